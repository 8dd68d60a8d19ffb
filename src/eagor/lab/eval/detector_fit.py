"""Fitting a `DetectorModel` on looks with known truth, by penalised maximum likelihood: the numbers, and how sure.

Expectation-maximisation: the assignments of detections to targets (`assignments`), then each number from them, with
weak priors where the looks say little. How far scores are believed, and what the fit is worth, is judged on groups of
looks that were left out in turn.

How many times likelier a target gives a score than a false alarm does is a rising curve. The ratio of two densities is
a logistic regression of "right or false" on the score (Prentice and Pyke, Biometrika 66(3), 1979). The logarithm of the
ratio is linear between a few knots and never falls. A normal prior on its rises draws it towards 1 for every score: few
scores say little.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from eagor._values import lazy
from eagor.evidence.detector import LEAST_OF_SIZE, Alarms, DetectorModel, model_as_json
from eagor.lab.eval.assignments import (
    ALARMS_PRIOR,
    HABIT_PRIOR,
    NUMBER_PRIOR,
    Assigned,
    Candidates,
    Deviations,
    LookAlikes,
    Rows,
    candidates,
    fitted_habit,
    in_time,
    look_alikes,
    once,
    rows_of,
    sums,
)
from eagor.lab.eval.labelled_looks import LabelledLook
from eagor.statistics import bootstrap_interval

__all__ = [
    "FLAT", "DetectorFit", "HeldOut", "fit_detector", "fitted_curve", "fitted_model", "knots_of", "scatter",
    "short", "told",
]  # fmt: skip

KNOTS = 5  # most places of the curve
EACH = 8  # scores that each knot asks for
FEWEST = 1.0  # right or false scores, below which nothing is known of the curve
DEVIATIONS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the score curve's prior, tried on what is left out
SPREAD_PRIOR = 2.0  # detections that the prior of the spread counts for
OFFSET_PRIOR = 2.0  # places, with one detection each, that the prior of the offset counts for
NARROWEST, WIDEST = math.radians(0.2), math.radians(40)  # spreads that are tried
STARTS = (0.4, 1.0, 2.5)  # times the stated spread: where the search begins
STEPS, SETTLED = 60, 1e-3  # most steps, and the relative change of every number at which they end
LEAST_RECALL, MOST_RECALL = 0.001, 0.99
BESIDE = 2.5  # widths about a target in which a second detection is no look-alike
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
PRIOR = 0.5  # probability of presence before a look


def short(value: float) -> float:
    """`value` with the three digits that mean something."""
    return float(f"{value:.3g}")


# --- the numbers -----------------------------------------------------------------------------------------------------


Curve = tuple[
    np.ndarray, np.ndarray
]  # scores ``(K,)``, and logarithms of ratios there; linear between, constant beyond
FLAT = np.array([0.0, 1.0]), np.zeros(2)  # ratio 1 for every score


def knots_of(scores: np.ndarray) -> np.ndarray:
    """The places ``(K,)`` of a curve for these scores ``(n,)``: quantiles; fewer than two where all are alike."""
    count = min(KNOTS, max(2, len(scores) // EACH))
    return np.unique(np.quantile(scores, np.linspace(0, 1, count))) if len(scores) else np.zeros(0)


def fitted_curve(
    scores: np.ndarray, right: np.ndarray, weights: np.ndarray, knots: np.ndarray, deviation: float
) -> Curve:
    """The curve for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. `deviation`: standard deviation, in the prior, of the logarithm of the
    ratio between the lowest and the highest score; 0: the flat curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    if deviation <= 0 or len(knots) < 2 or min(positive.sum(), negative.sum()) < FEWEST:
        return FLAT
    from scipy.optimize import minimize

    rises = len(knots) - 1
    # Column k is how far a score lies through the k-th gap between knots, in [0, 1].
    through = np.clip((scores[:, None] - knots[:-1]) / np.diff(knots), 0, 1)
    variance = deviation**2 / rises

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        odds = values[0] + through @ values[1:]
        above = positive @ np.logaddexp(0, -odds) + negative @ np.logaddexp(0, odds)
        slope = weights / (1 + np.exp(-np.clip(odds, -500, 500))) - positive
        gradient = np.concatenate([[slope.sum()], slope @ through + values[1:] / variance])
        return float(above + values[1:] @ values[1:] / (2 * variance)), gradient

    prior = math.log(positive.sum() / negative.sum())
    start = np.concatenate([[prior], np.zeros(rises)])
    bounds = [(None, None), *[(0, None)] * rises]
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    return knots, found[0] - prior + np.concatenate([[0.0], np.cumsum(found[1:])])


