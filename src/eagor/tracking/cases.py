"""Absent, standing, wandering or turning: one filter over these cases.

The target is absent, stands still, wanders (a random walk of so many degrees per root second), or turns at a steady
rate (`turning`). Each case with a target holds a belief over directions and is weighted by how well it predicted the
looks; a Markov chain links the cases. This is a Bernoulli filter (Ristic et al., IEEE Transactions on Signal
Processing 61(13), 2013) with interacting multiple models (Blom and Bar-Shalom, IEEE Transactions on Automatic Control
33(8), 1988). The presence is the sum of the weights of the cases with a target.

A wandering target is a density on a grid (`wandering`). A standing target is the sum of all looks since it came to
stand (`standing`). Such a sum cannot absorb a target that stops only now, so the likelier of the two is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor._lazy import lazy
from eagor.belief.field import Patch, SphereField, bent, blurred
from eagor.belief.reading import Reading
from eagor.belief.windows import REACH
from eagor.evidence.detector import Rates
from eagor.evidence.repeating import NONE_YET, CommonError
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.tracking.look import Look, Sight
from eagor.tracking.motion import MotionModel
from eagor.tracking.standing import Standing
from eagor.tracking.turning import Turning
from eagor.tracking.wandering import Wandering

_UNHEARD = 1e-5  # of the belief: cells with less do not count when the detector is learnt
_LEAST_NEW = 1e-6  # of a mean density: the lowest density of a target that comes to stand
_UNLIKELY = 0.05  # if turning is less likely than this, it counts as standing
_LARGEST = 700.0  # nats: the exponential still fits a float64


@dataclass(frozen=True, eq=False)
class Cases:
    """The cases and their probabilities: absent, standing, wandering in one of several ways, turning. World axes.

    `weights` ``(2 + M,)`` or, with `turning`, ``(3 + M,)`` sum to 1; M is the number of paces of `wandering`. `bias`:
    radians by which all looks together may be off: the part of their error that all of them share (`common`).
    """

    weights: np.ndarray
    standing: Standing
    wandering: Wandering
    turning: Turning | None = None
    bias: float = 0.0
    common: CommonError = NONE_YET

    @classmethod
    def prior(cls, motion: MotionModel, standing: Standing, presence: float = 0.5) -> Cases:
        """Before any look; `standing` is a uniform belief."""
        moving = motion.moving
        weights = np.array([1 - presence, presence * (1 - moving), *(presence * moving * motion.kinds)])
        turning = Turning.prior(motion.turn) if motion.turn else None
        return cls(weights, standing, Wandering.prior(motion, standing.degree), turning)

    @property
    def grid(self) -> ErpGrid:
        """On which densities and fields are kept."""
        return self.wandering.grid

    @property
    def presence(self) -> float:
        """Probability that the target is here."""
        return float(1 - self.weights[0])

    @property
    def moving(self) -> float:
        """Probability that it moves, if it is here."""
        here = self.weights[1:].sum()
        return float(self.weights[2:].sum() / here) if here > 0 else 0.0

    @lazy
    def field(self) -> SphereField:
        """log of (density / uniform density), given that the target is present; answers are read from it."""
        shares = self.weights[1:] / max(float(self.weights[1:].sum()), 1e-300)
        stands = self.standing.field
        if self.bias > 0:
            stands = _with_bias(stands, self.bias)
        turns = float(shares[-1]) if self.turning is not None else 0.0
        stays = float(shares[0])
        if turns < _UNLIKELY:
            stays, turns = stays + turns, 0.0
        level = math.log(max(stays, 1e-300)) - self.standing.log_mean
        stands = replace(
            stands,
            values=stands.values + level,
            patches=tuple(patch.like(patch.values + level) for patch in stands.patches),
        )
        if not len(self.wandering) and not turns:
            return stands
        wandering = self.wandering.mixed(shares[1 : 1 + len(self.wandering)])
        elsewhere = SphereField(self.grid, np.log(np.maximum(wandering, 1e-300)))
        turning = self.turning if turns > 0 else None

        def moves(wanders: np.ndarray, where: np.ndarray) -> np.ndarray:
            return wanders if turning is None else wanders + turns * turning.density(where)

        fine = stands.patches
        if turning is not None:
            narrow = 2 * math.pi / self.grid.height
            new = [patch for patch in turning.patches(narrow, 0.02 / turns) if not _is_covered(patch, stands)]
            fine += tuple(patch.like(stands.smooth(patch.directions)) for patch in new)
        patches = []
        for patch in fine:
            moving = moves(np.exp(elsewhere.smooth(patch.directions, 1)), patch.directions)
            patches.append(patch.like(np.logaddexp(patch.values, np.log(moving))))
        moving = moves(wandering, self.grid.directions)
        # Like `logaddexp`, ten times as fast; values are too large for it only where patches lie.
        values = np.log(np.exp(np.minimum(stands.values, _LARGEST)) + np.maximum(moving, 1e-300))
        return SphereField(self.grid, values, tuple(patches))

    @lazy
    def reading(self) -> Reading:
        """The `Reading` of `field`."""
        return Reading(self.field)

    def after(
        self, elapsed: float, motion: MotionModel, drift: float, step: np.ndarray | None, height: float | None
    ) -> Cases:
        """After `elapsed` seconds, in which the body has moved by `step` ``(3,)`` metres; `drift`: of the odometry."""
        standing, common = self.standing, self.common
        if step is not None and step.any():
            standing = standing.moved(step, height)
        if elapsed <= 0:
            return self if standing is self.standing else replace(self, standing=standing)
        flows = self.weights[:, None] * motion.transitions(elapsed)
        stands = self._standing_density() if len(self.wandering) and flows[1, 2:].any() else 0.0
        wandering = self.wandering.after(elapsed, motion, drift, flows, stands)
        turning = self._turned(flows, elapsed, motion, drift)
        if drift > 0:
            standing = _drifted(standing, drift, elapsed)
        kept, newly = flows[1, 1], np.delete(flows[:, 1], 1)
        spread, others = standing.spread, np.delete(flows, 1, axis=1)
        left = float(others[1].sum() / max(others.sum(), 1e-300))  # the share that stood before
        if left > 0:
            standing = standing.spreading(replace(spread, otherwise=spread.mixed(left).weights))
        if newly.sum() > kept:  # it has stopped just now
            standing, common = self._restarted(standing, newly), NONE_YET
        weights = flows.sum(axis=0)
        weights = weights / weights.sum()
        return replace(self, weights=weights, standing=standing, wandering=wandering, turning=turning, common=common)

    def _turned(self, flows: np.ndarray, elapsed: float, motion: MotionModel, drift: float) -> Turning | None:
        """The turning target after `elapsed` seconds, with the inflow from the other cases."""
        if self.turning is None:
            return None
        turned = self.turning.after(elapsed, motion.jumped(elapsed), drift)
        inflow = flows[:2, -1]
        total = float(inflow.sum() + flows[-1, -1])
        if total <= 0:
            return turned
        patches = self.standing.field.patches
        masses = self.standing.masses()
        widths = np.array([patch.spacing for patch in patches]).reshape(-1, 2)
        across = np.array([patch.frame[1:] for patch in patches]).reshape(-1, 2, 3) * widths[..., None]
        covariances = np.einsum("nai,naj->nij", across, across)
        tops = np.array([patch.directions.reshape(-1, 3)[int(patch.values.argmax())] for patch in patches])
        begun = float(inflow[1] / max(inflow.sum(), 1e-300))
        return turned.mixed(float(inflow.sum()) / total, tops.reshape(-1, 3), begun * masses, covariances)

    def _standing_density(self) -> np.ndarray:
        """The standing target's density over a uniform one, on the grid ``(H, W)``.

        Patches are integrated over the cells, which are too wide to sample a sharp peak.
        """
        field, level = self.standing.field, self.standing.log_mean
        found = np.exp(np.minimum(field.values - level, _LARGEST)).reshape(-1)
        weights = field.grid.weights.reshape(-1)
        for patch, shares in zip(field.patches, field.shares, strict=True):
            inside = patch.cells(field.grid)
            mass = float(np.sum(np.exp(np.minimum(patch.values - level, _LARGEST)) * shares))
            cells = float(found[inside] @ weights[inside])
            if cells > 0:
                found[inside] *= mass / cells
            elif not len(inside):  # the patch contains no cell centre
                nearest = int((field.grid.directions @ patch.frame[0]).argmax())
                found[nearest] += mass / weights.min()
        return found.reshape(field.grid.shape)

    def _restarted(self, standing: Standing, newly: np.ndarray) -> Standing:
        """A target that has just come to stand, where it was wandering, or anywhere.

        `newly`: what flows in from the absent target, and from each wanderer.
        """
        density = newly[0] + self.wandering.mixed(newly[1 : 1 + len(self.wandering)])
        if self.turning is not None and newly[-1] > 0:
            density = density + newly[-1] * self.turning.density(self.grid.directions)
        density = np.broadcast_to(density, self.grid.shape)
        field = np.log(np.maximum(density / _mean(density, self.grid), _LEAST_NEW))
        blank = standing.blank()
        blank = blank.spreading(replace(blank.spread, weights=blank.spread.otherwise))
        return replace(blank, coarse=blank.coarse.plus(RealHarmonics(standing.degree).analyse(field, self.grid)))

    def updated(
        self, sight: Sight, rates: Rates | None, passing: Look | None, since: np.ndarray | None
    ) -> tuple[Cases, Look, Rates | None]:
        """After one more look; also returns the look as log ratios, and the detector's rates after it.

        `passing`: the look before it, of which this one repeats a share; the body has moved by `since` from there.
        """
        standing, before = self.standing, self.standing.log_mean
        if sight.detections is not None:
            standing = standing.detecting()
        elapsed = 0.0 if passing is None else sight.stamp - passing.sight.stamp
        moved = 0.0 if since is None else float(np.linalg.norm(since))
        repeated = 0.0 if passing is None else passing.sight.repeating.after(elapsed, moved)
        if passing is not None and repeated > 0:
            standing = standing.plus(passing, -repeated, since)
        look = sight.read(rates, standing.spread)
        learnt = rates
        if sight.detections is not None:
            learnt = self._learnt(sight, look)
        # If the body has moved, the windows were already redrawn for this place.
        fresh = since is not None and bool(since.any())
        standing = standing.opened(look).plus(look).focused(fresh)
        gains = np.zeros(len(self.weights))
        gains[1] = standing.log_mean - before
        wandering, gains[2 : 2 + len(self.wandering)] = self.wandering.updated(look, passing, repeated)
        turning, foretold = self.turning, np.zeros(1)
        if turning is not None:
            turning, gains[-1], foretold = turning.updated(look, passing, repeated)
        spread = self._otherwise(look, foretold)
        log = np.log(np.maximum(self.weights, 1e-300)) + gains
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        taken = repeated if passing is not None and passing.sight.tells else 0.0
        common = self.common.with_look(sight.repeating.left(elapsed, moved), taken, sight.tells)
        bias = sight.bias * math.sqrt(common.correlation) if sight.repeating.fades else sight.bias
        standing = standing.judged(float(weights[1]), spread)
        return Cases(weights, standing, wandering, turning, bias, common), look, learnt

    def _otherwise(self, look: Look, turns: np.ndarray) -> np.ndarray:
        """The weights of the scales ``(S,)`` if the target does not stand, after a look.

        `turns` ``(S,)``: how likely it was for each of them if the target turns.
        """
        otherwise = look.spread.otherwise
        if look.by_scale is None or len(otherwise) == 1:
            return otherwise
        foretold = np.full(len(otherwise), self.weights[0])
        if len(self.wandering):
            roams = self.wandering.mixed(self.weights[2 : 2 + len(self.wandering)])
            foretold += look.by_scale.reshape(len(foretold), -1) @ (roams * self.grid.weights / (4 * math.pi)).ravel()
        if self.turning is not None:
            foretold += self.weights[-1] * turns
        return otherwise * foretold / (otherwise @ foretold)

    def _learnt(self, sight: Sight, look: Look) -> Rates:
        """The detector's rates, learnt from the look."""
        assert look.rates is not None
        assert look.world is not None
        if look.rates.weights.size == 1:
            return look.rates
        values, weights, directions = self.field.nodes
        mass = np.exp(np.minimum(values - self.field.log_mean, _LARGEST)) * weights / (4 * math.pi)
        counts = np.flatnonzero(mass > _UNHEARD)
        mass, directions = mass[counts], directions.take(counts, axis=0)
        mass = mass / mass.sum()
        share: np.ndarray | float = 1.0
        if look.world.views:
            share = look.world.share(directions @ sight.world_R_body)
        covered = float(np.sum(mass * share))
        expected = 0.0
        if len(look.world):
            found = look.world.densities(directions, look.spread.scales) @ (mass * share)
            stands = float(self.weights[1]) / max(self.presence, 1e-300)
            expected = float(look.spread.mixed(stands).weights @ found) * look.world.area
        return look.rates.learnt(self.presence, covered, expected)


