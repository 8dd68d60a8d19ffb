"""The likeliest numbers of a `DetectorModel` for labelled looks, by expectation-maximisation.

The assignments of detections to targets (`labelled_looks`), then each number from them: how often each place of a
target was detected, how far off, with which scores; and what false detections are (`detector_places`). Weak priors hold
where the looks say little: some places whose habits are known, a Gamma for the false alarms, a log-normal about the
stated spread, a normal for the rises of the score curve.

How many times likelier a target gives a score than a false alarm does is a rising curve from labelled scores. The ratio
of two densities is a logistic regression of "right or false" on the score (Prentice and Pyke, Biometrika 66(3), 1979).
The logarithm of the ratio is linear between a few knots and never falls. A normal prior on its rises draws it towards 1
for every score: few scores say little.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from eagor._values import lazy
from eagor.evaluation.detector_places import ALARMS_PRIOR, Candidates, Errors, Split, fitted_habit, once, scatter, split
from eagor.evaluation.labelled_looks import Assigned, Deviations, Rows, sums
from eagor.evidence.detector import LEAST_OF_SIZE, LOOK_ALIKES, DetectorModel

__all__ = [
    "Estimate", "Fitting", "ScoreCurve", "doubt", "expected_look_alikes", "fitted_curve", "knots_of",
    "likeliest_errors", "short",
]  # fmt: skip

KNOTS = 5  # most places of the curve
EACH = 8  # scores that each knot asks for
FEWEST = 1.0  # right or false scores, below which nothing is known of the curve
SPREAD_PRIOR = 2.0  # detections that the prior of the spread counts for
OFFSET_PRIOR = 2.0  # places, with one detection each, that the prior of the offset counts for
NARROWEST, WIDEST = math.radians(0.2), math.radians(40)  # spreads that are tried
STARTS = (0.4, 1.0, 2.5)  # times the stated spread: where the search begins
STEPS, SETTLED = 60, 1e-3  # most steps, and the relative change of every number at which they end
LEAST_RECALL, MOST_RECALL = 0.001, 0.99
BESIDE = 2.5  # widths about a target in which a second detection is no look-alike


@dataclass(frozen=True, eq=False)
class ScoreCurve:
    """Logarithms of ratios `logs` ``(K,)`` at scores `knots` ``(K,)``; linear between, constant beyond."""

    knots: np.ndarray
    logs: np.ndarray

    @classmethod
    def flat(cls) -> ScoreCurve:
        """Ratio 1 for every score."""
        return cls(np.array([0.0, 1.0]), np.zeros(2))

    def at(self, scores: np.ndarray) -> np.ndarray:
        """Logarithms of the ratios ``(n,)``."""
        return np.interp(scores, self.knots, self.logs)

    @property
    def pairs(self) -> tuple[tuple[float, float], ...]:
        """As `DetectorModel.score_ratios` has it."""
        return tuple((float(at), math.exp(log)) for at, log in zip(self.knots, self.logs, strict=True))


def knots_of(scores: np.ndarray) -> np.ndarray:
    """The places ``(K,)`` of a curve for these scores ``(n,)``: quantiles; fewer than two where all are alike."""
    count = min(KNOTS, max(2, len(scores) // EACH))
    return np.unique(np.quantile(scores, np.linspace(0, 1, count))) if len(scores) else np.zeros(0)


def fitted_curve(
    scores: np.ndarray, right: np.ndarray, weights: np.ndarray, knots: np.ndarray, deviation: float
) -> ScoreCurve:
    """The curve for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. `deviation`: standard deviation, in the prior, of the logarithm of the
    ratio between the lowest and the highest score; 0: the flat curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    if deviation <= 0 or len(knots) < 2 or min(positive.sum(), negative.sum()) < FEWEST:
        return ScoreCurve.flat()
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
    return ScoreCurve(knots, found[0] - prior + np.concatenate([[0.0], np.cumsum(found[1:])]))