def scatter(
    errors: tuple[np.ndarray, np.ndarray, np.ndarray],
    place: np.ndarray,
    counts: np.ndarray,
    times: np.ndarray,
    deviations: Deviations,
) -> float:
    """Log likelihood of detections about their places, with such `deviations`.

    What a place keeps is taken to be round, and that of its mean box. `errors` of each of n detections: variances
    ``(n, 2)`` of its box along its axes, offsets ``(n, 2)`` along them, and these axes in the plane of the place ``(n,
    2, 2)``. Its `place` ``(n,)``, and how often it counts there. `times` ``(C,)``: how often each place counts.
    """
    own, offsets, turns = errors
    variances = deviations.each(own)
    scaled, precisions = offsets / variances, 1 / variances
    alone = (np.log(variances) + offsets * scaled).sum(axis=1)
    pull = np.einsum("nij,ni->jn", turns, scaled) * counts
    hold = np.einsum("nij,nik,ni->jkn", turns, turns, precisions) * counts
    x, y = (np.bincount(place, each, len(times)) for each in pull)
    a, b, d = (np.bincount(place, each, len(times)) for each in (hold[0, 0], hold[0, 1], hold[1, 1]))
    # |1 + o^2 W|, and pull (W + 1 / o^2)^-1 pull.
    area = np.bincount(place, counts * own.mean(axis=1), len(times))
    square = deviations.kept(area / np.maximum(np.bincount(place, counts, len(times)), 1e-300))
    determinant = (1 + square * a) * (1 + square * d) - (square * b) ** 2
    kept = square * ((1 + square * d) * x * x - 2 * square * b * x * y + (1 + square * a) * y * y) / determinant
    return 0.5 * float(times @ (kept - np.log(determinant)) - (times[place] * counts) @ alone)


def _likeliest_errors(
    log_likelihood: Callable[[Deviations], float], base: DetectorModel, start: Deviations, told_apart: bool
) -> Deviations:
    """The likeliest deviations, with their priors in `base`; all but the spread as there, unless `told_apart`."""
    from scipy.optimize import minimize, minimize_scalar

    low, high = math.log(NARROWEST), math.log(WIDEST)
    if not told_apart:

        def alone(log: float) -> float:
            return _doubt(math.exp(log), base.spread) - log_likelihood(Deviations.stated(base, math.exp(log)))

        return Deviations.stated(base, math.exp(minimize_scalar(alone, bounds=(low, high), method="bounded").x))

    def deviations(values: np.ndarray) -> Deviations:
        return Deviations(math.exp(values[0]), values[1] * base.spread, math.exp(values[2]), float(values[3]))

    def every(values: np.ndarray) -> float:
        now = deviations(values)
        prior = _doubt(now.spread, base.spread) + _doubt(now.spread_of_size, base.spread_of_size)
        prior += _doubt_of_kept(now.offset, base.offset, base.spread)
        prior += _doubt_of_kept(now.offset_of_size, base.offset_of_size, base.spread_of_size)
        return prior - log_likelihood(now)

    bounds = [(low, high), (0.0, WIDEST / base.spread), (math.log(LEAST_OF_SIZE), math.log(2)), (0.0, 2.0)]
    first = [math.log(start.spread), max(start.offset, 0.3 * start.spread) / base.spread]
    first += [math.log(start.spread_of_size), max(start.offset_of_size, 0.1)]
    return deviations(minimize(every, np.array(first), bounds=bounds, method="L-BFGS-B").x)


def _doubt(spread: float, stated: float) -> float:
    """Minus the log prior of a spread: normal in its logarithm, about the stated one.

    Each of two axes of a detection brings a Fisher information of 2 about that logarithm.
    """
    return 2 * SPREAD_PRIOR * math.log(spread / stated) ** 2


def _doubt_of_kept(value: float, stated: float, one: float) -> float:
    """Minus the log prior of what a place keeps: `OFFSET_PRIOR` places with a detection each; `one`: its deviation."""
    wide = value**2 + one**2
    return OFFSET_PRIOR * (math.log(wide) + (stated**2 + one**2) / wide)


