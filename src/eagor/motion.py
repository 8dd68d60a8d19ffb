"""Is it here, does it stand, or does it wander? One filter over what there can be, each case weighed by what it foretold.

The target is not here, or it stands where it is, or it wanders by so many degrees per root second. Each case that has a
target holds a belief over directions; a Markov chain leads from case to case (a Bernoulli filter over several models of
motion: interacting multiple models, Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988; Ristic et
al., IEEE Transactions on Signal Processing 61(13), 2013). Presence is what the cases with a target weigh together.

A wanderer is held as a density on a grid: there diffusion is exact and costs one product, since the heat kernel
multiplies the coefficients of degree l by exp(-l (l + 1) sigma^2 / 2). A target that stands is held as the sum of all
looks since it stands (`eagor.standing`), which a change of case cannot enter. So of the two ways to stand, since then or
since now, the likelier one is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


import numpy as np

from eagor._lazy import lazy

from eagor._checks import require, within
from eagor.belief import Belief
from eagor.detector import Rates
from eagor.field import SphereField, blurred, sharpened
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.local import REACH
from eagor.looks import Look, Sight
from eagor.peaks import decoding_grid
from eagor.ranged import RangedBelief
from eagor.reading import Reading
from eagor.standing import Standing

_UNHEARD = 1e-5  # of the belief: a cell that holds less tells nothing of the detector
_FAINTEST = 1e-12  # of a mean density: what lies lower is the ringing of a cut series


@dataclass(frozen=True)
class MotionModel:
    """How targets come, go and move. Rates are per second: 0.002 means once in 500 seconds.

    - `wander`: radians per root second, one number for each kind of moving target that is reckoned with; empty: every
      target stands still.
    - `start`: rate at which a standing target begins to move.
    - `stop`: rate at which a moving one comes to stand.
    - `jump`: rate at which a moving one turns up anywhere else (carried off, or lost from sight and seen again).
    - `birth`, `death`: rates at which a target appears and disappears.
    """

    wander: tuple[float, ...] = (math.radians(2.5), math.radians(10))
    start: float = 0.01
    stop: float = 0.02
    jump: float = 0.03
    birth: float = 0.0005
    death: float = 0.0005

    def __post_init__(self) -> None:
        rates = {name: (within(getattr(self, name), 0, 100), "a rate per second, from 0 on") for name in _RATES}
        angles = isinstance(self.wander, tuple | list) and all(
            within(angle, 0, math.pi) and angle > 0 for angle in self.wander
        )
        require(self, rates | {"wander": (angles, "radians per root second above 0, in a tuple")})
        object.__setattr__(self, "wander", tuple(float(angle) for angle in self.wander))

    @classmethod
    def still(cls) -> MotionModel:
        """Targets that are there or not, and never move."""
        return cls(wander=(), start=0.0, stop=0.0, jump=0.0, birth=0.0, death=0.0)

    @property
    def moving(self) -> float:
        """The share of targets that move: where `start` and `stop` are in balance."""
        if not self.wander:
            return 0.0
        return self.start / (self.start + self.stop) if self.start + self.stop > 0 else 0.0


_RATES = ("start", "stop", "jump", "birth", "death")


@dataclass(frozen=True, eq=False)
class Cases:
    """What there can be, with its probability: absent, standing, or wandering in one of several ways. World axes.

    `weights` ``(2 + M,)`` sum to 1. `wanderers` ``(M, H, W)``: densities over a uniform one, on the decoding grid.
    `bias`: radians by which all looks together may lie beside the thing: the part of their error that repeats.
    `sharpening`: what the precision of peaks is read as, over what it was added up with (`Rates.sharpening`).
    """

    weights: np.ndarray
    standing: Standing
    wanderers: np.ndarray
    bias: float = 0.0
    sharpening: float = 1.0

    @classmethod
    def prior(cls, motion: MotionModel, standing: Standing, presence: float = 0.5) -> Cases:
        """Before any look; `standing` is a belief that knows nothing."""
        count, grid = len(motion.wander), decoding_grid(standing.degree)
        moving = motion.moving
        weights = np.array([1 - presence, presence * (1 - moving), *[presence * moving / max(count, 1)] * count])
        return cls(weights, standing, np.ones((count, *grid.shape)))

    @property
    def grid(self) -> ErpGrid:
        """Of the wanderers."""
        return decoding_grid(self.standing.degree)

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
        """log of the density over a uniform one, given that the target is here: what answers are read from."""
        shares = self.weights[1:] / max(float(self.weights[1:].sum()), 1e-300)
        stands = self.standing.field
        if abs(self.sharpening - 1) > 0.01:
            stands = replace(stands, patches=tuple(sharpened(patch, self.sharpening) for patch in stands.patches))
        if self.bias > 0:
            stands = _with_bias(stands, self.bias)
        level = math.log(max(float(shares[0]), 1e-300)) - self.standing.log_mean
        if not len(self.wanderers):
            return replace(
                stands,
                values=stands.values + level,
                patches=tuple(patch.like(patch.values + level) for patch in stands.patches),
            )
        roams = np.log(np.maximum(np.tensordot(shares[1:], self.wanderers, axes=1), 1e-300))
        elsewhere = SphereField(self.grid, roams)
        patches = tuple(
            patch.like(np.logaddexp(patch.values + level, elsewhere.smooth(patch.directions, 1)))
            for patch in stands.patches
        )
        return SphereField(self.grid, np.logaddexp(stands.values + level, roams), patches)

    @lazy
    def reading(self) -> Reading:
        """What can be read from `field`."""
        return Reading(self.field)

    def after(
        self, elapsed: float, motion: MotionModel, drift: float, step: np.ndarray | None, height: float | None
    ) -> Cases:
        """After `elapsed` seconds, in which the body has moved by `step` ``(3,)`` metres; `drift`: of the odometry."""
        standing = self.standing
        if step is not None and step.any():
            standing = standing.moved(step, height)
        if elapsed <= 0:
            return self if standing is self.standing else replace(self, standing=standing)
        if drift > 0:
            standing = _drifted(standing, drift, elapsed)
        born, died = _switched(motion.birth, motion.death, elapsed), _switched(motion.death, motion.birth, elapsed)
        begun, stopped = _switched(motion.start, motion.stop, elapsed), _switched(motion.stop, motion.start, elapsed)
        absent, stood, roamed = float(self.weights[0]), float(self.weights[1]), self.weights[2:]
        count = len(roamed)
        if count == 0:
            begun = 0.0
        moving = motion.moving
        # What flows into each case, and with which density.
        new_stand, from_roam = absent * born * (1 - moving), roamed * ((1 - died) * stopped)
        kept = stood * (1 - died) * (1 - begun)
        inflow = new_stand + float(from_roam.sum())
        wanderers = np.empty_like(self.wanderers)
        weights = np.empty_like(self.weights)
        weights[0] = absent * (1 - born) + died * (stood + float(roamed.sum()))
        weights[1] = kept + inflow
        if inflow > kept and inflow > 0:  # it stands since now
            standing = self._restarted(standing, new_stand, from_roam)
        if count:
            self._roam(wanderers, weights, elapsed, motion, drift, absent * born * moving / count, stood * (1 - died) * begun / count)
        weights /= weights.sum()
        return Cases(weights, standing, wanderers, self.bias, self.sharpening)

    def _roam(
        self, wanderers: np.ndarray, weights: np.ndarray, elapsed: float, motion: MotionModel, drift: float,
        newborn: float, started: float,
    ) -> None:  # fmt: skip
        """Write the wanderers' densities and weights after `elapsed` seconds."""
        died, stopped = _switched(motion.death, motion.birth, elapsed), _switched(motion.stop, motion.start, elapsed)
        jumped = -math.expm1(-motion.jump * elapsed)
        grid = self.grid
        basis = RealHarmonics(grid.height // 2 - 1)  # a density is narrower than its logarithm: all that the grid holds
        stands = None
        if started > 0:
            field = self.standing.field
            stands = np.exp(np.minimum(field.values - self.standing.log_mean, 700.0))
            if field.patches:
                stands = _filled(field, stands, self.standing.log_mean)
        for index, rate in enumerate(motion.wander):
            stays = float(self.weights[2 + index]) * (1 - died) * (1 - stopped)
            sigma = math.hypot(rate * math.sqrt(elapsed), drift * elapsed)
            density = basis.synthesise(basis.smooth(basis.analyse(self.wanderers[index], grid), sigma), grid)
            density = np.maximum(density, _FAINTEST)
            mixed = stays * ((1 - jumped) * density + jumped) + newborn
            if stands is not None:
                mixed += started * stands
            total = float(np.sum(mixed * grid.weights)) / (4 * math.pi)
            weights[2 + index] = stays + newborn + started
            wanderers[index] = mixed / total if total > 0 else 1.0

    def _restarted(self, standing: Standing, newborn: float, stopped: np.ndarray) -> Standing:
        """A target that has come to stand just now, where it was wandering, or anywhere."""
        mixed = newborn + (np.tensordot(stopped, self.wanderers, axes=1) if len(stopped) else 0.0)
        mixed = np.broadcast_to(np.asarray(mixed, dtype=np.float64), self.grid.shape)
        mean = float(np.sum(mixed * self.grid.weights)) / (4 * math.pi)
        found = RealHarmonics(standing.degree).analyse(np.log(np.maximum(mixed / mean, 1e-6)), self.grid)
        coarse = standing.coarse
        blank = Standing.uniform(standing.degree, coarse.ranges if isinstance(coarse, RangedBelief) else None, standing.height)
        return replace(blank, coarse=blank.coarse.plus(found))

    def updated(self, sight: Sight, rates: Rates | None, passing: Look | None, since: np.ndarray | None) -> tuple[Cases, Look, Rates | None]:
        """With one more look.

        `passing`: the look before it, of which this one repeats a share, taken before the body moved by `since`.
        Returns the look as it was read, and what is known of the detector's rates after it.
        """
        standing, before = self.standing, self.standing.log_mean
        repeated = 0.0
        if passing is not None and passing.sight.repeats > 0:
            repeated = passing.sight.repeats
            standing = standing.plus(passing, -repeated, since)
        look = sight.read(rates)
        learnt = rates
        if sight.detections is not None:
            learnt = self._learnt(sight, look)
        # Where the body has moved, its windows were drawn for this place just now.
        fresh = since is not None and bool(since.any())
        standing = standing.opened(look).plus(look).focused(fresh)
        gains = np.zeros(len(self.weights))
        gains[1] = standing.log_mean - before
        wanderers = self.wanderers
        if len(wanderers):
            ratio = np.exp(look.values)
            new = ratio if repeated == 0 else np.exp(look.values - repeated * passing.values)  # type: ignore[union-attr]
            shares = self.grid.weights / (4 * math.pi)
            gains[2:] = np.log(np.einsum("mij,ij->m", wanderers, new * shares))
            wanderers = wanderers * ratio
            wanderers /= np.einsum("mij,ij->m", wanderers, shares)[:, None, None]
        log = np.log(np.maximum(self.weights, 1e-300)) + gains
        weights = np.exp(log - log.max())
        sharpening = 1.0 if learnt is None else learnt.sharpening
        return Cases(weights / weights.sum(), standing, wanderers, sight.bias, sharpening), look, learnt

    def _learnt(self, sight: Sight, look: Look) -> Rates:
        """What the look tells of the detector."""
        assert look.rates is not None and look.world is not None
        if not len(look.world) and look.rates.weights.size == 1:
            return look.rates
        values, weights, directions = self.field.nodes
        mass = np.exp(np.minimum(values - self.field.log_mean, 700.0)) * weights / (4 * math.pi)
        counts = mass > _UNHEARD
        mass, directions = mass[counts], directions[counts]
        mass = mass / mass.sum()
        share: np.ndarray | float = 1.0
        if look.world.views:
            share = look.world.share(directions @ sight.world_R_body)
        covered = float(np.sum(mass * share))
        expected = np.zeros(len(look.rates.scales))
        if len(look.world):
            for index, scale in enumerate(look.rates.scales.tolist()):
                found = look.world.scaled(scale).densities(directions)
                expected[index] = float((mass * share) @ found.sum(axis=-1)) * look.world.area
        return look.rates.noted(len(look.world)).learnt(self.presence, covered, expected)


def _switched(rate: float, back: float, elapsed: float) -> float:
    """The probability of being on the other side after `elapsed` seconds, of two that change at these rates."""
    both = rate + back
    return 0.0 if both == 0 else -math.expm1(-both * elapsed) * rate / both


def _with_bias(field: SphereField, bias: float) -> SphereField:
    """A field whose patches are blurred; where they grow over the grid, what that says is kept."""
    patches = []
    for patch in field.patches:
        wide = blurred(patch, bias, REACH)
        directions = wide.directions
        outside = ~patch.places(directions)[1]
        around = np.full(wide.values.shape, -np.inf)
        around[outside] = SphereField(field.grid, field.values).smooth(directions[outside], 1)
        patches.append(wide.like(np.logaddexp(wide.values, around)))
    return replace(field, patches=tuple(patches))


def _filled(field: SphereField, density: np.ndarray, level: float) -> np.ndarray:
    """Densities of the grid where each patch keeps its mass: its cells are too wide to sample a sharp peak."""
    found = density.copy()
    weights = field.grid.weights
    for patch in field.patches:
        inside = patch.places(field.grid.directions)[1]
        mass = float(np.sum(np.exp(np.minimum(patch.values - level, 700.0)) * patch.weights))
        cells = float(np.sum(found[inside] * weights[inside]))
        if not inside.any():
            cell = np.unravel_index(int((field.grid.directions @ patch.frame[0]).argmax()), density.shape)
            found[cell] += mass / weights[cell]
        elif cells > 0:
            found[inside] *= mass / cells
    return found


def _drifted(standing: Standing, drift: float, elapsed: float) -> Standing:
    """With the peaks wider by what odometry that drifts by `drift` radians a second adds in `elapsed` seconds.

    Scaling a log-likelihood by s scales the variance of its peak by 1 / s: P + q = P / s.
    """
    patches = standing.field.patches
    width = math.radians(8)
    if patches:
        best = max(patches, key=lambda patch: float(patch.values.max()))
        shares = np.exp(best.values - best.values.max()) * best.weights
        offsets = np.linspace(-1, 1, len(best.values))
        u, v = (offsets * best.half[0])[:, None], (offsets * best.half[1])[None, :]
        width = max(math.sqrt(float(np.sum(shares * (u * u + v * v)) / shares.sum() / 2)), 1e-3)
    return standing.scaled(width**2 / (width**2 + drift**2 * elapsed))


__all__ = ["Belief", "Cases", "MotionModel"]
