"""Whether the target stands still or wanders: two hypotheses, weighed by how well each foretells what is seen next.

A thing that stands still is best found by a long memory, with parallax as the guide; a thing that wanders by a short
one. Neither serves both. So both are kept, and each look is first foretold by either: the one that expected it gains
(interacting multiple models without exchange of states; Blom and Bar-Shalom, IEEE Transactions on Automatic Control
33(8), 1988). The belief that is read is their mixture.

The wanderer is held as a density, not as its logarithm. There, diffusion is exact and costs one product: the heat
kernel multiplies the coefficients of degree l by exp(-l (l + 1) sigma^2 / 2). Its density is q exp(r), with q
band-limited and r the log ratios of the looks since q was last spread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eagor.belief import Belief, Reading
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.peaks import decoding_grid
from eagor.posterior import Field, Posterior, log_integral, typical
from eagor.ranged import RangedBelief

ANYWHERE = 2e-2  # per second: the share of a wanderer's density that is spread evenly: it may have been carried off
SETTLE = 10.0  # seconds: how soon what is known of the place where it stood fades, once it surely is elsewhere
SAME = math.radians(20)  # peaks nearer than this are of the same thing: near things move by parallax
DOUBT = 0.01  # neither case is ever less likely: things get moved, and looks share their mistakes
_UNIFORM = 1 / math.sqrt(4 * math.pi)  # the coefficient of degree 0 of a density
_SURE = 30.0  # nats: odds beyond are as good as certain


@dataclass(frozen=True, eq=False)
class Wanderer:
    """Where a wandering target may be: the density q exp(r) / Z. World or body axes, as the looks come.

    `spread` ``(size,)``: coefficients of q; `looks` ``(size,)``: of r. `evidence`: log of how likely all looks were
    under this hypothesis, against a target that is not here.
    """

    spread: np.ndarray
    looks: np.ndarray
    least: float = 1 / (4 * math.pi)  # the lowest density that q can have: what lies lower is ringing
    evidence: float = 0.0

    @classmethod
    def uniform(cls, degree: int) -> Wanderer:
        """Anywhere."""
        spread = np.zeros(RealHarmonics(degree).size)
        spread[0] = _UNIFORM
        return cls(spread, np.zeros_like(spread))

    @property
    def basis(self) -> RealHarmonics:
        """The basis of the coefficients."""
        return RealHarmonics(math.isqrt(len(self.spread)) - 1)

    @cached_property
    def field(self) -> np.ndarray:
        """log of q exp(r) on the decoding grid, not normalised."""
        return self.evaluator()(decoding_grid(self.basis.degree))

    def evaluator(self) -> Callable[[Any], np.ndarray]:
        """What gives log of q exp(r) on any grid, or at directions."""
        basis, spread, looks, least = self.basis, self.spread, self.looks, self.least

        def evaluate(where: Any) -> np.ndarray:
            return np.log(np.maximum(basis.synthesise(spread, where), least)) + basis.synthesise(looks, where)

        return evaluate

    def after(self, elapsed: float, wander: float, keep: float) -> Wanderer:
        """After `elapsed` seconds of wandering by `wander` radians per root second; `evidence` fades by `keep`."""
        if elapsed <= 0:
            return self
        grid, basis = decoding_grid(self.basis.degree), self.basis
        density = basis.analyse(np.exp(self.field - log_integral(self.field, grid.weights)), grid)
        density = basis.smooth(density, wander * math.sqrt(elapsed)) * (_UNIFORM / density[0])
        lost = -math.expm1(-ANYWHERE * elapsed)
        density *= 1 - lost
        density[0] = _UNIFORM
        return Wanderer(density, np.zeros_like(density), lost / (4 * math.pi), self.evidence * keep)


@dataclass(frozen=True, eq=False)
class StillOrMoving(Reading):
    """A target that stands still with probability 1 - `moving`, and wanders with probability `moving`.

    `still`: the belief of the first case, over direction, or over direction and distance.
    """

    still: Belief | RangedBelief
    wanderer: Wanderer
    moving: float = 0.5
    field_of_still: np.ndarray | None = None  # log ratios of `still` on the decoding grid, where they are known already

    @classmethod
    def uniform(cls, still: Belief | RangedBelief) -> StillOrMoving:
        """Nothing known, `still` being a belief without evidence."""
        return cls(still, Wanderer.uniform(still.degree))

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        return self.still.degree

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """One belief: no batch."""
        return ()

    @cached_property
    def moved(self) -> float:
        """Probability that the target wanders and is elsewhere than it stood by the first case."""
        grid, field = decoding_grid(self.degree), self.wanderer.field
        place = grid.directions.reshape(-1, 3)[int(self._stays.argmax())]
        density = np.exp(field - log_integral(field, grid.weights)) * grid.weights
        return self.moving * float(density[grid.directions @ place < math.cos(SAME)].sum())

    def fading(self, elapsed: float, settle: float = SETTLE) -> float:
        """The share of the first case's log-odds that survives `elapsed` seconds.

        What is known of the place where a thing stood is worth nothing once it has left it: should it stand still
        again, it stands elsewhere. Of something that was carried off, exp(-elapsed / settle) stays.
        """
        return math.exp(-self.moved * elapsed / settle)

    def after(
        self, still: Belief | RangedBelief, elapsed: float, wander: float, restless: float, keep: float
    ) -> StillOrMoving:
        """After `elapsed` seconds: `still` is the first case carried there; `restless`: changes of mind per second."""
        changed = -math.expm1(-2 * restless * elapsed) / 2  # of a Markov chain with two states
        moving = self.moving + changed * (1 - 2 * self.moving)
        return StillOrMoving(still, self.wanderer.after(elapsed, wander, keep), moving)

    def update(
        self,
        still: Belief | RangedBelief,
        look: np.ndarray,
        share: float = 1.0,
        passing: np.ndarray | None = None,
        doubt: float = DOUBT,
    ) -> StillOrMoving:
        """With the log ratios `look` ``(size,)`` of one more look; neither case gets less likely than `doubt`.

        Looks repeat each other: `still` is the first case with `share` of the look added to it, and `passing`
        ``(size,)`` is what the look before it counted besides, until now. Either case is judged by how it foretells
        what is new: the look less what it would repeat of the one before. Where both know the place, a thing that goes
        on being seen there tells little, and one that was seen and is not there any more tells much.

        A wanderer is looked at afresh, and its memory is short: it takes the whole look.
        """
        grid, wanderer, basis = decoding_grid(self.degree), self.wanderer, RealHarmonics(self.degree)
        log_ratio = basis.synthesise(look, grid)
        repeated = np.zeros(grid.shape) if passing is None else basis.synthesise(passing, grid)
        before = self._stays
        new = log_ratio - repeated
        gains = [
            log_integral(field + new, grid.weights) - log_integral(field, grid.weights)
            for field in (before + repeated, wanderer.field)
        ]
        odds = math.log(self.moving) - math.log1p(-self.moving) + gains[1] - gains[0]
        moving = min(max(1 / (1 + math.exp(-min(max(odds, -_SURE), _SURE))), doubt), 1 - doubt)
        roamed = replace(wanderer, looks=wanderer.looks + look, evidence=wanderer.evidence + gains[1])
        # A look adds the same to every range, so that it adds as much to the field over all of them.
        return StillOrMoving(still, roamed, moving, before + share * log_ratio)

    def capped(self, most: float, newest: np.ndarray | None = None) -> StillOrMoving:
        """With the first case made less sure, so that its peak rises at most `most` nats above the typical.

        The peak is read with what the `newest` look ``(size,)`` counts besides; "typical" is the median direction.
        Only what the looks say of directions is scaled down. What tells the ranges apart stays: a detector repeats its
        mistakes, but where lines of sight from several places cross is geometry.
        """
        grid, basis, agreed = decoding_grid(self.degree), RealHarmonics(self.degree), self.still.agreed
        stays = self._stays if newest is None else self._stays + basis.synthesise(newest, grid)
        peak = int(stays.argmax())
        excess = _rise(stays, peak, grid.weights) - most
        if excess <= 0:
            return self
        height = _rise(basis.synthesise(agreed, grid), peak, grid.weights)
        less = min(excess / height, 1.0) if height > 0 else 0.0
        return StillOrMoving(self.still.plus(-less * agreed), self.wanderer, self.moving)

    def plus(self, look: np.ndarray) -> StillOrMoving:
        """With log ratios `look` ``(size,)``, or ``(K, size)`` by range, that count in the first case while new."""
        stays = None
        if look.ndim == 1:
            stays = self._stays + RealHarmonics(self.degree).synthesise(look, decoding_grid(self.degree))
        return StillOrMoving(self.still.plus(look), self.wanderer, self.moving, stays)

    @cached_property
    def _stays(self) -> np.ndarray:
        return self.still.posterior.coarse if self.field_of_still is None else self.field_of_still

    @cached_property
    def likelier(self) -> Posterior:
        """The posterior of the likelier case.

        The answer is read there. In the mixture the sharper case has the higher peak even where it is the less likely.
        """
        if self.moving < 0.5:
            return self.still.posterior
        return Posterior(self.wanderer.evaluator(), decoding_grid(self.degree).height)

    def direction_belief(self) -> Belief:
        """The belief over directions alone, projected to this degree."""
        grid = decoding_grid(self.degree)
        return Belief(RealHarmonics(self.degree).analyse(self.posterior.coarse, grid))

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """log p per steradian at unit vectors ``(n..., 3)``: ``(n...)``; integrates to 1."""
        return self._evaluator()(directions) - self.posterior.log_total

    def _field(self, index: tuple[int, ...]) -> Field:
        return self._evaluator()

    def _evaluator(self) -> Callable[[Any], np.ndarray]:
        """What gives the mixture's log ratios on any grid, or at directions."""
        grid, known = decoding_grid(self.degree), (self._stays, self.wanderer.field)
        stays, roams = self.still.posterior.evaluate, self.wanderer.evaluator()
        totals = [log_integral(values, grid.weights) for values in known]
        shares = math.log1p(-self.moving), math.log(self.moving)
        evidence = np.logaddexp(shares[0] + totals[0], shares[1] + self.wanderer.evidence + math.log(4 * math.pi))
        offsets = [evidence + share - total for share, total in zip(shares, totals, strict=True)]

        def evaluate(where: Any) -> np.ndarray:
            a, b = known if isinstance(where, ErpGrid) and where == grid else (stays(where), roams(where))
            return np.logaddexp(a + offsets[0], b + offsets[1])

        return evaluate


def _rise(field: np.ndarray, cell: int, weights: np.ndarray) -> float:
    """By how many nats a field rises in a cell above the typical direction."""
    return float(field.reshape(-1)[cell]) - typical(field, weights)


def standing(belief: Belief | RangedBelief | StillOrMoving) -> Belief | RangedBelief:
    """The belief about a target that stands still."""
    return belief.still if isinstance(belief, StillOrMoving) else belief
