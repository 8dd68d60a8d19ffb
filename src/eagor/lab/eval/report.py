"""The report of one run, or of several runs of one task with published data; two runs compared.

Every number in them comes from the runs' records or from what the papers printed (`eagor.lab.eval.tables`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eagor._files import write_atomic
from eagor.errors import EagorError
from eagor.lab.envs.rules import Camera
from eagor.lab.eval import episodes, results, tables
from eagor.lab.eval.page import Cell, Part, Picture, Row, Section, Table, Text, address_of, markdown, page, span
from eagor.lab.eval.predictions import answers_of
from eagor.lab.eval.results import OURS, Run, Summary, difference, mean, values_of
from eagor.lab.tasks.task import config_of, finished, sample_of

PAPERS = "eagor_paper"  # the method as published
SAME = "scene_hash", "query", "targets", "stratum"  # of an episode: whether two runs have played the same one
LISTED = 200  # failed cases in a report
SAID = {"task", "episodes", "seed", "development", "samples"}  # settings that a report has in its own words


def write_report(folders: Path | Sequence[Path], out: Path | None = None, episode: str | None = None) -> Path:
    """Write the report of the runs in `folders`, all of one task, into `out` (None: the first folder).

    Returns the path of its page. `episode`: the name of a page beside it on which an episode can be watched
    (`eagor.studio.runs`), to link to. Raises `EagorError` where there are no records, or of several tasks;
    `FormatError` for a folder that is no run's; `StorageError`; `MissingExtraError`.
    """
    named = [Path(folders)] if isinstance(folders, str | Path) else [Path(folder) for folder in folders]
    runs = [results.read(folder) for folder in named]
    if len(names := {run.task.name for run in runs}) > 1:
        raise EagorError(f"the runs are of {', '.join(sorted(names))}; one report is about one task")
    if len(runs) > 1 and runs[0].simulated:
        raise EagorError("a run of a simulated task is reported alone; name one folder")
    task, summary = runs[0].task, results.summarise(runs)
    facts = [_facts(run, label, len(runs)) for run, label in zip(runs, results.labels_of(runs), strict=True)]
    sections = _simulated(runs[0], summary) if runs[0].simulated else _published(runs, summary)
    if summary["episodes"]:
        columns = {
            f"{m.title}{f' ({m.unit})' if m.unit else ''}": "; ".join(filter(None, (m.what, m.why)))
            for m in task.metrics
        }
        parts = [tables.main_table(task, summary), Section("What the columns are", [columns])]
        sections.insert(0, Section("Figures", parts, "figures"))
    if summary["failed"]:
        lines = [f"{f['key']} (attempt {f['attempt']}): {f['error']}" for f in summary["failures"]]
        errors = Text("These are errors, not wrong answers: they are in no figure above.")
        sections.append(Section("What could not be run", [errors, lines], "failed"))
    counts = " and ".join(dict.fromkeys(_of(len(finished(run.records)), run.planned) for run in runs))
    title = f"{task.title}: {counts} cases" + f", {len(runs)} runs" * (len(runs) > 1)
    if runs[0].simulated:
        title = f"{task.title}: {summary['episodes']} episodes, {len(summary['methods'])} methods"
    lead = [*_lead(runs, summary), Section("What was run", facts)]
    if episode is not None:
        lead.append(Text("Watch the worst episode, step by step", link=episode))
    place = Path(out or named[0])
    shown = [part for section in sections for part in section.parts if isinstance(part, Table)]
    write_atomic(place / "report.html", page(title, lead, [section for section in sections if section.parts]))
    write_atomic(place / "tables.md", markdown(title, facts, shown))
    if len(runs) == 1 and not runs[0].simulated:
        answers = answers_of(runs[0].records).items()
        lines = (json.dumps({"case": case, **answer}, ensure_ascii=False) + "\n" for case, answer in answers)
        write_atomic(place / "predictions.jsonl", "".join(lines))
    return place / "report.html"


def _of(there: int, planned: int | None) -> str:
    """How many there are, and of how many, where that is a part."""
    return str(there) if planned is None or there >= planned else f"{there} of {planned}"


def _facts(run: Run, label: str, count: int) -> dict[str, str]:
    """What was run, from run.json and the records."""
    good, failed = finished(run.records), len(run.records) - len(finished(run.records))
    facts = {"Run": label} if count > 1 else {}
    facts["Task"] = run.task.title
    if run.simulated:
        if run.unit == "apartment":
            facts["Apartments"] = _seeds(run)
        facts["Scenes played"] = str(len({record["episode"].get("scene") for record in good}))
    elif run.settings.get("seed") is not None:
        facts["Seed"] = str(run.settings["seed"])
    for key, value in run.settings.items():
        if key not in SAID and (text := tables.words(value)) not in ("", "none"):
            facts[key.capitalize()] = text
    facts["Records"] = f"{_of(len(good), run.planned)} with results, {failed} could not be run"
    facts |= _perception(good)
    hours = sum(float(record.get("seconds") or 0.0) for record in run.records) / 3600
    facts["Computing time"] = f"{hours:.2f} process hours" if hours >= 0.1 else f"{60 * hours:.1f} minutes"
    how = (
        f"shares of success after Korn and Graubard, else {results.RESAMPLES} resamples; a mean is over what has a case"
    )
    return facts | {"Intervals": f"{100 * results.LEVEL:.0f} %, of whole groups; {how}"}


def _seeds(run: Run) -> str:
    seeds = sorted({r["episode"]["seed"] for r in finished(run.records) if r["episode"].get("seed") is not None})
    kinds = {True: "development seeds, not results", False: "not development seeds"}
    kind = kinds.get(run.settings.get("development", ""), "run.json does not say whether they are development seeds")
    spread = f"{seeds[0]} to {seeds[-1]} ({len(seeds)} of them)" if len(seeds) > 1 else "".join(map(str, seeds))
    return f"seeds {spread}; {kind}" if seeds else "none"


def _perception(records: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Which model looked, how long a look took, and how many answers could not be read, where the records say so."""
    parts = (part for record in records for part in (record, *record.get("methods", {}).values()))
    if not (accounts := [part["looked"] for part in parts if part.get("looked")]):
        return {}
    looks, unread = (sum(account[key] for account in accounts) for key in ("looks", "unread"))
    times = [account["milliseconds"] for account in accounts if account["milliseconds"] is not None]
    sources = (account["source"] for account in accounts if account["source"])
    models = sorted({f"{s.get('model')} ({s.get('revision') or 'revision unknown'})" for s in sources})
    cost = f"; {sum(times) / len(times):.0f} ms each on average" if times else ""
    about = f"{looks}, of which {unread} with an answer that could not be read{cost}"
    return {"Model": ", ".join(models) or "unknown", "Looks": about}


