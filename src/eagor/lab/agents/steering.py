"""From what is known at a step to the step itself: along the estimate, or a search until there is one to act on.

A `Policy` goes a fixed step along the estimate, as published. A `Searcher` looks where that tells most for what it
costs while nothing is believed; then it acts on the belief. It uses odometry, touch, and the floor that looks show; no
map is given and no depth is read. A look from another place costs the way there; the best ratio is the next goal (a
frontier search; Yamauchi, 1997, with expected information as in Bourgault et al., 2002). The camera of H*Bench only
turns: its next heading is the one whose look tells most (`next_heading`).

The body begins to walk to the thing when that is likely to bring it nearer. It goes on although looks miss the thing,
as long as that may be hidden from here, by the floor that is known. It comes to the place from another side where it
stood beside it and did not meet it: a wall may be between. A place around which it has tried all sides is given up.
Where it was blocked too often on the way, it searches for as many steps as it has tried, and then tries again.
"""

from __future__ import annotations

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
)
from eagor.lab.envs.rules import Camera
from eagor.sphere import wrap
from eagor.tracking import TrackerConfig

ARRIVED = 0.8  # how sure a belief has to be to stop for it, as `commit_threshold`: a stop ends the search
RANGE = 5.0  # metres along the estimate to the assumed goal, where the distance to the target is unknown
TOUCH = 0.07  # a step that falls short by more than this share collided
TOUCHED = 0.1  # metres to each side of the way on which it was blocked: there it would be, too
FELT = 0.3  # the same of a body that sees no floor
KEPT, AROUND = 0.9, 2  # share of a visit that counts at the next plan, and the cells about the body that it counts for


def learn(known: FloorMap, before: np.ndarray, intended: np.ndarray, here: np.ndarray, step: float, wide: float) -> int:
    """Learn from a step `intended` ``(2,)`` from `before` to `here`: something stands where the body was blocked.

    Metres, world frame; `step`: the length of a whole step; `wide`: half of the width of what stands there. Returns 1
    if it was blocked, else 0.
    """
    lost = intended - (here - before)
    size = float(np.hypot(*lost))
    if size <= TOUCH * step or float(lost @ intended) <= 0:
        return 0
    normal = lost / size
    along = np.array([-normal[1], normal[0]])
    ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * step * normal
    aside = np.linspace(-wide, wide, 2 * round(wide / CELL) + 1)[None, :, None] * along
    points = (here + ahead + aside).reshape(-1, 2)
    known.block(points[np.any(known.cells(points) != known.cells(here), axis=1)])
    return 1


