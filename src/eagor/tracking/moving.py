"""Targets that move: one that wanders, and one that turns at a steady rate.

A wandering target is a random walk on the sphere, one density for each pace. A density on a grid is diffused exactly,
by one product: the heat kernel multiplies the coefficients of degree l by exp(-l (l + 1) sigma^2 / 2).

A target that turns is a Gaussian mixture over direction and angular velocity. This constant-turn model on the sphere
covers what walks past, what circles, and standing things while the odometry's heading drifts. Each detection may be the
target and makes a Kalman update of each component; the likeliest are kept (a Bernoulli Gaussian-mixture filter; Ristic
et al., IEEE Transactions on Signal Processing 61(13), 2013; the mixture: Vo and Ma, ibid. 54(11), 2006).

The error of a component is a small rotation phi and an error of the angular velocity, in world axes: the
direction is exp(phi) d, and after t seconds phi becomes R phi + t (error of the velocity) with R = exp(velocity t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor._values import altered, lazy
from eagor.belief.bank import mixed
from eagor.belief.field import Patch, SphereField
from eagor.evidence.detections import LOWEST, bump_norms, scaled_frames, tangent_frames
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid
from eagor.tracking.config import MotionModel
from eagor.tracking.scan import Sightings

FAINTEST = 1e-12  # of a mean density: lower values are ringing of the truncated series


@dataclass(frozen=True, eq=False)
class WanderingTarget:
    """The belief about a wandering target: `densities` ``(M, H, W)`` over a uniform one, on `grid`; world axes."""

    grid: ErpGrid
    densities: np.ndarray

    @classmethod
    def prior(cls, motion: MotionModel, degree: int) -> WanderingTarget:
        """Before any look."""
        grid = decoding_grid(degree)
        return cls(grid, np.ones((len(motion.wander), *grid.shape)))

    def __len__(self) -> int:
        return len(self.densities)

    def mixed(self, weights: np.ndarray) -> np.ndarray:
        """The sum of the densities with `weights` ``(M,)``: ``(H, W)``."""
        return mixed(weights, self.densities)

    def after(
        self, elapsed: float, motion: MotionModel, drift: float, flows: np.ndarray, stands: np.ndarray | float
    ) -> WanderingTarget:
        """After `elapsed` seconds, with the inflow from the other hypotheses.

        `flows`: probabilities of the transitions between the hypotheses; `stands`: density of the standing target ``(H,
        W)``; `drift`: of the odometry.
        """
        grid = self.grid
        if not len(self):
            return self
        basis = RealHarmonics(grid.height // 2 - 1)  # the grid's: a density is narrower than its logarithm
        jumped = motion.jumped(elapsed)
        sigmas = np.hypot(motion.wander, drift) * math.sqrt(elapsed)
        spread = basis.synthesise(basis.smooth(basis.analyse(self.densities, grid), sigmas[:, None]), grid)
        roamed = (1 - jumped) * np.maximum(spread, FAINTEST) + jumped
        wander = slice(2, 2 + len(sigmas))
        born, begun, kept = (flow[wander, None, None] for flow in (flows[0], flows[1], np.diagonal(flows)))
        mixed = kept * roamed + begun * stands + born
        means = np.einsum("mij,ij->m", mixed, grid.weights) / (4 * math.pi)
        return altered(self, densities=mixed / means[:, None, None])

    def updated(self, ratio: np.ndarray, new: np.ndarray) -> tuple[WanderingTarget, np.ndarray]:
        """After one more look of this likelihood `ratio` ``(H, W)``, and its logarithm for each pace ``(M,)``.

        `new` ``(H, W)``: the part of the ratio that does not repeat the look before.
        """
        if not len(self):
            return self, np.zeros(0)
        shares = self.grid.weights / (4 * math.pi)
        gains = np.log(np.einsum("mij,ij->m", self.densities, new * shares))
        densities = self.densities * ratio
        densities /= np.einsum("mij,ij->m", densities, shares)[:, None, None]
        return altered(self, densities=densities), gains


MOST = 24  # components
FAINT = 1e-4  # of the heaviest: lighter components are dropped
STEADY = 0.03  # per root second: relative change of the angular velocity
BENDS, BEND_SHARES, BEND_VARIANCE = (-1.1, 0.0, 1.1), (0.3, 0.4, 0.3), 0.27
FAR = 5.5  # standard deviations: beyond, a Gaussian is left out
WIDEST = math.radians(50)  # wider Gaussians do not fit a tangent plane
ALIKE = 0.05  # of the variance: nearer components are merged for drawing
LIGHT = 1e-2  # of the weight: lighter ones are not drawn
FINE = 2  # patches
NODES, REACH = 11, 4.0  # of a patch about a component
_EYE = np.eye(3)


@dataclass(frozen=True, eq=False)
class TurningTarget:
    """The belief about a turning target; world axes.

    `rates` ``(K,)``: radians per second, the prior standard deviations of each component of the angular velocity.
    `unseen`: the weight of a target that was never detected and may be anywhere. Components: `weights` ``(N,)``,
    `directions` ``(N, 3)``, angular velocities `turns` ``(N, 3)`` and `covariances` ``(N, 6, 6)`` of both. `unseen` and
    the weights sum to 1.
    """

    rates: tuple[float, ...]
    unseen: float
    weights: np.ndarray
    directions: np.ndarray
    turns: np.ndarray
    covariances: np.ndarray

    @classmethod
    def prior(cls, rates: tuple[float, ...]) -> TurningTarget:
        """Before any look."""
        return cls(rates, 1.0, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 6, 6)))

    def after(self, elapsed: float, jumped: float, drift: float) -> TurningTarget:
        """After `elapsed` seconds, in which a share `jumped` has jumped anywhere; `drift`: of the odometry."""
        kept = altered(self, unseen=self.unseen * (1 - jumped) + jumped, weights=self.weights * (1 - jumped))
        if not len(self.weights):
            return kept
        turned = _rotations(self.turns * elapsed)
        step = np.zeros((len(self.weights), 6, 6))
        step[:, :3, :3] = turned
        step[:, :3, 3:] = elapsed * _EYE + 0.5 * elapsed**2 * _crosses(self.turns)  # of first order in the turn
        step[:, 3:, 3:] = _EYE
        covariances = step @ self.covariances @ np.swapaxes(step, 1, 2)
        speed = np.sum(self.turns**2, axis=1) + min(self.rates) ** 2
        covariances[:, 3:, 3:] += (STEADY**2 * elapsed * speed)[:, None, None] * _EYE
        covariances[:, :3, :3] += drift**2 * elapsed * _EYE
        wide = WIDEST**2 / np.maximum(np.linalg.eigvalsh(covariances[:, :3, :3])[:, -1], WIDEST**2)
        scale = np.sqrt(wide)[:, None, None]
        covariances[:, :3, :] *= scale
        covariances[:, :, :3] *= scale
        directions = np.einsum("nij,nj->ni", turned, self.directions)
        return altered(kept, directions=directions, covariances=covariances)

    def mixed(self, share: float, directions: np.ndarray, shares: np.ndarray, covariances: np.ndarray) -> TurningTarget:
        """With a `share` of targets that begin to turn now, at `directions` ``(n, 3)`` with covariances ``(n, 3, 3)``.

        `shares` ``(n,)``: how they are distributed over these; the rest to 1 may be anywhere.
        """
        born = self._born(share * shares, directions, covariances)
        unseen = (1 - share) * self.unseen + share * (1 - float(shares.sum()))
        old = altered(self, weights=self.weights * (1 - share))
        return _joined(old, born, unseen=unseen)

    def updated(
        self, sightings: Sightings, before: SphereField | None = None, repeated: float = 0.0
    ) -> tuple[TurningTarget, float, np.ndarray]:
        """After one more look, and the look's log likelihood ratio.

        Also its likelihood for each scale of the spread ``(S,)``, if there are several. `repeated`: share of the log
        ratios `before`, of the look before it, that it repeats.
        """
        missed = sightings.missed(self.directions)
        peaks, amplitudes, spreads = sightings.directions, sightings.amplitudes, sightings.covariances
        found = altered(self, weights=self.weights * missed)
        born = self._born(self.unseen * amplitudes / (4 * math.pi), peaks, spreads)
        unseen = self.unseen * sightings.mean_missed
        parts = [found, born]
        foretold = np.full(len(sightings.scaled), unseen + float(found.weights.sum() + born.weights.sum()))
        if len(self.weights) and len(peaks):
            detected, likely = self._detected(sightings)
            parts.append(detected)
            foretold += likely
        total = unseen + sum(float(part.weights.sum()) for part in parts)
        joined = _joined(*parts, unseen=unseen)
        gain = math.log(total)
        if before is not None and repeated > 0 and len(joined.weights):
            gain -= repeated * float(joined.weights @ before.smooth(joined.directions, 1))
        return joined, gain, foretold

    def _born(self, weights: np.ndarray, directions: np.ndarray, covariances: np.ndarray) -> TurningTarget:
        """New components, of which only the direction is known."""
        # The bend of a path shows late, and then no single Gaussian fits: start with three for each rate.
        shares, bends, variances = _starts(self.rates)
        joint = np.zeros((len(shares), len(directions), 6, 6))
        joint[..., :3, :3] = covariances
        across = _EYE - (1 - BEND_VARIANCE) * (directions[:, :, None] * directions[:, None, :])
        joint[..., 3:, 3:] = variances[:, None, None, None] * across
        return altered(
            self,
            weights=(shares[:, None] * weights).reshape(-1),
            directions=np.concatenate([directions] * len(shares)),
            turns=(bends[:, None, None] * directions).reshape(-1, 3),
            covariances=joint.reshape(-1, 6, 6),
        )

    def _detected(self, seen: Sightings) -> tuple[TurningTarget, np.ndarray]:
        """A Kalman update of each component by each detection, and its likelihood for each scale ``(S,)``."""
        count, amplitudes = len(seen.directions), seen.amplitudes
        spreads = np.concatenate([seen.covariances[None], seen.scaled]).reshape(-1, 3, 3)
        peaks = np.tile(seen.directions, (1 + len(seen.scaled), 1))
        frames, gains, own = self._across
        inverse, pull, likely = innovations(self.directions, frames, own, peaks, spreads)
        foretold = (self.weights @ likely[:, count:]).reshape(-1, count) @ amplitudes
        weights = self.weights[:, None] * amplitudes * likely[:, :count]
        kept = np.nonzero(weights > FAINT * max(float(weights.max()), 1e-300))
        if len(kept[0]) > MOST:
            best = np.argsort(-weights[kept], kind="stable")[:MOST]
            kept = kept[0][best], kept[1][best]
        owner = kept[0]
        gain = gains[owner] @ inverse[kept]
        change = np.einsum("mia,ma->mi", gains[owner], pull[kept])
        detected = altered(
            self,
            weights=weights[kept],
            directions=np.einsum("nij,nj->ni", _rotations(change[:, :3]), self.directions[owner]),
            turns=self.turns[owner] + change[:, 3:],
            covariances=self.covariances[owner] - gain @ np.swapaxes(gains[owner], 1, 2),
        )
        return detected, foretold

    @lazy
    def _across(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Two tangent vectors ``(N, 2, 3)`` at each direction, and the covariances of the position along them.

        With the state ``(N, 6, 2)``, and with each other ``(N, 2, 2)``.
        """
        frames = tangent_frames(self.directions)
        # A small rotation phi moves d by phi x d: along the first by phi . second, along the second by -phi . first.
        moves = np.stack([frames[:, 1], -frames[:, 0]], axis=1)
        gains = self.covariances[:, :, :3] @ np.swapaxes(moves, 1, 2)
        return frames, gains, moves @ gains[:, :3]

    @lazy
    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The marginal over directions: weights ``(n,)``, directions ``(n, 3)`` and `axes` as of `Detections`.

        Nearby components of similar width are merged.
        """
        frames, _, own = self._across
        covariances = np.swapaxes(frames, 1, 2) @ own @ frames
        traces = own[:, 0, 0] + own[:, 1, 1]
        apart = 1 - self.directions @ self.directions.T
        alike = (apart < ALIKE * traces) & (np.abs(np.log(traces[:, None] / traces)) < 0.5)
        np.fill_diagonal(alike, True)  # also where rounding leaves a direction a little shorter than 1
        free = np.ones(len(self.weights), dtype=bool)
        places, groups = [], []
        for index in np.flatnonzero(self.weights > LIGHT * (1 - self.unseen)).tolist():  # the heaviest first
            if free[index]:
                places.append(index)
                groups.append(alike[index] & free)
                free &= ~alike[index]
        shares = np.array(groups, dtype=bool).reshape(len(groups), len(free)) * self.weights
        found, order = shares.sum(axis=1), np.array(places, dtype=np.intp)
        merged = ((shares / found[:, None]) @ covariances.reshape(-1, 9)).reshape(-1, 3, 3)
        frames = frames[order]
        found *= (1 - self.unseen) / max(float(found.sum()), 1e-300)
        return found, self.directions[order], scaled_frames(frames, frames @ merged @ np.swapaxes(frames, 1, 2))

    def density(self, where: np.ndarray) -> np.ndarray:
        """Density over a uniform one ``(...)``, at unit vectors ``(..., 3)``."""
        weights, centres, axes = self.places
        if not len(weights):
            return np.ones(where.shape[:-1])
        lengths = np.linalg.norm(axes, axis=-1)
        heights = weights * bump_norms(lengths) * 4 * math.pi
        reach = np.cos(np.minimum(FAR / lengths.min(axis=-1), math.pi))
        points = where.reshape(-1, 3).T
        ahead = centres @ points
        along = (axes.reshape(-1, 3) @ points).reshape(len(weights), 2, -1)
        along *= along
        falls = np.exp(np.maximum(-(along[:, 0] + along[:, 1]) / np.maximum(1 + ahead, 1e-9), LOWEST))
        falls[ahead <= reach[:, None]] = 0.0
        return (self.unseen + heights @ falls).reshape(where.shape[:-1])

    def patches(self, narrow: float, least: float) -> tuple[Patch, ...]:
        """Patches (values 0) about components narrower than `narrow` radians that hold at least `least`."""
        found: list[Patch] = []
        for weight, centre, axes in zip(*self.places, strict=True):
            widths = 1 / np.linalg.norm(axes, axis=1)
            if weight < least or widths.min() > narrow or len(found) == FINE:
                continue
            if any(patch.places(centre)[1] for patch in found):
                continue
            frame = np.array([centre, *(axes * widths[:, None])])
            half = np.minimum(np.tan(np.minimum(REACH * widths, 1.0)), 0.5)
            found.append(Patch(frame, half, np.zeros((NODES, NODES))))
        return tuple(found)


def innovations(
    directions: np.ndarray, frames: np.ndarray, own: np.ndarray, peaks: np.ndarray, spreads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The prediction of k detections, `peaks` ``(k, 3)`` with covariances `spreads` ``(k, 3, 3)``, by N Gaussians.

    These stand at `directions` ``(N, 3)`` with covariances `own` ``(N, 2, 2)`` along the tangent vectors `frames` ``(N,
    2, 3)``. Of each error, the inverse covariance ``(N, k, 2, 2)``, that times the error ``(N, k, 2)``, and the density
    ``(N, k)``.
    """
    cosine = np.clip(directions @ peaks.T, -1, 1)
    across = np.einsum("nai,ki->nka", frames, peaks)
    angle = np.arccos(cosine)
    residual = across * (angle / np.maximum(np.sin(angle), 1e-6))[..., None]
    noise = np.einsum("nai,kij,nbj->nkab", frames, spreads, frames)
    total = own[:, None] + noise
    determinant = total[..., 0, 0] * total[..., 1, 1] - total[..., 0, 1] ** 2
    inverse = np.empty_like(total)
    inverse[..., 0, 0], inverse[..., 1, 1] = total[..., 1, 1], total[..., 0, 0]
    inverse[..., 0, 1] = inverse[..., 1, 0] = -total[..., 0, 1]
    inverse /= determinant[..., None, None]
    pull = np.einsum("nkab,nkb->nka", inverse, residual)
    exponent = -0.5 * np.einsum("nka,nka->nk", pull, residual)
    return inverse, pull, np.exp(np.maximum(exponent, LOWEST)) / (2 * math.pi * np.sqrt(determinant))


