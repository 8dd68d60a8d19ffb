"""From the records of a benchmark's run to its figures, per cent: with intervals, by turn, by tag, by cause; as tables.

Wilson's interval takes every case for itself; the cluster bootstrap knows that cases share targets or scenes. The
tables are the same for the page, for Markdown and for the terminal.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eagor.lab.eval.page import NOTHING, Box, Row, Sheet, box, number, span
from eagor.lab.eval.samples import (
    Record,
    cause_of,
    clustered,
    failures,
    few_groups,
    finished,
    mean_intervals,
    sample,
    wilson,
)
from eagor.lab.eval.tables import FAILURE_TAGS, FIGURES, OURS, headed
from eagor.lab.tasks.benchmark import Benchmark, Figure
from eagor.statistics import calibration_error, reliability

BINS = 10
Summary = Mapping[str, Any]


def summarise(settings: Mapping[str, Any], records: Sequence[Record], benchmark: Benchmark) -> dict[str, Any]:
    """The figures of one run, ready for JSON; a figure without cases is None.

    "overall" and the other figures of the benchmark by their keys; "intervals" {key: {"wilson", "cluster"}} (Wilson's
    only where every score is 0 or 1, the bootstrap only with two clusters or more); "counts"; "by_turn" {"success",
    "low", "high"} with one entry per turn; "views", "views_to_success"; "reliability" (of what was stated with the
    answers) and "sure"; "tags" and "causes"; "episodes" with a result, "failed" without, and "failures".
    """
    good = finished(records)
    found: dict[str, Any] = {
        "task": settings["task"],
        "agent": settings.get("agent"),
        "perception": settings.get("perception"),
        "model": settings.get("model"),
        "episodes": len(good),
        "clusters": len({record["cluster"] for record in good}),
        "failed": len(records) - len(good),
    }
    cells = {figure.key: cell(figure, good) for figure in benchmark.figures}
    found |= {key: cell["value"] for key, cell in cells.items()}
    found["intervals"] = {key: {kind: c[kind] for kind in ("wilson", "cluster")} for key, c in cells.items()}
    found["counts"] = {key: cell["n"] for key, cell in cells.items()}
    if good:
        found |= _by_turn(good) | _views(good) | _reliability(good)
    found["tags"] = tags(good)
    found["causes"] = dict(Counter(filter(None, map(cause_of, good))).most_common())
    found["failures"] = failures(records)
    return found


def cell(figure: Figure, records: Sequence[Record]) -> dict[str, Any]:
    """One figure over some records: {"value", "n", "wilson", "cluster"} in per cent."""
    found = sample(records, None, figure)
    values = found.values.values()
    if not values:
        return {"value": None, "n": 0, "wilson": None, "cluster": None}
    outcomes = not found.kinds and all(value in (0.0, figure.scale) for value in values)
    ends = wilson(values, figure.scale) if outcomes else None
    return {"value": found.mean, "n": len(values), "wilson": ends, "cluster": clustered(found)}


def tags(records: Sequence[Record]) -> dict[str, Any]:
    """By tag: how many cases have it, their share, their success and its interval."""
    found: dict[str, Any] = {}
    for tag in sorted({tag for record in records for tag in record.get("tags", ())}):
        part = [record for record in records if tag in record.get("tags", ())]
        figure = cell(Figure(tag, tag, "", lambda record: record["score"]), part)
        causes = Counter(filter(None, map(cause_of, part)))
        found[tag] = {
            "episodes": len(part),
            "share": 100 * len(part) / len(records),
            "success": figure["value"],
            "wilson": figure["wilson"],
            "causes": dict(causes.most_common()),
        }
    return found


def _by_turn(records: Sequence[Record]) -> dict[str, Any]:
    rows = [(record["by_turn"], record["cluster"]) for record in records if record.get("by_turn")]
    if not rows:
        return {}
    longest = max(len(row) for row, _ in rows)
    # Episodes of runs with fewer turns have nothing to say about later ones.
    values = np.array([[*map(float, row), *([np.nan] * (longest - len(row)))] for row, _ in rows])
    low, high = mean_intervals(values, [label for _, label in rows])
    scaled = [[None if v is None else 100 * v for v in ends] for ends in (low, high)]
    return {"by_turn": {"success": (100 * np.nanmean(values, axis=0)).tolist(), "low": scaled[0], "high": scaled[1]}}


def _views(records: Sequence[Record]) -> dict[str, Any]:
    views = [record["views"] for record in records if "views" in record]
    if not views:
        return {}
    hits = [record["views"] for record in records if "views" in record and record["score"] == 1]
    return {"views": float(np.mean(views)), "views_to_success": float(np.mean(hits)) if hits else None}


def _reliability(records: Sequence[Record]) -> dict[str, Any]:
    """Of what was stated with the answer, and of the answers that were given because the agent was sure."""
    said = [(record["stated"], record["score"] == 1) for record in records if record.get("stated") is not None]
    if not said:
        return {}
    table = reliability([p for p, _ in said], [good for _, good in said], BINS)
    sure = [record["score"] == 1 for record in records if record.get("sure")]
    # What it would have submitted at every turn says more about the statements than the last ones alone.
    steps = [
        (step["would"]["p"], bool(step["would"].get(str(record.get("scoring", "official")))))
        for record in records
        for step in record.get("steps", ())
        if (step.get("would") or {}).get("p") is not None
    ]
    every = reliability([p for p, _ in steps], [good for _, good in steps], BINS) if steps else ()
    return {
        "reliability": _rows(table),
        "calibration_error": calibration_error(table),
        "reliability_by_step": _rows(every),
        "sure": {
            "episodes": len(sure),
            "right": 100 * float(np.mean(sure)) if sure else None,
            "wilson": wilson([100.0 * right for right in sure], 100.0) if sure else None,
        },
    }


def _rows(table: Sequence[Any]) -> list[list[float]]:
    return [[row.lower, row.upper, row.n, row.stated, row.frequency] for row in table]


def labels_of(summaries: Sequence[Summary]) -> list[str]:
    """What runs are called in tables: their agent, who looked or talked, and a number where that would be the same.

    A model goes without its address and its options, which are under what was run.
    """
    parts = (
        (str(s["agent"]), re.sub(r"(@https?://|\?).*", "", s.get("perception") or s.get("model") or ""))
        for s in summaries
    )
    found = [" · ".join(filter(None, part)) for part in parts]
    return [
        f"{label} ({found[: index + 1].count(label)})" if found.count(label) > 1 else label
        for index, label in enumerate(found)
    ]


def main_sheet(benchmark: Benchmark, summaries: Sequence[Summary], published: bool = True) -> Sheet:
    """The paper's Table 1: a row per run, then what was published."""
    labels = labels_of(summaries)
    figures = [f for f in benchmark.figures if any(s.get(f.key) is not None for s in summaries)]
    views = any("views" in s for s in summaries)
    rows = []
    for label, summary in zip(labels, summaries, strict=True):
        boxes = [_box(summary, figure) for figure in figures]
        rows.append(_row(label, summary, [*boxes, box(summary.get("views"))] if views else boxes))
    known = FIGURES.get(benchmark.name, {}) if published else {}
    for name, values in known.items():
        texts = [f"{values[f.key]:.2f}".rstrip("0").rstrip(".") if f.key in values else NOTHING for f in figures]
        rows.append(Row(f"{name}, published", tuple(map(Box, [*texts, NOTHING] if views else texts)), "paper"))
    heads = ["agent", *map(headed, figures), *(["views"] if views else [])]
    counts = "; ".join(
        f"{label}: {summary['episodes']} cases in {summary['clusters']} clusters"
        + (f", {summary['failed']} could not be run" if summary["failed"] else "")
        for label, summary in zip(labels, summaries, strict=True)
    )
    notes = [
        "Small print: 95 % intervals; Wilson's | cluster bootstrap, which knows that the cases of one target or scene "
        f"are not independent. {counts}.",
        *(f"{figure.title}: {figure.what}." for figure in figures),
        *few_clusters(summaries),
    ]
    if known:
        notes.append(
            "Published rows were measured with the models named, on the whole published data: they compare with ours "
            "only where model, data and scoring are the same."
        )
    return Sheet(benchmark.title, tuple(heads), tuple(rows), tuple(notes))


