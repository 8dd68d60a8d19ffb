"""Paths over a ground, and distances along them.

Paths are polylines, from which `follow_path` makes one pose per step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np


def initial_heading(path: np.ndarray, ahead: float = 0.5) -> float:
    """The initial heading (yaw, radians) of a path ``(n, 2)``, over its first `ahead` metres."""
    point = along(path, np.array([ahead]))[0]
    return float(np.arctan2(*(point - path[0])[::-1]))


def along(path: np.ndarray, metres: np.ndarray) -> np.ndarray:
    """The points ``(m, 2)`` of a polyline at these lengths from its start (clamped at its end)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))])
    return np.stack([np.interp(metres, lengths, path[:, axis]) for axis in (0, 1)], axis=-1)


def length_of(path: np.ndarray) -> float:
    """Its length in metres."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum())


def follow_path(path: np.ndarray, yaw: float, step: float, turn: float) -> np.ndarray:
    """One row of x, y, yaw per step ``(n, 3)`` along `path`, for a body that faces its walking direction.

    It starts with heading `yaw`, goes `step` metres at a time, and turns by at most `turn` radians per step; where the
    path bends more, it turns on the spot.
    """
    rows = []
    count = max(1, round(length_of(path) / step))
    points = along(path, np.arange(count + 1) * step)
    for here, there in pairwise(points):
        heading = math.atan2(there[1] - here[1], there[0] - here[0])
        while abs(left := math.remainder(heading - yaw, 2 * math.pi)) > turn + 1e-9:
            yaw = math.remainder(yaw + math.copysign(turn, left), 2 * math.pi)
            rows.append((here[0], here[1], yaw))
        yaw = heading
        rows.append((there[0], there[1], yaw))
    return np.array(rows)


# --- cells ------------------------------------------------------------------------------------------------------------


def cells_of(
    xy: np.ndarray, origin: np.ndarray, cell: float, shape: tuple[int, ...]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Points ``(..., 2)`` in cells, as row and column (0 off the grid), and whether on the grid (NaN is not)."""
    place = (np.asarray(xy, dtype=np.float64) - origin) / cell
    known = np.all((place >= 0) & (place < shape[::-1]), axis=-1)
    place = np.where(np.expand_dims(known, -1), place, 0.0)
    col, row = np.moveaxis(place.astype(np.intp), -1, 0)
    return place, (row, col), known


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Shortest distances over the ground to one goal or set of goals.

    `metres` ``(rows, cols)``: from the centre of each cell, inf without a path. Cell (0, 0) has its low corner at
    `origin` ``(2,)``; cells are squares of side `cell` metres.
    """

    origin: np.ndarray
    cell: float
    metres: np.ndarray

    def distance(self, xy: np.ndarray) -> np.ndarray:
        """Metres ``(...)`` from points ``(..., 2)``; inf without a path, off the ground and for NaN.

        Bilinear between the four cell centres around a point. Centres that cannot be reached, or whose distance
        differs much from that of the point's own cell, are left out: they lie behind a thin wall.
        """
        place, own, known = cells_of(xy, self.origin, self.cell, self.metres.shape)
        here = np.where(known, self.metres[own], np.inf)
        near = np.where(np.isfinite(here), here, 0.0)
        first = np.floor(place - 0.5).astype(np.intp)
        shares = (1 - (place - 0.5 - first), place - 0.5 - first)  # of the lower and of the upper neighbour
        last = np.array(self.metres.shape[::-1]) - 1
        total, weights = np.zeros(here.shape), np.zeros(here.shape)
        for right, up in product((0, 1), repeat=2):
            col, row = np.moveaxis(np.clip(first + np.array((right, up)), 0, last), -1, 0)
            value, weight = self.metres[row, col], shares[right][..., 0] * shares[up][..., 1]
            usable = np.abs(np.where(np.isfinite(value), value, 1e9) - near) < 2.1 * self.cell
            total = total + weight * np.where(usable, value, 0.0)
            weights = weights + np.where(usable, weight, 0.0)
        return np.where(np.isfinite(here), total / np.maximum(weights, 1e-12), np.inf)

    def union(self, *others: DistanceField) -> DistanceField:
        return DistanceField(
            self.origin, self.cell, np.minimum.reduce([self.metres, *(other.metres for other in others)])
        )


def walls_below(free: np.ndarray) -> np.ndarray:
    """The number of cells ``(rows + 1, cols)`` in rows below each row that are not free, for `sees`."""
    return np.pad(np.cumsum(~free, axis=0), ((1, 0), (0, 0)))


def sees(walls: np.ndarray, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Whether all cells that a straight line touches are free, both cells at a corner; `walls` as of `walls_below`.

    From one point `start` ``(2,)`` to each of `ends` ``(m, 2)``: x and y in cells, inside the grid.
    """
    (x, y), (left, bottom), (right, top) = start, np.minimum(start, ends).T, np.maximum(start, ends).T
    col = np.arange(int(left.min()), int(right.max()) + 1)
    # Where each line ``(m, 1)`` enters and leaves each column ``(k,)``, as far as it goes there.
    run, rise = (ends - start).T[..., None]
    crossed = np.clip(np.stack([col, col + 1])[:, None], left[:, None], right[:, None])
    height = y + (crossed - x) * rise / np.where(run == 0, np.inf, run)
    height[1] += np.where(run == 0, rise, 0.0)
    # Rounding must not leave out a cell at a corner, nor add one beyond the ends.
    first = np.maximum(height.min(axis=0) - 1e-9, bottom[:, None]).astype(np.intp)
    last = np.minimum(height.max(axis=0) + 1e-9, top[:, None]).astype(np.intp)
    inside = (col >= np.floor(left)[:, None]) & (col <= right[:, None])
    return ~(inside & (walls[last + 1, col] > walls[first, col])).any(axis=1)


def string_pull(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """The taut polyline of points ``(n, 2)``, in cells: corners are left out where `sees` allows the straight line.

    It runs from both ends until the path gets no shorter; new corners half-way along the legs let outer ones move in.
    """
    best = _shortcut(points, walls)
    while True:
        halved = np.insert(best, np.arange(1, len(best)), (best[1:] + best[:-1]) / 2, axis=0)
        shorter = _shortcut(_shortcut(halved, walls)[::-1], walls)[::-1]
        if length_of(shorter) > length_of(best) - 1e-3:
            return best
        best = shorter


def _shortcut(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    kept = [0]
    while kept[-1] < len(points) - 1:
        following, ahead = kept[-1] + 1, points[kept[-1] + 2 :]
        seen = sees(walls, points[kept[-1]], ahead) if len(ahead) else []
        kept.append(following + int(np.append(seen, False).argmin()))
    return points[kept]
