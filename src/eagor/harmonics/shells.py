"""Moving a field over direction and distance: the shell warp.

K fields on spheres of radii r_k describe a quantity around the body. When the body moves by t (in the axes of the
fields), the value at direction omega and range r_k comes from its previous place: direction
(r_k omega + t) / |r_k omega + t| and range |r_k omega + t|, interpolated between the neighbouring shells, cubic in log
range (Catmull-Rom), clamped at the first and the last. Linear interpolation would smear a little at every step, which
adds up over a walk.

With t turned onto the polar axis the azimuth does not change, so the orders m are independent: the warp is a product
of small matrices per order (Legendre functions at the warped latitudes, then Gauss quadrature back). No basis function
is evaluated at scattered points of the sphere.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, constant, frozen, namespace, table_like
from eagor.harmonics.legendre import coefficient_of, entry_of, latitude_functions
from eagor.harmonics.rotation import rotate

_DIGITS = 9  # of a step in metres, so that steps of equal length share their tables despite rounding


def translate(degree: int, shells: Array, ranges: np.ndarray, new_R_old: np.ndarray, displacement: np.ndarray) -> Array:
    """Fields ``(..., K, size)`` after the body has turned by `new_R_old` and moved by `displacement`.

    `ranges` ``(K,)`` metres, growing; `displacement` ``(3,)`` metres, of the body, in the NEW body frame.
    """
    distance = round(float(np.linalg.norm(displacement)), _DIGITS)
    if distance == 0.0:
        return rotate(degree, shells, new_R_old)
    pole_R_new = _to_pole(displacement / np.linalg.norm(displacement))
    upright = rotate(degree, shells, pole_R_new @ new_R_old)
    return rotate(degree, _along_pole(degree, upright, ranges, distance), pole_R_new.T)


def _along_pole(degree: int, shells: Array, ranges: np.ndarray, distance: float) -> Array:
    """The warp for a displacement of `distance` metres along +z."""
    xp = namespace(shells)
    count, nodes = len(ranges), len(_nodes(degree)[0])
    points = count * nodes
    table, where, weights = (table_like(part, shells) for part in _warp(degree, tuple(ranges.tolist()), distance))
    batch = tuple(shells.shape[:-2])
    packed = xp.take(shells, constant(coefficient_of, degree, like=shells), axis=-1)
    packed = xp.reshape(packed, (*batch, count, degree + 1, 2, degree + 1))
    packed = xp.permute_dims(
        packed, (*range(len(batch)), -3 + packed.ndim, -1 + packed.ndim, -4 + packed.ndim, -2 + packed.ndim)
    )
    # Every order: the field of every source shell at every point, in one product; then keep the four needed.
    seen = table @ xp.reshape(packed, (*batch, degree + 1, degree + 1, 2 * count))
    seen = xp.reshape(seen, (*batch, degree + 1, points * count, 2))
    picked = xp.reshape(xp.take(seen, where, axis=-2), (*batch, degree + 1, 4, 2 * points))
    values = xp.sum(picked * weights, axis=-2)
    values = xp.reshape(values, (*batch, degree + 1, count, nodes, 2))
    values = xp.matrix_transpose(values)  # (m, k, cos/sin, node)
    found = xp.reshape(values, (*batch, degree + 1, 2 * count, nodes)) @ constant(_gauss_plan, degree, like=shells)
    found = xp.reshape(found, (*batch, degree + 1, count, 2, degree + 1))
    found = xp.permute_dims(found, (*range(len(batch)), len(batch) + 1, len(batch), len(batch) + 2, len(batch) + 3))
    found = xp.reshape(found, (*batch, count, -1))
    return xp.take(found, constant(entry_of, degree, like=shells), axis=-1)


@lru_cache(maxsize=8)  # a robot's steps are often of equal length
def _warp(degree: int, ranges: tuple[float, ...], distance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tables of the warp by `distance` at each quadrature node of each target shell ("points").

    Latitude functions at the point as seen before the step ``(degree + 1 (m), points, degree + 1 (l))``; the indices of
    the four source shells ``(4 points,)``, and their weights ``(4, 2 points)``, cosine and sine alike.
    """
    radius, z, count = np.array(ranges)[:, None], _nodes(degree)[0][None, :], len(ranges)
    before = np.sqrt(radius**2 + distance**2 + 2 * radius * distance * z)
    sines = ((radius * z + distance) / before).ravel()
    nearest, weights = _cubic(np.interp(np.log(before).ravel(), np.log(ranges), np.arange(count)), count)
    seen = latitude_functions(degree, sines).transpose(1, 2, 0)
    where = (np.arange(sines.size) * count + nearest).ravel()
    return frozen(seen), frozen(where), frozen(np.repeat(weights, 2, axis=1))


def _cubic(position: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Four neighbouring shells ``(4, n)`` of each fractional index, and their Catmull-Rom weights."""
    lower = np.minimum(position.astype(np.intp), count - 2)
    t = position - lower
    weights = np.stack(
        [
            ((2 - t) * t - 1) * t / 2,
            ((3 * t - 5) * t * t + 2) / 2,
            ((4 - 3 * t) * t + 1) * t / 2,
            (t - 1) * t * t / 2,
        ]
    )
    return np.clip(lower + np.arange(-1, 3)[:, None], 0, count - 1), weights


@lru_cache(maxsize=16)
def _nodes(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes over sin(elevation): half more than an unwarped field needs (1e-3 at half the first shell)."""
    return np.polynomial.legendre.leggauss(3 * degree // 2 + 2)


def _gauss_plan(degree: int) -> np.ndarray:
    """Quadrature back to coefficients ``(degree + 1 (m), nodes, degree + 1 (l))``."""
    nodes, weights = _nodes(degree)
    table = latitude_functions(degree, nodes).transpose(1, 0, 2) * weights
    table[0] *= 2 * math.pi
    table[1:] *= math.pi
    return table.transpose(0, 2, 1)


def _to_pole(axis: np.ndarray) -> np.ndarray:
    """The rotation Ry(-beta) Rz(-alpha) ``(3, 3)`` that takes the unit vector `axis` to +z."""
    x, y, z = axis.tolist()
    across = math.hypot(x, y)
    c, s = (x / across, y / across) if across > 0 else (1.0, 0.0)
    return np.array([[z * c, z * s, -across], [-s, c, 0.0], [across * c, across * s, z]])
