"""The report of one run, or of several runs of one task with published data: report.html and tables.md.

Every number in them comes from the runs' records or from what the papers printed (`eagor.lab.eval.tables`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from eagor._files import written
from eagor.errors import EagorError
from eagor.lab.envs.places import APARTMENT
from eagor.lab.envs.rules import Camera
from eagor.lab.eval import episodes, tables
from eagor.lab.eval.page import (
    Facts,
    Fold,
    List,
    Part,
    Pictures,
    Section,
    Table,
    Text,
    address_of,
    markdown,
    page,
)
from eagor.lab.eval.predictions import predictions_of
from eagor.lab.eval.results import (
    FEW,
    LEVEL,
    OURS,
    PAPERS,
    RESAMPLES,
    Result,
    Run,
    Summary,
    is_rival,
    labels_of,
    rank,
    read,
    summarise,
)
from eagor.lab.tasks.task import config_of, finished, sample_of

LISTED = 200  # failed cases in a report


def write_report(folders: Path | Sequence[Path], out: Path | None = None, episode: str | None = None) -> Path:
    """Write the report of the runs in `folders`, all of one task, into `out` (None: the first folder).

    Returns the path of its page. `episode`: the name of a page beside it on which an episode can be watched
    (`eagor.studio.runs`), to link to. Raises `EagorError` where there are no records, or of several tasks;
    `FormatError` for a folder that is no run's; `StorageError`; `MissingExtraError`.
    """
    named = [Path(folders)] if isinstance(folders, str | Path) else [Path(folder) for folder in folders]
    if not named:
        raise EagorError("no run is named; wanted the folder of one or several")
    runs = [read(folder) for folder in named]
    if len(names := {run.task.name for run in runs}) > 1:
        raise EagorError(f"the runs are of {', '.join(sorted(names))}; one report is about one task")
    if len(runs) > 1 and runs[0].simulated:
        raise EagorError("a run of a simulated task is reported alone; name one folder")
    task, summary = runs[0].task, summarise(runs)
    facts = [fact for run, label in zip(runs, labels_of(runs), strict=True) for fact in _facts(run, label, len(runs))]
    sections = _simulated(runs[0], summary) if runs[0].simulated else _published(runs, summary)
    if summary["episodes"]:
        columns = [
            (f"{m.title}{f' ({m.unit})' if m.unit else ''}", "; ".join(filter(None, (m.what, m.why))))
            for m in task.metrics
        ]
        figures = [tables.main_table(task, summary), Fold("What the columns are", [Facts(columns)])]
        sections.insert(0, Section("figures", "Figures", figures))
    if summary["failed"]:
        lines = [f"{f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
        errors = Text("These are errors, not wrong answers: they are in no figure above.")
        sections.append(Section("failed", "What could not be run", [errors, List(lines)]))
    title = f"{task.title}: {_counts(runs, summary)}"
    lead = [*_lead(runs, summary), Fold("What was run", [Facts(facts)])]
    if episode is not None:
        lead.append(Text("Watch the worst episode, step by step", link=episode))
    place = Path(out or named[0])
    shown = [part for section in sections for part in section.parts if isinstance(part, Table)]
    written(place / "report.html", page(title, lead, [section for section in sections if section.parts]))
    written(place / "tables.md", markdown(title, facts, shown))
    if len(runs) == 1 and not runs[0].simulated:
        written(place / "predictions.jsonl", predictions_of(runs[0].records))
    return place / "report.html"


# --- what was run, and the outcome in a sentence ----------------------------------------------------------------------


def _counts(runs: Sequence[Run], summary: Summary) -> str:
    if runs[0].simulated:
        return f"{summary['episodes']} episodes, {len(summary['methods'])} methods"
    counts = dict.fromkeys(_of(len(finished(run.records)), run.planned) for run in runs)
    return f"{' and '.join(counts)} cases" + (f", {len(runs)} runs" if len(runs) > 1 else "")


def _of(there: int, planned: int | None) -> str:
    """How many there are, and of how many, where that is a part."""
    return str(there) if planned is None or there >= planned else f"{there} of {planned}"


def _facts(run: Run, label: str, count: int) -> list[tuple[str, str]]:
    """What was run, from run.json and the records."""
    good, failed = finished(run.records), len(run.records) - len(finished(run.records))
    facts = [("Run", label)] if count > 1 else []
    facts.append(("Task", run.task.title))
    skipped = {"task", "episodes", "seed", "development", "samples"}
    if run.simulated:
        facts += [("Apartments", _seeds(run))] if run.settings.get("world", APARTMENT) == APARTMENT else []
        facts.append(("Scenes played", str(len({record["episode"].get("scene") for record in good}))))
    elif run.settings.get("seed") is not None:
        facts.append(("Seed", str(run.settings["seed"])))
    settings = [(key.capitalize(), tables.words(value)) for key, value in run.settings.items() if key not in skipped]
    facts += [(name, value) for name, value in settings if value not in ("", "none")]
    facts.append(("Records", f"{_of(len(good), run.planned)} with results, {failed} could not be run"))
    facts += _perception(good)
    hours = sum(float(record.get("seconds") or 0.0) for record in run.records) / 3600
    facts.append(("Computing time", f"{hours:.2f} process hours" if hours >= 0.1 else f"{60 * hours:.1f} minutes"))
    how = f"shares of success after Korn and Graubard, else {RESAMPLES} resamples; a mean is over what has a case"
    return [*facts, ("Intervals", f"{100 * LEVEL:.0f} %, of whole groups; {how}")]


def _seeds(run: Run) -> str:
    seeds = sorted({r["episode"]["seed"] for r in finished(run.records) if r["episode"].get("seed") is not None})
    if not seeds:
        return "none"
    kinds = {True: "development seeds, not results", False: "not development seeds"}
    kind = kinds.get(run.settings.get("development", ""), "run.json does not say whether they are development seeds")
    spread = f"{seeds[0]} to {seeds[-1]} ({len(seeds)} of them)" if len(seeds) > 1 else str(seeds[0])
    return f"seeds {spread}; {kind}"


def _perception(records: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Which model looked, how long a look took, and how many answers could not be read, where the records say so."""
    accounts = [r["looked"] for r in records if r.get("looked")]
    accounts += [m["looked"] for r in records for m in r.get("methods", {}).values() if m.get("looked")]
    if not accounts:
        return []
    looks, unread = (sum(account[key] for account in accounts) for key in ("looks", "unread"))
    times = [account["milliseconds"] for account in accounts if account["milliseconds"] is not None]
    sources = [source for account in accounts if (source := account["source"])]
    models = sorted({f"{s.get('model')} ({s.get('revision') or 'revision unknown'})" for s in sources})
    cost = f"; {sum(times) / len(times):.0f} ms each on average" if times else ""
    return [
        ("Model", ", ".join(models) or "unknown"),
        ("Looks", f"{looks}, of which {unread} with an answer that could not be read{cost}"),
    ]


