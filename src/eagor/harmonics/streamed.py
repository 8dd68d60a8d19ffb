"""Projections of high degree, order by order, to bound the memory of their tables.

The latitude part of all orders together has (2 degree + 1) (degree + 1) rows numbers: gigabytes from degree 200 on.
Here it is computed for a few orders at a time, used, and dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from eagor._arrays import Array, namespace, table_like
from eagor.harmonics.legendre import latitude_functions_of

_BLOCK_BYTES = 1 << 25

Made = Callable[[np.ndarray], np.ndarray]


def analysed(degree: int, rings: Array, sines: np.ndarray, made: Made) -> Array:
    """Coefficients by signed order and degree ``(2 degree + 1, degree + 1, B)`` of `rings` ``(2 degree + 1, H, B)``.

    `made` turns latitude functions ``(..., n)`` at `sines` ``(n,)`` into their integrals over the rows ``(..., H)``.
    """
    xp = namespace(rings)
    sine, cosine = [], []
    for first, last, table in _blocks(degree, sines):
        table = table_like(made(table), rings)
        cosine.append(table @ rings[degree + first : degree + last, ...])
        sine.append(table @ xp.flip(rings[degree - last + 1 : degree - first + 1, ...], axis=0))
    return _signed(xp, sine, cosine)


def synthesised(degree: int, packed: Array, sines: np.ndarray) -> Array:
    """The rings ``(2 degree + 1, B, H)`` at `sines` ``(H,)`` of coefficients ``(2 degree + 1, B, degree + 1)``."""
    xp = namespace(packed)
    sine, cosine = [], []
    for first, last, table in _blocks(degree, sines):
        table = table_like(table, packed)
        cosine.append(packed[degree + first : degree + last, ...] @ table)
        sine.append(xp.flip(packed[degree - last + 1 : degree - first + 1, ...], axis=0) @ table)
    return _signed(xp, sine, cosine)


def _blocks(degree: int, sines: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """First and last order (exclusive) of each block, with its latitude functions ``(orders, degree + 1, n)``."""
    most = max(1, math.floor(_BLOCK_BYTES / (8 * (degree + 1) * sines.size)))
    for first in range(0, degree + 1, most):
        last = min(first + most, degree + 1)
        yield first, last, latitude_functions_of(degree, sines, first, last)


def _signed(xp: Any, sine: list[Array], cosine: list[Array]) -> Array:
    """Both by signed order, from -degree to degree."""
    below = xp.flip(xp.concat(sine), axis=0)
    return xp.concat([below[:-1, ...], *cosine])
