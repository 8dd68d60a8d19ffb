"""What is known to stand here and to be detected again and again: a list of look-alikes, each with its own habit.

A field of limited degree shows no weak place beside a strong one: it lies on the slope of the strong one's likelihood.
For a target that moves, each detection there would be news. So what may have caused the detections of earlier looks is
kept as a list: a Poisson multi-Bernoulli filter (Williams, IEEE Transactions on Aerospace and Electronic Systems 51(3),
2015) with the marginal association of probabilistic data association (Bar-Shalom and Tse, Automatica 11(5), 1975). Each
place j of the list exists with probability r_j; look-alikes that no look has detected yet are a Poisson process. With
m_j the probability that a look detects the place, a detection z_i of a look has the density

    lambda(z_i) = false alarms + sum_j r_j m_j v_j g(z_i | j) + look-alikes that were never detected,

and place j learns from the look as cells do (`eagor.belief.bank`), with S_j = sum_i g(z_i | j) over what else may have
caused z_i. Where positions are known, it may stand at any of several ranges: a Gaussian for each, which a step shifts.
A share of the boxes on a thing show only a part of it (`DetectorModel.parts`). These lie anywhere on it, and are no
news either: they count as caused by the place, which learns nothing from them.

If the odometry drifts, all that stands seems to turn, and the list foretells the looks badly. So there is one list for
each drift that is thought possible, and Bayes' rule weighs them (`LookAlikesByDrift`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor._values import altered, lazy
from eagor.belief.bank import learnt, linear
from eagor.belief.ranged import variance_in_shell
from eagor.evidence.detections import LOWEST, Detections, tangent_frames
from eagor.evidence.detector import ClutterRate, Habits, Spread
from eagor.grids import ErpGrid
from eagor.tracking.moving import innovations
from eagor.tracking.scan import Scan

MOST = 32  # places
LEAST = 1e-3  # probability to exist: what is less likely is forgotten
NEAREST = 0.05  # metres from the body
ACROSS = 0.6  # of half a thing's size: the standard deviation per axis of parts of it about its middle
DRIFT, UNTOLD = math.radians(1), 0.1  # of the odometry, radians per root second, and how often it drifts untold


@dataclass(frozen=True, eq=False)
class Heard:
    """How the n detections of a look fit m look-alikes at K ranges, before they are taken in.

    Densities of detections, relative to that of one false alarm a look: `drawn` ``(m, K, n)``, of each place that a
    look detects; `own` ``(m, n)``, as expected of each place; `parts` ``(m, n)``, of boxes on a part of it; `new`
    ``(n, A)``, of look-alikes that were never detected, by habit. `seen` ``(m, K)``: v of each. `gains`
    ``(m, K, 3, 2)``, `inverse` ``(m, K, n, 2, 2)`` and `pull` ``(m, K, n, 2)``: the terms of a Kalman update. `noise`
    ``(n, 3, 3)``: covariances of the detections.
    """

    drawn: np.ndarray
    own: np.ndarray
    parts: np.ndarray
    new: np.ndarray
    seen: np.ndarray
    gains: np.ndarray
    inverse: np.ndarray
    pull: np.ndarray
    noise: np.ndarray

    @lazy
    def density(self) -> np.ndarray:
        """The density ``(n,)`` of detections that look-alikes cause."""
        return (self.own + self.parts).sum(axis=0) + self.new.sum(axis=1)


@dataclass(frozen=True, eq=False)
class LookAlikes:
    """Look-alikes that were detected, and those that were not, world axes about the body.

    `points` ``(m, K, 3)`` with `covariances` ``(m, K, 3, 3)``: where each stands for each of `ranges` ``(K,)``, metres;
    one range of 1 without positions. `shares` ``(m, K)``: probabilities of the ranges. `odds` ``(m,)``: log odds that
    the place exists; `levels` ``(m, A)``: posterior of its habit; `boxes` ``(m, 2)``: how many detections it had, and
    the sum of their `sizes`. `hidden` ``(A, H, W)`` or ``(A, 1, 1)``: the number of look-alikes of each habit that were
    never detected, if the whole sphere were like this cell.
    """

    habits: Habits
    ranges: np.ndarray
    points: np.ndarray
    covariances: np.ndarray
    shares: np.ndarray
    odds: np.ndarray
    levels: np.ndarray
    boxes: np.ndarray
    hidden: np.ndarray

    @classmethod
    def prior(cls, habits: Habits, ranges: np.ndarray | None) -> LookAlikes:
        """Before any look; `ranges` ``(K,)`` in metres, None without positions."""
        ranges = np.ones(1) if ranges is None else ranges
        count, many = len(ranges), habits.look_alikes * habits.alike_shares
        points, covariances = np.zeros((0, count, 3)), np.zeros((0, count, 3, 3))
        levels, hidden = np.zeros((0, len(many))), many.reshape(-1, 1, 1)
        return cls(
            habits, ranges, points, covariances, np.zeros((0, count)), np.zeros(0), levels, np.zeros((0, 2)), hidden
        )

    def __len__(self) -> int:
        return len(self.odds)

    @lazy
    def distances(self) -> np.ndarray:
        """Metres ``(m, K)``."""
        return np.maximum(np.sqrt(np.einsum("mki,mki->mk", self.points, self.points)), NEAREST)

    @lazy
    def directions(self) -> np.ndarray:
        """Unit vectors ``(m, K, 3)``."""
        return self.points / self.distances[..., None]

    @lazy
    def recall(self) -> np.ndarray:
        """The probability ``(m,)`` that a look detects the place, if it exists."""
        return self.levels @ self.habits.alike_levels

    @lazy
    def expected(self) -> np.ndarray:
        """The probability ``(m,)`` that the place exists, and that a look detects it."""
        return 1 / (1 + np.exp(-self.odds)) * self.recall

    def for_sensor(self, habits: Habits) -> LookAlikes:
        """For looks of another detector: habits are drawn anew, the places stay."""
        if habits.same(self.habits):
            return self
        shares = habits.alike_shares
        levels = np.broadcast_to(shares, (len(self), len(shares)))
        many = self.hidden.sum(axis=0) * (habits.look_alikes / self.habits.look_alikes)
        return altered(self, habits=habits, levels=levels, hidden=many * shares.reshape(-1, 1, 1))

    def ranged(self, ranges: np.ndarray) -> LookAlikes:
        """With positions from here on: so far, the places may stand at any of `ranges` ``(K,)``, metres."""
        widths = self.covariances[:, 0] / self.distances[..., None] ** 2
        points, covariances = _at_ranges(self.directions[:, 0], widths, ranges)
        shares = np.full((len(self), len(ranges)), 1 / len(ranges))
        return altered(self, ranges=ranges, points=points, covariances=covariances, shares=shares)

    def after(self, elapsed: float, drift: float, step: np.ndarray | None) -> LookAlikes:
        """After `elapsed` seconds, in which the body has moved by `step` ``(3,)``; `drift`: of the odometry."""
        moved = 0.0 if step is None else float(np.linalg.norm(step))
        anew, found = self.habits.renewal_probability(elapsed, moved), self
        if anew > 0:
            prior = self.habits.alike_shares
            hidden = (1 - anew) * self.hidden + anew * self.hidden.sum(axis=0) * prior.reshape(-1, 1, 1)
            found = altered(self, levels=(1 - anew) * self.levels + anew * prior, hidden=hidden)
        if drift > 0 and len(self):
            across = np.eye(3) - self.directions[..., :, None] * self.directions[..., None, :]
            wider = drift**2 * elapsed * self.distances[..., None, None] ** 2 * across
            found = altered(found, covariances=self.covariances + wider)
        if moved > 0 and len(self.ranges) > 1:
            found = altered(found, points=self.points - step)
        return found

    def heard(self, scan: Scan, spread: Spread) -> Heard:
        """How the detections of a look fit."""
        world = scan.world
        assert world is not None
        noise = world.covariances(float(spread.weights @ spread.scales**-2.0) ** -0.5)
        count, directions = len(self.ranges), self.directions
        flat = directions.reshape(-1, 3)
        covariances = self.covariances / self.distances[..., None, None] ** 2
        frames = tangent_frames(flat)
        gains = covariances.reshape(-1, 3, 3) @ np.swapaxes(frames, 1, 2)
        inverse, pull, drawn = innovations(flat, frames, frames @ gains, world.directions, noise)
        shape = len(self), count, len(world)
        drawn = drawn.reshape(shape) * (world.area / world.clutter)
        seen = np.ones(shape[:2])
        if world.views:
            seen = np.asarray(world.share(directions @ scan.world_R_body))
        there, expected = self.shares * seen, self.expected[:, None]
        own, parts = (expected * np.einsum("mk,mkn->mn", there, each) for each in (drawn, self._parts_at(world)))
        new = self._hidden_at(world) * self.habits.alike_levels
        gains = gains.reshape(*shape[:2], 3, 2) * self.distances[..., None, None]
        terms = gains, inverse.reshape(*shape, 2, 2), pull.reshape(*shape, 2), noise
        return Heard(drawn, own, parts, new, seen, *terms)

    def _parts_at(self, found: Detections) -> np.ndarray:
        """The density ``(m, K, n)`` of detections of a part of each place, if each look detects it."""
        sizes = self.boxes[:, 1] / np.maximum(self.boxes[:, 0], 1e-300)
        precision = np.where(sizes > 0, 1 / np.maximum(ACROSS * sizes, 1e-3) ** 2, 0.0)[:, None, None]
        falls = np.exp(np.maximum((self.directions @ found.directions.T - 1) * precision, LOWEST))
        return found.model.parts * precision / (2 * math.pi) * falls * (found.area / found.clutter)

    def _hidden_at(self, found: Detections) -> np.ndarray:
        """The density ``(n, A)`` of detections of look-alikes that were never detected, if each look detects them."""
        if self.hidden[0].size == 1:
            each = self.hidden.reshape(1, -1)
        else:
            each = linear(ErpGrid(*self.hidden.shape[1:]), self.hidden, found.directions).T
        return each * (found.area / (4 * math.pi) / found.clutter)[:, None]

    def updated(
        self, scan: Scan, heard: Heard, alarms: ClutterRate, share: np.ndarray | float, moving: np.ndarray
    ) -> LookAlikes:
        """After the look; `share` ``(H, W)``: v of the cells. `alarms`: with this look counted.

        `moving` ``(n,)``: the density of detections that what moves causes, as those of `Heard`.
        """
        levels, world = self.habits.alike_levels, scan.world
        assert world is not None
        others = heard.density + moving - heard.own - heard.parts
        rest = np.einsum("a,amn->mn", alarms.weights, 1 / (alarms.numbers[:, None, None] + others))
        ratios = heard.drawn * rest[:, None]  # (m, K, n)
        recall = self.recall
        said = heard.seen * (ratios.sum(axis=2) - 1)
        totals = 1 + recall[:, None] * said
        each = (recall[:, None] * heard.seen / totals)[..., None] * ratios
        taken, boxes = np.einsum("mk,mkn->mn", self.shares, each), np.stack([np.ones(len(world)), world.sizes], axis=-1)
        step = np.einsum("mkn,mkna->mka", each, heard.pull)
        points = self.points + np.einsum("mkia,mka->mki", heard.gains, step)
        # Of the mean update, and of how far the updates by single detections lie apart.
        inner = np.einsum("mkn,mkna,mknb->mkab", each, heard.pull, heard.pull) - step[..., :, None] * step[..., None, :]
        inner -= np.einsum("mkn,mknab->mkab", each, heard.inverse)
        covariances = self.covariances + heard.gains @ inner @ np.swapaxes(heard.gains, 2, 3)
        habit = np.empty(self.levels.T.shape)
        total = learnt(self.levels.T, levels, recall, np.einsum("mk,mk->m", self.shares, said), habit)
        # A detection may be a place of its own, unless a known one is the likelier cause.
        lone = alarms.weights @ (1 / (alarms.numbers[:, None] + heard.own.sum(axis=0) + moving))
        new = np.flatnonzero(heard.own.max(axis=0, initial=0.0) * lone < 0.5)
        amounts = heard.new[new].sum(axis=1)
        born, widths = _at_ranges(world.directions[new], heard.noise[new], self.ranges)
        even = np.full(born.shape[:2], 1 / len(self.ranges))
        found = altered(
            self,
            points=np.concatenate([points, born]),
            covariances=np.concatenate([covariances, widths]),
            shares=np.concatenate([self.shares * totals / total[:, None], even]),
            odds=np.concatenate([self.odds + np.log(total), np.log(np.maximum(amounts * lone[new], 1e-300))]),
            levels=np.concatenate([habit.T, heard.new[new] / np.maximum(amounts, 1e-300)[:, None]]),
            boxes=np.concatenate([self.boxes + taken @ boxes, boxes[new]]),
            hidden=self.hidden * (1 - levels.reshape(-1, 1, 1) * np.asarray(share)),
        )
        return found._likeliest()

    def evidence(self, heard: Heard, alarms: ClutterRate, moving: np.ndarray) -> float:
        """log of the density of a look's detections, up to what is the same for any list; arguments as for `updated`.

        One place after the other, the likeliest first: what it explains is no longer there to be explained. Exact if
        there is one detection.
        """
        order = np.argsort(-self.odds, kind="stable")
        found = (self.expected * np.einsum("mk,mk->m", self.shares, heard.seen))[order]
        alone = float(alarms.weights @ alarms.numbers) + heard.new.sum(axis=1) + moving
        own, missed = heard.own[order], np.maximum(1 - found, LEAST)
        caused = own / missed[:, None]
        each = missed + (own / (alone + np.cumsum(caused, axis=0) - caused)).sum(axis=1)
        return float(np.log(alone).sum() + np.log(each).sum())

    def _likeliest(self) -> LookAlikes:
        """The likeliest places, `MOST` at most."""
        order = np.argsort(-self.odds, kind="stable")[:MOST]
        order = np.sort(order[self.odds[order] > math.log(LEAST)])
        names = "points", "covariances", "shares", "odds", "levels", "boxes"
        return altered(self, **{name: getattr(self, name)[order] for name in names})


@dataclass(frozen=True, eq=False)
class LookAlikesByDrift:
    """The known look-alikes for each drift that the odometry may have.

    `drifts` ``(D,)``: radians per root second; `logs` ``(D,)``: log weights, the largest is 0; `lists`: one for each.
    """

    drifts: np.ndarray
    logs: np.ndarray
    lists: tuple[LookAlikes, ...]

    @classmethod
    def prior(cls, habits: Habits, ranges: np.ndarray | None, drift: float | None) -> LookAlikesByDrift:
        """Before any look; `drift`: radians per root second, None if it is not known. Others as for `LookAlikes`."""
        drifts, shares = ([0.0, DRIFT], [1 - UNTOLD, UNTOLD]) if drift is None else ([drift], [1.0])
        return cls(np.array(drifts), np.log(shares), (LookAlikes.prior(habits, ranges),) * len(drifts))

    @property
    def weights(self) -> np.ndarray:
        """Probabilities ``(D,)`` of the `drifts`."""
        found = np.exp(self.logs)
        return found / found.sum()

    @property
    def drift(self) -> float:
        """The likeliest, radians per root second. A mean would blur all that is known for the sake of a doubt."""
        return float(self.drifts[int(self.logs.argmax())])

    @property
    def likeliest(self) -> LookAlikes:
        """The list for the likeliest drift."""
        return self.lists[int(self.logs.argmax())]

    def for_sensor(self, habits: Habits) -> LookAlikesByDrift:
        """As of `LookAlikes`."""
        return altered(self, lists=tuple(known.for_sensor(habits) for known in self.lists))

    def ranged(self, ranges: np.ndarray) -> LookAlikesByDrift:
        """As of `LookAlikes`."""
        return altered(self, lists=tuple(known.ranged(ranges) for known in self.lists))

    def after(self, elapsed: float, step: np.ndarray | None) -> LookAlikesByDrift:
        """As of `LookAlikes`."""
        pairs = zip(self.lists, map(float, self.drifts), strict=True)
        return altered(self, lists=tuple(known.after(elapsed, drift, step) for known, drift in pairs))

    def heard(self, scan: Scan, spread: Spread) -> list[Heard]:
        """As of `LookAlikes`, for each list."""
        return [known.heard(scan, spread) for known in self.lists]

    def density(self, heard: Sequence[Heard]) -> np.ndarray:
        """The density ``(n,)`` of detections that look-alikes cause."""
        return self.weights @ [each.density for each in heard]

    def updated(
        self,
        scan: Scan,
        heard: Sequence[Heard],
        alarms: ClutterRate,
        share: np.ndarray | float,
        moving: np.ndarray,
    ) -> LookAlikesByDrift:
        """After the look; arguments as for `LookAlikes`."""
        pairs, logs = list(zip(self.lists, heard, strict=True)), self.logs
        if len(pairs) > 1:
            logs = logs + [known.evidence(each, alarms, moving) for known, each in pairs]
        lists = tuple(known.updated(scan, each, alarms, share, moving) for known, each in pairs)
        return altered(self, logs=logs - logs.max(), lists=lists)


def _at_ranges(directions: np.ndarray, widths: np.ndarray, ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gaussians at each of `ranges` ``(K,)``: points ``(n, K, 3)`` and covariances ``(n, K, 3, 3)``, metres.

    In `directions` ``(n, 3)`` with covariances `widths` ``(n, 3, 3)`` across; along, as far as from one range to the
    next.
    """
    points = ranges[:, None] * directions[:, None]
    along = variance_in_shell(ranges) * directions[:, :, None] * directions[:, None, :]
    return points, ranges[:, None, None] ** 2 * (widths + along)[:, None]
