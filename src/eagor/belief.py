"""A belief about the direction of one target: a log-posterior on the sphere, in spherical harmonics.

f(omega) = sum c_lm Y_lm(omega) accumulates log-likelihood ratios; the density is p = exp(f) / integral of exp(f).
Turning the camera rotates the coefficients exactly, evidence adds to them, forgetting scales them. Beliefs are
immutable: every call returns a new one.

There are two ways to read a direction. `mode` is the default. `mean_direction` and `resultant` are the published way,
kept for comparison: the first moment of f, which depends on the three coefficients of degree 1 alone and is right only
if f is a single clean blob.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._arrays import Array, akin, as_float, constant, frozen, namespace, private, to_numpy
from eagor._lazy import lazy
from eagor._reprs import where
from eagor.diffusion import diffuse
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.grids import Grid
from eagor.harmonics import RealHarmonics, rotation
from eagor.peaks import FLAT, decoding_grid, forward_vector, peak
from eagor.posterior import CELLS_FOR_REGIONS, MIN_WEIGHT, PROMINENCE, CredibleRegion, Field, Posterior
from eagor.sphere import azimuth_elevation, check_rotation

__all__ = ["Belief"]


class Reading:
    """What can be read from any posterior over directions; `Belief` and `RangedBelief` supply the field.

    Results have the belief's leading batch dimensions. They are computed in NumPy, whatever arrays the belief holds.
    """

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        raise NotImplementedError

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


@dataclass(frozen=True, eq=False)
class Belief(Reading):
    """A belief over directions: `coefficients` ``(..., (degree + 1)^2)`` of the log-posterior in the body frame.

    Leading dimensions are a batch (several targets, particles, episodes). The coefficients stay in their array library
    and on their device; what is added is converted to those. They are copied, and read-only in NumPy.
    """

    coefficients: Array

    def __post_init__(self) -> None:
        size = self.coefficients.shape[-1] if len(self.coefficients.shape) else 0
        if size < 4 or math.isqrt(size) ** 2 != size:
            raise EagorError(f"coefficients have shape {tuple(self.coefficients.shape)}; wanted (..., (degree + 1)^2)")
        object.__setattr__(self, "coefficients", private(self.coefficients))

    def __repr__(self) -> str:
        return f"Belief(degree {self.degree}, {self._told()})"

    @classmethod
    def _of(cls, coefficients: Array) -> Belief:
        """A belief that keeps `coefficients` without a copy: a new array that nothing else refers to."""
        made = object.__new__(cls)
        object.__setattr__(made, "coefficients", frozen(coefficients))
        return made

    @classmethod
    def uniform(cls, degree: int, batch_shape: tuple[int, ...] = (), like: Array | None = None) -> Belief:
        """A uniform belief, f = 0, in arrays like `like` (default float64 NumPy)."""
        size = RealHarmonics(degree).size
        if like is None:
            return cls(np.zeros((*batch_shape, size)))
        return cls(namespace(like).zeros((*batch_shape, size), dtype=like.dtype, device=like.device))

    @property
    def degree(self) -> int:
        """The highest degree of the harmonics."""
        return math.isqrt(self.coefficients.shape[-1]) - 1

    @property
    def basis(self) -> RealHarmonics:
        """The basis of the coefficients."""
        return RealHarmonics(self.degree)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading dimensions."""
        return tuple(self.coefficients.shape[:-1])

    def __getitem__(self, index: Any) -> Belief:
        """Part of a batch."""
        if not self.batch_shape:
            raise EagorError("this belief has no batch dimension to index")
        return Belief(self.coefficients[index])

    def direction_belief(self) -> Belief:
        """Itself; a `RangedBelief` gives its marginal over directions."""
        return self

    @property
    def agreed(self) -> Array:
        """The coefficients ``(..., size)``; of a `RangedBelief`, the mean over its shells."""
        return self.coefficients

    def plus(self, log_ratios: Array) -> Belief:
        """With log ratios added, given as coefficients ``(..., size)``; they are converted to this belief's arrays."""
        return self._of(self.coefficients + akin(log_ratios, self.coefficients))

    def predict(self, new_R_old: Array) -> Belief:
        """After the body has turned: ``new_R_old @ direction_old = direction_new``, ``(..., 3, 3)``, exact."""
        return self._of(rotation.rotate(self.degree, as_float(self.coefficients), check_rotation(new_R_old)))

    def update(self, evidence: Evidence, new_R_capture: Array | None = None) -> Belief:
        """With one more look added. For evidence from an earlier orientation give `new_R_capture` (to now).

        Evidence in another array library or on another device is converted to the belief's (without gradients);
        ``Belief.uniform(degree, like=tensor)`` makes a belief of tensors.
        """
        found = evidence.coefficients(self.degree)
        if new_R_capture is not None:
            found = rotation.rotate(self.degree, found, check_rotation(new_R_capture, "new_R_capture"))
        return self.plus(found)

    def forget(self, factor: float) -> Belief:
        """With all log-odds scaled by `factor` in [0, 1], so that old evidence counts less."""
        if not 0 <= factor <= 1:
            raise EagorError(f"factor = {factor!r}; wanted 0 (forget everything) to 1 (keep everything)")
        return self._of(self.coefficients * factor)

    def diffuse(self, sigma: float) -> Belief:
        """With the density spread by a Gaussian of `sigma` radians per axis (odometry noise, a moving target)."""
        if not 0 <= sigma < math.pi:
            raise EagorError(f"sigma = {sigma!r}; wanted radians, 0 to pi")
        return self._of(diffuse(self.degree, self.coefficients, sigma)) if sigma > 0 else self

    def diffuse_log(self, sigma: float) -> Belief:
        """A cheap approximation: exp(-l(l+1) sigma^2 / 2) on the log field. It blurs f but hardly widens exp(f)."""
        return self._of(self.basis.smooth(self.coefficients, sigma))

    def log_ratio(self, directions: Grid | Array) -> Array:
        """f, the accumulated log-likelihood ratio, at unit vectors ``(n..., 3)`` or on a grid ``(..., H, W)``."""
        return self.basis.synthesise(self.coefficients, directions)

    def log_density(self, directions: Array) -> Array:
        """log p per steradian at unit vectors ``(n..., 3)``: ``(..., n...)``; integrates to 1."""
        f = self.log_ratio(directions)
        totals = self._log_totals(len(f.shape))
        if isinstance(f, np.ndarray | np.generic):
            return f - totals
        return f - namespace(f).asarray(totals, dtype=f.dtype, device=f.device)

    def mode(self) -> Array:
        """The direction of highest density ``(..., 3)``, in the belief's array library."""
        return peak(self.degree, self.coefficients)

    def mean_direction(self) -> Array:
        """The published estimate ``(..., 3)``: m / |m| with m the integral of f * omega, i.e. of degree 1 alone.

        Forward (1, 0, 0) where m is zero up to float32 rounding.
        """
        moment = self._moment()
        xp = namespace(moment)
        length = xp.sqrt(xp.sum(moment * moment, axis=-1, keepdims=True))
        forward = constant(forward_vector, like=moment) + xp.zeros_like(moment)
        known = length > FLAT * xp.clip(xp.abs(self.coefficients[..., :1]), 1.0, math.inf)
        return xp.where(known, moment / xp.where(known, length, xp.ones_like(length)), forward)

    def resultant(self) -> Array:
        """The published confidence ``(...)``: |m| / integral of f, signed.

        It is not a probability: for a log field it may be negative or arbitrary. See `presence` and `credible_region`.
        """
        moment = self._moment()
        xp = namespace(moment)
        return xp.sqrt(xp.sum(moment * moment, axis=-1)) / (self.coefficients[..., 0] * math.sqrt(4 * math.pi))

    def _moment(self) -> Array:
        """The integral of f * omega ``(..., 3)``: Y_11, Y_1-1, Y_10 are sqrt(3 / 4 pi) times x, y, z."""
        c = self.coefficients
        return namespace(c).stack([c[..., 3], c[..., 1], c[..., 2]], axis=-1) * math.sqrt(4 * math.pi / 3)

    def _field(self, index: tuple[int, ...]) -> Field:
        coefficients, basis = to_numpy(self.coefficients)[index].astype(np.float64), self.basis
        return lambda where: basis.synthesise(coefficients, where)
