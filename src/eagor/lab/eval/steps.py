"""What the steps of episodes say: errors along the way, where they come from, and how honest the regions are.

Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's. Per
episode first (the mean over its steps), then the mean over the episodes, with intervals that resample apartments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.lab.eval.page import Curve
from eagor.lab.eval.results import Result, mean_intervals
from eagor.lab.tasks.task import group_of

LEVELS = tuple(round(0.1 * k, 1) for k in range(1, 10))  # masses of the regions in a reliability curve
UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for


def numbers(values: Sequence[float | bool | None] | None) -> np.ndarray:
    """A list of a trace as an array, NaN where it has nothing."""
    return np.array(values or (), dtype=float)


def truth_of(result: Result) -> dict[str, Any]:
    """The truth at each step, under the same names whether all methods saw the same or each went its own way."""
    if "truth" in result.record:
        return result.record["truth"]
    trace = result.answer["trace"]
    return {**trace, **{key.removeprefix("true_"): each for key, each in trace.items() if key.startswith("true_")}}


def errors(result: Result) -> np.ndarray:
    """Direction error at each step, degrees; NaN where there was nothing to point at."""
    return numbers(result.answer["trace"]["error_deg"])


def by_step(results: Sequence[Result]) -> Curve | None:
    """Mean error at each step, where at least half of the episodes have one; it ends where fewer go on."""
    found = [errors(result) for result in results]
    longest = max(map(len, found), default=0)
    values = np.array([np.pad(row, (0, longest - len(row)), constant_values=np.nan) for row in found])
    count = np.isfinite(values).sum(axis=0)
    enough = count >= max(1, len(found) / 2)
    if not enough.any():
        return None
    last = int(np.flatnonzero(enough)[-1]) + 1
    mean = np.nansum(values, axis=0) / np.maximum(count, 1)

    def cut(row: Sequence[float | None]) -> tuple[float | None, ...]:
        return tuple(value if there else None for value, there in zip(row[:last], enough[:last], strict=True))

    low, high = mean_intervals(values, [group_of(result.record) for result in results])
    return Curve(tuple(range(last)), cut(mean.tolist()), cut(low), cut(high), tuple(count[:last].tolist()))


def reliability(results: Sequence[Result]) -> Curve | None:
    """Share of steps, percent, at which the truth lay in the region of each mass (percent); None where none is said."""
    rows, labels = [], []
    for result in results:
        stated = numbers(result.answer["trace"].get("mass_above"))
        stated = stated[np.isfinite(stated)]
        if len(stated):
            rows.append([100 * float((stated < level).mean()) for level in LEVELS])
            labels.append(group_of(result.record))
    if not rows:
        return None
    low, high = mean_intervals(np.array(rows), labels)
    x = tuple(round(100 * level) for level in LEVELS)
    return Curve(x, tuple(np.mean(rows, axis=0).tolist()), tuple(low), tuple(high), (len(rows),) * len(x))


@dataclass(frozen=True)
class Part:
    """A mean over the episodes that have such steps, its 95 % interval, their number, and their share of all steps."""

    mean: float
    low: float | None
    high: float | None
    episodes: int
    share: float


def error_in(results: Sequence[Result], part: str) -> Part | None:
    """Direction error, degrees, over the steps of one part, or of `SEEN`. None where no episode has any."""

    def read(result: Result) -> tuple[np.ndarray, np.ndarray]:
        visible = np.array(truth_of(result)["visible"], dtype=bool)
        found = np.where(np.cumsum(visible) == 0, UNSEEN, np.where(visible, IN_SIGHT, HIDDEN))
        return errors(result), found != UNSEEN if part == SEEN else found == part

    return _over(results, read)


def distance_error(results: Sequence[Result]) -> Part | None:
    """Relative error of the distance, percent, once the camera has moved by `BASELINE` of it since the first sighting.

    None for methods that state no distance.
    """

    def read(result: Result) -> tuple[np.ndarray, np.ndarray]:
        truth, stated = truth_of(result), numbers(result.answer["trace"].get("distance_m"))
        true = numbers(truth["range_m"])
        if not len(stated):
            return np.zeros(0), np.zeros(0, dtype=bool)
        moved = _baselines(np.array(truth["pose"])[:, :3], np.array(truth["visible"], dtype=bool))
        asked = (moved > BASELINE * true) & (true > 0) & np.isfinite(errors(result))
        return 100 * np.abs(stated - true) / np.where(true > 0, true, np.nan), asked

    return _over(results, read)


def coverage(results: Sequence[Result], visible: bool) -> Part | None:
    """Share of steps, percent, with the truth inside the 90 % region, the target in sight or out of it."""

    def read(result: Result) -> tuple[np.ndarray, np.ndarray]:
        inside = 100 * numbers(result.answer["trace"].get("inside"))
        return inside, np.array(truth_of(result)["visible"], dtype=bool)[: len(inside)] == visible

    return _over(results, read)


def _over(results: Sequence[Result], read: Callable[[Result], tuple[np.ndarray, np.ndarray]]) -> Part | None:
    """Of the values that `read` gives of the steps of an episode, those that it chooses."""
    means, groups, used, steps = [], [], 0, 0
    for result in results:
        values, chosen = read(result)
        chosen = chosen & np.isfinite(values)
        steps += int(np.isfinite(errors(result)).sum())
        if chosen.any():
            used += int(chosen.sum())
            means.append(float(values[chosen].mean()))
            groups.append(group_of(result.record))
    if not means:
        return None
    low, high = mean_intervals(np.array(means)[:, None], groups)
    return Part(float(np.mean(means)), low[0], high[0], len(means), used / steps)


def _baselines(positions: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """At each step, the largest distance so far between two places from which the target was in sight, metres."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    apart[~seen], apart[:, ~seen] = 0.0, 0.0
    return np.maximum.accumulate(np.tril(apart).max(axis=1))
