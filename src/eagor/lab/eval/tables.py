"""The tables of a report, the same for the page, for Markdown and for the terminal.

``published.toml`` has what the papers printed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from eagor.lab.eval import episodes
from eagor.lab.eval.page import NOTHING, Cell, Row, Table, cell, in_columns, number, span
from eagor.lab.eval.results import (
    FEW,
    OURS,
    PAPERS,
    RIVALS,
    SIGNIFICANT,
    Result,
    Run,
    Summary,
    difference,
    is_rival,
    is_variant,
    lowest_p,
    small_cluster_warning,
    values_of,
)
from eagor.lab.tasks.task import Metric, Task, finished
from eagor.statistics import PairedDifference

_PRINTED = tomllib.loads(files("eagor.lab.eval").joinpath("published.toml").read_text(encoding="utf-8"))
PUBLISHED: dict[str, dict[str, dict[str, float]]] = {
    task: {name: dict(zip(rows["columns"], row, strict=False)) for name, row in rows.items() if name != "columns"}
    for task, rows in _PRINTED["figures"].items()
}
PUBLISHED_TAGS: dict[str, dict[str, tuple[float, float]]] = _PRINTED["failure_tags"]

DAGGER = {"-": "†", "+": "‡", "": ""}
WIDTH = 120  # of a terminal
SMALL_PRINT = "Small print: 95 % intervals of whole {}s; n: how many episodes have such a case, where not all have."


# --- cells ------------------------------------------------------------------------------------------------------------


def mark(summary: Summary, name: str, metric: Metric) -> str:
    """Whether a method differs from its reference beyond chance: "-" it is worse, "+" it is better, "" neither."""
    found = summary["differences"].get(name, {}).get(metric.key)
    if found is None or found["p_holm"] >= SIGNIFICANT or found["difference"] == 0:
        return ""
    return "-" if (found["difference"] > 0) == (metric.better == "low") else "+"


def best(summary: Summary, metric: Metric, names: Sequence[str]) -> set[str]:
    """Those of `names` with the best figure of a metric, as it is shown; nobody where neither side is better."""
    there = {name: summary["methods"][name][metric.key] for name in names}
    figures = {name: round(value, metric.digits) for name, value in there.items() if value is not None}
    if metric.better is None or len(names) < 2 or not figures:
        return set()
    winner = (min if metric.better == "low" else max)(figures.values())
    return {name for name, value in figures.items() if value == winner}


def shown(value: float | None, metric: Metric, sign: bool = False) -> str:
    """A figure as text; a dash where there is no case."""
    return number(value, metric.digits, sign or metric.key == "delta")


def column_header(metric: Metric) -> str:
    """The title of a metric, an arrow to its better side, its unit."""
    arrow = {"low": " ↓", "high": " ↑", None: ""}[metric.better]
    return f"{metric.title}{arrow}{f', {metric.unit}' if metric.unit else ''}"


def shown_metrics(task: Task, summary: Summary) -> list[Metric]:
    """The metrics in which some method has a case."""
    rows = summary["methods"].values()
    return [metric for metric in task.metrics if any(row[metric.key] is not None for row in rows)]


def row(name: str, cells: Sequence[Cell]) -> Row:
    """The row of a method; ours is shown as such."""
    return Row(name, tuple(cells), "ours" if name.partition(" ")[0] == OURS else "")


def figure_rows(summary: Summary, names: Sequence[str], metrics: Sequence[Metric], rivals: Sequence[str]) -> list[Row]:
    """A row for each of `names`: figures with intervals and marks; the best of the `rivals` stand out.

    The number of cases stands beside where some episodes are none.
    """
    winners = {metric.key: best(summary, metric, rivals) for metric in metrics}
    rows = []
    for name in names:
        cells = []
        for metric in metrics:
            key = metric.key
            small = [span(summary["intervals"][name][key], metric.digits, key == "delta")]
            if 0 < (count := summary["counts"][name][key]) < summary["episodes"]:
                small.append(f"n {count}")
            text, sign = shown(summary["methods"][name][key], metric), DAGGER[mark(summary, name, metric)]
            cells.append(Cell(text, "; ".join(filter(None, small)), sign, name in winners[key]))
        rows.append(row(name, cells))
    return rows


def _heads(metrics: Sequence[Metric], first: str = "method") -> tuple[str, ...]:
    return (first, *map(column_header, metrics))


# --- of every task ----------------------------------------------------------------------------------------------------


def main_table(task: Task, summary: Summary) -> Table:
    """The table laid out like the paper's, with the published row below each method that has one."""
    metrics = shown_metrics(task, summary)
    names = [name for name in summary["methods"] if not is_variant(name)]
    rivals = list(filter(is_rival, names))
    published = dict(PUBLISHED.get(task.name, {}))
    rows = []
    for each in figure_rows(summary, names, metrics, rivals):
        rows.append(each)
        if each.head in published:
            rows.append(_published_row("as published", published.pop(each.head), metrics))
    rows += [_published_row(f"{name}, published", values, metrics) for name, values in published.items()]
    groups, unit, reference = summary["groups"], summary["unit"], summary["reference"]
    notes = [SMALL_PRINT.format(unit)]
    if reference in names and len(rivals) > 1 and groups > 1:
        notes.append(
            f"† worse, ‡ better than {reference}: p < {SIGNIFICANT} over what both have, by sign flips of {unit}s, "
            "Holm's correction over all tests of this table. Bold: the best of its column."
        )
    notes += small_cluster_warning(groups, unit)
    tests = sum(found is not None for name in rivals for found in summary["differences"].get(name, {}).values())
    if groups > 1 and tests and (lowest := lowest_p(groups, tests)) >= SIGNIFICANT:
        notes.append(
            f"With {groups} {unit}s and {tests} tests no p can be below {min(lowest, 1.0):.2g} after the correction: "
            "whatever the figures are, none of their differences is told from chance."
        )
    if PUBLISHED.get(task.name):
        notes.append(
            "As published: measured by the papers in their own setting (worlds, models, perception, rules, the whole "
            "data). They cannot be compared with ours one to one."
        )
    title = f"{task.title}: {summary['episodes']} {getattr(task, 'case', 'case')}s"
    return Table(title, _heads(metrics), tuple(rows), tuple(notes))


