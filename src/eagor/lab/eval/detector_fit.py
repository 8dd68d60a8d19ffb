"""Fitting a `DetectorModel` on looks with known truth, by penalised maximum likelihood: the numbers, and how sure.

Each target causes at most one detection; what no target caused is a false alarm. Expectation-maximisation, with the
probabilities of these assignments from belief propagation (Williams and Lau, IEEE Transactions on Aerospace and
Electronic Systems 50(4), 2014), exact for one target in a look. Given them, each number has a likelihood of its own:

- Habits: the hits of a place are beta-binomial, since its share of looks is drawn once.
- Errors: normal, of what differs from look to look and of what a place keeps. A box counts as round.
- Scores: a logistic regression of "right or false" on the log odds of the score gives the ratio of two densities
  (Prentice and Pyke, Biometrika 66(3), 1979). It rises, or is flat; a normal prior on its rise draws it towards 1.
- Look-alikes: a Poisson process of places. False detections that lie near each other in the world are of one
  look-alike, or transient and met by chance. Places that were never detected count as well.

Priors say little, as if a few looks had been counted before. The intervals are those of the Bayesian bootstrap (Rubin,
Annals of Statistics 9(1), 1981): it draws the weights of whole groups, and what the priors stand for. What the fit is
worth is judged on groups that were left out in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import betaln, digamma, logit, ndtr, stdtrit

from eagor.evidence.detections import bump_norms
from eagor.evidence.detector import LEAST_OF_SIZE, LEAST_SCORE, LOOK_ALIKES, ClutterRate, DetectorModel
from eagor.grids import ErpGrid
from eagor.lab.eval.labelled_looks import DetectionTable, LabelledLook
from eagor.sphere import angular_distance, unit
from eagor.statistics import PairedDifference, paired_difference

NEAR = 2.5  # deviations: a detection nearer to a target is beside it
SKY = ErpGrid(8, 16)  # directions at which it is counted how many looks covered them
KNOTS = 7  # most places of the score curve
DEVIATION = 2.0  # of the logarithm of the ratio between the lowest and the highest score, in the prior
WIDE = 2.5  # times the stated spread: what is far from a narrow start would stay a false alarm
STEPS, SETTLED = 60, 1e-3  # most steps, and the change of every probability at which they end
ROUNDS, STILL = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
RATES = math.log(1e-3), math.log(1e3)  # logarithms: of transient false alarms in a look, and of look-alikes
HABITS = math.log(0.05), math.log(200)  # logarithms: of the two numbers of a habit
ERRORS = ("spread", "spread_of_size", "offset", "offset_of_size")  # fields of `DetectorModel`, and what is tried
LOW = np.array([math.radians(0.2), LEAST_OF_SIZE, 1e-4, 1e-3])
HIGH = np.array([math.radians(40), 2.0, math.radians(40), 2.0])
FITTED = (*ERRORS, "false_alarms_per_look", "habit", "look_alikes", "look_alike_habit", "score_ratios")
FOLDS, BLOCKS = 5, 10  # parts that are left out in turn; stretches of consecutive looks, where there is one group
RESAMPLES, LEVEL = 200, 0.95
TINY = 1e-300
# What the priors count for: false alarms in one look; places with a known habit, of targets and of look-alikes; views
# with a known number of look-alikes; detections (of the spread); places with one detection each (of the offset).
ALARMS_PRIOR, HABIT_PRIOR, ALIKE_PRIOR, NUMBER_PRIOR, SPREAD_PRIOR, OFFSET_PRIOR = 0.5, 1, 4, 2.0, 2.0, 2.0
FLAT = (0.0, 1.0), (1.0, 1.0)  # ratio 1 for every score


class Prior(NamedTuple):
    """As if this had been counted before the looks.

    The mean logarithms ``(2,)`` of the shares of hits and of misses, at `HABIT_PRIOR` places of targets (`habit`) and
    at `ALIKE_PRIOR` look-alikes (`alike`); `alikes` in `NUMBER_PRIOR` views; the `spread` and `spread_of_size` of
    `SPREAD_PRIOR` detections (`spreads`); `alarms` in one look.
    """

    habit: np.ndarray
    alike: np.ndarray
    alikes: float
    spreads: np.ndarray
    alarms: float

    @classmethod
    def of(cls, base: DetectorModel, rng: np.random.Generator | None = None) -> Prior:
        """What is expected under `base`; with `rng`, what might be counted under it."""
        # Habits are fitted, so a stated detection probability does not say that there are no look-alikes.
        alikes = NUMBER_PRIOR * (LOOK_ALIKES if base.look_alikes is None else base.look_alikes)
        spreads, habits = deviations(base)[:2], (stated_habit(base), base.look_alike_habit)
        if rng is None:
            habit, alike = (digamma(each) - digamma(np.sum(each)) for each in habits)
            return cls(habit, alike, alikes, spreads, ALARMS_PRIOR)
        draws = (rng.dirichlet(*each) for each in zip(habits, (HABIT_PRIOR, ALIKE_PRIOR), strict=True))
        habit, alike = (np.log(shares + TINY).mean(axis=0) for shares in draws)
        alikes, factors = rng.gamma(alikes), np.sqrt(rng.gamma(SPREAD_PRIOR, size=2) / SPREAD_PRIOR)
        return cls(habit, alike, alikes, spreads * factors, rng.gamma(ALARMS_PRIOR))


def stated_habit(base: DetectorModel) -> np.ndarray:
    """The beta distribution ``(2,)`` of a target's share of looks, before any look."""
    habit, known = np.array(base.habit), base.detection_probability
    return habit if known is None else habit.sum() * np.array([known, 1 - known])


