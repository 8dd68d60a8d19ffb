"""The basins of a field on the sphere, and its places: which part of it belongs to which of its peaks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor.belief.field import LARGEST, SphereField, cells_of
from eagor.evidence.detections import LOWEST
from eagor.grids import beyond_edges

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
    around = values.reshape(-1).take(beyond_edges(height, width, 1))
    places = [(1, 2), (2, 0), (2, 1), (2, 2), (1, 0), (0, 2), (0, 1), (0, 0)]
    return [around[row : row + height, column : column + width] for row, column in places]


@lru_cache(maxsize=4)
def _indices(shape: tuple[int, int]) -> np.ndarray:
    """The index of each cell ``(H, W + 2)``, `_wrapped`."""
    return _wrapped(np.arange(shape[0] * shape[1]).reshape(shape))


def climbed(field: np.ndarray) -> np.ndarray:
    """For each cell, the index of the peak that steepest ascent leads to ``(H, W)``."""
    height, width = field.shape
    # The highest of a cell and its eight neighbours: first along the rows, then, of those, along the columns.
    best, target = np.empty((height + 2, width)), np.empty((height + 2, width), dtype=np.intp)
    wide, index = _wrapped(field), _indices((height, width))
    sides = slice(None, -2), slice(1, -1), slice(2, None)
    best[1:-1], target[1:-1] = _highest([wide[:, side] for side in sides], [index[:, side] for side in sides])
    for beyond, edge in ((0, 1), (-1, -2)):  # beyond a pole: the opposite meridian
        best[beyond], target[beyond] = _opposite(best[edge]), _opposite(target[edge])
    target = _highest([best[side] for side in sides], [target[side] for side in sides])[1].reshape(-1)
    while True:
        further = target.take(target)
        if (further == target).all():
            return target.reshape(field.shape)
        target = further


def _opposite(row: np.ndarray) -> np.ndarray:
    """A row ``(W,)`` half a turn further."""
    half = len(row) // 2
    return np.concatenate([row[-half:], row[:-half]])


def _wrapped(values: np.ndarray) -> np.ndarray:
    """`values` ``(H, W)`` with one more column at both sides, across the seam."""
    return np.concatenate([values[:, -1:], values, values[:, :1]], axis=1)


def _highest(values: list[np.ndarray], indices: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The highest of three `values` ``(H, W)`` each, and its index of `indices` ``(H, W)``.

    Equal values lead to the larger index, so that plateaus have one peak and no cycles.
    """
    best, target = values[1].copy(), indices[1].copy()
    for value, where in ((values[0], indices[0]), (values[2], indices[2])):
        better = (value > best) | ((value == best) & (where > target))
        np.copyto(best, value, where=better)
        np.copyto(target, where, where=better)
    return best, target


def _saddles(field: np.ndarray, label: np.ndarray) -> tuple[list[int], list[int], list[float]]:
    """Pairs of basins that touch, and the height of the saddle between them, the highest first.

    Saddles of equal height are in the order in which they are met.
    """
    others = np.array(_neighbours(label)[:4])
    border = (others != label).reshape(-1).nonzero()[0]
    home = border % field.size
    a, b = label.reshape(-1).take(home), others.reshape(-1).take(border)
    heights = np.minimum(field.reshape(-1).take(home), np.array(_neighbours(field)[:4]).reshape(-1).take(border))
    key = np.minimum(a, b) * field.size + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    if not len(starts):
        return [], [], []
    top = np.maximum.reduceat(heights[order], starts)
    best = np.lexsort((order[starts], -top))
    low, high = np.divmod(key[starts[best]], field.size)
    return low.tolist(), high.tolist(), top[best].tolist()


def _merge(field: np.ndarray, label: np.ndarray, prominence: float) -> np.ndarray:
    """Labels after merging shallow basins into a higher neighbour (persistence, highest saddle first)."""
    flat = field.reshape(-1)
    parent: dict[int, int] = {}  # of the basins that were merged
    for a, b, height in zip(*_saddles(field, label), strict=True):
        while a in parent:
            a = parent[a]
        while b in parent:
            b = parent[b]
        if a == b:
            continue
        low, high = (a, b) if flat[a] <= flat[b] else (b, a)
        if flat[low] - height < prominence:
            parent[low] = high
    if not parent:
        return label
    table = np.arange(flat.size)
    for peak, top in parent.items():
        while top in parent:
            top = parent[top]
        table[peak] = top
    return table[label]


@dataclass(frozen=True, eq=False)
class Places:
    """The basins of a field, numbered from 0 to `count` - 1.

    Of its `cells` ``(H, W)``, and of its `patches` ``(n,)``: each is one place, that of the cell below its peak.
    """

    count: int
    cells: np.ndarray
    patches: np.ndarray

    @classmethod
    def of(cls, field: SphereField, labels: tuple[int, np.ndarray]) -> Places:
        """With the `labels` of the cells."""
        grid, (count, cells) = field.grid, labels
        tops = [patch.top for patch in field.patches]
        return cls(count, cells, cells.reshape(-1)[cells_of(grid, np.array(tops).reshape(-1, 3))])


def labelled(values: np.ndarray, prominence: float = 0.0) -> tuple[int, np.ndarray]:
    """The number of basins of a field ``(H, W)``, and that of each cell ``(H, W)``; shallow ones join a neighbour."""
    label = basins(values, prominence).reshape(-1) if prominence else climbed(values).reshape(-1)
    there = np.zeros(len(label), dtype=bool)
    there[label] = True
    return int(there.sum()), (np.cumsum(there) - 1)[label].reshape(values.shape)


def log_sums(field: SphereField, places: Places) -> np.ndarray:
    """log of the integral ``(m,)`` of exp(field) over each of the places."""
    log, weight = field.logs, field.layout.weights
    of_patches = np.repeat(places.patches, [patch.values.size for patch in field.patches])
    home = np.concatenate([places.cells.reshape(-1).take(field.layout.free), of_patches])
    top = np.full(places.count, -np.inf)
    np.maximum.at(top, home, log)
    top = np.maximum(top, -LARGEST)  # a place may lie under patches of other places
    sums = np.bincount(home, np.exp(np.maximum(log - top.take(home), LOWEST)) * weight, minlength=places.count)
    return np.log(np.maximum(sums, math.exp(-LARGEST))) + top