def _published_row(name: str, values: Mapping[str, float], metrics: Sequence[Metric]) -> Row:
    cells = tuple(Cell(f"{values[m.key]:g}".replace("-", "−") if m.key in values else NOTHING) for m in metrics)
    return Row(name, cells, "paper")


def as_text(run: Run, summary: Summary) -> list[str]:
    """The main table for a terminal, and what its marks mean."""
    if not summary["methods"] or not summary["episodes"]:
        return [f"{run.task.title}: no results; {summary['failed']} failed"]
    table = main_table(run.task, summary)
    lines = Table("", table.heads, tuple(row for row in table.rows if row.kind != "paper")).lines(WIDTH)
    groups, unit = summary["groups"], summary["unit"]
    head = f"{table.title}, {groups} {unit}{'s' if groups != 1 else ''}"
    if summary["failed"]:
        head += f"; {summary['failed']} could not be run"
    marks = [text for text in ("† worse", "‡ better") if any(text[0] in line for line in lines)]
    notes = [summary["success"]] if summary.get("success") else []
    if marks:
        other = f"{summary['reference']} (a variant: than what it varies)"
        notes.append(f"{', '.join(marks)} than {other}: p < {SIGNIFICANT}, corrected for the number of tests")
    if any("(" in line for line in lines[1:]):
        notes.append(f"In brackets: 95 % of whole {unit}s.")
    return [head, *lines, *notes, *small_cluster_warning(groups, unit)]


