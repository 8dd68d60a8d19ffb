"""The parts of a report: tables, charts, words. As a page that needs nothing else, as Markdown, for a terminal.

The page (``report.html``, a Jinja template) follows the reader's light or dark colours, and reads on a phone: tables
scroll in their own box, charts stack. Words are escaped by the template; only the SVG of this module is not.

Charts are drawn by matplotlib. A method is told apart by its colour, its dashes and the shape of its marks, so that
colour alone is never needed. Colours are variables of the page's style sheet: matplotlib is given a stand-in for each,
which `svg_of` replaces.
"""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from eagor._extras import need
from eagor._version import __version__

NOTHING = "–"  # a figure without a case
RING = "ring"
# Of each method: its colour on a light and on a dark page, its dashes and its mark, as matplotlib names them. All
# colours have at least 3:1 contrast on their ground. The first eight stay apart for the colour-blind (after Okabe and
# Ito); the others are told apart by their dashes and marks.
LOOKS: dict[str, tuple[str, str, Any, str]] = {
    "eagor": ("#005fa3", "#5cb8f5", "-", "o"),
    "eagor_paper": ("#c44e00", "#ff8f45", (0, (7, 3)), "s"),
    "centroid": ("#a8467f", "#e79bca", (0, (2, 3)), "^"),
    "cent_circ": ("#866400", "#e8d44d", (0, (9, 3, 2, 3)), "v"),
    "grid": ("#007a5a", "#34cfa3", (0, (5, 3)), "D"),
    "vmf": ("#2f3440", "#e9ebf0", (0, (3, 2)), "x"),
    "grid_filter": ("#3d84c6", "#9fb6ff", (0, (10, 4)), "+"),
    "particle_filter": ("#71767f", "#a4a9b3", (0, (1, 3)), RING),
    "oracle": ("#2f3440", "#e9ebf0", "-", RING),
    "plain": ("#a3333d", "#f28b92", (0, (1, 2)), "D"),
    "best_detection": ("#7b4fb5", "#c0a6ff", (0, (8, 2, 2, 2, 2, 2)), "*"),
    "last_detection": ("#0f7f8c", "#6fd3dd", (0, (4, 1)), ">"),
}
_COLOURS = ("ink", "quiet", "paper", "rule", "target", *(f"c-{name}" for name in LOOKS))
ALL_MARKED = 10  # points of a line that all have a mark; of more some


# --- parts ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """Its text, an interval in small print, a mark (a dagger, or a word), and whether it is the best of its column."""

    text: str
    small: str = ""
    mark: str = ""
    best: bool = False


@dataclass(frozen=True)
class Row:
    """A row: its head, its cells, and its kind ("ours", "paper", "text" where the last cell is a text, or "")."""

    head: str
    cells: tuple[Cell, ...]
    kind: str = ""


@dataclass(frozen=True)
class Table:
    """A table: what it shows, the heads of its columns (the first is that of the row heads), rows and notes."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    def lines(self, width: int = 0) -> list[str]:
        """For a terminal: with the intervals in brackets where that is at most `width` wide."""
        for small in (True, False):
            rows = [[row.head, *(_in_line(cell, small) for cell in row.cells)] for row in self.rows]
            lines = in_columns([self.heads, *rows])
            if max(map(len, lines)) <= width:
                break
        return lines

    def markdown(self) -> str:
        """Nothing of a name is taken for markup."""
        lines = [f"## {_escaped(self.title)}", "", _piped(map(_escaped, self.heads))]
        lines.append("|---|" + "---:|" * (len(self.heads) - 1))
        for row in self.rows:
            stars = {"paper": "*", "ours": "**"}.get(row.kind, "")
            lines.append(_piped([f"{stars}{_escaped(row.head)}{stars}", *map(_in_markdown, row.cells)]))
        return "\n".join([*lines, "", *(f"{_escaped(note)}\n" for note in self.notes)])


@dataclass(frozen=True)
class Text:
    """A paragraph; its kind is "note", "warn", "h3" (a heading) or "". `link`: a file beside the page to lead to."""

    text: str
    kind: str = ""
    link: str = ""


@dataclass(frozen=True)
class Pictures:
    """Pictures (SVG, or the data address of a picture) with captions; `kind`: "map", "strip", "wide" or ""."""

    items: Sequence[tuple[str, str]]
    kind: str = ""


@dataclass(frozen=True)
class Facts:
    """Names and what they are."""

    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class List:
    """Lines."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Fold:
    """What is there for those who ask."""

    title: str
    parts: Sequence[Part]


Part = Table | Text | Pictures | Facts | List | Fold


@dataclass(frozen=True)
class Section:
    """A part of the page that the contents name."""

    id: str
    title: str
    parts: Sequence[Part]


def page(title: str, lead: Sequence[Part], sections: Sequence[Section]) -> str:
    """The whole page as HTML. Raises `MissingExtraError` without the extra ``report``."""
    need("a report", "report", "jinja2")
    import jinja2

    folder = files("eagor.lab.eval")
    template, style = (folder.joinpath(f"report.{kind}").read_text(encoding="utf-8") for kind in ("html", "css"))
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["kind"] = lambda part, name: type(part).__name__ == name
    return environment.from_string(template).render(
        title=title, lead=lead, sections=sections, css=style, light=_palette(0), dark=_palette(1), version=__version__
    )


def markdown(title: str, facts: Sequence[tuple[str, str]], tables: Sequence[Table]) -> str:
    """All tables as one Markdown text."""
    lines = [f"# {_escaped(title)}", "", *(f"- {_escaped(name)}: {_escaped(value)}" for name, value in facts), ""]
    return "\n".join([*lines, *(table.markdown() for table in tables)])