def few_clusters(summaries: Sequence[Summary]) -> list[str]:
    """What so few clusters cannot tell; nothing where every run with results has enough."""
    return few_groups(min((s["clusters"] for s in summaries if s["clusters"]), default=0), "cluster")


def turn_sheet(summaries: Sequence[Summary]) -> Sheet | None:
    """Success if the episode had ended at each turn."""
    with_turns = [(label, s) for label, s in zip(labels_of(summaries), summaries, strict=True) if s.get("by_turn")]
    if not with_turns:
        return None
    longest = max(len(summary["by_turn"]["success"]) for _, summary in with_turns)
    rows = []
    for label, summary in with_turns:
        turns = zip(*(summary["by_turn"][key] for key in ("success", "low", "high")), strict=True)
        boxes = [Box(number(v), span(ends, 0)) for v, *ends in turns]
        rows.append(_row(label, summary, [*boxes, *[Box(NOTHING)] * (longest - len(boxes))]))
    note = (
        "Per cent of the episodes whose answer would have succeeded, had it been given at this turn; after a "
        "submission its outcome stands. Small print: 95 % cluster bootstrap."
    )
    return Sheet("Success by turn", ("agent", *(str(k + 1) for k in range(longest))), tuple(rows), (note,))


def views_sheet(summaries: Sequence[Summary]) -> Sheet | None:
    """How many views it took, and whether those that were sure were right."""
    rows = []
    for label, summary in zip(labels_of(summaries), summaries, strict=True):
        if summary.get("views") is None:
            continue
        sure, error = summary.get("sure") or {}, summary.get("calibration_error")
        boxes = [
            box(summary["views"], digits=2),
            box(summary["views_to_success"], digits=2),
            Box(str(sure.get("episodes", NOTHING))),
            box(sure.get("right"), sure.get("wilson")),
            box(None if error is None else 100 * error),
        ]
        rows.append(_row(label, summary, boxes))
    if not rows:
        return None
    heads = (
        "views ↓", "views of successes ↓", "submitted because sure", "of those right ↑, %", "calibration error ↓, %",
    )  # fmt: skip
    note = "Calibration error: mean gap between the stated probability of success and the share that succeeded."
    return Sheet("Views, and stopping", ("agent", *heads), tuple(rows), (note,))


