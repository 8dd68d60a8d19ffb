"""What is drawn over what was seen: one set of marks for panoramas and for pictures of an ordinary camera.

Where an answer is in an ordinary picture it is marked there, with the border of its region. Where it is not, an arrow
at the edge points to it and says how far it is, and how sure. What such a camera was shown so far is a `Mosaic`.

Places on a panorama are degrees: azimuth, positive to the left, and elevation. Places in an ordinary picture are shares
of its width and height, from the left upper corner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.belief.posterior import Readable
from eagor.drawing.heat import MASS, Heat
from eagor.drawing.style import confidence
from eagor.errors import EagorError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sphere import azimuth_elevation, direction, unit
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["ALONE", "OURS", "TRUTH", "UNSEEN", "Marks", "Mosaic", "backdrop", "outline_of", "paint_marks"]

OURS, TRUTH = "#00e5ff", "#39ff6a"
# Markers and colours that can be told apart in grey and by the colour-blind; the first methods get the first ones.
OTHERS = (("s", "#ffb000"), ("D", "#ff5fa8"), ("^", "#b197ff"), ("v", "#ff7043"), ("P", "#9ccc65"), ("X", "#90a4ae"))
COLOUR, BRIGHTNESS = 0.72, 0.80  # of the panorama's own, so that heat and markers stand out
UNSEEN = (40, 44, 52)  # where there is no picture
MARGIN = 0.035  # of the picture's smaller side, between an arrow at the edge and the edge
SHRINK = 1.5  # pixels of a picture per cell of a mosaic: a finer one is shrunk first, by areas


def outline(width: float) -> list[Any]:
    """Effects for bright lines of matplotlib: a dark one of this width below."""
    from matplotlib import patheffects

    return [patheffects.Stroke(linewidth=width, foreground="black", alpha=0.75), patheffects.Normal()]


def worth_an_arrow(estimate: Estimate) -> bool:
    """Whether an answer is worth an arrow: half of the sphere or less holds 90 % of the belief about it."""
    return estimate.direction is not None and estimate.credible_angle <= math.pi / 2


# --- where things are -------------------------------------------------------------------------------------------------


def places(where: np.ndarray, grid: PerspectiveGrid | None = None) -> np.ndarray:
    """Where directions ``(..., 3)`` of the body are drawn ``(..., 2)``: on a panorama, or with `grid` in that picture.

    NaN for what is not in the picture.
    """
    if grid is None:
        return np.degrees(np.stack(azimuth_elevation(where), axis=-1))
    x, y, inside = grid.project(np.asarray(where, dtype=float))
    return np.where(inside[..., None], np.stack([x / grid.width, y / grid.height], axis=-1), np.nan)


def outline_of(grid: PerspectiveGrid) -> np.ndarray:
    """The outline of a view as a polyline ``(n, 2)`` on a panorama; NaN where it crosses the seam."""
    t, zero = np.linspace(0, 1, 99), np.zeros(99)
    x, y = np.concatenate([t, zero + 1, 1 - t, zero]), np.concatenate([zero, t, zero + 1, 1 - t])
    found = places(grid.unproject(x * grid.width, y * grid.height))
    found[np.abs(np.diff(found[:, 0], append=found[0, 0])) > 180] = np.nan
    return found


def edge(where: np.ndarray, grid: PerspectiveGrid, width: float, height: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The arrow to a direction ``(3,)`` of the body that is out of view, for a picture of this size in pixels.

    Its tip and the unit vector along it, pixels, x right and y down; degrees from the view's axis to the direction. It
    points along the great circle from the axis; straight behind counts as right.
    """
    ahead, left, up = np.asarray(where, dtype=float) @ grid.body_R_view
    length = math.hypot(left, up)
    way = np.array([-left, -up]) / length if length > 1e-9 else np.array([1.0, 0.0])
    inner = np.array([width, height]) / 2 - MARGIN * min(width, height)
    reach = float(np.min(inner / np.maximum(np.abs(way), 1e-9)))
    return np.array([width, height]) / 2 + reach * way, way, math.degrees(math.atan2(length, ahead))


# --- marks ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Marks:
    """Directions ``(3,)`` that are marked beside the answer: the truth, other methods' by name, candidates.

    `modes` None: the candidates of the estimate.
    """

    truth: np.ndarray | None = None
    others: Mapping[str, np.ndarray | None] = field(default_factory=dict)
    modes: Sequence[np.ndarray] | None = None


ALONE = Marks()


