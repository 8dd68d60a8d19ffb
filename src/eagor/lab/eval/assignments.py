"""Which detections of labelled looks are of which targets, and which come again and again.

Detections and targets are assigned by the likelihood of the measurement model itself (`eagor.evidence.detector`): each
target causes at most one detection, and what no target caused is a false alarm. The probabilities come from belief
propagation (Williams and Lau, IEEE Transactions on Aerospace and Electronic Systems 50(4), 2014), which is exact for
one target in a look.

False detections that lie near each other in the world may be of a look-alike, or transient and met by chance. A
look-alike is detected in h of the n looks that had it in view; h is beta-binomial, since its habit is drawn once. With
their number and habit this is a Poisson process of places among Poisson false alarms; `look_alikes` finds its likeliest
numbers by expectation-maximisation. Places that were never detected count as well: they truncate the distribution.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eagor._values import lazy
from eagor.errors import EagorError
from eagor.evidence.detections import bump_norms, tangent_frames
from eagor.evidence.detector import LOOK_ALIKES, DetectorModel
from eagor.lab.eval.labelled_looks import LabelledLook
from eagor.sphere import angular_distance, unit

__all__ = [
    "Assigned", "Candidates", "Deviations", "LookAlikes", "Rows", "candidates", "expected_look_alikes", "fitted_habit",
    "in_time", "look_alikes", "once", "rows_of", "stretches", "sums",
]  # fmt: skip

ROUNDS, SETTLED = 100, 1e-6  # of belief propagation: most rounds, and the change of a message at which it ends
LEAST = 1e-300  # a likelihood below it is rounded zero
APART = math.radians(10)  # from where it was first seen: the same thing, seen from elsewhere, is another place
NEAR, FAR = 2.5, 3.5  # widths about a detection, and about a candidate, in which detections belong to it
LEAST_COUNT = 0.5  # detections of a candidate
POINTS = 96  # directions at which it is counted how many looks covered them
# Places, known exactly, that the prior of a habit counts for: of targets; of look-alikes, where the rare tell little.
HABIT_PRIOR, ALIKE_PRIOR = 1.0, 4.0
NUMBER_PRIOR = 2.0  # views that the prior of the number of look-alikes counts for
ALARMS_PRIOR = (0.5, 1.0)  # false alarms, and looks, that the prior of the false alarms counts for
FLATTEST, SHARPEST = math.log(0.05), math.log(200)  # logarithms of the two numbers of a habit
STEPS, STILL = 100, 1e-3  # of the look-alikes: most steps, and the relative change of every number at which they end


@dataclass(frozen=True)
class Deviations:
    """How far a detection lies from its thing, as the fields of `DetectorModel` say."""

    spread: float
    offset: float
    spread_of_size: float
    offset_of_size: float

    @classmethod
    def stated(cls, model: DetectorModel, spread: float | None = None) -> Deviations:
        """Those of a model; with another `spread`, where that is known better."""
        spread = model.spread if spread is None else spread
        return cls(spread, model.offset, model.spread_of_size, model.offset_of_size)

    def each(self, own: np.ndarray) -> np.ndarray:
        """The variance ``(n, 2)`` of what differs from look to look; `own` ``(n, 2)``: of the box's area."""
        return self.spread**2 + self.spread_of_size**2 * own

    def kept(self, own: np.ndarray) -> np.ndarray:
        """The variance of what a place keeps."""
        return self.offset**2 + self.offset_of_size**2 * own

    def both(self, own: np.ndarray) -> np.ndarray:
        """The variance of one detection about the thing."""
        return self.each(own) + self.kept(own)


