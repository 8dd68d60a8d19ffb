"""Tables and the other parts of a report: as a page that needs nothing else, as Markdown, as lines for a terminal.

The page (``report.html``, a Jinja template) follows the reader's light or dark colours, and reads on a phone: tables
scroll in their own box, charts stack. Words are escaped by the template; only SVG of `eagor.lab.eval.charts` is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files

from eagor._extras import need
from eagor._version import __version__
from eagor.lab.eval.charts import DARK, LIGHT, palette

NOTHING = "–"  # a figure without a case


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
        lines = [
            f"## {_escaped(self.title)}",
            "",
            _piped(map(_escaped, self.heads)),
            "|---|" + "---:|" * (len(self.heads) - 1),
        ]
        for row in self.rows:
            stars = {"paper": "*", "ours": "**"}.get(row.kind, "")
            lines.append(_piped([f"{stars}{_escaped(row.head)}{stars}", *map(_in_markdown, row.cells)]))
        return "\n".join([*lines, "", *(f"{_escaped(note)}\n" for note in self.notes)])


@dataclass(frozen=True)
class Text:
    """A paragraph; its kind is "note", "warn", "h3" (a heading) or ""."""

    text: str
    kind: str = ""


@dataclass(frozen=True)
class Link:
    """A line that leads to a file beside the page."""

    text: str
    file: str


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


Part = Table | Text | Link | Pictures | Facts | List | Fold


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
        title=title, lead=lead, sections=sections, css=style, light=palette(LIGHT), dark=palette(DARK),
        version=__version__,
    )  # fmt: skip


def markdown(title: str, facts: Sequence[tuple[str, str]], tables: Sequence[Table]) -> str:
    """All tables as one Markdown text."""
    lines = [f"# {_escaped(title)}", "", *(f"- {_escaped(name)}: {_escaped(value)}" for name, value in facts), ""]
    return "\n".join([*lines, *(table.markdown() for table in tables)])


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
