"""One step of a track as a picture: what the camera saw with the belief, the answer in words, and the time line so far.

The camera sees all around, and its panorama is drawn; or only a part, and its picture is drawn with a small panorama of
what was looked at so far beside it (`eagor.drawing.view`).

A painter keeps its matplotlib figure and paints only lines and words with it, over pixels that NumPy and Pillow made:
that is several times faster than a new figure with images for each frame. What is drawn over the panorama is drawn by
`eagor.drawing.panorama.paint_marks`, as in the still pictures.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor.drawing.panorama import backdrop, heat_of, paint_marks
from eagor.drawing.style import DESIGN, FAINT, WORDS, blank, candidates_in_words, family, far_in_words, ground, over
from eagor.drawing.timeline import COLOURS, SIDES, Moment, TimeLine, ticks
from eagor.drawing.view import ViewScene, wipe
from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

__all__ = ["NARROWEST", "WIDEST", "ScenePainter", "StepPainter", "draw_step"]

HEAD, FOOT = 64, 152  # rows above and below the panorama
LEFT, RIGHT, TOP, BOTTOM = 78, 142, 12, 26  # pixels around the axes of the time line
PRESENCE, STATUS, GAP = 22, 9, 7  # rows of the lower strips, and between them
NARROWEST, WIDEST = 320, 3840
PANEL, RULE, ALARM = "#1a1e26", "#39404c", "#ffb000"
BAND, NOW = "#2b6f7d", "#ffffff"
LONGEST_QUERY, LONGEST_PROBLEM = 38, 150  # characters
MOST_CLOCK = 1e5  # seconds: stamps beyond are of a calendar, and the time line counts from the first one


class Scene:
    """The part of a figure in which a step is shown. `place`: left, top, width and height in pixels, `size`: all."""

    def __init__(self, figure: Figure, size: tuple[int, int], place: tuple[int, int, int, int]) -> None:
        left, top, wide, high = self.place = place
        self.axes = figure.add_axes((left / size[0], 1 - (top + high) / size[1], wide / size[0], high / size[1]))
        self.axes.set_axis_off()
        self.axes.set_autoscale_on(False)
        self.axes.set_xlim(180, -180)
        self.axes.set_ylim(-90, 90)
        self._figure, self._size = figure, size
        self.view: ViewScene | None = None  # once there was a picture of an ordinary camera

    def paint(
        self,
        pixels: np.ndarray,
        picture: np.ndarray | None,
        estimate: Estimate,
        problem: str | None,
        grid: PerspectiveGrid | None,
    ) -> None:
        """Paint a step, its pictures into `pixels` ``(H, W, 3)`` of the figure, the rest as artists."""
        wipe(self.axes)
        if grid is not None or (picture is None and self.view is not None):
            shown = self.viewed().paint(pixels, picture, grid, estimate)
        else:
            if self.view is not None:
                self.view.clear()
            left, top, wide, high = self.place
            heat, shown = heat_of(estimate), self.axes
            pixels[top : top + high, left : left + wide] = backdrop(picture, heat, wide, high)
            _mark(shown, estimate, heat)
        if problem:
            shown.text(
                0.5, 0.9, f"left out: {_short(problem, LONGEST_PROBLEM)}", transform=shown.transAxes, fontsize=10,
                color=ALARM, ha="center", va="top", zorder=9, family=family(),
                bbox={"facecolor": "black", "alpha": 0.7, "edgecolor": ALARM, "linewidth": 0.8, "pad": 4},
            )  # fmt: skip

    def viewed(self) -> ViewScene:
        """The scene of an ordinary camera, which remembers what it was shown."""
        if self.view is None:
            self.view = ViewScene(self._figure, self._size, self.place)
        return self.view


class ScenePainter:
    """Paints pictures with beliefs, `width` pixels wide and half as high, without words around them.

    Raises `EagorError` for an impossible width.
    """

    def __init__(self, width: int = DESIGN) -> None:
        self.width = _checked(width)
        self.height = self.width // 4 * 2
        self._sheet = blank(self.width, self.height, 100 * self.width / DESIGN)
        size = (self.width, self.height)
        self._scene = Scene(self._sheet.figure, size, (0, 0, *size))

    def paint(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> np.ndarray:
        """One picture ``(height, width, 3)`` uint8; arguments as for `StepPainter.paint`."""
        pixels = ground(self.width, self.height)
        self._scene.paint(pixels, picture, estimate, problem, grid)
        return over(self._sheet, pixels)

    def look(self, picture: np.ndarray | None, estimate: Estimate, grid: PerspectiveGrid | None) -> None:
        """Keep what an ordinary camera shows, for later pictures, without painting this step."""
        if grid is not None:
            self._scene.viewed().look(picture, grid, estimate.world_R_body)


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
        self._scene = Scene(self._sheet.figure, (w, h), (0, self.head, w, self.rows))
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
        self._rest, self._span = np.zeros(0), math.nan

    def paint(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        query: str = "",
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
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

        Raises `TimeError` unless the stamps grow, `EagorError` for a picture of another shape.
        """
        pixels = ground(self.width, self.height)
        self._scene.paint(pixels, picture, estimate, problem, grid)
        self.line.add(Moment.of(estimate, stamp, problem))
        if self.line.span != self._span:
            self._stretch()
        rows = slice(self.head, self.head + self.rows)
        scene, pixels = pixels[rows], self._rest.copy()
        pixels[rows] = scene
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
        self._rest, self._span = over(sheet, ground(w, h)), span

    def _say(self, estimate: Estimate, query: str) -> None:
        moment = self.line.last
        assert moment is not None
        told = [] if moment.cone is None else [estimate.certainty]
        if far := far_in_words(estimate):
            told.append(far)
        told += [f"presence {moment.presence:.2f}", f"{moment.stamp:.2f} s"]
        shown = _short(query, LONGEST_QUERY)
        self._words["query"].set_text(f"“{shown}”" if shown else "")
        self._words["answer"].set_text(candidates_in_words(estimate))
        self._words["status"].set_text(estimate.status)
        self._words["status"].set_color(COLOURS[moment.status])
        self._words["rest"].set_text("   ".join(told))

    def _draw_line(self) -> None:
        """The time line, from all moments so far."""
        from matplotlib.collections import LineCollection

        line, strips = self.line, (self._azimuth, self._presence, self._status)
        for strip in strips:
            wipe(strip)
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
    picture: np.ndarray | None,
    estimate: Estimate,
    *,
    stamp: float | None = None,
    query: str = "",
    problem: str | None = None,
    grid: PerspectiveGrid | None = None,
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
    return Image.fromarray(painter.paint(picture, estimate, stamp=stamp, query=query, problem=problem, grid=grid))


def _mark(axes: Axes, estimate: Estimate, heat: Any) -> None:
    """The marks of this step on its panorama."""
    from matplotlib import patheffects

    paint_marks(axes, estimate, heat)
    outline = [patheffects.withStroke(linewidth=2.2, foreground="black", alpha=0.6)]
    for index, (at, name) in enumerate(SIDES):
        side = "left" if index == 0 else "right" if index == len(SIDES) - 1 else "center"
        axes.annotate(
            name, (at, 90), xytext=({"left": 5, "right": -5}.get(side, 0), -4), textcoords="offset points",
            fontsize=9, color="white", ha=side, va="top", path_effects=outline, zorder=8,
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


def _short(text: str, most: int) -> str:
    text = " ".join(str(text).split())
    return text if len(text) <= most else text[: most - 1] + "…"


def _checked(width: int) -> int:
    """The next lower even width: videos have colours for two by two pixels."""
    if isinstance(width, bool) or not isinstance(width, int | np.integer) or not NARROWEST <= width <= WIDEST:
        raise EagorError(f"a picture {width!r} pixels wide; wanted a whole number from {NARROWEST} to {WIDEST}")
    return int(width) // 2 * 2
