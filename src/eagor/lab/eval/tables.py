"""The tables of a report, the same for the page, for Markdown and for the terminal.

``published.toml`` has what the papers printed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from msgspec import toml

from eagor.lab.eval import episodes
from eagor.lab.eval.page import NOTHING, Cell, Row, Table, cell, number, span
from eagor.lab.eval.results import OURS, Result, Run, Summary, is_rival, is_variant
from eagor.lab.tasks.task import Metric, Task, finished

_PRINTED = toml.decode(files("eagor.lab.eval").joinpath("published.toml").read_bytes())
PUBLISHED: dict[str, dict[str, dict[str, float]]] = {
    task: {name: dict(zip(rows["columns"], row, strict=False)) for name, row in rows.items() if name != "columns"}
    for task, rows in _PRINTED["figures"].items()
}
PUBLISHED_TAGS: dict[str, dict[str, tuple[float, float]]] = _PRINTED["failure_tags"]

FEW = 10  # groups, below which intervals that resample them are too narrow to be trusted
SIGNIFICANT = 0.05
WIDTH = 120  # of a terminal


def mark(summary: Summary, name: str, metric: Metric) -> str:
    """Whether a method differs from its reference beyond chance: "†" it is worse, "‡" it is better, "" neither."""
    found = summary["differences"].get(name, {}).get(metric.key)
    if found is None or found["p_holm"] >= SIGNIFICANT or found["difference"] == 0:
        return ""
    return "†" if (found["difference"] > 0) == (metric.better == "low") else "‡"


def best(summary: Summary, metric: Metric, names: Iterable[str]) -> set[str]:
    """Those of `names` with the best figure of a metric, as it is shown; nobody where neither side is better."""
    there = {name: summary["methods"][name][metric.key] for name in names}
    figures = {name: round(value, metric.digits) for name, value in there.items() if value is not None}
    if metric.better is None or len(there) < 2 or not figures:
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


def row(name: str, cells: Iterable[Cell]) -> Row:
    """The row of a method; ours is shown as such."""
    return Row(name, list(cells), "ours" if name.partition(" ")[0] == OURS else "")


def figure_table(
    title: str, task: Task, summary: Summary, names: Sequence[str], rivals: Iterable[str], notes: Sequence[str] = ()
) -> Table:
    """A row for each of `names`: figures with intervals and marks; the best of the `rivals` stand out.

    The number of cases stands beside where some episodes are none.
    """
    rows: dict[str, list[Cell]] = {name: [] for name in names}
    metrics, rivals = shown_metrics(task, summary), set(rivals)
    for metric in metrics:
        key, winners = metric.key, best(summary, metric, rivals)
        for name, cells in rows.items():
            value, ends, count = (summary[part][name][key] for part in ("methods", "intervals", "counts"))
            small = [span(ends, metric.digits, key == "delta"), f"n {count}" * (0 < count < summary["episodes"])]
            text, sign = shown(value, metric), mark(summary, name, metric)
            cells.append(Cell(text, "; ".join(filter(None, small)), sign, name in winners))
    return Table(title, ["method", *map(column_header, metrics)], [row(*each) for each in rows.items()], notes)


def small_cluster_warning(count: int, unit: str) -> list[str]:
    """What so few groups of this kind (apartment, cluster) cannot tell; nothing where there are enough, or none."""
    if count == 1:
        return [f"Only one {unit}: nothing can be said about how far the figures carry over to others."]
    return [f"Only {count} {unit}s: intervals that resample so few are too narrow."] if 0 < count < FEW else []


def main_table(task: Task, summary: Summary) -> Table:
    """The table laid out like the paper's, with the published row below each method that has one."""
    names = [name for name in summary["methods"] if not is_variant(name)]
    rivals = list(filter(is_rival, names))
    groups, unit, reference = summary["groups"], summary["unit"], summary["reference"]
    notes = [
        f"Small print: 95 % intervals of whole {unit}s; n: how many episodes have such a case, where not all have."
    ]
    if reference in names and len(rivals) > 1 and groups > 1:
        notes.append(
            f"† worse, ‡ better than {reference}: p < {SIGNIFICANT} over what both have, by sign flips of {unit}s, "
            "Holm's correction over all tests of this table. Bold: the best of its column."
        )
    notes += small_cluster_warning(groups, unit)
    tests = sum(found is not None for name in rivals for found in summary["differences"].get(name, {}).values())
    lowest = tests * 2.0 ** (1 - groups)
    if tests and lowest >= SIGNIFICANT:
        notes.append(
            f"With {groups} {unit}s and {tests} tests no p can be below {min(lowest, 1.0):.2g} after the correction: "
            "whatever the figures are, none of their differences is told from chance."
        )
    if published := PUBLISHED.get(task.name, {}):
        notes.append(
            "As published: measured by the papers in their own setting (worlds, models, perception, rules, the whole "
            "data). They cannot be compared with ours one to one."
        )
    title = f"{task.title}: {summary['episodes']} {getattr(task, 'case', 'case')}s"
    table, metrics, rows = figure_table(title, task, summary, names, rivals, notes), shown_metrics(task, summary), []

    def printed(head: str, name: str) -> Row:
        values = [published[name].get(metric.key) for metric in metrics]
        texts = (NOTHING if value is None else f"{value:g}".replace("-", "−") for value in values)
        return Row(head, list(map(Cell, texts)), "paper")

    for each in table.rows:
        rows += [each, printed("as published", each.head)] if each.head in published else [each]
    rows += [printed(f"{name}, published", name) for name in published if name not in names]
    return table._replace(rows=rows)


