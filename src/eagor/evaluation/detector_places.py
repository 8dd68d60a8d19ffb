"""Places where detections come again and again, told from detections that do not.

A place is detected in h of the n looks that had it in view; h is beta-binomial, since its habit is drawn once
(`eagor.evidence.detector`). Detections that lie near each other in the world may be such a place, of one of several
kinds (things, look-alikes), or transient false alarms that met by chance. With the expected number of places of each
kind and their habits, this is a Poisson process of places among Poisson false alarms; `split` finds its likeliest
numbers by expectation-maximisation. Places that were never detected count as well: they are what truncates the
distribution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.evaluation.labelled_looks import Deviations, Rows, offsets_along, sums
from eagor.evidence.detections import bump_norms, tangent_frames
from eagor.sphere import unit

__all__ = ["Candidates", "Split", "candidates", "fitted_habit", "once", "rate_interval", "scatter", "split"]

NEAR, FAR = 2.5, 3.5  # widths about a detection, and about a candidate, in which detections belong to it
LEAST_COUNT = 0.5  # detections of a candidate
POINTS = 96  # directions at which it is counted how many looks covered them
# Places, known exactly, that the prior of a habit counts for: of targets, and of look-alikes, where the rare ones tell
# little.
HABIT_PRIOR, ALIKE_PRIOR = 1.0, 4.0
NUMBER_PRIOR = 2.0  # views that the prior of the number of places counts for
ALARMS_PRIOR = (0.5, 1.0)  # false alarms, and looks, that the prior of the false alarms counts for
FLATTEST, SHARPEST = math.log(0.05), math.log(200)  # logarithms of the two numbers of a habit
Errors = tuple[np.ndarray, np.ndarray, np.ndarray]  # of detections about a place (`scatter`)
STEPS, SETTLED = 100, 1e-3  # most steps, and the relative change of every number at which they end


@dataclass(frozen=True, eq=False)
class Candidates:
    """C candidates for places, each in one stretch of looks.

    `stretch` ``(C,)``; `looks` ``(C,)``: how many had it in view. `detection` ``(M,)`` and `place` ``(M,)``: which
    detections belong to which candidate; `offsets` ``(M, 2)`` from its centre along their axes, `turns` ``(M, 2, 2)``:
    the axes in the tangent plane there. `exposure` ``(S, X)``: how many looks of each stretch covered directions of the
    world.
    """

    stretch: np.ndarray
    looks: np.ndarray
    detection: np.ndarray
    place: np.ndarray
    offsets: np.ndarray
    turns: np.ndarray
    exposure: np.ndarray


def candidates(rows: Rows, counts: np.ndarray, errors: Deviations) -> Candidates:
    """Candidates among the detections, which count `counts` ``(D,)`` each; only in looks with a known orientation.

    Where most detections lie within `NEAR` widths of one, about their mean; then among what is left.
    """
    widths = errors.each(rows.own).mean(axis=1)
    of, free = rows.stretch[rows.look_of_detection], counts * rows.placed[rows.look_of_detection]
    stretch, centres, detection, place = [], [], [], []
    for number in np.unique(of[free > 0]).tolist():
        members = np.flatnonzero((of == number) & (free > 0))
        at, wide, left = rows.directions[members], widths[members], free[members].copy()
        near = 2 - 2 * at @ at.T < NEAR**2 * (wide[:, None] + wide) / 2
        while left.max() > 0 and (total := near @ left).max() >= LEAST_COUNT:
            chosen = near[int(np.where(left > 0, total, 0).argmax())] * left / wide
            if not chosen.any():
                break
            centre = unit(chosen @ at)
            own = np.flatnonzero((left > 0) & ((2 - 2 * at @ centre < FAR**2 * wide) | (chosen > 0)))
            detection.append(members[own])
            place.append(np.full(len(own), len(centres)))
            stretch.append(number)
            centres.append(centre)
            left[own] = 0
    which, middles = np.array(stretch, dtype=int), np.reshape(centres, (-1, 3))
    seen, exposure = _covered(rows, which, middles)
    chosen = np.concatenate([np.zeros(0, dtype=int), *detection])
    of_place = np.concatenate([np.zeros(0, dtype=int), *place])
    axes, centre = rows.axes[chosen], middles[of_place]
    return Candidates(
        which, seen, chosen, of_place, offsets_along(axes, rows.directions[chosen], centre),
        np.einsum("pij,pkj->pik", axes, tangent_frames(centre)), exposure,
    )  # fmt: skip


def once(rows: Rows, errors: Deviations) -> np.ndarray:
    """One over the number of detections ``(D,)`` at the place of each: the score of a place is its habit, too.

    Where the pose of a look is not known, each of its detections is a place of its own.
    """
    found, widths = np.ones(len(rows.scores)), errors.each(rows.own).mean(axis=1)
    of = np.where(rows.placed, rows.stretch, -1)[rows.look_of_detection]
    for number in np.unique(of[of >= 0]).tolist():
        members = np.flatnonzero(of == number)
        at, wide = rows.directions[members], widths[members]
        near = 2 - 2 * at @ at.T < NEAR**2 * (wide[:, None] + wide) / 2
        found[members] = 1 / near.sum(axis=1)
    return found


def _covered(rows: Rows, stretch: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many looks of its stretch covered each centre ``(C,)``, and directions of the world ``(S, X)``."""
    heights = 1 - (2 * np.arange(POINTS) + 1) / POINTS
    around = np.arange(POINTS) * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - heights**2)
    points = np.array([level * np.cos(around), level * np.sin(around), heights]).T
    seen, exposure = np.zeros(len(stretch)), np.zeros((int(rows.stretch.max()) + 1, POINTS))
    for look, number in zip(rows.looks, rows.stretch.tolist(), strict=True):
        if look.world_R_body is None:
            continue
        here = np.flatnonzero(stretch == number)
        seen[here] += look.covers(centres[here] @ look.world)
        exposure[number] += look.covers(points @ look.world)
    return seen, exposure


