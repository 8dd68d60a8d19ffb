"""A run of a benchmark with published data: its settings, its units of work, and its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eagor.errors import EagorError, FormatError
from eagor.evaluation import ledger
from eagor.evaluation.shapes import checked, published
from eagor.evaluation.workers import Unit
from eagor.tasks.benchmark import Benchmark, Case, Record, known, load, read_options

KIND = "benchmark"  # in run.json: which kind of run this is


@dataclass(frozen=True)
class BenchmarkRun:
    """What is run. `options` are the benchmark's own; None in them is "as it is by default".

    `limit`: only the first so many cases; `shard`: (i, n), every n-th case from the i-th on, counted from 1. Neither
    changes what a case is called, so any parts of a run fit into one folder.
    """

    task: str
    data: Path
    agent: str | None = None
    perception: str | None = None
    model: str | None = None
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    calibrated: Mapping[str, Any] | None = None
    limit: int | None = None
    shard: tuple[int, int] = (1, 1)

    @property
    def benchmark(self) -> Benchmark:
        """The benchmark of the task."""
        return load(self.task)

    def settings(self) -> dict[str, Any]:
        """Everything that decides the results, as the JSON of run.json. Raises `EagorError` for what does not fit."""
        benchmark = self.benchmark
        if self.seed < 0:
            raise EagorError(f"seed {self.seed}; wanted a whole number from 0 on")
        told: dict[str, Any] = {
            "task": self.task,
            "data": str(Path(self.data).resolve()),
            "agent": self.agent or next(iter(benchmark.agents)),
            "perception": self.perception,
            "model": self.model,
            "seed": self.seed,
            **read_options(benchmark, self.options),
        }
        if self.calibrated:
            told["calibrated"] = dict(self.calibrated)
        return {"kind": KIND, **benchmark.settle(told)}

    def cases(self, settings: Mapping[str, Any]) -> list[Case]:
        """The cases of this part of the run. Raises `EagorError` for an impossible limit or shard."""
        part, parts = self.shard
        if not (1 <= part <= parts):
            raise EagorError(f"shard {part}/{parts}; wanted i/n with 1 <= i <= n, such as 1/4")
        if self.limit is not None and self.limit < 1:
            raise EagorError(f"a limit of {self.limit} cases; wanted 1 or more")
        found = self.benchmark.cases(Path(self.data), settings)[: self.limit]
        return found[part - 1 :: parts]


def units(settings: Mapping[str, Any], cases: list[Case]) -> list[Unit]:
    """One unit of work per case."""
    return [Unit(f"{settings['task']}/{case.id}", case.group, case.payload) for case in cases]


def is_benchmark(folder: Path) -> bool:
    """Whether the run in `folder` is one of a benchmark with published data. Raises `FormatError` if it is no run."""
    return ledger.description(folder).get("kind") == KIND


def read_run(folder: Path) -> tuple[dict[str, Any], Sequence[Record]]:
    """The settings and the records of a benchmark's run.

    Raises `EagorError` if it is none, or has no records; `FormatError`, which names it, for a malformed record.
    """
    settings = ledger.description(folder)
    if settings.get("kind") != KIND:
        raise EagorError(f"{folder} holds a run of {settings.get('task')}, which is no benchmark with published data")
    for key in ("task", "data"):
        if not isinstance(settings.get(key), str):
            raise FormatError(f"{Path(folder) / ledger.RUN} does not name its {key}; restore it")
    more = getattr(load(settings["task"]), "record", {}) if settings["task"] in known() else {}
    records = checked(ledger.read(folder), published(more))
    if not records:
        raise EagorError(f"{folder} has no records yet; run something into it first")
    return settings, records
