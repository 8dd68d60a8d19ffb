"""What is known of the floor: where looks have shown it, where it ends, where the body walked, and what it touched.

No map is given and no depth is read. A look shows which pixels are floor. A pixel of the floor lies where its ray meets
the floor's plane, so it tells that this place is free. Where the floor ends, something stands: its *contact*. What is
hidden behind it stays unknown until it is seen from elsewhere. Things that hang over the floor (a table's top) have no
contact; the body learns of them by touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.grids import ErpGrid

CELL = 0.15  # metres
FARTHEST = 6.0  # metres: beyond, a row of pixels covers more floor than a body
THICK = 0.3  # metres behind its contact that a thing reaches at least
MARGIN = 1.5  # metres of unknown ground around all that is known
BLOCK = 12  # cells by which the grid grows
UNKNOWN, FLOOR, CONTACT = range(3)


@dataclass
class FloorSeen:
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
