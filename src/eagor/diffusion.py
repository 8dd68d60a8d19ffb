"""Diffusion of a density that is held as its logarithm.

Near any direction the logarithm f is a quadratic in the tangent plane, with gradient g and Hessian H, and the
convolution of exp(f) with a Gaussian of variance s^2 then has a closed form:

    log (exp(f) * N(0, s^2)) = f - 1/2 log det(1 - s^2 H) + 1/2 s^2 g^T (1 - s^2 H)^-1 g.

It is exact for a Gaussian peak of any height and width (a concentration k becomes k / (1 + k s^2)), it needs no
exponential, which over the dynamic range of a log-posterior would lose everything below the peak, and it cannot turn
negative. The result has no band limit, so the field of the degree nearest to it is taken, in a least-squares
sense that cares most where the probability is. Wide diffusions are split into steps.

A heat kernel on the coefficients of f itself is NOT diffusion: it leaves the concentration of a peak nearly unchanged.
"""

from __future__ import annotations

import math

from eagor._arrays import Array, namespace
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.peaks import decoding_grid, derivatives

STEP = 0.5  # largest curvature times variance per step
CONVEX = 0.5  # valleys steepen without bound; they hold no probability, so their curvature is clamped here
DEPTH = 3.0  # nats below the top over which the least-squares weight falls by e ...
LEAST = 1e-3  # ... down to this
ITERATIONS = 30  # of conjugate gradients; the result is within the projection's own error after about 20


def diffuse(degree: int, coefficients: Array, sigma: float) -> Array:
    """log of exp(f) convolved with a heat kernel of standard deviation `sigma` (radians per axis), at the same degree.

    `coefficients` ``(..., size)`` of f. The integral of exp(f) is kept to the accuracy of the projection.
    """
    basis, grid = RealHarmonics(degree), decoding_grid(degree)
    xp = namespace(coefficients)
    done = 0.0
    while done < sigma**2 * (1 - 1e-12):
        f = basis.synthesise(coefficients, grid)
        top = xp.max(f, axis=(-2, -1), keepdims=True)
        gu, gv, huu, huv, hvv = derivatives(grid, f)
        size = xp.where(f > top - 10, xp.abs(huu) + xp.abs(huv) + xp.abs(hvv), xp.zeros_like(f))
        variance = min(sigma**2 - done, max(STEP / max(float(xp.max(size)), 1e-12), sigma**2 / 64))
        # The eigenvalues of H in closed form, and the gradient in the basis of its eigenvectors.
        mean, half = (huu + hvv) / 2, xp.hypot((huu - hvv) / 2, huv)
        angle = 0.5 * xp.atan2(huv, (huu - hvv) / 2)
        along, across = gu * xp.cos(angle) + gv * xp.sin(angle), gv * xp.cos(angle) - gu * xp.sin(angle)
        one = 1 - xp.clip(variance * (mean + half), -math.inf, CONVEX)
        two = 1 - xp.clip(variance * (mean - half), -math.inf, CONVEX)
        gained = 0.5 * variance * (along**2 / one + across**2 / two) - 0.5 * xp.log(one * two)
        gained = xp.minimum(gained, top - f)  # diffusion never exceeds the old maximum
        weight = LEAST + xp.exp((f - top) / DEPTH)
        spread = coefficients + _nearest(basis, grid, gained, weight)
        # A peak too steep for its degree to spread (thousands of nats) would overshoot: temper it to the right
        # curvature.
        tempered = coefficients / (1 + variance * xp.max(size, axis=(-2, -1))[..., None])
        risen = xp.max(basis.synthesise(spread, grid), axis=(-2, -1)) > top[..., 0, 0] + 1
        coefficients = xp.where(risen[..., None], tempered, spread)
        done += variance
    return coefficients


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