def strata_tables(task: Task, summary: Summary) -> list[Table]:
    """One table per stratum and label: the same columns, over some of the episodes."""
    found = []
    for title, labels in summary["strata"].items():
        for label, part in labels.items():
            view = {**summary, **part, "differences": {}}
            metrics = shown_metrics(task, view)
            names = [name for name in part["methods"] if not is_variant(name)]
            rows = figure_rows(view, names, metrics, list(filter(is_rival, names)))
            what = f"{title}: {label} ({part['episodes']} episodes)"
            found.append(Table(what, _heads(metrics), tuple(rows)))
    return found


def variant_tables(task: Task, summary: Summary) -> list[Table]:
    """One table per varied method and set of settings."""
    metrics = shown_metrics(task, summary)
    groups: dict[tuple[str, str], list[str]] = {}
    for name in filter(is_variant, summary["methods"]):
        base, _, text = name.partition(":")
        groups.setdefault((base, ", ".join(item.partition("=")[0] for item in text.split(","))), []).append(name)
    found = []
    for (base, keys), variants in sorted(groups.items()):
        names = [name for name in summary["methods"] if name == base or name in variants]
        rows = figure_rows(summary, names, metrics, names)
        rows = [Row(f"{base} (as it is)", each.cells, "ours") if each.head == base else each for each in rows]
        note = f"† worse, ‡ better than {base}: p < {SIGNIFICANT}, Holm's correction over all tests of all variants."
        found.append(Table(f"Variants of {base}: {keys}", _heads(metrics), tuple(rows), (note,)))
    return found


# --- of simulated tasks; a table without a case has no rows -----------------------------------------------------------


def ordering_table(task: Task, results: Mapping[str, Sequence[Result]]) -> Table:
    """How far the paper's ordering carries over: what its method gains over each rival, published and measured."""
    published = PUBLISHED.get(task.name, {})
    metrics = [metric for metric in task.metrics if metric.key in published.get(PAPERS, {})]
    values = {name: [values_of(results.get(name, ()), metric) for metric in metrics] for name in (PAPERS, *RIVALS)}
    rows, verdicts = [], []
    for rival in RIVALS if metrics else ():
        claimed, cells = [], []
        for metric, theirs, ours in zip(metrics, values[rival], values[PAPERS], strict=True):
            lower = metric.better == "low"
            ahead = published[rival][metric.key] - published[PAPERS][metric.key]
            margin = ahead if lower else -ahead
            gain = difference(theirs, ours) if lower else difference(ours, theirs)
            claimed.append(Cell(shown(margin, metric, True)))
            verdicts.append(verdict(margin, gain))
            ends = span((gain.interval.low, gain.interval.high), metric.digits, True) if gain else ""
            cells.append(Cell(shown(gain and gain.difference, metric, True), ends, verdicts[-1]))
        rows += [Row(f"over {rival}: published", tuple(claimed), "paper"), Row(f"over {rival}: measured", tuple(cells))]
    holds, undecided, other = (verdicts.count(word) for word in ("holds", "open", "reversed"))
    notes = (
        f"Margins of {PAPERS} (the method as published) over the paper's rivals; positive: it is better. Of "
        f"{holds + undecided + other} comparisons {holds} hold (the 95 % interval lies on the published side of 0 and "
        f"p < {SIGNIFICANT}), {other} are reversed (on the other side), {undecided} are open. Each is judged for "
        "itself, without a correction for their number.",
        "Measured: paired over the episodes that both have. Published margins are differences of the printed figures.",
    )
    title = f"What {PAPERS} gains over the paper's rivals"
    return Table(title, _heads(metrics, "margin"), tuple(rows if any(verdicts) else ()), notes)


def verdict(published: float, measured: PairedDifference | None) -> str:
    """Whether a measured margin confirms the published one: "holds", "reversed", "open"; "" where it has no case."""
    if measured is None:
        return ""
    low, high = measured.interval.low, measured.interval.high
    if (low > 0 or high < 0) and measured.p < SIGNIFICANT:
        return "holds" if (low > 0) == (published > 0) else "reversed"
    return "open"