def tag_sheet(summary: Summary) -> Sheet | None:
    """The first layer of the failure table: what was known before the run."""
    if not summary["tags"]:
        return None
    published = FAILURE_TAGS.get(str(summary["task"]), {})
    rows = []
    for tag, found in summary["tags"].items():
        boxes = Box(str(found["episodes"])), box(found["share"]), box(found["success"], found["wilson"])
        rows.append(Row(tag, boxes))
        if tag in published:
            rows.append(Row("published", (Box(NOTHING), *(Box(f"{value:g}") for value in published[tag])), "paper"))
    note = (
        "Exclusive tags that are given before anything runs, from the words and the boxes; the rules are ours, since "
        "the paper names its kinds and not how they were found."
    )
    return Sheet("By what is asked for", ("tag", "cases", "share, %", "success ↑, %"), tuple(rows), (note,))


def cause_sheet(summary: Summary, meanings: Mapping[str, str]) -> Sheet | None:
    """The second layer: why cases failed, crossed with the first."""
    causes, tags = summary["causes"], summary["tags"]
    if not causes:
        return None
    rows = []
    for cause, count in causes.items():
        boxes = [Box(str(count)), box(100 * count / summary["episodes"])]
        boxes += [Box(str(tag["causes"].get(cause, 0))) for tag in tags.values()]
        rows.append(Row(cause.replace("_", " "), tuple(boxes)))
    notes = tuple(f"{cause.replace('_', ' ')}: {meanings[cause]}." for cause in causes if cause in meanings)
    return Sheet("Why cases failed", ("cause", "cases", "of all, %", *tags), tuple(rows), notes)


def failed(records: Sequence[Record]) -> list[tuple[Record, str]]:
    """The cases that failed and why, worst first: by their score, then by how far off they are."""
    those = [(record, cause) for record in finished(records) if (cause := cause_of(record))]
    return sorted(those, key=lambda item: (item[0].get("score", 0), -(item[0].get("error") or 0)))


def failed_lines(failed: Sequence[tuple[Record, str]]) -> list[str]:
    """One line for each case that failed."""
    lines = []
    for record, cause in failed:
        said = record.get("words") or record.get("question") or ""
        answer = record.get("answer")
        told = isinstance(answer, Mapping)
        given = ", ".join(f"{key} {value}" for key, value in answer.items()) if told else str(answer)
        tags = ", ".join(record.get("tags", ()))
        off = f", {record['error']:.0f}° off" if record.get("error") is not None else ""
        lines.append(f"{record['case']}  {cause}  [{tags}]  {said!r}: {given or 'no answer'}{off}")
    return lines


def _row(label: str, summary: Summary, boxes: Sequence[Box]) -> Row:
    return Row(label, tuple(boxes), "ours" if summary["agent"] == OURS else "")


def _box(summary: Summary, figure: Figure) -> Box:
    """A figure of a run with both of its intervals."""
    ends = summary["intervals"].get(figure.key, {})
    small = " | ".join(span(ends[kind]) for kind in ("wilson", "cluster") if ends.get(kind))
    return Box(number(summary.get(figure.key), figure.digits), small)
