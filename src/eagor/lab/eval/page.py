"""The parts of a report: tables, pictures, words. As a page that needs nothing else, as Markdown, for a terminal.

The page (``report.html``, a Jinja template) follows the reader's light or dark colours, and reads on a phone: tables
scroll in their own box, pictures stack. Words are escaped by the template.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

from eagor._extras import require_extra
from eagor._version import __version__

NOTHING = "–"  # a figure without a case


class Cell(NamedTuple):
    """Its text, an interval in small print, a mark (a dagger, or a word), and whether it is the best of its column."""

    text: str
    small: str = ""
    mark: str = ""
    best: bool = False


class Row(NamedTuple):
    """A row: its head, its cells, and its kind ("ours", "paper", "text" where the last cell is a text, or "")."""

    head: str
    cells: Sequence[Cell]
    kind: str = ""


class Table(NamedTuple):
    """A table: what it shows, the heads of its columns (the first is that of the row heads), rows and notes."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Row]
    notes: Sequence[str] = ()

    def lines(self, width: int = 0) -> list[str]:
        """For a terminal: with the intervals in brackets where that is at most `width` wide."""
        lines: list[str] = []
        for small in (True, False):
            rows = [list(self.heads)]
            for head, cells, _ in self.rows:
                texts = (each.text + each.mark * (len(each.mark) == 1) for each in cells)
                ends = (f" ({each.small})" * bool(small and each.small) for each in cells)
                rows.append([head, *map("".join, zip(texts, ends, strict=True))])
            wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
            sides = "<" + ">" * len(wide)
            lines = ["  ".join(map("{:{}{}}".format, row, sides, wide)).rstrip() for row in rows]
            if max(map(len, lines)) <= width:
                break
        return lines


class Text(NamedTuple):
    """A paragraph; its kind is "note", "warn" or "". `link`: a file beside the page to lead to."""

    text: str
    kind: str = ""
    link: str = ""


class Picture(NamedTuple):
    """A picture by its data address (`address_of`), and what it shows."""

    address: str
    words: str


class Section(NamedTuple):
    """A part of the page that the contents name by its `id`; within another one, what opens when asked for."""

    title: str
    parts: Sequence[Part]
    id: str = ""


# A list: its lines. A dict: names and what they are.
Part = Table | Text | Picture | list[str] | dict[str, str] | Section


def page(title: str, lead: Sequence[Part], sections: Sequence[Section]) -> str:
    """The whole page as HTML. Raises `MissingExtraError` without the extra ``report``."""
    css = files("eagor.lab.eval").joinpath("report.css").read_text("utf-8")
    return _filled("report.html", title=title, lead=lead, sections=sections, css=css, version=__version__)


def markdown(title: str, facts: Sequence[Mapping[str, str]], tables: Sequence[Table]) -> str:
    """All tables as one Markdown text. Raises as `page`."""
    return _filled("report.md", title=title, facts=facts, tables=tables)


def _filled(name: str, **values: Any) -> str:
    """The template with the values in it."""
    require_extra("a report", "report", "jinja2")
    import jinja2

    environment = jinja2.Environment(autoescape=name == "report.html", trim_blocks=True, lstrip_blocks=True)
    environment.tests["kind"] = lambda part, kind: type(part).__name__ == kind
    environment.filters["words"] = _in_markdown
    return environment.from_string(files("eagor.lab.eval").joinpath(name).read_text("utf-8")).render(values)


def _in_markdown(text: str) -> str:
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
    return "" if not ends or None in ends else " to ".join(number(end, digits, sign) for end in ends)


def cell(value: float | None, ends: Sequence[float | None] | None = None, digits: int = 1) -> Cell:
    """A cell with a figure and its interval."""
    return Cell(number(value, digits), span(ends, digits))


def address_of(picture: Any) -> str:
    """A picture (of PIL) as the data address of a PNG."""
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