# --- expectation and maximisation ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Estimate:
    """Numbers of the model, in a fit.

    `habit` ``(2,)``; `recalls` ``(C,)``: how often each place of a target is detected. `alarms`: all false detections
    of a look, which `alikes` tells apart, where poses are known. `matched`: how many detections are of a target; `log`:
    the log posterior density.
    """

    habit: np.ndarray
    recalls: np.ndarray
    alarms: float
    errors: Deviations
    curve: Curve
    matched: float = 0.0
    log: float = -math.inf
    alikes: LookAlikes | None = None

    @property
    def share(self) -> float:
        """The mean share of looks in which a target is detected."""
        return float(self.habit[0] / self.habit.sum())

    @property
    def transient(self) -> float:
        """The false detections of a look that do not come again; all of them, where poses are not known."""
        return self.alarms if self.alikes is None else self.alikes.alarms

    @property
    def settled(self) -> np.ndarray:
        """The numbers ``(4,)`` that stand still at the end of a fit."""
        at = self.errors
        sides = math.hypot(at.spread, at.offset), math.hypot(at.spread_of_size, at.offset_of_size)
        return np.array([self.share, self.alarms, *sides])

    def of(self, rows: Rows) -> Assigned:
        """The assignments of looks under these numbers."""
        return rows.assigned(self.recalls[rows.place], self.alarms, self.errors, np.interp(rows.scores, *self.curve))

    def log_likelihoods(self, rows: Rows) -> np.ndarray:
        """Log likelihood of each look ``(L,)``, up to what none of these numbers changes."""
        missed = sums(rows.look_of_target, np.log(1 - self.recalls[rows.place]), len(rows.looks))
        detections = np.bincount(rows.look_of_detection, minlength=len(rows.looks))
        return self.of(rows).logs + missed + detections * math.log(self.alarms) - self.alarms


@dataclass(frozen=True, eq=False)
class Fitting:
    """Labelled looks as `rows`, and the prior `base`.

    `found`: candidates for look-alikes, and `false` ``(D,)``: how probably each detection is of none of the targets.
    """

    rows: Rows
    base: DetectorModel
    found: Candidates | None = None
    false: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @lazy
    def once(self) -> np.ndarray:
        """How often the score of each detection ``(D,)`` counts: once for each place."""
        return once(self.rows, Deviations.stated(self.base))

    @lazy
    def knots(self) -> np.ndarray:
        """The places of the score curve."""
        return knots_of(self.rows.scores)

    @property
    def prior_habit(self) -> np.ndarray:
        """The prior of the habit ``(2,)``; with a stated detection probability, its mean is that."""
        known, habit = self.base.detection_probability, np.array(self.base.habit)
        return habit if known is None else habit.sum() * np.array([known, 1 - known])

    def estimate(self, weights: np.ndarray, deviation: float, start: Estimate | None = None) -> Estimate:
        """The likeliest numbers for looks that count `weights` ``(L,)``; from several starts, or from `start` on.

        `deviation`: of the score curve's prior (`fitted_curve`).
        """
        starts = [start] if start else [self._start(weights, factor * self.base.spread) for factor in STARTS]
        best = max((self._climbed(weights, deviation, each) for each in starts), key=lambda each: each.log)
        if self.found is None:
            return best
        errors = Deviations.stated(self.base, best.errors.spread)  # what is false scatters more than what is right
        before = start.alikes if start else None
        return replace(best, alikes=look_alikes(self.rows, self.found, self.false, weights, errors, self.base, before))

    def _start(self, weights: np.ndarray, spread: float) -> Estimate:
        habit, places = self.prior_habit, int(self.rows.place.max(initial=-1)) + 1
        alarms = max(float(weights[self.rows.look_of_detection].sum() / weights.sum()), 0.1)
        errors = Deviations.stated(self.base, min(max(spread, NARROWEST), WIDEST))
        return Estimate(habit, np.full(places, habit[0] / habit.sum()), alarms, errors, FLAT)

    def _climbed(self, weights: np.ndarray, deviation: float, now: Estimate) -> Estimate:
        """The estimate to which the steps from `now` on lead."""
        rows, prior = self.rows, self.prior_habit
        of_target, of_detection = weights[rows.look_of_target], weights[rows.look_of_detection]
        looks, detections = float(weights.sum()), float(of_detection.sum())
        seen = np.bincount(rows.place, minlength=len(now.recalls)).astype(float)
        times = sums(rows.place, of_target, len(seen)) / seen  # how often each place counts
        # Errors are about a place; without poses each detection has a place of its own.
        posed = rows.placed[rows.look_of_target]
        names = np.where(posed[rows.target], rows.place[rows.target], -1 - np.arange(len(rows.target)))
        home = np.unique(names, return_inverse=True)[1].reshape(-1)
        pairs = np.bincount(home)
        spans = sums(home, of_detection[rows.detection], len(pairs)) / np.maximum(pairs, 1)
        told_apart = int(posed.sum()) > len(np.unique(rows.place[posed]))  # some place was seen twice, with poses
        for _ in range(STEPS):
            joint = now.of(rows)
            matched = float(of_detection @ joint.right)
            hits = sums(rows.place, of_target * joint.found, len(seen)) / np.maximum(times, 1e-300)
            hits = np.minimum(hits, seen) * (times > 0)
            habit = fitted_habit(hits, seen, times, prior, now.habit)
            recalls = (habit[0] + hits) / (habit.sum() + seen * (times > 0))
            alarms = (max(detections - matched, 0.0) + ALARMS_PRIOR[0]) / (looks + ALARMS_PRIOR[1])
            counts = of_detection[rows.detection] * joint.shares / np.maximum(spans[home], 1e-300)
            kept = counts > 1e-6
            of = rows.own[rows.detection[kept]], rows.offsets[kept], rows.turns[kept]
            log_likelihood = partial(scatter, of, home[kept], counts[kept], spans)
            errors = _likeliest_errors(log_likelihood, self.base, now.errors, told_apart)
            curve = fitted_curve(rows.scores, joint.right, of_detection * self.once, self.knots, deviation)
            before = now.settled
            now = Estimate(habit, np.clip(recalls, LEAST_RECALL, MOST_RECALL), alarms, errors, curve, matched)
            if np.abs(now.settled / before - 1).max() < SETTLED:
                break
        log = float(weights @ now.log_likelihoods(rows))
        log += ALARMS_PRIOR[0] * math.log(now.alarms) - ALARMS_PRIOR[1] * now.alarms
        return replace(now, log=log - _doubt(now.errors.spread, self.base.spread))

    def model(self, found: Estimate) -> DetectorModel:
        """The detector's model; what could not be counted is as in `base`."""
        numbers: dict[str, Any] = {name: short(value) for name, value in asdict(found.errors).items()}
        if len(self.rows.place):
            numbers |= {"detection_probability": None, "habit": tuple(map(short, found.habit))}
        if (alikes := found.alikes) is not None:
            numbers |= {"look_alikes": short(alikes.number), "look_alike_habit": tuple(map(short, alikes.habit))}
        if len(self.rows.scores):
            knots, logs = found.curve
            numbers["score_ratios"] = tuple(zip(map(short, knots), map(short, np.exp(logs)), strict=True))
        return replace(self.base, false_alarms_per_look=short(found.transient), **numbers)


