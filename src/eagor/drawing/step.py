"""One step of a track as a picture: what the camera saw with the belief, the answer in words, and the time line so far.

What an ordinary camera saw has a small panorama beside it, which shows the whole belief over what was looked at so far,
in the body's axes of now, with the outline of the view: one look tells "behind you, to the left".

A painter keeps its matplotlib figure and paints only lines and words with it, over pixels that NumPy and Pillow made:
that is several times faster than a new figure with images for each frame.
"""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.drawing import style
from eagor.drawing.heat import Heat, heat_of, reader_of_heat
from eagor.drawing.marks import ALONE, Marks, Mosaic, backdrop, outline, outline_of, paint_marks
from eagor.drawing.style import COLOURS, DARK, DESIGN, FAINT, SIDES, WORDS
from eagor.drawing.timeline import TimeLine, TimelinePoint
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["StepPainter"]

HEAD, FOOT = 64, 152  # rows above and below the picture
LEFT, RIGHT, LOW, GAP = 78, 142, 26, 7  # pixels around the strips of the time line, and between them
STRIPS = (("status", 9, (0, 1)), ("presence", 22, (0, 1)), ("azimuth", 69, (-180, 180)))  # from below: rows, ends
LEAST, AROUND = 218, 14  # columns of a small panorama at least, and pixels around it
SMALL = 0.6  # of markers and lines, on the small panorama
NARROWEST, WIDEST = 320, 3840
PANEL, RULE, BAND, NOW, ALARM = "#1a1e26", "#39404c", "#2b6f7d", "#ffffff", "#ffb000"
LONGEST_QUERY, LONGEST_PROBLEM = 38, 150  # characters

Box = tuple[int, int, int, int]  # left, top, width and height, pixels


