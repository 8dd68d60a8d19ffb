"""A map of the floor from looks and from touch, and the ways over it.

No map is given and no depth is read. A look shows which pixels are floor. A pixel of the floor lies where its ray meets
the floor's plane, so it tells that this place is free. Where the floor ends, something stands: its *contact*. What is
hidden behind it stays unknown until it is seen from elsewhere. Things that hang over the floor (a table's top) have no
contact; the body learns of them by touch. Ways may lead over what is unknown, dearer, and hardly through what stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from eagor.grids import ErpGrid

CELL = 0.15  # metres
FARTHEST = 6.0  # metres: beyond, a row of pixels covers more floor than a body
THICK = 0.3  # metres behind its contact that a thing reaches at least
MARGIN = 1.5  # metres of unknown ground around all that is known
BLOCK = 12  # cells by which the grid grows
UNKNOWN, FLOOR, CONTACT = range(3)
# What a metre costs on what is unknown, on the floor, and where something stands, in metres of floor: a contact may be
# seen a cell off, so it is no wall.
COSTS = np.array([2.0, 1.0, 15.0])
HELD = 20.0  # ... and more for each time that the body was held up there
STOOD = 1.0  # ... and for each time that it stood there: a way that led to and fro is not the way (Korf, 1990)
TIGHT, CLOSE = 4.0, 1.5  # ... times more within the body's radius of what stands, and within `SPARE` metres more
SPARE = 0.15
BESIDE = 1.2  # metres from a thing: close enough to have come to it
NEAR = 0.5  # metres between two places that are one
LOOK = 1.5  # metres: longest straight stretch of a way


@dataclass
class FloorMap:
    """A growing grid of square cells: `state` ``(rows, cols)``, x along columns, low corner at `origin` ``(2,)``.

    `nearest` ``(rows, cols)``: metres from which a cell was seen best. `worth` ``(rows, cols)``: probability that all
    looks so far would have missed a thing that stands there. `looked` ``(rows, cols)``: how well they saw it, from 0 to
    1, as far as the next look repeats their mistakes. `held` ``(rows, cols)``: how often the body was held up on
    its way there. `stood` ``(rows, cols)``: how often it stood there.
    """

    origin: np.ndarray = field(default_factory=lambda: np.zeros(2))
    state: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int8))
    nearest: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    worth: np.ndarray = field(default_factory=lambda: np.ones((0, 0)))
    looked: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    held: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int32))
    stood: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int32))

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Rows and columns ``(..., 2)`` of points ``(..., 2)``."""
        return np.floor((np.asarray(points) - self.origin) / CELL).astype(np.intp)[..., ::-1]

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """The middles ``(..., 2)`` of cells ``(..., 2)``."""
        return self.origin + (np.asarray(cells)[..., ::-1] + 0.5) * CELL

    def inside(self, cells: np.ndarray) -> np.ndarray:
        """Which cells ``(..., 2)`` lie on the grid."""
        return np.all((cells >= 0) & (cells < self.state.shape), axis=-1)

    def cover(self, low: np.ndarray, high: np.ndarray) -> None:
        """Grow the grid to these corners ``(2,)``."""
        first = np.floor(low / CELL / BLOCK).astype(int) * BLOCK
        last = np.ceil(high / CELL / BLOCK).astype(int) * BLOCK
        begin = np.round(self.origin / CELL).astype(int)
        end = begin + self.state.shape[::-1]
        if self.state.size:
            first, last = np.minimum(first, begin), np.maximum(last, end)
            if (first == begin).all() and (last == end).all():
                return
        else:
            begin = end = first
        pads = [(begin[axis] - first[axis], last[axis] - end[axis]) for axis in (1, 0)]
        self.state = np.pad(self.state, pads)
        self.nearest = np.pad(self.nearest, pads, constant_values=math.inf)
        self.worth = np.pad(self.worth, pads, constant_values=1.0)
        self.looked = np.pad(self.looked, pads)
        self.held = np.pad(self.held, pads)
        self.stood = np.pad(self.stood, pads)
        self.origin = first * CELL

    def look(
        self, floor: np.ndarray, world_R_body: np.ndarray, position: np.ndarray, seen: np.ndarray | None = None
    ) -> None:
        """Take in a look from `position` ``(3,)``, metres above the floor's plane z = 0.

        `floor` ``(H, W)`` bool: which pixels of an equirectangular picture show the floor. `seen` ``(H, W)`` bool:
        which of them the camera shows at all; None: all.
        """
        here, height = position[:2], position[2]
        reach = _reach(floor, height)
        places = self.centres(self._around(here, reach))
        away = places - here
        metres = np.hypot(*away.T)
        near = (metres < min(reach, FARTHEST)) & (metres > 0.05)
        places, away, metres = places[near], away[near], metres[near]
        row = math.pi / len(floor)
        # A thing stands where the floor has just ended: nearer by this much (at least a row of pixels) there is floor.
        back = np.maximum(THICK, 1.2 * row * (height + metres**2 / height))
        is_floor = _shows(floor, world_R_body, away, height)
        before = away * np.maximum(1 - back / metres, 0.0)[:, None]
        contact = ~is_floor & _shows(floor, world_R_body, before, height)
        if seen is not None:
            contact &= _shows(seen, world_R_body, away, height)
        shown = np.concatenate([places[is_floor | contact], here[None]])
        self.cover(shown.min(axis=0) - MARGIN, shown.max(axis=0) + MARGIN)
        for which, state in ((is_floor, FLOOR), (contact, CONTACT)):
            rows, cols = self.cells(places[which]).T
            better = metres[which] <= self.nearest[rows, cols] + 0.2
            rows, cols = rows[better], cols[better]
            self.state[rows, cols] = state
            self.nearest[rows, cols] = np.minimum(self.nearest[rows, cols], metres[which][better])

    def _around(self, here: np.ndarray, reach: float) -> np.ndarray:
        """The cells ``(n, 2)`` about a place, also those off the grid."""
        low, high = self.cells(here - reach), self.cells(here + reach) + 1
        rows, cols = np.arange(low[0], high[0]), np.arange(low[1], high[1])
        return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)

    def walked(self, here: np.ndarray, radius: float) -> None:
        """A body of this radius stands here: nothing else does."""
        self.cover(here - radius, here + radius)
        cells = self._around(here, radius)
        rows, cols = cells[np.hypot(*(self.centres(cells) - here).T) <= radius].T
        self.stood[rows, cols] += 1
        self.state[rows, cols], self.nearest[rows, cols] = FLOOR, 0.0
        row, col = self.cells(here)
        self.state[row, col], self.nearest[row, col], self.held[row, col] = FLOOR, 0.0, 0

    def held_up(self, points: np.ndarray) -> None:
        """The body was held up on its way to `points` ``(n, 2)``."""
        cells = np.unique(self.cells(points), axis=0)
        rows, cols = cells[self.inside(cells)].T
        self.held[rows, cols] += 1


