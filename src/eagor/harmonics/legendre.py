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
def entry_of(degree: int) -> np.ndarray:
    """The index of each coefficient in a flattened table (m >= 0, cosine or sine, l)."""
    m = orders(degree)
    return (2 * np.abs(m) + (m < 0)) * (degree + 1) + degrees(degree)


@lru_cache(maxsize=64)
def coefficient_of(degree: int) -> np.ndarray:
    """For each entry of that table, its coefficient; an arbitrary one (the first) where there is none."""
    found = np.zeros(2 * (degree + 1) ** 2, dtype=np.intp)
    found[entry_of(degree)] = np.arange((degree + 1) ** 2)
    return found


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


def evaluate(degree: int, directions: Array) -> Array:
    """Y ``(..., (degree + 1)^2)`` at unit vectors ``(..., 3)``.

    Q_lm = a_lm (z Q_l-1,m - b_lm Q_l-2,m), from Q_mm, all orders at once (Holmes & Featherstone, J. Geodesy 76, 2002).
    """
    xp = namespace(directions)
    if xp is np:
        return _evaluate(degree, directions)
    start, a, b = _recursion(degree)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    one = xp.ones_like(z)[None, ...]
    row, before, cosines, sines = start[0] * one, one[:0, ...], [one[0, ...]], [xp.zeros_like(z)]
    columns = [row[0, ...]]
    for l in range(1, degree + 1):
        c, s = cosines[-1], sines[-1]
        cosines.append(c * x - s * y)
        sines.append(s * x + c * y)
        scale_a, scale_b = (xp.reshape(table_like(np.array(t[l]), z), (-1,) + (1,) * z.ndim) for t in (a, b))
        below = z * row - scale_b * xp.concat([before, xp.zeros_like(one)])
        row, before = xp.concat([scale_a * below, start[l] * one]), row
        columns += [row[m, ...] * sines[m] for m in range(l, 0, -1)]
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


def latitude_functions(degree: int, sines: np.ndarray, first: int = 0, last: int | None = None) -> np.ndarray:
    """The latitude part of Y_lm ``(degree + 1 (l), orders, n)`` at sin(elevation) ``(n,)``; zero where m > l.

    It is the reduced function times cos(elevation)^m, which does not depend on l. Of the orders `first` to `last` - 1,
    by default of all from 0 on.
    """
    start, a, b = _recursion(degree)
    last = degree + 1 if last is None else last
    cosines = np.sqrt(np.clip(1 - sines * sines, 0.0, 1.0))
    table, power = np.zeros((degree + 1, last - first, sines.size), sines.dtype), cosines**first
    for l in range(first, degree + 1):
        count = min(l, last) - first  # orders smaller than l
        row = table[l, :count]
        np.multiply(table[l - 1, :count], sines, out=row)
        row -= np.array(b[l][first : first + count])[:, None] * table[l - 2, :count]
        row *= np.array(a[l][first : first + count])[:, None]
        if l < last:
            np.multiply(power, start[l], out=table[l, l - first])
            power = power * cosines
    return table


def longitude_table(degree: int, azimuths: np.ndarray) -> np.ndarray:
    """The longitude part ``(n, 2 (degree + 1))``: cos(m azimuth) and sin(m azimuth), in turn, for m >= 0."""
    angle = np.outer(azimuths, np.arange(degree + 1))
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(len(angle), -1)
