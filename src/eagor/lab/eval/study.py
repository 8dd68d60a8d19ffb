"""A study: what is played unit by unit, counted, and shown; simulated tasks and published benchmarks are both one.

`eagor.lab.eval.studies.load` finds one by its name. Whoever runs, reports or lists goes by this Protocol alone: the
log, the workers, the page and the files are the same for all.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from eagor._tables import as_csv
from eagor.lab.eval.page import Box, Part, Section, Sheet
from eagor.lab.eval.runner import Unit
from eagor.lab.eval.samples import Measured, Record
from eagor.lab.eval.tables import compared_with
from eagor.lab.tasks.task import load

Settings = Mapping[str, Any]
Summary = dict[str, Any]


@dataclass(frozen=True)
class LoadedRun:
    """A run as it was read from its folder: its study, ``run.json``, the records, and what they come to."""

    study: Study
    settings: Settings
    records: Sequence[Record]
    summary: Summary

    @property
    def methods(self) -> list[str]:
        """Which methods have results; none of a benchmark's run, which has one agent."""
        return list(self.summary.get("methods", ()))


@dataclass(frozen=True)
class Worst:
    """The cases of a run that went worst, worst first: a line and a JSON object each.

    `sheets`: tables of why cases failed; `said`: what else JSON has.
    """

    lines: Sequence[str]
    cases: Sequence[dict[str, Any]]
    sheets: Sequence[Sheet]
    said: dict[str, Any]


@dataclass(frozen=True)
class Report:
    """What a report says: its page, and the tables of it that stand in ``tables.md``.

    `facts`: what was run; `files`: the text of further files, by name.
    """

    title: str
    lead: Sequence[Part]
    sections: Sequence[Section]
    facts: Sequence[tuple[str, str]]
    sheets: Sequence[Sheet]
    files: Mapping[str, str] = field(default_factory=dict)


class Planned(Protocol):
    """A run that may be played: what decides its results, and its units of work."""

    def config(self) -> dict[str, Any]:
        """The JSON of run.json. Raises `EagorError` for what does not exist or does not fit."""
        ...

    def units(self, config: Settings) -> list[Unit]:
        """What there is to play. Raises `EagorError` for a part that cannot be."""
        ...


class Study(Protocol):
    """What is played, counted and shown.

    `work`: ``"package.module:function"``; ``function(settings)`` returns what plays one unit's payload and returns its
    record. `case`: what a unit's result is called ("episode", "case"). `several`: whether one report may be about
    several runs. `columns`: the figures of its table; `alike`: the settings in which runs must agree to be compared.
    """

    name: str
    work: str
    case: str
    several: bool
    columns: Sequence[Measured]
    alike: Sequence[str]

    def offer(self) -> dict[str, Any]:
        """What ``eagor bench list --json`` says of it."""
        ...

    def loaded(self, settings: Settings, records: Sequence[Record]) -> LoadedRun:
        """The run that these are of. Raises `FormatError`, which names it, for a malformed record."""
        ...

    def as_text(self, summary: Summary) -> list[str]:
        """The table for a terminal."""
        ...

    def as_json(self, summary: Summary) -> dict[str, Any]:
        """What ``eagor bench run --json`` says."""
        ...

    def planned(self, settings: Settings) -> int | None:
        """How many records the whole run has; None where that cannot be told, as the data are not there."""
        ...

    def report(self, runs: Sequence[LoadedRun], open_place: Any = None) -> Report:
        """The report of one or several runs; `open_place` makes a world again, for pictures."""
        ...

    def worst(self, run: LoadedRun, method: str | None) -> Worst:
        """The worst cases of a run; of a simulated one, those of `method` (None: ours, else the first)."""
        ...


# --- tables as text ---------------------------------------------------------------------------------------------------

FIELDS = (
    "task", "stratum", "method", "column", "unit", "value", "low", "high", "n",
    "reference", "difference", "difference_low", "difference_high", "p", "p_holm",
)  # fmt: skip


def markdown(title: str, facts: Sequence[tuple[str, str]], sheets: Sequence[Sheet]) -> str:
    """All tables as one Markdown text, in which nothing of a name is taken for markup."""
    lines = [f"# {_plain(title)}", "", *(f"- {_plain(name)}: {_plain(value)}" for name, value in facts), ""]
    for sheet in sheets:
        lines += [
            f"## {_plain(sheet.title)}",
            "",
            _line(map(_plain, sheet.heads)),
            "|---|" + "---:|" * (len(sheet.heads) - 1),
        ]
        for row in sheet.rows:
            stars = {"paper": "*", "ours": "**"}.get(row.kind, "")
            lines.append(_line([f"{stars}{_plain(row.head)}{stars}", *map(_cell, row.boxes)]))
        lines += ["", *(f"{_plain(note)}\n" for note in sheet.notes)]
    return "\n".join(lines)


def words(value: Any) -> str:
    """A setting as text."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {words(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(f"({words(item)})" if isinstance(item, list) else words(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def table_csv(summary: dict[str, Any]) -> str:
    """One row per stratum ("" for all episodes), method and column, at full precision; empty where there is no case."""
    rows: list[list[Any]] = []
    parts, columns = {"": summary}, load(summary["task"]).columns
    for title, labels in summary["strata"].items():
        parts |= {f"{title}: {label}": part for label, part in labels.items()}
    for stratum, part in parts.items():
        for method, values in part["methods"].items():
            for column in columns:
                key = column.key
                ends = part["intervals"][method][key] or (None, None)
                row = [
                    summary["task"], stratum, method, key, column.unit, values[key], *ends, part["counts"][method][key],
                ]  # fmt: skip
                if found := part.get("differences", {}).get(method, {}).get(key):
                    row += [compared_with(method, summary["reference"])]
                    row += [found[name] for name in ("difference", "low", "high", "p", "p_holm")]
                rows.append(row + [None] * (len(FIELDS) - len(row)))
    return as_csv([FIELDS, *rows])


def _plain(text: str) -> str:
    """`text` as Markdown shows it: no tag, no link, no code, no cell of a table and no line begins in it."""
    marked = re.sub(r"([\\`\[\]|])", r"\\\1", " ".join(text.split()))
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", marked)


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(box: Box) -> str:
    text = f"**{_plain(box.text)}**" if box.best else _plain(box.text)
    interval = f" ({_plain(box.small)})" if box.small else ""
    # A dagger stands at the figure, a word at the end.
    return f"{text}{box.mark}{interval}" if len(box.mark) == 1 else f"{text}{interval} {box.mark}".rstrip()