# --- the fit ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeldOut:
    """Means over looks that the fit had not seen, nats: (with the model before, with the fitted one).

    `log_density`, per steradian, at the truth after this look alone; None without targets. `log_presence`: log of the
    probability given to the truth about presence, from 0.5 before the look. `gain`: by how much the two together rose,
    with a 95 % interval over the parts that were left out.
    """

    log_density: tuple[float, float] | None
    log_presence: tuple[float, float]
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
        return {
            "detector": model_as_json(self.model),
            "counts": counts,
            "intervals": _rounded(self.intervals),
            "held_out": None if self.held_out is None else _rounded(asdict(self.held_out)),
        }


def fit_detector(
    looks: Sequence[LabelledLook],
    base: DetectorModel | None = None,
    *,
    resamples: int = RESAMPLES,
    on_step: Callable[[], object] = lambda: None,
) -> DetectorFit:
    """The model of the detector that gave `looks`, fitted by penalised maximum likelihood.

    `base` (default: `DetectorModel()`): the prior of each number. What the looks cannot tell is taken from it: the
    habit without a target in view, the offset and the look-alikes without orientations, `kept_for` and `kept_within`
    always. `resamples`: draws of whole groups, for the intervals; `on_step` is called after each.

    Raises `EagorError` without looks.
    """
    base, looks = base or DetectorModel(), list(looks)
    fitting, deviation, found = _fitted(looks, base)
    parts, drawn = _parts(looks), []
    count, rng = int(parts.max()) + 1, np.random.default_rng(0)
    for _ in range(resamples if count > 1 else 0):
        times = np.bincount(rng.integers(count, size=count), minlength=count)
        drawn.append(fitting.estimate(times[parts].astype(float), deviation, found))
        on_step()
    return DetectorFit(
        fitting.model(found), len(looks), len({look.group for look in looks}), len(fitting.rows.place),
        len(fitting.rows.scores), found.matched, _intervals(found, drawn, fitting.rows, count),
        _held_out(looks, base, parts) if count > 1 else None,
    )  # fmt: skip


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    fitting, _, found = _fitted(looks, base)
    return fitting.model(found)


