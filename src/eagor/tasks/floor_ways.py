"""Ways over the floor that is known: what is not known may be passed, dearer; what stands there hardly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from eagor.tasks.floor_seen import CELL, CONTACT, FloorSeen

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


@dataclass(frozen=True, eq=False)
class Ways:
    """The cheapest ways from `here` ``(2,)`` to all cells.

    `costs` ``(rows, cols)`` of a metre in each cell; `metres` ``(rows, cols)``: cost of the way there; `before`: the
    cell before each on its way (flat, negative at the start).
    """

    known: FloorSeen
    here: np.ndarray
    costs: np.ndarray
    metres: np.ndarray
    before: np.ndarray

    @classmethod
    def over(cls, known: FloorSeen, radius: float, here: np.ndarray) -> Ways:
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
