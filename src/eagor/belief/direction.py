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
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._arrays import Array, as_float, constant, frozen, namespace, private, to_library, to_numpy
from eagor.belief.diffusion import diffuse
from eagor.belief.posterior import Field
from eagor.belief.readable import Readable
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.grids import Grid
from eagor.harmonics import RealHarmonics, rotation
from eagor.harmonics.peaks import FLAT, forward_vector, peak
from eagor.sphere import check_rotation

__all__ = ["Belief"]


@dataclass(frozen=True, eq=False)
class Belief(Readable):
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
        return self._of(self.coefficients + to_library(log_ratios, self.coefficients))

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
