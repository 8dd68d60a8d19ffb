"""From an estimate to a step: straight at it, and around obstacles by touch alone.

The published policy goes a fixed step along the estimate. With `detour` the body remembers where it collided and plans
around these places as if all else were free (free-space assumption; Koenig, Tovey and Smirnov, 2003).
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field

import numpy as np

from eagor.tasks.search_space import SteeringInput

SPACING = 0.15  # metres between the nodes of the planning lattice
TOUCH = 0.07  # a step that falls short by more than this share collided
STANDOFF, HALF = 0.1, 0.3  # metres from the colliding body to the noted wall, and half of the wall's length
WALL, HIGHEST = 5.0, 20.0  # metres that one collision adds to an edge, and that all of them add at most
VISIT, AROUND = 0.2, 2  # metres that planning at a node adds to paths through it and this many nodes around
KEPT = 0.9  # share of that after the next plan
RANGE = 5.0  # metres along the estimate to the assumed goal: the target's true range is unknown
LOOK, WINDOW = 1.5, 10.0  # metres: longest straight stretch of a path, and farthest that paths stray from the body
_NEIGHBOURS = [(i, j, math.hypot(i, j) * SPACING) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
_EDGES = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  # every edge of the lattice once, from one of its ends

Node = tuple[int, int]


@dataclass
class Policy:
    """Walks along the estimate, whatever it is worth, for one episode.

    `step` in metres; `detour`: whether to find ways around obstacles. It never searches, and reads no floor.
    """

    step: float
    detour: bool = True
    searching: bool = False
    looks_down: bool = False
    # The plan's frame has its origin where the episode began, and its x axis along the body's heading there.
    _start: tuple[np.ndarray, float] | None = None
    _last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step
    _walls: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))  # both ends of each noted wall
    _extra: dict[tuple[Node, Node], float] = field(default_factory=dict)  # metres that walls add to edges
    _visits: dict[Node, float] = field(default_factory=dict)

    def walk(self, now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        return self.heading(now.azimuth, now.position[:2], now.yaw), self.step

    def heading(self, azimuth: float, xy: np.ndarray, yaw: float) -> float:
        """The heading to walk in, radians from straight ahead, in (-pi, pi]; without `detour` just the azimuth.

        `azimuth` of the estimate, radians, body frame; `xy` ``(2,)`` and `yaw`: the odometry's pose.
        """
        if not self.detour:
            return azimuth
        if self._start is None:
            self._start = np.array(xy, dtype=np.float64), yaw
        begin, turn = self._start
        cos, sin = math.cos(turn), math.sin(turn)
        # Rounded to the micron, so that rounding errors of the frame do not decide between equal paths.
        here = np.round(np.array([[cos, sin], [-sin, cos]]) @ (np.asarray(xy, dtype=np.float64) - begin), 6)
        bearing = round(math.remainder(azimuth + yaw - turn, 2 * math.pi), 6)
        if self._last is not None:
            self._feel(*self._last, here)
        ahead = np.array([math.cos(bearing), math.sin(bearing)])
        way = self._way(here, here + RANGE * ahead)
        self._last = here, way * (self.step / np.hypot(*way))
        heading = math.remainder(math.atan2(way[1], way[0]) + turn - yaw, 2 * math.pi)
        return heading if heading > -math.pi else math.pi

    def _feel(self, before: np.ndarray, meant: np.ndarray, here: np.ndarray) -> None:
        """Learn from a step: a wall where the body was held up, no wall where it passed."""
        moved = here - before
        crossed = _cross(before, here, self._walls[:, 0], self._walls[:, 1])
        if crossed.any():
            self._walls, self._extra = self._walls[~crossed], {}
            for wall in self._walls:
                self._note(wall)
        lost = held_back(before, meant, here, self.step)
        if lost is None:
            return
        size, into = float(np.hypot(*lost)), float(lost @ meant)
        # The body goes straight, then slides along the wall, which removes the component of each step normal to it.
        normal, slid = lost / size, min(size * size / into, 1.0)
        along = np.array([-normal[1], normal[0]])
        first = here - (moved - (1 - slid) * meant)
        if (here - first) @ along < 0:
            along = -along
        wall = np.array([first - HALF * along, here + HALF * along]) + STANDOFF * normal
        self._walls = np.concatenate([self._walls, wall[None]])
        self._note(wall)

    def _note(self, wall: np.ndarray) -> None:
        """Lengthen the edges of the lattice that cross a wall ``(2, 2)``."""
        low, high = np.floor(wall.min(axis=0) / SPACING) - 1, np.ceil(wall.max(axis=0) / SPACING) + 1
        cols, rows = (np.arange(a, b + 1, dtype=int) for a, b in zip(low, high, strict=True))
        ends = np.stack(np.meshgrid(cols, rows, indexing="ij"), axis=-1).reshape(-1, 1, 2) + np.zeros_like(_EDGES)
        hit = _cross(ends * SPACING, (ends + _EDGES) * SPACING, wall[0], wall[1])
        for (a, b), (c, d) in zip(ends[hit].tolist(), (ends + _EDGES)[hit].tolist(), strict=True):
            longer = min(self._extra.get(((a, b), (c, d)), 0.0) + WALL, HIGHEST)
            self._extra[(a, b), (c, d)] = self._extra[(c, d), (a, b)] = longer

    def _in_the_way(self, here: np.ndarray, there: np.ndarray) -> int:
        """The number of walls between two points."""
        return int(_cross(here, there, self._walls[:, 0], self._walls[:, 1]).sum())

    def _step_costs(self, here: np.ndarray, there: np.ndarray) -> float:
        """The cost of walls on the line to a point, extended to a whole step: steps cannot be shortened."""
        share = max(1.0, self.step / float(np.hypot(*(there - here))))
        return WALL * self._in_the_way(here, here + share * (there - here))

    def _way(self, here: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """The direction ``(2,)`` (of any length) in which the cheapest path to the goal begins."""
        if not self._in_the_way(here, goal):
            return goal - here
        target = None
        for node in self._plan(here, goal):
            point = np.array(node) * SPACING
            seen = np.hypot(*(point - here)) < LOOK and not self._step_costs(here, point)
            if target is not None and not seen:
                break
            target = point
        return target - here if target is not None else goal - here

    def _plan(self, here: np.ndarray, goal: np.ndarray) -> list[Node]:
        """The cheapest path over the lattice (A*), from about a step away from the body to the goal."""
        end, (x, y) = _node(goal), _node(here)
        reach = max(self.step, SPACING / 0.6)
        # Visited places cost more for a while, not for good: the body's own trail would wall it in.
        self._visits = {node: KEPT * metres for node, metres in self._visits.items() if metres > 0.01}
        for node in ((x + i, y + j) for i in range(-AROUND, AROUND + 1) for j in range(-AROUND, AROUND + 1)):
            self._visits[node] = self._visits.get(node, 0.0) + VISIT
        near = range(-math.ceil(1.3 * reach / SPACING) - 1, math.ceil(1.3 * reach / SPACING) + 2)
        costs: dict[Node, float] = {}
        for node in ((x + i, y + j) for i in near for j in near):
            point = np.array(node) * SPACING
            away = float(np.hypot(*(point - here)))
            if 0.4 * reach < away <= 1.3 * reach:
                costs[node] = away + self._step_costs(here, point) + self._visits.get(node, 0.0)
        least = min(costs.values())  # subtracted, as otherwise a walled-in body would search everywhere
        costs = {node: cost - least for node, cost in costs.items()}
        came: dict[Node, Node] = {}
        heap, done = [(cost + _octile(node, end), node) for node, cost in costs.items()], set()
        heapq.heapify(heap)
        while heap and end not in done:
            node = heapq.heappop(heap)[1]
            if node in done:
                continue
            done.add(node)
            for i, j, length in _NEIGHBOURS:
                other = node[0] + i, node[1] + j
                if other in done or max(abs(other[0] - x), abs(other[1] - y)) * SPACING > WINDOW:
                    continue
                cost = costs[node] + length + self._extra.get((node, other), 0.0) + self._visits.get(other, 0.0)
                if cost < costs.get(other, math.inf):
                    costs[other], came[other] = cost, node
                    heapq.heappush(heap, (cost + _octile(other, end), other))
        way = [end]
        while way[-1] in came:
            way.append(came[way[-1]])
        return way[::-1]


def held_back(before: np.ndarray, meant: np.ndarray, here: np.ndarray, step: float) -> np.ndarray | None:
    """The part ``(2,)`` of the movement `meant` that a body could not make on its way to `here`; None: no collision.

    Metres; `step`: the length of a whole step.
    """
    lost = meant - (here - before)
    collided = float(np.hypot(*lost)) > TOUCH * step and float(lost @ meant) > 0
    return lost if collided else None


def _node(point: np.ndarray) -> Node:
    return round(float(point[0]) / SPACING), round(float(point[1]) / SPACING)


def _octile(one: Node, other: Node) -> float:
    """Length of the shortest path between two nodes of a free lattice."""
    a, b = abs(one[0] - other[0]), abs(one[1] - other[1])
    return SPACING * (max(a, b) + (math.sqrt(2) - 1) * min(a, b))


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether lines from a to b cross those from c to d; all ``(..., 2)``, broadcast."""

    def left(o: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        turn = (p[..., 0] - o[..., 0]) * (q[..., 1] - o[..., 1]) - (p[..., 1] - o[..., 1]) * (q[..., 0] - o[..., 0])
        return turn > 0

    return (left(a, b, c) != left(a, b, d)) & (left(c, d, a) != left(c, d, b))
