"""From what is known at a step to the step itself: along the estimate, or a search until there is one to act on.

A `Policy` goes a fixed step along the estimate, as published. With `detour` the body remembers where it collided and
plans around these places as if all else were free (free-space assumption; Koenig, Tovey and Smirnov, 2003).

A `Searcher` looks where that tells most for what it costs while nothing is believed; then it acts on the belief. One
searcher drives a camera that only turns, such as the views of H*Bench (`Searcher.face`), and a body that stands or
walks (`Searcher.walk`). The latter uses odometry, touch, and the floor that looks show; no map is given and no depth is
read. A look from another place costs the way there; the best ratio is the next goal (a frontier search; Yamauchi, 1997,
with expected information as in Bourgault et al., 2002).

The body begins to walk to the thing when that is likely to bring it nearer. It goes on although looks miss the thing,
as long as that may be hidden from here, by the floor that is known. It comes to the place from another side where it
stood beside it in vain: a wall may be between. A place around which it has tried all sides is given up. Where it was
held up too often on the way, nothing is learnt of the place: it searches for as many steps as it has tried, and then,
if the thing is still believed to be there, it tries again (`Approach`).
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from eagor.lab.agents.floor_map import BESIDE, CELL, CONTACT, FLOOR, NEAR, FloorMap, Ways
from eagor.lab.agents.search_space import SearchedGround, Space, SteeringInput, apart, turned
from eagor.lab.envs.rules import Camera
from eagor.tracking import TrackerConfig

SPACING = 0.15  # metres between the nodes of the planning lattice
TOUCH = 0.07  # a step that falls short by more than this share collided
STANDOFF, HALF = 0.1, 0.3  # metres from the colliding body to the noted wall, and half of the wall's length
WALL, HIGHEST = 5.0, 20.0  # metres that one collision adds to an edge, and that all of them add at most
VISIT, AROUND = 0.2, 2  # metres that planning at a node adds to paths through it and this many nodes around
KEPT = 0.9  # share of that after the next plan
ARRIVED = 0.8  # how sure a belief has to be to stop for it, as `handover`: a stop ends the search
RANGE = 5.0  # metres along the estimate to the assumed goal, where the distance to the target is unknown
LOOK, WINDOW = 1.5, 10.0  # metres: longest straight stretch of a path, and farthest that paths stray from the body
_NEIGHBOURS = [(i, j, math.hypot(i, j) * SPACING) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
_EDGES = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  # every edge of the lattice once, from one of its ends

Node = tuple[int, int]


@dataclass
class Policy:
    """Walks along the estimate, whatever it is worth, for one episode.

    `step` in metres; `detour`: whether to find ways around obstacles. It never searches, and reads no floor. `near`,
    `arrived`: as of a `Searcher`.
    """

    step: float
    detour: bool = True
    near: float = 0.0
    searching: bool = False
    arrived: bool = False
    looks_down: bool = False
    # The plan's frame has its origin where the episode began, and its x axis along the body's heading there.
    _start: tuple[np.ndarray, float] | None = None
    _last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step
    _walls: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))  # both ends of each noted wall
    _extra: dict[tuple[Node, Node], float] = field(default_factory=dict)  # metres that walls add to edges
    _visits: dict[Node, float] = field(default_factory=dict)

    def walk(self, now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        self.arrived = _arrived(now, self.near)
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


def _arrived(now: SteeringInput, near: float, stands: bool = False) -> bool:
    """Whether the thing is surely less than `near` metres away, as believed, or is what the body `stands` beside."""
    if not near or now.distance is None or now.progress * now.presence < ARRIVED:
        return False
    return stands or now.distance < near


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


# --- a search --------------------------------------------------------------------------------------------------------

TOUCHED = 0.1  # metres to each side of the way on which it was held up: there it would be, too
OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
PATIENCE = 30  # times that the body is held up on its way to a place before it gives it up
REACHED = 0.3  # metres from a goal
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place
NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
FACED = 1e-6  # radians
STANDING = 0.25  # metres that a standing body counts for a step of a turn
NEARER = 1e-5  # nats per degree: where every turn costs the same, the nearest of looks that tell as much
Where = TypeVar("Where", bound=Space)


@dataclass
class Approach:
    """Where the thing should be, and what became of going there. For one episode.

    `kept` ``(2,)``: the place, metres, world frame. `tried`: where the body stood beside it, and was not there. `held`:
    how often the body was held up on its way; `steps`: of the way so far. `given_up`: places ``(2,)`` where the thing
    should have been, and was not, each with the step from which it is tried again; `clock`: the steps so far. `stands`:
    whether the body stands beside the place, as near as it comes.
    """

    kept: np.ndarray | None = None
    tried: list[np.ndarray] = field(default_factory=list)
    held: int = 0
    steps: int = 0
    given_up: list[tuple[np.ndarray, float]] = field(default_factory=list)
    clock: int = 0
    stands: bool = False

    def hides(self, ground: SearchedGround, now: SteeringInput) -> bool:
        """Whether the thing, if it is where it should be, cannot be seen from here: looks that miss it say nothing."""
        if self.kept is None or not _agrees(now, self.kept):
            return False
        return ground.sight(self.kept) < OPEN_SIGHT

    def target(self, ground: SearchedGround, now: SteeringInput) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, as believed; None if the body has been there in vain.

        The way to it is kept until the belief moves away from it.
        """
        kept = self.kept if self.kept is not None and _agrees(now, self.kept) else None
        if kept is None:
            self._begin()
            kept = now.here + (now.distance if now.distance is not None else _free(ground.known, now)) * now.ahead
        if self._in_vain(kept) and now.distance is None:
            kept = now.here + RANGE * now.ahead  # not in front of the next obstacle: behind it
        self.kept = kept
        return None if self._in_vain(kept) else kept

    def beside(
        self, ground: SearchedGround, now: SteeringInput, ways: Ways, target: np.ndarray
    ) -> tuple[int, int] | None:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not known, or it is close and nothing stands between.
        """
        self.steps += 1
        self.stands = False
        end = ways.nearest(target, self.tried)
        if end is not None and float(np.hypot(*(ground.known.centres(np.array(end)) - now.here))) < REACHED:
            self.tried.append(now.here)
            close = float(np.hypot(*(target - now.here))) < BESIDE
            self.stands = now.distance is not None and close
            there = now.distance is not None and (not close or ground.sight(target) < OPEN_SIGHT)
            end = ways.nearest(target, self.tried) if there else None
        if end is None:
            self.given_up.append((target, math.inf))
        elif self.held > PATIENCE:
            self.given_up.append((target, self.clock + self.steps))
            self._begin()
            return None
        return end

    def _begin(self) -> None:
        """The way to a place begins, for the first time or anew."""
        self.tried, self.held, self.steps = [], 0, 0

    def feel(self, known: FloorMap, before: np.ndarray, meant: np.ndarray, here: np.ndarray, step: float) -> None:
        """Learn from a step of a body that meant to move by `meant` ``(2,)``: something stands where it was held up.

        All in metres, world frame; `step`: the length of a whole step.
        """
        lost = held_back(before, meant, here, step)
        if lost is None:
            return
        self.held += 1
        normal = lost / float(np.hypot(*lost))
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * step * normal
        beside = np.linspace(-TOUCHED, TOUCHED, 3)[None, :, None] * along
        points = (here + ahead + beside).reshape(-1, 2)
        known.held_up(points[np.any(known.cells(points) != known.cells(here), axis=1)])

    def _in_vain(self, place: np.ndarray) -> bool:
        return any(self.clock < until and float(np.hypot(*(place - at))) < NEAR for at, until in self.given_up)


def _agrees(now: SteeringInput, place: np.ndarray) -> bool:
    """Whether what is believed now still means this place ``(2,)``."""
    to = place - now.here
    away = float(np.hypot(*to))
    if now.distance is not None and abs(math.log(max(now.distance, 0.1) / max(away, 0.1))) > FARTHER:
        return False
    return float(to @ now.ahead) > math.cos(ALIKE) * away


def _free(known: FloorMap, now: SteeringInput) -> float:
    """Metres to where something stands first towards the estimate, as far as is known; `RANGE` if nothing does."""
    metres = np.arange(0.3, RANGE, CELL / 2)
    cells = known.cells(now.here + metres[:, None] * now.ahead)
    inside = known.inside(cells)
    cells = np.where(inside[:, None], cells, 0)
    stands = inside & (known.state[cells[:, 0], cells[:, 1]] == CONTACT)
    return float(metres[stands.argmax()]) if stands.any() else RANGE


@dataclass
class Searcher(Generic[Where]):
    """Chooses looks and steps for one episode.

    `space`: what can be looked at; to walk, a `SearchedGround`. `step`: metres that the body walks in a step; 0: it
    stands, and only turns. `handover`: how sure a belief has to be to be acted on; of a body that walks, metres nearer,
    as believed, per metre walked along the answer. `turn`: radians that it turns in a step, at most; infinite: any turn
    takes one step, and so does another look the same way; a look from here then costs as much as a metre.

    A body whose camera does not see all around looks around before it walks, as long as that tells more for the time,
    and walks ahead only. `searching`: whether the last choice was made because too little is believed. `arrived`:
    whether a body that walks believed then that it is there: less than `near` metres from the thing, or as near as it
    comes to where the thing should be. With `near` 0 it never does.
    """

    space: Where
    step: float = 0.0
    handover: float = 0.2
    turn: float = math.inf
    near: float = 0.0
    searching: bool = True
    arrived: bool = False
    looks_down: bool = True
    _facing: np.ndarray | None = None  # a heading to turn to
    _goal: np.ndarray | None = None  # a place to look from
    _promise: float = 0.0
    _last: tuple[np.ndarray, np.ndarray] | None = None  # where the last step began, and what it was meant to be
    _approach: Approach = field(default_factory=Approach)

    @property
    def known(self: Searcher[SearchedGround]) -> FloorMap:
        """What looks have shown of the floor."""
        return self.space.known

    def face(self, facing: np.ndarray, sure: float) -> np.ndarray | None:
        """The heading ``(2,)`` to turn to for the next look; None: what is believed is sure enough to act on it.

        `facing` ``(2,)``: the present one; azimuth and elevation, radians, world frame. `sure`: of what is believed, as
        `handover`. A heading is kept until it is faced; where any turn takes one step, it is chosen anew after each.
        """
        self.searching = sure < self.handover
        if not self.searching:
            self._facing = None
        elif math.isinf(self.turn) or not self._turning(facing):
            self._facing = self._best_here(facing)[0]
        return self._facing

    def walk(self: Searcher[SearchedGround], now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        ground = self.space
        ground.look(now)
        self._approach.clock += 1
        if self._last is not None:
            self._approach.feel(ground.known, *self._last, now.here, self.step)
        target = self._approach.target(ground, now) if self._believes(now) else None
        self.searching = target is None
        if target is not None:
            self._goal = self._facing = None
            ground.known.cover(np.minimum(now.here, target) - 1.0, np.maximum(now.here, target) + 1.0)
        ways = Ways.over(ground.known, ground.radius, now.here)
        end = None if target is None else self._approach.beside(ground, now, ways, target)
        self.arrived = target is not None and _arrived(now, self.near, self._approach.stands)
        if end is None:
            end = self._search(ways.metres, now)
        if end is None or not self.step:
            aim, metres = now.bearing if self._facing is None else float(self._facing[0]), 0.0
        else:
            way = ways.first(end)
            aim, metres = math.atan2(way[1], way[0]), self.step
        turn = math.remainder(aim - now.yaw, 2 * math.pi)
        if abs(turn) > self.turn + 1e-9:
            turn, metres = math.copysign(self.turn, turn), 0.0
        self._last = (now.here, metres * np.array([math.cos(aim), math.sin(aim)])) if metres else None
        return turn, metres

    def _believes(self: Searcher[SearchedGround], now: SteeringInput) -> bool:
        """Whether the body goes where the thing should be.

        It begins to when the thing is likely there, and goes on while the thing would be there if it is here at all,
        and cannot be seen from here: looks that miss it then say nothing about it.
        """
        if now.progress * now.presence >= self.handover:
            return True
        return not self.searching and now.progress >= self.handover and self._approach.hides(self.space, now)

    def _search(self: Searcher[SearchedGround], metres: np.ndarray, now: SteeringInput) -> tuple[int, int] | None:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one.

        None: rather turn, to `_facing`.
        """
        ground, facing = self.space, np.array([now.yaw, 0.0])
        if self._turning(facing):
            return None
        if self._goal is not None:
            cell = ground.known.cells(self._goal)
            if float(np.hypot(*(self._goal - now.here))) < REACHED:
                if ground.around:
                    ground.looked_from(self._goal, now.yaw)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres)[0] > WORTH * self._promise and self.known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        self._goal = None
        cells = ground.places()
        cells = cells[np.isfinite(metres[cells[:, 0], cells[:, 1]])]
        if not ground.around:
            cells = cells[np.hypot(*(ground.known.centres(cells) - now.here).T) > REACHED]
        worth = self._worth(cells, metres) if self.step else np.zeros(0)
        promise = float(worth.max(initial=0.0))
        if not ground.around:
            best, told = self._best_here(facing)
            if told >= promise:
                self._facing = best
                return None
        if not len(worth):
            row, col = ground.known.cells(now.here + now.ahead)
            return int(row), int(col)
        row, col = cells[int(worth.argmax())]
        self._goal, self._promise = ground.known.centres(np.array([row, col])), promise
        return int(row), int(col)

    def _turning(self, facing: np.ndarray) -> bool:
        """Whether a heading was chosen that is not faced yet."""
        if self._facing is not None and turned(self._facing, facing) <= FACED:
            self._facing = None
        return self._facing is not None

    def _best_here(self, facing: np.ndarray) -> tuple[np.ndarray, float]:
        """The heading ``(2,)`` whose look from here tells most for its cost, and nats per metre, or per turn."""
        told, angles = self.space.tells(), turned(self.space.headings, facing)
        if math.isinf(self.turn):  # rounded, so that rounding errors do not decide between turns to either side
            worth = told - NEARER * np.round(np.degrees(angles), 6)
        else:
            worth = told / (self._costs(angles) + NEAREST_GOAL)
            worth[angles <= FACED] = 0.0  # there the next look is taken anyway
        best = int(worth.argmax())
        return self.space.headings[best], float(worth[best])

    def _worth(self: Searcher[SearchedGround], cells: np.ndarray, metres: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        ground = self.space
        to = ground.known.centres(cells) - ground.here  # as it arrives, it faces away from here; then it turns
        angles = apart(ground.headings[:, 0] - np.arctan2(to[:, 1], to[:, 0])[:, None])
        cost = metres[cells[:, 0], cells[:, 1]] + NEAREST_GOAL
        return (ground.tells_from(cells) / (cost[:, None] + self._costs(angles))).max(axis=1)

    def _costs(self, angles: np.ndarray) -> np.ndarray:
        """Metres that one could walk in the time that it takes to turn by angles (radians)."""
        return np.ceil(angles / self.turn - 1e-9) * (self.step or STANDING)


def seeking(rules: Any, tracker: TrackerConfig) -> TrackerConfig:
    """The tracker's configuration for a body that searches: what is out of sight may come into sight at any step."""
    if getattr(rules, "policy", "follow") == "follow":
        return tracker
    return replace(tracker, target_motion=replace(tracker.target_motion, birth=rules.appears))


# `searching`: whether the last step was one of a search. `looks_down`: whether it wants to know the floor of each look,
# and what is believed; without that, `SteeringInput.progress` and `presence` are 1.
Steering = Policy | Searcher[SearchedGround]


def steering_for(rules: Any, camera: Camera) -> Steering:
    """The steering that the rules ask for; a task whose rules do not speak of it follows."""
    near = getattr(rules, "near", 0.0)
    if getattr(rules, "policy", "follow") == "follow":
        return Policy(camera.step, getattr(rules, "detour", True), near)
    turn = math.inf if camera.around else math.radians(camera.turn)
    return Searcher(SearchedGround.about(camera), camera.step, rules.handover, turn, near)
