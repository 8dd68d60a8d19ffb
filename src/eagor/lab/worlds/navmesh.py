"""The ground that tasks walk on, whoever holds it, and paths over it.

`NavMesh` is the part of `eagor.lab.worlds.ground.Ground` that tasks and reports use; another simulator's navigation
mesh has it, too. Paths over it are polylines, from which `follow_path` and `stroll` make one pose per step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from eagor.lab.worlds.scene import Instance


class GeodesicDistance(Protocol):
    """Shortest distances over a ground to one goal or set of goals."""

    def distance(self, xy: np.ndarray, /) -> np.ndarray:
        """Metres ``(...)`` from points ``(..., 2)``; inf without a path, off the ground and for NaN."""
        ...

    def union(self, *others: Any) -> GeodesicDistance:
        """The distance to the nearest goal of this one and the others, on the same ground."""
        ...


class NavMesh(Protocol):
    """Where a round body can stand, path lengths, and steps with collisions; metres, world frame.

    A point is ``(2,)``: x and y. The plan is for maps and for choosing places: square cells of side `cell`, cell (0, 0)
    with its low corner at `origin` ``(2,)``; `free`, `structure` (bool) and `clearance` (metres) are ``(rows, cols)``,
    rows along y.
    """

    @property
    def radius(self) -> float:
        """Of the body."""
        ...

    @property
    def floor(self) -> float:
        """Height of the floor."""
        ...

    @property
    def origin(self) -> np.ndarray: ...
    @property
    def cell(self) -> float: ...
    @property
    def free(self) -> np.ndarray: ...
    @property
    def structure(self) -> np.ndarray: ...
    @property
    def clearance(self) -> np.ndarray: ...

    @property
    def points(self) -> np.ndarray:
        """Places to choose from ``(n, 2)``: the centres of the free cells, in reading order."""
        ...

    def at_points(self, way: Any, /) -> np.ndarray:
        """Metres ``(n,)`` of a way of this ground from all `points`, to the accuracy of the plan."""
        ...

    def height(self, xy: np.ndarray, /) -> float:
        """Height of the ground under a point: `floor`, unless there are steps, ramps or stairs."""
        ...

    def is_free(self, xy: np.ndarray, /) -> np.ndarray:
        """Whether the body can stand at points ``(..., 2)``; False off the ground and for NaN."""
        ...

    def snap(self, xy: np.ndarray, within: float = ...) -> np.ndarray | None:
        """The free point nearest to a point; None if there is none `within` this many metres, and for NaN."""
        ...

    def sample(self, rng: np.random.Generator, clearance: float = ...) -> np.ndarray:
        """A random free point of at least this `clearance` (m). Raises `WorldError` if there is none."""
        ...

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> GeodesicDistance:
        """Distances to the nearest of points ``(n, 2)`` or ``(2,)``; each starts at its offset ``(n,)`` or 0."""
        ...

    def field_to_places(self, places: np.ndarray, /) -> GeodesicDistance:
        """Distances to the nearest of places ``(n, 3)`` at the feet, whatever the ground knows of other storeys."""
        ...

    def footprint(self, instance: Instance, /) -> GeodesicDistance:
        """Distances to the footprint of an instance, via points `beside` it; inf everywhere without any."""
        ...

    def beside(self, instance: Instance, /) -> tuple[np.ndarray, np.ndarray]:
        """The free points ``(k, 2)`` beside an instance, and their distances ``(k,)`` to its footprint."""
        ...

    def path(self, start: np.ndarray, goal: Any) -> np.ndarray:
        """The shortest path ``(n, 2)`` from a free point to another, or along a way. `WorldError` if there is none."""
        ...

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = ...) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point, which is free, too, and whether it collided."""
        ...


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


def stroll(ground: NavMesh, start: np.ndarray, step: float, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Points ``(2,)`` without end, `step` metres apart: along paths from `start` to one random goal after another."""
    last = np.asarray(start, dtype=np.float64)
    yield last
    while True:
        path = ground.path(last, ground.sample(rng))
        points = along(path, np.arange(step, max(length_of(path), step) + 1e-9, step))
        yield from points
        last = points[-1]


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
