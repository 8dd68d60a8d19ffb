"""Bayes that is not told how the target moves, with all of our prior: the floor of `ideal.py`."""

from __future__ import annotations

import math

import numpy as np
from ideal_filters import Contestant, search_top
from ideal_worlds import Detector
from scipy.stats import qmc

from eagor import MotionModel
from eagor.sphere import unit

STEADY = 0.03  # per root second: relative change of an angular velocity
SPLIT = 0.2  # of the prior's standard deviation of angular velocities: that within a new Gaussian
DRAWN = 256  # directions at which regions of highest density are measured
_EYE = np.eye(3)
_KAPPA = np.geomspace(1e-3, 1e7, 8000)
_SHRUNK = np.log(-np.log(1 / np.tanh(_KAPPA) - 1 / _KAPPA))  # log of -log of the length of the mean direction
Rows = list[np.ndarray]  # of histories; their weights first


class FairBayes(Contestant):
    """Bayes with the prior that is `eagor.MotionModel()`, and the detector stated.

    A history says when the target stood, wandered, turned and jumped, and which detections were of it. If it stands or
    wanders, its direction is then von Mises-Fisher distributed: each detection adds kappa z to a vector whose length is
    the concentration, and a random walk shortens it so that the mean direction is right. If it turns, direction and
    angular velocity have a Gaussian that begins narrow: the velocities of the prior are split into many.

    All histories of a look are weighed. Then they are thinned, to `particles` that turn and a third as many of each
    other kind, by lots that leave each weight what it is on average. What was never detected, or has jumped, is one
    history for each kind.

    Measured: twice the particles change mean nats by 0.006 at most. A plain particle filter that draws the angular
    velocity too and needs no Gaussian (60,000 particles) differs by 0.002 on average; in constant turns it is 0.02 +-
    0.02 ahead, with 150,000. With the same prior, exact random walks on a grid differ by 0.003.
    """

    def __init__(self, detector: Detector, seed: int, particles: int = 1500) -> None:
        self.detector, self.motion = detector, MotionModel()
        self.rng = np.random.default_rng((31, seed))
        self.particles, self.few = particles, particles // 3
        moving, self.turns = self.motion.moving, 1 + len(self.motion.wander)  # the kinds: stands, wanders, turns
        # Absent, then each kind of a target that may be anywhere.
        self.blank = 0.5 * np.array([1, 1 - moving, *(moving * self.motion.kinds)])
        self.still: Rows = [np.zeros(0), np.zeros(0, dtype=int), np.zeros((0, 3))]  # kinds, sums
        self.turning = self._begun(np.zeros(0), np.zeros((0, 3)))
        self.time: float | None = None

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        if self.time is not None:
            self._predict(time - self.time)
        self.time, self.pose = time, pose
        self._update(detections @ pose.T)
        self._read()
        if len(self.still[0]):
            self.direction = search_top(self.at, self.points[self.heights.argmax()], 0.1) @ pose

    def _predict(self, elapsed: float) -> None:
        (weights, kinds, sums), (turned, *moved) = self.still, rotated(self.turning, elapsed, min(self.motion.turn))
        for kind, pace in enumerate(self.motion.wander, 1):
            sums[kinds == kind] = diffused(sums[kinds == kind], pace**2 * elapsed)
        masses = np.append(np.bincount(kinds, weights, self.turns), turned.sum())
        jumped = np.full(len(masses), self.motion.jumped(elapsed))
        jumped[0] = 0
        flows = self.motion.transitions(elapsed)
        self.blank[1:] += jumped * masses
        self.blank = self.blank @ flows
        flows = (1 - jumped)[:, None] * flows[1:]
        self.blank[0] += masses @ flows[:, 0]
        stopped = moved[0] / np.sqrt(np.linalg.det(placed(moved[0], moved[2])[1]))[:, None]
        parts = [[turned * flows[-1, 1], np.zeros(len(turned), dtype=int), stopped]]
        parts += [[weights * flows[kinds, 1 + kind], np.full(len(kinds), kind), sums] for kind in range(self.turns)]
        begun = weights * flows[kinds, -1]
        index = stepped(begun, self.few, self.rng)
        new = self._begun(np.full(len(index), begun.sum() / self.few), sums[index])
        self.still, self.turning = joined(*parts), joined([turned * flows[-1, -1], *moved], new)

    def _begun(self, weights: np.ndarray, sums: np.ndarray) -> Rows:
        """Targets that begin to turn: directions as of `sums` ``(n, 3)``, angular velocities as of the prior."""
        count, lengths = len(weights), np.linalg.norm(sums, axis=1)
        rates = np.repeat(self.motion.turn, count)[:: len(self.motion.turn), None]
        normal = qmc.MultivariateNormalQMC(np.zeros(3), rng=self.rng).random(1 << count.bit_length())[:count]
        covariances = np.zeros((count, 6, 6))
        covariances[:, :3, :3] = _EYE / lengths[:, None, None]
        covariances[:, 3:, 3:] = _EYE * (SPLIT * rates[..., None]) ** 2
        order = self.rng.permutation(count)
        velocities = math.sqrt(1 - SPLIT**2) * rates * normal
        return [weights, sums / lengths[:, None], velocities[order], covariances[order]]

    def _update(self, found: np.ndarray) -> None:
        detector, kappa = self.detector, self.detector.concentration
        gain = detector.detection / detector.alarms
        (weights, kinds, sums), turning = self.still, self.turning
        lengths = np.linalg.norm(sums, axis=1)
        missed = 1 - detector.detection
        still = [[missed * weights, kinds, sums]]
        turns = [[missed * turning[0], *turning[1:]]]
        for detection in found:
            added, alone = sums + kappa * detection, np.tile(kappa * detection, (self.few, 1))
            after = np.linalg.norm(added, axis=1)
            likely = log_norm(lengths) + log_norm(kappa) - log_norm(after) + after - lengths - kappa
            still.append([4 * math.pi * gain * weights * np.exp(likely), kinds, added])
            still.append([gain * self.blank[1:-1], np.arange(self.turns), alone[: self.turns]])
            likely, *corrected = updated(turning, detection, kappa)
            turns.append([4 * math.pi * gain * turning[0] * likely, *corrected])
            turns.append(self._begun(np.full(len(alone), gain * self.blank[-1] / len(alone)), alone))
        self.blank[1:] *= missed
        rows = joined(*still)
        parts = [
            thinned([values[rows[1] == kind] for values in rows], self.few, self.rng) for kind in range(self.turns)
        ]
        self.still, self.turning = joined(*parts), thinned(joined(*turns), self.particles, self.rng)
        total = self.blank.sum() + self.still[0].sum() + self.turning[0].sum()
        for weights in (self.blank, self.still[0], self.turning[0]):
            weights /= total

    def _read(self) -> None:
        """The mixture that `at` reads, and directions that are drawn from it.

        In the equal-area plane about its mean direction a von Mises-Fisher distribution is a Gaussian, cut off.
        """
        lengths = np.linalg.norm(self.still[2], axis=1)[:, None]
        centres = np.concatenate([self.still[2] / lengths, self.turning[1], _EYE[:1]])
        covariances = np.full((len(centres), 3, 3), 1e6 * _EYE)  # the last may be anywhere
        covariances[: len(lengths)] = _EYE / lengths[..., None]
        covariances[len(lengths) : -1] = self.turning[3][:, :3, :3]
        axes, own = placed(centres, covariances)
        roots = np.linalg.cholesky(own)
        weights = np.concatenate([self.still[0], self.turning[0], [self.blank[1:].sum()]])
        tops = weights / weights.sum() * np.exp(log_norm(1 / np.sqrt(np.linalg.det(own))))
        self.mixture = tops, centres, (np.linalg.inv(roots) @ axes).reshape(-1, 3)
        index = stepped(weights, DRAWN, self.rng)
        plane = np.einsum("nab,nb->na", roots[index], self.rng.normal(size=(DRAWN, 2)))
        half = (plane**2).sum(axis=1, keepdims=True) / 4
        away = np.einsum("na,nai->ni", plane, axes[index])
        drawn = (1 - 2 * half) * centres[index] + np.sqrt(np.maximum(1 - half, 0)) * away
        self.points = np.where(half < 1, drawn, unit(self.rng.normal(size=(DRAWN, 3))))
        self.heights = self.at(self.points)

    def at(self, points: np.ndarray) -> np.ndarray:
        """Log density per steradian at world directions ``(n, 3)``, if the target is there."""
        tops, centres, axes = self.mixture
        found = []
        for part in np.array_split(points, 1 + len(points) // 32):
            across = ((axes @ part.T) ** 2).reshape(len(tops), 2, -1).sum(axis=1)
            found.append(tops @ np.exp(-across / np.maximum(1 + centres @ part.T, 1e-9)))
        return np.log(np.concatenate(found))


def joined(*parts: Rows) -> Rows:
    return [np.concatenate(values) for values in zip(*parts, strict=True)]


def stepped(weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices ``(count,)`` of rows at even steps of the sum of the weights; none if that is 0."""
    total = np.cumsum(weights)
    return np.searchsorted(total, (np.arange(count if weights.any() else 0) + rng.random()) / count * total[-1:])


def thinned(rows: Rows, most: int, rng: np.random.Generator) -> Rows:
    """At most so many rows: the heavy ones, and lots that are drawn among the light ones, of equal weights.

    (Fearnhead and Clifford, Journal of the Royal Statistical Society B 65(4), 2003.)
    """
    order = np.argsort(-rows[0], kind="stable")
    order = order[rows[0][order] > 0]
    weights = rows[0][order]
    if len(order) > most:
        rest = np.cumsum(weights[::-1])[::-1]
        kept = int(np.argmax(weights * (most - np.arange(len(order))) <= rest))
        lots = order[kept:][stepped(weights[kept:], most - kept, rng)]
        order = np.append(order[:kept], lots)
        weights = np.append(weights[:kept], np.full(len(lots), rest[kept] / len(lots)))
    return [weights, *(values[order] for values in rows[1:])]


def log_norm(kappa: np.ndarray | float) -> np.ndarray:
    """Log of a von Mises-Fisher density at its top, per steradian."""
    return np.log(kappa / (-2 * math.pi * np.expm1(-2 * np.asarray(kappa))))


def diffused(sums: np.ndarray, variance: float) -> np.ndarray:
    """Von Mises-Fisher distributions after a random walk of this variance per axis, which scales mean directions."""
    lengths = np.linalg.norm(sums, axis=1)
    shrunk = np.exp(np.interp(np.log(lengths), np.log(_KAPPA), _SHRUNK)) + variance
    return sums * (np.exp(np.interp(np.log(shrunk), _SHRUNK[::-1], np.log(_KAPPA)[::-1])) / lengths)[:, None]


def rotations(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations ``(n, 3, 3)`` about `vectors` ``(n, 3)`` by their lengths; matrices of the cross product with them."""
    crosses = np.cross(vectors[:, None, :], _EYE).swapaxes(1, 2)
    angles = np.maximum(np.linalg.norm(vectors, axis=1), 1e-9)[:, None, None]
    twice = crosses @ crosses / angles**2
    return _EYE + np.sin(angles) / angles * crosses + (1 - np.cos(angles)) * twice, crosses


def rotated(rows: Rows, elapsed: float, least: float) -> Rows:
    """Targets that turn, after `elapsed` seconds."""
    weights, directions, turns, covariances = rows
    turned, crosses = rotations(turns * elapsed)
    step = np.zeros((len(weights), 6, 6)) + np.eye(6)
    step[:, :3, :3] = turned
    step[:, :3, 3:] = elapsed * (_EYE + crosses / 2 + crosses @ crosses / 6)
    covariances = step @ covariances @ step.swapaxes(1, 2)
    squares = (turns**2).sum(axis=1) + np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2) + least**2
    covariances[:, 3:, 3:] += (STEADY**2 * elapsed * squares)[:, None, None] * _EYE
    return [weights, np.einsum("nij,nj->ni", turned, directions), turns, covariances]


def placed(directions: np.ndarray, covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two tangent vectors ``(n, 2, 3)`` at each direction, and the covariances ``(n, 2, 2)`` along them."""
    first = unit(np.cross(directions, _EYE[np.abs(directions).argmin(axis=1)]))
    second = np.cross(directions, first)
    moves = np.stack([second, -first], axis=1)  # a small rotation phi moves d by phi x d
    return np.stack([first, second], axis=1), moves @ covariances[:, :3, :3] @ moves.swapaxes(1, 2)


def updated(rows: Rows, detection: np.ndarray, kappa: float) -> Rows:
    """Targets that turn, after this detection of them, by a Kalman update; first its density, per steradian."""
    _, directions, turns, covariances = rows
    axes, own = placed(directions, covariances)
    with_state = covariances[:, :, :3] @ np.stack([axes[:, 1], -axes[:, 0]], axis=1).swapaxes(1, 2)
    inverse = np.linalg.inv(own + np.eye(2) / kappa)
    cosine, away, alone = directions @ detection, axes @ detection, 1 / np.sqrt(np.linalg.det(own))
    # `short`: how much shorter the sum of two vectors is if they are not parallel; with it, round Gaussians are exact.
    short = np.sqrt(np.maximum(1 - 2 * alone * kappa * (1 - cosine) / (alone + kappa) ** 2, 1e-6))
    pull = np.einsum("nab,nb->na", inverse, away)
    squares = 2 * (away * pull).sum(axis=1) / np.maximum(1 + cosine, 1e-9)
    density = np.sqrt(np.linalg.det(inverse)) / (2 * math.pi * short) * np.exp(-squares / (1 + short))
    change = np.einsum("nia,na->ni", with_state, pull / short[:, None])
    covariances = covariances - with_state @ inverse @ with_state.swapaxes(1, 2)
    scale = np.repeat([1 / np.sqrt(short), np.ones(len(short))], 3, axis=0).T
    covariances *= scale[:, :, None] * scale[:, None, :]
    directions = unit(np.einsum("nij,nj->ni", rotations(change[:, :3])[0], directions))
    return [density, directions, turns + change[:, 3:], covariances]
