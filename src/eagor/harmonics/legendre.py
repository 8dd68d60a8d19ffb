"""The real spherical harmonics as polynomials of x, y and z.

Real, orthonormal, without the Condon-Shortley phase: index l*l + l + m, with m > 0 the cosine and m < 0 the sine, so
that Y_00 = 1 / sqrt(4 pi) and (Y_1-1, Y_10, Y_11) = sqrt(3 / 4 pi) (y, z, x).

Each one is Y_lm = Q_l|m|(z) C_m(x, y), where C_m and C_-m are the real and imaginary part of (x + i y)^m, which
carries the factor cos(elevation)^m of the associated Legendre function. No angle is computed, so the poles need no
special case.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._arrays import Array, namespace, table_like


@lru_cache(maxsize=64)
def orders(degree: int) -> np.ndarray:
    """The signed order m of each of the (degree + 1)^2 coefficients."""
    return np.concatenate([np.arange(-l, l + 1) for l in range(degree + 1)])


@lru_cache(maxsize=64)
def degrees(degree: int) -> np.ndarray:
    """The degree l of each of the (degree + 1)^2 coefficients."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


@lru_cache(maxsize=64)
def _recursion(degree: int) -> tuple[list[float], list[list[float]], list[list[float]]]:
    """Starting values Q_mm (sqrt 2 of the real basis included), and a_lm, b_lm of the three-term recursion in l."""
    start = [1 / math.sqrt(4 * math.pi)]
    for m in range(1, degree + 1):
        start.append(start[-1] * math.sqrt((2 * m + 1) / (2 * m)) * (math.sqrt(2) if m == 1 else 1.0))
    a, b = [], []
    for l in range(degree + 1):
        a.append([math.sqrt((4 * l * l - 1) / (l * l - m * m)) for m in range(l)])
        b.append([math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) if m < l - 1 else 0.0 for m in range(l)])
    return start, a, b


def reduced_legendre(degree: int, z: Array) -> list[Array]:
    """Q_lm(z) for l = 0 .. degree: a list of arrays ``(l + 1, ...)`` over m, for `z` = sin(elevation) ``(...)``.

    Q_lm = a_lm (z Q_l-1,m - b_lm Q_l-2,m), from Q_mm, all orders at once (Holmes & Featherstone, J. Geodesy 76, 2002).
    """
    xp = namespace(z)
    start, a, b = _recursion(degree)
    column = (-1,) + (1,) * z.ndim
    one = xp.ones_like(z)[None, ...]
    rows = [start[0] * one]
    for l in range(1, degree + 1):
        scale_a, scale_b = (xp.reshape(table_like(np.array(t[l]), z), column) for t in (a, b))
        below = z * rows[l - 1]
        if l > 1:
            two_below = xp.concat([rows[l - 2], xp.zeros_like(one)])
            below = below - scale_b * two_below
        rows.append(xp.concat([scale_a * below, start[l] * one]))
    return rows


def evaluate(degree: int, directions: Array) -> Array:
    """Y ``(..., (degree + 1)^2)`` at unit vectors ``(..., 3)``."""
    xp = namespace(directions)
    if xp is np:
        return _evaluate(degree, directions)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    cosines, sines = [xp.ones_like(x)], [xp.zeros_like(x)]
    for _ in range(degree):
        c, s = cosines[-1], sines[-1]
        cosines.append(c * x - s * y)
        sines.append(s * x + c * y)
    columns = []
    for l, row in enumerate(reduced_legendre(degree, z)):
        columns += [row[-m, ...] * sines[-m] for m in range(-l, 0)]
        columns += [row[m, ...] * cosines[m] for m in range(l + 1)]
    return xp.stack(columns, axis=-1)


def _evaluate(degree: int, directions: np.ndarray) -> np.ndarray:
    """The same in as few NumPy calls as possible, which take most of the time at a hundred directions.

    The recursion runs over polynomials with leading coefficient 1, which leaves one factor in it.
    """
    flat = directions.reshape(-1, 3)
    z, below = np.ascontiguousarray(flat[:, 2]), _monic(degree)[0]
    table = np.ones((degree + 1, degree + 1, len(flat)), flat.dtype)
    for l in range(1, degree + 1):
        np.multiply(table[l - 1, :l], z, out=table[l, :l])
        table[l, : l - 1] -= below[l, : l - 1] * table[l - 2, : l - 1]
    turns: Any = np.ones((degree + 1, len(flat)), np.result_type(flat.dtype, np.complex64))
    turns[1:] = flat[:, 0] + 1j * flat[:, 1]
    turns = np.multiply.accumulate(turns, axis=0)
    across = np.concatenate([turns.imag[:0:-1], turns.real])  # by signed order
    m = orders(degree)
    found = table[degrees(degree), np.abs(m)] * across[m + degree]
    found *= _monic(degree)[1]
    return found.T.reshape(*directions.shape[:-1], len(found))


