"""A study: what is played unit by unit, counted, and shown; simulated tasks and published benchmarks are both one.

`eagor.evaluation.studies.load` finds one by its name. Whoever runs, reports or lists goes by this Protocol alone: the
ledger, the workers, the page and the files are the same for all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from eagor.evaluation.page import Part, Section, Sheet
from eagor.evaluation.samples import Measured, Record
from eagor.evaluation.workers import Unit

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
    several runs. `columns`: the figures of its table; `alike`: the settings in which runs must agree to be compared;
    `exports`: what a run can be written as, and a line about each.
    """

    @property
    def name(self) -> str: ...
    @property
    def work(self) -> str: ...
    @property
    def case(self) -> str: ...
    @property
    def several(self) -> bool: ...
    @property
    def columns(self) -> Sequence[Measured]: ...
    @property
    def alike(self) -> Sequence[str]: ...
    @property
    def exports(self) -> Mapping[str, str]: ...

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

    def export(self, to: str, run: LoadedRun, folder: Path) -> list[Path]:
        """Write what `exports` names `to` into `folder`; returns the files. `run` may have no records."""
        ...