@dataclass(frozen=True, eq=False)
class Estimate:
    """Numbers of the model, and what they were counted on: sums over looks and their weights.

    `habit` ``(2,)``; `recalls` ``(C,)``: how often each place of a target is detected. `alarms`: all false detections
    of a look, which `split` tells apart. `targets` in view, at `places`; `detections`, of which `matched` are of a
    target; `log`: the log posterior density.
    """

    habit: np.ndarray
    recalls: np.ndarray
    alarms: float
    errors: Deviations
    curve: ScoreCurve
    looks: float = 0.0
    targets: float = 0.0
    places: float = 0.0
    detections: float = 0.0
    matched: float = 0.0
    log: float = -math.inf
    split: Split | None = field(default=None, repr=False)

    @property
    def share(self) -> float:
        """The mean share of looks in which a target is detected."""
        return float(self.habit[0] / self.habit.sum())

    @property
    def transient(self) -> float:
        """The false detections of a look that do not come again; all of them, where poses are not known."""
        return self.alarms if self.split is None else self.split.alarms

    @property
    def settled(self) -> np.ndarray:
        """The numbers ``(4,)`` that stand still at the end of a fit."""
        at = self.errors
        sides = math.hypot(at.spread, at.offset), math.hypot(at.spread_of_size, at.offset_of_size)
        return np.array([self.share, self.alarms, *sides])

    def of(self, rows: Rows) -> Assigned:
        """The assignments of looks under these numbers."""
        return rows.assigned(self.recalls[rows.place], self.alarms, self.errors, self.curve.at(rows.scores))

    def log_likelihoods(self, rows: Rows) -> np.ndarray:
        """Log likelihood of each look ``(L,)``, up to what none of these numbers changes."""
        return self.of(rows).log_likelihoods(self.recalls[rows.place], self.alarms)

    def false(self, rows: Rows) -> np.ndarray:
        """How probably each detection ``(D,)`` is false, and not beside a target."""
        lengths = self.errors.both(rows.own) ** -0.5
        beside = ((rows.offsets * lengths[rows.detection]) ** 2).sum(axis=1) < BESIDE**2
        return (1 - self.of(rows).right) * (sums(rows.detection[beside], np.ones(beside.sum()), len(rows.scores)) == 0)

    def model(self, base: DetectorModel) -> DetectorModel:
        """The detector's model; what could not be counted is as in `base`."""
        found: dict[str, object] = {"false_alarms_per_look": short(self.transient)}
        found |= {name: short(value) for name, value in asdict(self.errors).items()}
        if self.targets:
            found |= {"detection_probability": None, "habit": tuple(map(short, self.habit))}
        if self.split is not None:
            found |= {"look_alikes": short(self.split.numbers[0])}
            found |= {"look_alike_habit": tuple(map(short, self.split.habits[0]))}
        if self.detections:
            found["score_ratios"] = tuple((short(at), short(ratio)) for at, ratio in self.curve.pairs)
        return replace(base, **found)


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

    @property
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
        numbers, habits = np.array([expected_look_alikes(self.base)]), np.array([self.base.look_alike_habit])
        before = start.split if start else None
        errors = Deviations.stated(self.base, best.errors.spread)  # what is false scatters more than what is right
        told = split(self.rows, self.found, self.false, weights, errors, numbers, habits, before)
        return replace(best, split=told)

    def _start(self, weights: np.ndarray, spread: float) -> Estimate:
        detections = float(weights[self.rows.look_of_detection].sum())
        habit, places = self.prior_habit, int(self.rows.place.max(initial=-1)) + 1
        alarms, spread = max(detections / weights.sum(), 0.1), min(max(spread, NARROWEST), WIDEST)
        return Estimate(
            habit, np.full(places, habit[0] / habit.sum()), alarms,
            Deviations.stated(self.base, spread), ScoreCurve.flat(),
        )  # fmt: skip

    def _climbed(self, weights: np.ndarray, deviation: float, now: Estimate) -> Estimate:
        """The estimate to which the steps from `now` on lead."""
        rows, knots, base = self.rows, self.knots, self.prior_habit
        of_target, of_detection = weights[rows.look_of_target], weights[rows.look_of_detection]
        targets, detections, looks = (float(part.sum()) for part in (of_target, of_detection, weights))
        seen = np.bincount(rows.place, minlength=len(now.recalls)).astype(float)
        times = sums(rows.place, of_target, len(seen)) / np.maximum(seen, 1)
        errors, home, spans = self._homes(of_detection)
        for _ in range(STEPS):
            joint = now.of(rows)
            matched = float(of_detection @ joint.right)
            hits = sums(rows.place, of_target * joint.found, len(seen)) / np.maximum(times, 1e-300)
            hits = np.minimum(hits, seen) * (times > 0)
            habit = fitted_habit(hits, seen, times, base, now.habit)
            recalls = (habit[0] + hits) / (habit.sum() + seen * (times > 0))
            alarms = (max(detections - matched, 0.0) + ALARMS_PRIOR[0]) / (looks + ALARMS_PRIOR[1])
            inner = of_detection[rows.detection] * joint.shares / np.maximum(spans[home], 1e-300)
            deviations = likeliest_errors(errors, home, inner, spans, self.base, now.errors, self._told_apart)
            curve = fitted_curve(rows.scores, joint.right, of_detection * self.once, knots, deviation)
            before = now.settled
            now = Estimate(
                habit, np.clip(recalls, LEAST_RECALL, MOST_RECALL), alarms, deviations, curve,
                looks, targets, float(times.sum()), detections, matched,
            )  # fmt: skip
            if np.abs(now.settled / before - 1).max() < SETTLED:
                break
        log = float(weights @ now.log_likelihoods(rows))
        log += ALARMS_PRIOR[0] * math.log(now.alarms) - ALARMS_PRIOR[1] * now.alarms
        return replace(now, log=log - doubt(now.errors.spread, self.base.spread))

    @property
    def _told_apart(self) -> bool:
        """Whether the looks can tell the offset: a place was seen twice, with poses."""
        placed = self.rows.place[self.rows.placed[self.rows.look_of_target]]
        return len(placed) > len(np.unique(placed))

    def _homes(self, of_detection: np.ndarray) -> tuple[Errors, np.ndarray, np.ndarray]:
        """For `scatter`: of each pair, its errors and its place; how often each place counts.

        Without poses each detection has a place of its own.
        """
        rows = self.rows
        known = rows.placed[rows.look_of_target[rows.target]]
        names = np.where(known, rows.place[rows.target], -1 - np.arange(len(known)))
        home = np.unique(names, return_inverse=True)[1].reshape(-1)
        count = int(home.max(initial=-1)) + 1
        spans = sums(home, of_detection[rows.detection], count) / np.maximum(np.bincount(home, minlength=count), 1)
        return (rows.own[rows.detection], rows.offsets, rows.turns), home, spans


