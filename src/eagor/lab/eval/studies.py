"""The studies there are, simulated tasks and benchmarks; a run as its folder tells it; reports and comparisons of runs.

A report is report.html (one file that needs nothing else), tables.md and tables.csv. Every number in them comes from
the runs' records or from `eagor.lab.eval.tables`. A comparison is of two runs, or of two methods of one run, on the
cases that both have: paired differences, with intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eagor import plugins
from eagor._files import written
from eagor.errors import EagorError
from eagor.lab.eval import log, page, tables
from eagor.lab.eval.benchmarks import KIND, Published
from eagor.lab.eval.page import in_columns, span
from eagor.lab.eval.samples import FEW, Measured, Record, case_of, gap, lowest_p, played_by, sample
from eagor.lab.eval.simulated import Simulated
from eagor.lab.eval.study import LoadedRun, Study, markdown, words
from eagor.lab.eval.tables import OURS, headed, shown
from eagor.lab.tasks import benchmark, task
from eagor.statistics import mcnemar

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
    settings = log.description(folder)
    study = Published.of(settings, folder) if settings.get("kind") == KIND else None
    records = log.recorded(folder)
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
    pictures (`eagor.lab.envs.places.load_place` where it is None). `episode`: the name of a page beside it on which an
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
        lead.append(page.link("Watch the worst episode, step by step", episode))
    written(path, page.document(told.title, lead, told.sections))
    written(place / "tables.md", markdown(told.title, told.facts, told.sheets))
    for name, text in told.files.items():
        written(place / name, text)
    return path


# --- two runs, or two methods of one run, on the cases that both have -------------------------------------------------

SAME = "scene_hash", "query", "targets", "stratum"  # of an episode: whether two runs have played the same one


def compare(a: LoadedRun, b: LoadedRun, methods: Sequence[str] = ()) -> dict[str, Any]:
    """Figure by figure, a minus b, over the cases that both have a result of, ready for JSON.

    With an interval that resamples whole groups (apartments, clusters), p by sign flips of groups, and McNemar's exact
    test where every value is an outcome. `methods` of a simulated task: of both runs, or of a and of b; by default
    ours. Raises `EagorError` if the runs are of different studies, data or worlds, or share no case.
    """
    study = a.study
    alike = ((key, a.settings.get(key), b.settings.get(key)) for key in study.alike)
    for key, x, y in (("task", study.name, b.study.name), *alike):
        if x != y:
            raise EagorError(f"the runs differ in {key}: {x} and {y}; compare like with like")
    named = _methods(a, b, methods)
    left, right = (
        {case_of(record): record for record in played_by(run.records, method)}
        for run, method in zip((a, b), named, strict=True)
    )
    shared = sorted(left.keys() & right.keys())
    if not shared:
        raise EagorError(
            f"the runs share no {study.case} that both have a result of; run the same part of the data with both"
        )
    for case in shared if a.methods else ():
        _check_same(case, left[case]["episode"], right[case]["episode"])
    pairs = [[part[case] for case in shared] for part in (left, right)]
    found = {column.key: _difference(column, pairs, named) for column in study.columns}
    return {
        "task": study.name,
        **({"methods": list(named)} if a.methods else {}),
        "cases": len(shared),
        "only_in_a": len(left.keys() - right.keys()),
        "only_in_b": len(right.keys() - left.keys()),
        "settings": {
            key: [a.settings.get(key), b.settings.get(key)]
            for key in dict.fromkeys([*a.settings, *b.settings])
            if key != "samples" and a.settings.get(key) != b.settings.get(key)
        },
        "figures": {key: figure for key, figure in found.items() if figure is not None},
    }


def comparison_in_words(found: Mapping[str, Any], a: LoadedRun) -> list[str]:
    """A comparison for a terminal; `a`: one of its runs."""
    lines = [
        f"{found['task']}: {found['cases']} {a.study.case}s that both have "
        f"(a only: {found['only_in_a']}, b only: {found['only_in_b']})"
    ]
    if "methods" in found:
        lines.append("  method: a {}, b {}".format(*found["methods"]))
    lines += [f"  {key}: a {words(x)}, b {words(y)}" for key, (x, y) in found["settings"].items()]
    outcomes = any("mcnemar" in figure for figure in found["figures"].values())
    rows = [["", "a", "b", "a - b", "95 % interval", "p", *(("only a", "only b", "McNemar p") if outcomes else ())]]
    for column in a.study.columns:
        if (figure := found["figures"].get(column.key)) is None:
            continue
        told = "low" in figure
        ends = (figure["low"], figure["high"]) if told else None
        rows.append(
            [
                f"{headed(column)} ({figure['n']})",
                shown(figure["a"], column),
                shown(figure["b"], column),
                shown(figure["difference"], column, True),
                span(ends, column.digits, True) or "-",
                f"{figure['p']:.2g}" if told else "-",
            ]
        )
        if outcomes:
            test = figure.get("mcnemar", {})
            p = f"{test['p']:.2g}" if test else "-"
            rows[-1] += [str(test.get("only_a", "-")), str(test.get("only_b", "-")), p]
    lines += in_columns(rows)
    what = "apartments" if a.methods else "clusters"
    note = f"; McNemar takes {a.study.case}s as independent" if outcomes else ""
    lines.append(f"p: sign flips of whole {what}, each figure for itself{note}.")
    groups = max((figure.get("clusters", 1) for figure in found["figures"].values()), default=1)
    if groups == 1:
        only = f"Only one {what[:-1]}"
        lines.append(f"{only}: nothing can be said about how far the differences carry over to others.")
    elif groups < FEW:
        few = f"Only {groups} {what}: intervals that resample so few are too narrow"
        lines.append(f"{few}, and p cannot be below {lowest_p(groups):.2g}.")
    return lines


def _methods(a: LoadedRun, b: LoadedRun, named: Sequence[str]) -> tuple[str | None, str | None]:
    """Which method of a is compared with which of b."""
    if not a.methods:
        if named:
            raise EagorError(f"a run of {a.study.name} has one agent; leave out the methods {', '.join(named)}")
        return None, None
    if len(named) > 2:
        raise EagorError(f"the methods {', '.join(named)}; wanted one, or two to be compared with each other")
    both = [name for name in a.methods if name in b.methods]
    if not named and OURS not in both and len(both) != 1:
        raise EagorError(f"the runs have no {OURS} in common; name one or two of their methods with --methods")
    first, second = (*named, *named)[:2] if named else (OURS if OURS in both else both[0],) * 2
    for label, name, run in (("a", first, a), ("b", second, b)):
        if name not in run.methods:
            raise EagorError(f"run {label} has no method {name!r}; it has {', '.join(run.methods)}")
    return first, second


def _check_same(case: str, left: Mapping[str, Any], right: Mapping[str, Any]) -> None:
    for key in SAME:
        if (x := left.get(key)) != (y := right.get(key)):
            raise EagorError(f"{case} is another episode in each run: its {key} is {x} and {y}; compare like with like")


def _difference(
    column: Measured, pairs: Sequence[Sequence[Record]], methods: tuple[str | None, str | None]
) -> dict[str, Any] | None:
    """One figure, from the records of both, case by case; None without a case."""
    x, y = (sample(records, method, column) for records, method in zip(pairs, methods, strict=True))
    both = [case for case in x.values if case in y.values]
    if not both:
        return None
    x, y = x.only(both), y.only(both)
    found: dict[str, Any] = {"title": column.title, "n": len(both), "a": x.mean, "b": y.mean}
    found["difference"] = found["a"] - found["b"]
    if (measured := gap(x, y)) is not None:
        found |= {"low": measured.low, "high": measured.high, "p": measured.p, "clusters": measured.groups}
    shares = np.array([[*x.values.values()], [*y.values.values()]]) / column.scale
    if column.share and bool(np.isin(shares, (0.0, 1.0)).all()):
        test = mcnemar(*shares)
        found["mcnemar"] = {"only_a": test.only_a, "only_b": test.only_b, "p": test.p}
    return found
