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
stood beside it and did not meet it: a wall may be between. A place around which it has tried all sides is given up.
Where it was blocked too often on the way, nothing is learnt of the place: it searches for as many steps as it has
tried, and then, if the thing is still believed to be there, it tries again.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.lab.agents.search_space import (
    BESIDE,
    CELL,
    CONTACT,
    FLOOR,
    NEAR,
    FloorMap,
    SearchedGround,
    SteeringInput,
    Ways,
    angle_size,
    turn_angle,
)
from eagor.lab.envs.rules import Camera
from eagor.tracking import TrackerConfig

ARRIVED = 0.8  # how sure a belief has to be to stop for it, as `commit_threshold`: a stop ends the search
RANGE = 5.0  # metres along the estimate to the assumed goal, where the distance to the target is unknown
TOUCH = 0.07  # a step that falls short by more than this share collided

# --- along the estimate -----------------------------------------------------------------------------------------------

SPACING = 0.15  # metres between the nodes of the planning lattice
STANDOFF, HALF = 0.1, 0.3  # metres from the colliding body to the noted wall, and half of the wall's length
WALL, HIGHEST = 5.0, 20.0  # metres that one collision adds to an edge, and that all of them add at most
VISIT, AROUND = 0.2, 2  # metres that planning at a node adds to paths through it and this many nodes around
KEPT = 0.9  # share of that after the next plan
LOOK, WINDOW = 1.5, 10.0  # metres: longest straight stretch of a path, and farthest that paths stray from the body
_NEIGHBOURS = [(i, j, math.hypot(i, j) * SPACING) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
_EDGES = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  # every edge of the lattice once, from one of its ends

Node = tuple[int, int]


class Policy:
    """Walks along the estimate, whatever it is worth, for one episode.

    `step` in metres; `detour`: whether to find ways around obstacles. It never searches, and reads no floor. `near`,
    `arrived`: as of a `Searcher`.
    """

    searching, needs_floor_mask = False, False

    def __init__(self, step: float, detour: bool = True, near: float = 0.0) -> None:
        self.step, self.detour, self.near, self.arrived = step, detour, near, False
        # The plan's frame has its origin where the episode began, and its x axis along the body's heading there.
        self._start: tuple[np.ndarray, float] | None = None
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step
        self._walls = np.zeros((0, 2, 2))  # both ends of each noted wall
        self._extra: dict[tuple[Node, Node], float] = {}  # metres that walls add to edges
        self._visits: dict[Node, float] = {}

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
            self._learn(*self._last, here)
        way = self._way(here, here + RANGE * np.array([math.cos(bearing), math.sin(bearing)]))
        self._last = here, way * (self.step / np.hypot(*way))
        heading = math.remainder(math.atan2(way[1], way[0]) + turn - yaw, 2 * math.pi)
        return heading if heading > -math.pi else math.pi

    def _learn(self, before: np.ndarray, intended: np.ndarray, here: np.ndarray) -> None:
        """Learn from a step: a wall where the body was blocked, no wall where it passed."""
        crossed = _cross(before, here, self._walls)
        if crossed.any():
            self._walls, self._extra = self._walls[~crossed], {}
            for wall in self._walls:
                self._note(wall)
        lost = _lost(before, intended, here, self.step)
        if lost is None:
            return
        size, into = float(np.hypot(*lost)), float(lost @ intended)
        # The body goes straight, then slides along the wall, which removes the component of each step normal to it.
        normal, slid = lost / size, min(size * size / into, 1.0)
        along = np.array([-normal[1], normal[0]])
        first = here - ((here - before) - (1 - slid) * intended)
        if (here - first) @ along < 0:
            along = -along
        wall = np.array([first - HALF * along, here + HALF * along]) + STANDOFF * normal
        self._walls = np.concatenate([self._walls, wall[None]])
        self._note(wall)

    def _note(self, wall: np.ndarray) -> None:
        """Lengthen the edges of the lattice that cross a wall ``(2, 2)``."""
        low = np.floor(wall.min(axis=0) / SPACING).astype(int) - 1
        size = np.ceil(wall.max(axis=0) / SPACING).astype(int) + 2 - low
        ones = low + np.indices(size).reshape(2, -1).T[:, None] + np.zeros_like(_EDGES)
        hit = _cross(ones * SPACING, (ones + _EDGES) * SPACING, wall)
        for one, other in zip(ones[hit].tolist(), (ones + _EDGES)[hit].tolist(), strict=True):
            a, b = (one[0], one[1]), (other[0], other[1])
            self._extra[a, b] = self._extra[b, a] = min(self._extra.get((a, b), 0.0) + WALL, HIGHEST)

    def _step_cost(self, here: np.ndarray, there: np.ndarray) -> float:
        """The cost of walls on the line to a point, extended to a whole step: steps cannot be shortened."""
        share = max(1.0, self.step / float(np.hypot(*(there - here))))
        return WALL * int(_cross(here, here + share * (there - here), self._walls).sum())

    def _way(self, here: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """The direction ``(2,)`` (of any length) in which the cheapest path to the goal begins."""
        target = None
        for node in self._plan(here, goal) if _cross(here, goal, self._walls).any() else ():
            point = np.array(node) * SPACING
            in_line = np.hypot(*(point - here)) < LOOK and not self._step_cost(here, point)
            if target is not None and not in_line:
                break
            target = point
        return (goal if target is None else target) - here

    def _plan(self, here: np.ndarray, goal: np.ndarray) -> list[Node]:
        """The cheapest path over the lattice (A*), from about a step away from the body to the goal."""
        end, (x, y) = _node(goal), _node(here)
        reach = max(self.step, SPACING / 0.6)
        # Visited places cost more for a while, not for good: the body's own trail would wall it in.
        self._visits = {node: KEPT * metres for node, metres in self._visits.items() if metres > 0.01}
        for node in _square((x, y), AROUND):
            self._visits[node] = self._visits.get(node, 0.0) + VISIT
        costs: dict[Node, float] = {}
        for node in _square((x, y), math.ceil(1.3 * reach / SPACING) + 1):
            point = np.array(node) * SPACING
            away = float(np.hypot(*(point - here)))
            if 0.4 * reach < away <= 1.3 * reach:
                costs[node] = away + self._step_cost(here, point) + self._visits.get(node, 0.0)
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


def _node(point: np.ndarray) -> Node:
    return round(float(point[0]) / SPACING), round(float(point[1]) / SPACING)


def _square(middle: Node, reach: int) -> list[Node]:
    """The nodes at most so many away from the middle, along each axis."""
    sides = range(-reach, reach + 1)
    return [(middle[0] + i, middle[1] + j) for i in sides for j in sides]


def _octile(one: Node, other: Node) -> float:
    """Length of the shortest path between two nodes of a free lattice."""
    a, b = abs(one[0] - other[0]), abs(one[1] - other[1])
    return SPACING * (max(a, b) + (math.sqrt(2) - 1) * min(a, b))


def _cross(start: np.ndarray, end: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Whether lines ``(..., 2)`` from start to end cross walls ``(..., 2, 2)``, broadcast."""
    one, other = walls[..., 0, :], walls[..., 1, :]

    def left(o: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        turn = (p[..., 0] - o[..., 0]) * (q[..., 1] - o[..., 1]) - (p[..., 1] - o[..., 1]) * (q[..., 0] - o[..., 0])
        return turn > 0

    return (left(start, end, one) != left(start, end, other)) & (left(one, other, start) != left(one, other, end))


def _lost(before: np.ndarray, intended: np.ndarray, here: np.ndarray, step: float) -> np.ndarray | None:
    """The part ``(2,)`` of an intended movement that a body could not make on its way to `here`; None: no collision.

    Metres; `step`: the length of a whole step.
    """
    lost = intended - (here - before)
    return lost if float(np.hypot(*lost)) > TOUCH * step and float(lost @ intended) > 0 else None


def _arrived(now: SteeringInput, near: float, stands: bool = False) -> bool:
    """Whether the thing is surely less than `near` metres away, as believed, or is what the body `stands` beside."""
    if not near or now.distance is None or now.progress * now.presence < ARRIVED:
        return False
    return stands or now.distance < near


# --- a search --------------------------------------------------------------------------------------------------------

TOUCHED = 0.1  # metres to each side of the way on which it was blocked: there it would be, too
OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
PATIENCE = 30  # times that the body is blocked on its way to a place before it gives it up
REACHED = 0.3  # metres from a goal
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place
NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
FACED = 1e-6  # radians
STANDING = 0.25  # metres that a standing body counts for a step of a turn
NEARER = 1e-5  # nats per degree: where every turn costs the same, the nearest of looks that tell as much


class Searcher:
    """Chooses looks and steps for one episode.

    - `space`: what can be looked at, a `Space`; to walk, a `SearchedGround`.
    - `step`: metres that the body walks in a step; 0: it stands, and only turns.
    - `commit_threshold`: how sure a belief has to be to be acted on; of a body that walks, metres nearer, as believed,
      per metre walked along the answer.
    - `turn`: radians that it turns in a step, at most; infinite: any turn takes one step, and so does another look the
      same way; a look from here then costs as much as a metre.

    A body whose camera does not see all around looks around before it walks, as long as that tells more for the time,
    and walks ahead only. `searching`: whether the last choice was made because too little is believed. `arrived`:
    whether a body that walks believed then that it is there: less than `near` metres from the thing, or as near as it
    comes to where the thing should be. With `near` 0 it never does.
    """

    needs_floor_mask = True

    def __init__(
        self, space: Any, step: float = 0.0, commit_threshold: float = 0.2, turn: float = math.inf, near: float = 0.0
    ) -> None:
        self.space, self.step, self.commit_threshold, self.turn, self.near = space, step, commit_threshold, turn, near
        self.searching, self.arrived = True, False
        self._facing: np.ndarray | None = None  # a heading to turn to
        self._goal: np.ndarray | None = None  # a place to look from
        self._promise = 0.0  # of the goal: nats per metre
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step
        # Where the thing should be ``(2,)``, metres, world frame; where the body stood beside it and did not meet it;
        # how often it was blocked on its way there, and the steps of that way.
        self._place: np.ndarray | None = None
        self._tried: list[np.ndarray] = []
        self._blocked_count = self._way_steps = 0
        # Places ``(2,)`` where it should have been and was not, with the step from which each is tried again.
        self._given_up: list[tuple[np.ndarray, float]] = []
        self._clock = 0  # the steps so far

    def face(self, facing: np.ndarray, sure: float) -> np.ndarray | None:
        """The heading ``(2,)`` to turn to for the next look; None: what is believed is sure enough to act on it.

        `facing` ``(2,)``: the present one; azimuth and elevation, radians, world frame. `sure`: of what is believed, as
        `commit_threshold`. A heading is kept until it is faced; where any turn takes one step, it is chosen anew.
        """
        self.searching = sure < self.commit_threshold
        if not self.searching:
            self._facing = None
        elif math.isinf(self.turn) or not self._turning(facing):
            self._facing = self._best_here(facing)[0]
        return self._facing

    def walk(self, now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        ground: SearchedGround = self.space
        ground.look(now)
        self._clock += 1
        if self._last is not None:
            self._learn(*self._last, now.here)
        target = self._target(now) if self._believes(now) else None
        self.searching = target is None
        if target is not None:
            self._goal = self._facing = None
            ground.known.cover(np.minimum(now.here, target) - 1.0, np.maximum(now.here, target) + 1.0)
        ways = Ways(ground.known, ground.radius, now.here)
        end, stands = (None, False) if target is None else self._beside(now, ways, target)
        self.arrived = target is not None and _arrived(now, self.near, stands)
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

    def _believes(self, now: SteeringInput) -> bool:
        """Whether the body goes where the thing should be: it is likely there, or was, and cannot be seen from here."""
        if now.progress * now.presence >= self.commit_threshold:
            return True
        if self.searching or now.progress < self.commit_threshold or self._place is None:
            return False
        # Looks that miss the thing say nothing where it would be hidden.
        return _agrees(now, self._place) and self.space.sight(self._place) < OPEN_SIGHT

    def _learn(self, before: np.ndarray, intended: np.ndarray, here: np.ndarray) -> None:
        """Learn from a step ``(2,)``, metres, world frame: something stands where the body was blocked."""
        lost = _lost(before, intended, here, self.step)
        if lost is None:
            return
        self._blocked_count += 1
        normal = lost / float(np.hypot(*lost))
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * self.step * normal
        aside = np.linspace(-TOUCHED, TOUCHED, 3)[None, :, None] * along
        points, known = (here + ahead + aside).reshape(-1, 2), self.space.known
        known.block(points[np.any(known.cells(points) != known.cells(here), axis=1)])

    def _target(self, now: SteeringInput) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, as believed; None if the body has been there, and it was not.

        The way to it is kept until the belief moves away from it.
        """
        if self._place is None or not _agrees(now, self._place):
            away = now.distance if now.distance is not None else _free(self.space.known, now)
            self._place = now.here + away * now.ahead
            self._begin()
        if self._goal_falsified(self._place) and now.distance is None:
            self._place = now.here + RANGE * now.ahead  # not in front of the next obstacle: behind it
        return None if self._goal_falsified(self._place) else self._place

    def _begin(self) -> None:
        """The way to a place begins, for the first time or anew."""
        self._tried, self._blocked_count, self._way_steps = [], 0, 0

    def _goal_falsified(self, place: np.ndarray) -> bool:
        """Whether a place ``(2,)`` is given up, at this step."""
        return any(self._clock < until and float(np.hypot(*(place - at))) < NEAR for at, until in self._given_up)

    def _beside(self, now: SteeringInput, ways: Ways, target: np.ndarray) -> tuple[tuple[int, int] | None, bool]:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not known, or it is close and nothing stands between.
        And whether the body stands beside the target, as near as it comes.
        """
        self._way_steps += 1
        stands, end = False, ways.nearest(target, self._tried)
        if end is not None and float(np.hypot(*(self.space.known.centres(np.array(end)) - now.here))) < REACHED:
            self._tried.append(now.here)
            close = float(np.hypot(*(target - now.here))) < BESIDE
            stands = now.distance is not None and close
            there = now.distance is not None and (not close or self.space.sight(target) < OPEN_SIGHT)
            end = ways.nearest(target, self._tried) if there else None
        if end is None:
            self._given_up.append((target, math.inf))
        elif self._blocked_count > PATIENCE:
            self._given_up.append((target, self._clock + self._way_steps))
            self._begin()
            end = None
        return end, stands

    def _search(self, metres: np.ndarray, now: SteeringInput) -> tuple[int, int] | None:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one.

        None: rather turn, to `_facing`.
        """
        ground, facing = self.space, np.array([now.yaw, 0.0])
        known: FloorMap = ground.known
        if self._turning(facing):
            return None
        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - now.here))) < REACHED:
                if ground.around:
                    ground.mark_scanned(self._goal, now.yaw)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres)[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        self._goal = None
        cells = ground.places()
        cells = cells[np.isfinite(metres[tuple(cells.T)])]
        if not ground.around:
            cells = cells[np.hypot(*(known.centres(cells) - now.here).T) > REACHED]
        worth = self._worth(cells, metres) if self.step else np.zeros(0)
        promise = float(worth.max(initial=0.0))
        if not ground.around:
            best, worth_here = self._best_here(facing)
            if worth_here >= promise:
                self._facing = best
                return None
        cell = known.cells(now.here + now.ahead)
        if len(worth):
            cell = cells[int(worth.argmax())]
            self._goal, self._promise = known.centres(cell), promise
        return int(cell[0]), int(cell[1])

    def _turning(self, facing: np.ndarray) -> bool:
        """Whether a heading was chosen that is not faced yet."""
        if self._facing is not None and turn_angle(self._facing, facing) <= FACED:
            self._facing = None
        return self._facing is not None

    def _best_here(self, facing: np.ndarray) -> tuple[np.ndarray, float]:
        """The heading ``(2,)`` whose look from here tells most for its cost, and nats per metre, or per turn."""
        nats, angles = self.space.tells(), turn_angle(self.space.headings, facing)
        if math.isinf(self.turn):  # rounded, so that rounding errors do not decide between turns to either side
            worth = nats - NEARER * np.round(np.degrees(angles), 6)
        else:
            worth = nats / (self._costs(angles) + NEAREST_GOAL)
            worth[angles <= FACED] = 0.0  # there the next look is taken anyway
        best = int(worth.argmax())
        return self.space.headings[best], float(worth[best])

    def _worth(self, cells: np.ndarray, metres: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        ground: SearchedGround = self.space
        to = ground.known.centres(cells) - ground.here  # as it arrives, it faces away from here; then it turns
        angles = angle_size(ground.headings[:, 0] - np.arctan2(to[:, 1], to[:, 0])[:, None])
        cost = metres[tuple(cells.T)] + NEAREST_GOAL
        return (ground.tells_from(cells) / (cost[:, None] + self._costs(angles))).max(axis=1)

    def _costs(self, angles: np.ndarray) -> np.ndarray:
        """Metres that one could walk in the time that it takes to turn by angles (radians)."""
        return np.ceil(angles / self.turn - 1e-9) * (self.step or STANDING)


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
    metres, cells = metres[known.inside(cells)], cells[known.inside(cells)]
    stands = known.state[tuple(cells.T)] == CONTACT
    return float(metres[stands.argmax()]) if stands.any() else RANGE


def search_config(rules: Any, tracker: TrackerConfig) -> TrackerConfig:
    """The tracker's configuration for a body that searches: what is out of sight may come into sight at any step."""
    if getattr(rules, "policy", "follow") == "follow":
        return tracker
    return replace(tracker, target_motion=replace(tracker.target_motion, birth=rules.birth_rate))


# `searching`: whether the last step was one of a search. `needs_floor_mask`: whether it wants to know the floor of each
# look, and what is believed; without that, `SteeringInput.progress` and `presence` are 1.
Steering = Policy | Searcher


def steering_for(rules: Any, camera: Camera) -> Steering:
    """The steering that the rules ask for; a task whose rules do not speak of it follows."""
    near = getattr(rules, "near", 0.0)
    if getattr(rules, "policy", "follow") == "follow":
        return Policy(camera.step, getattr(rules, "detour", True), near)
    turn = math.inf if camera.around else math.radians(camera.turn)
    return Searcher(SearchedGround(camera), camera.step, rules.commit_threshold, turn, near)