def deviations(model: DetectorModel) -> np.ndarray:
    """Its `ERRORS` ``(4,)``."""
    return np.array([getattr(model, name) for name in ERRORS])


def variances(errors: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Variances ``(2, n)`` per axis, of each look and of each place; `own` ``(n,)``: the variance of a box's area."""
    return np.square(errors[::2, None]) + np.square(errors[1::2, None]) * own


def assign(table: DetectionTable, model: DetectorModel) -> tuple[np.ndarray, np.ndarray]:
    """The probabilities ``(P,)`` that a detection is of a target, and ``(D,)`` of any, by belief propagation."""
    rate, square = model.false_alarms_per_look, variances(deviations(model), table.own).sum(axis=0)[table.detection]
    ratios = model.ratios(table.scores, len(table.scores)) * table.areas[table.look] / (rate * table.clutter)
    logs = np.log(ratios)[table.detection] + np.log(np.divide(*stated_habit(model)))
    logs += np.log(bump_norms(square[:, None] ** [-0.5, -0.5])) - (table.offsets**2).sum(axis=1) / (2 * square)
    pairs = np.exp(np.clip(logs, math.log(TINY), -math.log(TINY) / 4))
    back, forth = np.ones_like(pairs), np.zeros_like(pairs)  # messages from detections to targets, and there
    for _ in range(ROUNDS):
        forth = pairs / (1 + _others(pairs * back, table.target))
        before, back = back, 1 / (1 + _others(forth, table.detection))
        if np.abs(back - before).max(initial=0.0) < STILL:
            break
    weights = pairs * back
    shares = weights / (1 + np.bincount(table.target, weights)[table.target])
    return shares, np.minimum(np.bincount(table.detection, shares, len(table.scores)), 1.0)


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(np.bincount(groups, values)[groups] - values, 0.0)


def log_hits(hits: np.ndarray, looks: np.ndarray, habit: np.ndarray) -> np.ndarray:
    """Log of the beta-binomial probability ``(n,)`` of these `hits` in so many `looks`, each in its place."""
    return betaln(habit[0] + hits, habit[1] + looks - hits) - betaln(*habit)


def fitted_habit(hits: np.ndarray, looks: np.ndarray, weights: np.ndarray, prior: Prior, start: Any) -> np.ndarray:
    """The likeliest beta distribution ``(2,)`` of places ``(n,)`` with so many `hits` in so many `looks`.

    `weights` ``(n,)``: how often each counts.
    """

    def loss(logs: np.ndarray) -> float:
        habit = np.exp(logs)
        return -float(weights @ log_hits(hits, looks, habit) + HABIT_PRIOR * (prior.habit @ habit - betaln(*habit)))

    return np.exp(minimize(loss, np.clip(np.log(start), *HABITS), bounds=[HABITS] * 2).x)


def fitted_curve(scores: np.ndarray, right: np.ndarray, weights: np.ndarray) -> tuple[tuple[float, float], ...]:
    """The `score_ratios` for scores ``(n,)``, of which `right` ``(n,)`` says how probably each is of a target.

    `weights` ``(n,)``: how often each counts. Scores beyond `LEAST_SCORE` count as that, as where a model has no curve.
    """
    positive, negative = weights * right, weights * (1 - right)
    scores = np.clip(scores, LEAST_SCORE, 1 - LEAST_SCORE)
    knots = np.unique(np.round(np.quantile(scores, np.linspace(0, 1, KNOTS)), 3))
    if len(knots) < 2 or min(positive.sum(), negative.sum()) < 1:
        return FLAT
    lowest, highest = logit(knots[[0, -1]])
    through, at_knots = ((logit(each) - lowest) / (highest - lowest) for each in (scores, knots))

    def loss(values: np.ndarray) -> float:
        odds = values[0] + values[1] * through
        above = positive @ np.logaddexp(0, -odds) + negative @ np.logaddexp(0, odds)
        return float(above + values[1] ** 2 / (2 * DEVIATION**2))

    prior = math.log(positive.sum() / negative.sum())
    fit = minimize(loss, np.array([prior, 0.0]), bounds=[(None, None), (0, None)]).x
    return tuple(zip(knots.tolist(), np.exp(fit[0] - prior + fit[1] * at_knots).tolist(), strict=True))


def fitted_errors(
    table: DetectionTable, counts: np.ndarray, times: np.ndarray, prior: Prior, start: np.ndarray
) -> np.ndarray:
    """The likeliest deviations ``(4,)``; all but the spread as stated where no place was seen twice with poses.

    Detections are normal about their places, and what a place keeps is of its mean box. `counts` ``(P,)``: how often
    each pair counts in its home; `times` ``(C,)``: how often each home counts.
    """
    stated, free = deviations(table.base), 4 if table.revisits else 1
    home, own, number = table.home, table.own[table.detection], len(times)
    area = np.bincount(home, counts * own, number) / np.maximum(np.bincount(home, counts, number), TINY)

    def loss(logs: np.ndarray) -> float:
        errors = np.append(np.exp(logs), stated[free:])
        per_look, kept = variances(errors, own)[0], variances(errors, area)[1]
        precise = counts / per_look
        pull = sum(np.bincount(home, precise * along, number) ** 2 for along in table.offsets.T)
        mixed = 1 + kept * np.bincount(home, precise, number)
        likelihood = times @ (kept * pull / (2 * mixed) - np.log(mixed))
        likelihood -= (times[home] * counts) @ (np.log(per_look) + (table.offsets**2).sum(axis=1) / (2 * per_look))
        # Spreads are normal in their logarithms; each of two axes of a detection brings a Fisher information of 2.
        doubt = 2 * SPREAD_PRIOR * np.log(errors[:2] / prior.spreads) ** 2
        wide = errors[2:] ** 2 + prior.spreads**2
        doubt += OFFSET_PRIOR * (np.log(wide) + (stated[2:] ** 2 + prior.spreads**2) / wide)
        return float(doubt.sum() - likelihood)

    first = np.maximum(start, [0, 0, 0.3 * start[0], 0.1])[:free]
    found = np.exp(minimize(loss, np.log(first), bounds=np.log([LOW, HIGH]).T[:free]).x)
    return np.append(np.clip(found, LOW[:free], HIGH[:free]), stated[free:])


def estimated(table: DetectionTable, weights: np.ndarray, prior: Prior, start: DetectorModel | None) -> DetectorModel:
    """The likeliest model for looks that count `weights` ``(L,)``, with look-alikes among the false alarms."""
    of_target, of_detection = weights[table.target_look], weights[table.look]
    of_pair, last = of_detection[table.detection], np.full(len(table.target), np.inf)
    visits = np.bincount(table.place, minlength=table.places)
    times = np.bincount(table.place, of_target, table.places) / visits  # how often each place counts
    each = np.maximum(np.bincount(table.home, minlength=table.homes), 1)  # 0 of a place in no look with a detection
    spans = np.bincount(table.home, of_pair, table.homes) / each
    if (model := start) is None:
        alarms, spread = max(float(of_detection.sum() / weights.sum()), 0.1), WIDE * table.base.spread
        known: dict[str, Any] = {"score_ratios": FLAT} if len(table.scores) else {}
        known |= {"detection_probability": None, "habit": tuple(stated_habit(table.base))} if table.places else {}
        model = replace(table.base, false_alarms_per_look=alarms, spread=np.clip(spread, LOW[0], HIGH[0]), **known)
    for _ in range(STEPS):
        shares, right = assign(table, model)
        alarms = max(of_detection @ (1 - right), 0.0) + prior.alarms
        counts = of_pair * shares / np.maximum(spans[table.home], TINY)
        errors = fitted_errors(table, counts, spans, prior, deviations(model))
        numbers: dict[str, Any] = dict(zip(ERRORS, errors.tolist(), strict=True))
        numbers["false_alarms_per_look"] = float(alarms / (weights.sum() + 1))
        if table.places:
            hit = np.minimum(np.bincount(table.target, shares, len(table.place)), 1.0)
            hits = np.minimum(np.bincount(table.place, of_target * hit, table.places) / np.maximum(times, TINY), visits)
            numbers["habit"] = tuple(fitted_habit(hits, visits, times, prior, model.habit).tolist())
        if len(table.scores):
            numbers["score_ratios"] = fitted_curve(table.scores, right, of_detection * table.score_weights)
        model = replace(model, **numbers)
        if np.abs(shares - last).max(initial=0.0) < SETTLED:
            break
        last = shares
    return model


def look_alike_fit(table: DetectionTable, at: DetectorModel) -> Callable[..., DetectorModel]:
    """What tells the look-alikes of a model from transient false alarms; `at`: the model that counts them together.

    C candidates are places of false detections in looks with poses; a second detection beside a target is none.
    """
    errors, false = deviations(at), 1 - assign(table, at)[1]
    wanted, square = false > 0.5, variances(errors, table.own).sum(axis=0)[table.detection]
    wanted[table.detection[(table.offsets**2).sum(axis=1) < NEAR**2 * square]] = False
    errors[1] = table.base.spread_of_size  # what is false scatters more than what is right
    precise, rows, places = 1 / variances(errors, table.own)[0], [], [*SKY.directions.reshape(-1, 3)]
    for members in table.clusters(wanted, 1 / precise):
        of = members[np.unique(table.look[members], return_index=True)[1]]  # one of each look
        places.append(unit(precise[of] @ table.directions[of]))
        # Log density if they are of one place, over that of transient ones: normal, their common middle integrated out.
        each = precise[of] * table.areas[table.look[of]] / table.clutter[of] / (2 * math.pi)
        far = precise[of] * angular_distance(table.directions[of], places[-1]) ** 2
        together = np.log(each).sum() - far.sum() / 2 - math.log(precise[of].sum() / (2 * math.pi))
        rows.append((table.segment[table.look[of[0]]], len(of), together))
    of_segment, hits, together = np.reshape(rows, (-1, 3)).T
    segment, places = of_segment.astype(int), np.array(places)
    exposure = np.zeros((int(table.segment.max()) + 1, len(places)))
    for look, number in zip(table.looks, table.segment, strict=True):  # how many covered each direction and candidate
        exposure[number] += look.covers(places @ look.world)
    seen = np.maximum(exposure[segment, SKY.weights.size + np.arange(len(rows))], hits)
    views, view = np.unique(exposure[:, : SKY.weights.size], return_inverse=True)

    def fitted(model: DetectorModel, weights: np.ndarray, prior: Prior) -> DetectorModel:
        times = np.bincount(table.segment, weights) / np.bincount(table.segment)  # how often each segment counts
        total, alarms = weights.sum() + 1, weights[table.look] @ false + prior.alarms
        often = np.bincount(view.ravel(), np.outer(times, SKY.weights / (4 * math.pi)).ravel())

        def loss(logs: np.ndarray) -> float:
            (rate, number), habit = np.exp(logs[:2]), np.exp(logs[2:])
            likelier = logs[1] - math.log(4 * math.pi) + together + log_hits(hits, seen, habit)
            gain = times[segment] @ np.logaddexp(0, likelier - hits * logs[0]) + alarms * logs[0] - total * rate
            gain -= number * float(often @ (1 - np.exp(log_hits(np.zeros(len(views)), views, habit))))  # never detected
            gain += prior.alikes * logs[1] - NUMBER_PRIOR * number
            return -float(gain + ALIKE_PRIOR * (prior.alike @ habit - betaln(*habit)))

        first = [math.log(alarms / total), math.log(LOOK_ALIKES), *np.log(table.base.look_alike_habit)]
        rate, number, *habit = np.exp(minimize(loss, first, bounds=[RATES, RATES, HABITS, HABITS]).x).tolist()
        return replace(model, false_alarms_per_look=rate, look_alikes=number, look_alike_habit=tuple(habit))

    return fitted


@dataclass(frozen=True)
class DetectorFit:
    """A fitted `model`, and what it rests on.

    `counts`: looks, groups, targets in view, detections; how many of these are of a target (`matched`, a sum of
    probabilities) and how many `false_alarms`. `intervals`: 95 % intervals by name of the number, over groups; with one
    group over stretches of its looks. `held_out`: the gain in `log_score` over the model before, nats per look, on
    looks that the fit had not seen; None for a single look.
    """

    model: DetectorModel
    counts: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    held_out: PairedDifference | None


def fit_detector(
    looks: Sequence[LabelledLook],
    base: DetectorModel | None = None,
    *,
    resamples: int = RESAMPLES,
    judged: bool = True,
    on_step: Callable[[], object] = lambda: None,
) -> DetectorFit:
    """The model of the detector that gave `looks`, fitted by penalised maximum likelihood.

    `base` (default: `DetectorModel()`): the prior of each number. What the looks cannot tell is taken from it: the
    habit without a target in view, the offset and the look-alikes without orientations, `kept_for` and `kept_within`
    always. `resamples`: draws of the groups' weights, for the intervals; `on_step` is called after each. `judged`:
    whether looks are left out in turn. Raises `EagorError` without looks.
    """
    table, every = DetectionTable(looks, base or DetectorModel()), np.ones(len(looks))
    prior, told_apart = Prior.of(table.base), None
    model = estimate = estimated(table, every, prior, None)
    if table.posed and table.base.look_alikes != 0:
        told_apart = look_alike_fit(table, estimate)
        model = told_apart(estimate, every, prior)
    found, matched = len(table.scores), round(float(assign(table, estimate)[1].sum()), 1)
    counts = {"looks": len(looks), "groups": len({look.group for look in looks}), "targets": len(table.place)}
    counts |= {"detections": found, "matched": matched, "false_alarms": round(found - matched, 1)}
    parts, rng, draws = _parts(looks), np.random.default_rng(0), []
    number = int(parts.max()) + 1
    for _ in range(resamples):
        weights, prior = number * rng.dirichlet(np.ones(number))[parts], Prior.of(table.base, rng)
        drawn = estimated(table, weights, prior, estimate)
        draws.append(told_apart(drawn, weights, prior) if told_apart else drawn)
        on_step()
    names = (*ERRORS, "false_alarms_per_look", *(("look_alikes",) if told_apart else ()))
    values = {name: [getattr(drawn, name) for drawn in draws] for name in names}
    if table.places:
        values["detection_share"] = [drawn.habit[0] / sum(drawn.habit) for drawn in draws]
    # Expanded percentiles, wider for few parts (Hesterberg, The American Statistician 69(4), 2015).
    few = max(number, 2)
    ends = stdtrit(few - 1, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])  # of Student's t; scipy.stats takes long to import
    levels = ndtr(math.sqrt(few / (few - 1)) * ends)
    intervals = {name: tuple(np.quantile(each, levels).tolist()) for name, each in values.items() if draws}
    model = replace(model, **{name: short(getattr(model, name)) for name in FITTED})
    held_out = _held_out(looks, table.base, parts) if judged and number > 1 else None
    return DetectorFit(model, counts, intervals, held_out)