@dataclass(frozen=True, eq=False)
class Rows:
    """Labelled `looks` as flat tables: L looks, D detections, T targets in view, P pairs of both in one look.

    `look_of_detection` ``(D,)``, `look_of_target` ``(T,)``; `detection` ``(P,)``, `target` ``(P,)``. `areas` ``(L,)``:
    what each look covered, steradians. `stretch` ``(L,)``: a number for the looks of one view (`stretches`); `place`
    ``(T,)``: one for each thing in each stretch.

    `directions` ``(D, 3)`` and unit `axes` ``(D, 2, 3)`` of the detections in the axes of the world (of the body, where
    the pose is not known), with `scores`, `clutter` ``(D,)``; `own` ``(D, 2)``: variances along these axes of a box's
    area, 0 for points. `offsets` ``(P, 2)``: of the detection from the target along these axes, in Lambert's plane;
    `turns` ``(P, 2, 2)``: the axes in the target's tangent plane.
    """

    looks: tuple[LabelledLook, ...]
    areas: np.ndarray
    stretch: np.ndarray
    look_of_detection: np.ndarray
    look_of_target: np.ndarray
    place: np.ndarray
    directions: np.ndarray
    axes: np.ndarray
    scores: np.ndarray
    clutter: np.ndarray
    own: np.ndarray
    detection: np.ndarray
    target: np.ndarray
    offsets: np.ndarray
    turns: np.ndarray

    @lazy
    def placed(self) -> np.ndarray:
        """Whether each look ``(L,)`` has a known orientation."""
        return np.array([look.world_R_body is not None for look in self.looks])

    def log_densities(self, errors: Deviations) -> np.ndarray:
        """log g(z | w) ``(P,)``, per steradian."""
        return _log_bumps(errors.both(self.own[self.detection]), self.offsets)

    def assigned(
        self, recall: float | np.ndarray, alarms: float, errors: Deviations, log_ratios: np.ndarray
    ) -> Assigned:
        """Which detections are of which targets, for these rates and errors.

        `recall`: of all targets, or ``(T,)``. `log_ratios` ``(D,)``: of the scores.
        """
        areas = self.areas[self.look_of_detection]
        recalls = np.broadcast_to(recall, self.place.shape)
        odds = log_ratios - np.log(alarms * self.clutter / areas)
        found = np.log(recalls / (1 - recalls))[self.target] + odds[self.detection] + self.log_densities(errors)
        pairs = np.exp(np.clip(found, math.log(LEAST), -math.log(LEAST) / 4))
        back, there = np.ones_like(pairs), np.zeros_like(pairs)  # messages from detections to targets, and there
        for _ in range(ROUNDS):
            there = pairs / (1 + _others(pairs * back, self.target))
            before, back = back, 1 / (1 + _others(there, self.detection))
            if not len(pairs) or float(np.abs(back - before).max()) < SETTLED:
                break
        heard = pairs * back
        taken = sums(self.target, heard, len(self.place))
        claimed = sums(self.detection, there, len(self.scores))
        logs = sums(self.look_of_target, np.log1p(taken), len(self.looks))
        logs += sums(self.look_of_detection, np.log1p(claimed), len(self.looks))
        logs -= sums(self.look_of_target[self.target], np.log1p(there * back), len(self.looks))
        return Assigned(self, heard / (1 + taken[self.target]), logs)


@dataclass(frozen=True, eq=False)
class Assigned:
    """Probabilities `shares` ``(P,)`` that a detection is of a target.

    `logs` ``(L,)``: log of the sum over all assignments, over that of "all are false alarms, all targets are missed".
    """

    rows: Rows
    shares: np.ndarray
    logs: np.ndarray

    @property
    def right(self) -> np.ndarray:
        """The probability of each detection ``(D,)`` to be of any target."""
        return np.minimum(sums(self.rows.detection, self.shares, len(self.rows.scores)), 1.0)

    @property
    def found(self) -> np.ndarray:
        """The probability of each target ``(T,)`` to have been detected."""
        return np.minimum(sums(self.rows.target, self.shares, len(self.rows.place)), 1.0)


