"""The studies that there are: simulated tasks (`eagor.tasks.task`) and benchmarks (`eagor.tasks.benchmark`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eagor import plugins
from eagor.errors import EagorError
from eagor.evaluation import ledger, tables
from eagor.evaluation.benchmarks import KIND, Published
from eagor.evaluation.simulated import Simulated
from eagor.evaluation.study import Study, Told
from eagor.tasks import benchmark, task

SIMULATED, PUBLISHED = "simulated", "published data"


def known() -> dict[str, str]:
    """The studies' kinds by name, simulated ones first; nothing is imported yet."""
    return dict.fromkeys(task.known(), SIMULATED) | dict.fromkeys(sorted(benchmark.known()), PUBLISHED)


def load(name: str) -> Study:
    """The study of this name. Raises `EagorError` for an unknown one, or one that cannot be imported."""
    if name in task.known():
        return Simulated(task.load(name))
    if name in benchmark.known():
        return Published(benchmark.load(name))
    raise EagorError(f"there is no task {name!r}; known are {', '.join(known())}")


def read(folder: Path) -> Told:
    """The run in `folder`. Raises `FormatError` if it is none, `EagorError` if it has no records; as `Study.told`."""
    settings = ledger.description(folder)
    study = Published.of(settings, folder) if settings.get("kind") == KIND else None
    records = ledger.recorded(folder)
    if study is None:  # the records name their task, or else run.json does
        records = [{"task": settings.get("task"), **record} for record in records]
        study = Simulated(tables.task_of(records))
    return study.told(settings, records)


def offers() -> dict[str, dict[str, Any]]:
    """What each says of itself, by name; of one that cannot be imported, why ("unavailable")."""
    parts = ((task.GROUP, task.BUILT_IN), (benchmark.GROUP, benchmark.BUILT_IN))
    broken = unimportable(*parts)
    found: dict[str, dict[str, Any]] = {}
    for name, kind in known().items():
        try:
            told = {"unavailable": broken[name]} if name in broken else load(name).offer()
        except Exception as error:  # a broken plugin may raise anything
            told = {"unavailable": str(error) if isinstance(error, EagorError) else repr(error)}
        found[name] = {"kind": kind, **told}
    return found


def unimportable(*groups: tuple[str, dict[str, str]]) -> dict[str, str]:
    """What other packages bring to these entry-point groups and cannot be imported, by name, and why."""
    theirs = [point for group, built_in in groups for point in plugins.brought(group, built_in)]
    return {point.name: f"cannot be imported ({why})" for point, why in plugins.faults(theirs).items()}
