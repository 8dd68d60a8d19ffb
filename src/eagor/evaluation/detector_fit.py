"""Fitting a `DetectorModel` on looks, with known truth or without labels: the numbers, and how sure they are.

With known truth, how far scores are believed, and what the fit is worth, is judged on groups of looks that were left
out in turn. Without labels, detections that lie near each other in the world are a thing, a look-alike, or transient
false alarms that met by chance (`detector_places`). Which of them is told by the share of looks in which a place was
detected, since things are found more often than look-alikes, and by the scores. Much of that rests on the priors: a
number that too few places or detections carry stays as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.evaluation.detector_em import (
    STARTS,
    Estimate,
    Fitting,
    ScoreCurve,
    doubt,
    expected_look_alikes,
    fitted_curve,
    knots_of,
    likeliest_errors,
    short,
)
from eagor.evaluation.detector_places import (
    ALARMS_PRIOR,
    HABIT_PRIOR,
    NUMBER_PRIOR,
    THING_PRIOR,
    Candidates,
    Split,
    candidates,
    rate_interval,
    split,
)
from eagor.evaluation.labelled_looks import Deviations, LabelledLook, Rows, in_time, rows_of, sums
from eagor.evidence.detector import Alarms, DetectorModel, model_as_json
from eagor.statistics import bootstrap_interval

__all__ = ["ENOUGH", "DetectorFit", "HeldOut", "UnlabelledFit", "fit_detector", "fit_unlabelled", "fitted_model"]

DEVIATIONS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the score curve's prior, tried on what is left out
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
PRIOR = 0.5  # probability of presence before a look
# Numbers that have an interval, and when they have none.
NUMBERS: dict[str, Callable[[Estimate], float]] = {
    "detection_share": lambda found: found.share,
    "false_alarms_per_look": lambda found: found.transient,
    "look_alikes": lambda found: math.nan if found.split is None else found.split.numbers[0],
    "spread": lambda found: found.errors.spread,
    "offset": lambda found: found.errors.offset,
    "spread_of_size": lambda found: found.errors.spread_of_size,
    "offset_of_size": lambda found: found.errors.offset_of_size,
}
UNKNOWN_WITHOUT: dict[str, Callable[[Estimate], object]] = {
    "detection_share": lambda found: found.targets,
    "look_alikes": lambda found: found.split is not None,
}


@dataclass(frozen=True)
class HeldOut:
    """Means over looks that the fit had not seen, nats: (with the model before, with the fitted one).

    `density`: log density (per steradian) at the truth after this look alone; None without targets. `presence`: log of
    the probability given to the truth about presence, from 0.5 before the look. `gain`: by how much the two together
    rose, with a 95 % interval over the parts that were left out.
    """

    density: tuple[float, float] | None
    presence: tuple[float, float]
    gain: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class DetectorFit:
    """A fitted `model`, and what it rests on.

    `targets` in view; `matched`: how many of the `detections` are of a target (a sum of probabilities). `intervals`:
    95 % intervals by name of the number, over `groups`. With one group they are over stretches of its looks, and say
    nothing of other recordings. `held_out`: None for a single look.
    """

    model: DetectorModel
    looks: int
    groups: int
    targets: int
    detections: int
    matched: float
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    held_out: HeldOut | None = None

    @property
    def false_alarms(self) -> float:
        """How many detections are of no target."""
        return self.detections - self.matched

    def as_json(self) -> dict[str, Any]:
        """Plain values, for files and ``--json``."""
        counts = {name: getattr(self, name) for name in ("looks", "groups", "targets", "detections")}
        counts |= {"matched": round(self.matched, 1), "false_alarms": round(self.false_alarms, 1)}
        judged = None
        if (told := self.held_out) is not None:
            judged = {
                "log_density": None if told.density is None else _rounded(told.density),
                "log_presence": _rounded(told.presence),
                "gain": round(told.gain, 4),
                "interval": _rounded(told.interval),
            }
        intervals = {name: _rounded(ends) for name, ends in self.intervals.items()}
        return {"detector": model_as_json(self.model), "counts": counts, "intervals": intervals, "held_out": judged}


def fit_detector(
    looks: Sequence[LabelledLook],
    base: DetectorModel | None = None,
    *,
    rng: np.random.Generator | None = None,
    resamples: int = RESAMPLES,
    on_step: Callable[[], object] = lambda: None,
) -> DetectorFit:
    """The model of the detector that gave `looks`, fitted by penalised maximum likelihood.

    `base` (default: `DetectorModel()`): the prior of each number. What the looks cannot tell is taken from it: the
    habit without a target in view, the offset and the look-alikes without orientations, `kept_for` and `kept_within`
    always. `resamples`: draws of whole groups, for the intervals; `on_step` is called after each. `rng` draws them.

    Raises `EagorError` without looks.
    """
    base, looks = base or DetectorModel(), list(looks)
    fitting, deviation, found = _fitted(looks, base)
    rows, parts = fitting.rows, _parts(looks)
    drawn, names = [], np.unique(parts)
    rng = rng or np.random.default_rng(0)
    for _ in range(resamples if len(names) > 1 else 0):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        drawn.append(fitting.estimate(times[np.searchsorted(names, parts)].astype(float), deviation, found))
        on_step()
    return DetectorFit(
        found.model(base), len(looks), len({look.group for look in looks}), len(rows.look_of_target), len(rows.scores),
        found.matched, _intervals(found, drawn, fitting, len(names)),
        _held_out(looks, fitting, deviation, found, parts) if len(names) > 1 else None,
    )  # fmt: skip


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    return _fitted(looks, base)[2].model(base)


def _fitted(looks: Sequence[LabelledLook], base: DetectorModel) -> tuple[Fitting, float, Estimate]:
    """The looks, how far their scores are believed, and the likeliest numbers."""
    rows = rows_of(looks, base)
    fitting, every = Fitting(rows, base), np.ones(rows.count)
    deviation = _deviation(fitting, _folds(_parts(looks)))
    found = fitting.estimate(every, deviation)
    if rows.placed.any():
        false = found.false(rows)
        around = candidates(rows, false, Deviations.stated(base, found.errors.spread))
        fitting = replace(fitting, found=around, false=1 - found.of(rows).right)
        found = fitting.estimate(every, deviation, found)
    return fitting, deviation, found


def _parts(looks: Sequence[LabelledLook]) -> np.ndarray:
    """A number for each look ``(L,)``: its group; where all are of one group, its stretch of consecutive looks."""
    names = list(dict.fromkeys(look.group for look in looks))
    if len(names) > 1:
        return np.array([names.index(look.group) for look in looks])
    parts = np.empty(len(looks), dtype=int)
    parts[in_time(looks)] = np.arange(len(looks)) * min(BLOCKS, len(looks)) // len(looks)
    return parts


def _folds(parts: np.ndarray) -> list[np.ndarray]:
    """Which looks ``(L,)`` are left out, in turn."""
    names = np.unique(parts)
    count = min(FOLDS, len(names))
    return [np.isin(parts, names[fold::count]) for fold in range(count)] if len(names) > 1 else []


def _deviation(fitting: Fitting, folds: Sequence[np.ndarray]) -> float:
    """How far scores are believed: what gives the looks that were left out the best likelihood.

    Of those that are within a standard error of the best, the one that believes least (Breiman et al., Classification
    and Regression Trees, 1984).
    """
    if len(fitting.knots) < 2 or not folds:
        return 0.0
    totals = np.zeros((len(folds), len(DEVIATIONS)))
    for row, left_out in zip(totals, folds, strict=True):
        found: Estimate | None = None
        for place, deviation in enumerate(DEVIATIONS):
            found = fitting.estimate((~left_out).astype(float), deviation, found)
            row[place] = left_out @ found.log_likelihoods(fitting.rows)
    behind = totals[:, [totals.sum(axis=0).argmax()]] - totals
    doubt = behind.std(axis=0, ddof=1) / math.sqrt(len(folds))
    return DEVIATIONS[int(np.flatnonzero(behind.mean(axis=0) <= doubt)[0])]


def _intervals(
    found: Estimate, drawn: Sequence[Estimate], fitting: Fitting, parts: int
) -> dict[str, tuple[float, float]]:
    """The bootstrap's intervals; those of rates at least as wide as their posteriors for independent places.

    Wider for few `parts`: expanded percentiles (Hesterberg, The American Statistician 69(4), 2015).
    """
    from scipy.special import betaincinv, ndtr, stdtrit

    ends = np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    drawn_ends = ndtr(math.sqrt(parts / (parts - 1)) * stdtrit(parts - 1, ends)) if parts > 1 else ends
    values = {name: [of(each) for each in drawn] for name, of in NUMBERS.items()}
    looks = found.looks + ALARMS_PRIOR[1]
    wide = {"false_alarms_per_look": rate_interval(found.transient * looks - ALARMS_PRIOR[0], looks, LEVEL)}
    if found.targets:
        # Looks at one place count for less than looks at as many places: that is what its habit means.
        seen = np.bincount(fitting.rows.place)
        strength = float(found.habit.sum())
        worth = float((seen * (strength + 1) / (strength + seen)).sum()) + HABIT_PRIOR
        low, high = betaincinv(worth * found.share, worth * (1 - found.share), ends).tolist()
        wide["detection_share"] = low, high
    if found.split is not None:
        views = len(np.unique(fitting.rows.stretch[fitting.rows.placed])) + NUMBER_PRIOR
        wide["look_alikes"] = rate_interval(found.split.numbers[0] * views, views, LEVEL)
    intervals = {}
    for name, of_drawn in values.items():
        if name in UNKNOWN_WITHOUT and not UNKNOWN_WITHOUT[name](found):
            continue
        least, most = wide.get(name, (math.inf, -math.inf))
        low, high = np.quantile(of_drawn, drawn_ends) if drawn else (least, most)
        low, high = float(min(low, least)), float(max(high, most))
        if low <= high:
            intervals[name] = (low, high)
    return intervals


def _held_out(
    looks: Sequence[LabelledLook], fitting: Fitting, deviation: float, found: Estimate, parts: np.ndarray
) -> HeldOut:
    """Each look read by `base`, and by the model that was fitted without it."""
    told = np.empty((len(looks), 2, 2))  # before and after; density and presence
    for left_out in _folds(parts):
        model = fitting.estimate((~left_out).astype(float), deviation, found).model(fitting.base)
        for index in np.flatnonzero(left_out).tolist():
            told[index] = [_told(looks[index], each) for each in (fitting.base, model)]
    density, presence = told[..., 0], told[..., 1]
    known = np.asarray(np.isfinite(density).all(axis=1))
    gains = np.where(known, np.diff(np.where(known[:, None], density, 0))[:, 0], 0.0) + np.diff(presence)[:, 0]
    ends = bootstrap_interval(gains, np.random.default_rng(0), LEVEL, groups=parts)
    before, after = presence.mean(axis=0).tolist()
    there = tuple(density[known].mean(axis=0).tolist()) if known.any() else None
    return HeldOut(there, (before, after), float(gains.mean()), (ends.low, ends.high))


def _told(look: LabelledLook, model: DetectorModel) -> tuple[float, float]:
    """Log density at the truth (its mean over targets; NaN without), and log probability of the truth about presence.

    Both after this look alone, from a uniform direction and `PRIOR`. One look cannot tell a look-alike from a false
    alarm, nor an offset from a spread.
    """
    spread = min(math.hypot(model.spread, model.offset), math.radians(60))
    of_size = min(math.hypot(model.spread_of_size, model.offset_of_size), 2.0)
    found = look.detections.read(replace(model, spread=spread, spread_of_size=of_size))
    targets, habits = look.in_view, model.habits
    lasting = habits.look_alikes * float(habits.alike_levels @ habits.alike_shares)
    alarms = Alarms.prior(model).after(np.full(len(found), lasting))
    inverse, covered = float(alarms.weights @ (1 / (alarms.numbers + lasting))), found.area / (4 * math.pi)
    mean = 1 + habits.mean * covered * (inverse * float((found.ratios / found.clutter).sum()) - 1)
    if not len(targets):
        return math.nan, -math.log1p(PRIOR / (1 - PRIOR) * mean) if not len(look.targets) else 0.0
    speaks = (
        inverse * found.area * found.densities(targets, np.ones(1), found.ratios[None])[0, 0] if len(found) else 0.0
    )
    at = np.log1p(habits.mean * (speaks - np.ones(len(targets)))) - math.log(4 * math.pi * mean)
    return float(at.mean()), -math.log1p((1 - PRIOR) / PRIOR / mean)


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(float(value), 4) for value in values]


# --- the likeliest numbers of a `DetectorModel` for looks without labels, by expectation-maximisation over places -----

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
UNLABELLED_RESAMPLES = 100
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
    resamples: int = UNLABELLED_RESAMPLES,
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
        places = candidates(rows, np.ones(len(rows.scores)), Deviations.stated(base, spread))
        found = _Found(places, _NOTHING, spread, -math.inf, curve)
        now = _split(rows, base, found, every)
        found = replace(found, split=now, log=now.log - doubt(spread, base.spread))
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
    errors = Deviations.stated(base, found.spread)
    return split(rows, found.candidates, every, weights, errors, numbers, habits, told=told, start=start)


def _spread(rows: Rows, base: DetectorModel, found: _Found, weights: np.ndarray) -> float:
    """The likeliest spread (radians) of detections about the centres of their places."""
    of, place = found.candidates.detection, found.candidates.place
    times = found.split.shares.sum(axis=1) * (np.bincount(rows.stretch, weights) > 0)[found.candidates.stretch]
    errors = rows.own[of], found.candidates.offsets, found.candidates.turns
    start = Deviations.stated(base, found.spread)
    return likeliest_errors(errors, place, found.split.chances, times, base, start, False, FLAT).spread


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
