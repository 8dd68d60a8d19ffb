"""Single episodes of runs of simulated tasks: what their steps say, and played again.

Before the first sighting, errors are the price of the search; in sight, the perception's; hidden, the memory's. Means
are per episode first, over its steps, then over the episodes, with intervals that resample apartments.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from eagor.errors import EagorError
from eagor.lab.envs.episodes import PER_PLACE, EpisodeSpec
from eagor.lab.eval.results import Result, Run, Value, Values, interval, mean
from eagor.lab.tasks.sim.rollout import Runner
from eagor.lab.tasks.task import finished, group_of, sample_of

UNSEEN, IN_SIGHT, HIDDEN = "before it was first seen", "in sight", "hidden again"
PARTS = (UNSEEN, IN_SIGHT, HIDDEN)
SEEN = "after it was first seen"  # in sight or hidden again
DISTANCE, COVERED, COVERED_HIDDEN = "distance", "covered in sight", "covered out of sight"
COLUMNS = (*PARTS, SEEN, DISTANCE, COVERED, COVERED_HIDDEN)
BASELINE = 0.1  # of the distance: by so much the camera has to have moved before a distance is asked for


def numbers(values: Sequence[float | bool | None] | None, count: int = 0) -> np.ndarray:
    """A list of a trace as an array, NaN where it has nothing; `count` of these for a trace without the list."""
    return np.array(values or [None] * count, dtype=float)


def by_step(results: Sequence[Result]) -> list[float | None]:
    """Mean error at each step, where at least half of the episodes have one; it ends where fewer go on."""
    columns = zip_longest(*(result.answer["trace"]["error_deg"] for result in results))
    there = ([error for error in column if error is not None] for column in columns)
    curve = [float(np.mean(errors)) if len(errors) >= max(1, len(results) / 2) else None for errors in there]
    while curve and curve[-1] is None:
        curve.pop()
    return curve


def parts(results: Sequence[Result]) -> tuple[dict[str, tuple[float, list[float] | None]], dict[str, float]]:
    """Means over the episodes that have such steps, with 95 % intervals, and the share of each part of all steps.

    - `PARTS` and `SEEN`: the direction error, degrees, over the steps of that part;
    - `DISTANCE`: relative error of the distance, percent, once the camera has moved by `BASELINE` of it since the first
      sighting;
    - `COVERED` and `COVERED_HIDDEN`: share of steps, percent, with the truth inside the 90 % region, the target in
      sight, and out of it.
    """
    found: dict[str, Values] = {name: {} for name in COLUMNS}
    counts: Counter[str] = Counter()
    for record, answer in results:
        trace = answer["trace"]
        # Where each method goes its own way, its trace has the truth.
        truth = record.get("truth") or {key.removeprefix("true_"): each for key, each in trace.items()}
        error, visible = numbers(trace["error_deg"]), np.array(truth["visible"], dtype=bool)
        since = np.logical_or.accumulate(visible)
        inside = 100 * numbers(trace.get("inside"), len(error))
        true, stated = numbers(truth["range_m"]), numbers(trace.get("distance_m"), len(error))
        moved = _baselines(np.array(truth["pose"])[:, :3], visible) > BASELINE * true
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.where(np.isfinite(error), 100 * np.abs(stated - true) / true, np.nan)
        chosen = [
            (error, ~since), (error, visible), (error, since & ~visible), (error, since),
            (off, moved & (true > 0)), (inside, visible), (inside, ~visible),
        ]  # fmt: skip
        for name, (values, where) in zip(COLUMNS, chosen, strict=True):
            if len(kept := values[where & np.isfinite(values)]):
                counts[name] += len(kept)
                found[name][sample_of(record)] = Value(float(kept.mean()), str(group_of(record)))
    means = {name: (mean(values), interval(values)) for name, values in found.items() if values}
    return means, {name: counts[name] / (counts[UNSEEN] + counts[SEEN]) for name in PARTS if counts[name]}


def _baselines(positions: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """At each step, the largest distance so far between two places from which the target was in sight, metres."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    apart[~seen], apart[:, ~seen] = 0.0, 0.0
    return np.maximum.accumulate(np.tril(apart).max(axis=1))


def runner_of(run: Run, case: str) -> tuple[Runner, EpisodeSpec]:
    """What plays a case of a run again, and its spec.

    Raises `EagorError` for answers to published data, or an unknown case.
    """
    if not run.simulated:
        raise EagorError(f"only episodes of simulated tasks can be played again, and {run.task.name} has none")
    records = {sample_of(record): record for record in finished(run.records)}
    if case not in records:
        raise EagorError(f"the run has no case {case!r}; it has {', '.join(records)[:200] or 'none'}")
    episode, first = records[case]["episode"], run.settings.get("seed")
    world, seed, index = (episode.get(key) for key in ("world", "seed", "index"))
    if not (isinstance(world, str) and all(isinstance(value, int) for value in (first, seed, index))):
        raise EagorError(
            f"the record {records[case]['key']!r} does not say which episode it is of; it cannot be played again"
        )
    number = (seed - first) * PER_PLACE + index  # by which some tasks deal their scenarios
    return Runner(dict(run.settings)), EpisodeSpec(run.task.name, world, seed, index, number)
