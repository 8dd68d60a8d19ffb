"""Fitting a `DetectorModel` on looks with known truth, by penalised maximum likelihood: the numbers, and how sure.

Each target causes at most one detection, and what no target caused is a false alarm. Expectation-maximisation: the
probabilities of these assignments come from belief propagation (Williams and Lau, IEEE Transactions on Aerospace and
Electronic Systems 50(4), 2014), exact for one target in a look; given them, each number has a likelihood of its own.

- Habits: the hits of a place are beta-binomial, since its share of looks is drawn once.
- Errors: normal, of what differs from look to look and of what a place keeps. A box counts as round.
- Scores: the ratio of two densities is a logistic regression of "right or false" on the score (Prentice and Pyke,
  Biometrika 66(3), 1979). Its logarithm is linear in the score's own log odds and rises, or is flat (Platt, Advances in
  Large Margin Classifiers, 1999); a normal prior on its rise draws the ratio towards 1.
- Look-alikes: a Poisson process of places. False detections that lie near each other in the world are of one
  look-alike, or transient and met by chance. Places that were never detected count as well.

Priors say little, as if a few looks had been counted before. The intervals are those of the Bayesian bootstrap (Rubin,
Annals of Statistics 9(1), 1981): it draws the weights of whole groups, and what the priors stand for. What the fit is
worth is judged on groups that were left out in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import betaln, digamma, logit, ndtr, stdtrit

from eagor.evidence.detections import bump_norms
from eagor.evidence.detector import LEAST_OF_SIZE, LEAST_SCORE, LOOK_ALIKES, Alarms, DetectorModel
from eagor.grids import ErpGrid
from eagor.lab.eval.labelled_looks import DetectionTable, LabelledLook, in_time, sums
from eagor.sphere import angular_distance, unit
from eagor.statistics import bootstrap_interval

NEAR = 2.5  # deviations: a detection nearer to a target is beside it
SKY = ErpGrid(8, 16)  # directions at which it is counted how many looks covered them
KNOTS = 7  # most places of the score curve
DEVIATION = 2.0  # of the logarithm of the ratio between the lowest and the highest score, in the prior
NARROWEST, WIDEST = math.radians(0.2), math.radians(40)  # spreads that are tried
WIDE = 2.5  # times the stated spread: what is far from a narrow start would stay a false alarm
STEPS, SETTLED = 60, 1e-3  # most steps, and the change of every probability at which they end
ROUNDS, STILL = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
RECALLS = 0.001, 0.99  # of a place: no fewer and no more
RATES = math.log(1e-3), math.log(1e3)  # logarithms: of transient false alarms in a look, and of look-alikes
HABITS = math.log(0.05), math.log(200)  # logarithms: of the two numbers of a habit
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
PRESENT = 0.5  # probability of presence before a look
TINY = 1e-300
# What the priors count for: false alarms in one look; places with a known habit, of targets and of look-alikes; views
# with a known number of look-alikes; detections (of the spread); places with one detection each (of the offset).
ALARMS_PRIOR, HABIT_PRIOR, ALIKE_PRIOR, NUMBER_PRIOR, SPREAD_PRIOR, OFFSET_PRIOR = 0.5, 1, 4, 2.0, 2.0, 2.0

Curve = tuple[np.ndarray, np.ndarray]  # scores ``(K,)``, and logarithms of ratios: linear between, constant beyond
FLAT = np.array([0.0, 1.0]), np.zeros(2)  # ratio 1 for every score


def short(value: float) -> float:
    """`value` with the three digits that mean something."""
    return float(f"{value:.3g}")


def expected_look_alikes(base: DetectorModel) -> float:
    """Their prior number; habits are fitted, so a stated detection probability does not say that there are none."""
    return LOOK_ALIKES if base.look_alikes is None else base.look_alikes


class Deviations(NamedTuple):
    """How far a detection lies from its thing, as these fields of `DetectorModel` say."""

    spread: float
    spread_of_size: float
    offset: float
    offset_of_size: float

    @classmethod
    def of(cls, model: DetectorModel, **known: float) -> Deviations:
        """Those of a model, but for what is `known` better."""
        return cls(**{name: getattr(model, name) for name in cls._fields} | known)

    def per_look(self, own: np.ndarray) -> np.ndarray:
        """The variance ``(n,)``, per axis, of what differs from look to look; `own` ``(n,)``: of the box's area."""
        return self.spread**2 + self.spread_of_size**2 * own

    def per_place(self, own: np.ndarray) -> np.ndarray:
        """The variance of what a place keeps."""
        return self.offset**2 + self.offset_of_size**2 * own

    def variances(self, own: np.ndarray) -> np.ndarray:
        """The variance of both."""
        return self.per_look(own) + self.per_place(own)


