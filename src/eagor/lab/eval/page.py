"""The parts of a report: tables, pictures, words. As a page that needs nothing else, as Markdown, for a terminal.

The page (``report.html``, a Jinja template) follows the reader's light or dark colours, and reads on a phone: tables
scroll in their own box, pictures stack. Words are escaped by the template.
"""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from eagor._extras import need
from eagor._version import __version__

NOTHING = "–"  # a figure without a case


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
    known = [end for end in ends or () if end is not None and not math.isnan(end)]
    return " to ".join(number(end, digits, sign) for end in known) if len(known) == 2 else ""


def cell(value: float | None, ends: Sequence[float | None] | None = None, digits: int = 1) -> Cell:
    """A cell with a figure and its interval."""
    return Cell(number(value, digits), span(ends, digits))


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows under their heads as lines for a terminal: the first column to the left, the others to the right."""
    wide = [max(len(row[k]) for row in rows if k < len(row)) for k in range(len(rows[0]))]
    cells = ([text.ljust(wide[k]) if k == 0 else text.rjust(wide[k]) for k, text in enumerate(row)] for row in rows)
    return ["  ".join(row).rstrip() for row in cells]


def address_of(picture: Any) -> str:
    """A picture (of PIL) as the data address of a PNG."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