class Policy:
    """Walks along the estimate, whatever it is worth, for one episode; with `detour` around what it has touched.

    `step` in metres. It never searches, and reads no floor: all that it has not touched is taken to be free (free-space
    assumption; Koenig, Tovey and Smirnov, 2003). `near`, `arrived`: as of a `Searcher`.
    """

    searching, needs_floor_mask = False, False

    def __init__(self, step: float, detour: bool = True, near: float = 0.0) -> None:
        self.step, self.detour, self.near, self.arrived = step, detour, near, False
        self._known = FloorMap()
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step

    def walk(self, now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        self.arrived = _arrived(now, self.near)
        return self.heading(now.azimuth, now.position[:2], now.yaw), self.step

    def heading(self, azimuth: float, xy: np.ndarray, yaw: float) -> float:
        """Radians from straight ahead, in (-pi, pi]; `azimuth` of the estimate; `xy` ``(2,)`` and `yaw` by odometry."""
        if not self.detour:
            return azimuth
        known, here = self._known, np.array(xy, dtype=np.float64)
        way = np.array([math.cos(azimuth + yaw), math.sin(azimuth + yaw)])
        goal = here + RANGE * way
        known.cover(np.minimum(here, goal) - 1.0, np.maximum(here, goal) + 1.0)
        if self._last is not None:
            passed = self._last[0] + np.linspace(0, 1, 5)[:, None] * (here - self._last[0])
            known.blocked_count[tuple(known.cells(passed).T)] = 0
            learn(known, *self._last, here, self.step, FELT)
        line = known.cells(here + np.arange(0.0, RANGE, CELL / 2)[:, None] * way)
        if known.blocked_count[tuple(line.T)].any():
            known.visit_count = KEPT * known.visit_count  # its own trail would wall it in for good
            row, column = known.cells(here)
            known.visit_count[row - AROUND : row + AROUND + 1, column - AROUND : column + AROUND + 1] += 1
            row, column = known.cells(goal)
            way = Ways(known, 0.0, here).first((int(row), int(column)))
        self._last = here, self.step * way / np.hypot(*way)
        heading = math.remainder(math.atan2(way[1], way[0]) - yaw, 2 * math.pi)
        return heading if heading > -math.pi else math.pi


def _arrived(now: SteeringInput, near: float, stands: bool = False) -> bool:
    """Whether the thing is surely less than `near` metres away, as believed, or is what the body `stands` beside."""
    if not near or now.distance is None or now.progress * now.presence < ARRIVED:
        return False
    return stands or now.distance < near


# --- a search --------------------------------------------------------------------------------------------------------

OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
PATIENCE = 30  # times that the body is blocked on its way to a place before it gives it up
REACHED = 0.3  # metres from a goal
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place
NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
NEARER = 1e-5  # nats per degree: where every turn costs the same, the nearest of looks that tell as much


def next_heading(headings: np.ndarray, nats: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """The one of the headings ``(n, 2)`` whose look tells most ``(n,)``, of equal ones the nearest to `facing`.

    Azimuth and elevation, radians, world frame. Any turn costs the same.
    """
    angles = np.abs(wrap(headings[:, 0] - facing[0])) + np.abs(headings[:, 1] - facing[1])
    # Rounded, so that rounding errors do not decide between turns to either side.
    return headings[int((nats - NEARER * np.round(np.degrees(angles), 6)).argmax())]


class Searcher:
    """Chooses the steps of a body for one episode: looks while too little is believed, else goes where the thing is.

    - `ground`: what it knows. `step`: metres that the body walks in a step.
    - `commit_threshold`: how sure a belief has to be to be acted on: metres nearer, as believed, per metre walked along
      the answer.

    `searching`: whether the last choice was made because too little is believed. `arrived`: whether the body believed
    then that it is there: less than `near` metres from the thing, or as near as it comes to where the thing should be.
    With `near` 0 it never does.
    """

    needs_floor_mask = True

    def __init__(self, ground: SearchedGround, step: float, commit_threshold: float = 0.2, near: float = 0.0) -> None:
        self.ground, self.step, self.commit_threshold, self.near = ground, step, commit_threshold, near
        self.searching, self.arrived = True, False
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

    def walk(self, now: SteeringInput) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        ground = self.ground
        ground.look(now)
        self._clock += 1
        if self._last is not None:
            self._blocked_count += learn(ground.known, *self._last, now.here, self.step, TOUCHED)
        target = self._target(now) if self._believes(now) else None
        self.searching = target is None
        if target is not None:
            self._goal = None
            ground.known.cover(np.minimum(now.here, target) - 1.0, np.maximum(now.here, target) + 1.0)
        ways = Ways(ground.known, ground.radius, now.here)
        end, stands = (None, False) if target is None else self._beside(now, ways, target)
        self.arrived = target is not None and _arrived(now, self.near, stands)
        way = ways.first(self._search(ways.metres, now) if end is None else end)
        aim = math.atan2(way[1], way[0])
        self._last = now.here, self.step * np.array([math.cos(aim), math.sin(aim)])
        return math.remainder(aim - now.yaw, 2 * math.pi), self.step

    def _believes(self, now: SteeringInput) -> bool:
        """Whether the body goes where the thing should be: it is likely there, or was, and cannot be seen from here."""
        if now.progress * now.presence >= self.commit_threshold:
            return True
        if self.searching or now.progress < self.commit_threshold or self._place is None:
            return False
        # Looks that miss the thing say nothing where it would be hidden.
        return _agrees(now, self._place) and self.ground.sight(self._place) < OPEN_SIGHT

    def _target(self, now: SteeringInput) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, while the belief stays; None if the body was there, and it was not."""
        if self._place is None or not _agrees(now, self._place):
            away = now.distance if now.distance is not None else _free(self.ground.known, now)
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
        if end is not None and float(np.hypot(*(self.ground.known.centres(np.array(end)) - now.here))) < REACHED:
            self._tried.append(now.here)
            close = float(np.hypot(*(target - now.here))) < BESIDE
            stands = now.distance is not None and close
            there = now.distance is not None and (not close or self.ground.sight(target) < OPEN_SIGHT)
            end = ways.nearest(target, self._tried) if there else None
        if end is None:
            self._given_up.append((target, math.inf))
        elif self._blocked_count > PATIENCE:
            self._given_up.append((target, self._clock + self._way_steps))
            self._begin()
            end = None
        return end, stands

    def _search(self, metres: np.ndarray, now: SteeringInput) -> tuple[int, int]:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one."""
        known = self.ground.known
        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - now.here))) < REACHED:
                self.ground.mark_scanned(self._goal)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres)[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        self._goal = None
        cells = self.ground.places()
        cells = cells[np.isfinite(metres[tuple(cells.T)])]
        cell = known.cells(now.here + now.ahead)
        if len(cells):
            worth = self._worth(cells, metres)
            cell, self._promise = cells[int(worth.argmax())], float(worth.max())
            self._goal = known.centres(cell)
        return int(cell[0]), int(cell[1])

    def _worth(self, cells: np.ndarray, metres: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        return self.ground.tells(cells) / (metres[tuple(cells.T)] + NEAREST_GOAL)


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
    return Searcher(SearchedGround(camera), camera.step, rules.commit_threshold, near)