def _lead(runs: Sequence[Run], summary: Summary) -> list[Part]:
    """The outcome in a sentence, and warnings."""
    task = runs[0].task
    key = getattr(task, "headline", task.metrics[0].key)
    metric = next(metric for metric in task.metrics if metric.key == key)
    figures = {
        name: row[key] for name, row in summary["methods"].items() if results.is_rival(name) and row[key] is not None
    }
    outcomes = []
    if runs[0].simulated:  # ours, the published method, the best other one
        names = sorted(figures, key=lambda name: figures[name] * (1 if metric.better == "low" else -1))
        best = [name for name in names if name not in (OURS, PAPERS)][:1]
        figures = {name: figures[name] for name in (OURS, PAPERS, *best) if name in figures}
    for name in figures:
        ends = summary["intervals"][name][key]
        span = f" ({tables.shown(ends[0], metric)} to {tables.shown(ends[1], metric)})" if ends else ""
        outcomes.append(f"{name}: {tables.shown(figures[name], metric)} {metric.unit}{span}")
    text = f"{metric.title}, {metric.what}: {'; '.join(outcomes)}." if outcomes else "There are no results."
    lead: list[Part] = [Text(text)]
    if runs[0].settings.get("development"):
        warning = "These are development seeds: parameters were chosen on them. The figures are no results."
        lead.append(Text(warning, "warn"))
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


def _simulated(run: Run, summary: Summary) -> list[Section]:
    task, found = run.task, run.results()
    parts = tables.parts_table(found)
    return [
        Section("What the errors are made of", [parts] if parts.rows else [], "parts"),
        Section("Error by step", _by_step(run), "steps"),
        Section("By kind of episode", tables.strata_tables(task, summary), "strata"),
        Section("Variants", tables.variant_tables(task, summary), "variants"),
    ]


def _by_step(run: Run) -> list[Part]:
    """Errors against time, ours first."""
    rows = sorted(run.results().items(), key=lambda row: row[0] != OURS)
    curves = {name: curve for name, found in rows if results.is_rival(name) and (curve := episodes.by_step(found))}
    if not curves:
        return []
    from eagor.drawing import draw_errors

    seconds = run.settings.get("camera", {}).get("seconds", Camera().seconds)
    times = [step * seconds for step in range(max(map(len, curves.values())))]
    caption = (
        "Mean error at each step. A line ends where fewer than half of its episodes go on: where every method goes its "
        "own way, those that arrive early leave it, so the right end of a line is about the harder episodes."
    )
    return [Picture(address_of(draw_errors(times, curves)), caption)]


def _published(runs: Sequence[Run], summary: Summary) -> list[Section]:
    both = {"turns": tables.turn_table(summary), "views": tables.views_table(summary)}
    sections = [Section(table.title, [table], name) for name, table in both.items() if table.rows]
    for number, (run, (name, part)) in enumerate(zip(runs, summary["answers"].items(), strict=True)):
        about = f": {name}" if len(runs) > 1 else ""
        found = tables.failure_tables(run.task, part)
        parts: list[Part] = [table._replace(title=f"{table.title}{about}") for table in found]
        if parts and (lines := tables.failed_lines(run)[:LISTED]):
            parts.append(Section(f"The cases that failed ({len(lines)} shown)", [lines]))
        sections.append(Section(f"Failures: {name}", parts, f"failures-{number}"))
    return sections


