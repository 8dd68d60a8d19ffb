"""The picture of an ordinary camera with the belief on it, and beside it what is believed all around.

Where the answer is in view it is marked there, with the border of its region. Where it is not, an arrow at the edge
points to it and says how far it is, and how sure. A small panorama beside it shows the whole belief over what was
looked at so far (`Mosaic`), in the body's axes of now, with the outline of the view. One look tells "behind you, to the
left".
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.cameras import Sampler
from eagor.drawing.panorama import (
    ALONE,
    BEHIND,
    OURS,
    Heat,
    Marks,
    backdrop,
    border,
    heat_of,
    marks,
    note,
    outline,
    paint_marks,
    worth_an_arrow,
)
from eagor.drawing.style import DESIGN, FAINT, WORDS, answer_in_words, family, sureness
from eagor.drawing.timeline import COLOURS, SIDES
from eagor.errors import EagorError
from eagor.grids import ErpGrid, PerspectiveGrid, ViewKey, forward_view, view_key
from eagor.sphere import azimuth_elevation, direction
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Mosaic", "ViewScene", "edge", "heat_in_view", "lines_in_view", "outline_of", "place_in_view"]

ROWS = 240
FINE = 1.5  # pixels of a picture per cell: a finer one is shrunk first, by areas
LEAST = 0.17  # of the scene's width: what a small panorama needs at least
GAP = 14 / DESIGN  # of the scene's width, around the small panorama
SMALL = 0.6  # of markers and lines, on the small panorama
ALONG = 24  # points along each side of the outline
NO_SHRINK = {"shrinkA": 0, "shrinkB": 0}  # of an arrow, at its ends
MARGIN = 0.035  # of the picture's smaller side, between an arrow at the edge and the edge


# --- what a camera has shown so far -----------------------------------------------------------------------------------


class Mosaic:
    """The pictures of a camera that turns, in the axes of the world; a newer picture covers older ones.

    `colours` ``(rows, 2 rows, 3)`` uint8; `seen` ``(rows, 2 rows)``: which of its cells any picture has shown.
    """

    def __init__(self, rows: int = ROWS) -> None:
        self._grid = ErpGrid(rows, 2 * rows)
        self.colours = np.zeros((*self._grid.shape, 3), dtype=np.uint8)
        self.seen = np.zeros(self._grid.shape, dtype=bool)

    @property
    def share(self) -> float:
        """The share of the sphere that was shown, 0 to 1."""
        return float(np.sum(self.seen * self._grid.weights)) / (4 * math.pi)

    def add(self, picture: np.ndarray, grid: PerspectiveGrid, world_R_body: np.ndarray) -> None:
        """Paste a picture ``(h, w, 3)`` uint8, whose pixels `grid` describes, taken with this orientation."""
        from PIL import Image

        height = min(grid.height, math.ceil(FINE * self._grid.height / math.pi * grid.height / grid.focal))
        width = max(1, round(grid.width * height / grid.height))
        if (height, width) != picture.shape[:2]:
            small = Image.fromarray(np.ascontiguousarray(picture)).resize((width, height), Image.Resampling.BOX)
            picture = np.asarray(small)
        # Only what is nearer to the axis than the farthest corner can be in the picture.
        corners = grid.unproject(np.array([0.0, grid.width] * 2), np.array([0.0, 0.0, grid.height, grid.height]))
        axis = grid.body_R_view[:, 0]
        near = self._grid.directions @ (world_R_body @ axis) >= min(float((corners @ axis).min()) - 0.02, 1.0)
        x, y, inside = grid.project(self._grid.directions[near] @ world_R_body)
        column = (x[inside] * (width / grid.width)).astype(int).clip(0, width - 1)
        row = (y[inside] * (height / grid.height)).astype(int).clip(0, height - 1)
        rows, columns = (index[inside] for index in np.nonzero(near))
        self.colours[rows, columns] = picture[row, column]
        self.seen[rows, columns] = True

    def seen_from(self, world_R_body: np.ndarray, unseen: tuple[int, int, int]) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 in the axes of a body with this orientation, with holes `unseen`."""
        x, y, _ = self._grid.project(_directions(self._grid) @ world_R_body.T.astype(np.float32))
        row = y.astype(int).clip(0, self._grid.height - 1)
        column = x.astype(int) % self._grid.width
        found = self.colours[row, column]
        found[~self.seen[row, column]] = unseen
        return found


@lru_cache(maxsize=2)
def _directions(grid: ErpGrid) -> np.ndarray:
    return grid.directions.astype(np.float32)


# --- where things are in the picture ----------------------------------------------------------------------------------