@lru_cache(maxsize=16)
def _starts(rates: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the new components of one direction ``(n,)``: shares, rates along the bend, variances of the rates."""
    shares = np.tile(np.array(BEND_SHARES) / len(rates), len(rates))
    return shares, np.outer(rates, BENDS).reshape(-1), np.repeat(np.array(rates) ** 2, len(BENDS))


def _joined(*parts: TurningTarget, unseen: float) -> TurningTarget:
    """The likeliest components of all, weights that sum to 1 with `unseen`."""
    weights = np.concatenate([part.weights for part in parts])
    order = np.argsort(-weights, kind="stable")[:MOST]
    order = order[weights[order] > FAINT * max(float(weights.max(initial=0.0)), 1e-300)]
    total = unseen + float(weights[order].sum())
    pick = {
        name: np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("directions", "turns", "covariances")
    }
    return altered(parts[0], unseen=unseen / total, weights=weights[order] / total, **pick)


def _rotations(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices ``(n, 3, 3)`` about `vectors` ``(n, 3)`` by their lengths (Rodrigues' formula)."""
    angles, crosses = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))[:, None, None], _crosses(vectors)
    angles = np.maximum(angles, 1e-20)
    whole, half = math.pi * (angles / math.pi), math.pi * (angles / (2 * math.pi))
    once, twice = np.sin(whole) / whole, 0.5 * (np.sin(half) / half) ** 2
    return _EYE + once * crosses + twice * (crosses @ crosses)


def _crosses(vectors: np.ndarray) -> np.ndarray:
    """Matrices ``(n, 3, 3)`` that take a vector to its cross product with each of `vectors` ``(n, 3)``."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 0] = -z, y, z
    found[:, 1, 2], found[:, 2, 0], found[:, 2, 1] = -x, -y, x
    return found
