"""A searcher: while nothing is believed it takes the look that tells most for what it costs, then it goes to the thing.

Where looks may go is its *space* (`eagor.tasks.looks.Space`): the ground around a body that walks (`searched_ground`),
or the directions around a camera that only turns (`eagor.tasks.hstar.search`). The decision is the same: the thing is
believed to be there if going to it is likely to bring it nearer; if not, the next look is the one with the best ratio
of nats to its cost. What was chosen is kept until it is reached, or not worth it any more.

A body uses odometry, touch, and the floor that looks show. It begins to walk to the thing when that is likely to bring
it nearer. It goes on although looks miss the thing, as long as that may be hidden from here (`approach`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.sphere import heading
from eagor.tasks.approach import REACHED, Approach
from eagor.tasks.floor_seen import FLOOR, FloorSeen
from eagor.tasks.floor_ways import Ways
from eagor.tasks.looks import Space
from eagor.tasks.searched_ground import AZIMUTHS, SearchedGround
from eagor.tasks.situation import Situation

NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
FACED = 1e-6  # radians
STANDING = 0.25  # metres that a standing body counts for a step of a turn
EVERY = 3  # cells between the places that are weighed


@dataclass
class Searcher:
    """Chooses looks and steps for one episode. `step` and `radius` in metres.

    `handover`: metres nearer, as believed, per metre walked along the answer that make it worth following; of a camera
    that only turns, the probability from which on it acts. `hfov`: what the camera sees across, straight ahead,
    radians. If that is not all around, the body turns at most `turn` radians in a step, looks around before it walks as
    long as that tells more for the time, and walks ahead only. A body that stands has the step 0: it only turns.

    `space`: where looks may go; None: the ground around a body, which only `walk` and `look` need. `faced`: radians to
    a heading that has been reached; `nearer`: what a radian less to turn is worth, in nats per metre, beyond its time.
    """

    step: float
    radius: float = 0.18
    handover: float = 0.2
    hfov: float = 2 * math.pi
    turn: float = math.radians(30)
    space: Space | None = None
    faced: float = FACED
    nearer: float = 0.0
    searching: bool = True
    looks_down: bool = True
    ground: SearchedGround = field(init=False)
    _approach: Approach = field(init=False)
    _goal: np.ndarray | None = None
    _facing: np.ndarray | None = None  # a heading to turn to: azimuth and elevation, world frame
    _promise: float = 0.0
    _last: tuple[np.ndarray, np.ndarray] | None = None

    def __post_init__(self) -> None:
        self.ground = SearchedGround(self.hfov)
        self._approach = Approach(self.ground)

    @property
    def known(self) -> FloorSeen:
        """What looks have shown of the floor."""
        return self.ground.known

    def face(self, facing: np.ndarray, likely: float) -> np.ndarray | None:
        """Where a camera that only turns looks next: azimuth and elevation ``(2,)``, radians, world frame.

        `facing` ``(2,)``: where it looks now; `likely`: the probability that to act on what is believed succeeds. None:
        that is `handover` or more.
        """
        self.searching = likely < self.handover
        if not self.searching:
            self._facing = None
            return None
        if self._kept(facing) is None:
            self._facing = self._most_telling(facing)[0]
        return self._facing

    def walk(self, now: Situation) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        here, yaw = np.array(now.position[:2], dtype=np.float64), heading(now.world_R_body)
        self.look(now)
        if self._last is not None:
            self._approach.feel(*self._last, here, self.step)
        bearing = now.azimuth + yaw
        ahead = np.array([math.cos(bearing), math.sin(bearing)])
        target = self._approach.target(now, here, ahead) if self._believes(now, here, ahead) else None
        self.searching = target is None
        if target is not None:
            self._goal = self._facing = None
            self.known.cover(np.minimum(here, target) - 1.0, np.maximum(here, target) + 1.0)
        ways = Ways.over(self.known, self.radius, here)
        end = None if target is None else self._approach.beside(target, ways, here, now.distance is not None)
        if end is None:
            end = self._search(ways.metres, here, yaw, ahead)
        if end is None or not self.step:
            aim, metres = bearing if self._facing is None else float(self._facing[0]), 0.0
        else:
            way = ways.first(end)
            aim, metres = math.atan2(way[1], way[0]), self.step
        turn = math.remainder(aim - yaw, 2 * math.pi)
        if not self.ground.around and abs(turn) > self.turn + 1e-9:
            turn, metres = math.copysign(self.turn, turn), 0.0
        self._last = (here, metres * np.array([math.cos(aim), math.sin(aim)])) if metres else None
        return turn, metres

    def look(self, now: Situation) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing."""
        self.ground.look(now, self.radius)

    def _believes(self, now: Situation, here: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether the body goes where the thing should be.

        It begins to when the thing is likely there, and goes on while the thing would be there if it is here at all,
        and cannot be seen from here: looks that miss it then say nothing about it.
        """
        if now.progress * now.presence >= self.handover:
            return True
        if self.searching or now.progress < self.handover:
            return False
        return self._approach.goes_on(now, here, ahead)

    def _search(self, metres: np.ndarray, here: np.ndarray, yaw: float, ahead: np.ndarray) -> tuple[int, int] | None:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one.

        None: rather turn, to `_facing`.
        """
        known, facing = self.known, np.array([yaw, 0.0])
        if self._kept(facing) is not None:
            return None
        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - here))) < REACHED:
                if self.ground.around:
                    self.ground.looked(self._goal, yaw)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres, here)[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        self._goal = None
        rows, cols = np.nonzero(known.state == FLOOR)
        kept = (rows % EVERY == 0) & (cols % EVERY == 0) & np.isfinite(metres[rows, cols])
        cells = np.stack([rows[kept], cols[kept]], axis=-1)
        if not self.ground.around:
            cells = cells[np.hypot(*(known.centres(cells) - here).T) > REACHED]
        worth = self._worth(cells, metres, here) if self.step else np.zeros(0)
        promise = float(worth.max(initial=0.0))
        if not self.ground.around:
            found, told = self._most_telling(facing)
            if told >= promise:
                self._facing = found
                return None
        if not len(worth):
            row, col = known.cells(here + ahead)
            return int(row), int(col)
        best = int(worth.argmax())
        self._goal, self._promise = known.centres(cells[best]), promise
        return int(cells[best, 0]), int(cells[best, 1])

    def _kept(self, facing: np.ndarray) -> np.ndarray | None:
        """The heading that was chosen, until it has been reached."""
        if self._facing is not None and float(_apart(self._facing, facing)) <= self.faced:
            self._facing = None
        return self._facing

    def _most_telling(self, facing: np.ndarray) -> tuple[np.ndarray, float]:
        """The heading ``(2,)`` that tells most from here for the turn, and its nats per metre walked instead."""
        space = self.ground if self.space is None else self.space
        headings = space.headings
        apart = _apart(headings, facing)
        worth = space.tells() / (self._turning(apart) + NEAREST_GOAL)
        if math.isfinite(self.turn):  # a step that turns by nothing would cost nothing
            worth[apart <= self.faced] = 0.0
        best = int((worth - self.nearer * apart).argmax())
        return headings[best], float(worth[best])

    def _turning(self, angles: np.ndarray) -> np.ndarray:
        """Metres that one could walk in the time that it takes to turn by angles (radians, 0 or more)."""
        return np.ceil(angles / self.turn - 1e-9) * (self.step or STANDING)

    def _worth(self, cells: np.ndarray, metres: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        told, cost = self.ground.tells_at(cells), metres[cells[:, 0], cells[:, 1]] + NEAREST_GOAL
        if self.ground.around:
            return told[:, 0] / cost
        to = self.known.centres(cells) - here  # as it arrives, it faces away from here; then it turns
        away = np.abs(np.remainder(AZIMUTHS - np.arctan2(to[:, 1], to[:, 0])[:, None] + math.pi, 2 * math.pi) - math.pi)
        return (told / (cost[:, None] + self._turning(away))).max(axis=1)


def _apart(headings: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Radians ``(...)`` from `facing` ``(2,)`` to headings ``(..., 2)``: pan (azimuth) and tilt, added."""
    pan = np.abs(np.remainder(headings[..., 0] - facing[0] + math.pi, 2 * math.pi) - math.pi)
    return pan + np.abs(headings[..., 1] - facing[1])
