"""The ground that tasks walk on, whoever holds it, and shortest paths over cells of it.

`NavMesh` is the part of `eagor.lab.worlds.ground.Ground` that tasks and reports use; another simulator's navigation
mesh has it, too. Paths over it are polylines, from which `follow_path` and `stroll` make one pose per step.

In a grid of free cells, every cell is joined to 32 neighbours (steps of up to three cells that are not a multiple of a
shorter one) if all cells that the straight step touches are free. Directions are at most 18.4 degrees apart, so a path
over the graph is at most 1.3 % longer than the straight one, 0.6 % on average. Cells are (row, col); row along y, col
along x.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from eagor._values import lazy

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


# --- shortest paths on a grid of free cells ---------------------------------------------------------------------------

_REACH = 3


def _steps() -> dict[tuple[int, int], list[tuple[int, int]]]:
    """One of each opposite pair of steps (rows, cols), and the cells that its straight line touches."""
    span = range(-_REACH, _REACH + 1)
    steps = [(r, c) for r in span for c in span if (r, c) > (0, 0) and math.gcd(r, c) == 1]

    def touches(step: tuple[int, int], cell: tuple[int, int]) -> bool:
        (r, c), (a, b) = step, cell
        within = min(0, r) <= a <= max(0, r) and min(0, c) <= b <= max(0, c)
        return within and 2 * abs(r * b - c * a) <= abs(r) + abs(c) and cell not in ((0, 0), step)

    return {step: [(a, b) for a in span for b in span if touches(step, (a, b))] for step in steps}


_STEPS = _steps()


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
        for right, up in itertools.product((0, 1), repeat=2):
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


@dataclass(frozen=True, eq=False)
class CellGraph:
    """The graph of the free cells ``(rows, cols)``; lengths in cells."""

    free: np.ndarray

    @lazy
    def nodes(self) -> np.ndarray:
        """Rows and columns ``(n, 2)`` of the free cells, in reading order."""
        return np.argwhere(self.free)

    @lazy
    def index(self) -> np.ndarray:
        """Index in `nodes` of each cell ``(rows, cols)``, -1 for those that are not free."""
        index = np.full(self.free.shape, -1, dtype=np.int32)
        index[self.free] = np.arange(len(self.nodes), dtype=np.int32)
        return index

    @lazy
    def edges(self) -> csr_array:
        """Lengths ``(n, n)`` of the steps between free cells."""
        reach = _REACH
        free, index = np.pad(self.free, reach), np.pad(self.index, reach, constant_values=-1)
        rows, cols = self.free.shape
        starts, ends, lengths = [], [], []

        def shifted(grid: np.ndarray, step: tuple[int, int]) -> np.ndarray:
            return grid[reach + step[0] : reach + step[0] + rows, reach + step[1] : reach + step[1] + cols]

        for step, between in _STEPS.items():
            open_ = self.free & shifted(free, step)
            for cell in between:
                open_ &= shifted(free, cell)
            here, there = self.index[open_], shifted(index, step)[open_]
            starts += [here, there]
            ends += [there, here]
            lengths.append(np.full(2 * len(here), math.hypot(*step)))
        entries = np.concatenate(lengths), (np.concatenate(starts), np.concatenate(ends))
        return csr_array(entries, shape=(len(self.nodes), len(self.nodes)))

    def spread(self, seeds: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """Distances in cells ``(rows, cols)`` from seeds, indices of `nodes` ``(k,)`` that start at `offsets` ``(k,)``.

        A virtual node joined to every seed by an edge of its offset stands for the goal.
        """
        found = np.full(self.free.shape, np.inf)
        if len(seeds) == 0:
            return found
        edges, count = self.edges, len(self.nodes)
        joined = csr_array(
            (
                np.concatenate([edges.data, np.maximum(offsets, 1e-9)]),
                np.concatenate([edges.indices, np.asarray(seeds, dtype=edges.indices.dtype)]),
                np.concatenate([edges.indptr, [edges.nnz + len(seeds)]]).astype(edges.indptr.dtype),
            ),
            shape=(count + 1, count + 1),
        )
        found[self.free] = dijkstra(joined, indices=count)[:count]
        return found

    def descend(self, distances: np.ndarray, row: int, col: int) -> list[tuple[int, int]]:
        """Cells from (row, col) down to the seed of its path; `distances` is a result of `spread`."""
        values, edges = distances[self.free], self.edges
        here = int(self.index[row, col])
        way = [here]
        while True:
            part = slice(edges.indptr[here], edges.indptr[here + 1])
            through = values[edges.indices[part]] + edges.data[part]
            # A seed starts below every path through a neighbour, up to rounding.
            if len(through) == 0 or through.min() > values[here] + 1e-7:
                return [(int(r), int(c)) for r, c in self.nodes[way]]
            here = int(edges.indices[part][through.argmin()])
            way.append(here)


def string_pull(points: list[tuple[float, float]], sees: Callable[[tuple, tuple], bool]) -> list[tuple[float, float]]:
    """The taut polyline: corners are left out where the straight line between others is free.

    It runs from both ends until the path gets no shorter; new corners half-way along the legs let outer ones move in.
    """
    best = _shortcut(points, sees)
    for _ in range(4):
        halved = [best[0]]
        for a, b in itertools.pairwise(best):
            halved += [((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), b]
        shorter = _shortcut(_shortcut(halved, sees)[::-1], sees)[::-1]
        if length_of(np.array(shorter)) > length_of(np.array(best)) - 1e-3:
            break
        best = shorter
    return best


def _shortcut(points: list[tuple[float, float]], sees: Callable[[tuple, tuple], bool]) -> list[tuple[float, float]]:
    kept, at = [points[0]], 0
    while at < len(points) - 1:
        following = at + 1
        while following + 1 < len(points) and sees(points[at], points[following + 1]):
            following += 1
        kept.append(points[following])
        at = following
    return kept


class Walls(NamedTuple):
    """Cells in reading order, `cols` per row: `free`, one byte each, none free at the border; `clearance`."""

    free: bytes
    clearance: list[float]
    cols: int

    def sees(self, start: tuple[float, float], end: tuple[float, float]) -> bool:
        """Whether all cells that a straight line touches are free (Amanatides and Woo's walk, both cells at a corner).

        Points (x, y) in cells, inside the grid.
        """
        (free, _, cols), (x, y), (x_end, y_end) = self, start, end
        col, row, last_col, last_row = math.floor(x), math.floor(y), math.floor(x_end), math.floor(y_end)
        dx, dy = x_end - x, y_end - y
        right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        per_col = abs(1 / dx) if dx else math.inf
        per_row = abs(1 / dy) if dy else math.inf
        to_col = (col + 1 - x if dx > 0 else x - col) * per_col if dx else math.inf
        to_row = (row + 1 - y if dy > 0 else y - row) * per_row if dy else math.inf
        for _ in range(abs(last_col - col) + abs(last_row - row) + 1):
            if not free[row * cols + col]:
                return False
            if col == last_col and row == last_row:
                return True
            if abs(to_col - to_row) < 1e-9:
                if not (free[row * cols + col + right] and free[(row + up) * cols + col]):
                    return False
                col, row, to_col, to_row = col + right, row + up, to_col + per_col, to_row + per_row
            elif to_col < to_row:
                col, to_col = col + right, to_col + per_col
            else:
                row, to_row = row + up, to_row + per_row
        return bool(free[last_row * cols + last_col])

    def move(self, x: float, y: float, dx: float, dy: float, slide: bool) -> tuple[float, float, bool]:
        """The end of a step (dx, dy) from a free point (x, y), and whether it collided; all in cells.

        The step is taken in parts of at most half a cell; a blocked part continues along the wall (`slide`).
        """
        free, _, cols = self
        at = int(y) * cols + int(x)
        parts = math.ceil(math.hypot(dx, dy) * 2)
        if parts:
            dx, dy = dx / parts, dy / parts
        collided = False
        for _ in range(parts):
            to = int(y + dy) * cols + int(x + dx)
            if free[to] and self._joined(at, to):
                x, y, at = x + dx, y + dy, to
                continue
            collided = True
            if not slide:
                break
            for along_x, along_y in self._along(at, dx, dy):
                to = int(y + along_y) * cols + int(x + along_x)
                if free[to] and self._joined(at, to):
                    x, y, at = x + along_x, y + along_y, to
                    break
            else:
                break
        return x, y, collided

    def _along(self, at: int, dx: float, dy: float) -> list[tuple[float, float]]:
        """A part of a step without its component into the wall, the best candidate first.

        The wall is normal to the gradient of the clearance; if that leads nowhere, along one of the axes.
        """
        clearance, cols = self.clearance, self.cols
        slope_x, slope_y = clearance[at + 1] - clearance[at - 1], clearance[at + cols] - clearance[at - cols]
        into = dx * slope_x + dy * slope_y
        found = [(dx, 0.0), (0.0, dy)] if abs(dx) > abs(dy) else [(0.0, dy), (dx, 0.0)]
        if into < 0:
            into /= slope_x * slope_x + slope_y * slope_y
            found.insert(0, (dx - into * slope_x, dy - into * slope_y))
        # In a head-on collision only rounding errors are left; they give no direction along the wall.
        least = 0.01 * math.hypot(dx, dy)
        return [(a, b) for a, b in found if math.hypot(a, b) > least]

    def _joined(self, here: int, there: int) -> bool:
        """Whether two neighbouring free cells share an edge, or a corner that is not closed from both sides."""
        cols = self.cols
        if abs(here - there) in (0, 1, cols):
            return True
        row, col = here // cols, here % cols
        return bool(self.free[row * cols + there % cols] or self.free[there // cols * cols + col])
