"""The walk to a place where the thing should be: which place that is, from where to come to it, when it was in vain."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.tasks.floor_ways import NEAR, Ways
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
    """The walk of one episode to places where the thing should be, over `ground`. Places ``(2,)`` in metres.

    `kept`: that place; `tried`: where the body stood beside it, and was not there; `vain`: where the thing should have
    been, and was not; `held`: times held up on the way there.
    """

    ground: SearchedGround
    kept: np.ndarray | None = None
    tried: list[np.ndarray] = field(default_factory=list)
    vain: list[np.ndarray] = field(default_factory=list)
    held: int = 0

    def goes_on(self, now: Situation, here: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether the thing would still be at the kept place, and cannot be seen from here: looks say nothing then."""
        if self.kept is None or not self._agrees(now, self.kept - here, ahead):
            return False
        return self.ground.sight(here, self.kept) < OPEN_SIGHT

    def target(self, now: Situation, here: np.ndarray, ahead: np.ndarray) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, as believed; None if the body has been there in vain.

        The way to it is kept until the belief moves away from it.
        """
        kept = self.kept if self.kept is not None and self._agrees(now, self.kept - here, ahead) else None
        if kept is None:
            self.tried, self.held = [], 0
            kept = here + (now.distance if now.distance is not None else self.ground.free(here, ahead, RANGE)) * ahead
        if self._in_vain(kept) and now.distance is None:
            kept = here + RANGE * ahead  # not in front of the next obstacle: behind it
        self.kept = kept
        return None if self._in_vain(kept) else kept

    def beside(self, target: np.ndarray, ways: Ways, here: np.ndarray, sure: bool) -> tuple[int, int] | None:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not `sure`, or nothing stands between it and here.
        """
        end = ways.nearest(target, self.tried)
        if end is not None and float(np.hypot(*(self.ground.known.centres(np.array(end)) - here))) < REACHED:
            self.tried.append(here)
            there = sure and self.ground.sight(here, target) < OPEN_SIGHT
            end = ways.nearest(target, self.tried) if there else None
        if end is None or self.held > PATIENCE:
            self.vain.append(target)
            return None
        return end

    def feel(self, before: np.ndarray, meant: np.ndarray, here: np.ndarray, step: float) -> None:
        """Learn from a step: something stands where the body was held up."""
        lost = held_back(before, meant, here, step)
        if lost is None:
            return
        self.held += 1
        normal = lost / float(np.hypot(*lost))
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * step * normal
        beside = np.linspace(-HALF, HALF, 3)[None, :, None] * along
        points = (here + ahead + beside).reshape(-1, 2)
        self.ground.known.held_up(
            points[np.any(self.ground.known.cells(points) != self.ground.known.cells(here), axis=1)]
        )

    def _in_vain(self, place: np.ndarray) -> bool:
        return any(float(np.hypot(*(place - other))) < NEAR for other in self.vain)

    def _agrees(self, now: Situation, to: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether what is believed now still means the place `to` ``(2,)`` metres from here."""
        away = float(np.hypot(*to))
        if now.distance is not None and abs(math.log(max(now.distance, 0.1) / max(away, 0.1))) > FARTHER:
            return False
        return float(to @ ahead) > math.cos(ALIKE) * away