@dataclass(frozen=True, eq=False)
class Split:
    """What became of the candidates, K kinds of places among transient false alarms.

    `alarms` per look; `numbers` ``(K,)`` of places expected on the whole sphere, with `habits` ``(K, 2)``. `shares`
    ``(C, K)``: how probably each candidate is of each kind; `hits` ``(C,)``: in how many looks it was detected.
    `chances` ``(M,)``: how probably each detection is of its candidate, if that is a place. `log`: log likelihood.
    """

    alarms: float
    numbers: np.ndarray
    habits: np.ndarray
    shares: np.ndarray
    hits: np.ndarray
    chances: np.ndarray
    log: float


def split(
    rows: Rows,
    found: Candidates,
    counts: np.ndarray,
    weights: np.ndarray,
    errors: Deviations,
    numbers: np.ndarray,
    habits: np.ndarray,
    start: Split | None = None,
) -> Split:
    """The likeliest split of detections that count `counts` ``(D,)``, in looks that count `weights` ``(L,)``.

    Priors: `numbers` ``(K,)``, 0 for no such places, and `habits` ``(K, 2)``.
    """
    of_look = rows.look_of_detection[found.detection]
    lengths = errors.each(rows.own[found.detection]) ** -0.5
    log_density = np.log(bump_norms(lengths)) - 0.5 * (found.offsets**2 * lengths**2).sum(axis=1)
    log_density += np.log(rows.areas[of_look] / rows.clutter[found.detection] * counts[found.detection])
    keys, pair = np.unique(found.place * rows.count + of_look, return_inverse=True)  # detections of one look at a place
    place, look = np.divmod(keys, rows.count)
    density = sums(pair, np.exp(log_density), len(keys))
    part = np.exp(log_density) / np.maximum(density[pair], 1e-300)
    times = np.bincount(rows.stretch, weights) / np.bincount(rows.stretch)  # how often each stretch counts
    of_place = times[found.stretch]
    inner = weights[look] / np.maximum(of_place[place], 1e-300)
    count, total = len(found.stretch), float(weights.sum())
    false = float(weights[rows.look_of_detection] @ counts)
    sharp = sums(found.place, np.log(lengths).sum(axis=1), count) / np.bincount(found.place, minlength=count)
    unseen, index = np.unique(found.exposure, return_inverse=True)
    often = sums(index.ravel(), np.repeat(times / POINTS, POINTS), len(unseen)) * (unseen > 0)
    now = start or Split(
        max(false / total, 0.01), np.maximum(numbers, 0.1) * (numbers > 0), habits,
        np.full((count, len(numbers)), 1 / len(numbers)), np.zeros(0), np.zeros(0), -math.inf,
    )  # fmt: skip
    hits = sums(found.place, np.ones(len(found.place)), count) if start is None else now.hits
    for _ in range(STEPS):
        recall = (now.habits[:, 0] + hits[:, None]) / (now.habits.sum(axis=1) + np.maximum(found.looks, hits)[:, None])
        shares = (now.shares + 1e-9) / (now.shares + 1e-9).sum(axis=1, keepdims=True)
        odds = np.clip((recall * shares).sum(axis=1), 1e-6, 1 - 1e-6)
        logs = np.log(density / now.alarms)
        chance = 1 / (1 + np.exp(-np.clip(logs + np.log(odds / (1 - odds))[place], -500, 500)))
        hits = sums(place, inner * chance, count)
        doubt = -_xlogx(chance) - _xlogx(1 - chance)
        evidence = sums(place, inner * (chance * logs + doubt), count) - sharp - math.log(2)
        evidence -= np.log(np.maximum(hits, 1.0))
        looks = np.maximum(found.looks, hits)
        log_habits = np.stack([_log_hits(hits, looks, *habit) for habit in now.habits], axis=1)
        likely = now.numbers * np.exp(np.clip(evidence[:, None] + log_habits, -500, 500))
        shares = likely / (1 + likely.sum(axis=1, keepdims=True))
        silent = [often * np.exp(_log_hits(np.zeros(len(unseen)), unseen, *habit)) for habit in now.habits]
        log = float(of_place @ np.log1p(likely.sum(axis=1))) + false * math.log(now.alarms) - total * now.alarms
        log -= sum(n * (often.sum() - never.sum()) for n, never in zip(now.numbers, silent, strict=True))
        taken = float(of_place @ (shares.sum(axis=1) * hits))
        alarms = (max(false - taken, 0.0) + ALARMS_PRIOR[0]) / (total + ALARMS_PRIOR[1])
        expected, fitted = [], []
        for kind, (number, never) in enumerate(zip(now.numbers, silent, strict=True)):
            here = of_place * shares[:, kind]
            expected.append(
                (here.sum() + number * never.sum() + NUMBER_PRIOR * numbers[kind]) / (often.sum() + NUMBER_PRIOR)
            )
            fitted.append(
                fitted_habit(
                    np.concatenate([hits, np.zeros(len(unseen))]),
                    np.concatenate([looks, unseen]),
                    np.concatenate([here, number * never]),
                    habits[kind],
                    now.habits[kind],
                    ALIKE_PRIOR,
                )
            )
        before = np.concatenate([[now.alarms], now.numbers, now.habits.ravel()])
        now = Split(
            alarms, np.array(expected) * (numbers > 0), np.array(fitted), shares, hits, chance[pair] * part, log
        )
        after = np.concatenate([[now.alarms], now.numbers, now.habits.ravel()])
        if np.abs(after - before).max() < SETTLED * (1 + np.abs(before).max()):
            break
    return now


