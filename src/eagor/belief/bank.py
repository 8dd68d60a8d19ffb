"""The bank of habits: what all looks tell about how often each place is detected.

The likelihood ratio of a target at x, whose habit is to be detected in a share p of the looks, is after many looks

    exp F_p(x) = prod_t (1 - p v_t(x) + p v_t(x) S_t(x)),        S_t(x) = sum_i g(z_i | x) / lambda(z_i),

and with the prior w of habits T(x) = sum_p w(p) exp F_p(x). A belief keeps log T, one field. The rest of the bank is
the posterior of the habit at each place, w(p) exp F_p(x) / T(x): with it, the next look adds

    log T  <-  log T + log(1 - m v + m v S),        m(x) = sum_p p w(p) exp F_p(x) / T(x),

so each place has its own probability of detection, which the looks have taught it. A place that draws its habit anew
mixes the posterior with the prior and keeps T. Beside it stand

- the bank of look-alikes, with another prior of habits: `Bank.lead` is the logarithm of its T over the target's;
- that of a target that was never detected (`Bank.missed`): with S = 0, the likelihood ratio M of a target at x if
  something else caused all that was detected there.

What look-alikes explain as well is no sign of the target. With Q the expected number of look-alikes about x times their
likelihood ratio, and b(x) the ratio of the scores, once for each place,

    LR(x) = (b T + Q M) / (1 + Q),

since either the target was detected, and no look-alike is there, or a look-alike was, and the target was missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._values import altered, lazy
from eagor.evidence.detector import Habits
from eagor.grids import ErpGrid

# Maps beside the posteriors of the two habits, counted from the end: see the properties of `Bank`.
LEAD, SILENT, HITS, SCORED, SIZED, EXCUSED = range(-6, 0)
EXTRAS = 6


@dataclass(frozen=True, eq=False)
class Shown:
    """What one look says of some directions.

    `share` v ``(...)``; `ratio` S ``(S, ...)`` for each scale of the spread. Means over what speaks for each direction:
    `score` ``(...)``, the log score ratio, None without scores; `size` ``(...)``, half the angular size in radians,
    None for points.
    """

    share: np.ndarray | float
    ratio: np.ndarray
    score: np.ndarray | None = None
    size: np.ndarray | None = None

    def gains(self, recall: np.ndarray | float) -> np.ndarray:
        """1 - m v + m v S ``(S, ...)``, for the probability m ``(...)`` that a target there is detected."""
        return 1 + (recall * self.share) * (self.ratio - 1)


@dataclass(frozen=True, eq=False)
class Bank:
    """Habits at some directions.

    `maps` ``(C, ...)``: posteriors of the habit of a target there, and of a look-alike, and `EXTRAS` more. `never`
    ``(P + 1, ...)``: the posterior of the habit of a target that was never detected, and log M; of shape ``(P + 1, 1,
    1)`` where it is the same everywhere.
    """

    habits: Habits
    maps: np.ndarray
    never: np.ndarray

    @classmethod
    def blank(cls, habits: Habits, shape: tuple[int, ...]) -> Bank:
        """Before any look."""
        prior = np.concatenate([habits.shares, habits.alike_shares, np.zeros(EXTRAS)])
        maps = np.broadcast_to(_column(prior, len(shape)), (len(prior), *shape))
        return cls(habits, maps, _column(np.append(habits.shares, 0.0), len(shape)))

    @property
    def target(self) -> np.ndarray:
        """The posterior of a target's habit ``(P, ...)``."""
        return self.maps[: len(self.habits.levels)]

    @property
    def alike(self) -> np.ndarray:
        """The posterior of a look-alike's habit ``(A, ...)``; A is 0 if there are none."""
        return self.maps[len(self.habits.levels) : -EXTRAS]

    @property
    def lead(self) -> np.ndarray:
        """log of the look-alike's likelihood over the target's ``(...)``."""
        return self.maps[LEAD]

    @property
    def missed(self) -> np.ndarray:
        """log M ``(...)``, or of shape ``(1, 1)`` where it is the same everywhere."""
        return self.never[-1]

    def judged(self, support: np.ndarray, explained: np.ndarray | None) -> np.ndarray:
        """log LR ``(...)`` from log T, where look-alikes explain so much: log(1 + Q); None: there are none."""
        found = support + self.log_score if self.scored else support
        if explained is None:
            return found
        left = np.minimum(self.excused - explained, 0.0)
        return _log_sum(found + left, self.missed + _log_rest(left))

    @property
    def silent(self) -> np.ndarray:
        """log of the probability that no look detected anything here ``(...)``."""
        return self.maps[SILENT]

    @property
    def excused(self) -> np.ndarray:
        """log(1 + Q) ``(...)`` when the target came to stand: what look-alikes explained before says nothing of it."""
        return self.maps[EXCUSED]

    @property
    def log_score(self) -> np.ndarray:
        """log b ``(...)``: the mean log score ratio of the detections here, as far as there were any."""
        mean = self._mean(SCORED)
        return np.log1p(-np.expm1(self.silent) * np.expm1(mean))

    @property
    def size(self) -> np.ndarray:
        """Half the angular size ``(...)`` of what was detected here, radians: the mean of the detections; 0 if none."""
        return self._mean(SIZED)

    def _mean(self, name: int) -> np.ndarray:
        hits, told = self.maps[HITS], self.maps[name]
        return np.divide(told, hits, out=np.zeros(told.shape), where=hits > 0)

    @property
    def scored(self) -> bool:
        """Whether any score was told."""
        return bool(self.maps[SCORED].any())

    @property
    def sized(self) -> bool:
        """Whether any size was told."""
        return bool(self.maps[SIZED].any())

    @lazy
    def recall(self) -> np.ndarray:
        """m ``(...)``: the probability that a target there is detected by the next look."""
        return mixed(self.habits.levels, self.target)

    @lazy
    def alike_recall(self) -> np.ndarray:
        """The same for a look-alike; 0 if there are none."""
        return mixed(self.habits.alike_levels, self.alike)

    def after(self, shown: Shown, weights: np.ndarray, taken: np.ndarray | float = 1.0) -> Bank:
        """After one more look; `weights` ``(S,)`` of the scales of the spread.

        `taken` ``(...)``: the share of what the look said that log T took in; log T' takes in as much.
        """
        ratio = shown.ratio[0] if len(weights) == 1 else mixed(weights, shown.ratio)
        said = shown.share * (ratio - 1)
        own, other = self.habits.levels, self.habits.alike_levels
        maps = np.empty(self.maps.shape)
        count, middle = len(own), len(self.maps) - EXTRAS
        total = learnt(self.target, own, self.recall, said, maps[:count])
        maps[-EXTRAS:] = self.maps[-EXTRAS:]
        if len(other):
            total = learnt(self.alike, other, self.alike_recall, said, maps[count:middle]) / total
            maps[LEAD] += taken * np.log(total)
        hit = shown.share * np.maximum(1 - 1 / np.maximum(ratio, 1.0), 0.0)
        maps[SILENT] += np.log1p(-np.minimum(hit, 1 - 1e-12))
        maps[HITS] += hit
        for name, told in ((SCORED, shown.score), (SIZED, shown.size)):
            if told is not None:
                maps[name] += hit * told
        if not len(other):
            return altered(self, maps=maps)
        silence = -np.asarray(shown.share, dtype=np.float64)
        silence = silence.reshape((1,) * (maps.ndim - 1)) if silence.ndim == 0 else silence
        shape = np.broadcast_shapes(self.never.shape[1:], silence.shape)
        never = np.empty((count + 1, *shape))
        unseen = self.never[:-1]
        never[-1] = self.never[-1] + np.log(learnt(unseen, own, mixed(own, unseen), silence, never[:-1]))
        return altered(self, maps=maps, never=never)

    def renewed(self, share: float) -> Bank:
        """After a `share` of the places has drawn its habit anew."""
        if share <= 0 or len(self.maps) == 1 + EXTRAS:
            return self
        maps, never = np.empty(self.maps.shape), self.never.copy()
        prior = np.concatenate([self.habits.shares, self.habits.alike_shares])
        np.multiply(self.maps[:-EXTRAS], 1 - share, out=maps[:-EXTRAS])
        maps[:-EXTRAS] += _column(share * prior, maps.ndim - 1)
        maps[-EXTRAS:] = self.maps[-EXTRAS:]
        never[:-1] += share * (_column(self.habits.shares, maps.ndim - 1) - never[:-1])
        return altered(self, maps=maps, never=never)

    def for_sensor(self, habits: Habits) -> Bank:
        """For looks of another detector: habits are drawn anew, what was learnt with the others stays."""
        if habits.same(self.habits):
            return self
        blank = Bank.blank(habits, self.maps.shape[1:])
        maps = np.concatenate([blank.maps[:-EXTRAS], self.maps[-EXTRAS:]])
        shape = self.never.shape[1:]
        never = np.concatenate([np.broadcast_to(blank.never[:-1], (len(habits.shares), *shape)), self.never[-1:]])
        return Bank(habits, maps, never)

    def restarted(self, lead: np.ndarray, excused: np.ndarray) -> Bank:
        """For a target that has just come to stand; what is known of look-alikes stays."""
        blank = Bank.blank(self.habits, self.maps.shape[1:])
        maps = blank.maps.copy()
        count = len(self.habits.levels)
        maps[count:] = self.maps[count:]
        maps[LEAD], maps[HITS:EXCUSED], maps[EXCUSED] = lead, 0.0, excused
        return altered(blank, maps=maps)

    def at_cells(self, grid: ErpGrid, directions: np.ndarray) -> Bank:
        """At directions ``(..., 3)``, of a bank ``(C, H, W)`` on a grid: linear between its cells."""
        if self.never[0].size == 1:
            never = self.never.reshape(-1, *[1] * (directions.ndim - 1))
            return altered(self, maps=linear(grid, self.maps, directions), never=never)
        both = linear(grid, np.concatenate([self.maps, self.never]), directions)
        return altered(self, maps=both[: len(self.maps)], never=both[len(self.maps) :])

    def at_nodes(self, places: np.ndarray) -> Bank:
        """At places ``(2, ...)`` of a bank ``(C, n, n)``, counted in nodes from 0 to n - 1: linear between nodes."""
        if self.never[0].size == 1:
            return altered(self, maps=_between(self.maps, places))
        both = _between(np.concatenate([self.maps, self.never]), places)
        return altered(self, maps=both[: len(self.maps)], never=both[len(self.maps) :])

    def with_nodes(self, nodes: np.ndarray, other: Bank) -> Bank:
        """With the values of another bank ``(C, m)`` at the `nodes`, a mask ``(n, n)`` with m of them."""
        maps, never = self.maps.copy(), self.never
        maps[:, nodes] = other.maps
        if other.never.shape[1:] == (nodes.sum(),) or never[0].size > 1:
            never = np.broadcast_to(never, (len(never), *nodes.shape)).copy()
            never[:, nodes] = other.never
        return altered(self, maps=maps, never=never)


