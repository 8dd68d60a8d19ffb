"""The parts of a report: tables, charts, words. As a page that needs nothing else, as Markdown, for a terminal.

The page (``report.html``, a Jinja template) follows the reader's light or dark colours, and reads on a phone: tables
scroll in their own box, pictures stack. Words are escaped by the templates. Charts are drawn by matplotlib; a method is
told apart by its colour, its dashes and the shape of its marks, so that colour alone is never needed.
"""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from eagor._extras import need
from eagor._version import __version__

NOTHING = "–"  # a figure without a case
# Of each method: its colour (at least 3:1 contrast on white), its dashes and its mark, as matplotlib names them. The
# first eight stay apart for the colour-blind (after Okabe and Ito); the others by their dashes and marks.
LOOKS: dict[str, tuple[str, Any, str]] = {
    "eagor": ("#005fa3", "-", "o"),
    "eagor_paper": ("#c44e00", (0, (7, 3)), "s"),
    "centroid": ("#a8467f", (0, (2, 3)), "^"),
    "cent_circ": ("#866400", (0, (9, 3, 2, 3)), "v"),
    "grid": ("#007a5a", (0, (5, 3)), "D"),
    "vmf": ("#2f3440", (0, (3, 2)), "x"),
    "grid_filter": ("#3d84c6", (0, (10, 4)), "+"),
    "particle_filter": ("#71767f", (0, (1, 3)), "h"),
    "oracle": ("#2f3440", "-", "d"),
    "plain": ("#a3333d", (0, (1, 2)), "D"),
    "best_detection": ("#7b4fb5", (0, (8, 2, 2, 2, 2, 2)), "*"),
    "last_detection": ("#0f7f8c", (0, (4, 1)), ">"),
}
INK, QUIET, RULE = "#1d222c", "#566070", "#dde1e8"
ALL_MARKED = 10  # points of a line that all have a mark; of more some


# --- parts ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """Its text, an interval in small print, a mark (a dagger, or a word), and whether it is the best of its column."""

    text: str
    small: str = ""
    mark: str = ""
    best: bool = False

    def in_line(self, small: bool = True) -> str:
        """With a dagger at the figure, and its interval in brackets."""
        mark = self.mark if len(self.mark) == 1 else ""
        return f"{self.text}{mark}{f' ({self.small})' if self.small and small else ''}"


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
        wide, narrow = (
            in_columns([self.heads, *([row.head, *(cell.in_line(small) for cell in row.cells)] for row in self.rows)])
            for small in (True, False)
        )
        return wide if max(map(len, wide)) <= width else narrow


@dataclass(frozen=True)
class Text:
    """A paragraph; its kind is "note", "warn", "h3" (a heading) or "". `link`: a file beside the page to lead to."""

    text: str
    kind: str = ""
    link: str = ""


@dataclass(frozen=True)
class Pictures:
    """Pictures (the data address of each, or HTML) with captions; `kind`: "map", "strip", "wide" or ""."""

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

    template, css = (files("eagor.lab.eval").joinpath(f"report.{kind}").read_text("utf-8") for kind in ("html", "css"))
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["kind"] = lambda part, kind: type(part).__name__ == kind
    values = {"title": title, "lead": lead, "sections": sections, "css": css, "version": __version__}
    return environment.from_string(template).render(values)


def markdown(title: str, facts: Sequence[tuple[str, str]], tables: Sequence[Table]) -> str:
    """All tables as one Markdown text."""
    lines = [f"# {_escaped(title)}", "", *(f"- {_escaped(name)}: {_escaped(value)}" for name, value in facts), ""]
    for table in tables:
        rows = [[*map(_escaped, table.heads)], ["---", *["---:"] * (len(table.heads) - 1)]]
        for row in table.rows:
            stars = {"paper": "*", "ours": "**"}.get(row.kind, "")
            rows.append([f"{stars}{_escaped(row.head)}{stars}", *map(_in_markdown, row.cells)])
        lines += [f"## {_escaped(table.title)}", "", *(f"| {' | '.join(row)} |" for row in rows), ""]
        lines += [f"{_escaped(note)}\n" for note in table.notes]
    return "\n".join(lines)


def _in_markdown(cell: Cell) -> str:
    """A dagger stands at the figure, a word at the end."""
    text = f"**{_escaped(cell.text)}**" if cell.best else _escaped(cell.text)
    small = f" ({_escaped(cell.small)})" if cell.small else ""
    return f"{text}{cell.mark}{small}" if len(cell.mark) == 1 else f"{text}{small} {cell.mark}".rstrip()