def _lead(runs: Sequence[Run], summary: Summary) -> list[Part]:
    """The outcome in a sentence, and warnings."""
    task = runs[0].task
    key = getattr(task, "headline", task.metrics[0].key)
    metric = next(metric for metric in task.metrics if metric.key == key)
    figures = {name: row[key] for name, row in summary["methods"].items() if is_rival(name) and row[key] is not None}
    names = list(figures)
    if runs[0].simulated:  # ours, the published method, the best other one
        others = [name for name in figures if name not in (OURS, PAPERS)]
        others.sort(key=lambda name: figures[name] * (1 if metric.better == "low" else -1))
        names = [name for name in (OURS, PAPERS, *others[:1]) if name in figures]
    outcomes = []
    for name in names:
        ends = summary["intervals"][name][key]
        span = f" ({tables.shown(ends[0], metric)} to {tables.shown(ends[1], metric)})" if ends else ""
        outcomes.append(f"{name}: {tables.shown(figures[name], metric)} {metric.unit}{span}")
    text = f"{metric.title}, {metric.what}: {'; '.join(outcomes)}." if outcomes else "There are no results."
    lead: list[Part] = [Text(text)]
    if runs[0].settings.get("development"):
        warning = "These are development seeds: parameters were chosen on them. The figures are no results."
        lead.append(Text(warning, "warn"))
    if summary["groups"] < FEW and not runs[0].simulated:
        lead.append(Text(f"There are only {summary['groups']} groups of cases.", "note"))
    if criterion := criterion_of(runs[0]):
        lead.append(Text(f"{criterion[0].upper()}{criterion[1:]}.", "note"))
    if summary["failed"]:
        lead.append(Text(f"{summary['failed']} units could not be run and are in no figure.", "warn"))
    return lead