class Prior(NamedTuple):
    """What the priors stand for: as if this had been counted before the looks.

    `alarms` in one look; the mean logarithms ``(2,)`` of the shares of hits and of misses, at `HABIT_PRIOR` places of
    targets, and of as many look-alikes as `ALIKE_PRIOR` says; `alikes` in `NUMBER_PRIOR` views; `errors` of
    `SPREAD_PRIOR` detections.
    """

    alarms: float
    habit: np.ndarray
    alike: np.ndarray
    alikes: float
    errors: Deviations

    @classmethod
    def of(cls, base: DetectorModel) -> Prior:
        """What is expected under `base`."""
        habit, alike = (digamma(each) - digamma(np.sum(each)) for each in (prior_habit(base), base.look_alike_habit))
        return cls(ALARMS_PRIOR, habit, alike, NUMBER_PRIOR * expected_look_alikes(base), Deviations.of(base))

    @classmethod
    def drawn(cls, base: DetectorModel, rng: np.random.Generator) -> Prior:
        """What might be counted under `base`."""
        habit = np.log(rng.dirichlet(prior_habit(base), HABIT_PRIOR) + TINY).mean(axis=0)
        alike = np.log(rng.dirichlet(base.look_alike_habit, ALIKE_PRIOR) + TINY).mean(axis=0)
        alikes = rng.gamma(NUMBER_PRIOR * expected_look_alikes(base))
        spread, of_size = np.sqrt(rng.gamma(SPREAD_PRIOR, size=2) / SPREAD_PRIOR)
        errors = Deviations.of(base, spread=base.spread * spread, spread_of_size=base.spread_of_size * of_size)
        return cls(rng.gamma(ALARMS_PRIOR), habit, alike, alikes, errors)


def prior_habit(base: DetectorModel) -> np.ndarray:
    """The beta distribution ``(2,)`` of a target's share of looks, before any look."""
    habit, known = np.array(base.habit), base.detection_probability
    return habit if known is None else habit.sum() * np.array([known, 1 - known])


# --- which detections are of which targets, and the numbers -----------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Estimate:
    """Numbers of the model, in a fit.

    `habit` ``(2,)``; `recalls` ``(C,)``: how often each place of a target is detected. `alarms`: all false detections
    of a look, which `alikes` tells apart, where poses are known. `matched`: how many detections are of a target.
    """

    habit: np.ndarray
    recalls: np.ndarray
    alarms: float
    errors: Deviations
    curve: Curve = FLAT
    matched: float = 0.0
    alikes: LookAlikes | None = None

    @property
    def numbers(self) -> dict[str, float]:
        """Those that have intervals."""
        known = {"detection_share": float(self.habit[0] / self.habit.sum()), "false_alarms_per_look": self.alarms}
        if self.alikes is not None:
            known |= {"false_alarms_per_look": self.alikes.alarms, "look_alikes": self.alikes.number}
        return known | self.errors._asdict()

    def model(self, table: DetectionTable) -> DetectorModel:
        """The detector's model; what could not be counted is as in the prior."""
        numbers: dict[str, Any] = {name: short(value) for name, value in self.numbers.items()}
        del numbers["detection_share"]
        if table.places:
            numbers |= {"detection_probability": None, "habit": tuple(map(short, self.habit))}
        if self.alikes is not None:
            numbers["look_alike_habit"] = tuple(map(short, self.alikes.habit))
        if len(table.scores):
            knots, logs = self.curve
            numbers["score_ratios"] = tuple(zip(map(short, knots), map(short, np.exp(logs)), strict=True))
        return replace(table.base, **numbers)