def log_detected(bank: Bank) -> np.ndarray:
    """log of the probability ``(...)`` that anything was detected there."""
    return _log_rest(bank.silent)


def log_over(support: np.ndarray, missed: np.ndarray) -> np.ndarray:
    """log of the share ``(...)`` of T that is not that of a target that was never detected: log(1 - M / T)."""
    return _log_rest(missed - support)


def _log_rest(log: np.ndarray) -> np.ndarray:
    """log(1 - exp(log)) ``(...)``, for a `log` up to 0."""
    return np.log(-np.expm1(np.minimum(log, -1e-300)))


def _log_sum(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """log(exp(one) + exp(other)) ``(...)`` of finite values: as `np.logaddexp`, a fifth of its time."""
    return np.maximum(one, other) + np.log1p(np.exp(-np.abs(one - other)))


def mixed(weights: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """The sum ``(...)`` of maps ``(P, ...)`` with `weights` ``(P,)``: as `np.tensordot`, at less overhead."""
    return (weights @ maps.reshape(len(weights), math.prod(maps.shape[1:]))).reshape(maps.shape[1:])


def _column(values: np.ndarray, dimensions: int) -> np.ndarray:
    return values.reshape(-1, *[1] * dimensions)


def learnt(prior: np.ndarray, levels: np.ndarray, recall: np.ndarray, said: np.ndarray, into: np.ndarray) -> np.ndarray:
    """The posterior of a habit ``(P, ...)`` after a look, written to `into`, and the look's mean ratio ``(...)``.

    `recall` ``(...)``: the mean of the `levels` over the `prior`; `said` ``(...)``: v (S - 1).
    """
    if len(levels) == 1:  # nothing to learn
        into[...] = prior
        return 1 + levels[0] * said
    # The prior sums to 1 but for rounding. Taken for 1, its error would grow from look to look.
    total = prior.sum(axis=0) + recall * said
    np.multiply(_column(levels, said.ndim), said / total, out=into)
    into += 1 / total
    into *= prior
    return total


def _between(maps: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Maps ``(C, n, n)`` at places ``(2, ...)``, counted in nodes: ``(C, ...)``, linear."""
    count = maps.shape[-1]
    low = np.minimum(places.astype(np.intp), count - 2)
    (u, v), (i, j) = places - low, low
    flat, index = maps.reshape(len(maps), -1), i * count + j
    found = (1 - u) * (1 - v) * flat[:, index] + (1 - u) * v * flat[:, index + 1]
    return found + u * (1 - v) * flat[:, index + count] + u * v * flat[:, index + count + 1]


def linear(grid: ErpGrid, maps: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Maps ``(C, H, W)`` on a grid of the whole sphere at directions ``(..., 3)``: ``(C, ...)``, linear."""
    height, width = grid.shape
    x, y, _ = grid.project(directions)
    x, y = x - 0.5, np.clip(y - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(np.intp), np.minimum(y.astype(np.intp), height - 2)
    u, v = x - left, y - top
    flat, right = maps.reshape(len(maps), -1), (left + 1) % width
    left, row = left % width, top * width
    found = (1 - u) * (1 - v) * flat[:, row + left] + u * (1 - v) * flat[:, row + right]
    return found + (1 - u) * v * flat[:, row + width + left] + u * v * flat[:, row + width + right]
