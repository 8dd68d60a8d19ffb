"""Fitting a `DetectorModel` on looks with known truth, by penalised maximum likelihood: the numbers, and how sure.

Expectation-maximisation, with weak priors where the looks say little. Each target causes at most one detection, and
what no target caused is a false alarm. The probabilities of these assignments come from belief propagation (Williams
and Lau, IEEE Transactions on Aerospace and Electronic Systems 50(4), 2014), exact for one target in a look.

How many times likelier a target gives a score than a false alarm does is a rising curve. The ratio of two densities is
a logistic regression of "right or false" on the score (Prentice and Pyke, Biometrika 66(3), 1979). Its logarithm is
linear between a few knots. A normal prior on its rises draws the ratio towards 1: few scores say little. How far scores
are believed, and what the fit is worth, is judged on groups of looks that were left out in turn.

False detections near each other in the world may be of a look-alike, or transient and met by chance. Look-alikes are
a Poisson process of places; one is detected in h of the n looks that had it in view, and h is beta-binomial, since its
habit is drawn once. Places that were never detected count as well: they truncate the distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from eagor.errors import EagorError
from eagor.evidence.detections import bump_norms, tangent_frames
from eagor.evidence.detector import LEAST_OF_SIZE, LOOK_ALIKES, Alarms, DetectorModel, model_as_json
from eagor.lab.eval.labelled_looks import LabelledLook
from eagor.sphere import angular_distance, direction, unit
from eagor.statistics import bootstrap_interval

__all__ = ["DetectorFit", "HeldOut", "expected_look_alikes", "fit_detector", "fitted_model", "short"]

APART = math.radians(10)  # from where it was first seen: the same thing, seen from elsewhere, is another place
NEAR, FAR = 2.5, 3.5  # widths about a detection, and about a candidate, in which detections belong to it
LEAST_COUNT = 0.5  # detections of a candidate
POINTS = 96  # directions at which it is counted how many looks covered them
KNOTS, EACH = 5, 8  # most places of the score curve, and scores that each asks for
DEVIATIONS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the score curve's prior, tried on what is left out
NARROWEST, WIDEST = math.radians(0.2), math.radians(40)  # spreads that are tried
WIDE = (
    2.5  # times the stated spread: where the search begins, since what is far from a narrow start stays a false alarm
)
STEPS, SETTLED = 60, 1e-3  # most steps, and the relative change of every number at which they end
ROUNDS, STILL = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
RECALLS = 0.001, 0.99  # of a place: no fewer and no more
FLATTEST, SHARPEST = math.log(0.05), math.log(200)  # logarithms of the two numbers of a habit
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
PRESENT = 0.5  # probability of presence before a look
TINY = 1e-300
# What the priors count for: false alarms in looks; places with a known habit, of targets and of look-alikes; views with
# a known number of look-alikes; detections (of the spread); places with one detection each (of the offset).
ALARMS_PRIOR, HABIT_PRIOR, ALIKE_PRIOR, NUMBER_PRIOR = (0.5, 1.0), 1.0, 4.0, 2.0
SPREAD_PRIOR, OFFSET_PRIOR = 2.0, 2.0

Curve = tuple[np.ndarray, np.ndarray]  # scores ``(K,)``, and logarithms of ratios: linear between, constant beyond
FLAT = np.array([0.0, 1.0]), np.zeros(2)  # ratio 1 for every score


def short(value: float) -> float:
    """`value` with the three digits that mean something."""
    return float(f"{value:.3g}")


def expected_look_alikes(base: DetectorModel) -> float:
    """Their prior number; habits are fitted, so a stated detection probability does not say that there are none."""
    return LOOK_ALIKES if base.look_alikes is None else base.look_alikes


def sums(groups: np.ndarray, values: np.ndarray, count: int = 0) -> np.ndarray:
    """The sum of the `values` ``(n,)`` of each of `count` groups."""
    return np.bincount(groups, values, count).astype(np.float64)


class Deviations(NamedTuple):
    """How far a detection lies from its thing, as these fields of `DetectorModel` say."""

    spread: float
    offset: float
    spread_of_size: float
    offset_of_size: float

    @classmethod
    def of(cls, model: DetectorModel, **known: float) -> Deviations:
        """Those of a model, but for what is `known` better."""
        return cls(**{name: getattr(model, name) for name in cls._fields} | known)

    def per_look(self, own: np.ndarray) -> np.ndarray:
        """The variance ``(n, 2)`` of what differs from look to look; `own` ``(n, 2)``: of the box's area."""
        return self.spread**2 + self.spread_of_size**2 * own

    def per_place(self, own: np.ndarray) -> np.ndarray:
        """The variance of what a place keeps."""
        return self.offset**2 + self.offset_of_size**2 * own


