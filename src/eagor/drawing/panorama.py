"""A belief over a panorama: its density as heat, the border of its 90 % region, and the directions of all methods.

An `Estimate` is drawn as it is: its density, region, answer and candidates. What is drawn over a panorama and where
(heat, border, arrow, markers at the seam) is here once, for still pictures, videos and logs; `eagor.drawing.view` draws
the same over the picture of an ordinary camera. Places are degrees
``(n, 2)``: azimuth, positive to the left, and elevation. Rasters are in the layout of `eagor.sphere`: azimuth +180 at
the left edge, elevation +90 at the top.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.belief.posterior import Readable
from eagor.errors import EagorError
from eagor.grids import PatchGrid
from eagor.sphere import azimuth_elevation, unit
from eagor.thumbnail import undrawn
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Heat", "Marks", "arrow", "backdrop", "heat_of", "paint_marks", "places", "worth_an_arrow"]

ROWS = (360, 540)  # of the heat map: more for a small region
CELLS = 40  # least number of cells in a region, so that its border is not just a few straight lines
COARSE, BELOW = 180, 4.0  # rows; nats below the border: where the density is not computed on all cells
MASS = 0.9
FLAT = 1e-6  # a density that varies by less than this share of its mean is uniform
NEAR_SEAM = 172  # degrees of azimuth: a marker beyond it is drawn at both edges
COLOUR, BRIGHTNESS = 0.72, 0.80  # of the panorama's own, so that heat and markers stand out
BEHIND = (40, 44, 52)  # where there is no panorama


@dataclass(frozen=True, eq=False)
class Heat:
    """A belief as heat.

    `rgba` ``(H, W, 4)`` uint8, a whole panorama; `border`: the polylines around the 90 % region, empty where it is not
    drawn, and `missing` then says why. `share` ``(H, W)``: the root of the share of the highest density, 0 to 1;
    `contrast`: 0 for a uniform belief, 1 for a sharp one.
    """

    rgba: np.ndarray
    border: tuple[np.ndarray, ...] = ()
    missing: str = ""
    share: np.ndarray | None = None
    contrast: float = 1.0


@lru_cache(maxsize=1)  # a video and a page draw the same estimate one after the other
def heat_of(belief: Estimate | Readable, rows: tuple[int, ...] = ROWS) -> Heat | None:
    """The density as heat with the border of its 90 % region; None for a uniform belief, and while nothing is known.

    The border is missing if the region is larger than half of the sphere or if ripples alone decide where it runs.
    `rows`: of the map, multiples of 180; the first that are enough for the region.
    """
    if isinstance(belief, Estimate) and belief.direction is None:
        return None
    level, area = _region(belief)
    grid = _cells(area, rows)
    log_density = _density(belief, grid, level)
    times = 4 * math.pi * np.exp(log_density)  # relative to the uniform density
    most = float(times.max())
    if most - float(times.min()) < FLAT:
        return None
    share = np.sqrt(np.clip((times - 1) * (1 / (most - 1)), 0, 1))
    contrast = 1 - 1 / most
    rgba = _colours(contrast)[np.rint(255 * share).astype(np.uint8)]
    if why := undrawn(log_density, grid.weights, level, area):
        return Heat(rgba, (), f"{100 * MASS:.0f} % region not drawn: {why}", share, contrast)
    return Heat(rgba, _contour(log_density, grid, level), "", share, contrast)


def worth_an_arrow(estimate: Estimate) -> bool:
    """Whether an answer is worth an arrow: half of the sphere or less holds 90 % of the belief about it."""
    return estimate.direction is not None and estimate.credible_angle <= math.pi / 2


def arrow(where: np.ndarray) -> np.ndarray:
    """The great circle from forward to `where` ``(3,)`` as places ``(240, 2)``.

    ``(0, 2)`` if it is straight ahead or straight behind.
    """
    end = np.asarray(where, dtype=float)
    angle = math.acos(max(-1.0, min(1.0, float(end[0]))))
    side = np.array([0.0, end[1], end[2]])
    if angle < 1e-6 or np.linalg.norm(side) < 1e-6:
        return np.zeros((0, 2))
    along = np.linspace(0, angle, 240)[:, None]
    azimuth, elevation = azimuth_elevation(np.cos(along) * np.array([1.0, 0, 0]) + np.sin(along) * unit(side))
    return np.degrees(np.stack([azimuth, elevation], axis=-1))


def places(where: np.ndarray) -> np.ndarray:
    """Where a marker for `where` ``(3,)`` is drawn ``(1 or 2, 2)``: at both edges if it lies on the seam."""
    azimuth, elevation = (math.degrees(float(angle)) for angle in azimuth_elevation(np.asarray(where)))
    found = [(azimuth, elevation)]
    if abs(azimuth) > NEAR_SEAM:
        found.append((azimuth - math.copysign(360, azimuth), elevation))
    return np.array(found)


def backdrop(panorama: np.ndarray | None, heat: Heat | None, width: int, height: int) -> np.ndarray:
    """The panorama ``(H, W, 3)``, uint8 or 0 to 1, a little muted, with the heat: ``(height, width, 3)`` uint8.

    Without a panorama the ground is plain. Raises `EagorError` for a panorama of another shape.
    """
    from PIL import Image

    if panorama is None:
        ground = Image.new("RGB", (width, height), BEHIND)
    else:
        image = np.asarray(panorama)
        if image.ndim != 3 or image.shape[2] != 3 or not image.size:
            raise EagorError(f"a panorama of shape {image.shape}; wanted (H, W, 3)")
        if image.dtype != np.uint8:
            image = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
        own = Image.fromarray(np.ascontiguousarray(image))
        ground = own.resize((width, height), Image.Resampling.BILINEAR, reducing_gap=1.0)
        grey, colour = BRIGHTNESS * (1 - COLOUR) / 3, BRIGHTNESS * COLOUR
        matrix = [
            grey + (colour if row == column else 0) if column < 3 else 0 for row in range(3) for column in range(4)
        ]
        ground = ground.convert("RGB", tuple(matrix))
    if heat is not None:
        over = Image.fromarray(heat.rgba).resize((width, height), Image.Resampling.BILINEAR)
        ground.paste(over, mask=over)
    return np.asarray(ground)


def _region(belief: Estimate | Readable) -> tuple[float, float]:
    """The log density (per steradian) at the border of the 90 % region, and its solid angle."""
    if isinstance(belief, Estimate):
        return belief.region(MASS)
    found = belief.credible_region(MASS)
    return found.threshold, found.area


def _cells(area: float, rows: tuple[int, ...]) -> PatchGrid:
    """Cells for the heat, fine enough for a region of this solid angle."""
    wanted = math.ceil(math.sqrt(CELLS * 2 * math.pi / max(area, 1e-9)))
    return _grid(next((enough for enough in rows if enough >= wanted), rows[-1]))


@lru_cache(maxsize=3)
def _grid(rows: int) -> PatchGrid:
    return PatchGrid(rows, 2 * rows)


def _density(belief: Estimate | Readable, grid: PatchGrid, level: float) -> np.ndarray:
    """The log density ``(H, W)``, float32: exact near the answer and wherever it is not far below the border.

    Elsewhere it is interpolated between the cells of a coarse grid: a sharp belief covers few cells.
    """
    from PIL import Image
    from scipy import ndimage

    if not isinstance(belief, Estimate):  # smooth, and quickly computed
        return np.asarray(belief.log_density(grid.directions), dtype=np.float32)
    coarse = _grid(COARSE)
    found = np.asarray(belief.log_density(coarse.directions), dtype=np.float32)
    if grid.height == coarse.height:
        return found
    near: Any = found > level - BELOW
    x, y, _ = coarse.project(np.array([belief.direction, *(mode.direction for mode in belief.modes)]))
    near[np.minimum(y.astype(int), coarse.height - 1), x.astype(int) % coarse.width] = True
    modes: Any = ("nearest", "wrap")  # beyond the poles, and over the seam
    near = ndimage.maximum_filter(near, 5, mode=modes)
    times = grid.height // coarse.height
    wide = Image.fromarray(np.concatenate([found[:, -1:], found, found[:, :1]], axis=1))
    values = np.array(wide.resize((grid.width + 2 * times, grid.height), Image.Resampling.BILINEAR))[:, times:-times]
    exact = np.repeat(np.repeat(near, times, axis=0), times, axis=1)
    values[exact] = belief.log_density(grid.directions[exact])
    return values


def _colours(contrast: float) -> np.ndarray:
    """The colours ``(256, 4)`` uint8 of densities from none to the highest.

    `contrast`: 0 for a uniform belief, 1 for a sharp one.
    """
    from matplotlib import colormaps

    share = np.linspace(0, 1, 256)
    found = colormaps["inferno"](0.35 + 0.6 * share, bytes=True)
    found[:, 3] = np.rint(255 * 0.85 * contrast * np.clip(1.3 * share, 0, 1))
    return found


def _contour(log_density: np.ndarray, grid: PatchGrid, level: float) -> tuple[np.ndarray, ...]:
    """Where the density is at `level`. A few more columns on either side let it run across the seam into the frame."""
    from contourpy import contour_generator  # matplotlib draws contours with it

    more = 8
    azimuth = np.degrees(math.pi - 2 * math.pi * (np.arange(-more, grid.width + more) + 0.5) / grid.width)
    (inside,) = np.nonzero((log_density >= level).any(axis=1))
    if not len(inside):
        return ()
    rows = slice(max(0, inside[0] - 2), inside[-1] + 3)
    part = log_density[rows]
    padded = np.concatenate([part[:, -more:], part, part[:, :more]], axis=1)
    return tuple(map(np.asarray, contour_generator(azimuth, np.degrees(grid.latitudes[rows]), padded).lines(level)))


# --- marks ------------------------------------------------------------------------------------------------------------

OURS, TRUTH = "#00e5ff", "#39ff6a"
# Markers and colours that can be told apart in grey and by the colour-blind; the first methods get the first ones.
OTHERS = (("s", "#ffb000"), ("D", "#ff5fa8"), ("^", "#b197ff"), ("v", "#ff7043"), ("P", "#9ccc65"), ("X", "#90a4ae"))


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
    axes: Axes, belief: Estimate | Readable, heat: Heat | None, more: Marks = ALONE, scale: float = 1.0
) -> None:
    """All that is drawn over the heat: the border, the arrow, markers, and a note on what is missing.

    `scale`: of markers and lines, for a small panorama.
    """
    for at in (-90, 0, 90):
        axes.axvline(at, color="white", alpha=0.22, linewidth=0.8, zorder=1)
    axes.axhline(0, color="white", alpha=0.22, linewidth=0.8, zorder=1)
    answer = belief.direction if isinstance(belief, Estimate) else None
    if isinstance(belief, Estimate) and answer is None:
        note(axes, "direction not known", scale)
    if heat is not None and heat.missing:
        note(axes, heat.missing, scale)
    elif heat is not None:
        border(axes, heat.border, scale)
    if answer is not None and isinstance(belief, Estimate) and worth_an_arrow(belief):
        _arrow(axes, answer, scale)
    marks(axes, belief, places, more, scale)


def marks(
    axes: Axes,
    belief: Estimate | Readable,
    at: Callable[[np.ndarray], np.ndarray],
    more: Marks,
    scale: float = 1.0,
) -> None:
    """A marker for each direction; `at` says where in the axes ``(k, 2)`` one of them ``(3,)`` is drawn."""
    answer = belief.direction if isinstance(belief, Estimate) else None
    modes = more.modes
    if modes is None:
        modes = [mode.direction for mode in belief.modes] if isinstance(belief, Estimate) else []
    for index, mode in enumerate(modes):
        label = "candidate directions" if index == 0 else None
        _mark(axes, at(mode), "o", "white", 15 * scale, label, hollow=True, width=1.8 * scale)
    for index, (name, where) in enumerate(more.others.items()):
        marker, colour = OTHERS[index % len(OTHERS)]
        if where is not None:
            _mark(axes, at(where), marker, colour, 8.5 * scale, name)
    if more.truth is not None:
        _mark(axes, at(more.truth), "o", TRUTH, 21 * scale, "truth", hollow=True, width=2.6 * scale)
    if answer is not None:
        _mark(axes, at(answer), "o", OURS, 8.5 * scale, "estimate")


def border(axes: Axes, lines: Sequence[np.ndarray], scale: float = 1.0) -> None:
    """The border of the 90 % region: polylines ``(n, 2)``."""
    from matplotlib.collections import LineCollection

    for colour, width in (("black", 3.4), ("white", 1.6)):
        drawn = LineCollection(list(lines), colors=colour, linewidths=scale * width, zorder=3, capstyle="round")
        axes.add_collection(drawn, autolim=False)
    axes.plot([], [], color="white", linewidth=1.6, label=f"{100 * MASS:.0f} % region")


def note(axes: Axes, text: str, scale: float = 1.0) -> None:
    """Words in the corner of this panel: what a legend says holds for all panels."""
    axes.text(
        0.008, 0.02, text, transform=axes.transAxes, fontsize=9 * scale**0.5, color="white", ha="left", va="bottom",
        zorder=8, bbox={"facecolor": "black", "alpha": 0.55, "edgecolor": "none", "pad": 2.5},
    )  # fmt: skip


def _arrow(axes: Axes, where: np.ndarray, scale: float) -> None:
    """An arrow along the great circle from forward to `where`."""
    x, y = arrow(where).T
    if not len(x):
        return
    sheet = axes.get_figure(root=True)
    near = 0.18 * scale * (100.0 if sheet is None else sheet.dpi)  # the head ends before the rings around the estimate
    clear = axes.get_window_extent().width / 360 * np.hypot(x - x[-1], y - y[-1]) > near
    x, y = x[clear], y[clear]
    if len(x) < 8:
        return
    wide = 1.8 * scale
    axes.plot(x, y, color=OURS, linewidth=wide, zorder=6, path_effects=outline(2 * wide), solid_capstyle="round")
    axes.plot(0, 0, "o", color=OURS, markersize=4.5 * scale, markeredgecolor="black", markeredgewidth=0.8, zorder=6)
    head = {
        "arrowstyle": f"-|>,head_width={0.32 * scale},head_length={0.55 * scale}",
        "color": OURS,
        "linewidth": wide,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", xy=(x[-1], y[-1]), xytext=(x[-6], y[-6]), arrowprops=head, zorder=6)


def _mark(
    axes: Axes,
    at: np.ndarray,
    marker: str,
    colour: str,
    size: float,
    label: str | None,
    hollow: bool = False,
    width: float = 1.0,
) -> None:
    """A marker at each of the places ``(k, 2)``: two for a direction on the seam, none for one that is not shown."""
    for place in at:
        style = {"markersize": size, "linestyle": "none", "zorder": 7}
        if hollow:  # a dark ring below the bright one
            axes.plot(*place, marker, mfc="none", mec="black", mew=width + 1.8, alpha=0.7, **style)
            axes.plot(*place, marker, mfc="none", mec=colour, mew=width, label=label, **style)
        else:
            axes.plot(*place, marker, mfc=colour, mec="black", mew=width, label=label, **style)
        label = None


def outline(width: float) -> list[Any]:
    """Effects for bright lines of matplotlib: a dark one of this width below."""
    from matplotlib import patheffects

    return [patheffects.Stroke(linewidth=width, foreground="black", alpha=0.75), patheffects.Normal()]
