"""A search: while nothing is believed it looks where that tells most for what it costs; then it acts on the belief.

One searcher drives a camera that only turns, such as the views of H*Bench (`Searcher.face`), and a body that stands or
walks (`Searcher.walk`). The latter uses odometry, touch, and the floor that looks show; no map is given and no depth is
read. A look from another place costs the way there; the best ratio is the next goal (a frontier search; Yamauchi, 1997,
with expected information as in Bourgault et al., 2002).

The body begins to walk to the thing when that is likely to bring it nearer. It goes on although looks miss the thing,
as long as that may be hidden from here, by the floor that is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from eagor.tasks.approach import REACHED, Approach
from eagor.tasks.floor_seen import FLOOR, FloorSeen
from eagor.tasks.floor_ways import Ways
from eagor.tasks.looks import Space, apart, turned
from eagor.tasks.searched_ground import SearchedGround
from eagor.tasks.situation import Situation

NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
FACED = 1e-6  # radians
STANDING = 0.25  # metres that a standing body counts for a step of a turn
NEARER = 1e-5  # nats per degree: where every turn costs the same, the nearest of looks that tell as much

Where = TypeVar("Where", bound=Space)


@dataclass
class Searcher(Generic[Where]):
    """Chooses looks and steps for one episode.

    `space`: what can be looked at; to walk, a `SearchedGround`. `step`: metres that the body walks in a step; 0: it
    stands, and only turns. `handover`: how sure a belief has to be to be acted on; of a body that walks, metres nearer,
    as believed, per metre walked along the answer. `turn`: radians that it turns in a step, at most; infinite: any turn
    takes one step, and so does another look the same way; a look from here then costs as much as a metre.

    A body whose camera does not see all around looks around before it walks, as long as that tells more for the time,
    and walks ahead only. `searching`: whether the last choice was made because too little is believed.
    """

    space: Where
    step: float = 0.0
    handover: float = 0.2
    turn: float = math.inf
    searching: bool = True
    looks_down: bool = True
    _facing: np.ndarray | None = None  # a heading to turn to
    _goal: np.ndarray | None = None  # a place to look from
    _promise: float = 0.0
    _last: tuple[np.ndarray, np.ndarray] | None = None  # where the last step began, and what it was meant to be
    _approach: Approach = field(default_factory=Approach)

    @property
    def known(self: Searcher[SearchedGround]) -> FloorSeen:
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

    def walk(self: Searcher[SearchedGround], now: Situation) -> tuple[float, float]:
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

    def _believes(self: Searcher[SearchedGround], now: Situation) -> bool:
        """Whether the body goes where the thing should be.

        It begins to when the thing is likely there, and goes on while the thing would be there if it is here at all,
        and cannot be seen from here: looks that miss it then say nothing about it.
        """
        if now.progress * now.presence >= self.handover:
            return True
        return not self.searching and now.progress >= self.handover and self._approach.hides(self.space, now)

    def _search(self: Searcher[SearchedGround], metres: np.ndarray, now: Situation) -> tuple[int, int] | None:
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
