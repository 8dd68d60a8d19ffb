"""One step of a track as a picture: the panorama with the belief, the answer in words, and the time line so far.

A painter keeps its matplotlib figure and paints only lines and words with it, over pixels that NumPy and Pillow made:
that is several times faster than a new figure with images for each frame. What is drawn over the panorama is drawn by
`eagor.drawing.panorama.paint_marks`, as in the still pictures.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.drawing.panorama import MASS, backdrop, heat_of, paint_marks
from eagor.drawing.sheet import blank, family, over
from eagor.drawing.timeline import COLOURS, SIDES, Moment, TimeLine, ticks
from eagor.drawing.words import answer_in_words, far_in_words
from eagor.errors import EagorError
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

__all__ = ["NARROWEST", "WIDEST", "ScenePainter", "StepPainter", "draw_step"]

DESIGN = 1280  # columns that all sizes below are for; a picture of another width is scaled
HEAD, FOOT = 64, 152  # rows above and below the panorama
LEFT, RIGHT, TOP, BOTTOM = 78, 142, 12, 26  # pixels around the axes of the time line
PRESENCE, STATUS, GAP = 22, 9, 7  # rows of the lower strips, and between them
NARROWEST, WIDEST = 320, 3840
GROUND, PANEL, RULE, WORDS, FAINT, ALARM = "#12151b", "#1a1e26", "#39404c", "#eef1f6", "#a5aebb", "#ffb000"
BAND, NOW = "#2b6f7d", "#ffffff"
LONGEST_QUERY, LONGEST_PROBLEM = 38, 150  # characters
MOST_CLOCK = 1e5  # seconds: stamps beyond are of a calendar, and the time line counts from the first one


class ScenePainter:
    """Paints panoramas with beliefs, `width` pixels wide and half as high, without words around them.

    Raises `EagorError` for an impossible width.
    """

    def __init__(self, width: int = DESIGN) -> None:
        self.width = _checked(width)
        self.height = self.width // 4 * 2
        self._sheet = blank(self.width, self.height, 100 * self.width / DESIGN)
        self._axes = _scene(self._sheet.figure, (0, 0, 1, 1))

    def paint(self, panorama: np.ndarray | None, estimate: Estimate, problem: str | None = None) -> np.ndarray:
        """One picture ``(height, width, 3)`` uint8; arguments as for `StepPainter.paint`."""
        heat = heat_of(estimate)
        ground = backdrop(panorama, heat, self.width, self.height)
        _repaint(self._axes, estimate, heat, problem)
        return over(self._sheet, ground)


class StepPainter:
    """Paints the steps of one track, in order of time; the time line grows with them.

    `width` of the pictures in pixels, 320 to 3840, made even. `span`: the seconds that the time line shows, if the
    length of the clip is known. Raises `EagorError` for an impossible width, `TimeError` for an impossible span.
    """

    def __init__(self, width: int = DESIGN, span: float | None = None) -> None:
        self.line = TimeLine(span)
        self.width = _checked(width)
        scale = self.width / DESIGN
        self.head, self.rows = round(HEAD * scale), self.width // 4 * 2
        self.height = (self.head + self.rows + round(FOOT * scale)) // 2 * 2
        self._sheet = blank(self.width, self.height, 100 * scale)
        w, h = self.width, self.height
        self._scene = _scene(self._sheet.figure, (0, (h - self.head - self.rows) / h, 1, self.rows / h))
        left, wide = LEFT * scale / w, 1 - (LEFT + RIGHT) * scale / w
        low, places = BOTTOM * scale, []
        for high in (STATUS * scale, PRESENCE * scale, 0.0):
            high = high or h - self.head - self.rows - TOP * scale - low
            places.append((left, low / h, wide, high / h))
            low += high + GAP * scale
        self._places = places
        self._status, self._presence, self._azimuth = (_strip(self._sheet.figure, place) for place in places)
        for strip, low, high in ((self._status, 0, 1), (self._presence, 0, 1), (self._azimuth, -180, 180)):
            strip.set_ylim(low, high)
        self._words = self._places_of_words()
        self._ground, self._span = np.zeros(0), math.nan

    def paint(
        self,
        panorama: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        query: str = "",
        problem: str | None = None,
    ) -> np.ndarray:
        """One step ``(height, width, 3)`` uint8.

        Args:
            panorama: ``(H, W, 3)``, uint8 or 0 to 1, in the body frame of the estimate; None for a frame that cannot
                be read.
            estimate: the answer.
            stamp: time of the frame in seconds; None: of the estimate.
            query: what is looked for.
            problem: why the frame could not be used, if so; it is written into the picture.

        Raises `TimeError` unless the stamps grow, `EagorError` for a panorama of another shape.
        """
        heat = heat_of(estimate)
        seen = backdrop(panorama, heat, self.width, self.rows)
        self.line.add(Moment.of(estimate, stamp, problem))
        if self.line.span != self._span:
            self._stretch()
        pixels = self._ground.copy()
        pixels[self.head : self.head + self.rows] = seen
        _repaint(self._scene, estimate, heat, problem)
        self._say(estimate, query)
        self._draw_line()
        return over(self._sheet, pixels)

    def _places_of_words(self) -> dict[str, Any]:
        """The words that change from step to step, empty so far."""
        figure, h = self._sheet.figure, self.height
        first, second, edge = 1 - 0.36 * self.head / h, 1 - 0.74 * self.head / h, 16 / DESIGN
        large: dict[str, Any] = {"va": "center", "family": family(), "fontsize": 14, "weight": "bold"}
        small: dict[str, Any] = {"va": "center", "family": family(), "fontsize": 11.5}
        return {
            "query": figure.text(edge, first, "", color=WORDS, **large),
            "answer": figure.text(edge, second, "", color=WORDS, **small),
            "status": figure.text(1 - edge, first, "", ha="right", **large),
            "rest": figure.text(1 - edge, second, "", color=FAINT, ha="right", **small),
        }

    def _stretch(self) -> None:
        """The ground of all pictures with this span of time: panels, rules, labels, what the colours mean."""
        w, h, scale = self.width, self.height, self.width / DESIGN
        sheet = blank(w, h, 100 * scale)
        figure, small = sheet.figure, {"fontsize": 8.5, "color": FAINT, "va": "center"}
        status, presence, azimuth = (_strip(figure, place, PANEL) for place in self._places)
        azimuth.set_ylim(-180, 180)
        for at, name in SIDES:
            azimuth.axhline(at, color=RULE, linewidth=0.7 if abs(at) < 180 else 0, zorder=1)
            azimuth.annotate(name, (0, at), xytext=(-5, 0), textcoords="offset points", ha="right", **small)
        presence.set_ylim(0, 1)
        presence.axhline(0.5, color=RULE, linewidth=0.7, zorder=1)
        for axes, name in ((presence, "presence"), (status, "status")):
            axes.text(-5 * scale / (self._places[0][2] * w), 0.5, name, transform=axes.transAxes, ha="right", **small)
        span = self.line.span
        offset = self.line.first if 0 <= self.line.first < MOST_CLOCK else 0.0
        status.set_xlim(0, span)
        status.set_xticks(times := ticks(span), [f"{offset + time:g} s" for time in times])
        status.tick_params(colors=FAINT, labelsize=8.5, length=2, pad=2)
        top = h - self.head - self.rows - TOP * scale
        x = 1 - (RIGHT - 18) / DESIGN
        for index, (name, colour) in enumerate([*COLOURS.items(), ("90 % cone", BAND)]):
            y = (top - (6 + 17.5 * index) * scale) / h
            figure.text(x, y, "■", fontsize=9, color=colour, va="center")
            figure.text(x + 15 / DESIGN, y, name, **small)
        for strip in (self._status, self._presence, self._azimuth):
            strip.set_xlim(0, span)
        ground = np.empty((h, w, 3), dtype=np.uint8)
        ground[:] = [int(GROUND[at : at + 2], 16) for at in (1, 3, 5)]
        self._ground, self._span = over(sheet, ground), span

    def _say(self, estimate: Estimate, query: str) -> None:
        moment = self.line.last
        assert moment is not None
        told = [] if moment.cone is None else [f"{100 * MASS:.0f} % within {math.degrees(moment.cone):.0f}°"]
        if far := far_in_words(estimate):
            told.append(far)
        told += [f"presence {moment.presence:.2f}", f"{moment.stamp:.2f} s"]
        shown, known = _short(query, LONGEST_QUERY), moment.azimuth is not None
        self._words["query"].set_text(f"“{shown}”" if shown else "")
        self._words["answer"].set_text(answer_in_words(estimate) if known else "direction not known")
        self._words["status"].set_text(estimate.status)
        self._words["status"].set_color(COLOURS[moment.status])
        self._words["rest"].set_text("   ".join(told))

    def _draw_line(self) -> None:
        """The time line, from all moments so far."""
        from matplotlib.collections import LineCollection

        line, strips = self.line, (self._azimuth, self._presence, self._status)
        for strip in strips:
            _clear(strip)
        _boxes(self._azimuth, line.bands(), BAND, 0.75)
        lines = list(line.answers()[:, [[0, 2], [1, 2]]])
        for colour, width in (("black", 3.2), (COLOURS["tracking"], 2.0)):
            drawn = LineCollection(lines, colors=colour, linewidths=width, zorder=4)
            self._azimuth.add_collection(drawn, autolim=False)
        _boxes(self._presence, np.insert(line.presence(), 2, 0.0, axis=1), COLOURS["tracking"], 0.65)
        stretches = line.stretches()
        for status, colour in COLOURS.items():
            rows = [(begin, end, 0.0, 1.0) for begin, end, what in stretches if what == status]
            _boxes(self._status, np.array(rows).reshape(-1, 4), colour, 1.0)
        for strip in strips:
            strip.axvline(line.now, color=NOW, linewidth=1.4, zorder=7)


def draw_step(
    panorama: np.ndarray | None,
    estimate: Estimate,
    *,
    stamp: float | None = None,
    query: str = "",
    problem: str | None = None,
    before: tuple[Moment, ...] | list[Moment] = (),
    span: float | None = None,
    width: int = DESIGN,
) -> Image:
    """One step as a still picture, as a video shows it; `before`: the earlier moments, in order of time.

    Other arguments and errors as for `StepPainter`.
    """
    from PIL import Image

    painter = StepPainter(width, span)
    for moment in before:
        painter.line.add(moment)
    return Image.fromarray(painter.paint(panorama, estimate, stamp=stamp, query=query, problem=problem))


def _scene(figure: Any, place: tuple[float, float, float, float]) -> Axes:
    axes = figure.add_axes(place)
    axes.set_axis_off()
    axes.set_autoscale_on(False)
    axes.set_xlim(180, -180)
    axes.set_ylim(-90, 90)
    return axes


def _repaint(axes: Axes, estimate: Estimate, heat: Any, problem: str | None) -> None:
    """The marks of this step instead of the last one's."""
    from matplotlib import patheffects

    _clear(axes)
    paint_marks(axes, estimate, heat)
    outline = [patheffects.withStroke(linewidth=2.2, foreground="black", alpha=0.6)]
    for index, (at, name) in enumerate(SIDES):
        side = "left" if index == 0 else "right" if index == len(SIDES) - 1 else "center"
        axes.annotate(
            name, (at, 90), xytext=({"left": 5, "right": -5}.get(side, 0), -4), textcoords="offset points",
            fontsize=9, color="white", ha=side, va="top", path_effects=outline, zorder=8,
        )  # fmt: skip
    if problem:
        axes.text(
            0.5, 0.9, f"left out: {_short(problem, LONGEST_PROBLEM)}", transform=axes.transAxes, fontsize=10,
            color=ALARM, ha="center", va="top", zorder=9, family=family(),
            bbox={"facecolor": "black", "alpha": 0.7, "edgecolor": ALARM, "linewidth": 0.8, "pad": 4},
        )  # fmt: skip