def _reach(floor: np.ndarray, height: float) -> float:
    """Metres to the farthest floor that a look from this height shows, and a little more; `FARTHEST` at most."""
    rows = np.flatnonzero(floor.any(axis=1))
    if not len(rows):
        return 1.0
    depression = (rows[0] + 0.5) / floor.shape[0] * math.pi - math.pi / 2
    far = height / math.tan(depression) if depression > 0.02 else FARTHEST
    return min(max(far + THICK, 1.0), FARTHEST)


def _shows(floor: np.ndarray, world_R_body: np.ndarray, away: np.ndarray, height: float) -> np.ndarray:
    """Whether the pixels of points ``(n, 2)`` of the floor's plane, from below the camera, show the floor."""
    rays = np.column_stack([away, np.full(len(away), -height)]) @ world_R_body
    grid = ErpGrid(*floor.shape)
    x, y, _ = grid.project(rays)
    return floor[np.minimum(y.astype(np.intp), grid.height - 1), x.astype(np.intp) % grid.width]


@dataclass(frozen=True, eq=False)
class Ways:
    """The cheapest ways from `here` ``(2,)`` to all cells.

    `costs` ``(rows, cols)`` of a metre in each cell; `metres` ``(rows, cols)``: cost of the way there; `before`: the
    cell before each on its way (flat, negative at the start).
    """

    known: FloorMap
    here: np.ndarray
    costs: np.ndarray
    metres: np.ndarray
    before: np.ndarray

    @classmethod
    def over(cls, known: FloorMap, radius: float, here: np.ndarray) -> Ways:
        """The ways of a body of this radius (metres)."""
        stands = known.state == CONTACT
        away = np.asarray(ndimage.distance_transform_edt(~stands)) * CELL
        costs = COSTS[known.state]
        costs[~stands & (away < radius + SPARE)] *= CLOSE
        costs[~stands & (away < radius)] *= TIGHT
        costs += HELD * known.held + STOOD * known.stood
        row, col = known.cells(here)
        one, other, lengths, order = _lattice(costs.shape)
        flat = costs.reshape(-1)
        graph = csr_array(((flat[one] + flat[other]) * lengths, other, order), shape=(flat.size, flat.size))
        start = int(row) * costs.shape[1] + int(col)
        metres, before = dijkstra(graph, indices=start, return_predecessors=True)
        return cls(known, here, costs, metres.reshape(costs.shape), before)

    def nearest(self, goal: np.ndarray, but: Sequence[np.ndarray] = ()) -> tuple[int, int] | None:
        """The cell to go to for a goal ``(2,)`` in which something may stand.

        If the body has been at places `but` ``(2,)`` for it: another one beside it, None if there is none.
        """
        cells = np.moveaxis(np.indices(self.metres.shape), 0, -1)
        places = self.known.centres(cells)
        away = np.hypot(*np.moveaxis(places - goal, -1, 0))
        cost = 3 * away + 0.2 * self.metres
        if len(but):
            cost[away > BESIDE] = math.inf
        for place in but:
            cost[np.hypot(*np.moveaxis(places - place, -1, 0)) < NEAR] = math.inf
        best = int(cost.argmin())
        return divmod(best, self.metres.shape[1]) if math.isfinite(cost.flat[best]) else None

    def first(self, end: tuple[int, int]) -> np.ndarray:
        """The direction ``(2,)``, of any length, in which the way to a cell begins: to its farthest point in a line."""
        width = self.metres.shape[1]
        path = [end[0] * width + end[1]]
        while self.before[path[-1]] >= 0:
            path.append(int(self.before[path[-1]]))
        path = path[::-1]
        points = self.known.centres(np.stack(np.divmod(path, width), axis=-1))
        target = points[min(1, len(points) - 1)]
        for flat, point in zip(path[1:], points[1:], strict=True):
            if float(np.hypot(*(point - self.here))) > LOOK:
                break
            if self._line(point) > 1.05 * float(self.metres.flat[flat]) + 0.1:
                break
            target = point
        found = target - self.here
        return found if np.hypot(*found) > 1e-6 else np.array([1.0, 0.0])

    def _line(self, there: np.ndarray) -> float:
        """The cost of the straight line to a point."""
        length = float(np.hypot(*(there - self.here)))
        at = np.linspace(0, 1, max(2, math.ceil(length / CELL * 2)))[:, None]
        cells = self.known.cells(self.here + at * (there - self.here))
        return float(self.costs[cells[:, 0], cells[:, 1]].mean()) * length


@lru_cache(maxsize=8)
def _lattice(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The edges of a grid of cells, sorted by their first: both ends, half their lengths (metres), and row pointers."""
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    padded = np.pad(index, 1, constant_values=-1)
    around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    ends = np.stack([padded[1 + i : 1 + i + shape[0], 1 + j : 1 + j + shape[1]] for i, j in around], axis=-1)
    lengths = np.broadcast_to([math.hypot(i, j) * CELL / 2 for i, j in around], ends.shape)
    there = ends.reshape(-1) >= 0
    first = np.repeat(index.reshape(-1), len(around))[there]
    order = np.concatenate([[0], np.cumsum((ends >= 0).sum(axis=-1).reshape(-1))])
    narrow = np.int32  # what scipy searches; it would convert others every time
    return first, ends.reshape(-1)[there].astype(narrow), lengths.reshape(-1)[there], order.astype(narrow)
