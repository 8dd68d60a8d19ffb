"""The pieces of a report's page, and the template that makes one HTML file of them: no script, no network.

The page follows the reader's light or dark colours, and reads on a phone: tables scroll in their own box, charts stack.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from eagor._extras import need
from eagor._version import __version__

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
NOTHING = "–"  # a figure without a case
SPARE = 8  # colours of series that are no methods: x0 to x7


@dataclass(frozen=True)
class Box:
    """A cell: its text, an interval in small print, a mark, and whether it is the best of its column."""

    text: str
    small: str = ""
    mark: str = ""
    best: bool = False


@dataclass(frozen=True)
class Row:
    """A row: its head, its cells, and its kind ("ours", "paper", or "")."""

    head: str
    boxes: tuple[Box, ...]
    kind: str = ""


@dataclass(frozen=True)
class Sheet:
    """A table: what it shows, the heads of its columns (the first is that of the row heads), rows and notes."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Text:
    """A paragraph; its kind is "note", "warn" or ""."""

    text: str
    kind: str = ""


@dataclass(frozen=True)
class Heading:
    """A heading below a section's own."""

    text: str


@dataclass(frozen=True)
class Facts:
    """Names and what they are."""

    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Items:
    """A list."""

    texts: Sequence[str]


@dataclass(frozen=True)
class Pictures:
    """Pictures (SVG, as `eagor.evaluation.charts` makes it) with captions; `kind`: "map", "strip" or ""."""

    pictures: Sequence[tuple[str, str]]
    kind: str = ""


@dataclass(frozen=True)
class Folded:
    """What is there for those who ask."""

    summary: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Link:
    """A line that leads to a file beside the page."""

    text: str
    file: str


Part = Sheet | Text | Heading | Facts | Items | Link | Pictures | Folded


@dataclass(frozen=True)
class Section:
    """A part of the page that the contents name."""

    id: str
    heading: str
    parts: Sequence[Part]


def number(value: float | None, digits: int = 1, sign: bool = False) -> str:
    """A figure as text; a dash where there is no case."""
    if value is None:
        return NOTHING
    value = round(value, digits) + 0.0  # no negative zero
    return f"{value:{'+' if value and sign else ''}.{digits}f}".replace("-", "−")


def span(ends: Sequence[float | None] | None, digits: int = 1, sign: bool = False) -> str:
    """An interval as text; "" where there is none."""
    return " to ".join(number(end, digits, sign) for end in ends) if ends and None not in ends else ""


def box(value: float | None, ends: Sequence[float | None] | None = None, digits: int = 1) -> Box:
    """A cell with a figure and its interval."""
    return Box(number(value, digits), span(ends, digits))


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows under their heads as lines for a terminal: the first column to the left, the others to the right."""
    wide = [max(len(row[k]) for row in rows if k < len(row)) for k in range(len(rows[0]))]
    cells = ([text.ljust(wide[k]) if k == 0 else text.rjust(wide[k]) for k, text in enumerate(row)] for row in rows)
    return ["  ".join(row).rstrip() for row in cells]


def lines_of(sheet: Sheet) -> list[str]:
    """A table as lines for a terminal, intervals in brackets."""
    cells = ([f"{box.text} ({box.small})" if box.small else box.text for box in row.boxes] for row in sheet.rows)
    return in_columns([sheet.heads, *([row.head, *texts] for row, texts in zip(sheet.rows, cells, strict=True))])


def could_not(summary: Mapping[str, Any]) -> list[Part]:
    """Which units of a run have no result, and why."""
    lines = [f"{f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
    return [Text("These are errors, not wrong answers: they are in no figure above."), Items(lines)]


def document(title: str, lead: Sequence[Part], sections: Sequence[Section]) -> str:
    """The whole page; all text is escaped."""
    return rendered("report.html", title=title, lead=lead, sections=sections, palette=_palette())


def rendered(template: str, **values: Any) -> str:
    """A template of this package, filled."""
    return _environment().get_template(template).render(version=__version__, **values)


@lru_cache(maxsize=1)
def _environment() -> Any:
    need("a report page", "sim", "jinja2")
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader("eagor.evaluation"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    found.globals["kind"] = lambda part: type(part).__name__
    return found


def _palette() -> dict[str, dict[str, str]]:
    """The colours of methods and spare series, by their names in the style sheet."""
    return {
        name: colours | {f"x{k}": colour for k, colour in enumerate(list(colours.values())[:SPARE])}
        for name, colours in (("light", LIGHT), ("dark", DARK))
    }
