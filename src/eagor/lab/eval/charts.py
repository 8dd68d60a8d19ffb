"""Charts of a page, as SVG by matplotlib: they scale, and need no script.

A method is told apart by its colour, its dashes and the shape of its marks, so that colour alone is never needed. The
colours are variables of the page's style sheet: matplotlib is given a stand-in for each, which `svg_of` replaces.
"""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

# All have at least 3:1 contrast on their ground. The first eight hues stay apart for the colour-blind (after Okabe and
# Ito); the others are told apart by their dashes and marks. A chart asks for a colour by its name here.
LIGHT = {
    "eagor": "#005fa3", "eagor_paper": "#c44e00", "centroid": "#a8467f", "cent_circ": "#866400", "grid": "#007a5a",
    "vmf": "#2f3440", "grid_filter": "#3d84c6", "particle_filter": "#71767f", "oracle": "#2f3440",
    "plain": "#a3333d", "best_detection": "#7b4fb5", "last_detection": "#0f7f8c",
}  # fmt: skip
DARK = {
    "eagor": "#5cb8f5", "eagor_paper": "#ff8f45", "centroid": "#e79bca", "cent_circ": "#e8d44d", "grid": "#34cfa3",
    "vmf": "#e9ebf0", "grid_filter": "#9fb6ff", "particle_filter": "#a4a9b3", "oracle": "#e9ebf0",
    "plain": "#f28b92", "best_detection": "#c0a6ff", "last_detection": "#6fd3dd",
}  # fmt: skip
SPARE = 8  # colours of series that are no methods: x0 to x7
RING = "ring"
ALL_MARKED = 10  # points of a line that all have a mark; of more some
STYLES: dict[str, tuple[Any, str]] = {  # dashes and marks, as matplotlib names them
    "eagor": ("-", "o"),
    "eagor_paper": ((0, (7, 3)), "s"),
    "centroid": ((0, (2, 3)), "^"),
    "cent_circ": ((0, (9, 3, 2, 3)), "v"),
    "grid": ((0, (5, 3)), "D"),
    "best_detection": ((0, (8, 2, 2, 2, 2, 2)), "*"),
    "last_detection": ((0, (4, 1)), ">"),
    "vmf": ((0, (3, 2)), "x"),
    "grid_filter": ((0, (10, 4)), "+"),
    "particle_filter": ((0, (1, 3)), RING),
    "oracle": ("-", RING),
    "plain": ((0, (1, 2)), "D"),
}
MARKS = ("o", "s", "^", "D", "v", "x", "+", RING)
_PAGE = ("ink", "quiet", "paper", "rule", "target")
_COLOURS = (*_PAGE, *(f"c-{name}" for name in LIGHT), *(f"c-x{k}" for k in range(SPARE)))


@dataclass(frozen=True)
class Curve:
    """A mean `y` at each `x` with its interval, over `n` episodes; None where too few episodes have a case."""

    x: tuple[float, ...]
    y: tuple[float | None, ...]
    low: tuple[float | None, ...]
    high: tuple[float | None, ...]
    n: tuple[int, ...]


@dataclass(frozen=True)
class Series:
    """A line of a chart: what it is called, its points, and the name of its looks."""

    name: str
    curve: Curve
    look: str
    strong: bool = False


def bands(series: Sequence[Series]) -> str:
    """What a caption says of the bands of these lines; "" where none is drawn."""
    return "; bands: 95 % intervals" if any(v is not None for line in series for v in line.curve.low) else ""


def look_of(name: str, index: int = 0) -> str:
    """The looks of a method; others get one of the spare ones, by `index`."""
    return name if name in STYLES else f"x{index % SPARE}"


def palette(colours: Mapping[str, str]) -> str:
    """The colours of methods and spare series, by their names in the style sheet."""
    spare = {f"x{k}": colour for k, colour in enumerate(list(colours.values())[:SPARE])}
    return "".join(f"--c-{name}:{colour};" for name, colour in {**colours, **spare}.items())


