"""The likeliest numbers of a `DetectorModel` for looks without labels, by expectation-maximisation over places.

Detections that lie near each other in the world are a thing, a look-alike, or transient false alarms that met by chance
(`detector_places`). Which of them is told by the share of looks in which a place was detected, since things are found
more often than look-alikes, and by the scores. Much of that rests on the priors: a number that too few places or
detections carry stays as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.evaluation.detector_em import (
    STARTS,
    ScoreCurve,
    doubt,
    expected_look_alikes,
    fitted_curve,
    knots_of,
    likeliest_errors,
    short,
)
from eagor.evaluation.detector_places import (
    NUMBER_PRIOR,
    THING_PRIOR,
    Candidates,
    Split,
    candidates,
    rate_interval,
    split,
)
from eagor.evaluation.labelled_looks import LabelledLook, Rows, rows_of, sums
from eagor.evidence.detector import DetectorModel, model_as_json

__all__ = ["ENOUGH", "UnlabelledFit", "fit_unlabelled"]

THINGS = math.log(2)  # expected number of things of one query: there is one or more with probability 0.5
ROUNDS, SETTLED = 8, 0.01  # most rounds of candidates, and the relative change of the spread at which they end
FLAT = 1.0  # radians: a place may have its centre anywhere
DEVIATION = 1.0  # of the score curve's prior
# What carries a number, and how much of it a number asks for.
ENOUGH = {
    "habit": (3, "things"),
    "look_alikes": (3, "views"),
    "look_alike_habit": (3, "look-alikes"),
    "false_alarms_per_look": (10, "looks"),
    "spread": (10, "detections beyond the first of a place"),
    "score_ratios": (20, "right and as many false scores"),
}
RESAMPLES, LEVEL = 100, 0.95
ENDS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


@dataclass(frozen=True)
class UnlabelledFit:
    """A fitted `model`, the prior `base`, and what each number rests on.

    `carried`: by name of a number, how much of what `ENOUGH` says carries it. `things`: how many of the thing there
    are on average, for each query and view. `intervals`: 95 % intervals of what they tell, over groups.
    """

    model: DetectorModel
    base: DetectorModel
    looks: int
    groups: int
    detections: int
    things: float
    carried: dict[str, float]
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)

    def tells(self, name: str) -> bool:
        """Whether the looks tell this number; else it is that of the prior."""
        return self.carried[name] >= ENOUGH[name][0]

    def as_json(self) -> dict[str, Any]:
        """Plain values, for files and ``--json``."""
        counts = {name: getattr(self, name) for name in ("looks", "groups", "detections")}
        numbers = {name: {"carried": round(value, 1), "told": self.tells(name)} for name, value in self.carried.items()}
        return {
            "detector": model_as_json(self.model),
            "prior": model_as_json(self.base),
            "counts": counts | {"things": round(self.things, 2)},
            "numbers": numbers,
            "intervals": {name: [round(end, 4) for end in ends] for name, ends in self.intervals.items()},
        }


def fit_unlabelled(
    looks: Sequence[LabelledLook],
    base: DetectorModel | None = None,
    *,
    rng: np.random.Generator | None = None,
    resamples: int = RESAMPLES,
    on_step: Callable[[], object] = lambda: None,
) -> UnlabelledFit:
    """The model of the detector that gave `looks`, whose targets are not read.

    Each look needs its `world_R_body`; a `group` is one query in one recording. `base` (default: `DetectorModel()`):
    the prior of each number. The offset, `kept_for` and `kept_within` stay as they are there. `resamples`: draws of
    whole groups, for the intervals; `on_step` is called after each. `rng` draws them.

    Raises `EagorError` without looks.
    """
    from scipy.special import betaincinv

    base = base or DetectorModel()
    rows = rows_of([replace(look, targets=np.zeros((0, 3))) for look in looks], base)
    best = max((_climbed(rows, base, factor * base.spread) for factor in STARTS), key=lambda each: each.log)
    carried, numbers = _carried(rows, best), _numbers(best)
    values = {name: value for name, value in numbers.items() if carried[name] >= ENOUGH[name][0]}
    if "habit" in values:
        values["detection_probability"] = None
    names, parts = np.unique([look.group for look in looks], return_inverse=True)
    drawn, rng = [], rng or np.random.default_rng(0)
    for _ in range(resamples if len(names) > 1 else 0):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        again = replace(best, split=_split(rows, base, best, times[parts].astype(float)))
        drawn.append(replace(again, spread=_spread(rows, base, again, times[parts].astype(float))))
        on_step()
    things, alikes = best.split.numbers.tolist()
    views = carried["look_alikes"] + NUMBER_PRIOR
    habit = best.split.habits[0]
    worth = (carried["habit"] + THING_PRIOR) * (1 + habit.sum()) / habit.sum()  # as many looks, all independent
    wide = {
        "detection_share": betaincinv(*(worth * habit), ENDS).tolist(),
        "look_alikes": rate_interval(alikes * views, views, LEVEL),
        "false_alarms_per_look": rate_interval(best.split.alarms * rows.count, rows.count, LEVEL),
    }
    intervals = {}
    for name, of in _SCALARS.items():
        if drawn and ("habit" if name == "detection_share" else name) in values:
            low, high = np.quantile([of(each) for each in drawn], ENDS).tolist()
            least, most = wide.get(name, (low, high))
            intervals[name] = (min(low, least), max(high, most))
    model = replace(base, **values)
    return UnlabelledFit(model, base, rows.count, len(names), len(rows.scores), things, carried, intervals)


@dataclass(frozen=True, eq=False)
class _Found:
    """Candidates, their `split` into things and look-alikes, and the numbers that it was made with."""

    candidates: Candidates
    split: Split
    spread: float
    log: float
    curve: ScoreCurve | None = None

    @property
    def things(self) -> np.ndarray:
        """How probably each detection ``(M,)`` of a candidate is of a thing."""
        return self.split.chances * self.split.shares[self.candidates.place, 0]


_SCALARS: dict[str, Callable[[_Found], float]] = {
    "detection_share": lambda found: found.split.habits[0, 0] / found.split.habits[0].sum(),
    "look_alikes": lambda found: found.split.numbers[1],
    "false_alarms_per_look": lambda found: found.split.alarms,
    "spread": lambda found: found.spread,
}


def _climbed(rows: Rows, base: DetectorModel, spread: float) -> _Found:
    """The likeliest numbers from this spread on: candidates, what they are, their scatter and scores, and again."""
    curve, every, rounds = None, np.ones(rows.count), 0
    while True:
        found = _Found(candidates(rows, np.ones(len(rows.scores)), spread), _NOTHING, spread, -math.inf, curve)
        now = _split(rows, base, found, every)
        found = replace(found, split=now, log=now.log - doubt(spread, base))
        curve, before, rounds = _curve(rows, found), spread, rounds + 1
        spread = _spread(rows, base, found, every)
        if rounds == ROUNDS or abs(spread / before - 1) < SETTLED:
            return replace(found, spread=spread, curve=curve)


def _split(rows: Rows, base: DetectorModel, found: _Found, weights: np.ndarray) -> Split:
    """What the candidates are, in looks that count `weights` ``(L,)``."""
    numbers, habits = np.array([THINGS, expected_look_alikes(base)]), np.array([base.habit, base.look_alike_habit])
    of, place = found.candidates.detection, found.candidates.place
    logs = np.zeros(len(rows.scores))
    if found.curve is not None:
        logs = found.curve.at(rows.scores)
    elif base.score_ratios is not None:
        logs = np.log(base.ratios(rows.scores, len(rows.scores)))
    told = np.zeros((len(found.candidates.stretch), 2))
    told[:, 0] = sums(place, logs[of], len(told)) / np.bincount(place, minlength=len(told))
    start = None if found.split is _NOTHING else found.split
    every = np.ones(len(rows.scores))
    return split(rows, found.candidates, every, weights, found.spread, numbers, habits, told=told, start=start)


def _spread(rows: Rows, base: DetectorModel, found: _Found, weights: np.ndarray) -> float:
    """The likeliest spread (radians) of detections about the centres of their places."""
    of, place = found.candidates.detection, found.candidates.place
    times = found.split.shares.sum(axis=1) * (np.bincount(rows.stretch, weights) > 0)[found.candidates.stretch]
    errors = rows.own[of], found.candidates.offsets, found.candidates.turns
    return likeliest_errors(errors, place, found.split.chances, times, base, (found.spread, 0.0), False, FLAT)[0]


def _curve(rows: Rows, found: _Found) -> ScoreCurve | None:
    """How much likelier each score is for things; None where too few scores tell it."""
    right = np.zeros(len(rows.scores))
    right[found.candidates.detection] = found.things
    if min(right.sum(), (1 - right).sum()) < ENOUGH["score_ratios"][0]:
        return None
    return fitted_curve(rows.scores, right, np.ones(len(right)), knots_of(rows.scores), DEVIATION)


def _numbers(found: _Found) -> dict[str, Any]:
    """Fields of `DetectorModel`."""
    habits = [tuple(map(short, habit)) for habit in found.split.habits.tolist()]
    curve = () if found.curve is None else found.curve.pairs
    return {
        "habit": habits[0],
        "look_alikes": short(float(found.split.numbers[1])),
        "look_alike_habit": habits[1],
        "false_alarms_per_look": short(found.split.alarms),
        "spread": short(found.spread),
        "score_ratios": tuple((short(at), short(ratio)) for at, ratio in curve) or None,
    }


def _carried(rows: Rows, found: _Found) -> dict[str, float]:
    """How much of what `ENOUGH` says carries each number."""
    shares, hits = found.split.shares, found.split.hits
    right = float(found.things.sum())
    return {
        "habit": float(shares[:, 0].sum()),
        "look_alikes": float((found.candidates.exposure.max(axis=1) > 0).sum()),
        "look_alike_habit": float(shares[:, 1].sum()),
        "false_alarms_per_look": float(rows.count),
        "spread": float(shares.sum(axis=1) @ np.maximum(hits - 1, 0)),
        "score_ratios": 0.0 if found.curve is None else min(right, len(rows.scores) - right),
    }


_NOTHING = Split(0.0, np.zeros(2), np.zeros((2, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), -math.inf)
