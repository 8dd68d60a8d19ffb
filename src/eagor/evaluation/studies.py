"""The studies that there are, simulated tasks and benchmarks; a run as its folder tells it; the report of runs.

A report is report.html (one file that needs nothing else), tables.md and tables.csv. Every number in them comes from
the runs' records or from `eagor.evaluation.tables`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eagor import plugins
from eagor._files import written
from eagor.errors import EagorError
from eagor.evaluation import export, ledger, page, tables
from eagor.evaluation.benchmarks import KIND, Published
from eagor.evaluation.simulated import Simulated
from eagor.evaluation.study import LoadedRun, Study
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


def read(folder: Path) -> LoadedRun:
    """The run in `folder`. Raises `FormatError` if it is none, `EagorError` if it has no records; as `Study.loaded`."""
    settings = ledger.description(folder)
    study = Published.of(settings, folder) if settings.get("kind") == KIND else None
    records = ledger.recorded(folder)
    if study is None:  # the records name their task, or else run.json does
        records = [{"task": settings.get("task"), **record} for record in records]
        study = Simulated(tables.task_of(records))
    return study.loaded(settings, records)


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


def write_report(
    folders: Path | Sequence[Path], open_place: Any = None, out: Path | None = None, episode: str | None = None
) -> Path:
    """Write the report of the runs in `folders`, all of one study, into `out` (None: the first folder).

    Returns the path of its page. `open_place` makes a world again from its name, its seed and the body's radius, for
    pictures (`eagor.tasks.places.load_place` where it is None). `episode`: the name of a page beside it on which an
    episode can be watched (`eagor.studio.runs`), to link to. Raises `EagorError` where there are no records, or of
    several studies; `FormatError` for a folder that is no run's; `StorageError`.
    """
    named = [Path(folders)] if isinstance(folders, str | Path) else [Path(folder) for folder in folders]
    if not named:
        raise EagorError("no run is named; wanted the folder of one or several")
    runs = [read(folder) for folder in named]
    if len(names := {run.study.name for run in runs}) > 1:
        raise EagorError(f"the runs are of {', '.join(sorted(names))}; one report is about one benchmark")
    study = runs[0].study
    if len(named) > 1 and not study.several:
        raise EagorError("a run of a simulated task is reported alone; name one folder")
    told = study.report(runs, open_place)
    place = Path(out or named[0])
    path = place / "report.html"
    lead = list(told.lead)
    if episode is not None:
        lead.append(page.Link("Watch the worst episode, step by step", episode))
    written(path, page.document(told.title, lead, told.sections))
    written(place / "tables.md", export.markdown(told.title, told.facts, told.sheets))
    for name, text in told.files.items():
        written(place / name, text)
    return path
