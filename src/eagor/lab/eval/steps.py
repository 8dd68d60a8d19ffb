"""What the steps of episodes say: errors around turns and seam crossings and along the way; where they come from.

Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's. Per
episode first (the mean over its events or steps), then the mean over the episodes, with intervals that resample
apartments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.lab.eval.charts import Curve
from eagor.lab.eval.results import Result, mean_intervals
from eagor.lab.tasks.task import group_of
from eagor.metrics import seam_crossings
from eagor.sphere import direction

BEFORE, AFTER = 4, 14  # steps shown about a turn
ABOUT_SEAM = 6
LEVELS = tuple(round(0.1 * k, 1) for k in range(1, 10))  # masses of the regions in a reliability curve
UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for

Events = Callable[[Result], Sequence[int]]


def numbers(values: Sequence[float | bool | None] | None) -> np.ndarray:
    """A list of a trace as an array, NaN where it has nothing."""
    return np.array([np.nan if value is None else float(value) for value in values or ()])


def truth_of(result: Result) -> dict[str, Any]:
    """The truth at each step, under the same names whether all methods saw the same or each went its own way."""
    if "truth" in result.record:
        return result.record["truth"]
    trace = result.answer["trace"]
    return {**trace, **{key.removeprefix("true_"): each for key, each in trace.items() if key.startswith("true_")}}


def errors(result: Result) -> np.ndarray:
    """Direction error at each step, degrees; NaN where there was nothing to point at."""
    return numbers(result.answer["trace"]["error_deg"])


def turns(result: Result) -> list[int]:
    """The steps at which a leg but the first begins."""
    legs = truth_of(result).get("leg") or ()
    return [k for k in range(1, len(legs)) if legs[k] != legs[k - 1]]


def crossings(result: Result) -> list[int]:
    """The steps at which the true bearing crosses the seam."""
    truth = truth_of(result)
    if "seam" in truth:
        return np.flatnonzero(truth["seam"]).tolist()
    azimuth = np.radians(numbers(truth["azimuth_deg"]))
    return np.flatnonzero(seam_crossings(direction(azimuth, 0 * azimuth))).tolist()


def around(results: Sequence[Result], events: Events, before: int, after: int, alone: bool = False) -> Curve | None:
    """Error from `before` steps before to `after` steps after the events of each episode; None without any.

    `alone` leaves out steps that belong to the neighbouring events.
    """
    rows, labels = [], []
    for result in results:
        found, where = errors(result), events(result)
        windows = np.full((len(where), before + after + 1), np.nan)
        for index, event in enumerate(where):
            first = max(event - before, where[index - 1] if alone and index else 0)
            last = min(event + after, (where[index + 1] if alone and index + 1 < len(where) else len(found)) - 1)
            windows[index, first - event + before : last - event + before + 1] = found[first : last + 1]
        if len(windows):
            rows.append(_mean(windows))
            labels.append(group_of(result.record))
    return _curve(range(-before, after + 1), rows, labels)


def by_step(results: Sequence[Result]) -> Curve | None:
    """Error at each step. It ends where fewer than half of the episodes go on."""
    found = [errors(result) for result in results]
    longest = max(map(len, found), default=0)
    rows = [np.pad(values, (0, longest - len(values)), constant_values=np.nan) for values in found]
    return _curve(range(longest), rows, [group_of(result.record) for result in results])


def reliability(results: Sequence[Result]) -> Curve | None:
    """Share of steps, percent, at which the truth lay in the region of each mass (percent); None where none is said."""
    rows, labels = [], []
    for result in results:
        stated = numbers(result.answer["trace"].get("mass_above"))
        stated = stated[np.isfinite(stated)]
        if len(stated):
            rows.append(np.array([100 * float((stated < level).mean()) for level in LEVELS]))
            labels.append(group_of(result.record))
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
    enough = count >= max(1, len(rows) / 2)
    if not enough.any():
        return None
    last = int(np.flatnonzero(enough)[-1]) + 1

    def cut(found: Sequence[float | None] | np.ndarray) -> tuple[float | None, ...]:
        pairs = zip(found[:last], enough, strict=False)
        return tuple(float(v) if there and v is not None else None for v, there in pairs)

    low, high = mean_intervals(values, labels)
    return Curve(tuple(x[:last]), cut(_mean(values)), cut(low), cut(high), tuple(count[:last].tolist()))


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