def assign(table: DetectionTable, at: Estimate) -> np.ndarray:
    """The probabilities ``(P,)`` that a detection is of a target, by belief propagation."""
    recalls, variances = at.recalls[table.place], at.errors.variances(table.own)[table.detection]
    odds = np.interp(table.scores, *at.curve) - np.log(at.alarms * table.clutter / table.areas[table.look])
    logs = odds[table.detection] + np.log(recalls / (1 - recalls))[table.target]
    logs += np.log(bump_norms(variances[:, None] ** [-0.5, -0.5])) - (table.offsets**2).sum(axis=1) / (2 * variances)
    pairs = np.exp(np.clip(logs, math.log(TINY), -math.log(TINY) / 4))
    back, forth = np.ones_like(pairs), np.zeros_like(pairs)  # messages from detections to targets, and there
    for _ in range(ROUNDS):
        forth = pairs / (1 + _others(pairs * back, table.target))
        before, back = back, 1 / (1 + _others(forth, table.detection))
        if np.abs(back - before).max(initial=0.0) < STILL:
            break
    weights = pairs * back
    return weights / (1 + sums(table.target, weights)[table.target])


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(sums(groups, values)[groups] - values, 0.0)


def log_hits(hits: np.ndarray, looks: np.ndarray, habit: np.ndarray) -> np.ndarray:
    """Log of the beta-binomial probability ``(n,)`` of these `hits` in so many `looks`, each in its place."""
    return betaln(habit[0] + hits, habit[1] + looks - hits) - betaln(*habit)


