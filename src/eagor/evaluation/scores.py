"""From the records of a benchmark's run to its figures, per cent: with intervals, by turn, by tag, by cause.

Wilson's interval takes every case for itself; the cluster bootstrap knows that cases share targets or scenes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.evaluation.samples import LEVEL, RESAMPLES, SEED, cause_of, failures, finished, mean_intervals
from eagor.statistics import (
    bootstrap_interval,
    calibration_error,
    mcnemar,
    paired_difference,
    reliability,
    wilson_interval,
)
from eagor.tasks.benchmark import Figure, Record, load

BINS = 10


def summarise(settings: Mapping[str, Any], records: Sequence[Record]) -> dict[str, Any]:
    """The figures of one run, ready for JSON; a figure without cases is None.

    "overall" and the other figures of the benchmark by their keys; "intervals" {key: {"wilson", "cluster"}} (Wilson's
    only where every score is 0 or 1, the bootstrap only with two clusters or more); "counts"; "by_turn" {"success",
    "low", "high"} with one entry per turn; "views", "views_to_success"; "reliability" (of what was stated with the
    answers) and "sure"; "tags" and "causes"; "episodes" with a result, "failed" without, and "failures".
    """
    good = finished(records)
    benchmark = load(str(settings["task"]))
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
    chosen = [(value, record) for record in records if (value := figure.read(record)) is not None]
    if not chosen:
        return {"value": None, "n": 0, "wilson": None, "cluster": None}
    values = np.array([value for value, _ in chosen], dtype=np.float64)
    labels = [record["cluster"] for _, record in chosen]
    if figure.over is None:
        low, high = mean_intervals(values[:, None], labels)
        cluster = None if low[0] is None or high[0] is None else [100 * low[0], 100 * high[0]]
        wilson = _wilson(values) if bool(np.isin(values, (0.0, 1.0)).all()) else None
        return {"value": 100 * float(values.mean()), "n": len(values), "wilson": wilson, "cluster": cluster}
    mean_of_means, cluster = _mean_of_means(values, [figure.over(record) for _, record in chosen]), None
    everything = np.arange(len(values), dtype=np.float64)
    if len(set(labels)) > 1:
        rng = np.random.default_rng(SEED)
        drawn = bootstrap_interval(everything, rng, LEVEL, mean_of_means, labels, RESAMPLES)
        cluster = [100 * drawn.low, 100 * drawn.high]
    return {"value": 100 * mean_of_means(everything), "n": len(values), "wilson": None, "cluster": cluster}


def _mean_of_means(values: np.ndarray, kinds: Sequence[str]) -> Callable[[np.ndarray], float]:
    """What takes indices into `values` ``(n,)`` and returns the mean over their `kinds` of the mean over each kind."""
    place = np.unique(kinds, return_inverse=True)[1]

    def mean(indices: np.ndarray) -> float:
        rows = indices.astype(np.intp)
        sums, counts = np.bincount(place[rows], values[rows]), np.bincount(place[rows])
        return float((sums[counts > 0] / counts[counts > 0]).mean())

    return mean


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


def compare(
    a: tuple[Mapping[str, Any], Sequence[Record]], b: tuple[Mapping[str, Any], Sequence[Record]]
) -> dict[str, Any]:
    """Two runs of one benchmark over the cases that both have a result of, figure by figure, a minus b.

    With a cluster-bootstrap interval, p by sign flips of clusters, and McNemar's exact test where every score is 0 or
    1. Raises `EagorError` if the runs are of different benchmarks or data, or share no case.
    """
    (settings_a, records_a), (settings_b, records_b) = a, b
    for key in ("task", "data"):
        if settings_a.get(key) != settings_b.get(key):
            raise EagorError(
                f"the runs differ in {key}: {settings_a.get(key)} and {settings_b.get(key)}; compare like with like"
            )
    left, right = ({record["case"]: record for record in finished(part)} for part in (records_a, records_b))
    shared = sorted(left.keys() & right.keys())
    if not shared:
        raise EagorError("the runs share no case that both have a result of; run the same part of the data with both")
    figures = {}
    for figure in load(str(settings_a["task"])).figures:
        pairs = [(figure.read(left[case]), figure.read(right[case]), left[case]) for case in shared]
        both = [(x, y, record) for x, y, record in pairs if x is not None and y is not None]
        if both:
            figures[figure.key] = {"title": figure.title, **_difference(figure, both)}
    return {
        "task": settings_a["task"],
        "cases": len(shared),
        "only_in_a": len(left.keys() - right.keys()),
        "only_in_b": len(right.keys() - left.keys()),
        "settings": {
            key: [settings_a.get(key), settings_b.get(key)]
            for key in dict.fromkeys([*settings_a, *settings_b])
            if settings_a.get(key) != settings_b.get(key)
        },
        "figures": figures,
    }


def _difference(figure: Figure, both: Sequence[tuple[float, float, Record]]) -> dict[str, Any]:
    """One figure of `compare`, from the scores of both runs and a record of each case."""
    x, y = (np.array([pair[k] for pair in both], dtype=np.float64) for k in (0, 1))
    groups = [record["cluster"] for _, _, record in both]
    kinds = [figure.over(record) if figure.over else "" for _, _, record in both]
    _, place, counts = np.unique(kinds, return_inverse=True, return_counts=True)
    weights = len(both) / (len(counts) * counts[place])  # with these, a plain mean is the mean of the kinds' means
    found: dict[str, Any] = {"n": len(both), "a": 100 * float((weights * x).mean())}
    found["b"] = 100 * float((weights * y).mean())
    found["difference"] = found["a"] - found["b"]
    if len(set(groups)) > 1:
        gap = paired_difference(weights * x, weights * y, np.random.default_rng(SEED), groups, LEVEL)
        ends = gap.interval
        if figure.over:  # clusters that are drawn hold other shares of the kinds
            everything, statistic = np.arange(len(both), dtype=np.float64), _mean_of_means(x - y, kinds)
            ends = bootstrap_interval(everything, np.random.default_rng(SEED), LEVEL, statistic, groups, RESAMPLES)
        found |= {"low": 100 * ends.low, "high": 100 * ends.high, "p": gap.p, "clusters": gap.groups}
    if bool(np.isin([x, y], (0.0, 1.0)).all()):
        test = mcnemar(x, y)
        found["mcnemar"] = {"only_a": test.only_a, "only_b": test.only_b, "p": test.p}
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
            "wilson": _wilson(sure) if sure else None,
        },
    }


def _rows(table: Sequence[Any]) -> list[list[float]]:
    return [[row.lower, row.upper, row.n, row.stated, row.frequency] for row in table]


def _wilson(outcomes: Any) -> list[float]:
    """The ends of Wilson's interval of a share, per cent."""
    found = wilson_interval(int(sum(outcomes)), len(outcomes), LEVEL)
    return [100 * found.low, 100 * found.high]