def place_in_view(where: np.ndarray, grid: PerspectiveGrid) -> np.ndarray:
    """Where a direction ``(3,)`` of the body is in the picture ``(1, 2)``; ``(0, 2)`` if it is out of view.

    In shares of its width and height, from the left upper corner.
    """
    x, y, inside = grid.project(np.asarray(where, dtype=float))
    return np.array([[float(x) / grid.width, float(y) / grid.height]]) if inside else np.zeros((0, 2))


def lines_in_view(lines: Sequence[np.ndarray], grid: PerspectiveGrid) -> list[np.ndarray]:
    """The parts of polylines ``(n, 2)``, azimuth and elevation in degrees, that are in view: as `place_in_view`."""
    found = []
    for line in lines:
        x, y, inside = grid.project(direction(*np.radians(np.asarray(line, dtype=float)).T))
        at = np.stack([x / grid.width, y / grid.height], axis=-1)
        parts = np.split(np.arange(len(line)), np.flatnonzero(np.diff(inside.astype(int))) + 1)
        found += [at[part] for part in parts if len(part) > 1 and inside[part[0]]]
    return found


def heat_in_view(heat: Heat, grid: PerspectiveGrid, height: int, width: int) -> np.ndarray:
    """The part of a belief's heat ``(height, width, 4)`` uint8 that is in view, linear between its cells."""
    return _looked_at(view_key(grid), grid.body_R_view.tobytes(), height, width, *heat.rgba.shape[:2])(heat.rgba)


def outline_of(grid: PerspectiveGrid) -> list[np.ndarray]:
    """The outline of a view as polylines ``(n, 2)``, azimuth and elevation in degrees, cut at the seam."""
    t = np.linspace(0, 1, ALONG)
    zero = np.zeros(ALONG)
    x, y = np.concatenate([t, zero + 1, 1 - t, zero]), np.concatenate([zero, t, zero + 1, 1 - t])
    azimuth, elevation = azimuth_elevation(grid.unproject(x * grid.width, y * grid.height))
    found = np.degrees(np.stack([azimuth, elevation], axis=-1))
    return np.split(found, np.flatnonzero(np.abs(np.diff(found[:, 0])) > 180) + 1)


@dataclass(frozen=True)
class Edge:
    """An arrow at the edge of a picture: its `tip` and the unit vector along it `way`, pixels, x right and y down.

    `angle`: degrees from the view's axis to where it points.
    """

    tip: np.ndarray
    way: np.ndarray
    angle: float


def edge(where: np.ndarray, grid: PerspectiveGrid, width: float, height: float) -> Edge:
    """The arrow to a direction ``(3,)`` of the body that is out of view, for a picture of this size in pixels.

    It points along the great circle from the view's axis; straight behind counts as right.
    """
    ahead, left, up = np.asarray(where, dtype=float) @ grid.body_R_view
    length = math.hypot(left, up)
    way = np.array([-left, -up]) / length if length > 1e-9 else np.array([1.0, 0.0])
    inner = np.array([width, height]) / 2 - MARGIN * min(width, height)
    reach = float(np.min(inner / np.maximum(np.abs(way), 1e-9)))
    angle = math.degrees(math.atan2(length, ahead))
    return Edge(np.array([width, height]) / 2 + reach * way, way, angle)


@lru_cache(maxsize=4)
def _looked_at(lens: ViewKey, pose: bytes, height: int, width: int, rows: int, columns: int) -> Sampler:
    """What reads a panorama of so many rows and columns where each pixel of a view looks."""
    grid = forward_view(lens)
    assert isinstance(grid, PerspectiveGrid)
    turned = grid.resized(height, width).directions @ np.frombuffer(pose).reshape(3, 3).T
    return Sampler(ErpGrid(rows, columns), turned)


# --- the scene --------------------------------------------------------------------------------------------------------