class StepPainter:
    """Paints the steps of one track, in order of time; the time line grows with them.

    `width` of the pictures in pixels, 320 to 3840, made even. `span`: the seconds that the time line shows, if the
    length of the clip is known. `bare`: only what was seen, twice as wide as high, without words and time line.
    `mosaic`: what an ordinary camera was shown before; what is painted is added. Raises `EagorError` for an impossible
    width, `TimeError` for an impossible span.
    """

    def __init__(
        self, width: int = DESIGN, span: float | None = None, bare: bool = False, mosaic: Mosaic | None = None
    ) -> None:
        if not (isinstance(width, int) and NARROWEST <= width <= WIDEST):
            raise EagorError(f"a picture {width!r} pixels wide; wanted a whole number from {NARROWEST} to {WIDEST}")
        self.line, self.mosaic = TimeLine(span), mosaic or Mosaic()
        self.width = width // 2 * 2  # videos have colours for two by two pixels
        self._scale = scale = self.width / DESIGN
        self.rows, self.head = self.width // 4 * 2, 0 if bare else round(HEAD * scale)
        self.height = self.rows if bare else (self.head + self.rows + round(FOOT * scale)) // 2 * 2
        self._pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        self._figure = style.figure(self.width, self.height, 100 * scale)
        self._seen, self._around = (self._figure.add_axes((0, 0, 1, 1), autoscale_on=False) for _ in range(2))
        self._seen.axison = self._around.axison = False
        self._grid: PerspectiveGrid | None = None  # of the step before
        self._bare, self._span = bare, 0.0
        self._said: list[Any] = []  # artists of this step
        if not bare:
            self._strips = {name: self._strip(index) for index, (name, _, _) in enumerate(STRIPS)}
            self._drawn = self._artists()

    def paint(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        query: str = "",
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
        more: Marks = ALONE,
    ) -> np.ndarray:
        """One step ``(height, width, 3)`` uint8.

        Args:
            picture: ``(H, W, 3)``, uint8 or 0 to 1: a panorama in the body frame of the estimate, or with `grid` what
                an ordinary camera saw; None for a frame that cannot be read.
            estimate: the answer.
            stamp: time of the frame in seconds; None: of the estimate.
            query: what is looked for.
            problem: why the frame could not be used, if so; it is written into the picture.
            grid: which directions of the body the pixels of an ordinary camera show.
            more: what is marked beside the answer.

        Raises `TimeError` unless the stamps grow, `EagorError` for a picture of another shape.
        """
        self._pixels[:] = DARK
        for axes in (self._seen, self._around):
            self._said += [*axes.lines, *axes.collections, *axes.patches, *axes.texts]
        while self._said:
            self._said.pop().remove()
        heat = heat_of(estimate)
        grid = self._grid = grid or (self._grid if picture is None else None)
        if grid is None:
            self._show(self._seen, (0, self.head, self.width, self.rows), picture, heat)
            paint_marks(self._seen, estimate, heat, more)
            for (at, name), side in zip(SIDES, ("left", "center", "center", "center", "right"), strict=True):
                _name(self._seen, at, name, side, 9)
        else:
            self._view(picture, estimate, heat, grid, more)
        if problem:
            self._seen.text(
                0.5, 0.9, f"left out: {style.short(problem, LONGEST_PROBLEM)}", transform=self._seen.transAxes,
                fontsize=10, color=ALARM, ha="center", va="top", zorder=9, family=style.family(),
                bbox={"facecolor": "black", "alpha": 0.7, "edgecolor": ALARM, "linewidth": 0.8, "pad": 4},
            )  # fmt: skip
        if not self._bare:
            moment, right = TimelinePoint.of(estimate, stamp, problem), {"ha": "right", "weight": "normal"}
            self.line.add(moment)
            self._draw_line()
            told = [] if moment.cone is None else [estimate.certainty]
            told += [style.far_in_words(estimate), f"presence {moment.presence:.2f}", f"{moment.stamp:.2f} s"]
            asked, answer = style.short(query, LONGEST_QUERY), style.candidates_in_words(estimate)
            left, first, second = 16 * self._scale, 0.36 * self.head, 0.74 * self.head
            self._say(left, first, f"“{asked}”" if asked else "", 14, WORDS)
            self._say(left, second, answer, 11.5, WORDS, weight="normal")
            self._say(self.width - left, first, estimate.status, 14, COLOURS[estimate.status], ha="right")
            self._say(self.width - left, second, "   ".join(filter(None, told)), 11.5, FAINT, **right)
        return style.painted(self._figure, self._pixels)

    def boxes(self, grid: PerspectiveGrid) -> tuple[Box, Box]:
        """Where an ordinary picture is, as large as leaves a place for the small panorama, and where that is."""
        gap, ratio = round(AROUND * self._scale), grid.width / grid.height
        wide = min(self.width - round(LEAST * self._scale) - 2 * gap, round(self.rows * ratio))
        free = self.width - wide - 2 * gap
        small = min(free, self.rows)  # leaves half of the height to the words
        around = wide + gap + (free - small) // 2, self.head + gap, small, small // 2
        return (0, self.head, wide, min(self.rows, round(wide / ratio))), around

    def _view(
        self, picture: np.ndarray | None, estimate: Estimate, heat: Heat | None, grid: PerspectiveGrid, more: Marks
    ) -> None:
        """What an ordinary camera saw, what is around it, how sure it is, and the answer in words."""
        if picture is not None:
            self.mosaic.add(picture, grid, estimate.world_R_body)
        view, around = self.boxes(grid)
        self._show(self._seen, view, picture, heat, grid)
        self._show(self._around, around, self.mosaic.seen_from(estimate.world_R_body), heat)
        self._around.plot(*outline_of(grid).T, color="white", linewidth=1.6, zorder=5, path_effects=outline(3.2))
        for at, name in SIDES[1:-1]:
            _name(self._around, at, name, "center", 8)
        paint_marks(self._around, estimate, heat, more, scale=SMALL)
        paint_marks(self._seen, estimate, heat, more, grid)
        left, top, width, height = around
        if estimate.direction is not None:
            colour = COLOURS[estimate.status]
            self._say(left, top + height + 14 * self._scale, style.confidence(estimate), 22, colour, va="top")
        kept = style.answer_in_words(estimate).replace(" degrees", "\u00a0degrees")  # a number stays with its unit
        said = textwrap.fill(kept, max(12, int(width / (11.5 * self._scale))))
        self._say(left, top + height + 56 * self._scale, said, 15, WORDS, va="top", linespacing=1.35)

    def _show(
        self, axes: Axes, box: Box, picture: np.ndarray | None, heat: Heat | None, grid: PerspectiveGrid | None = None
    ) -> None:
        """Paint a panorama, or with `grid` an ordinary picture, with heat on it, and move its axes there."""
        (left, top, wide, high), rgba = box, None if heat is None else heat.rgba
        if heat is not None and grid is not None:  # sampled about once per cell; to the pixels it is interpolated
            cell = max(1.0, high / grid.height * grid.focal * math.pi / len(heat.rgba))
            rgba = reader_of_heat(grid, math.ceil(high / cell), math.ceil(wide / cell))(heat.rgba)
        self._pixels[top : top + high, left : left + wide] = backdrop(picture, rgba, wide, high)
        w, h, whole = self.width, self.height, grid is None
        axes.set(position=(left / w, 1 - (top + high) / h, wide / w, high / h))
        axes.set(xlim=(180, -180) if whole else (0, 1), ylim=(-90, 90) if whole else (1, 0))

    def _say(self, x: float, y: float, words: str, size: float, colour: str, **how: Any) -> None:
        """Words of this step, at pixels from the left upper corner."""
        how = {"va": "center", "weight": "bold", "family": style.family()} | how
        made = self._figure.text(x / self.width, 1 - y / self.height, words, fontsize=size, color=colour, **how)
        self._said.append(made)

    def _strip(self, index: int) -> Axes:
        """The axes of a strip of the time line, with its names and rules."""
        scale, (name, rows, ends) = self._scale, STRIPS[index]
        low = (LOW + sum(rows + GAP for _, rows, _ in STRIPS[:index])) * scale
        wide = 1 - (LEFT + RIGHT) * scale / self.width
        place = (LEFT * scale / self.width, low / self.height, wide, rows * scale / self.height)
        axes = self._figure.add_axes(place, facecolor=PANEL, autoscale_on=False, ylim=ends, xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        how: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "xytext": (-5, 0)}
        for at, words in SIDES if name == "azimuth" else [(0.5, name)]:
            if name != "status" and abs(at) < 180:
                axes.axhline(at, color=RULE, linewidth=0.7, zorder=1)
            axes.annotate(words, (0, at), fontsize=8.5, color=FAINT, ha="right", va="center", **how)
        return axes

    def _artists(self) -> list[tuple[str, Any]]:
        """What grows along the time line, by its name in `TimeLine.boxes`; and in words, what its colours mean."""
        from matplotlib.collections import PolyCollection

        x = 1 - (RIGHT - 18) / DESIGN
        for index, (name, colour) in enumerate([*COLOURS.items(), ("90 % cone", BAND)]):
            y = (FOOT - 18 - 17.5 * index) * self._scale / self.height
            self._figure.text(x, y, "■", fontsize=9, color=colour, va="center")
            self._figure.text(x + 15 / DESIGN, y, name, fontsize=8.5, color=FAINT, va="center")
        cyan, made = COLOURS["tracking"], []
        kinds = [("bands", "azimuth", BAND, 0.75, 0.0), ("presence", "presence", cyan, 0.65, 0.0)]
        kinds += [("answers", "azimuth", "black", 1.0, 3.2), ("answers", "azimuth", cyan, 1.0, 2.0)]
        kinds += [(status, "status", colour, 1.0, 0.0) for status, colour in COLOURS.items()]
        for name, strip, colour, alpha, edge in kinds:  # answers are boxes without a height
            how: dict[str, Any] = {"linewidths": edge, "antialiaseds": False, "zorder": 4 if edge else 2}
            drawn = PolyCollection([], facecolors=colour, edgecolors=colour, alpha=alpha, **how)
            self._strips[strip].add_collection(drawn, autolim=False)
            made.append((name, drawn))
        return made

    def _draw_line(self) -> None:
        """The time line, from all moments so far."""
        line, boxes = self.line, self.line.boxes()
        if line.span != self._span:
            self._span = line.span
            for strip in self._strips.values():
                strip.set_xlim(0, line.span)
            times, names = zip(*line.ticks(), strict=True)
            self._strips["status"].set_xticks(times, names)
            self._strips["status"].tick_params(colors=FAINT, labelsize=8.5, length=2, pad=2)
        for name, drawn in self._drawn:
            drawn.set_verts(boxes[name][:, [[0, 2], [0, 3], [1, 3], [1, 2]]])
        for strip in self._strips.values():
            self._said.append(strip.axvline(line.now, color=NOW, linewidth=1.4, zorder=7))


def _name(axes: Axes, at: float, name: str, side: str, size: float) -> None:
    """What an azimuth is called, at the upper edge of a panorama."""
    beside = {"left": 5, "right": -5}.get(side, 0)
    axes.annotate(
        name, (at, 90), xytext=(beside, -4), textcoords="offset points", fontsize=size, color="white", ha=side,
        va="top", path_effects=outline(2.2), zorder=8,
    )  # fmt: skip