def paint_marks(
    axes: Axes,
    belief: Estimate | Readable,
    heat: Heat | None,
    more: Marks = ALONE,
    grid: PerspectiveGrid | None = None,
    scale: float = 1.0,
) -> None:
    """All that is drawn over the heat: the border, the answer and the way to it, markers, what is missing.

    The axes show a panorama, or with `grid` that picture. `scale`: of markers and lines, for a small panorama.
    """
    from matplotlib.collections import LineCollection

    estimate = belief if isinstance(belief, Estimate) else None
    answer = None if estimate is None else estimate.direction
    if grid is None:
        for at in (-90, 0, 90):
            axes.axvline(at, color="white", alpha=0.22, linewidth=0.8, zorder=1)
        axes.axhline(0, color="white", alpha=0.22, linewidth=0.8, zorder=1)
    if estimate is not None and answer is None:
        _note(axes, "direction not known", scale)
    if heat is not None and heat.missing and grid is None and scale == 1:
        _note(axes, heat.missing, scale)
    elif heat is not None and not heat.missing:
        lines = [line if grid is None else places(direction(*np.radians(line).T), grid) for line in heat.border]
        for colour, width in (("black", 3.4), ("white", 1.6)):
            drawn = LineCollection(lines, colors=colour, linewidths=scale * width, zorder=3, capstyle="round")
            axes.add_collection(drawn, autolim=False)
        axes.plot([], [], color="white", linewidth=1.6, label=f"{100 * MASS:.0f} % region")
    if estimate is not None and answer is not None:
        if grid is not None:
            _point(axes, estimate, answer, grid)
        elif worth_an_arrow(estimate):
            _turn(axes, answer, scale)
    modes = more.modes
    if modes is None:
        modes = () if estimate is None else [mode.direction for mode in estimate.modes]
    for index, mode in enumerate(modes):
        label = "candidate directions" if index == 0 else None
        _mark(axes, mode, grid, "o", "white", 15 * scale, label, 1.8 * scale)
    for (name, where), (marker, colour) in zip(more.others.items(), OTHERS * len(more.others), strict=False):
        if where is not None:
            _mark(axes, where, grid, marker, colour, 8.5 * scale, name)
    if more.truth is not None:
        _mark(axes, more.truth, grid, "o", TRUTH, 21 * scale, "truth", 2.6 * scale)
    if answer is not None:
        _mark(axes, answer, grid, "o", OURS, 8.5 * scale, "estimate")


def _mark(
    axes: Axes, where: np.ndarray, grid: PerspectiveGrid | None, marker: str, colour: str, size: float,
    label: str | None, ring: float = 0.0,
) -> None:  # fmt: skip
    """A marker at a direction, at both edges of a panorama if it is at the seam; `ring`: the width of a hollow one."""
    at = places(where, grid) + ([(0, 0), (360, 0), (-360, 0)] if grid is None else [(0, 0)])
    how = {"markersize": size, "linestyle": "none", "zorder": 7}
    if ring:  # a dark one below the bright one
        axes.plot(*at.T, marker, mfc="none", mec="black", mew=ring + 1.8, alpha=0.7, **how)
        axes.plot(*at.T, marker, mfc="none", mec=colour, mew=ring, label=label, **how)
    else:
        axes.plot(*at.T, marker, mfc=colour, mec="black", mew=1.0, label=label, **how)


def _note(axes: Axes, text: str, scale: float = 1.0) -> None:
    """Words in the corner of this panel: what a legend says holds for all panels."""
    axes.text(
        0.008, 0.02, text, transform=axes.transAxes, fontsize=9 * scale**0.5, color="white", ha="left", va="bottom",
        zorder=8, bbox={"facecolor": "black", "alpha": 0.55, "edgecolor": "none", "pad": 2.5},
    )  # fmt: skip


def _turn(axes: Axes, where: np.ndarray, scale: float) -> None:
    """An arrow on a panorama along the great circle from forward to `where`, up to the rings around it."""
    rings = math.radians(65 * scale * axes.figure.dpi / axes.bbox.width)
    angle = math.acos(max(-1.0, min(1.0, float(where[0])))) - rings
    if angle < 0.1 or np.hypot(*where[1:]) < 1e-6:  # nearly ahead, or straight behind
        return
    along = np.linspace(0, angle, 240)[:, None]
    x, y = np.degrees(azimuth_elevation(np.cos(along) * np.eye(3)[0] + np.sin(along) * unit(where * (0, 1, 1))))
    wide = 1.8 * scale
    axes.plot(x, y, color=OURS, linewidth=wide, zorder=6, path_effects=outline(2 * wide), solid_capstyle="round")
    axes.plot(0, 0, "o", color=OURS, markersize=4.5 * scale, markeredgecolor="black", markeredgewidth=0.8, zorder=6)
    style = f"-|>,head_width={0.32 * scale},head_length={0.55 * scale}"
    head = {"arrowstyle": style, "color": OURS, "linewidth": wide, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=(x[-1], y[-1]), xytext=(x[-6], y[-6]), arrowprops=head, zorder=6)