class ViewScene:
    """A part of a figure that shows the picture of an ordinary camera, and what is believed all around.

    `place`: left, top, width, height of it, pixels of a figure of `size` (width, height). `mosaic` holds what was
    looked at so far; every picture that is painted is added to it.
    """

    def __init__(
        self, figure: Figure, size: tuple[int, int], place: tuple[int, int, int, int], mosaic: Mosaic | None = None
    ) -> None:
        self.mosaic = mosaic or Mosaic()
        self._figure, self._size, self._place = figure, size, place
        self._view, self._around = (figure.add_axes((0, 0, 1, 1)) for _ in range(2))
        for axes in (self._view, self._around):
            axes.set_axis_off()
            axes.set_autoscale_on(False)
        self._around.set_xlim(180, -180)
        self._around.set_ylim(-90, 90)
        big: dict[str, Any] = {"color": WORDS, "family": family(), "va": "top", "linespacing": 1.35}
        self._words = figure.text(0, 0, "", fontsize=15, weight="bold", **big)
        self._sure = figure.text(0, 0, "", fontsize=22, weight="bold", **big)
        quiet: dict[str, Any] = big | {"color": FAINT, "va": "bottom"}
        self._looked = figure.text(0, 0, "", fontsize=10, **quiet)
        self._grid: PerspectiveGrid | None = None

    def clear(self) -> None:
        """Draw nothing: for a step with a panorama."""
        for axes in (self._view, self._around):
            wipe(axes)
        for text in (self._words, self._sure, self._looked):
            text.set_text("")

    def look(self, picture: np.ndarray | None, grid: PerspectiveGrid, world_R_body: np.ndarray) -> None:
        """Keep what a picture shows, without painting. Raises `EagorError` if it is none, or not of the grid's size."""
        if picture is None:
            return
        if picture.ndim != 3 or picture.shape != (*grid.shape, 3):
            raise EagorError(
                f"a picture of shape {picture.shape} with a grid of {grid.height} x {grid.width}; wanted (H, W, 3) of "
                "the grid's size: use grid.resized(height, width)"
            )
        self.mosaic.add(_bytes(picture), grid, world_R_body)

    def paint(
        self,
        pixels: np.ndarray,
        picture: np.ndarray | None,
        grid: PerspectiveGrid | None,
        estimate: Estimate,
        more: Marks = ALONE,
    ) -> Axes:
        """Paint a step: its pictures into `pixels` ``(H, W, 3)`` of the figure, the rest as artists.

        `picture` ``(h, w, 3)``, uint8 or 0 to 1; None for one that cannot be read: the view is that of the step before.
        Returns the axes of the picture, in shares of its width and height. Errors as for `look`.
        """
        grid = self._grid = grid or self._grid
        assert grid is not None
        self.look(picture, grid, estimate.world_R_body)
        view, around = self._layout(grid)
        heat = heat_of(estimate)
        left, top, width, height = view
        there = None
        if heat is not None:  # sampled about once per cell; to the pixels it is interpolated
            cell = max(1.0, height / grid.height * grid.focal * math.pi / len(heat.rgba))
            there = Heat(heat_in_view(heat, grid, math.ceil(height / cell), math.ceil(width / cell)))
        pixels[top : top + height, left : left + width] = backdrop(picture, there, width, height)
        left, top, width, height = around
        looked = self.mosaic.seen_from(estimate.world_R_body, BEHIND)
        pixels[top : top + height, left : left + width] = backdrop(looked, heat, width, height)
        self.clear()
        self._mark_around(estimate, heat, grid, more)
        self._mark_view(estimate, heat, grid, view[2:], more)
        self._say(estimate, view, around)
        return self._view

    def _layout(self, grid: PerspectiveGrid) -> tuple[tuple[int, int, int, int], tuple[int, int, int, int]]:
        """Left, top, width and height, pixels, of the picture and of the small panorama; moves the axes there.

        The picture is as large as leaves a place for the small panorama: beside it, or below one that is very wide.
        """
        left, top, width, height = self._place
        gap, least = round(GAP * width), round(LEAST * width)
        ratio = grid.width / grid.height
        beside = min(width - least - 2 * gap, round(height * ratio))
        below = min(width, round((height - least // 2 - 2 * gap) * ratio))
        wide = max(beside, below)
        high = min(height, round(wide / ratio))
        if beside >= below:
            view = left, top, wide, high
            free = width - wide - 2 * gap
            small = min(free, height)  # leaves half of the height to the words
            around = left + wide + gap + (free - small) // 2, top + gap, small, small // 2
        else:
            view = left + (width - wide) // 2, top, wide, high
            small = 2 * (height - high - 2 * gap)
            around = view[0], top + high + gap, small, small // 2
        for axes, (x, y, w, h) in ((self._view, view), (self._around, around)):
            axes.set_position(self._share(x, y, w, h))
        self._view.set_xlim(0, 1)
        self._view.set_ylim(1, 0)
        return view, around

    def _share(self, x: float, y: float, wide: float, high: float) -> tuple[float, float, float, float]:
        """Pixels from the left upper corner as shares of the figure from the lower one."""
        return x / self._size[0], 1 - (y + high) / self._size[1], wide / self._size[0], high / self._size[1]

    def _mark_around(self, estimate: Estimate, heat: Heat | None, grid: PerspectiveGrid, more: Marks) -> None:
        """What is drawn on the small panorama: the belief's marks, the outline of the view, the sides."""
        axes = self._around
        for line in outline_of(grid):
            axes.plot(*line.T, color="white", linewidth=1.6, zorder=5, path_effects=outline(3.2))
        quiet = None if heat is None or heat.missing else heat
        paint_marks(axes, estimate, quiet, more, SMALL)
        for at, name in SIDES[1:-1]:
            axes.annotate(
                name, (at, 90), xytext=(0, -3), textcoords="offset points", fontsize=8, color="white", ha="center",
                va="top", path_effects=outline(2.0), zorder=8,
            )  # fmt: skip

    def _mark_view(
        self, estimate: Estimate, heat: Heat | None, grid: PerspectiveGrid, size: tuple[int, int], more: Marks
    ) -> None:
        """What is drawn on the picture: the border of the region and the marks in view, or an arrow at the edge."""
        axes, answer = self._view, estimate.direction
        pointed = worth_an_arrow(estimate) or estimate.status != "searching"
        if heat is not None and not heat.missing:
            border(axes, lines_in_view(heat.border, grid))
        if answer is None:
            note(axes, "direction not known")
        elif len(at := place_in_view(answer, grid)):
            if pointed:
                axes.annotate(
                    sureness(estimate), at[0], xytext=(12, 12), textcoords="offset points", fontsize=14, color=OURS,
                    weight="bold", path_effects=outline(3.0), zorder=8, annotation_clip=False,
                )  # fmt: skip
        elif pointed:
            self._point(edge(answer, grid, *size), estimate, size)
        else:
            note(axes, "not in view; it may be anywhere")
        marks(axes, estimate, lambda where: place_in_view(where, grid), more)

    def _point(self, arrow: Edge, estimate: Estimate, size: tuple[int, int]) -> None:
        """An arrow at the edge, with the angle and how sure it is beside it, inside the picture."""
        axes, less = self._view, min(size)
        tip, tail = arrow.tip / size, (arrow.tip - 0.16 * less * arrow.way) / size
        for colour, more in (("black", 1.0), (OURS, 0.0)):
            head = {"arrowstyle": f"simple,head_width={1.5 + 0.2 * more},head_length=1.1,tail_width={0.5 + 0.2 * more}"}
            head |= {"facecolor": colour, "edgecolor": "black", "linewidth": 1 + 3 * more, "mutation_scale": 15}
            axes.annotate("", xy=tuple(tip), xytext=tuple(tail), arrowprops=head | NO_SHRINK, zorder=7 - more)
        at = (arrow.tip - 0.19 * less * arrow.way) / size
        ha = "center" if abs(arrow.way[0]) < 0.5 else "right" if arrow.way[0] > 0 else "left"
        va = "center" if abs(arrow.way[1]) < 0.5 else "bottom" if arrow.way[1] > 0 else "top"
        axes.text(
            at[0], at[1], f"{arrow.angle:.0f}°\n{sureness(estimate)}", fontsize=17, weight="bold", color=OURS, ha=ha,
            va=va, path_effects=outline(3.5), zorder=8, linespacing=1.15,
        )  # fmt: skip

    def _say(self, estimate: Estimate, view: tuple[int, int, int, int], around: tuple[int, int, int, int]) -> None:
        """The answer in words, below the small panorama, or right of one that is below the picture."""
        left, top, width, height = around
        scale, foot = self._place[2] / DESIGN, self._place[1] + self._place[3] - 12 / DESIGN * self._place[2]
        if top >= view[1] + view[3]:
            left, width = left + width + round(GAP * self._place[2]), view[2] - width
            downs, foot = (0, 40), top + height
        else:
            top, downs = top + height, (14, 56)
        said = answer_in_words(estimate)
        columns = max(12, int(width / (11.5 * scale)))
        if len(said) > columns:  # where the height begins
            kept = said.replace(" degrees)", "\u00a0degrees)")  # a number stays with its unit
            said = "\n".join(textwrap.fill(part, columns) for part in kept.rsplit(", ", 1))
        self._words.set_text(said)
        self._sure.set_text(sureness(estimate) if estimate.direction is not None else "")
        self._sure.set_color(COLOURS[estimate.status])
        looked = f"looked at {100 * self.mosaic.share:.0f} % of all directions"
        self._looked.set_text(textwrap.fill(looked, max(12, int(width / (7 * scale)))))
        down, further = (top + each * scale for each in downs)
        for text, y in ((self._sure, down), (self._words, further), (self._looked, foot)):
            text.set_position(self._share(left, y, 0, 0)[:2])


def wipe(axes: Axes) -> None:
    """Remove everything that was drawn into these axes."""
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.texts):
        artist.remove()


def _bytes(picture: np.ndarray) -> np.ndarray:
    return picture if picture.dtype == np.uint8 else np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)
