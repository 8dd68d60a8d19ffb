"""What a searching body knows of the ground, and what a look is expected to tell about where a thing is.

The thing is in one of many patches of the ground, a `FloorMap` with `Ways` over it. A look is worth taking for what it
shows: patches that no look has shown, and patches that were looked at but where the perception may have missed the
thing. A search takes the look that tells most for what it costs (`eagor.lab.agents.steering`).

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
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from eagor.evidence import Evidence
from eagor.evidence.detector import Habits
from eagor.grids import ErpGrid
from eagor.sphere import azimuth_elevation, heading
from eagor.tracking.next_view import information

if TYPE_CHECKING:
    from eagor.lab.agents.methods import Estimator

CELL = 0.15  # metres
FARTHEST = 6.0  # metres: beyond, a row of pixels covers more floor than a body
THICK = 0.3  # metres behind its contact that a thing reaches at least
MARGIN = 1.5  # metres of unknown ground around all that is known
BLOCK = 12  # cells by which the grid grows
UNKNOWN, FLOOR, CONTACT = range(3)
# What a metre costs on what is unknown, on the floor, and where something stands, in metres of floor: a contact may be
# seen a cell off, so it is no wall.
COSTS = np.array([2.0, 1.0, 15.0])
BLOCKED = 20.0  # ... and more for each time that the body was blocked there
VISITED = 1.0  # ... and for each time that it stood there: a way that led to and fro is not the way (Korf, 1990)
TIGHT, CLOSE = 4.0, 1.5  # ... times more within the body's radius of what stands, and within `SPARE` metres more
SPARE = 0.15
BESIDE = 1.2  # metres from a thing: close enough to have come to it
NEAR = 0.5  # metres between two places that are one
LOOK = 1.5  # metres: longest straight stretch of a way

LEAST = 0.05  # recall: nobody looks with what finds less, whatever its calibration says
RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 7 * RAYS  # rays about the body itself, the others among them: what they reach has been looked at
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
TOUCH = 0.07  # a step that falls short by more than this share collided


@dataclass(frozen=True)
class Chance:
    """What chance a look has to find what is in sight.

    `recall`: the probability that it reports it. `repeats`: the share of the mistakes of the look before, taken
    `elapsed` seconds earlier, that it repeats. `habits`: of the detector, which fade; None: nothing fades.
    """

    recall: float = 0.5
    repeats: float = 0.0
    habits: Habits | None = None
    elapsed: float = 0.0

    @classmethod
    def of(cls, evidence: Evidence, elapsed: float) -> Chance:
        """As the evidence itself has it, but `LEAST` at least.

        A detector's model states the recall. Of a response, 1 - recall is the likelihood ratio of silence.
        """
        if evidence.detections is not None:
            habits = evidence.detections.model.habits
            return cls(max(habits.mean, LEAST), habits.correlation, habits, elapsed)
        logs = np.asarray(evidence.log_ratio, dtype=np.float64)
        logs = logs if evidence.coverage is None else logs[evidence.coverage > 0.5]
        recall = -float(np.expm1(np.median(logs))) if logs.size else 0.0
        return cls(max(recall, LEAST), evidence.calibration.persistence, None, elapsed)

    def left(self, moved: float) -> float:
        """The share of the habits of places that is still the same `moved` metres after the look before."""
        return 1.0 if self.habits is None else 1 - self.habits.renewal_probability(self.elapsed, moved)


@dataclass(eq=False)
class SteeringInput:
    """What is known at a step.

    - `azimuth` of the estimate, radians, body frame; `progress`: metres nearer to the thing, as believed, per metre
      walked that way, at most 1, if it is here; `presence`: probability of that; `distance` to the thing along the
      floor, metres, None if not known.
    - `position` ``(3,)``: of the camera by odometry, z in metres above the floor; `world_R_body` ``(3, 3)``.
    - `floor` ``(H, W)`` bool: which pixels of an equirectangular look show the floor; None if the policy needs none.
      `chance`: to find, of that look; None if it could not be read.
    - World frame: `here` ``(2,)`` and `yaw` of the body; `ahead`: the unit vector ``(2,)`` towards the estimate.
    """

    azimuth: float
    progress: float
    presence: float
    distance: float | None
    position: np.ndarray
    world_R_body: np.ndarray
    floor: np.ndarray | None = None
    chance: Chance | None = field(default_factory=Chance)

    def __post_init__(self) -> None:
        self.here, self.yaw = np.array(self.position[:2], dtype=np.float64), heading(self.world_R_body)
        self.ahead = np.array([math.cos(self.azimuth + self.yaw), math.sin(self.azimuth + self.yaw)])

    @classmethod
    def of(
        cls, method: Estimator, direction: np.ndarray, position: np.ndarray, world_R_body: np.ndarray,
        floor: np.ndarray | None, look: Evidence | None, elapsed: float,
    ) -> SteeringInput:  # fmt: skip
        """What a `method` that said `direction` ``(3,)`` believes; its `look` is `elapsed` seconds after the last."""
        progress, presence, distance = method.belief()
        distance = None if distance is None else distance * math.hypot(float(direction[0]), float(direction[1]))
        azimuth, chance = float(azimuth_elevation(direction)[0]), None if look is None else Chance.of(look, elapsed)
        return cls(azimuth, progress, presence, distance, position, world_R_body, floor, chance)


# --- the floor -------------------------------------------------------------------------------------------------------


class FloorMap:
    """What a body of this `radius` (metres) knows of the ground: a growing grid of square cells.

    x runs along columns, the low corner is at `origin` ``(2,)``, the body at `here` ``(2,)``. Layers ``(rows, cols)``:

    - `state`: unknown, floor or contact. `nearest`: metres from which a cell was seen best.
    - `miss_cost`: probability that all looks so far would have missed a thing that stands there. `coverage`: how well
      they saw it, from 0 to 1, as far as the next look repeats their mistakes.
    - `blocked_count`: how often the body was blocked on its way there. `visit_count`: how often it stood there.
    """

    def __init__(self, radius: float = 0.0) -> None:
        self.radius, self.origin, self.here = radius, np.zeros(2), np.zeros(2)
        self._chance = Chance()
        self._from: np.ndarray | None = None  # where the last look was taken that could be read
        self.state = np.zeros((0, 0), dtype=np.int8)
        self.nearest, self.miss_cost, self.coverage, self.visit_count = (np.zeros((0, 0)) for _ in range(4))
        self.blocked_count = np.zeros((0, 0), dtype=np.int32)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Rows and columns ``(..., 2)`` of points ``(..., 2)``."""
        return np.floor((np.asarray(points) - self.origin) / CELL).astype(np.intp)[..., ::-1]

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """The middles ``(..., 2)`` of cells ``(..., 2)``."""
        return self.origin + (np.asarray(cells)[..., ::-1] + 0.5) * CELL

    def inside(self, cells: np.ndarray) -> np.ndarray:
        """Which cells ``(..., 2)`` lie on the grid."""
        return np.all((cells >= 0) & (cells < self.state.shape), axis=-1)

    def states(self, points: np.ndarray) -> np.ndarray:
        """The state ``(n,)`` of points ``(n, 2)``, also of those off the grid."""
        cells = self.cells(points)
        inside = self.inside(cells)
        found = np.full(len(cells), UNKNOWN)
        found[inside] = self.state[tuple(cells[inside].T)]
        return found

    def cover(self, low: np.ndarray, high: np.ndarray) -> None:
        """Grow the grid to these corners ``(2,)``."""
        first = np.floor(low / CELL / BLOCK).astype(int) * BLOCK
        last = np.ceil(high / CELL / BLOCK).astype(int) * BLOCK
        begin = np.round(self.origin / CELL).astype(int) if self.state.size else first
        end = begin + self.state.shape[::-1]
        if self.state.size:
            first, last = np.minimum(first, begin), np.maximum(last, end)
        pads = [(begin[axis] - first[axis], last[axis] - end[axis]) for axis in (1, 0)]
        beyond = {"nearest": math.inf, "miss_cost": 1.0}
        for name in ("state", "nearest", "miss_cost", "coverage", "blocked_count", "visit_count"):
            setattr(self, name, np.pad(getattr(self, name), pads, constant_values=beyond.get(name, 0)))
        self.origin = first * CELL

    def observe(self, now: SteeringInput) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing."""
        here, height, floor = now.here, float(now.position[2]), now.floor
        assert floor is not None
        # Nothing is told of what is farther than the highest pixel of the floor, and a little more.
        row, shown = math.pi / len(floor), np.flatnonzero(floor.any(axis=1))
        depression = (shown[0] + 0.5) * row - math.pi / 2 if len(shown) else math.pi / 2
        reach = min(max(height / math.tan(max(depression, 1e-9)) + THICK, 1.0), FARTHEST)
        places = self.centres(self._around(here, reach))
        away = places - here
        metres = np.hypot(*away.T)
        near = (metres < reach) & (metres > 0.05)
        places, away, metres = places[near], away[near], metres[near]
        # A thing stands where the floor has just ended: nearer by this much (at least a row of pixels) there is floor.
        back = np.maximum(THICK, 1.2 * row * (height + metres**2 / height))
        is_floor = _shows(floor, now.world_R_body, away, height)
        before = away * np.maximum(1 - back / metres, 0.0)[:, None]
        contact = ~is_floor & _shows(floor, now.world_R_body, before, height)
        shown = np.concatenate([places[is_floor | contact], here[None]])
        self.cover(shown.min(axis=0) - MARGIN, shown.max(axis=0) + MARGIN)
        for which, state in ((is_floor, FLOOR), (contact, CONTACT)):
            rows, cols = self.cells(places[which]).T
            better = metres[which] <= self.nearest[rows, cols] + 0.2
            rows, cols = rows[better], cols[better]
            self.state[rows, cols] = state
            self.nearest[rows, cols] = np.minimum(self.nearest[rows, cols], metres[which][better])
        # The body stands here: nothing else does.
        self.cover(here - self.radius, here + self.radius)
        cells = self._around(here, self.radius)
        rows, cols = cells[np.hypot(*(self.centres(cells) - here).T) <= self.radius].T
        self.visit_count[rows, cols] += 1
        self.state[rows, cols], self.nearest[rows, cols] = FLOOR, 0.0
        row, col = self.cells(here)
        self.state[row, col], self.nearest[row, col], self.blocked_count[row, col] = FLOOR, 0.0, 0
        self.here = here
        if now.chance is not None:
            moved = 0.0 if self._from is None else float(np.hypot(*(here - self._from)))
            self._chance, self._from = now.chance, here
            self.coverage *= now.chance.left(moved)
            self.mark_scanned(here)

    def _around(self, here: np.ndarray, reach: float) -> np.ndarray:
        """The cells ``(n, 2)`` about a place, also those off the grid."""
        low, high = self.cells(here - reach), self.cells(here + reach) + 1
        return low + np.indices(tuple(high - low)).reshape(2, -1).T

    def touch(self, before: np.ndarray, intended: np.ndarray, here: np.ndarray, wide: float) -> bool:
        """Learn from a step `intended` ``(2,)`` from `before` to `here`: something stands where the body was blocked.

        `wide`: half of the width of what stands there. Whether it was blocked.
        """
        lost, step = intended - (here - before), float(np.hypot(*intended))
        size = float(np.hypot(*lost))
        if size <= TOUCH * step or float(lost @ intended) <= 0:
            return False
        normal = lost / size
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * step * normal
        aside = np.linspace(-wide, wide, 2 * round(wide / CELL) + 1)[None, :, None] * along
        cells = np.unique(self.cells((here + ahead + aside).reshape(-1, 2)), axis=0)
        rows, cols = cells[self.inside(cells) & np.any(cells != self.cells(here), axis=1)].T
        self.blocked_count[rows, cols] += 1
        return True

    def mark_scanned(self, place: np.ndarray) -> None:
        """What can be seen from a place ``(2,)`` has had its chance."""
        index, reached = self._reached(self.cells(place)[None], FINE)
        seen = np.pad(np.zeros(self.state.shape), PAD)
        np.maximum.at(seen.reshape(-1), index.reshape(-1), reached.reshape(-1))
        seen = seen[PAD:-PAD, PAD:-PAD]
        self.miss_cost *= 1 - self._finds() * seen
        np.maximum(self.coverage, seen, out=self.coverage)

    def tells(self, cells: np.ndarray) -> np.ndarray:
        """What looks from cells ``(m, 2)`` are expected to tell ``(m,)`` about where the thing is, nats."""
        index, reached = self._reached(cells, RAYS)
        miss_cost, count = self.miss_cost, len(cells)
        here = np.pad(miss_cost, PAD, constant_values=1.0).take(index) * (_rays(RAYS)[1] / (miss_cost.sum() * CELL**2))
        share = np.pad(self._finds(), PAD, constant_values=self._chance.recall).take(index) * reached
        return information(here.reshape(count, -1), share.reshape(count, -1))

    def sight(self, there: np.ndarray) -> float:
        """The probability that nothing hides a place ``(2,)`` from here, by the floor that is known."""
        away = float(np.hypot(*(there - self.here)))
        at = np.arange(CELL, max(away - THICK, 0.0), CELL)[:, None] / max(away, CELL)
        return float(np.exp(-VEIL[self.states(self.here + at * (there - self.here))].sum()))

    def _finds(self) -> np.ndarray:
        """The probability ``(rows, cols)`` that a look finds a thing in full sight, after those that missed it."""
        return 1 - (1 - self._chance.recall) ** (1 - self._chance.repeats * self.coverage)

    def _reached(self, cells: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Padded cells (flat) along rays from cells ``(n, 2)``, and the sight that is left, both ``(n, count, k)``."""
        veil = VEIL[np.pad(self.state, PAD)]
        flat = np.array([veil.shape[1], 1])
        index = ((cells + PAD) @ flat)[:, None, None] + _rays(count)[0] @ flat
        dimmed = veil.take(index)
        return index, np.exp(dimmed - np.cumsum(dimmed, axis=2))


