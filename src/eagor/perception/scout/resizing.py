"""Resizes panoramas to the network's input, alike at all azimuths."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def resized(image: np.ndarray, rows: int) -> np.ndarray:
    """`image` ``(H, 2 H, 3)`` uint8 as ``(rows, 2 rows, 3)`` uint8.

    Whole blocks are averaged if `rows` divides H. Otherwise a triangle filter is used, two pixels of the coarser image
    wide; it wraps around the seam and stops at the poles.
    """
    height = image.shape[0]
    if height == rows:
        return image
    if height % rows == 0:
        times = height // rows
        # Columns first would access memory with strides.
        sums = image.reshape(rows, times, 2 * height, 3).sum(axis=1, dtype=np.uint32)
        sums = sums.reshape(rows, 2 * rows, times, 3).sum(axis=2)
        return ((sums + times * times // 2) // (times * times)).astype(np.uint8)
    down = triangles(height, rows, False) @ image.reshape(height, -1).astype(np.float32)
    across = down.reshape(rows, 2 * height, 3).transpose(1, 0, 2).reshape(2 * height, -1)
    found = (triangles(2 * height, 2 * rows, True) @ across).reshape(2 * rows, rows, 3).transpose(1, 0, 2)
    return np.clip(np.rint(found), 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def triangles(before: int, after: int, circular: bool) -> csr_array:
    """Weights ``(after, before)`` of the triangle filter; rows sum to 1."""
    from scipy.sparse import csr_array

    scale = before / after
    reach = max(scale, 1.0)
    centre = (np.arange(after) + 0.5) * scale - 0.5
    offset = np.arange(-int(np.ceil(reach)), int(np.ceil(reach)) + 2)
    place = np.floor(centre).astype(int)[:, None] + offset
    weight = np.maximum(1 - np.abs(place - centre[:, None]) / reach, 0)
    place = place % before if circular else np.clip(place, 0, before - 1)
    weight /= weight.sum(axis=1, keepdims=True)
    row = np.repeat(np.arange(after), len(offset))
    return csr_array((weight.ravel().astype(np.float32), (row, place.ravel())), shape=(after, before))