def fitted_model(looks: Sequence[LabelledLook], base: DetectorModel) -> DetectorModel:
    """The model alone, as `fit_detector` finds it."""
    return fit_detector(looks, base, resamples=0, judged=False).model


def short(value: Any) -> Any:
    """Numbers, alone or in tuples, with the three digits that mean something; None stays."""
    if isinstance(value, tuple):
        return tuple(map(short, value))
    return None if value is None else float(f"{value:.3g}")


def _parts(looks: Sequence[LabelledLook]) -> np.ndarray:
    """A number for each look ``(L,)``: its group; where all are of one group, its stretch of consecutive looks."""
    names = list(dict.fromkeys(look.group for look in looks))
    if len(names) > 1:
        return np.array([names.index(look.group) for look in looks])
    in_time = np.argsort([look.stamp or 0.0 for look in looks], kind="stable")
    return np.argsort(in_time) * min(BLOCKS, len(looks)) // len(looks)


def _held_out(looks: Sequence[LabelledLook], base: DetectorModel, parts: np.ndarray) -> PairedDifference:
    """Each look read by `base`, and by the model that was fitted on the other parts alone."""
    after, before = np.empty((2, len(looks)))
    for left_out in range(min(FOLDS, int(parts.max()) + 1)):
        fold = parts % FOLDS == left_out
        model = fitted_model([look for look, out in zip(looks, fold, strict=True) if not out], base)
        for index in np.flatnonzero(fold).tolist():
            after[index], before[index] = log_score(looks[index], model), log_score(looks[index], base)
    return paired_difference(after, before, np.random.default_rng(0), parts, LEVEL)


