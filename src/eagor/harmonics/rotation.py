"""Rotating a field: Wigner's D for the real basis, without ever forming an angle.

Any rotation is R = Rz(alpha) Ry(beta) Rz(gamma), and Ry(beta) = Rx(-90) Rz(beta) Rx(90), so that

    D(R) = Z(alpha) J^T Z(beta) J Z(gamma),    J = D(Rx(90 degrees)),

where Z(a) mixes only the sine and cosine of the same order (a multiplication by exp(i m a)) and J is one constant
matrix, computed once (Pinchon & Hoggan, J. Phys. A 40, 2007, use the same factoring).

The gimbal trap: the cosines and sines of the three angles are read off R directly, gamma from the rest of R after alpha
is removed. So identity, pure yaw, half turns and tilts of 1e-8 are all exact to rounding.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._arrays import Array, constant, namespace, table_like, to_numpy
from eagor.harmonics.legendre import evaluate, orders

DENSE_UP_TO = 15  # up to this degree one 256 x 256 matrix is faster than 16 small ones
DENSE_COLUMNS = 8  # the most fields at once for which it is
CHUNK = 256  # beliefs at a time, so that the working set fits in the second-level cache


def rotate(degree: int, coefficients: Array, new_R_old: Array) -> Array:
    """Coefficients ``(..., (degree + 1)^2)`` in the new frame; `new_R_old` ``(..., 3, 3)`` broadcasts with them.

    The caller has checked `new_R_old`. It may be another kind of array; the result is of the kind of the coefficients.
    """
    if type(new_R_old) is not type(coefficients):
        new_R_old = table_like(to_numpy(new_R_old), coefficients)
    if new_R_old.ndim == 2 and type(coefficients) is np.ndarray:
        if coefficients.ndim == 1:
            return _rotated(degree, coefficients, new_R_old)
        columns = np.ascontiguousarray(coefficients.reshape(-1, coefficients.shape[-1]).T)
        return _rotated(degree, columns, new_R_old).T.reshape(coefficients.shape)
    xp = namespace(coefficients)
    batch = np.broadcast_shapes(tuple(coefficients.shape[:-1]), tuple(new_R_old.shape[:-2]))
    size = coefficients.shape[-1]
    # Coefficients first, beliefs last: every step is then a long row operation or one matrix product.
    flat = xp.reshape(xp.broadcast_to(coefficients, (*batch, size)), (-1, size)).T
    turns = xp.reshape(xp.broadcast_to(new_R_old, (*batch, 3, 3)), (-1, 3, 3))
    if new_R_old.ndim == 2:
        turns = new_R_old[None, ...]
    turns = xp.astype(turns, flat.dtype)
    if xp is not np:
        rotated = _rotated(degree, flat, turns)
    else:
        rotated = np.empty(flat.shape, flat.dtype)
        for start in range(0, flat.shape[1], CHUNK):
            part = slice(start, start + CHUNK)
            some = turns if turns.shape[0] == 1 else turns[part]
            rotated[:, part] = _rotated(degree, np.ascontiguousarray(flat[:, part]), some)
    return xp.reshape(rotated.T, (*batch, size))


def _rotated(degree: int, columns: Array, turns: Array) -> Array:
    """`columns` ``(size, n)`` rotated by `turns` ``(n or 1, 3, 3)``; or by one NumPy matrix, then also ``(size,)``."""
    xp = namespace(columns)
    if turns.ndim == 2:  # in plain floats
        (r00, r01, r02), (r10, r11, r12), (_, _, r22) = turns.tolist()
        tilt = math.hypot(r02, r12)
        if tilt < 1e-15 and r22 > 0:  # a pure yaw
            return _turn(degree, columns, r00, r10)
        alpha, upright = ((r02 / tilt, r12 / tilt) if tilt > 0 else (1.0, 0.0)), False
    else:
        (r00, r01, r02), (r10, r11, r12), (_, _, r22) = ([turns[:, i, j] for j in range(3)] for i in range(3))
        tilt = xp.hypot(r02, r12)
        level = tilt == 0
        safe = xp.where(level, xp.ones_like(tilt), tilt)
        alpha = xp.where(level, xp.ones_like(tilt), r02 / safe), xp.where(level, xp.zeros_like(tilt), r12 / safe)
        upright = xp is np and bool(level.all() and (r22 > 0).all())
    columns = _turn(degree, columns, alpha[0] * r11 - alpha[1] * r01, alpha[0] * r10 - alpha[1] * r00)
    if upright:
        return columns
    columns = _turn(degree, _quarter(degree, columns, False), r22, tilt)
    return _turn(degree, _quarter(degree, columns, True), *alpha)


def _turn(degree: int, columns: Array, cosine: Array | float, sine: Array | float) -> Array:
    """Z of n angles ``(n,)`` on `columns` ``(size, n)``, or of one angle."""
    if isinstance(cosine, float):
        phase = complex(cosine, sine)
        phase /= abs(phase)
        if abs(phase - 1) < 1e-15:
            return columns
        powers = [1 + 0j]
        for _ in range(degree):
            powers.append(powers[-1] * phase)
        table: Any = np.array([power.conjugate() for power in powers[:0:-1]] + powers)[_order_index(degree)]
        table = table if columns.ndim == 1 else table[:, None]
        return (columns * table.real - columns[_partner(degree)] * table.imag).astype(columns.dtype, copy=False)
    xp = namespace(columns)
    length = xp.hypot(cosine, sine)
    cosine, sine = cosine / length, sine / length
    cosines, sines = [xp.ones_like(cosine)], [xp.zeros_like(sine)]
    for _ in range(degree):
        c, s = cosines[-1], sines[-1]
        cosines.append(c * cosine - s * sine)
        sines.append(s * cosine + c * sine)
    index, partner = constant(_order_index, degree, like=columns), constant(_partner, degree, like=columns)
    even, odd = xp.stack(cosines[:0:-1] + cosines), xp.stack([-s for s in sines[:0:-1]] + sines)
    # One large table at a time, for the cache.
    return columns * xp.take(even, index, axis=0) - xp.take(columns, partner, axis=0) * xp.take(odd, index, axis=0)


def _quarter(degree: int, columns: Array, transposed: bool) -> Array:
    """J (or its transpose) on `columns` ``(size, n)``."""
    if degree <= DENSE_UP_TO and (columns.ndim == 1 or columns.shape[1] <= DENSE_COLUMNS):
        return constant(_quarter_dense, degree, transposed, like=columns) @ columns
    if type(columns) is np.ndarray:
        blocks = _quarter_kept(degree, transposed, columns.dtype.char)
    else:
        blocks = tuple(constant(_quarter_block, degree, l, transposed, like=columns) for l in range(degree + 1))
    parts = [block @ columns[l * l : (l + 1) ** 2, ...] for l, block in enumerate(blocks)]
    return namespace(columns).concat(parts)


@lru_cache(maxsize=64)
def _order_index(degree: int) -> np.ndarray:
    """The index of each coefficient's order in a table over m = -degree .. degree."""
    return orders(degree) + degree