def criterion_of(run: Run) -> str:
    """What success means in a run; "" where its task has no such thing, or its rules are not known."""
    try:
        return str(getattr(config_of(run.task, run.settings).rules, "success_criterion", "")) if run.simulated else ""
    except (EagorError, AttributeError):  # of another version
        return ""


# --- the sections of a simulated task ---------------------------------------------------------------------------------


def _simulated(run: Run, summary: Summary) -> list[Section]:
    task, results = run.task, run.results()
    rivals = {name: found for name, found in results.items() if is_rival(name)}
    ordering, parts = tables.ordering_table(task, results), tables.parts_table(results)
    return [
        Section("ordering", "How far the paper's ordering carries over", [ordering] if ordering.rows else []),
        Section("parts", "What the errors are made of", [parts] if parts.rows else []),
        Section("steps", "Error by step", _by_step(run, rivals)),
        Section("strata", "By kind of episode", tables.strata_tables(task, summary)),
        Section("variants", "Variants", tables.variant_tables(task, summary)),
        Section("episodes", "Three episodes", _three(run)),
    ]


def _three(run: Run) -> list[Part]:
    """The best, the median and the worst episode of our default method."""
    ranked = [result.record for result in rank(run, OURS)]
    if not ranked:
        return [Text(f"There is no episode with a result of {OURS}.")]
    lines = [
        f"The {kind}: {sample_of(record)}, {record['episode']['query']}. {tables.figures_of(record, run.task)}"
        for kind, record in (("best", ranked[0]), ("median", ranked[len(ranked) // 2]), ("worst", ranked[-1]))
    ]
    how = "To watch one, step by step: eagor studio export RUN --episode NAME --out page.html"
    return [List(lines), Text(how, "note")]


def _by_step(run: Run, rivals: Mapping[str, Sequence[Result]]) -> list[Part]:
    """Errors against time."""
    curves = {name: curve for name, found in rivals.items() if (curve := episodes.by_step(found))}
    if not curves:
        return []
    from eagor.drawing import draw_errors

    seconds = run.settings.get("camera", {}).get("seconds", Camera().seconds)
    times = [step * seconds for step in range(max(map(len, curves.values())))]
    ours_first = {name: curves[name] for name in sorted(curves, key=lambda name: name != OURS)}
    caption = (
        "Mean error at each step. A line ends where fewer than half of its episodes go on: where every method goes its "
        "own way, those that arrive early leave it, so the right end of a line is about the harder episodes."
    )
    return [Pictures([(address_of(draw_errors(times, ours_first)), caption)], "wide")]


# --- the sections of answers to published data ------------------------------------------------------------------------


def _published(runs: Sequence[Run], summary: Summary) -> list[Section]:
    task, sections = runs[0].task, []
    for name, table in (("turns", tables.turn_table(summary)), ("views", tables.views_table(summary))):
        sections += [Section(name, table.title, [table])] if table.rows else []
    for number, (run, (name, part)) in enumerate(zip(runs, summary["answers"].items(), strict=True)):
        found = tables.failure_tables(task, part)
        if len(runs) > 1:
            found = [replace(table, title=f"{table.title}: {name}") for table in found]
        layers: list[Part] = [*found]
        if layers and (lines := tables.failed_lines(run)[:LISTED]):
            layers.append(Fold(f"The cases that failed ({len(lines)} shown)", [List(lines)]))
        sections.append(Section(f"failures-{number}", f"Failures: {name}", layers))
    return sections
