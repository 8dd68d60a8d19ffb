"""The walk of a body to where the thing is believed to be, over the ground that its looks have shown.

The body comes to the place from another side where it stood beside it in vain: a wall may be between. A place around
which it has tried all sides is given up. Where it was held up too often on the way, nothing is learnt of the place: it
searches for as many steps as it has tried, and then, if the thing is still believed to be there, it tries again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.tasks.floor_seen import CELL, CONTACT, FloorSeen
from eagor.tasks.floor_ways import BESIDE, NEAR, Ways
from eagor.tasks.policy import held_back
from eagor.tasks.searched_ground import SearchedGround
from eagor.tasks.situation import Situation

HALF = 0.1  # metres to each side of the way on which it was held up: there it would be, too
OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
PATIENCE = 30  # times that the body is held up on its way to a place before it gives it up
REACHED = 0.3  # metres from a goal
RANGE = 5.0  # metres to a target whose distance is unknown
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place


@dataclass
class Approach:
    """Where the thing should be, and what became of going there. For one episode.

    `kept` ``(2,)``: the place, metres, world frame. `tried`: where the body stood beside it, and was not there. `held`:
    how often the body was held up on its way; `steps`: of the way so far. `given_up`: places ``(2,)`` where the thing
    should have been, and was not, each with the step from which it is tried again; `clock`: the steps so far.
    """

    kept: np.ndarray | None = None
    tried: list[np.ndarray] = field(default_factory=list)
    held: int = 0
    steps: int = 0
    given_up: list[tuple[np.ndarray, float]] = field(default_factory=list)
    clock: int = 0

    def hides(self, ground: SearchedGround, now: Situation) -> bool:
        """Whether the thing, if it is where it should be, cannot be seen from here: looks that miss it say nothing."""
        if self.kept is None or not _agrees(now, self.kept):
            return False
        return ground.sight(self.kept) < OPEN_SIGHT

    def target(self, ground: SearchedGround, now: Situation) -> np.ndarray | None:
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

    def beside(self, ground: SearchedGround, now: Situation, ways: Ways, target: np.ndarray) -> tuple[int, int] | None:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not known, or it is close and nothing stands between.
        """
        self.steps += 1
        end = ways.nearest(target, self.tried)
        if end is not None and float(np.hypot(*(ground.known.centres(np.array(end)) - now.here))) < REACHED:
            self.tried.append(now.here)
            close = float(np.hypot(*(target - now.here))) < BESIDE
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

    def feel(self, known: FloorSeen, before: np.ndarray, meant: np.ndarray, here: np.ndarray, step: float) -> None:
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
        beside = np.linspace(-HALF, HALF, 3)[None, :, None] * along
        points = (here + ahead + beside).reshape(-1, 2)
        known.held_up(points[np.any(known.cells(points) != known.cells(here), axis=1)])

    def _in_vain(self, place: np.ndarray) -> bool:
        return any(self.clock < until and float(np.hypot(*(place - at))) < NEAR for at, until in self.given_up)


def _agrees(now: Situation, place: np.ndarray) -> bool:
    """Whether what is believed now still means this place ``(2,)``."""
    to = place - now.here
    away = float(np.hypot(*to))
    if now.distance is not None and abs(math.log(max(now.distance, 0.1) / max(away, 0.1))) > FARTHER:
        return False
    return float(to @ now.ahead) > math.cos(ALIKE) * away


def _free(known: FloorSeen, now: Situation) -> float:
    """Metres to where something stands first towards the estimate, as far as is known; `RANGE` if nothing does."""
    metres = np.arange(0.3, RANGE, CELL / 2)
    cells = known.cells(now.here + metres[:, None] * now.ahead)
    inside = known.inside(cells)
    cells = np.where(inside[:, None], cells, 0)
    stands = inside & (known.state[cells[:, 0], cells[:, 1]] == CONTACT)
    return float(metres[stands.argmax()]) if stands.any() else RANGE
