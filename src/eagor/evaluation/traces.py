"""What the steps of episodes say: errors around turns and seam crossings and along the way; where they come from.

Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's. Per
episode first (the mean over its events or steps), then the mean over the episodes, with intervals that resample
apartments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.evaluation.page import Curve
from eagor.evaluation.samples import Record, group_of, mean_intervals, numbers, played_by
from eagor.metrics import seam_crossings
from eagor.sphere import direction

BEFORE, AFTER = 4, 14  # steps shown about a turn
ABOUT_SEAM = 6
LEVELS = tuple(round(0.1 * k, 1) for k in range(1, 10))  # masses of the regions in a reliability curve
UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for

Events = Callable[[Record, str], Sequence[int]]


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


@dataclass(frozen=True)
class Part:
    """A mean over the episodes that have such steps, its 95 % interval, their number, and their share of all steps."""

    mean: float
    low: float | None
    high: float | None
    episodes: int
    share: float


def error_in(records: Sequence[Record], method: str, part: str) -> Part | None:
    """Direction error, degrees, over the steps of one part, or of `SEEN`. None where no episode has any."""

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        found = _parts(truth)
        return numbers(trace["error_deg"]), found != UNSEEN if part == SEEN else found == part

    return _over(records, method, read)


def distance_error(records: Sequence[Record], method: str) -> Part | None:
    """Relative error of the distance, percent, once the camera has moved by `BASELINE` of it since the first sighting.

    None for methods that state no distance.
    """

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        stated, true = numbers(trace.get("distance_m") or []), numbers(truth.get("range_m") or trace["true_range_m"])
        if not len(stated):
            return np.zeros(0), np.zeros(0, dtype=bool)
        moved = _baselines(np.array(truth["pose"])[:, :3], np.array(truth["visible"], dtype=bool))
        asked = (moved > BASELINE * true) & (true > 0) & np.isfinite(numbers(trace["error_deg"]))
        return 100 * np.abs(stated - true) / np.where(true > 0, true, np.nan), asked

    return _over(records, method, read)


def coverage(records: Sequence[Record], method: str, visible: bool) -> Part | None:
    """Share of steps, percent, with the truth inside the 90 % region, the target in sight or out of it."""

    def read(trace: dict, truth: dict) -> tuple[np.ndarray, np.ndarray]:
        inside = 100 * numbers(trace.get("inside") or [])
        return inside, np.array(truth["visible"], dtype=bool)[: len(inside)] == visible

    return _over(records, method, read)


def _over(
    records: Sequence[Record], method: str, read: Callable[[dict, dict], tuple[np.ndarray, np.ndarray]]
) -> Part | None:
    means, groups, used, steps = [], [], 0, 0
    for record in played_by(records, method):
        trace = record["methods"][method]["trace"]
        values, chosen = read(trace, record.get("truth", trace))
        chosen = chosen & np.isfinite(values)
        steps += int(np.isfinite(numbers(trace["error_deg"])).sum())
        if chosen.any():
            used += int(chosen.sum())
            means.append(float(values[chosen].mean()))
            groups.append(group_of(record))
    if not means:
        return None
    low, high = mean_intervals(np.array(means)[:, None], groups)
    return Part(float(np.mean(means)), low[0], high[0], len(means), used / steps)


def _parts(truth: dict) -> np.ndarray:
    """Which part each step belongs to."""
    seen = np.array(truth["visible"], dtype=bool)
    before = np.cumsum(seen) == 0
    return np.where(before, UNSEEN, np.where(seen, IN_SIGHT, HIDDEN))


def _baselines(positions: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """At each step, the largest distance so far between two places from which the target was in sight, metres."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    apart[~seen], apart[:, ~seen] = 0.0, 0.0
    return np.maximum.accumulate(np.tril(apart).max(axis=1))
