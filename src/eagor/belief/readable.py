"""What can be read from any posterior over directions: peaks, regions, entropy, presence."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from eagor._arrays import Array, to_numpy
from eagor._lazy import lazy
from eagor._reprs import where
from eagor.belief.basins import PROMINENCE
from eagor.belief.posterior import CELLS_FOR_REGIONS, MIN_WEIGHT, CredibleRegion, Field, Posterior
from eagor.errors import EagorError
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import FLAT, decoding_grid
from eagor.sphere import azimuth_elevation


class Readable:
    """What can be read from any posterior over directions; `Belief` and `RangedBelief` supply the field.

    Results have the belief's leading batch dimensions. They are computed in NumPy, whatever arrays the belief holds.
    """

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        raise NotImplementedError

    @property
    def basis(self) -> RealHarmonics:
        """The basis of the coefficients."""
        return RealHarmonics(self.degree)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions."""
        raise NotImplementedError

    def _field(self, index: tuple[int, ...]) -> Field:
        """A function that evaluates the log-posterior of one belief of the batch (up to a constant), in NumPy.

        It must not refer to the belief, which caches it: a reference cycle would stay in memory until the garbage
        collector runs.
        """
        raise NotImplementedError

    @lazy
    def posteriors(self) -> np.ndarray:
        """The `Posterior` of each belief of the batch, an object array (cached)."""
        found = np.empty(self.batch_shape, dtype=object)
        for index in np.ndindex(*self.batch_shape):
            found[index] = Posterior(self._field(index), decoding_grid(self.degree).height)
        return found

    def _told(self) -> str:
        """A short summary of one belief; of a batch, its shape."""
        if self.batch_shape:
            return f"batch {self.batch_shape}"
        posterior = self.posterior
        if not np.isfinite(posterior.coarse).all():
            return "not finite"
        if float(np.ptp(posterior.coarse)) < FLAT:
            return "nothing known"
        azimuth, elevation = (float(angle) for angle in azimuth_elevation(posterior.mode))
        return f"{where(azimuth, elevation)}, 90 % within {math.degrees(posterior.cone(0.9)):.0f}°"

    def _repr_html_(self) -> str:
        """A small picture, for notebooks; text only for a batch or values that are not finite."""
        from eagor import thumbnail

        if self.batch_shape or not np.isfinite(self.posterior.coarse).all():
            return thumbnail.text_html(repr(self))
        region = self.credible_region(0.9)
        return thumbnail.density_html(repr(self), self.log_density, region.threshold, region.area)

    @property
    def posterior(self) -> Posterior:
        """The posterior of a belief without batch dimensions."""
        self._check_single()
        found: Any = self.posteriors[()]
        return found

    def _check_single(self) -> None:
        if self.batch_shape:
            raise EagorError(f"this reads one belief, and got a batch {self.batch_shape}; index it: belief[i]")

    def modes(
        self, k: int = 3, prominence: float = PROMINENCE, min_weight: float = MIN_WEIGHT
    ) -> tuple[np.ndarray, np.ndarray]:
        """At most `k` separate peaks, highest density first: directions ``(..., n, 3)`` and weights ``(..., n)``.

        A mode stands at least `prominence` nats above the saddle around it. Its weight is the share of its basin in the
        density above that of a typical direction. Modes lighter than `min_weight` are left out unless they rise nearly
        as high as the best. n is the largest number in the batch; beliefs with fewer modes are filled up with weight 0
        and the first direction.
        """
        found = [p.modes(k, prominence, min_weight)[:2] for p in self.posteriors.reshape(-1)]
        most = max((len(weights) for _, weights in found), default=0)
        directions = [np.concatenate([d, np.repeat(d[:1], most - len(d), axis=0)]) for d, _ in found]
        weights = [np.concatenate([w, np.zeros(most - len(w))]) for _, w in found]
        shape = self.batch_shape
        return np.reshape(directions, (*shape, most, 3)), np.reshape(weights, (*shape, most))

    def credible_angle(self, mass: float = 0.9) -> Any:
        """Half-angle (radians, ``(...)``) of the cone that is centred on the mode and holds `mass` of the belief."""
        return self._each(lambda p: p.cone(_checked_mass(mass)))

    def credible_region(self, mass: float = 0.9) -> CredibleRegion:
        """The smallest region that holds `mass` of the belief (highest density). One belief at a time."""
        self._check_single()
        posterior = Posterior(self._field(()), decoding_grid(self.degree).height, CELLS_FOR_REGIONS)
        level, area = posterior.level(_checked_mass(mass))
        return CredibleRegion(
            mass=mass,
            threshold=level - posterior.log_total,
            area=area,
            angle=posterior.cone(mass),
            mode=posterior.mode,
            log_density=lambda directions: to_numpy(self.log_density(directions)),
        )

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest highest-density region that reaches `direction` ``(3,)``. One belief at a time.

        If it is below 0.9, `direction` lies in the 90 % region. For true directions and calibrated beliefs it is
        uniform in [0, 1].
        """
        density = float(to_numpy(self.log_density(np.asarray(direction, dtype=np.float64))))
        return self.posterior.mass_above(density + self.posterior.log_total)

    def entropy(self) -> Any:
        """Differential entropy ``(...)`` in nats: log(4 pi) = 2.53 for a uniform belief, negative for a sharp one."""
        return self._each(lambda p: p.entropy())

    def presence(self, prior: float = 0.5) -> Any:
        """Probability ``(...)`` that the target is present.

        prior Z / (prior Z + 1 - prior), where Z = (1 / 4 pi) integral of exp(f) is the likelihood ratio of all evidence
        so far, averaged over directions.
        """
        if not 0 <= prior <= 1:
            raise EagorError(f"prior = {prior!r}; wanted a probability in [0, 1]")
        if prior in (0.0, 1.0):
            return self._each(lambda p: prior)
        odds = math.log(prior) - math.log1p(-prior)
        return self._each(lambda p: 1 / (1 + math.exp(-_clip(odds + p.log_total - math.log(4 * math.pi)))))

    def log_density(self, directions: Array) -> Array:
        """log p per steradian at unit vectors ``(n..., 3)``: ``(..., n...)``; integrates to 1."""
        raise NotImplementedError

    def _log_totals(self, ndim: int) -> np.ndarray:
        """log of the integral of exp(f), shaped to be subtracted from values of `ndim` dimensions."""
        totals = np.asarray(self._each(lambda p: p.log_total))
        return totals.reshape(self.batch_shape + (1,) * (ndim - len(self.batch_shape)))

    def _each(self, read: Callable[[Posterior], float]) -> Any:
        values = [read(p) for p in self.posteriors.reshape(-1)]
        return np.reshape(values, self.batch_shape) if self.batch_shape else float(values[0])


def _clip(exponent: float) -> float:
    return max(-700.0, min(700.0, exponent))


def _checked_mass(mass: float) -> float:
    if not 0 < mass < 1:
        raise EagorError(f"mass = {mass!r}; wanted a probability strictly between 0 and 1, such as 0.9")
    return mass