@lru_cache(maxsize=64)
def _monic(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """For monic Q_lm: the factors ``(l, m, 1)`` of Q_l-2,m, and leading coefficients ``((degree + 1)^2, 1)``."""
    start, a, b = _recursion(degree)
    leading, below = np.diag(start), np.zeros((degree + 1, degree + 1, 1))
    for l in range(1, degree + 1):
        leading[l, :l] = np.array(a[l]) * leading[l - 1, :l]
        below[l, : l - 1, 0] = np.array(b[l][:-1]) / np.array(a[l - 1])
    return below, leading[degrees(degree), np.abs(orders(degree))][:, None]


def latitude_functions(degree: int, sines: Array) -> Array:
    """The latitude part of Y_lm, ``(degree + 1 (l), degree + 1 (m), n)``, at sin(elevation) ``(n,)``; zero where m > l.

    It is the reduced function times cos(elevation)^m.
    """
    xp = namespace(sines)
    cosines = xp.sqrt(xp.clip(1 - sines * sines, 0.0, 1.0))
    if xp is np:  # the same recursion in place: the factor cos^m does not depend on l
        start, a, b = _recursion(degree)
        table = np.zeros((degree + 1, degree + 1, sines.size), sines.dtype)
        table[0, 0] = start[0]
        power = np.ones_like(sines)
        for l in range(1, degree + 1):
            row = table[l, :l]
            np.multiply(table[l - 1, :l], sines, out=row)
            if l > 1:
                row[:-1] -= np.array(b[l][:-1])[:, None] * table[l - 2, : l - 1]
            row *= np.array(a[l])[:, None]
            power = power * cosines
            np.multiply(power, start[l], out=table[l, l])
        return table
    powers = [xp.ones_like(cosines)]
    for _ in range(degree):
        powers.append(powers[-1] * cosines)
    blank = xp.zeros_like(sines)[None, ...]
    rows = reduced_legendre(degree, sines)
    full = xp.stack([xp.concat([row, *([blank] * (degree - l))]) for l, row in enumerate(rows)])
    return full * xp.stack(powers)


def latitude_functions_of(degree: int, sines: np.ndarray, first: int, last: int) -> np.ndarray:
    """The same for the orders `first` to `last` - 1, ``(orders, degree + 1 (l), n)``."""
    start, a, b = _recursion(degree)
    cosines = np.sqrt(np.clip(1 - sines * sines, 0.0, 1.0))
    table = np.zeros((degree + 1, last - first, sines.size))
    for l in range(first, degree + 1):
        below = min(l, last) - first  # orders smaller than l
        if below > 0:
            row = table[l, :below]
            np.multiply(table[l - 1, :below], sines, out=row)
            if l > 1:
                row -= np.array(b[l][first : first + below])[:, None] * table[l - 2, :below]
            row *= np.array(a[l][first : first + below])[:, None]
        if l < last:
            np.multiply(cosines**l, start[l], out=table[l, l - first])
    return table.transpose(1, 0, 2)


def latitude_table(degree: int, sines: np.ndarray) -> np.ndarray:
    """The latitude part as table ``(2 degree + 1, degree + 1, n)``: signed order m by degree l, zero where l < |m|."""
    found = latitude_functions(degree, np.asarray(sines, dtype=np.float64)).transpose(1, 0, 2)
    return np.concatenate([found[:0:-1], found])


def longitude_table(degree: int, azimuths: np.ndarray) -> np.ndarray:
    """The longitude part ``(n, 2 degree + 1)``: sin(|m| azimuth) for m < 0, then cos(m azimuth)."""
    angle = np.outer(azimuths, np.arange(degree + 1))
    return np.concatenate([np.sin(angle[:, :0:-1]), np.cos(angle)], axis=1)