def style_of(look: str, **more: Any) -> dict[str, Any]:
    """How matplotlib draws a line of these looks, and its marks."""
    dashes, mark = STYLES.get(look) or ("-", MARKS[int(look[1:]) % len(MARKS)])
    found = {"color": colour_of(f"c-{look}"), "linestyle": dashes, "marker": mark, "clip_on": False}
    if mark == RING:
        found |= {"marker": "o", "markerfacecolor": colour_of("paper")}
    return found | more


def colour_of(name: str) -> str:
    """The stand-in for a colour of the page."""
    return f"#fe00{_COLOURS.index(name):02x}"


def blank(width: float, height: float, inside: tuple[float, float, float, float] = (0, 0, 1, 1)) -> tuple[Any, Any]:
    """A figure of this many pixels, and its axes within (left, bottom, width, height: shares); nothing is drawn yet."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 72, height / 72), dpi=72)
    axes = figure.add_axes(inside)
    axes.axis("off")
    figure.patch.set_visible(False)
    axes.patch.set_visible(False)
    return figure, axes


def line_chart(
    series: Sequence[Series],
    title: str,
    x_label: str,
    y_label: str,
    y_range: tuple[float, float] | None = None,
    event: str = "",
    diagonal: bool = False,
) -> str:
    """Lines with their 95 % bands and a legend; the strong ones lie on top.

    `event` names what happens at x = 0, where a line is drawn; `diagonal` draws y = x.
    """
    values = [v for line in series for v in (*line.curve.y, *line.curve.low, *line.curve.high) if v is not None]
    low, high = y_range or (0.0, max(values, default=1.0) * 1.04)
    high = max(high, low + 1e-6)
    rows = math.ceil(len(series) / _columns([line.name for line in series]))
    height = 300 + 16 * rows
    figure, axes = blank(480, height, (46 / 480, (42 + 16 * rows) / height, 418 / 480, 246 / height))
    axes.axis("on")
    for side in axes.spines.values():
        side.set_visible(False)
    axes.grid(axis="y", color=colour_of("rule"), linewidth=1, clip_on=False)
    axes.locator_params(nbins=6, steps=[1, 2, 5, 10])
    axes.tick_params(length=0, pad=6, labelsize=12, labelcolor=colour_of("quiet"))
    axes.set_xlabel(x_label, color=colour_of("ink"), fontsize=12)
    axes.set_ylabel(y_label, color=colour_of("ink"), fontsize=12)
    xs = [x for line in series for x in line.curve.x]
    axes.set_xlim(min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1)
    axes.set_ylim(low, high)
    quiet = {"color": colour_of("quiet"), "linewidth": 1, "linestyle": (0, (2, 3)), "clip_on": False}
    if event and min(xs) < 0 < max(xs):
        axes.plot([0, 0], [low, high], **quiet)
        axes.annotate(event, (0, 1), (4, -11), xycoords=("data", "axes fraction"), textcoords="offset points",
                      color=colour_of("quiet"), fontsize=11)  # fmt: skip
    if diagonal:
        ends = max(axes.get_xlim()[0], low), min(axes.get_xlim()[1], high)
        axes.plot(ends, ends, **quiet)
    for index, line in enumerate(sorted(series, key=lambda line: line.strong)):
        x = np.array(line.curve.x, dtype=float)
        y, below, above = (np.clip(_floats(v), low, high) for v in (line.curve.y, line.curve.low, line.curve.high))
        axes.fill_between(x, below, above, where=np.isfinite(y + below + above), linewidth=0, alpha=0.13,
                          color=colour_of(f"c-{line.look}"), clip_on=False)  # fmt: skip
        count = np.count_nonzero(np.isfinite(y))
        every = 1 if count <= ALL_MARKED else math.ceil(count / 7)
        axes.plot(x, y, label=line.name, markevery=(index % every, every), markersize=7 if line.strong else 6,
                  linewidth=3.2 if line.strong else 1.7, **style_of(line.look))  # fmt: skip
    _legend(figure, axes, [line.name for line in series])
    return svg_of(figure, title, _in_words(series, x_label, y_label))


def legend(names: Sequence[str], strong: str, of: str) -> str:
    """The names of methods, each with a sample of its line, as a picture of its own; `of`: what it belongs to."""
    figure, axes = blank(480, 16 * math.ceil(len(names) / _columns(names)) + 2)
    for name in names:
        axes.plot([], [], label=name, linewidth=3.2 if name == strong else 1.7, **style_of(look_of(name)))
    _legend(figure, axes, names)
    return svg_of(figure, f"Legend of {of}", f"the methods {', '.join(names)}")


def svg_of(figure: Any, title: str, words: str, image: str = "") -> str:
    """A figure as SVG, with a title and a description for those who do not see it; `image`: what lies below it.

    Numbers of ids come from the title and the words, so that the same chart is the same text, and differ by chart.
    """
    import matplotlib.text

    for each in figure.findobj(matplotlib.text.Text):
        each.set_parse_math(False)  # a dollar in a name is a dollar
    settings: Any = {"svg.fonttype": "none", "svg.hashsalt": f"{title}{words}"}
    with matplotlib.rc_context(settings), io.StringIO() as buffer:
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
        drawn = buffer.getvalue()
    box = re.search(r'viewBox="([^"]*)"', drawn)
    body = re.search(r"<svg[^>]*>(.*)</svg>", drawn, re.DOTALL)
    assert box is not None
    assert body is not None
    inner = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body[1], flags=re.DOTALL)
    inner = re.sub(r' id="(?!m[0-9a-f]{10}")[^"]*"', "", inner.replace("xlink:href", "href"))
    inner = re.sub(r"font-family: [^;\"]*", "font-family: system-ui, sans-serif", inner)
    inner = re.sub(r"#fe00([0-9a-f]{2})", lambda found: f"var(--{_COLOURS[int(found[1], 16)]})", inner)
    inner = re.sub(r"\s*\n\s*", " ", inner)
    below = f'<image href="{image}" width="100%" height="100%" preserveAspectRatio="none"/>' if image else ""
    said = html.escape(f"{title}. {words}")
    return (
        f'<svg viewBox="{box[1]}" role="img" aria-label="{said}" stroke-linejoin="round"><title>{html.escape(title)}'
        f"</title>{below}{inner}</svg>"
    )


def _columns(names: Sequence[str]) -> int:
    """How many columns of a legend of 480 pixels these names fit into, at about 6.5 pixels a letter."""
    widest = 60 + 6.5 * max(map(len, names), default=0)
    return max(1, min(3, len(names), int(480 / widest)))


def _legend(figure: Any, axes: Any, names: Sequence[str]) -> None:
    """All lines that are named, in this order, at the foot of the figure."""
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(
        [handles[name] for name in names], names, loc="lower center", ncol=_columns(names), frameon=False,
        fontsize=12, labelcolor=colour_of("ink"), handlelength=3, borderpad=0, borderaxespad=0, columnspacing=1.5,
        labelspacing=0.3,
    )  # fmt: skip


def _floats(values: Sequence[float | None]) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in values], dtype=float)


def _in_words(series: Sequence[Series], x_label: str, y_label: str) -> str:
    """The lines' ends and peaks, for those who do not see them."""
    found = []
    for line in series:
        points = [(x, y) for x, y in zip(line.curve.x, line.curve.y, strict=True) if y is not None]
        if points:
            top = max(points, key=lambda point: point[1])
            found.append(
                f"{line.name}: {points[0][1]:.3g} at {points[0][0]:g}, {points[-1][1]:.3g} at {points[-1][0]:g}, "
                f"at most {top[1]:.3g} at {top[0]:g}"
            )
    return f"{y_label} against {x_label}. " + "; ".join(found)