@lru_cache(maxsize=64)
def _partner(degree: int) -> np.ndarray:
    """The index of (l, -m) for each (l, m)."""
    return np.arange((degree + 1) ** 2) - 2 * orders(degree)


@lru_cache(maxsize=64)
def _quarter_blocks(degree: int) -> tuple[np.ndarray, ...]:
    """The blocks of J = D(Rx(90 degrees)), by quadrature of Y_i(omega) Y_j(R^-1 omega), exact for this degree."""
    sines, weights = np.polynomial.legendre.leggauss(degree + 1)
    azimuths = np.arange(2 * degree + 2) * (math.pi / (degree + 1))
    blocks = [np.zeros((2 * l + 1, 2 * l + 1)) for l in range(degree + 1)]
    for z, weight in zip(sines, weights, strict=True):  # one ring at a time: at degree 63 all at once take 0.5 GB
        radius = math.sqrt(1 - z * z)
        ring = np.stack([radius * np.cos(azimuths), radius * np.sin(azimuths), np.full(azimuths.size, z)], axis=-1)
        here = evaluate(degree, ring) * (weight * math.pi / (degree + 1))
        # R = Rx(90): (x, y, z) -> (x, -z, y), so R^-1 omega = (x, z, -y).
        before = evaluate(degree, np.stack([ring[:, 0], ring[:, 2], -ring[:, 1]], axis=-1))
        for l, block in enumerate(blocks):
            part = slice(l * l, (l + 1) ** 2)
            block += here[:, part].T @ before[:, part]
    return tuple(blocks)


@lru_cache(maxsize=64)
def _quarter_kept(degree: int, transposed: bool, kind: str) -> tuple[np.ndarray, ...]:
    """The blocks of J (or its transpose) in one precision."""
    like = np.zeros(0, dtype=kind)
    return tuple(constant(_quarter_block, degree, l, transposed, like=like) for l in range(degree + 1))


def _quarter_block(degree: int, l: int, transposed: bool) -> np.ndarray:
    block = _quarter_blocks(degree)[l]
    return block.T if transposed else block


def _quarter_dense(degree: int, transposed: bool) -> np.ndarray:
    from scipy.linalg import block_diag

    dense = np.asarray(block_diag(*_quarter_blocks(degree)))
    return dense.T if transposed else dense