def rows_of(looks: Sequence[LabelledLook], base: DetectorModel) -> Rows:
    """The looks as tables; `base` gives the relative clutter. Raises `EagorError` without looks."""
    if not looks:
        raise EagorError("there are no looks with detections; wanted at least one")
    read = [look.detections.read(base).turned(look.world) for look in looks]
    seen = [look.in_view @ look.world.T for look in looks]
    look_of_detection, look_of_target = (np.repeat(np.arange(len(looks)), list(map(len, of))) for of in (read, seen))
    target, detection = np.nonzero(look_of_target[:, None] == look_of_detection)
    axes, directions, scores, clutter, own = (
        np.concatenate([getattr(found, name) for found in read])
        for name in ("axes", "directions", "scores", "clutter", "own")
    )
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    at, stretch = np.concatenate(seen), stretches(looks, base)
    return Rows(
        tuple(looks), np.array([found.area for found in read]), stretch, look_of_detection, look_of_target,
        _places(looks, stretch, seen), directions, axes, scores, clutter, own, detection, target,
        _offsets(axes[detection], directions[detection], at[target]),
        np.einsum("pij,pkj->pik", axes[detection], tangent_frames(at)[target]),
    )  # fmt: skip


def _offsets(axes: np.ndarray, directions: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """How far `directions` ``(n, 3)`` lie from `centres` ``(n, 3)`` along `axes` ``(n, 2, 3)``: ``(n, 2)``, radians.

    In Lambert's plane.
    """
    near = np.maximum(1 + np.einsum("ni,ni->n", directions, centres), 1e-9)
    return -np.einsum("nij,nj->ni", axes, centres) * np.sqrt(2 / near)[:, None]


def _log_bumps(variances: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Log densities ``(n,)``, per steradian, of detections with such `variances` and `offsets` ``(n, 2)``."""
    return np.log(bump_norms(variances**-0.5)) - 0.5 * (offsets**2 / variances).sum(axis=1)


def stretches(looks: Sequence[LabelledLook], base: DetectorModel) -> np.ndarray:
    """A number for each look ``(L,)``, the same as long as a group's view stays the same.

    A view ends where places have lost their habits, by `kept_for` and `kept_within` of `base`.
    """
    found, begun = np.empty(len(looks), dtype=int), {}
    for count, index in enumerate(in_time(looks)):
        look = looks[index]
        first, number = begun.get(look.group, (look, -1))
        elapsed = (look.stamp or 0.0) - (first.stamp or 0.0)
        here, there = look.position, first.position
        moved = 0.0 if here is None or there is None else float(np.linalg.norm(here - there))
        if number < 0 or elapsed / (base.kept_for or math.inf) + moved / (base.kept_within or math.inf) > 1:
            begun[look.group] = (look, count)
        found[index] = begun[look.group][1]
    return np.unique(found, return_inverse=True)[1]


def in_time(looks: Sequence[LabelledLook]) -> list[int]:
    """Indices of the looks by stamp; without stamps, as they came."""
    return sorted(range(len(looks)), key=lambda index: looks[index].stamp or 0.0)


def _places(looks: Sequence[LabelledLook], stretch: np.ndarray, seen: Sequence[np.ndarray]) -> np.ndarray:
    """A number for each target in view ``(T,)``, the same for one thing in one stretch.

    `seen`: their directions ``(m, 3)`` of each look. Where poses are known, the thing is what is nearest in the world
    to where it was first seen, within `APART`.
    """
    anchors: dict[int, list[np.ndarray]] = {}
    names: list[tuple[int, int]] = []
    for look, number, directions in zip(looks, stretch.tolist(), seen, strict=True):
        if look.world_R_body is None:
            names += [(number, -1 - index) for index in np.flatnonzero(look.covers(look.targets)).tolist()]
            continue
        known = anchors.setdefault(number, [])
        free = list(range(len(known)))
        for at in directions:
            apart = [float(angular_distance(known[index], at)) for index in free]
            if apart and min(apart) < APART:
                names.append((number, free.pop(int(np.argmin(apart)))))
            else:
                names.append((number, len(known)))
                known.append(at)
    numbers = {name: index for index, name in enumerate(dict.fromkeys(names))}
    return np.array([numbers[name] for name in names], dtype=int)


def sums(groups: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The sum of the `values` ``(n,)`` of each of `count` groups."""
    return np.bincount(groups, values, count).astype(np.float64)


def _others(values: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """For each of `values` ``(P,)`` the sum of the others of its group."""
    return np.maximum(sums(groups, values, 0)[groups] - values, 0.0)


# --- what comes again and again --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidates:
    """C candidates for look-alikes, each in one stretch of looks.

    `stretch` ``(C,)``; `looks` ``(C,)``: how many had it in view. `detection` ``(M,)`` and `place` ``(M,)``: which
    detections belong to which candidate; `offsets` ``(M, 2)`` from its centre along their axes. `exposure` ``(S, X)``:
    how many looks of each stretch covered directions of the world.
    """

    stretch: np.ndarray
    looks: np.ndarray
    detection: np.ndarray
    place: np.ndarray
    offsets: np.ndarray
    exposure: np.ndarray


def candidates(rows: Rows, counts: np.ndarray, errors: Deviations) -> Candidates:
    """Candidates among the detections, which count `counts` ``(D,)`` each; only in looks with a known orientation.

    Where most detections lie within `NEAR` widths of one, about their mean; then among what is left.
    """
    stretch, centres, detection, place = [], [], [], []
    for number, members, near, wide in _neighbours(rows, counts > 0, errors):
        at, left = rows.directions[members], counts[members].copy()
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
    chosen, of_place = (np.concatenate([np.zeros(0, dtype=int), *each]) for each in (detection, place))
    seen, exposure = _covered(rows, which, middles)
    offsets = _offsets(rows.axes[chosen], rows.directions[chosen], middles[of_place])
    return Candidates(which, seen, chosen, of_place, offsets, exposure)


def once(rows: Rows, errors: Deviations) -> np.ndarray:
    """One over the number of detections ``(D,)`` at the place of each: the score of a place is its habit, too.

    Where the pose of a look is not known, each of its detections is a place of its own.
    """
    found = np.ones(len(rows.scores))
    for _, members, near, _ in _neighbours(rows, found > 0, errors):
        found[members] = 1 / near.sum(axis=1)
    return found


def _neighbours(
    rows: Rows, wanted: np.ndarray, errors: Deviations
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Each stretch with poses: its number, its `wanted` detections ``(n,)``, which of them are near, their widths."""
    widths = errors.each(rows.own).mean(axis=1)
    of = np.where(rows.placed, rows.stretch, -1)[rows.look_of_detection]
    for number in np.unique(of[wanted & (of >= 0)]).tolist():
        members = np.flatnonzero((of == number) & wanted)
        at, wide = rows.directions[members], widths[members]
        yield number, members, 2 - 2 * at @ at.T < NEAR**2 * (wide[:, None] + wide) / 2, wide


def _covered(rows: Rows, stretch: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many looks of its stretch covered each centre ``(C,)``, and directions of the world ``(S, X)``."""
    heights = 1 - (2 * np.arange(POINTS) + 1) / POINTS
    around = np.arange(POINTS) * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - heights**2)
    points = np.array([level * np.cos(around), level * np.sin(around), heights]).T
    seen, exposure = np.zeros(len(stretch)), np.zeros((int(rows.stretch.max()) + 1, POINTS))
    for look, number in zip(rows.looks, rows.stretch.tolist(), strict=True):
        if look.world_R_body is not None:
            here = np.flatnonzero(stretch == number)
            seen[here] += look.covers(centres[here] @ look.world)
            exposure[number] += look.covers(points @ look.world)
    return seen, exposure


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


def expected_look_alikes(base: DetectorModel) -> float:
    """Their prior number; habits are fitted, so a stated detection probability does not say that there are none."""
    return LOOK_ALIKES if base.look_alikes is None else base.look_alikes


def look_alikes(
    rows: Rows,
    found: Candidates,
    counts: np.ndarray,
    weights: np.ndarray,
    errors: Deviations,
    base: DetectorModel,
    start: LookAlikes | None = None,
) -> LookAlikes:
    """The likeliest numbers for detections that count `counts` ``(D,)``, in looks that count `weights` ``(L,)``.

    Their priors are in `base`; where that has no look-alikes, there are none.
    """
    from scipy.special import entr, expit, logit

    of_look, variances = rows.look_of_detection[found.detection], errors.each(rows.own[found.detection])
    odds = np.log(rows.areas[of_look] / rows.clutter[found.detection] * counts[found.detection])
    keys, pair = np.unique(found.place * len(rows.looks) + of_look, return_inverse=True)  # of one look at a place
    place, look = np.divmod(keys, len(rows.looks))
    density = np.log(sums(pair, np.exp(_log_bumps(variances, found.offsets) + odds), len(keys)))
    times = np.bincount(rows.stretch, weights) / np.bincount(rows.stretch)  # how often each stretch counts
    of_place = times[found.stretch]
    inner = weights[look] / np.maximum(of_place[place], 1e-300)
    count, total = len(found.stretch), float(weights.sum())
    false = float(weights[rows.look_of_detection] @ counts)
    each = np.bincount(found.place, minlength=count)
    blunt = sums(found.place, np.log(variances).sum(axis=1), count) / (2 * each) - math.log(2)
    unseen, index = np.unique(found.exposure, return_inverse=True)
    often = sums(index.ravel(), np.repeat(times / POINTS, POINTS), len(unseen)) * (unseen > 0)
    expected, prior = expected_look_alikes(base), np.array(base.look_alike_habit)
    now = start or LookAlikes(
        max(false / total, 0.01), max(expected, 0.1) if expected > 0 else 0.0, prior, each.astype(np.float64)
    )
    for _ in range(STEPS):
        recall = (now.habit[0] + now.hits) / (now.habit.sum() + np.maximum(found.looks, now.hits))
        logs = density - math.log(now.alarms)
        chance = expit(logs + logit(np.clip(recall, 1e-6, 1 - 1e-6))[place])
        hits = sums(place, inner * chance, count)
        looks = np.maximum(found.looks, hits)
        gain = sums(place, inner * (chance * logs + entr(chance) + entr(1 - chance)), count)
        gain += blunt - np.log(np.maximum(hits, 1.0)) + _log_hits(hits, looks, *now.habit)
        likely = now.number * np.exp(np.clip(gain, -500, 500))
        there = of_place * likely / (1 + likely)  # how often each candidate is one, and counts
        never = now.number * often * np.exp(_log_hits(np.zeros(len(unseen)), unseen, *now.habit))
        number = (there.sum() + never.sum() + NUMBER_PRIOR * expected) / (often.sum() + NUMBER_PRIOR)
        every = [np.concatenate(both) for both in ((hits, np.zeros(len(unseen))), (looks, unseen), (there, never))]
        after = LookAlikes(
            (max(false - float(there @ hits), 0.0) + ALARMS_PRIOR[0]) / (total + ALARMS_PRIOR[1]),
            float(number) if expected > 0 else 0.0,
            fitted_habit(*every, prior, now.habit, ALIKE_PRIOR),
            hits,
        )
        before, now = now, after
        change = np.array([now.alarms, now.number, *now.habit]) - [before.alarms, before.number, *before.habit]
        if np.abs(change).max() < STILL * (1 + max(before.alarms, before.number, *before.habit)):
            break
    return now


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

    first = np.clip(np.log(start), FLATTEST, SHARPEST)
    return np.exp(minimize(loss, first, jac=True, bounds=[(FLATTEST, SHARPEST)] * 2, method="L-BFGS-B").x)