def fitted_habit(
    hits: np.ndarray, looks: np.ndarray, weights: np.ndarray, prior: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """The likeliest beta distribution ``(2,)`` of places ``(n,)`` with so many `hits` in so many `looks`.

    `weights` ``(n,)``: how often each counts. `prior` ``(2,)``: mean logarithms of shares (`Prior`).
    """

    def loss(logs: np.ndarray) -> float:
        habit = np.exp(logs)
        return -float(weights @ log_hits(hits, looks, habit) + HABIT_PRIOR * (prior @ habit - betaln(*habit)))

    return np.exp(minimize(loss, np.clip(np.log(start), *HABITS), bounds=[HABITS] * 2, method="L-BFGS-B").x)


def fitted_curve(scores: np.ndarray, right: np.ndarray, weights: np.ndarray) -> Curve:
    """The curve for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. Scores beyond `LEAST_SCORE` count as that, as where a model has no curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    scores = np.clip(scores, LEAST_SCORE, 1 - LEAST_SCORE)
    knots = np.unique(np.quantile(scores, np.linspace(0, 1, KNOTS))) if len(scores) else scores
    if len(knots) < 2 or min(positive.sum(), negative.sum()) < 1:
        return FLAT
    lowest, highest = logit(knots[[0, -1]])
    through, at_knots = ((logit(each) - lowest) / (highest - lowest) for each in (scores, knots))

    def loss(values: np.ndarray) -> float:
        odds = values[0] + values[1] * through
        above = positive @ np.logaddexp(0, -odds) + negative @ np.logaddexp(0, odds)
        return float(above + values[1] ** 2 / (2 * DEVIATION**2))

    prior = math.log(positive.sum() / negative.sum())
    fit = minimize(loss, np.array([prior, 0.0]), bounds=[(None, None), (0, None)], method="L-BFGS-B").x
    return knots, fit[0] - prior + fit[1] * at_knots


def scatter(
    own: np.ndarray, offsets: np.ndarray, place: np.ndarray, counts: np.ndarray, times: np.ndarray, errors: Deviations
) -> float:
    """Log likelihood of n detections about their places, with such `errors`; what a place keeps is of its mean box.

    Of each detection: the variance `own` ``(n,)`` of its box, its `offsets` ``(n, 2)`` in the plane of the place, its
    `place` ``(n,)``, and how often it `counts` there. `times` ``(C,)``: how often each place counts.
    """
    variances, number = errors.per_look(own), len(times)
    precise = counts / variances
    pull = np.array([sums(place, precise * along, number) for along in offsets.T])
    area = sums(place, counts * own, number) / np.maximum(sums(place, counts, number), TINY)
    square = errors.per_place(area)
    mixed = 1 + square * sums(place, precise, number)
    shared = square * (pull**2).sum(axis=0) / (2 * mixed) - np.log(mixed)
    alone = np.log(variances) + (offsets**2).sum(axis=1) / (2 * variances)
    return float(times @ shared - (times[place] * counts) @ alone)


def _fitted_errors(
    table: DetectionTable, counts: np.ndarray, times: np.ndarray, prior: Deviations, start: Deviations
) -> Deviations:
    """The likeliest deviations; all but the spread as stated where no place was seen twice with poses."""
    base, mask = table.base, counts > 1e-6
    errors = table.own[table.detection[mask]], table.offsets[mask], table.home[mask], counts[mask], times

    stated, stated_offset = np.reshape(prior, (2, 2))

    def deviations(values: np.ndarray) -> Deviations:
        spread, of_size = np.exp(values[:2])
        return Deviations(spread, of_size, values[2] * base.spread, values[3])

    def loss(values: np.ndarray) -> float:
        now = deviations(values)
        spread, offset = np.reshape(now, (2, 2))
        # Spreads are normal in their logarithms; each of two axes of a detection brings a Fisher information of 2.
        doubt = 2 * SPREAD_PRIOR * np.log(spread / stated) ** 2
        wide = offset**2 + stated**2
        doubt += OFFSET_PRIOR * (np.log(wide) + (stated_offset**2 + stated**2) / wide)
        return float(doubt.sum()) - scatter(*errors, now)

    first = [math.log(start.spread), math.log(start.spread_of_size)]
    first += [max(start.offset, 0.3 * start.spread) / base.spread, max(start.offset_of_size, 0.1)]
    low = [math.log(NARROWEST), math.log(LEAST_OF_SIZE), 0.0, 0.0]
    high = [math.log(WIDEST), math.log(2), WIDEST / base.spread, 2.0]
    if not table.revisits:
        first[1:] = low[1:] = high[1:] = [math.log(base.spread_of_size), base.offset / base.spread, base.offset_of_size]
    return deviations(minimize(loss, first, bounds=list(zip(low, high, strict=True)), method="L-BFGS-B").x)


def _estimate(table: DetectionTable, weights: np.ndarray, prior: Prior, start: Estimate | None = None) -> Estimate:
    """The likeliest numbers for looks that count `weights` ``(L,)``, by expectation-maximisation from `start` on."""
    habit, base = prior_habit(table.base), table.base
    now = start or Estimate(
        habit,
        np.full(table.places, habit[0] / habit.sum()),
        max(float(weights[table.look].sum() / weights.sum()), 0.1),
        Deviations.of(base, spread=min(max(WIDE * base.spread, NARROWEST), WIDEST)),
    )
    of_target, of_detection, of_pair = (
        weights[of] for of in (table.target_look, table.look, table.look[table.detection])
    )
    visits = np.bincount(table.place, minlength=table.places)
    times = sums(table.place, of_target, table.places) / visits  # how often each place counts
    spans = sums(table.home, of_pair, table.homes) / np.bincount(table.home, minlength=table.homes)
    last = np.full(len(table.target), np.inf)
    for _ in range(STEPS):
        shares = assign(table, now)
        right = table.right(shares)
        hit = np.minimum(sums(table.target, shares, len(table.place)), 1.0)
        hits = np.minimum(sums(table.place, of_target * hit, table.places) / np.maximum(times, TINY), visits)
        habit = fitted_habit(hits, visits, times, prior.habit, now.habit)
        recalls = np.clip((habit[0] + hits) / (habit.sum() + visits), *RECALLS)
        matched = float(of_detection @ right)
        alarms = (max(of_detection.sum() - matched, 0.0) + prior.alarms) / (weights.sum() + 1)
        counts = of_pair * shares / np.maximum(spans[table.home], TINY)
        errors = _fitted_errors(table, counts, spans, prior.errors, now.errors)
        curve = fitted_curve(table.scores, right, of_detection * table.score_weights)
        now = Estimate(habit, recalls, float(alarms), errors, curve, matched)
        if np.abs(shares - last).max(initial=0.0) < SETTLED:
            break
        last = shares
    return now


# --- what comes again and again --------------------------------------------------------------------------------------


class LookAlikes(NamedTuple):
    """The `alarms` of a look that do not come again; the `number` of look-alikes on the whole sphere, their `habit`."""

    alarms: float
    number: float
    habit: np.ndarray


@dataclass(frozen=True, eq=False)
class Candidates:
    """C candidates for look-alikes: places of false detections, each in one segment of looks with poses.

    `false` ``(D,)``: how probably each detection is of no target. `segment` ``(C,)``; `hits` and `looks` ``(C,)``: in
    how many looks each was detected, of those that had it in view. `together` ``(C,)``: log density of its detections
    if they are of one place, over that of as many looks with one transient false alarm each. `exposure` ``(S, X)``:
    how many looks of each segment covered the directions of `SKY`.
    """

    false: np.ndarray
    segment: np.ndarray
    hits: np.ndarray
    looks: np.ndarray
    together: np.ndarray
    exposure: np.ndarray

    @classmethod
    def among(cls, table: DetectionTable, at: Estimate) -> Candidates:
        """Those under these numbers. A second detection beside a target is none."""
        false = 1 - table.right(assign(table, at))
        wanted = false > 0.5
        beside = (table.offsets**2).sum(axis=1) < NEAR**2 * at.errors.variances(table.own)[table.detection]
        wanted[table.detection[beside]] = False
        errors = Deviations.of(table.base, spread=at.errors.spread)  # what is false scatters more than what is right
        precise, worth = 1 / errors.per_look(table.own), np.log(table.areas[table.look] / table.clutter)
        rows, centres = [], []
        for members in table.clusters(wanted, 1 / precise):
            centre = unit(precise[members] @ table.directions[members])
            far = precise[members] * angular_distance(table.directions[members], centre) ** 2
            near = np.argsort(far)  # of several in one look the nearest counts
            one = near[np.unique(table.look[members[near]], return_index=True)[1]]
            of = members[one]
            # Normal densities, their common middle integrated out.
            together = worth[of] + np.log(precise[of] / (2 * math.pi)) - far[one] / 2
            together = together.sum() + math.log(2 * math.pi / precise[of].sum())
            rows.append((table.segment[table.look[of[0]]], len(of), together))
            centres.append(centre)
        segment, hits, together = np.reshape(rows, (-1, 3)).T
        sky, middles = SKY.directions.reshape(-1, 3), np.reshape(centres, (-1, 3))
        seen, exposure = np.zeros(len(rows)), np.zeros((int(table.segment.max()) + 1, len(sky)))
        for index in np.flatnonzero(table.posed).tolist():
            look, number = table.looks[index], table.segment[index]
            here = np.flatnonzero(segment == number)
            seen[here] += look.covers(middles[here] @ look.world)
            exposure[number] += look.covers(sky @ look.world)
        return cls(false, segment.astype(int), hits, np.maximum(seen, hits), together, exposure)

    def fitted(self, table: DetectionTable, weights: np.ndarray, prior: Prior) -> LookAlikes:
        """The likeliest numbers for looks that count `weights` ``(L,)``."""
        times = np.bincount(table.segment, weights) / np.bincount(table.segment)  # how often each segment counts
        total, false = weights.sum() + 1, weights[table.look] @ self.false + prior.alarms
        views, index = np.unique(self.exposure, return_inverse=True)
        often = sums(index.ravel(), np.outer(times, SKY.weights / (4 * math.pi)).ravel())

        def loss(logs: np.ndarray) -> float:
            (alarms, number), habit = np.exp(logs[:2]), np.exp(logs[2:])
            likelier = logs[1] - math.log(4 * math.pi) + self.together + log_hits(self.hits, self.looks, habit)
            gain = times[self.segment] @ np.logaddexp(0, likelier - self.hits * logs[0])
            gain += false * logs[0] - total * alarms
            gain -= number * float(often @ (1 - np.exp(log_hits(np.zeros(len(views)), views, habit))))
            gain += prior.alikes * logs[1] - NUMBER_PRIOR * number
            return -float(gain + ALIKE_PRIOR * (prior.alike @ habit - betaln(*habit)))

        first = [math.log(false / total), math.log(LOOK_ALIKES), *np.log(table.base.look_alike_habit)]
        bounds = [RATES, RATES, HABITS, HABITS]
        found = np.exp(minimize(loss, np.array(first), bounds=bounds, method="L-BFGS-B").x)
        return LookAlikes(float(found[0]), float(found[1]), found[2:])


# --- the fit ---------------------------------------------------------------------------------------------------------


class HeldOut(NamedTuple):
    """By how much looks that the fit had not seen are read better than with the model before, nats per look.

    Of the log density at the truth and the log probability of the truth about presence, together (`log_score`); `low`
    to `high`: the 95 % interval over the parts that were left out.
    """

    gain: float
    low: float
    high: float


@dataclass(frozen=True)
class DetectorFit:
    """A fitted `model`, and what it rests on.

    `targets` in view; `matched`: how many of the `detections` are of a target (a sum of probabilities). `intervals`:
    95 % intervals by name of the number, over `groups`; with one group over stretches of its looks. `held_out`: None
    for a single look.
    """

    model: DetectorModel
    looks: int
    groups: int
    targets: int
    detections: int
    matched: float
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    held_out: HeldOut | None = None

    def as_json(self) -> dict[str, Any]:
        """What it rests on, as plain values."""
        counts = {name: getattr(self, name) for name in ("looks", "groups", "targets", "detections")}
        counts |= {"matched": round(self.matched, 1), "false_alarms": round(self.detections - self.matched, 1)}
        held_out = None if self.held_out is None else self.held_out._asdict()
        return {"counts": counts, "intervals": self.intervals, "held_out": held_out}


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
    always. `resamples`: draws of the groups' weights, for the intervals; `on_step` is called after each.

    Raises `EagorError` without looks.
    """
    base, looks = base or DetectorModel(), list(looks)
    table = DetectionTable(looks, base)
    estimate, candidates = _fitted(table)
    parts, resampled = _parts(looks), []
    count, rng = int(parts.max()) + 1, np.random.default_rng(0)
    for _ in range(resamples):
        weights, prior = count * rng.dirichlet(np.ones(count))[parts], Prior.drawn(base, rng)
        drawn = _estimate(table, weights, prior, estimate)
        alikes = None if candidates is None else candidates.fitted(table, weights, prior)
        resampled.append(replace(drawn, alikes=alikes).numbers)
        on_step()
    intervals = {name: _interval([each[name] for each in resampled], count) for name in estimate.numbers if resampled}
    if not table.places:
        intervals.pop("detection_share", None)
    return DetectorFit(
        estimate.model(table), len(looks), len({look.group for look in looks}), len(table.place), len(table.scores),
        estimate.matched, intervals, _held_out(looks, base, parts) if count > 1 else None,
    )  # fmt: skip


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    table = DetectionTable(looks, base)
    return _fitted(table)[0].model(table)


def _fitted(table: DetectionTable) -> tuple[Estimate, Candidates | None]:
    """The likeliest numbers, and the candidates for look-alikes; None where nothing tells of any, or there are none."""
    every, prior = np.ones(len(table.looks)), Prior.of(table.base)
    estimate = _estimate(table, every, prior)
    if not table.posed.any() or table.base.look_alikes == 0:
        return estimate, None
    candidates = Candidates.among(table, estimate)
    return replace(estimate, alikes=candidates.fitted(table, every, prior)), candidates


def _parts(looks: Sequence[LabelledLook]) -> np.ndarray:
    """A number for each look ``(L,)``: its group; where all are of one group, its stretch of consecutive looks."""
    names = list(dict.fromkeys(look.group for look in looks))
    if len(names) > 1:
        return np.array([names.index(look.group) for look in looks])
    parts = np.empty(len(looks), dtype=int)
    parts[in_time(looks)] = np.arange(len(looks)) * min(BLOCKS, len(looks)) // len(looks)
    return parts


def _interval(values: Sequence[float], parts: int) -> tuple[float, float]:
    """The interval of resamples of so many `parts`, wider for few.

    Expanded percentiles (Hesterberg, The American Statistician 69(4), 2015).
    """
    parts = max(parts, 2)
    ends = stdtrit(parts - 1, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])  # of Student's t; scipy.stats takes long to import
    levels = ndtr(math.sqrt(parts / (parts - 1)) * ends)
    low, high = np.quantile(values, levels)
    return float(low), float(high)


