"""The basins of a field on the sphere: which peak each cell belongs to."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

# Nats from a peak down to the saddle at which it counts as one of its own. It is Rayleigh's criterion, by which the eye
# sees two points of light apart: the light between them falls to 0.735 of that of the points.
PROMINENCE = -math.log(0.735)


def basins(field: np.ndarray, prominence: float) -> np.ndarray:
    """For each cell of an equirectangular `field` ``(H, W)``, the index of the peak that it belongs to ``(H, W)``.

    Each cell climbs to its peak; basins whose peak stands less than `prominence` above the saddle to a higher one join
    that one.
    """
    return _merge(field, climbed(field), prominence)


def _neighbours(values: np.ndarray) -> list[np.ndarray]:
    """`values` ``(H, W)`` of each cell's right, lower-left, lower and lower-right neighbours, then the opposites."""
    height, width = values.shape
    around = np.empty((height + 2, width + 2), values.dtype)
    around[1:-1, 1:-1] = values
    for row, edge in ((0, values[0]), (-1, values[-1])):  # beyond a pole: the opposite meridian
        around[row, 1:-1] = np.roll(edge, width // 2)
    around[:, 0], around[:, -1] = around[:, -2], around[:, 1]
    places = [(1, 2), (2, 0), (2, 1), (2, 2), (1, 0), (0, 2), (0, 1), (0, 0)]
    return [around[row : row + height, column : column + width] for row, column in places]


@lru_cache(maxsize=4)
def _indices(shape: tuple[int, int]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """The index of each cell ``(H, W)``, and those of its neighbours."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    return index, tuple(_neighbours(index))


def climbed(field: np.ndarray) -> np.ndarray:
    """For each cell, the index of the peak that steepest ascent leads to ``(H, W)``."""
    index, around = _indices(field.shape)  # type: ignore[arg-type]
    best, target = field.copy(), index.copy()
    for value, where in zip(_neighbours(field), around, strict=True):
        # Equal values lead to the larger index, so that plateaus have one peak and no cycles.
        better = (value > best) | ((value == best) & (where > target))
        np.copyto(best, value, where=better)
        np.copyto(target, where, where=better)
    target = target.reshape(-1)
    while True:
        further = target[target]
        if np.array_equal(further, target):
            return target.reshape(field.shape)
        target = further


def _saddles(field: np.ndarray, label: np.ndarray) -> list[tuple[tuple[int, int], float]]:
    """Pairs of basins that touch and the height of the saddle between them, in the order in which they are met."""
    keys, heights = [], []
    for value, other in zip(_neighbours(field)[:4], _neighbours(label)[:4], strict=True):
        border = label != other
        a, b = label[border], other[border]
        keys.append(np.minimum(a, b) * field.size + np.maximum(a, b))
        heights.append(np.minimum(field[border], value[border]))
    key, height = np.concatenate(keys), np.concatenate(heights)
    if not len(key):
        return []
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    top = np.maximum.reduceat(height[order], starts)
    found = sorted(zip(order[starts].tolist(), key[order][starts].tolist(), top.tolist(), strict=True))
    return [(divmod(each, field.size), most) for _, each, most in found]


def _merge(field: np.ndarray, label: np.ndarray, prominence: float) -> np.ndarray:
    """Labels after merging shallow basins into a higher neighbour (persistence, highest saddle first)."""
    flat = field.reshape(-1)
    parent = {int(peak): int(peak) for peak in np.unique(label)}

    def root(peak: int) -> int:
        while parent[peak] != peak:
            peak = parent[peak]
        return peak

    for (a, b), height in sorted(_saddles(field, label), key=lambda item: -item[1]):
        low, high = sorted((root(a), root(b)), key=lambda peak: flat[peak])
        if low != high and flat[low] - height < prominence:
            parent[low] = high
    table = np.arange(flat.size)
    for peak in parent:
        table[peak] = root(peak)
    return table[label]