def as_text(run: Run, summary: Summary) -> list[str]:
    """The main table for a terminal, and what its marks mean."""
    if not summary["methods"] or not summary["episodes"]:
        return [f"{run.task.title}: no results; {summary['failed']} failed"]
    table = main_table(run.task, summary)
    lines = table._replace(rows=[row for row in table.rows if row.kind != "paper"]).lines(WIDTH)
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
            names = [name for name in part["methods"] if not is_variant(name)]
            what = f"{title}: {label} ({part['episodes']} episodes)"
            view = {**summary, **part, "differences": {}}
            found.append(figure_table(what, task, view, names, filter(is_rival, names)))
    return found


def variant_tables(task: Task, summary: Summary) -> list[Table]:
    """One table per varied method and set of settings."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name in filter(is_variant, summary["methods"]):
        base, _, text = name.partition(":")
        groups.setdefault((base, ", ".join(item.partition("=")[0] for item in text.split(","))), []).append(name)
    found = []
    for (base, keys), variants in sorted(groups.items()):
        names = [name for name in summary["methods"] if name == base or name in variants]
        note = f"† worse, ‡ better than {base}: p < {SIGNIFICANT}, Holm's correction over all tests of all variants."
        table = figure_table(f"Variants of {base}: {keys}", task, summary, names, names, [note])
        rows = [Row(f"{base} (as it is)", each.cells, "ours") if each.head == base else each for each in table.rows]
        found.append(table._replace(rows=rows))
    return found


def parts_table(results: Mapping[str, Sequence[Result]]) -> Table:
    """What the errors are made of, how far off the distance is, and how honest the regions are."""
    rows, share = [], ""
    for name, found in results.items():
        if is_variant(name):
            continue
        means, shares = episodes.parts(found)
        figures = (means.get(part, (None, None)) for part in episodes.COLUMNS)
        rows.append(row(name, (cell(*figure) for figure in figures)))
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
    return Table("What the errors are made of", heads, rows, notes)


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
    return Table("Success by turn", ["agent", *(str(k + 1) for k in range(longest))], rows, [note])


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
    return Table("Views, and stopping", heads, rows, [note])


def failure_tables(task: Task, part: Mapping[str, Any]) -> list[Table]:
    """What was known of the failures before the run, and why cases failed, crossed with that; those that have rows."""
    published, kinds, whys = PUBLISHED_TAGS.get(task.name, {}), [], []
    for tag, found in part["tags"].items():
        kinds.append(
            Row(tag, [Cell(str(found["episodes"])), cell(found["share"]), cell(found["success"], found["interval"])])
        )
        if tag in published:
            kinds.append(Row("published", [Cell(NOTHING), *(Cell(f"{value:g}") for value in published[tag])], "paper"))
    causes, count = part["causes"], sum(part["causes"].values())
    for cause, n in causes.items():
        crossed = (Cell(str(tag["causes"].get(cause, 0))) for tag in part["tags"].values())
        whys.append(Row(cause.replace("_", " "), [Cell(str(n)), cell(100 * n / count), *crossed]))
    note = (
        "The kind of a case was known before it was played. Small print: 95 % of whole clusters. Published: the "
        "paper's, of its own agent and model."
    )
    meanings = getattr(task, "causes", {})
    notes = [f"{cause.replace('_', ' ')}: {meanings[cause]}." for cause in causes if cause in meanings]
    tables = [
        Table("What was asked", ["kind", "cases", "of all, %", "success ↑, %"], kinds, [note]),
        Table("Why cases failed", ["cause", "cases", "of failures, %", *part["tags"]], whys, notes),
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


def words(value: Any) -> str:
    """A setting as text."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {words(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(f"({words(item)})" if isinstance(item, list) else words(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