def _strip(figure: Any, place: tuple[float, float, float, float], ground: str = "none") -> Axes:
    axes = figure.add_axes(place, facecolor=ground)
    axes.set_autoscale_on(False)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    return axes


def _boxes(axes: Axes, boxes: np.ndarray, colour: str, alpha: float) -> None:
    """Rectangles ``(n, 4)``, begin, end, low and high, as one path."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if not len(boxes):
        return
    begin, end, low, high = boxes.T
    corners = np.stack([begin, low, begin, high, end, high, end, low, begin, low], axis=1).reshape(-1, 2)
    codes = np.tile(np.array([Path.MOVETO, *[Path.LINETO] * 3, Path.CLOSEPOLY], dtype=np.uint8), len(boxes))
    axes.add_artist(PathPatch(Path(corners, codes), facecolor=colour, alpha=alpha, linewidth=0, zorder=2))


def _clear(axes: Axes) -> None:
    for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.texts):
        artist.remove()


def _short(text: str, most: int) -> str:
    text = " ".join(str(text).split())
    return text if len(text) <= most else text[: most - 1] + "…"


def _checked(width: int) -> int:
    """The next lower even width: videos have colours for two by two pixels."""
    if isinstance(width, bool) or not isinstance(width, int | np.integer) or not NARROWEST <= width <= WIDEST:
        raise EagorError(f"a picture {width!r} pixels wide; wanted a whole number from {NARROWEST} to {WIDEST}")
    return int(width) // 2 * 2
