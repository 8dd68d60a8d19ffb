"""The report of a run, or of several: report.html (one file that needs nothing else), tables.md and tables.csv.

Every number in them comes from the runs' records or from `eagor.evaluation.published`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor.errors import EagorError
from eagor.evaluation import export, page, studies


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
    runs = [studies.read(folder) for folder in named]
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