def parts_table(results: Mapping[str, Sequence[Result]]) -> Table:
    """What the errors are made of, how far off the distance is, and how honest the regions are."""
    rows, share = [], ""
    for name, found in results.items():
        if is_variant(name):
            continue
        means, shares = episodes.parts(found)
        pairs = ((mean, ends) for mean, *ends in (means.get(part, (None, None, None)) for part in episodes.COLUMNS))
        rows.append(row(name, [cell(mean, ends) for mean, ends in pairs]))
        if name == OURS and shares:
            parts = ", ".join(f"{100 * each:.0f} % {part}" for part, each in shares.items())
            share = f" Of the steps of {OURS}: {parts}."
    notes = (
        "Mean direction error over the steps of each kind, over the episodes that have such steps. Before the target "
        "was ever in sight nothing can be known of it but where it is not: that part is the price of the search, and "
        "an estimator that made no mistake would have the others at 0. The fourth column is the second and the third."
        + share,
        f"Distance: mean relative error once the camera has moved by {100 * episodes.BASELINE:.0f} % of it since the "
        "first sighting, for methods that state one. Covered: share of steps at which the true direction lay in the "
        "stated 90 % region; 90 is right, less is overconfident, more is too cautious.",
    )
    heads = ["method", *(f"{part} ↓, °" for part in episodes.COLUMNS[:4]), "distance ↓, %"]
    heads += [f"{part}, %" for part in episodes.COLUMNS[5:]]
    return Table("What the errors are made of", tuple(heads), tuple(rows), notes)


# --- of answers to published data -------------------------------------------------------------------------------------


def turn_table(summary: Summary) -> Table:
    """Success if the episode had ended at each turn."""
    found = {name: part["by_turn"] for name, part in summary["answers"].items() if "by_turn" in part}
    longest = max((len(part["success"]) for part in found.values()), default=0)
    rows = []
    for name, part in found.items():
        cells = [Cell(number(value), span(ends, 0)) for value, *ends in zip(*part.values(), strict=True)]
        rows.append(row(name, [*cells, *[Cell(NOTHING)] * (longest - len(cells))]))
    note = (
        "Per cent of the episodes whose answer would have succeeded, had it been given at this turn; after a "
        "submission its outcome stands. Small print: 95 % of whole clusters."
    )
    return Table("Success by turn", ("agent", *(str(k + 1) for k in range(longest))), tuple(rows), (note,))


def views_table(summary: Summary) -> Table:
    """How many views it took, and whether those that were sure were right."""
    rows = []
    for name, part in summary["answers"].items():
        if "views" in part:
            sure, error = part.get("sure", {}), part.get("calibration_error")
            cells = [cell(part[key], digits=2) for key in ("views", "views_to_success")]
            cells += [Cell(str(sure.get("episodes", NOTHING))), cell(sure.get("success"), sure.get("interval"))]
            rows.append(row(name, [*cells, cell(None if error is None else 100 * error)]))
    heads = (
        "agent", "views ↓", "views of successes ↓", "submitted because sure", "of those right ↑, %",
        "calibration error ↓, %",
    )  # fmt: skip
    note = "Calibration error: mean gap between the stated probability of success and the share that succeeded."
    return Table("Views, and stopping", heads, tuple(rows), (note,))


