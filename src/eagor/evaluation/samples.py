"""From records to figures per episode, and from those to means with their uncertainty.

Episodes of one apartment (the "seed") share its rooms and light, so whole apartments are resampled, always with the
same seed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.statistics import paired_difference, wilson_interval
from eagor.tasks.task import Column

SEED = 20260
RESAMPLES = 2000
LEVEL = 0.95
FEW = 10  # groups (apartments, clusters), below which intervals that resample them are too narrow to be trusted

Record = Mapping[str, Any]


@dataclass(frozen=True)
class Cell:
    """A mean over `n` episodes of `groups` apartments; low and high are None where there is too little to tell."""

    value: float
    low: float | None
    high: float | None
    n: int
    groups: int


@dataclass(frozen=True)
class Gap:
    """A mean difference over `n` shared episodes with its interval, and p before and after Holm's correction."""

    difference: float
    low: float
    high: float
    p: float
    n: int
    groups: int
    p_holm: float | None = None


@dataclass(frozen=True)
class Sample:
    """A method's figures of one column: `values` and `groups` by episode."""

    values: dict[str, float]
    groups: dict[str, Any]


def apartment(record: Record) -> Any:
    """Which episodes belong together: those of one apartment."""
    return record["episode"].get("seed", record["episode"]["id"])


def numbers(values: Sequence[float | bool | None]) -> np.ndarray:
    """A list of a trace as an array, NaN where it has nothing."""
    return np.array([np.nan if value is None else float(value) for value in values])


def finished(records: Iterable[Record]) -> list[Record]:
    """The records that hold a result."""
    return [record for record in records if record["status"] == "ok"]


def cause_of(record: Record) -> str | None:
    """Why a benchmark's case failed ("wrong" where the benchmark names no cause); None for one that did not fail."""
    cause = record.get("cause")
    return str(cause or "wrong") if cause or record.get("score", 1) < 1 else None


def failures(records: Iterable[Record]) -> list[dict[str, Any]]:
    """What the records without a result say: key, attempt, error."""
    return [
        {"key": record["key"], "attempt": record["attempt"], "error": record.get("error", "")}
        for record in records
        if record["status"] != "ok"
    ]


def computing_time(records: Iterable[Record]) -> str:
    """How long all units took together, in words."""
    hours = sum(float(record.get("seconds") or 0.0) for record in records) / 3600
    return f"{hours:.2f} process hours" if hours >= 0.1 else f"{60 * hours:.1f} process minutes"


def method_names(records: Iterable[Record]) -> set[str]:
    """Every method that has a result."""
    return {name for record in finished(records) for name in record["methods"]}


def sample(records: Sequence[Record], method: str, column: Column) -> Sample:
    """The figures of `method` in `column`, in the column's unit, of the episodes that have one."""
    values, groups = {}, {}
    for record in finished(records):
        found = record["methods"].get(method)
        if found is None:
            continue
        metrics = found["metrics"]
        value = metrics.get(column.metric)
        if value is None or (column.only_if and not metrics.get(column.only_if)):
            continue
        name = record["episode"]["id"]
        if name in values:
            raise EagorError(f"the episode {name!r} has two results of {method}; give each episode an id of its own")
        values[name], groups[name] = column.scale * float(value), apartment(record)
    return Sample(values, groups)


def cell(found: Sample, column: Column) -> Cell | None:
    """The mean of a sample with its 95 % interval: Wilson's for shares, a cluster bootstrap for the rest."""
    if not found.values:
        return None
    values = np.array(list(found.values.values()))
    labels = list(found.groups.values())
    value, n, groups = float(values.mean()), len(values), len(set(labels))
    if column.share:
        interval = wilson_interval(round(float(values.sum()) / column.scale), n, LEVEL)
        return Cell(value, column.scale * interval.low, column.scale * interval.high, n, groups)
    low, high = mean_intervals(values[:, None], labels)
    return Cell(value, low[0], high[0], n, groups)


def mean_intervals(values: np.ndarray, labels: Sequence[Any]) -> tuple[list[float | None], list[float | None]]:
    """95 % intervals of the means of the columns of `values` ``(n, k)``, NaN where there is no case.

    `eagor.statistics.bootstrap_interval` with groups, for many columns at once. None with cases of fewer than two
    groups.
    """
    names = list(dict.fromkeys(labels))
    place = {name: index for index, name in enumerate(names)}
    member = np.zeros((len(names), len(labels)))
    member[[place[label] for label in labels], np.arange(len(labels))] = 1.0
    there = np.isfinite(values)
    sums, counts = member @ np.where(there, values, 0.0), member @ there
    if len(names) < 2:
        return [None] * values.shape[1], [None] * values.shape[1]
    drawn = np.random.default_rng(SEED).integers(len(names), size=(RESAMPLES, len(names)))
    times = np.stack([(drawn == index).sum(axis=1) for index in range(len(names))], axis=1).astype(float)
    total = times @ counts
    means = np.where(total > 0, (times @ sums) / np.maximum(total, 1.0), np.nan)
    told = np.count_nonzero(counts, axis=0) >= 2
    ends = np.nanquantile(np.where(told, means, 0.0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    low, high = ([float(v) if there else None for v, there in zip(row, told, strict=True)] for row in ends)
    return low, high


def gap(a: Sample, b: Sample) -> Gap | None:
    """Mean of a - b over the episodes that both have; None with fewer than two apartments."""
    shared = [name for name in a.values if name in b.values]
    labels = [a.groups[name] for name in shared]
    if len(set(labels)) < 2:
        return None
    found = paired_difference(
        [a.values[name] for name in shared],
        [b.values[name] for name in shared],
        np.random.default_rng(SEED),
        groups=labels,
        level=LEVEL,
    )
    return Gap(found.difference, found.interval.low, found.interval.high, found.p, found.n, found.groups)


def lowest_p(groups: int, tests: int = 1) -> float:
    """The p of `gap` where all `groups` agree, times the number of `tests` as `holm` has it (so perhaps above 1)."""
    return tests * 2.0 ** (1 - groups)


def holm(p: Sequence[float]) -> list[float]:
    """p-values corrected for being many, so that all rejections together are false with at most the stated chance.

    Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    most = 0.0
    for rank, index in enumerate(order):
        most = max(most, min(1.0, (len(p) - rank) * p[index]))
        corrected[index] = most
    return corrected.tolist()