def log_score(look: LabelledLook, model: DetectorModel) -> float:
    """Log density at the truth (its mean over targets) and log probability of the truth about presence, summed.

    After this look alone, from a uniform direction and an even chance of presence. One look cannot tell a look-alike
    from a false alarm, nor an offset from a spread.
    """
    spread, of_size = np.minimum(np.hypot(*deviations(model).reshape(2, 2)), [math.radians(60), 2.0])
    targets, habits = look.in_view, model.habits
    lasting = habits.look_alikes * float(habits.alike_levels @ habits.alike_shares)
    alarms = ClutterRate.prior(model).after(np.full(len(look.detections), lasting))
    rate = 1 / float(alarms.weights @ (1 / (alarms.numbers + lasting)))
    model = replace(model, false_alarms_per_look=rate, spread=spread, spread_of_size=of_size)
    scan = look.detections.read(model)
    mean = float((scan.ratios / scan.clutter).sum()) / rate  # over the sphere, of the likelihood ratio of a place
    mean = 1 + habits.mean * scan.area / (4 * math.pi) * (mean - 1)
    if not len(targets):
        return 0.0 if len(look.targets) else -math.log1p(mean)
    density = np.log(scan.ratio(targets, 1.0)) - math.log(4 * math.pi * mean)
    return float(density.mean()) - math.log1p(1 / mean)
