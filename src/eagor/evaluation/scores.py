"""From the records of a benchmark's run to its figures, per cent: with intervals, by turn, by tag, by cause.

Wilson's interval takes every case for itself; the cluster bootstrap knows that cases share targets or scenes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eagor.evaluation.samples import cause_of, clustered, failures, finished, mean_intervals, sample, wilson
from eagor.statistics import calibration_error, reliability
from eagor.tasks.benchmark import Benchmark, Figure, Record

BINS = 10


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