def rate_interval(events: float, span: float, level: float) -> tuple[float, float]:
    """The interval of a rate after so many `events` in a `span`: what is left to doubt however alike the groups are."""
    from scipy.special import gammaincinv

    low, high = gammaincinv(max(events, 0.0) + 0.5, [(1 - level) / 2, (1 + level) / 2]) / span
    return float(low), float(high)


def _xlogx(values: np.ndarray) -> np.ndarray:
    return values * np.log(np.maximum(values, 1e-300))


def _log_hits(hits: np.ndarray, looks: np.ndarray, a: float, b: float) -> np.ndarray:
    """Log of the beta-binomial probability ``(n,)`` of these `hits` in so many `looks`, each in its place."""
    from scipy.special import betaln

    return betaln(a + hits, b + looks - hits) - betaln(a, b)


def fitted_habit(
    hits: np.ndarray,
    looks: np.ndarray,
    weights: np.ndarray,
    base: np.ndarray,
    start: np.ndarray,
    prior: float = HABIT_PRIOR,
) -> np.ndarray:
    """The likeliest beta distribution ``(2,)`` of places ``(n,)`` with so many `hits` in so many `looks`.

    `weights` ``(n,)``: how often each counts. The `prior` are so many places whose shares are as `base` ``(2,)`` says.
    """
    from scipy.optimize import minimize
    from scipy.special import betaln, psi

    kept = (weights > 1e-9) & (looks > 0)
    hits, looks, weights = hits[kept], looks[kept], weights[kept]
    misses, total = looks - hits, float(weights.sum()) + prior
    mean_logs = prior * (psi(base) - psi(base.sum()))

    def loss(logs: np.ndarray) -> tuple[float, np.ndarray]:
        a, b = np.exp(logs)
        value = weights @ betaln(a + hits, b + misses) + mean_logs @ (a, b) - total * betaln(a, b)
        both = weights @ psi(a + b + looks) - total * psi(a + b)
        slopes = np.array([weights @ psi(a + hits) - total * psi(a), weights @ psi(b + misses) - total * psi(b)])
        return -float(value), -(slopes + mean_logs - both) * (a, b)

    ends = [(FLATTEST, SHARPEST)] * 2
    first = np.clip(np.log(start), FLATTEST, SHARPEST)
    return np.exp(minimize(loss, first, jac=True, bounds=ends, method="L-BFGS-B").x)


def scatter(errors: Errors, place: np.ndarray, counts: np.ndarray, times: np.ndarray, deviations: Deviations) -> float:
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