def _held_out(looks: Sequence[LabelledLook], base: DetectorModel, parts: np.ndarray) -> HeldOut:
    """Each look read by `base`, and by the model that was fitted on the other parts alone."""
    gains = np.empty(len(looks))
    for left_out in range(min(FOLDS, int(parts.max()) + 1)):
        fold = parts % FOLDS == left_out
        model = fitted_model([look for look, out in zip(looks, fold, strict=True) if not out], base)
        for index in np.flatnonzero(fold).tolist():
            gains[index] = log_score(looks[index], model) - log_score(looks[index], base)
    ends = bootstrap_interval(gains, np.random.default_rng(0), LEVEL, groups=parts)
    return HeldOut(float(gains.mean()), ends.low, ends.high)


def log_score(look: LabelledLook, model: DetectorModel) -> float:
    """Log density at the truth (its mean over targets) and log probability of the truth about presence, summed.

    After this look alone, from a uniform direction and `PRESENT`. One look cannot tell a look-alike from a false alarm,
    nor an offset from a spread.
    """
    spread = min(math.hypot(model.spread, model.offset), math.radians(60))
    of_size = min(math.hypot(model.spread_of_size, model.offset_of_size), 2.0)
    targets, habits = look.in_view, model.habits
    lasting = habits.look_alikes * float(habits.alike_levels @ habits.alike_shares)
    alarms = Alarms.prior(model).after(np.full(len(look.detections), lasting))
    rate = 1 / float(alarms.weights @ (1 / (alarms.numbers + lasting)))
    model = replace(model, false_alarms_per_look=rate, spread=spread, spread_of_size=of_size)
    scan = look.detections.read(model)
    mean = float((scan.ratios / scan.clutter).sum()) / rate  # over the sphere, of the likelihood ratio of a place
    mean = 1 + habits.mean * scan.area / (4 * math.pi) * (mean - 1)
    if not len(targets):
        return 0.0 if len(look.targets) else -math.log1p(PRESENT / (1 - PRESENT) * mean)
    density = np.log(scan.ratio(targets, 1.0)) - math.log(4 * math.pi * mean)
    return float(density.mean()) - math.log1p((1 - PRESENT) / PRESENT / mean)
