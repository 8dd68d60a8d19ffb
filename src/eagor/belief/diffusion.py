"""Diffusion of a density given by its logarithm.

Near any direction the logarithm f is a quadratic in the tangent plane, with gradient g and Hessian H, and the
convolution of exp(f) with a Gaussian of variance s^2 then has a closed form:

    log (exp(f) * N(0, s^2)) = f - 1/2 log det(1 - s^2 H) + 1/2 s^2 g^T (1 - s^2 H)^-1 g.

It is exact for a Gaussian peak of any height and width (a concentration k becomes k / (1 + k s^2)). It needs no
exponential, which would lose everything far below the peak, and the density stays positive. The result is not
band-limited: it is projected to the degree by least squares, weighted by the probability, and shifted so that the
integral of exp(f) stays the same. Wide diffusions are split into steps.

A heat kernel on the coefficients of f itself is NOT diffusion: it leaves the concentration of a peak nearly unchanged.
"""

from __future__ import annotations

import math

import numpy as np

from eagor._arrays import Array, constant, namespace
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, derivatives

STEP = 0.5  # largest curvature times variance per step
CONVEX = 0.5  # positive curvature is clamped here: valleys steepen without bound and hold no probability
DEPTH = 3.0  # nats below the top over which the least-squares weight falls by e ...
LEAST = 1e-3  # ... down to this
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
    return coefficients + constant(_flat, degree, like=coefficients) * lost[..., 0]


def _flat(degree: int) -> np.ndarray:
    """The field that is 1 everywhere ``(size,)``."""
    return np.eye(1, (degree + 1) ** 2)[0] * math.sqrt(4 * math.pi)


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
    weights = constant(_weights, grid, like=f)
    return top + xp.log(xp.sum(xp.exp(f - top) * weights, axis=(-2, -1), keepdims=True))


def _weights(grid: ErpGrid) -> np.ndarray:
    return grid.weights


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