def failure_tables(task: Task, part: Mapping[str, Any]) -> list[Table]:
    """What was known of the failures before the run, and why cases failed, crossed with that; those that have rows."""
    published, kinds, whys = PUBLISHED_TAGS.get(task.name, {}), [], []
    for tag, found in part["tags"].items():
        cells = Cell(str(found["episodes"])), cell(found["share"]), cell(found["success"], found["interval"])
        kinds.append(Row(tag, cells))
        if tag in published:
            cells = (Cell(NOTHING), *(Cell(f"{value:g}") for value in published[tag]))
            kinds.append(Row("published", cells, "paper"))
    causes, count = part["causes"], sum(part["causes"].values())
    for cause, n in causes.items():
        crossed = [Cell(str(tag["causes"].get(cause, 0))) for tag in part["tags"].values()]
        whys.append(Row(cause.replace("_", " "), (Cell(str(n)), cell(100 * n / count), *crossed)))
    note = (
        "The kind of a case was known before it was played. Small print: 95 % of whole clusters. Published: the "
        "paper's, of its own agent and model."
    )
    meanings = getattr(task, "causes", {})
    notes = tuple(f"{cause.replace('_', ' ')}: {meanings[cause]}." for cause in causes if cause in meanings)
    tables = [
        Table("What was asked", ("kind", "cases", "of all, %", "success ↑, %"), tuple(kinds), (note,)),
        Table("Why cases failed", ("cause", "cases", "of failures, %", *part["tags"]), tuple(whys), notes),
    ]
    return [table for table in tables if table.rows]


def figures_of(record: Mapping[str, Any], task: Task, method: str = OURS) -> str:
    """The figures of a method in an episode, in words."""
    values = [(metric, metric.of(record["methods"][method])) for metric in task.metrics]
    figures = ", ".join(f"{m.title} {shown(value, m)}{m.unit}" for m, value in values if value is not None)
    return f"{method}: {figures}."


def failures(run: Run) -> list[tuple[Mapping[str, Any], str]]:
    """The records that failed and why, worst first: by their score, then by how far off they are."""
    those = [(record, cause) for record in finished(run.records) if (cause := run.task.failure(record))]
    return sorted(those, key=lambda item: (item[0].get("score", 0), -(item[0].get("error") or 0)))


def failed_lines(run: Run) -> list[str]:
    """One line for each failure, worst first."""
    lines = []
    for record, cause in failures(run):
        question, answer = record.get("words") or record.get("question") or "", record.get("answer")
        given = ", ".join(f"{k} {v}" for k, v in answer.items()) if isinstance(answer, Mapping) else str(answer or "")
        off = f", {record['error']:.0f}° off" if record.get("error") is not None else ""
        tags = ", ".join(record.get("tags", ()))
        lines.append(f"{record['case']}  {cause}  [{tags}]  {question!r}: {given or 'no answer'}{off}")
    return lines


# --- a comparison, for a terminal -------------------------------------------------------------------------------------


def comparison_in_words(found: Mapping[str, Any], run: Run) -> list[str]:
    """What `eagor.lab.eval.results.compare` found; `run`: one of the two."""
    case, unit = getattr(run.task, "case", "case"), run.unit
    lines = [
        f"{found['task']}: {found['cases']} {case}s that both have "
        f"(a only: {found['only_in_a']}, b only: {found['only_in_b']})"
    ]
    if "methods" in found:
        lines.append("  method: a {}, b {}".format(*found["methods"]))
    lines += [f"  {key}: a {words(x)}, b {words(y)}" for key, (x, y) in found["settings"].items()]
    rows = [["", "a", "b", "a - b", "95 % interval", "p"]]
    for metric in run.task.metrics:
        if (figure := found["figures"].get(metric.key)) is not None:
            sides = (shown(figure[side], metric, side == "difference") for side in ("a", "b", "difference"))
            ends = span((figure.get("low"), figure.get("high")), metric.digits, True) or "-"
            p = f"{figure['p']:.2g}" if "p" in figure else "-"
            rows.append([f"{column_header(metric)} ({figure['n']})", *sides, ends, p])
    lines += [*in_columns(rows), f"p: sign flips of whole {unit}s, each figure for itself."]
    groups = max((figure.get("groups", 1) for figure in found["figures"].values()), default=1)
    lines += small_cluster_warning(groups, unit)
    return lines + ([f"p cannot be below {lowest_p(groups):.2g}."] if 1 < groups < FEW else [])


def words(value: Any) -> str:
    """A setting as text."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {words(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(f"({words(item)})" if isinstance(item, list) else words(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
