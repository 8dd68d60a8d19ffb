"""A belief about the direction of one target: a log-posterior on the sphere, in spherical harmonics.

f(omega) = sum c_lm Y_lm(omega) accumulates log-likelihood ratios; the density is p = exp(f) / integral of exp(f).
Turning the camera rotates the coefficients exactly, evidence adds to them, forgetting scales them. Beliefs are
immutable: every call returns a new one.

There are two ways to read a direction. `mode` is the default. `mean_direction` and `resultant` are the published way,
kept for comparison: the first moment of f, which depends on the three coefficients of degree 1 alone and is right only
if f is a single clean blob.

Diffusion. Near any direction the logarithm f is a quadratic in the tangent plane, with gradient g and Hessian H, and
the convolution of exp(f) with a Gaussian of variance s^2 then has a closed form:

    log (exp(f) * N(0, s^2)) = f - 1/2 log det(1 - s^2 H) + 1/2 s^2 g^T (1 - s^2 H)^-1 g.

It is exact for a Gaussian peak of any height and width (a concentration k becomes k / (1 + k s^2)). It needs no
exponential, which would lose everything far below the peak, and the density stays positive. The result is not
band-limited: it is projected to the degree by least squares, weighted by the probability, and shifted so that the
integral of exp(f) stays the same. Wide diffusions are split into steps.

A heat kernel on the coefficients of f itself is NOT diffusion: it leaves the concentration of a peak nearly unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._arrays import Array, as_float, frozen, namespace, table_like, to_library, to_numpy
from eagor.belief.posterior import Field, Readable
from eagor.errors import EagorError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, Grid
from eagor.harmonics import RealHarmonics, rotation
from eagor.harmonics.peaks import FLAT, decoding_grid, derivatives, peak
from eagor.sphere import FORWARD, check_rotation

__all__ = ["Belief"]

STEP = 0.5  # largest curvature times variance per step
CONVEX = 0.5  # positive curvature is clamped here: valleys steepen without bound and hold no probability
DEPTH = 3.0  # nats below the top over which the least-squares weight falls by e
LEAST = 1e-3  # the lowest such weight
ITERATIONS = 30  # of conjugate gradients; about 20 reach the projection's own error


def diffuse(degree: int, coefficients: Array, sigma: float) -> Array:
    """log of exp(f) convolved with a heat kernel of standard deviation `sigma` (radians per axis), at the same degree.

    `coefficients` ``(..., size)`` of f. The integral of exp(f) over the decoding grid is kept. Each belief of a batch
    is diffused as if it were alone: in NumPy to the last digit; tensors are computed together and differ by rounding.
    """
    if isinstance(coefficients, np.ndarray) and coefficients.ndim > 1:
        found = [_diffused(degree, one, sigma) for one in coefficients.reshape(-1, coefficients.shape[-1])]
        return np.reshape(found, coefficients.shape)
    return _diffused(degree, coefficients, sigma)


def _diffused(degree: int, coefficients: Array, sigma: float) -> Array:
    """`diffuse`, all of a batch at once."""
    basis, grid = RealHarmonics(degree), decoding_grid(degree)
    xp = namespace(coefficients)
    f = basis.synthesise(coefficients, grid)
    before = _log_integral(f, grid)
    left = xp.zeros_like(before) + sigma**2
    while bool(xp.any(left > 1e-12 * sigma**2)):
        top = xp.max(f, axis=(-2, -1), keepdims=True)
        gained, variance, tempering = _gained(f, top, grid, left, sigma)
        spread = coefficients + _nearest(basis, grid, gained, LEAST + xp.exp((f - top) / DEPTH))
        # A peak too steep for its degree (thousands of nats) would overshoot: temper it.
        found = basis.synthesise(spread, grid)
        risen = xp.max(found, axis=(-2, -1), keepdims=True) > top + 1
        coefficients = xp.where(risen[..., 0], coefficients / tempering[..., 0], spread)
        f = xp.where(risen, f / tempering, found)
        left = left - variance
    lost = before - _log_integral(f, grid)
    even = np.eye(1, basis.size)[0] * math.sqrt(4 * math.pi)  # the field that is 1 everywhere
    return coefficients + table_like(even, coefficients) * lost[..., 0]


def _gained(f: Array, top: Array, grid: ErpGrid, left: Array, sigma: float) -> tuple[Array, Array, Array]:
    """What one step adds to fields ``(..., H, W)``, its variance and how it would temper a peak ``(..., 1, 1)``.

    `top`: the fields' maxima. `left`: the variance that is still to come.
    """
    xp = namespace(f)
    gu, gv, huu, huv, hvv = derivatives(grid, f)
    size = xp.where(f > top - 10, xp.abs(huu) + xp.abs(huv) + xp.abs(hvv), xp.zeros_like(f))
    steepest = xp.max(size, axis=(-2, -1), keepdims=True)
    fits = xp.clip(STEP / xp.clip(steepest, 1e-12, math.inf), sigma**2 / 64, math.inf)
    variance = xp.minimum(left, fits)
    # The eigenvalues of H in closed form, and the gradient in the basis of its eigenvectors.
    mean, half = (huu + hvv) / 2, xp.hypot((huu - hvv) / 2, huv)
    angle = 0.5 * xp.atan2(huv, (huu - hvv) / 2)
    along, across = gu * xp.cos(angle) + gv * xp.sin(angle), gv * xp.cos(angle) - gu * xp.sin(angle)
    one = 1 - xp.clip(variance * (mean + half), -math.inf, CONVEX)
    two = 1 - xp.clip(variance * (mean - half), -math.inf, CONVEX)
    gained = 0.5 * variance * (along**2 / one + across**2 / two) - 0.5 * xp.log(one * two)
    gained = xp.minimum(gained, top - f)  # diffusion never exceeds the old maximum
    return gained, variance, 1 + variance * steepest


def _log_integral(f: Array, grid: ErpGrid) -> Array:
    """log of the integral of exp(f) over the sphere ``(..., 1, 1)``, for fields ``(..., H, W)`` on `grid`."""
    xp = namespace(f)
    top = xp.max(f, axis=(-2, -1), keepdims=True)
    return top + xp.log(xp.sum(xp.exp(f - top) * table_like(grid.weights, f), axis=(-2, -1), keepdims=True))


def _nearest(basis: RealHarmonics, grid: ErpGrid, values: Array, weight: Array) -> Array:
    """Coefficients ``(..., size)`` of the field nearest to `values` under `weight` (conjugate gradients)."""
    xp = namespace(values)
    residual = basis.analyse(weight * values, grid)
    found, towards = xp.zeros_like(residual), residual
    power = xp.sum(residual * residual, axis=-1, keepdims=True)
    for _ in range(ITERATIONS):
        if not bool(xp.any(power > 0)):
            break
        image = basis.analyse(weight * basis.synthesise(towards, grid), grid)
        scale = xp.sum(towards * image, axis=-1, keepdims=True)
        length = xp.where(scale > 0, power / xp.where(scale > 0, scale, xp.ones_like(scale)), xp.zeros_like(scale))
        found, residual = found + length * towards, residual - length * image
        power, before = xp.sum(residual * residual, axis=-1, keepdims=True), power
        ratio = xp.where(before > 0, power / xp.where(before > 0, before, xp.ones_like(before)), xp.zeros_like(before))
        towards = residual + ratio * towards
    return found


def _private(values: Array) -> Array:
    """A copy of `values`, read-only in NumPy; gradients pass through it."""
    if isinstance(values, np.ndarray):
        return frozen(np.array(values))
    if hasattr(values, "clone"):  # torch: its asarray would cut the gradient
        return values.clone()
    return namespace(values).asarray(values, copy=True)


@dataclass(frozen=True, eq=False)
class Belief(Readable):
    """A belief over directions: `coefficients` ``(..., (degree + 1)^2)`` of the log-posterior in the body frame.

    Leading dimensions are a batch (several targets, particles, episodes). The coefficients stay in their array library
    and on their device; what is added is converted to those. They are copied, and read-only in NumPy.

        >>> belief = eagor.Belief.uniform(15).update(eagor.Evidence.from_points([[0, 1, 0]]))
        >>> belief = belief.predict(eagor.sphere.rotation((0, 0, 1), -math.pi / 2))  # the camera turns left
        >>> belief
        Belief(degree 15, 0° left, 0° up, 90 % within 89°)
    """

    coefficients: Array

    def __post_init__(self) -> None:
        size = self.coefficients.shape[-1] if len(self.coefficients.shape) else 0
        if size < 4 or math.isqrt(size) ** 2 != size:
            raise EagorError(f"coefficients have shape {tuple(self.coefficients.shape)}; wanted (..., (degree + 1)^2)")
        object.__setattr__(self, "coefficients", _private(self.coefficients))

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
        forward = table_like(np.array(FORWARD), moment) + xp.zeros_like(moment)
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
