"""Errors against steps: around turns and seam crossings, along an episode; and how honest the regions are.

Per episode first (the mean over its events), then the mean over the episodes, with intervals that resample apartments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.evaluation.samples import Record, group_of, mean_intervals, numbers, played_by
from eagor.metrics import seam_crossings
from eagor.sphere import direction

BEFORE, AFTER = 4, 14  # steps shown about a turn
ABOUT_SEAM = 6
LEVELS = tuple(round(0.1 * k, 1) for k in range(1, 10))  # masses of the regions in a reliability curve

Events = Callable[[Record, str], Sequence[int]]


@dataclass(frozen=True)
class Curve:
    """A mean `y` at each `x` with its interval, over `n` episodes; None where too few episodes have a case."""

    x: tuple[float, ...]
    y: tuple[float | None, ...]
    low: tuple[float | None, ...]
    high: tuple[float | None, ...]
    n: tuple[int, ...]


def errors(record: Record, method: str) -> np.ndarray:
    """Direction error at each step, degrees; NaN where there was nothing to point at."""
    return numbers(record["methods"][method]["trace"]["error_deg"])


def turns(record: Record, method: str) -> list[int]:
    """The steps at which a leg but the first begins."""
    legs = record["truth"]["leg"]
    return [k for k in range(1, len(legs)) if legs[k] != legs[k - 1]]


def crossings(record: Record, method: str) -> list[int]:
    """The steps at which the true bearing crosses the seam; of the method's own way, where each goes its own."""
    if "truth" in record:
        return [int(k) for k in np.flatnonzero(record["truth"]["seam"])]
    azimuth = np.radians(numbers(record["methods"][method]["trace"]["true_azimuth_deg"]))
    return [int(k) for k in np.flatnonzero(seam_crossings(direction(azimuth, 0 * azimuth)))]


def around(
    records: Sequence[Record], method: str, events: Events, before: int, after: int, alone: bool = False
) -> Curve | None:
    """Error of `method` from `before` steps before to `after` steps after the events of each episode; None without any.

    `alone` leaves out steps that belong to the neighbouring events.
    """
    rows, labels = [], []
    for record in played_by(records, method):
        found, where = errors(record, method), events(record, method)
        windows = []
        for index, event in enumerate(where):
            window = np.full(before + after + 1, np.nan)
            first = max(event - before, where[index - 1] if alone and index else 0)
            last = min(event + after, (where[index + 1] if alone and index + 1 < len(where) else len(found)) - 1)
            window[first - event + before : last - event + before + 1] = found[first : last + 1]
            windows.append(window)
        if windows:
            rows.append(_mean(np.array(windows)))
            labels.append(group_of(record))
    return _curve(range(-before, after + 1), rows, labels)


def by_step(records: Sequence[Record], method: str) -> Curve | None:
    """Error of `method` at each step. It ends where fewer than half of the episodes go on."""
    found = [(errors(record, method), group_of(record)) for record in played_by(records, method)]
    longest = max((len(values) for values, _ in found), default=0)
    rows = [np.pad(values, (0, longest - len(values)), constant_values=np.nan) for values, _ in found]
    return _curve(range(longest), rows, [label for _, label in found])


def reliability(records: Sequence[Record], method: str) -> Curve | None:
    """Share of steps, percent, at which the truth lay in the region of each mass (percent); None where none is said."""
    rows, labels = [], []
    for record in played_by(records, method):
        stated = numbers(record["methods"][method]["trace"].get("mass_above") or [])
        stated = stated[np.isfinite(stated)]
        if len(stated):
            rows.append(np.array([100 * float((stated < level).mean()) for level in LEVELS]))
            labels.append(group_of(record))
    return _curve([round(100 * level) for level in LEVELS], rows, labels)


def _mean(rows: np.ndarray) -> np.ndarray:
    """Mean over the rows, without NaN; NaN where there is nothing else."""
    there = np.isfinite(rows)
    count = there.sum(axis=0)
    return np.where(count > 0, np.where(there, rows, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _curve(x: Sequence[float], rows: Sequence[np.ndarray], labels: Sequence[object]) -> Curve | None:
    """The mean of `rows`; it has a value where at least half of them do."""
    if not rows:
        return None
    values = np.array(rows)
    count = np.isfinite(values).sum(axis=0)
    kept = count >= max(1, len(rows) / 2)
    low, high = mean_intervals(values, labels)
    mean = _mean(values)
    last = int(np.flatnonzero(kept)[-1]) + 1 if kept.any() else 0
    if not last:
        return None
    return Curve(
        tuple(x[:last]),
        tuple(float(m) if k else None for m, k in zip(mean[:last], kept, strict=False)),
        tuple(v if k else None for v, k in zip(low[:last], kept, strict=False)),
        tuple(v if k else None for v, k in zip(high[:last], kept, strict=False)),
        tuple(int(c) for c in count[:last]),
    )
