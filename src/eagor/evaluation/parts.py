"""Where errors come from: before the target was first in sight, while it is, while it is hidden again; and distance.

Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.evaluation.samples import Record, group_of, mean_intervals, numbers, played_by

UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for


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