# --- two runs, or two methods of one run, on the samples that both have -----------------------------------------------


def compare(a: Run, b: Run, methods: Sequence[str] = ()) -> dict[str, Any]:
    """Metric by metric, a minus b, over the samples that both have a result of, ready for JSON.

    With an interval that resamples whole groups, and p by sign flips of groups. `methods` of simulated tasks: of both
    runs, or of a and of b; by default ours. Raises `EagorError` if the runs are of different tasks, data or worlds, or
    share no sample.
    """
    for key in ("task", "data", "world"):
        if (x := a.settings.get(key)) != (y := b.settings.get(key)):
            raise EagorError(f"the runs differ in {key}: {x} and {y}; compare like with like")
    names = _methods(a, b, methods)
    left, right = (
        {sample_of(result.record): result for result in run.results().get(name, ())}
        for run, name in zip((a, b), names, strict=True)
    )
    shared = sorted(left.keys() & right.keys())
    if not shared:
        raise EagorError("the runs share no sample that both have a result of; run the same part of the data with both")
    for name in shared if a.simulated else ():
        for key in SAME:
            x, y = (side[name].record["episode"].get(key) for side in (left, right))
            if x != y:
                raise EagorError(f"{name} is another episode in each run: its {key} is {x} and {y}")
    figures = {}
    for metric in a.task.metrics:
        x, y = (values_of([side[name] for name in shared], metric) for side in (left, right))
        x, y = {name: x[name] for name in x if name in y}, {name: y[name] for name in x if name in y}
        if x:
            figure = {"title": metric.title, "n": len(x), "a": mean(x), "b": mean(y), "difference": mean(x) - mean(y)}
            figures[metric.key] = figure | (difference(x, y) or {})
    return {
        "task": a.task.name,
        **({"methods": list(names)} if a.simulated else {}),
        "cases": len(shared),
        "only_in_a": len(left.keys() - right.keys()),
        "only_in_b": len(right.keys() - left.keys()),
        "settings": {
            key: [a.settings.get(key), b.settings.get(key)]
            for key in dict.fromkeys([*a.settings, *b.settings])
            if key != "samples" and a.settings.get(key) != b.settings.get(key)
        },
        "figures": figures,
    }


def _methods(a: Run, b: Run, names: Sequence[str]) -> tuple[str, str]:
    """Which method of a is compared with which of b."""
    there = [list(run.results()) for run in (a, b)]
    if not a.simulated:
        if names:
            raise EagorError(f"a run of {a.task.name} has one agent; leave out the methods {', '.join(names)}")
        return there[0][0], there[1][0]
    both = [name for name in there[0] if name in there[1]]
    chosen = names or ([OURS] if OURS in both else both)
    if len(names) > 2:
        raise EagorError(f"the methods {', '.join(names)}; wanted one, or two to be compared with each other")
    if not names and len(chosen) != 1:
        raise EagorError(f"the runs have no {OURS} in common; name one or two of their methods with --methods")
    for label, name, known in zip("ab", (chosen[0], chosen[-1]), there, strict=True):
        if name not in known:
            raise EagorError(f"run {label} has no method {name!r}; it has {', '.join(known)}")
    return chosen[0], chosen[-1]


def comparison_in_words(found: Mapping[str, Any], run: Run) -> list[str]:
    """What `compare` found, for a terminal; `run`: one of the two."""
    case, unit, rows = getattr(run.task, "case", "case"), run.unit, []
    lines = [
        f"{found['task']}: {found['cases']} {case}s that both have "
        f"(a only: {found['only_in_a']}, b only: {found['only_in_b']})"
    ]
    if "methods" in found:
        lines.append("  method: a {}, b {}".format(*found["methods"]))
    lines += [f"  {key}: a {tables.words(x)}, b {tables.words(y)}" for key, (x, y) in found["settings"].items()]
    for metric in run.task.metrics:
        if (figure := found["figures"].get(metric.key)) is not None:
            sides = (tables.shown(figure[side], metric, side == "difference") for side in ("a", "b", "difference"))
            ends = span((figure.get("low"), figure.get("high")), metric.digits, True) or "-"
            p = f"{figure['p']:.2g}" if "p" in figure else "-"
            rows.append(Row(f"{tables.column_header(metric)} ({figure['n']})", [*map(Cell, (*sides, ends, p))]))
    lines += Table("", ("", "a", "b", "a - b", "95 % interval", "p"), rows).lines()
    groups = max((figure.get("groups", 1) for figure in found["figures"].values()), default=1)
    lines += [f"p: sign flips of whole {unit}s, each figure for itself.", *tables.small_cluster_warning(groups, unit)]
    return lines + ([f"p cannot be below {2.0 ** (1 - groups):.2g}."] if 1 < groups < tables.FEW else [])