def _escaped(text: str) -> str:
    """`text` as Markdown shows it: no tag, no link, no code, no cell of a table and no line begins in it."""
    marked = re.sub(r"([\\`\[\]|])", r"\\\1", " ".join(text.split()))
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", marked)


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


# --- charts -----------------------------------------------------------------------------------------------------------


class Curve(NamedTuple):
    """A mean `y` at each `x` with its interval, each ``(m,)``, NaN where too few have a case; `n`: at most so many."""

    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray
    n: int


def style_of(name: str, index: int = 0, **more: Any) -> dict[str, Any]:
    """How matplotlib draws the line of a method; of others, that of the method at `index`."""
    colour, dashes, mark = LOOKS.get(name) or list(LOOKS.values())[index % len(LOOKS)]
    return {"color": colour, "linestyle": dashes, "marker": mark, "clip_on": False} | more


def line_chart(
    curves: dict[str, Curve],
    x_label: str,
    y_label: str,
    y_range: tuple[float, float] = (0.0, 1.0),
    diagonal: bool = False,
) -> str:
    """The lines of methods with their 95 % bands and a legend, the address of an SVG; `diagonal` draws y = x.

    Ours lies on top. Other names than those of methods get the looks of methods by their order.
    """
    figure, axes = blank(480, 300)
    axes.axis("on")
    axes.spines[:].set_visible(False)
    axes.grid(axis="y", color=RULE, linewidth=1, clip_on=False)
    axes.locator_params(nbins=6, steps=[1, 2, 5, 10])
    axes.tick_params(length=0, pad=6, labelsize=12, labelcolor=QUIET)
    axes.set_xlabel(x_label, color=INK, fontsize=12)
    axes.set_ylabel(y_label, color=INK, fontsize=12)
    xs = np.concatenate([curve.x for curve in curves.values()])
    axes.set_xlim(xs.min(), xs.max() if np.ptp(xs) else xs.min() + 1)
    axes.set_ylim(*y_range)
    if diagonal:
        ends = max(axes.get_xlim()[0], y_range[0]), min(axes.get_xlim()[1], y_range[1])
        axes.plot(ends, ends, color=QUIET, linewidth=1, linestyle=(0, (2, 3)), clip_on=False)
    for index, (name, curve) in enumerate(curves.items()):
        ours, style = name.partition(" ")[0] == "eagor", style_of(name, index)
        y, low, high = (np.clip(values, *y_range) for values in curve[1:4])
        axes.fill_between(curve.x, low, high, linewidth=0, alpha=0.13, color=style["color"], clip_on=False)
        count = np.count_nonzero(np.isfinite(y))
        every = 1 if count <= ALL_MARKED else math.ceil(count / 7)
        axes.plot(curve.x, y, label=name, markevery=(index % every, every), zorder=4 if ours else 3,
                  markersize=7 if ours else 6, linewidth=3.2 if ours else 1.7, **style)  # fmt: skip
    add_legend(figure, axes, list(curves))
    return drawn(figure, "svg")


def blank(width: float, height: float) -> tuple[Any, Any]:
    """A figure of this many pixels, and its axes, which fill it; nothing is drawn yet."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 72, height / 72), dpi=72)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    return figure, axes


def add_legend(figure: Any, axes: Any, names: Sequence[str], y: float = -0.19) -> None:
    """All lines that are named, in this order, below the axes."""
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    columns = max(1, min(3, len(names), int(480 / (60 + 6.5 * max(map(len, names), default=0)))))
    figure.legend(
        [handles[name] for name in names], names, loc="upper center", ncol=columns, frameon=False, fontsize=12,
        labelcolor=INK, handlelength=3, columnspacing=1.5, labelspacing=0.3, bbox_to_anchor=(0.5, y),
    )  # fmt: skip


def address_of(picture: Any) -> str:
    """A picture (of PIL) as the data address of a PNG."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return _address("png", buffer)


def drawn(figure: Any, kind: str) -> str:
    """A figure with all that lies around it, as the data address of an "svg" or a "png".

    The same figure is the same text.
    """
    import matplotlib.text

    for each in figure.findobj(matplotlib.text.Text):
        each.set_parse_math(False)  # a dollar in a name is a dollar
    settings: Any = {
        "svg.fonttype": "none",
        "svg.hashsalt": "eagor",
        "savefig.bbox": "tight",
        "savefig.pad_inches": 0.05,
    }
    buffer = io.BytesIO()
    with matplotlib.rc_context(settings):
        figure.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else {}, dpi=144)
    return _address({"svg": "svg+xml"}.get(kind, kind), buffer)


def _address(kind: str, content: io.BytesIO) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content.getvalue()).decode('ascii')}"