def _shows(floor: np.ndarray, world_R_body: np.ndarray, away: np.ndarray, height: float) -> np.ndarray:
    """Whether the pixels of points ``(n, 2)`` of the floor's plane, from below the camera, show the floor."""
    rays = np.column_stack([away, np.full(len(away), -height)]) @ world_R_body
    grid = ErpGrid(*floor.shape)
    x, y, _ = grid.project(rays)
    return floor[np.minimum(y.astype(np.intp), grid.height - 1), x.astype(np.intp) % grid.width]


class Ways:
    """The cheapest ways of the body from `here` ``(2,)`` to all cells.

    `costs` ``(rows, cols)`` of a metre in each cell; `metres` ``(rows, cols)``: cost of the way there.
    """

    def __init__(self, known: FloorMap, here: np.ndarray) -> None:
        self.known, self.here = known, here
        stands = known.state == CONTACT
        away = np.asarray(ndimage.distance_transform_edt(~stands)) * CELL
        costs = COSTS[known.state]
        costs[~stands & (away < known.radius + SPARE)] *= CLOSE
        costs[~stands & (away < known.radius)] *= TIGHT
        costs += BLOCKED * known.blocked_count + VISITED * known.visit_count
        flat, (one, other, lengths) = costs.reshape(-1), _lattice(costs.shape)
        graph = csr_array(((flat[one] + flat[other]) * lengths, (one, other)), shape=(flat.size, flat.size))
        start = np.ravel_multi_index(tuple(known.cells(here)), costs.shape)
        metres, self._before = dijkstra(graph, indices=start, return_predecessors=True)
        self.costs, self.metres = costs, metres.reshape(costs.shape)

    def nearest(self, goal: np.ndarray, but: Sequence[np.ndarray] = ()) -> tuple[int, int] | None:
        """The cell to go to for a goal ``(2,)``, not near places `but` where the body was for it; None if all are."""
        places = self.known.centres(np.moveaxis(np.indices(self.metres.shape), 0, -1))
        away = np.hypot(*np.moveaxis(places - goal, -1, 0))
        cost = 3 * away + 0.2 * self.metres
        if len(but):
            cost[away > BESIDE] = math.inf
        for place in but:
            cost[np.hypot(*np.moveaxis(places - place, -1, 0)) < NEAR] = math.inf
        best = int(cost.argmin())
        return divmod(best, self.metres.shape[1]) if math.isfinite(cost.flat[best]) else None

    def first(self, end: Sequence[int] | np.ndarray) -> np.ndarray:
        """The direction ``(2,)``, of any length, in which the way to a cell begins: to its farthest point in a line."""
        width = self.metres.shape[1]
        path = [int(end[0] * width + end[1])]
        while self._before[path[-1]] >= 0:
            path.append(int(self._before[path[-1]]))
        path.reverse()
        points = self.known.centres(np.stack(np.divmod(path, width), axis=-1))
        target = points[min(1, len(points) - 1)]
        for flat, point in zip(path[1:], points[1:], strict=True):
            away = point - self.here
            length = float(np.hypot(*away))
            at = np.linspace(0, 1, max(2, math.ceil(length / CELL * 2)))[:, None]
            rows, cols = self.known.cells(self.here + at * away).T
            line = float(self.costs[rows, cols].mean()) * length
            if length > LOOK or line > 1.05 * float(self.metres.flat[flat]) + 0.1:
                break
            target = point
        found = target - self.here
        return found if np.hypot(*found) > 1e-6 else np.array([1.0, 0.0])


@lru_cache(maxsize=8)
def _lattice(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges of a grid of cells: both ends (flat), and half their lengths (metres)."""
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])
    ends = np.indices(shape).reshape(2, -1).T[:, None] + steps
    inside = np.all((ends >= 0) & (ends < shape), axis=-1)
    lengths = np.broadcast_to(np.hypot(*steps.T) * CELL / 2, inside.shape)
    return np.nonzero(inside)[0], (ends @ [shape[1], 1])[inside], lengths[inside]


@lru_cache(maxsize=2)
def _rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets ``(count, n, 2)`` of the cells along rays, and the square metres ``(n,)`` for which each stands."""
    metres = (np.arange(int(SIGHT / CELL)) + 0.5) * CELL
    angles = (np.arange(count) + 0.5) * 2 * math.pi / count
    offsets = np.stack([np.sin(angles)[:, None] * metres, np.cos(angles)[:, None] * metres], axis=-1)
    return np.round(offsets / CELL).astype(np.intp), 2 * math.pi / count * metres * CELL
