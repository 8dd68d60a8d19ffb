"""One step of a track as a picture: what the camera saw with the belief, the answer in words, and the time line so far.

A painter keeps its matplotlib figure and paints only lines and words with it, over pixels that NumPy and Pillow made:
that is several times faster than a new figure with images for each frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.drawing import style
from eagor.drawing.scene import ALONE, Marks, Scene
from eagor.drawing.style import COLOURS, DARK, DESIGN, FAINT, SIDES, WORDS
from eagor.drawing.timeline import Moment, TimeLine
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["StepPainter"]

HEAD, FOOT = 64, 152  # rows above and below the picture
LEFT, RIGHT, LOW, GAP = 78, 142, 26, 7  # pixels around the strips of the time line, and between them
STRIPS = (("status", 9, (0, 1)), ("presence", 22, (0, 1)), ("azimuth", 69, (-180, 180)))  # from below: rows, ends
NARROWEST, WIDEST = 320, 3840
PANEL, RULE, BAND, NOW = "#1a1e26", "#39404c", "#2b6f7d", "#ffffff"
LONGEST_QUERY = 38  # characters


class StepPainter:
    """Paints the steps of one track, in order of time; the time line grows with them.

    `width` of the pictures in pixels, 320 to 3840, made even. `span`: the seconds that the time line shows, if the
    length of the clip is known. `bare`: only what was seen, twice as wide as high, without words and time line. Raises
    `EagorError` for an impossible width, `TimeError` for an impossible span.
    """

    def __init__(self, width: int = DESIGN, span: float | None = None, bare: bool = False) -> None:
        if isinstance(width, bool) or not isinstance(width, int | np.integer) or not NARROWEST <= width <= WIDEST:
            raise EagorError(f"a picture {width!r} pixels wide; wanted a whole number from {NARROWEST} to {WIDEST}")
        self.line, self.width = TimeLine(span), int(width) // 2 * 2  # videos have colours for two by two pixels
        self.rows, scale = self.width // 4 * 2, self.width / DESIGN
        self.head = 0 if bare else round(HEAD * scale)
        self.height = self.rows if bare else (self.head + self.rows + round(FOOT * scale)) // 2 * 2
        self._figure = style.figure(self.width, self.height, 100 * scale)
        self.scene = Scene(self._figure, (0, self.head, self.width, self.rows))
        self._bare, self._span = bare, 0.0
        if not bare:
            self._words = self._places_of_words()
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
        pixels = np.full((self.height, self.width, 3), DARK, dtype=np.uint8)
        self.scene.paint(pixels, picture, estimate, grid, more, problem)
        if not self._bare:
            moment = Moment.of(estimate, stamp, problem)
            self.line.add(moment)
            told = [] if moment.cone is None else [estimate.certainty]
            told += [style.far_in_words(estimate), f"presence {moment.presence:.2f}", f"{moment.stamp:.2f} s"]
            self._words["query"].set_text(f"“{style.short(query, LONGEST_QUERY)}”" if query.strip() else "")
            self._words["answer"].set_text(style.candidates_in_words(estimate))
            self._words["status"].set(text=estimate.status, color=COLOURS[moment.status])
            self._words["rest"].set_text("   ".join(filter(None, told)))
            self._draw_line()
        return style.painted(self._figure, pixels)

    def _places_of_words(self) -> dict[str, Any]:
        """The words that change from step to step, empty so far."""
        first, second, edge = 1 - 0.36 * self.head / self.height, 1 - 0.74 * self.head / self.height, 16 / DESIGN
        how: dict[str, Any] = {"va": "center", "family": style.family()}
        large, small, text = {"fontsize": 14, "weight": "bold"}, {"fontsize": 11.5}, self._figure.text
        return {
            "query": text(edge, first, "", color=WORDS, **how, **large),
            "answer": text(edge, second, "", color=WORDS, **how, **small),
            "status": text(1 - edge, first, "", ha="right", **how, **large),
            "rest": text(1 - edge, second, "", color=FAINT, ha="right", **how, **small),
        }

    def _strip(self, index: int) -> Axes:
        """The axes of a strip of the time line, with its names and rules."""
        scale, (name, rows, ends) = self.width / DESIGN, STRIPS[index]
        low = (LOW + sum(rows + GAP for _, rows, _ in STRIPS[:index])) * scale
        wide = 1 - (LEFT + RIGHT) * scale / self.width
        place = (LEFT * scale / self.width, low / self.height, wide, rows * scale / self.height)
        axes = self._figure.add_axes(place, facecolor=PANEL, autoscale_on=False, ylim=ends, xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        names = SIDES if name == "azimuth" else [(0.5, name)]
        for at, words in names:
            if name != "status" and abs(at) < 180:
                axes.axhline(at, color=RULE, linewidth=0.7, zorder=1)
            how: dict[str, Any] = {"textcoords": "offset points", "xytext": (-5, 0), "ha": "right", "va": "center"}
            axes.annotate(words, (0, at), xycoords=("axes fraction", "data"), fontsize=8.5, color=FAINT, **how)
        return axes

    def _artists(self) -> dict[str, Any]:
        """What grows along the time line, empty so far, and what its colours mean."""
        from matplotlib.collections import LineCollection, PolyCollection

        def boxes(strip: str, colour: str, alpha: float) -> PolyCollection:
            made = PolyCollection([], facecolors=colour, alpha=alpha, linewidths=0, antialiaseds=False, zorder=2)
            self._strips[strip].add_collection(made, autolim=False)
            return made

        scale, x = self.width / DESIGN, 1 - (RIGHT - 18) / DESIGN
        for index, (name, colour) in enumerate([*COLOURS.items(), ("90 % cone", BAND)]):
            y = (FOOT - 18 - 17.5 * index) * scale / self.height
            self._figure.text(x, y, "■", fontsize=9, color=colour, va="center")
            self._figure.text(x + 15 / DESIGN, y, name, fontsize=8.5, color=FAINT, va="center")
        lines = [
            LineCollection([], colors=c, linewidths=w, zorder=4) for c, w in (("black", 3.2), (COLOURS["tracking"], 2))
        ]
        for line in lines:
            self._strips["azimuth"].add_collection(line, autolim=False)
        return {
            "bands": boxes("azimuth", BAND, 0.75),
            "presence": boxes("presence", COLOURS["tracking"], 0.65),
            "answers": lines,
            "now": [strip.axvline(0, color=NOW, linewidth=1.4, zorder=7) for strip in self._strips.values()],
            **{status: boxes("status", colour, 1.0) for status, colour in COLOURS.items()},
        }

    def _draw_line(self) -> None:
        """The time line, from all moments so far."""
        line, drawn = self.line, self._drawn
        if line.span != self._span:
            self._span = line.span
            for strip in self._strips.values():
                strip.set_xlim(0, line.span)
            times, names = zip(*line.ticks(), strict=True)
            self._strips["status"].set_xticks(times, names)
            self._strips["status"].tick_params(colors=FAINT, labelsize=8.5, length=2, pad=2)
        drawn["bands"].set_verts(_corners(line.bands()))
        drawn["presence"].set_verts(_corners(line.presence()))
        for each in drawn["answers"]:
            each.set_segments(line.answers()[:, [[0, 2], [1, 2]]])
        for status in COLOURS:
            found = [(begin, end, 0, 1) for begin, end, what in line.stretches() if what == status]
            drawn[status].set_verts(_corners(np.reshape(found, (-1, 4))))
        for each in drawn["now"]:
            each.set_xdata([line.now, line.now])


def _corners(boxes: np.ndarray) -> np.ndarray:
    """The corners ``(n, 4, 2)`` of boxes ``(n, 4)``: begin, end, low and high."""
    return boxes[:, [[0, 2], [0, 3], [1, 3], [1, 2]]]