def address_of(picture: Any) -> str:
    """A picture (of PIL) as the data address of a PNG."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def number(value: float | None, digits: int = 1, sign: bool = False) -> str:
    """A figure as text; a dash where there is no case."""
    if value is None:
        return NOTHING
    value = round(value, digits) + 0.0  # no negative zero
    return f"{value:{'+' if value and sign else ''}.{digits}f}".replace("-", "−")


def span(ends: Sequence[float | None] | None, digits: int = 1, sign: bool = False) -> str:
    """An interval as text; "" where there is none."""
    return " to ".join(number(end, digits, sign) for end in ends) if ends and None not in ends else ""


def cell(value: float | None, ends: Sequence[float | None] | None = None, digits: int = 1) -> Cell:
    """A cell with a figure and its interval."""
    return Cell(number(value, digits), span(ends, digits))


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows under their heads as lines for a terminal: the first column to the left, the others to the right."""
    wide = [max(len(row[k]) for row in rows if k < len(row)) for k in range(len(rows[0]))]
    cells = ([text.ljust(wide[k]) if k == 0 else text.rjust(wide[k]) for k, text in enumerate(row)] for row in rows)
    return ["  ".join(row).rstrip() for row in cells]


def _in_line(cell: Cell, small: bool) -> str:
    return f"{cell.text}{cell.mark if len(cell.mark) == 1 else ''}{f' ({cell.small})' if cell.small and small else ''}"


def _in_markdown(cell: Cell) -> str:
    """A dagger stands at the figure, a word at the end."""
    text = f"**{_escaped(cell.text)}**" if cell.best else _escaped(cell.text)
    small = f" ({_escaped(cell.small)})" if cell.small else ""
    return f"{text}{cell.mark}{small}" if len(cell.mark) == 1 else f"{text}{small} {cell.mark}".rstrip()


def _escaped(text: str) -> str:
    """`text` as Markdown shows it: no tag, no link, no code, no cell of a table and no line begins in it."""
    marked = re.sub(r"([\\`\[\]|])", r"\\\1", " ".join(text.split()))
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", marked)


def _piped(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _palette(dark: int) -> str:
    """The colours of the looks, by their names in the style sheet."""
    return "".join(f"--c-{name}:{look[dark]};" for name, look in LOOKS.items())


# --- charts -----------------------------------------------------------------------------------------------------------


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


def look_of(name: str, index: int = 0) -> str:
    """The looks of a method; others are shown as the method at `index`."""
    return name if name in LOOKS else list(LOOKS)[index % len(LOOKS)]


def style_of(look: str, **more: Any) -> dict[str, Any]:
    """How matplotlib draws a line of these looks, and its marks."""
    *_, dashes, mark = LOOKS[look]
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
    y_range: tuple[float, float] = (0.0, 1.0),
    diagonal: bool = False,
) -> str:
    """Lines with their 95 % bands and a legend, as SVG; the strong ones lie on top. `diagonal` draws y = x."""
    low, high = y_range
    names = [line.name for line in series]
    height = 300 + _legend_height(names)
    figure, axes = blank(480, height, (46 / 480, (height - 258) / height, 418 / 480, 246 / height))
    axes.axis("on")
    axes.spines[:].set_visible(False)
    axes.grid(axis="y", color=colour_of("rule"), linewidth=1, clip_on=False)
    axes.locator_params(nbins=6, steps=[1, 2, 5, 10])
    axes.tick_params(length=0, pad=6, labelsize=12, labelcolor=colour_of("quiet"))
    axes.set_xlabel(x_label, color=colour_of("ink"), fontsize=12)
    axes.set_ylabel(y_label, color=colour_of("ink"), fontsize=12)
    xs = [x for line in series for x in line.curve.x]
    axes.set_xlim(min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1)
    axes.set_ylim(low, high)
    if diagonal:
        ends = max(axes.get_xlim()[0], low), min(axes.get_xlim()[1], high)
        axes.plot(ends, ends, color=colour_of("quiet"), linewidth=1, linestyle=(0, (2, 3)), clip_on=False)
    for index, line in enumerate(sorted(series, key=lambda line: line.strong)):
        curve = (
            np.array(values, dtype=float) for values in (line.curve.y, line.curve.low, line.curve.high)
        )  # None: NaN
        x, (y, below, above) = np.array(line.curve.x, dtype=float), (np.clip(values, low, high) for values in curve)
        axes.fill_between(x, below, above, where=np.isfinite(y + below + above), linewidth=0, alpha=0.13,
                          color=colour_of(f"c-{line.look}"), clip_on=False)  # fmt: skip
        count = np.count_nonzero(np.isfinite(y))
        every = 1 if count <= ALL_MARKED else math.ceil(count / 7)
        axes.plot(x, y, label=line.name, markevery=(index % every, every), markersize=7 if line.strong else 6,
                  linewidth=3.2 if line.strong else 1.7, **style_of(line.look))  # fmt: skip
    _legend(figure, axes, names)
    return svg_of(figure, title, _in_words(series, x_label, y_label))


def legend(names: Sequence[str], strong: str, of: str) -> str:
    """The names of methods, each with a sample of its line, as a picture of its own; `of`: what it belongs to."""
    figure, axes = blank(480, _legend_height(names) + 2)
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


def _legend_height(names: Sequence[str]) -> int:
    return 16 * math.ceil(len(names) / _columns(names))


def _legend(figure: Any, axes: Any, names: Sequence[str]) -> None:
    """All lines that are named, in this order, at the foot of the figure."""
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(
        [handles[name] for name in names], names, loc="lower center", ncol=_columns(names), frameon=False,
        fontsize=12, labelcolor=colour_of("ink"), handlelength=3, borderpad=0, borderaxespad=0, columnspacing=1.5,
        labelspacing=0.3,
    )  # fmt: skip


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