def _is_covered(patch: Patch, field: SphereField) -> bool:
    """Whether the middle of a patch lies in one of the field's."""
    return any(other.places(patch.frame[0])[1] for other in field.patches)


def _mean(density: np.ndarray, grid: ErpGrid) -> float:
    """Over the sphere."""
    return float(np.sum(density * grid.weights)) / (4 * math.pi)


def _with_bias(field: SphereField, bias: float) -> SphereField:
    """A field with blurred patches; where they grow over the grid, the grid's values are kept."""
    patches = []
    for patch in field.patches:
        wide = blurred(patch, bias, REACH)
        directions = wide.directions
        outside = ~patch.places(directions)[1]
        around = np.full(wide.values.shape, -np.inf)
        around[outside] = SphereField(field.grid, field.values).smooth(directions[outside], 1)
        patches.append(wide.like(np.logaddexp(wide.values, around)))
    return replace(field, patches=tuple(patches))


def _drifted(standing: Standing, drift: float, elapsed: float) -> Standing:
    """With peaks widened by `elapsed` seconds of odometry drift (`drift` radians per root second).

    Scaling a log-likelihood by s scales the variance of its peak by 1 / s: P + q = P / s.
    """
    patches = standing.field.patches
    width = math.radians(8)
    if patches:
        best = max(patches, key=lambda patch: float(patch.values.max()))
        shares = np.exp(best.values - best.values.max()) * best.weights
        u, v = bent(np.linspace(-1, 1, len(best.values)), best.half, best.bend)[0]
        width = max(math.sqrt(float(np.sum(shares * ((u * u)[:, None] + v * v)) / shares.sum() / 2)), 1e-3)
    return standing.scaled(width**2 / (width**2 + drift**2 * elapsed))