# --- the looks as tables, and which detections are of which targets --------------------------------------------------


class DetectionTable:
    """Labelled `looks` as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    - Of looks: `posed` (whether the orientation is known), `areas` (covered, steradians), `segment` (`segments`).
    - Of detections: `look`; `directions` ``(D, 3)`` and unit `axes` ``(D, 2, 3)`` in the axes of the world, or of the
      body without a pose; `scores`, relative `clutter`; `own` ``(D, 2)``: variances of a box's area along its axes, 0
      for points; `score_weights`: one over the number of detections at its place, since a score is a habit, too.
    - Of targets: `target_look`, and `place`, the same number for one thing in one segment, of `places`.
    - Of pairs: `detection`, `target`; `offsets` ``(P, 2)`` of the detection from the target along its axes, in
      Lambert's plane; `turns` ``(P, 2, 2)``: these axes in the target's tangent plane; `home`, of `homes`: where errors
      are kept. That is the place; each detection without a pose has a home of its own. `revisits`:
      whether any place was looked at again, with poses.

    `base`: the prior. Raises `EagorError` without looks.
    """

    def __init__(self, looks: Sequence[LabelledLook], base: DetectorModel) -> None:
        if not looks:
            raise EagorError("there are no looks with detections; wanted at least one")
        sets = [look.detections.read(base).turned(look.world) for look in looks]
        targets = [look.in_view @ look.world.T for look in looks]
        self.looks, self.base = tuple(looks), base
        self.posed = np.array([look.world_R_body is not None for look in looks])
        self.areas = np.array([each.area for each in sets])
        self.segment = segments(looks, base)
        self.look, self.target_look = (np.repeat(np.arange(len(looks)), list(map(len, of))) for of in (sets, targets))
        self.directions, axes, self.scores, self.clutter, self.own = (
            np.concatenate([getattr(each, name) for each in sets])
            for name in ("directions", "axes", "scores", "clutter", "own")
        )
        self.axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
        self.place = _places(looks, self.segment, targets)
        self.places = int(self.place.max(initial=-1)) + 1
        self.target, self.detection = np.nonzero(self.target_look[:, None] == self.look)
        at, axes = np.concatenate(targets), self.axes[self.detection]
        self.offsets = _offsets(axes, self.directions[self.detection], at[self.target])
        self.turns = np.einsum("pij,pkj->pik", axes, tangent_frames(at)[self.target])
        posed = self.posed[self.target_look]
        names = np.where(posed[self.target], self.place[self.target], -1 - np.arange(len(self.target)))
        self.home = np.unique(names, return_inverse=True)[1].reshape(-1)
        self.homes = int(self.home.max(initial=-1)) + 1
        self.revisits = int(posed.sum()) > len(np.unique(self.place[posed]))
        self.score_weights = np.ones(len(self.scores))
        for _, members, near, _ in self.neighbours(self.score_weights > 0, Deviations.of(base)):
            self.score_weights[members] = 1 / near.sum(axis=1)
        count = min(KNOTS, max(2, len(self.scores) // EACH))
        self.knots = np.unique(np.quantile(self.scores, np.linspace(0, 1, count))) if len(self.scores) else np.zeros(0)

    def neighbours(
        self, wanted: np.ndarray, errors: Deviations
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        """Each segment with poses: its number, its `wanted` detections ``(n,)``, which of them are near, variances."""
        variances = errors.per_look(self.own).mean(axis=1)
        of = np.where(self.posed, self.segment, -1)[self.look]
        for number in np.unique(of[wanted & (of >= 0)]).tolist():
            members = np.flatnonzero((of == number) & wanted)
            at, wide = self.directions[members], variances[members]
            yield number, members, 2 - 2 * at @ at.T < NEAR**2 * (wide[:, None] + wide) / 2, wide

    def assign(self, at: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """The probabilities ``(P,)`` that a detection is of a target, and log likelihood ratios ``(L,)`` of the looks.

        These compare all assignments to "all are false alarms, all targets are missed".
        """
        recalls = at.recalls[self.place]
        odds = np.interp(self.scores, *at.curve) - np.log(at.alarms * self.clutter / self.areas[self.look])
        odds = odds[self.detection] + np.log(recalls / (1 - recalls))[self.target]
        own = self.own[self.detection]
        logs = odds + _log_bumps(at.errors.per_look(own) + at.errors.per_place(own), self.offsets)
        pairs = np.exp(np.clip(logs, math.log(TINY), -math.log(TINY) / 4))
        back, forth = np.ones_like(pairs), np.zeros_like(pairs)  # messages from detections to targets, and there
        for _ in range(ROUNDS):
            forth = pairs / (1 + _others(pairs * back, self.target))
            before, back = back, 1 / (1 + _others(forth, self.detection))
            if np.abs(back - before).max(initial=0.0) < STILL:
                break
        weights, count = pairs * back, len(self.looks)
        taken = sums(self.target, weights, len(self.place))
        ratios = sums(self.target_look, np.log1p(taken), count)
        ratios += sums(self.look, np.log1p(sums(self.detection, forth, len(self.scores))), count)
        ratios -= sums(self.target_look[self.target], np.log1p(forth * back), count)
        return weights / (1 + taken[self.target]), ratios

    def right(self, shares: np.ndarray) -> np.ndarray:
        """The probability of each detection ``(D,)`` to be of any target, from `shares` ``(P,)``."""
        return np.minimum(sums(self.detection, shares, len(self.scores)), 1.0)

    def log_likelihoods(self, at: Estimate) -> np.ndarray:
        """Log likelihood of each look ``(L,)``, up to what none of the numbers changes."""
        missed = sums(self.target_look, np.log(1 - at.recalls[self.place]), len(self.looks))
        detections = np.bincount(self.look, minlength=len(self.looks))
        return self.assign(at)[1] + missed + detections * math.log(at.alarms) - at.alarms


def _offsets(axes: np.ndarray, directions: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """How far `directions` ``(n, 3)`` lie from `centres` ``(n, 3)`` along `axes` ``(n, 2, 3)``: ``(n, 2)``, radians."""
    near = np.maximum(1 + np.einsum("ni,ni->n", directions, centres), 1e-9)
    return -np.einsum("nij,nj->ni", axes, centres) * np.sqrt(2 / near)[:, None]


def _log_bumps(variances: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Log densities ``(n,)``, per steradian, of detections with such `variances` and `offsets` ``(n, 2)``."""
    return np.log(bump_norms(variances**-0.5)) - 0.5 * (offsets**2 / variances).sum(axis=1)


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(sums(groups, values)[groups] - values, 0.0)


def segments(looks: Sequence[LabelledLook], base: DetectorModel) -> np.ndarray:
    """A number for each look ``(L,)``, the same as long as a group's view stays the same.

    A view ends where places have lost their habits, by `kept_for` and `kept_within` of `base`.
    """
    numbers, starts = np.empty(len(looks), dtype=int), {}
    for index in _in_time(looks):
        look = looks[index]
        first = looks[starts.setdefault(look.group, index)]
        elapsed = (look.stamp or 0.0) - (first.stamp or 0.0)
        here, there = look.position, first.position
        moved = 0.0 if here is None or there is None else float(np.linalg.norm(here - there))
        if elapsed / (base.kept_for or math.inf) + moved / (base.kept_within or math.inf) > 1:
            starts[look.group] = index
        numbers[index] = starts[look.group]
    return np.unique(numbers, return_inverse=True)[1]


def _in_time(looks: Sequence[LabelledLook]) -> list[int]:
    """Indices of the looks by stamp; without stamps, as they came."""
    return sorted(range(len(looks)), key=lambda index: looks[index].stamp or 0.0)


def _places(looks: Sequence[LabelledLook], segment: np.ndarray, targets: Sequence[np.ndarray]) -> np.ndarray:
    """A number for each target in view ``(T,)``, the same for one thing in one segment.

    `targets`: their directions ``(m, 3)`` of each look. Where poses are known, the thing is what is nearest in the
    world to where it first was, within `APART`; else it is what has the same index.
    """
    anchors: dict[int, list[np.ndarray]] = {}
    names: list[tuple[int, int]] = []
    for look, number, directions in zip(looks, segment.tolist(), targets, strict=True):
        if look.world_R_body is None:
            names += [(number, -1 - index) for index in np.flatnonzero(look.covers(look.targets)).tolist()]
            continue
        anchors_here = anchors.setdefault(number, [])
        unused = dict(enumerate(anchors_here))
        for at in directions:
            apart = {index: float(angular_distance(anchor, at)) for index, anchor in unused.items()}
            nearest = min(apart, key=apart.__getitem__, default=None)
            if nearest is None or apart[nearest] >= APART:
                nearest = len(anchors_here)
                anchors_here.append(at)
            unused.pop(nearest, None)
            names.append((number, nearest))
    numbers = {name: index for index, name in enumerate(dict.fromkeys(names))}
    return np.array([numbers[name] for name in names], dtype=int)


# --- the numbers -----------------------------------------------------------------------------------------------------


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
        transient = self.alarms if self.alikes is None else self.alikes.alarms
        known = {"detection_share": float(self.habit[0] / self.habit.sum()), "false_alarms_per_look": transient}
        known |= {} if self.alikes is None else {"look_alikes": self.alikes.number}
        return known | self.errors._asdict()

    @property
    def settled(self) -> list[float]:
        """The numbers that stand still at the end of a fit."""
        spread, offset, spread_of_size, offset_of_size = self.errors
        sides = math.hypot(spread, offset), math.hypot(spread_of_size, offset_of_size)
        return [self.numbers["detection_share"], self.alarms, *sides]

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


def fitted_habit(
    hits: np.ndarray, looks: np.ndarray, weights: np.ndarray, base: np.ndarray, start: np.ndarray, prior: float
) -> np.ndarray:
    """The likeliest beta distribution ``(2,)`` of places ``(n,)`` with so many `hits` in so many `looks`.

    `weights` ``(n,)``: how often each counts. The `prior` are so many places whose shares are as `base` ``(2,)`` says.
    """
    from scipy.optimize import minimize
    from scipy.special import betaln, digamma

    counted = (weights > 1e-9) & (looks > 0)
    hits, looks, weights = hits[counted], looks[counted], weights[counted]
    mean_logs = digamma(base) - digamma(base.sum())

    def loss(logs: np.ndarray) -> float:
        a, b = np.exp(logs)
        gain = weights @ (betaln(a + hits, b + looks - hits) - betaln(a, b))
        return -float(gain + prior * (mean_logs @ (a, b) - betaln(a, b)))

    first = np.clip(np.log(start), FLATTEST, SHARPEST)
    return np.exp(minimize(loss, first, bounds=[(FLATTEST, SHARPEST)] * 2, method="L-BFGS-B").x)


def fitted_curve(
    scores: np.ndarray, right: np.ndarray, weights: np.ndarray, knots: np.ndarray, deviation: float
) -> Curve:
    """The curve for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. `deviation`: standard deviation, in the prior, of the logarithm of the
    ratio between the lowest and the highest score; 0: the flat curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    if deviation <= 0 or len(knots) < 2 or min(positive.sum(), negative.sum()) < 1:
        return FLAT
    from scipy.optimize import minimize
    from scipy.special import expit

    rises = len(knots) - 1
    # Column k is how far a score lies through the k-th gap between knots, in [0, 1].
    through = np.clip((scores[:, None] - knots[:-1]) / np.diff(knots), 0, 1)
    variance = deviation**2 / rises

    def loss(values: np.ndarray) -> tuple[float, np.ndarray]:
        odds = values[0] + through @ values[1:]
        above = positive @ np.logaddexp(0, -odds) + negative @ np.logaddexp(0, odds)
        slope = weights * expit(odds) - positive
        gradient = np.concatenate([[slope.sum()], slope @ through + values[1:] / variance])
        return float(above + values[1:] @ values[1:] / (2 * variance)), gradient

    prior = math.log(positive.sum() / negative.sum())
    bounds = [(None, None), *[(0, None)] * rises]
    fit = minimize(loss, np.array([prior, *[0.0] * rises]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return knots, fit[0] - prior + np.concatenate([[0.0], np.cumsum(fit[1:])])


def scatter(
    own: np.ndarray, offsets: np.ndarray, turns: np.ndarray, place: np.ndarray, counts: np.ndarray, times: np.ndarray,
    errors: Deviations,
) -> float:  # fmt: skip
    """Log likelihood of n detections about their places, with such `errors`.

    What a place keeps is taken to be round, and that of its mean box. Of each detection: variances `own` ``(n, 2)`` of
    its box along its axes, `offsets` ``(n, 2)`` along them, `turns` ``(n, 2, 2)``: these axes in the plane of the
    place; its `place` ``(n,)``, and how often it `counts` there. `times` ``(C,)``: how often each place counts.
    """
    variances = errors.per_look(own)
    pull, hold, area = np.zeros((len(times), 2)), np.zeros((len(times), 2, 2)), np.zeros(len(times))
    precise = turns * (counts[:, None] / variances)[..., None]
    np.add.at(pull, place, np.einsum("nij,ni->nj", precise, offsets))
    np.add.at(hold, place, np.einsum("nij,nik->njk", precise, turns))
    np.add.at(area, place, counts * own.mean(axis=1))
    square = errors.per_place(area / np.maximum(sums(place, counts, len(times)), TINY))
    mixed = np.eye(2) + square[:, None, None] * hold
    gain = square * np.einsum("ci,ci->c", pull, np.linalg.solve(mixed, pull[..., None])[..., 0])
    alone = (np.log(variances) + offsets**2 / variances).sum(axis=1)
    return 0.5 * float(times @ (gain - np.log(np.linalg.det(mixed))) - (times[place] * counts) @ alone)


def _fitted_errors(table: DetectionTable, counts: np.ndarray, times: np.ndarray, start: Deviations) -> Deviations:
    """The likeliest deviations; all but the spread as stated where no place was seen twice with poses."""
    from scipy.optimize import minimize

    base, mask = table.base, counts > 1e-6
    errors = table.own[table.detection[mask]], table.offsets[mask], table.turns[mask], table.home[mask], counts[mask]

    def deviations(values: np.ndarray) -> Deviations:
        return Deviations(math.exp(values[0]), values[1] * base.spread, math.exp(values[2]), float(values[3]))

    def loss(values: np.ndarray) -> float:
        now, doubt = deviations(values), 0.0
        for spread, stated, offset, stated_offset in (
            (now.spread, base.spread, now.offset, base.offset),
            (now.spread_of_size, base.spread_of_size, now.offset_of_size, base.offset_of_size),
        ):
            # Spreads are normal in their logarithms; each of two axes of a detection brings a Fisher information of 2.
            doubt += 2 * SPREAD_PRIOR * math.log(spread / stated) ** 2
            wide = offset**2 + stated**2
            doubt += OFFSET_PRIOR * (math.log(wide) + (stated_offset**2 + stated**2) / wide)
        return doubt - scatter(*errors, times, now)

    first = [math.log(start.spread), max(start.offset, 0.3 * start.spread) / base.spread]
    first += [math.log(start.spread_of_size), max(start.offset_of_size, 0.1)]
    low = [math.log(NARROWEST), 0.0, math.log(LEAST_OF_SIZE), 0.0]
    high = [math.log(WIDEST), WIDEST / base.spread, math.log(2), 2.0]
    if not table.revisits:
        known = [base.offset / base.spread, math.log(base.spread_of_size), base.offset_of_size]
        first[1:] = low[1:] = high[1:] = known
    return deviations(minimize(loss, np.array(first), bounds=list(zip(low, high, strict=True)), method="L-BFGS-B").x)


def _estimate(
    table: DetectionTable,
    weights: np.ndarray,
    deviation: float,
    start: Estimate | None = None,
    candidates: Candidates | None = None,
) -> Estimate:
    """The likeliest numbers for looks that count `weights` ``(L,)``, by expectation-maximisation from `start` on.

    `deviation`: of the score curve's prior (`fitted_curve`).
    """
    base = table.base
    known, prior = base.detection_probability, np.array(base.habit)
    prior = prior if known is None else prior.sum() * np.array([known, 1 - known])
    now = start or Estimate(
        prior,
        np.full(table.places, prior[0] / prior.sum()),
        max(float(weights[table.look].sum() / weights.sum()), 0.1),
        Deviations.of(base, spread=min(max(WIDE * base.spread, NARROWEST), WIDEST)),
    )
    of_target, of_detection, pair_weights = (
        weights[of] for of in (table.target_look, table.look, table.look[table.detection])
    )
    visits = np.bincount(table.place, minlength=table.places).astype(float)
    times = sums(table.place, of_target, table.places) / visits  # how often each place counts
    looks = visits * (times > 0)
    spans = sums(table.home, pair_weights, table.homes) / np.bincount(table.home, minlength=table.homes)
    for _ in range(STEPS):
        shares, _ = table.assign(now)
        right = table.right(shares)
        hit = np.minimum(sums(table.target, shares, len(table.place)), 1.0)
        hits = np.minimum(sums(table.place, of_target * hit, table.places) / np.maximum(times, TINY), looks)
        habit = fitted_habit(hits, looks, times, prior, now.habit, HABIT_PRIOR)
        recalls = np.clip((habit[0] + hits) / (habit.sum() + looks), *RECALLS)
        matched = float(of_detection @ right)
        alarms = (max(of_detection.sum() - matched, 0.0) + ALARMS_PRIOR[0]) / (weights.sum() + ALARMS_PRIOR[1])
        counts = pair_weights * shares / np.maximum(spans[table.home], TINY)
        errors = _fitted_errors(table, counts, spans, now.errors)
        curve = fitted_curve(table.scores, right, of_detection * table.score_weights, table.knots, deviation)
        before, now = now, Estimate(habit, recalls, float(alarms), errors, curve, matched)
        if np.allclose(now.settled, before.settled, rtol=SETTLED, atol=0):
            break
    if candidates is None:
        return now
    errors = Deviations.of(base, spread=now.errors.spread)  # what is false scatters more than what is right
    return replace(now, alikes=fitted_look_alikes(table, candidates, weights, errors, start.alikes if start else None))


# --- what comes again and again --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidates:
    """C candidates for look-alikes, each in one segment of looks with poses.

    `false` ``(D,)``: how probably each detection is of none of the targets. `segment` ``(C,)``; `looks` ``(C,)``: how
    many had it in view. `detection` ``(M,)`` and `place` ``(M,)``: which detections belong to which candidate;
    `offsets` ``(M, 2)`` from its centre along their axes. `exposure` ``(S, X)``: how many looks of each segment covered
    directions of the world.
    """

    false: np.ndarray
    segment: np.ndarray
    looks: np.ndarray
    detection: np.ndarray
    place: np.ndarray
    offsets: np.ndarray
    exposure: np.ndarray

    @classmethod
    def among(cls, table: DetectionTable, at: Estimate) -> Candidates:
        """Those under these numbers: where most false detections lie near one, about their mean; then among the rest.

        A second detection beside a target is none.
        """
        false = 1 - table.right(table.assign(at)[0])
        own = table.own[table.detection]
        beside = (table.offsets**2 / (at.errors.per_look(own) + at.errors.per_place(own))).sum(axis=1) < NEAR**2
        counts = false * (np.bincount(table.detection[beside], minlength=len(false)) == 0)
        segment, centres, detection, place = [], [], [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        errors = Deviations.of(table.base, spread=at.errors.spread)
        for number, members, near, wide in table.neighbours(counts > 0, errors):
            directions, remaining = table.directions[members], counts[members]
            while remaining.max() > 0 and (total := near @ remaining).max() >= LEAST_COUNT:
                chosen = near[int(np.where(remaining > 0, total, 0).argmax())] * remaining / wide
                if not chosen.any():
                    break
                centre = unit(chosen @ directions)
                of = np.flatnonzero((remaining > 0) & ((2 - 2 * directions @ centre < FAR**2 * wide) | (chosen > 0)))
                detection.append(members[of])
                place.append(np.full(len(of), len(centres)))
                segment.append(number)
                centres.append(centre)
                remaining[of] = 0
        chosen, of_place = np.concatenate(detection), np.concatenate(place)
        which, middles = np.array(segment, dtype=int), np.reshape(centres, (-1, 3))
        offsets = _offsets(table.axes[chosen], table.directions[chosen], middles[of_place])
        lattice = np.arange(POINTS)  # of Fibonacci
        points = direction(lattice * (math.pi * (3 - math.sqrt(5))), np.arcsin(1 - (2 * lattice + 1) / POINTS))
        seen, exposure = np.zeros(len(which)), np.zeros((int(table.segment.max()) + 1, POINTS))
        for index in np.flatnonzero(table.posed).tolist():
            look, number = table.looks[index], table.segment[index]
            here = np.flatnonzero(which == number)
            seen[here] += look.covers(middles[here] @ look.world)
            exposure[number] += look.covers(points @ look.world)
        return cls(false, which, seen, chosen, of_place, offsets, exposure)


@dataclass(frozen=True, eq=False)
class LookAlikes:
    """What became of the candidates: look-alikes among transient false alarms.

    `alarms` of a look that do not come again; the `number` of look-alikes expected on the whole sphere, with their
    `habit` ``(2,)``. `hits` ``(C,)``: in how many looks each candidate was detected.
    """

    alarms: float
    number: float
    habit: np.ndarray
    hits: np.ndarray


def fitted_look_alikes(
    table: DetectionTable, candidates: Candidates, weights: np.ndarray, errors: Deviations, start: LookAlikes | None
) -> LookAlikes:
    """The likeliest numbers for looks that count `weights` ``(L,)``; none where the prior has no look-alikes."""
    from scipy.special import betaln, entr, expit, logit

    def log_hits(hits: np.ndarray, looks: np.ndarray, a: float, b: float) -> np.ndarray:
        """Log of the beta-binomial probability of these hits in so many looks, each in its place."""
        return betaln(a + hits, b + looks - hits) - betaln(a, b)

    of_look, variances = table.look[candidates.detection], errors.per_look(table.own[candidates.detection])
    odds = np.log(table.areas[of_look] / table.clutter[candidates.detection] * candidates.false[candidates.detection])
    keys, pair = np.unique(candidates.place * len(table.looks) + of_look, return_inverse=True)  # of one look at a place
    place, look = np.divmod(keys, len(table.looks))
    density = np.log(sums(pair, np.exp(_log_bumps(variances, candidates.offsets) + odds), len(keys)))
    times = np.bincount(table.segment, weights) / np.bincount(table.segment)  # how often each segment counts
    of_place = times[candidates.segment]
    inner = weights[look] / np.maximum(of_place[place], TINY)
    count, total, false = len(candidates.segment), float(weights.sum()), float(weights[table.look] @ candidates.false)
    each = np.bincount(candidates.place, minlength=count)
    blunt = sums(candidates.place, np.log(variances).sum(axis=1), count) / (2 * each) - math.log(2)
    unseen, index = np.unique(candidates.exposure, return_inverse=True)
    often = sums(index.ravel(), np.repeat(times / POINTS, POINTS), len(unseen)) * (unseen > 0)
    expected, prior = expected_look_alikes(table.base), np.array(table.base.look_alike_habit)
    many = max(expected, 0.1) if expected > 0 else 0.0
    now = start or LookAlikes(max(false / total, 0.01), many, prior, each.astype(np.float64))
    for _ in range(ROUNDS):
        recall = (now.habit[0] + now.hits) / (now.habit.sum() + np.maximum(candidates.looks, now.hits))
        logs = density - math.log(now.alarms)
        chance = expit(logs + logit(np.clip(recall, 1e-6, 1 - 1e-6))[place])
        hits = sums(place, inner * chance, count)
        looks = np.maximum(candidates.looks, hits)
        gain = sums(place, inner * (chance * logs + entr(chance) + entr(1 - chance)), count)
        gain += blunt - np.log(np.maximum(hits, 1.0)) + log_hits(hits, looks, *now.habit)
        likely = now.number * np.exp(np.clip(gain, -500, 500))
        presence = of_place * likely / (1 + likely)  # how often each candidate is one, and counts
        undetected = now.number * often * np.exp(log_hits(np.zeros(len(unseen)), unseen, *now.habit))
        number = (presence.sum() + undetected.sum() + NUMBER_PRIOR * expected) / (often.sum() + NUMBER_PRIOR)
        pairs = (hits, np.zeros(len(unseen))), (looks, unseen), (presence, undetected)
        places = map(np.concatenate, pairs)
        before, now = now, LookAlikes(
            (max(false - float(presence @ hits), 0.0) + ALARMS_PRIOR[0]) / (total + ALARMS_PRIOR[1]),
            float(number) if expected > 0 else 0.0, fitted_habit(*places, prior, now.habit, ALIKE_PRIOR), hits,
        )  # fmt: skip
        old, new = (np.array([each.alarms, each.number, *each.habit]) for each in (before, now))
        if np.abs(new - old).max() < SETTLED * (1 + old.max()):
            break
    return now


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


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {name: None if value is None else np.round(value, 4).tolist() for name, value in values.items()}


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
    table, deviation, estimate, candidates = _fitted(looks, base)
    parts, resampled = _parts(looks), []
    count, rng = int(parts.max()) + 1, np.random.default_rng(0)
    for _ in range(resamples if count > 1 else 0):
        times = np.bincount(rng.integers(count, size=count), minlength=count)
        resampled.append(_estimate(table, times[parts].astype(float), deviation, estimate, candidates))
        on_step()
    return DetectorFit(
        estimate.model(table), len(looks), len({look.group for look in looks}), len(table.place), len(table.scores),
        estimate.matched, _intervals(table, estimate, resampled, count),
        _held_out(looks, base, parts) if count > 1 else None,
    )  # fmt: skip


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    table, _, estimate, _ = _fitted(looks, base)
    return estimate.model(table)


def _fitted(
    looks: Sequence[LabelledLook], base: DetectorModel
) -> tuple[DetectionTable, float, Estimate, Candidates | None]:
    """The looks, how far their scores are believed, the likeliest numbers, and candidates for look-alikes."""
    table, every = DetectionTable(looks, base), np.ones(len(looks))
    deviation = _deviation(table, _folds(_parts(looks)))
    estimate = _estimate(table, every, deviation)
    if not table.posed.any():
        return table, deviation, estimate, None
    candidates = Candidates.among(table, estimate)
    return table, deviation, _estimate(table, every, deviation, estimate, candidates), candidates


def _parts(looks: Sequence[LabelledLook]) -> np.ndarray:
    """A number for each look ``(L,)``: its group; where all are of one group, its stretch of consecutive looks."""
    names = list(dict.fromkeys(look.group for look in looks))
    if len(names) > 1:
        return np.array([names.index(look.group) for look in looks])
    parts = np.empty(len(looks), dtype=int)
    parts[_in_time(looks)] = np.arange(len(looks)) * min(BLOCKS, len(looks)) // len(looks)
    return parts


def _folds(parts: np.ndarray) -> list[np.ndarray]:
    """Which looks ``(L,)`` are left out, in turn."""
    count = min(FOLDS, int(parts.max()) + 1)
    return [parts % count == fold for fold in range(count)] if count > 1 else []


def _deviation(table: DetectionTable, folds: Sequence[np.ndarray]) -> float:
    """How far scores are believed: what gives the looks that were left out the best likelihood.

    Of those that are within a standard error of the best, the one that believes least (Breiman et al., Classification
    and Regression Trees, 1984).
    """
    if len(table.knots) < 2 or not folds:
        return 0.0
    totals = np.zeros((len(folds), len(DEVIATIONS)))
    for row, fold in zip(totals, folds, strict=True):
        estimate: Estimate | None = None
        for index, deviation in enumerate(DEVIATIONS):
            estimate = _estimate(table, (~fold).astype(float), deviation, estimate)
            row[index] = fold @ table.log_likelihoods(estimate)
    behind = totals[:, [totals.sum(axis=0).argmax()]] - totals
    doubt = behind.std(axis=0, ddof=1) / math.sqrt(len(folds))
    return DEVIATIONS[int(np.flatnonzero(behind.mean(axis=0) <= doubt)[0])]


def _intervals(
    table: DetectionTable, estimate: Estimate, resampled: Sequence[Estimate], parts: int
) -> dict[str, tuple[float, float]]:
    """The bootstrap's intervals; those of rates at least as wide as their posteriors for independent places.

    Wider for few `parts`: expanded percentiles (Hesterberg, The American Statistician 69(4), 2015).
    """
    from scipy import stats

    numbers, looks = estimate.numbers, len(table.looks) + ALARMS_PRIOR[1]
    false = max(numbers["false_alarms_per_look"] * looks - ALARMS_PRIOR[0], 0.0)
    ends = {"false_alarms_per_look": [stats.gamma(false + 0.5, scale=1 / looks).interval(LEVEL)]}
    share = numbers.pop("detection_share")
    if table.places:
        # Looks at one place count for less than looks at as many places: that is what its habit means.
        visits, strength = np.bincount(table.place), float(estimate.habit.sum())
        worth = float((visits * (strength + 1) / (strength + visits)).sum()) + HABIT_PRIOR
        ends["detection_share"] = [stats.beta(worth * share, worth * (1 - share)).interval(LEVEL)]
    if estimate.alikes is not None:
        views = len(np.unique(table.segment[table.posed])) + NUMBER_PRIOR
        ends["look_alikes"] = [stats.gamma(estimate.alikes.number * views + 0.5, scale=1 / views).interval(LEVEL)]
    if resampled:
        levels = stats.norm.cdf(math.sqrt(parts / (parts - 1)) * np.array(stats.t(parts - 1).interval(LEVEL)))
        for name in {**numbers, **ends}:
            ends.setdefault(name, []).append(np.quantile([each.numbers[name] for each in resampled], levels))
    return {name: (float(np.min(each)), float(np.max(each))) for name, each in ends.items()}


def _held_out(looks: Sequence[LabelledLook], base: DetectorModel, parts: np.ndarray) -> HeldOut:
    """Each look read by `base`, and by the model that was fitted on the other parts alone."""
    scores = np.empty((len(looks), 2, 2))  # before and after; density and presence
    for fold in _folds(parts):
        model = fitted_model([look for look, out in zip(looks, fold, strict=True) if not out], base)
        for index in np.flatnonzero(fold).tolist():
            scores[index] = [log_scores(looks[index], each) for each in (base, model)]
    density, presence = scores[..., 0], scores[..., 1]
    with_targets = ~np.isnan(density[:, 0])
    gains = np.nan_to_num(np.diff(density))[:, 0] + np.diff(presence)[:, 0]
    ends = bootstrap_interval(gains, np.random.default_rng(0), LEVEL, groups=parts)
    before, after = presence.mean(axis=0).tolist()
    log_density = tuple(density[with_targets].mean(axis=0).tolist()) if with_targets.any() else None
    return HeldOut(log_density, (before, after), float(gains.mean()), (ends.low, ends.high))


def log_scores(look: LabelledLook, model: DetectorModel) -> tuple[float, float]:
    """Log density at the truth (its mean over targets; NaN without), and log probability of the truth about presence.

    Both after this look alone, from a uniform direction and `PRESENT`. One look cannot tell a look-alike from a false
    alarm, nor an offset from a spread.
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
        return math.nan, -math.log1p(PRESENT / (1 - PRESENT) * mean) if not len(look.targets) else 0.0
    density = np.log(scan.ratio(targets, 1.0)) - math.log(4 * math.pi * mean)
    return float(density.mean()), -math.log1p((1 - PRESENT) / PRESENT / mean)