def _fitted(looks: Sequence[LabelledLook], base: DetectorModel) -> tuple[Fitting, float, Estimate]:
    """The looks, how far their scores are believed, and the likeliest numbers."""
    rows = rows_of(looks, base)
    fitting, every = Fitting(rows, base), np.ones(len(looks))
    deviation = _deviation(fitting, _folds(_parts(looks)))
    found = fitting.estimate(every, deviation)
    if rows.placed.any():
        false = 1 - found.of(rows).right
        lengths = found.errors.both(rows.own) ** -0.5
        beside = ((rows.offsets * lengths[rows.detection]) ** 2).sum(axis=1) < BESIDE**2
        alone = np.bincount(rows.detection[beside], minlength=len(false)) == 0
        around = candidates(rows, false * alone, Deviations.stated(base, found.errors.spread))
        fitting = replace(fitting, found=around, false=false)
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
    count = min(FOLDS, int(parts.max()) + 1)
    return [parts % count == fold for fold in range(count)] if count > 1 else []


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


def _intervals(found: Estimate, drawn: Sequence[Estimate], rows: Rows, parts: int) -> dict[str, tuple[float, float]]:
    """The bootstrap's intervals; those of rates at least as wide as their posteriors for independent places.

    Wider for few `parts`: expanded percentiles (Hesterberg, The American Statistician 69(4), 2015).
    """
    from scipy import stats

    def numbers(each: Estimate) -> dict[str, float]:
        known = {"false_alarms_per_look": each.transient, **asdict(each.errors)}
        known |= {"detection_share": each.share} if len(rows.place) else {}
        return known | ({"look_alikes": each.alikes.number} if each.alikes else {})

    def of_rate(rate: float, span: float) -> Any:
        return stats.gamma(max(rate * span, 0.0) + 0.5, scale=1 / span)

    looks = len(rows.looks) + ALARMS_PRIOR[1]
    posteriors = {"false_alarms_per_look": of_rate(found.transient - ALARMS_PRIOR[0] / looks, looks)}
    if len(rows.place):
        # Looks at one place count for less than looks at as many places: that is what its habit means.
        seen, strength = np.bincount(rows.place), float(found.habit.sum())
        worth = float((seen * (strength + 1) / (strength + seen)).sum()) + HABIT_PRIOR
        posteriors["detection_share"] = stats.beta(worth * found.share, worth * (1 - found.share))
    if found.alikes is not None:
        views = len(np.unique(rows.stretch[rows.placed])) + NUMBER_PRIOR
        posteriors["look_alikes"] = of_rate(found.alikes.number, views)
    ends = {name: [posterior.interval(LEVEL)] for name, posterior in posteriors.items()}
    if drawn:
        levels = stats.norm.cdf(math.sqrt(parts / (parts - 1)) * np.array(stats.t(parts - 1).interval(LEVEL)))
        values = [numbers(each) for each in drawn]
        for name in values[0]:
            ends.setdefault(name, []).append(np.quantile([each[name] for each in values], levels))
    return {name: (float(np.min(each)), float(np.max(each))) for name, each in ends.items()}


def _held_out(looks: Sequence[LabelledLook], base: DetectorModel, parts: np.ndarray) -> HeldOut:
    """Each look read by `base`, and by the model that was fitted on the other parts alone."""
    read = np.empty((len(looks), 2, 2))  # before and after; density and presence
    for left_out in _folds(parts):
        model = fitted_model([look for look, out in zip(looks, left_out, strict=True) if not out], base)
        for index in np.flatnonzero(left_out).tolist():
            read[index] = [told(looks[index], each) for each in (base, model)]
    density, presence = read[..., 0], read[..., 1]
    known = np.asarray(np.isfinite(density).all(axis=1))
    gains = np.where(known, np.diff(np.where(known[:, None], density, 0))[:, 0], 0.0) + np.diff(presence)[:, 0]
    ends = bootstrap_interval(gains, np.random.default_rng(0), LEVEL, groups=parts)
    before, after = presence.mean(axis=0).tolist()
    there = tuple(density[known].mean(axis=0).tolist()) if known.any() else None
    return HeldOut(there, (before, after), float(gains.mean()), (ends.low, ends.high))


def told(look: LabelledLook, model: DetectorModel) -> tuple[float, float]:
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


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {name: None if value is None else np.round(value, 4).tolist() for name, value in values.items()}