def likeliest_errors(
    errors: Errors,
    place: np.ndarray,
    counts: np.ndarray,
    times: np.ndarray,
    base: DetectorModel,
    start: Deviations,
    told_apart: bool,
) -> Deviations:
    """The likeliest deviations of detections, which `scatter` describes, with their priors in `base`.

    All but the spread are those of `base` unless they can be `told_apart`.
    """
    from scipy.optimize import minimize, minimize_scalar

    kept = counts > 1e-6
    own, offsets, turns = errors
    rest = (own[kept], offsets[kept], turns[kept]), place[kept], counts[kept], times
    low, high = math.log(NARROWEST), math.log(WIDEST)
    if not told_apart:

        def alone(log: float) -> float:
            return doubt(math.exp(log), base.spread) - scatter(*rest, Deviations.stated(base, math.exp(log)))

        return Deviations.stated(base, math.exp(minimize_scalar(alone, bounds=(low, high), method="bounded").x))

    def deviations(values: np.ndarray) -> Deviations:
        return Deviations(math.exp(values[0]), values[1] * base.spread, math.exp(values[2]), float(values[3]))

    def every(values: np.ndarray) -> float:
        now = deviations(values)
        prior = doubt(now.spread, base.spread) + doubt(now.spread_of_size, base.spread_of_size)
        prior += _doubt_of_kept(now.offset, base.offset, base.spread)
        prior += _doubt_of_kept(now.offset_of_size, base.offset_of_size, base.spread_of_size)
        return prior - scatter(*rest, now)

    bounds = [(low, high), (0.0, WIDEST / base.spread), (math.log(LEAST_OF_SIZE), math.log(2)), (0.0, 2.0)]
    first = [math.log(start.spread), max(start.offset, 0.3 * start.spread) / base.spread]
    first += [math.log(start.spread_of_size), max(start.offset_of_size, 0.1)]
    return deviations(minimize(every, np.array(first), bounds=bounds, method="L-BFGS-B").x)


def _doubt_of_kept(value: float, stated: float, one: float) -> float:
    """Minus the log prior of what a place keeps: `OFFSET_PRIOR` places with a detection each; `one`: its deviation."""
    wide = value**2 + one**2
    return OFFSET_PRIOR * (math.log(wide) + (stated**2 + one**2) / wide)


def expected_look_alikes(base: DetectorModel) -> float:
    """Their prior number; habits are fitted, so a stated detection probability does not say that there are none."""
    return LOOK_ALIKES if base.look_alikes is None else base.look_alikes


def doubt(spread: float, stated: float) -> float:
    """Minus the log prior of a spread: normal in its logarithm, about the stated one.

    Each of two axes of a detection brings a Fisher information of 2 about that logarithm.
    """
    return 2 * SPREAD_PRIOR * math.log(spread / stated) ** 2


def short(value: float) -> float:
    """`value` with the three digits that mean something."""
    return float(f"{value:.3g}")
