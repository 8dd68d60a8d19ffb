"""From what is known at a step to the step itself: along the estimate, or a search until there is one to act on.

A `Policy` goes a fixed step along the estimate, as published. A `Searcher` looks where that tells most for what it
costs while nothing is believed; then it acts on the belief. A look from another place costs the way there; the best
ratio is the next goal (a frontier search; Yamauchi, 1997, with expected information as in Bourgault et al., 2002). The
camera of H*Bench only turns: its next heading is the one whose look tells most (`next_heading`).

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

from eagor.lab.agents.search_space import BESIDE, CELL, CONTACT, FLOOR, NEAR, FloorMap, SteeringInput, Ways
from eagor.lab.envs.rules import Camera
from eagor.sphere import wrap
from eagor.tracking import TrackerConfig

ARRIVED = 0.8  # how sure a belief has to be to stop for it, as `commit_threshold`: a stop ends the search
RANGE = 5.0  # metres along the estimate to the assumed goal, where the distance to the target is unknown
TOUCHED = 0.1  # metres to each side of the way on which it was blocked: there it would be, too
FELT = 0.3  # the same of a body that sees no floor
KEPT, AROUND = 0.9, 2  # share of a visit that counts at the next plan, and the cells about the body that it counts for


class Policy:
    """Walks along the estimate, whatever it is worth, for one episode; with `detour` around what it has touched.

    It never searches, and reads no floor: all that it has not touched is taken to be free (free-space assumption;
    Koenig, Tovey and Smirnov, 2003). `step`: metres that the body walks in a step.

    `searching`: whether the last step was one of a search. `arrived`: whether the body believed then that it is there,
    less than `near` metres from the thing; with `near` 0 it never does. `needs_floor_mask`: whether looks have to tell
    which of their pixels show the floor.
    """

    needs_floor_mask = False

    def __init__(self, step: float, near: float = 0.0, detour: bool = True, radius: float = 0.0) -> None:
        self.step, self.near, self.detour, self.searching, self.arrived = step, near, detour, False, False
        self.known = FloorMap(radius)
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # start of the last step, and the intended step

    def walk(self, now: SteeringInput) -> float:
        """The turn before the next step, radians, positive left, in (-pi, pi]."""
        self.arrived = self._arrives(now)
        return self.heading(now.azimuth, now.here, now.yaw)

    def heading(self, azimuth: float, xy: np.ndarray, yaw: float) -> float:
        """Radians from straight ahead, in (-pi, pi]; `azimuth` of the estimate; `xy` ``(2,)`` and `yaw` by odometry."""
        if not self.detour:
            return azimuth
        known, here = self.known, np.array(xy, dtype=np.float64)
        way = RANGE * np.array([math.cos(azimuth + yaw), math.sin(azimuth + yaw)])
        known.cover(np.minimum(here, here + way) - 1.0, np.maximum(here, here + way) + 1.0)
        if self._last is not None:
            passed = self._last[0] + np.linspace(0, 1, 5)[:, None] * (here - self._last[0])
            known.blocked_count[tuple(known.cells(passed).T)] = 0
            known.touch(*self._last, here, FELT)
        line = known.cells(here + np.linspace(0, 1, 2 * round(RANGE / CELL))[:, None] * way)
        if known.blocked_count[tuple(line.T)].any():
            known.visit_count = KEPT * known.visit_count  # its own trail would wall it in for good
            row, column = known.cells(here)
            known.visit_count[row - AROUND : row + AROUND + 1, column - AROUND : column + AROUND + 1] += 1
            way = Ways(known, here).first(known.cells(here + way))
        return self._begin_step(way, here, yaw)

    def _arrives(self, now: SteeringInput, stands: bool = False) -> bool:
        """Whether the thing is surely less than `near` metres away, or is what the body `stands` beside."""
        sure = self.near and now.distance is not None and now.progress * now.presence >= ARRIVED
        return bool(sure) and (stands or now.distance < self.near)  # type: ignore[operator]

    def _begin_step(self, way: np.ndarray, here: np.ndarray, yaw: float) -> float:
        """The turn, radians, in (-pi, pi], to a way ``(2,)`` of any length, for the next step."""
        aim = math.atan2(way[1], way[0])
        self._last = here, self.step * np.array([math.cos(aim), math.sin(aim)])
        turn = math.remainder(aim - yaw, 2 * math.pi)
        return turn if turn > -math.pi else math.pi


# --- a search --------------------------------------------------------------------------------------------------------

OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
EVERY = 3  # cells between the places that are weighed
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


class Searcher(Policy):
    """Chooses the steps of a body for one episode: looks while too little is believed, else goes where the thing is.

    `commit_threshold`: how sure a belief has to be to be acted on: metres nearer, as believed, per metre walked along
    the answer. It has also `arrived` as near as it comes to where the thing should be.
    """

    needs_floor_mask = True

    def __init__(self, camera: Camera, near: float = 0.0, commit_threshold: float = 0.2) -> None:
        super().__init__(camera.step, near, radius=camera.radius)
        self.commit_threshold, self.searching = commit_threshold, True
        self._goal: np.ndarray | None = None  # a place to look from
        self._promise = 0.0  # of the goal: nats per metre
        # Where the thing should be ``(2,)``, metres, world frame; where the body stood beside it and did not meet it;
        # how often it was blocked on its way there, the steps of that way, and all steps so far.
        self._place: np.ndarray | None = None
        self._tried: list[np.ndarray] = []
        self._blocked_count = self._way_steps = self._clock = 0
        # Places ``(2,)`` where it should have been and was not, with the step from which each is tried again.
        self._given_up: list[tuple[np.ndarray, float]] = []

    def walk(self, now: SteeringInput) -> float:
        known = self.known
        known.observe(now)
        self._clock += 1
        if self._last is not None:
            self._blocked_count += known.touch(*self._last, now.here, TOUCHED)
        target = self._target(now) if self._believes(now) else None
        self.searching = target is None
        if target is not None:
            self._goal = None
            known.cover(np.minimum(now.here, target) - 1.0, np.maximum(now.here, target) + 1.0)
        ways = Ways(known, now.here)
        end, stands = (None, False) if target is None else self._beside(now, ways, target)
        self.arrived = target is not None and self._arrives(now, stands)
        way = ways.first(self._search(ways.metres, now) if end is None else end)
        return self._begin_step(way, now.here, now.yaw)

    def _believes(self, now: SteeringInput) -> bool:
        """Whether the body goes where the thing should be: it is likely there, or was, and cannot be seen from here."""
        if now.progress * now.presence >= self.commit_threshold:
            return True
        if self.searching or now.progress < self.commit_threshold or self._place is None:
            return False
        # Looks that miss the thing say nothing where it would be hidden.
        return _agrees(now, self._place) and self.known.sight(self._place) < OPEN_SIGHT

    def _target(self, now: SteeringInput) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, while the belief stays; None if the body was there, and it was not."""
        if self._place is None or not _agrees(now, self._place):
            away = now.distance
            if away is None:  # where something stands first towards the estimate, as far as is known
                metres = np.arange(0.3, RANGE, CELL / 2)
                stands = self.known.states(now.here + metres[:, None] * now.ahead) == CONTACT
                away = float(metres[stands.argmax()]) if stands.any() else RANGE
            self._place = now.here + away * now.ahead
            self._tried, self._blocked_count, self._way_steps = [], 0, 0
        if self._is_given_up(self._place) and now.distance is None:
            self._place = now.here + RANGE * now.ahead  # not in front of the next obstacle: behind it
        return None if self._is_given_up(self._place) else self._place

    def _is_given_up(self, place: np.ndarray) -> bool:
        """Whether a place ``(2,)`` is given up, at this step."""
        return any(self._clock < until and float(np.hypot(*(place - at))) < NEAR for at, until in self._given_up)

    def _beside(self, now: SteeringInput, ways: Ways, target: np.ndarray) -> tuple[tuple[int, int] | None, bool]:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not known, or it is close and nothing stands between.
        And whether the body stands beside the target, as near as it comes.
        """
        self._way_steps += 1
        stands, end = False, ways.nearest(target, self._tried)
        if end is not None and float(np.hypot(*(self.known.centres(np.array(end)) - now.here))) < REACHED:
            self._tried.append(now.here)
            close = float(np.hypot(*(target - now.here))) < BESIDE
            stands = now.distance is not None and close
            there = now.distance is not None and (not close or self.known.sight(target) < OPEN_SIGHT)
            end = ways.nearest(target, self._tried) if there else None
        if end is None:
            self._given_up.append((target, math.inf))
        elif self._blocked_count > PATIENCE:
            self._given_up.append((target, self._clock + self._way_steps))
            self._tried, self._blocked_count, self._way_steps = [], 0, 0
            end = None
        return end, stands

    def _search(self, metres: np.ndarray, now: SteeringInput) -> np.ndarray:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one."""
        known = self.known

        def worth(cells: np.ndarray) -> np.ndarray:
            """Nats that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
            return known.tells(cells) / (metres[tuple(cells.T)] + NEAREST_GOAL)

        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - now.here))) < REACHED:
                known.mark_scanned(self._goal)  # as good as there: steps end a little beside it
            elif worth(cell[None])[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return cell
        cells = np.argwhere((known.state == FLOOR) & np.isfinite(metres))
        cells = cells[(cells % EVERY == 0).all(axis=1)]
        if not len(cells):
            self._goal = None
            return known.cells(now.here + now.ahead)
        nats = worth(cells)
        cell, self._promise = cells[int(nats.argmax())], float(nats.max())
        self._goal = known.centres(cell)
        return cell


def _agrees(now: SteeringInput, place: np.ndarray) -> bool:
    """Whether what is believed now still means this place ``(2,)``."""
    to = place - now.here
    away = float(np.hypot(*to))
    if now.distance is not None and abs(math.log(max(now.distance, 0.1) / max(away, 0.1))) > FARTHER:
        return False
    return float(to @ now.ahead) > math.cos(ALIKE) * away


def search_config(rules: Any, tracker: TrackerConfig) -> TrackerConfig:
    """The tracker's configuration for a body that searches: what is out of sight may come into sight at any step."""
    if getattr(rules, "policy", "follow") == "follow":
        return tracker
    return replace(tracker, target_motion=replace(tracker.target_motion, birth=rules.birth_rate))


def steering_for(rules: Any, camera: Camera) -> Policy:
    """The steering that the rules ask for; a task whose rules do not speak of it follows."""
    near = getattr(rules, "near", 0.0)
    if getattr(rules, "policy", "follow") == "follow":
        return Policy(camera.step, near, getattr(rules, "detour", True))
    return Searcher(camera, near, rules.commit_threshold)