def _point(axes: Axes, estimate: Estimate, answer: np.ndarray, grid: PerspectiveGrid) -> None:
    """How sure it is: beside the answer in a picture, or at an arrow at the edge that points to it, with the angle."""
    said: dict[str, Any] = {"weight": "bold", "color": OURS, "path_effects": outline(3.2), "zorder": 8}
    pointed = worth_an_arrow(estimate) or estimate.status != "searching"
    if np.isfinite(at := places(answer, grid)).all():
        if pointed:
            beside: dict[str, Any] = {"xytext": (12, 12), "textcoords": "offset points", "annotation_clip": False}
            axes.annotate(confidence(estimate), tuple(at), fontsize=14, **beside, **said)
        return
    if not pointed:
        _note(axes, "not in view; it may be anywhere")
        return
    size = np.array(axes.bbox.size)
    tip, way, angle = edge(answer, grid, *size)
    tail, words = ((tip - share * min(size) * way) / size for share in (0.16, 0.19))
    shape = {"arrowstyle": "simple,head_width=1.5,head_length=1.1,tail_width=0.5", "mutation_scale": 15}
    shape |= {"facecolor": OURS, "edgecolor": "black", "shrinkA": 0, "shrinkB": 0, "path_effects": outline(5.0)}
    axes.annotate("", xy=tuple(tip / size), xytext=tuple(tail), arrowprops=shape, zorder=7)
    ha = "center" if abs(way[0]) < 0.5 else "right" if way[0] > 0 else "left"
    va = "center" if abs(way[1]) < 0.5 else "bottom" if way[1] > 0 else "top"
    text = f"{angle:.0f}°\n{confidence(estimate)}"
    axes.text(words[0], words[1], text, fontsize=17, ha=ha, va=va, linespacing=1.15, **said)


# --- pictures ---------------------------------------------------------------------------------------------------------


def backdrop(picture: np.ndarray | None, heat: np.ndarray | None, width: int, height: int) -> np.ndarray:
    """A picture ``(H, W, 3)``, uint8 or 0 to 1, a little muted, with heat ``(h, w, 4)`` on it.

    Returns ``(height, width, 3)`` uint8. Without a picture the ground is plain. Raises `EagorError` for another shape.
    """
    from PIL import Image, ImageEnhance

    if picture is None:
        ground = Image.new("RGB", (width, height), UNSEEN)
    else:
        own = Image.fromarray(_bytes(picture)).resize((width, height), Image.Resampling.BILINEAR, reducing_gap=1.0)
        ground = ImageEnhance.Brightness(ImageEnhance.Color(own).enhance(COLOUR)).enhance(BRIGHTNESS)
    if heat is not None:
        over = Image.fromarray(heat).resize((width, height), Image.Resampling.BILINEAR)
        ground.paste(over, mask=over)
    return np.asarray(ground)


def _bytes(picture: np.ndarray) -> np.ndarray:
    """A picture ``(H, W, 3)`` as uint8. Raises `EagorError` for another shape."""
    picture = np.asarray(picture)
    if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise EagorError(f"a picture of shape {picture.shape}; wanted (H, W, 3)")
    if picture.dtype != np.uint8:
        picture = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(picture)


class Mosaic:
    """The pictures of a camera that turns, in the axes of the world; a newer picture covers older ones.

    `colours` ``(rows, 2 rows, 3)`` uint8: what was shown of the sphere, and `UNSEEN`.
    """

    def __init__(self, rows: int = 240) -> None:
        self._grid = ErpGrid(rows, 2 * rows)
        self._directions = self._grid.directions.astype(np.float32)
        self.colours = np.full((*self._grid.shape, 3), UNSEEN, dtype=np.uint8)

    def add(self, picture: np.ndarray, grid: PerspectiveGrid, world_R_body: np.ndarray) -> None:
        """Paste a picture ``(H, W, 3)``, whose pixels `grid` describes, taken with this orientation.

        Raises `EagorError` if it is not of the grid's size.
        """
        from PIL import Image

        if picture.shape != (*grid.shape, 3):
            raise EagorError(
                f"a picture of shape {picture.shape} with a grid of {grid.height} x {grid.width}; wanted (H, W, 3) of "
                "the grid's size: use grid.resized(height, width)"
            )
        height = min(grid.height, math.ceil(SHRINK * self._grid.height / math.pi * grid.height / grid.focal))
        width = max(1, round(grid.width * height / grid.height))
        small = np.asarray(Image.fromarray(_bytes(picture)).resize((width, height), Image.Resampling.BOX))
        x, y, inside = grid.project(self._directions @ world_R_body)
        column = (x[inside] * (width / grid.width)).astype(int).clip(0, width - 1)
        row = (y[inside] * (height / grid.height)).astype(int).clip(0, height - 1)
        self.colours[inside] = small[row, column]

    def seen_from(self, world_R_body: np.ndarray) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 in the axes of a body with this orientation."""
        x, y, _ = self._grid.project(self._directions @ world_R_body.T.astype(np.float32))
        return self.colours[y.astype(int).clip(0, self._grid.height - 1), x.astype(int) % self._grid.width]
