"""A body that searches: while nothing is believed it goes where looks would tell most per metre, then to the thing.

It uses odometry, touch, and the floor that looks show (`floor_seen`); no map is given and no depth is read. A place is
worth going to for what could be seen from there: ground that no look has shown, as far as it may go on, and ground that
was looked at but where the perception may have missed the thing. The best ratio of that to the way is the next goal
(a frontier search; Yamauchi, 1997, with expected information as in Bourgault et al., 2002).

The body begins to walk to the thing when that is likely to bring it nearer. It goes on although looks miss the thing,
as long as that may be hidden from here, by the floor that is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from eagor.sphere import heading
from eagor.tasks.floor_seen import CELL, CONTACT, FLOOR, THICK, UNKNOWN, FloorSeen
from eagor.tasks.floor_ways import NEAR, Ways
from eagor.tasks.looks import information
from eagor.tasks.policy import held_back
from eagor.tasks.situation import Situation

HALF = 0.1  # metres to each side of the way on which it was held up: there it would be, too
RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 160  # rays about the body itself
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
REACHED = 0.3  # metres from a goal
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
RANGE = 5.0  # metres to a target whose distance is unknown
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place
EVERY = 3  # cells between the places that are weighed


@dataclass
class Searcher:
    """Chooses headings for one episode. `step` and `radius` in metres; `recall`: probability that a look finds.

    `handover`: metres nearer, as believed, per metre walked along the answer that make it worth following.
    """

    step: float
    radius: float = 0.18
    handover: float = 0.2
    recall: float = 0.5
    known: FloorSeen = field(default_factory=FloorSeen)
    searching: bool = True
    looks_down: bool = True
    _goal: np.ndarray | None = None
    _promise: float = 0.0
    _last: tuple[np.ndarray, np.ndarray] | None = None
    _kept: np.ndarray | None = None  # where the thing should be
    _tried: list[np.ndarray] = field(default_factory=list)  # where the body stood beside that place, and was not there
    _vain: list[np.ndarray] = field(default_factory=list)  # where it should have been, and was not

    def heading(self, now: Situation) -> float:
        """The heading to walk in, radians from straight ahead, in (-pi, pi]."""
        here, yaw = np.array(now.position[:2], dtype=np.float64), heading(now.world_R_body)
        self.look(now)
        if self._last is not None:
            self._feel(*self._last, here)
        bearing = now.azimuth + yaw
        ahead = np.array([math.cos(bearing), math.sin(bearing)])
        target = self._target(now, here, ahead) if self._believes(now, here, ahead) else None
        self.searching = target is None
        if target is not None:
            self._goal = None
            self.known.cover(np.minimum(here, target) - 1.0, np.maximum(here, target) + 1.0)
        ways = Ways.over(self.known, self.radius, here)
        end = None if target is None else self._beside(target, ways, here, now.distance is not None)
        way = ways.first(self._search(ways.metres, here, ahead) if end is None else end)
        self._last = here, way * (self.step / max(np.hypot(*way), 1e-9))
        return math.remainder(math.atan2(way[1], way[0]) - yaw, 2 * math.pi)

    def look(self, now: Situation) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing."""
        here = np.array(now.position[:2], dtype=np.float64)
        assert now.floor is not None
        self.known.look(now.floor, now.world_R_body, now.position)
        self.known.walked(here, self.radius)
        self._looked(here)

    def _believes(self, now: Situation, here: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether the body goes where the thing should be.

        It begins to when the thing is likely there, and goes on while the thing would be there if it is here at all,
        and cannot be seen from here: looks that miss it then say nothing about it.
        """
        if now.progress * now.presence >= self.handover:
            return True
        kept = None if self.searching else self._kept
        if kept is None or now.progress < self.handover or not self._agrees(now, kept - here, ahead):
            return False
        return self._sight(here, kept) < OPEN_SIGHT

    def _sight(self, here: np.ndarray, there: np.ndarray) -> float:
        """The probability that nothing hides `there` ``(2,)`` from `here`, by the floor that is known."""
        away = float(np.hypot(*(there - here)))
        at = np.arange(CELL, max(away - THICK, 0.0), CELL)[:, None] / max(away, CELL)
        cells = self.known.cells(here + at * (there - here))
        inside = self.known.inside(cells)
        rows, cols = cells[inside].T
        return float(np.exp(-VEIL[self.known.state[rows, cols]].sum() - VEIL[UNKNOWN] * (~inside).sum()))

    def _target(self, now: Situation, here: np.ndarray, ahead: np.ndarray) -> np.ndarray | None:
        """Where the thing should be ``(2,)``, as believed; None if the body has been there in vain.

        The way to it is kept until the belief moves away from it.
        """
        kept = self._kept if self._kept is not None and self._agrees(now, self._kept - here, ahead) else None
        if kept is None:
            self._tried = []
            kept = here + (now.distance if now.distance is not None else self._free(here, ahead)) * ahead
        if self._in_vain(kept) and now.distance is None:
            kept = here + RANGE * ahead  # not in front of the next obstacle: behind it
        self._kept = kept
        return None if self._in_vain(kept) else kept

    def _beside(self, target: np.ndarray, ways: Ways, here: np.ndarray, sure: bool) -> tuple[int, int] | None:
        """The cell from which to come to the target: another one than where the body stood and did not meet it.

        None if there is no other: where the target's distance is not `sure`, or nothing stands between it and here.
        """
        end = ways.nearest(target, self._tried)
        if end is not None and float(np.hypot(*(self.known.centres(np.array(end)) - here))) < REACHED:
            self._tried.append(here)
            there = sure and self._sight(here, target) < OPEN_SIGHT
            end = ways.nearest(target, self._tried) if there else None
        if end is None:
            self._vain.append(target)
        return end

    def _in_vain(self, place: np.ndarray) -> bool:
        return any(float(np.hypot(*(place - other))) < NEAR for other in self._vain)

    def _agrees(self, now: Situation, to: np.ndarray, ahead: np.ndarray) -> bool:
        """Whether what is believed now still means the place `to` ``(2,)`` metres from here."""
        away = float(np.hypot(*to))
        if now.distance is not None and abs(math.log(max(now.distance, 0.1) / max(away, 0.1))) > FARTHER:
            return False
        return float(to @ ahead) > math.cos(ALIKE) * away

    def _free(self, here: np.ndarray, ahead: np.ndarray) -> float:
        """Metres to where something stands first in a direction, as far as is known; `RANGE` if nothing does."""
        metres = np.arange(0.3, RANGE, CELL / 2)
        cells = self.known.cells(here + metres[:, None] * ahead)
        inside = self.known.inside(cells)
        cells = np.where(inside[:, None], cells, 0)
        stands = inside & (self.known.state[cells[:, 0], cells[:, 1]] == CONTACT)
        return float(metres[stands.argmax()]) if stands.any() else RANGE

    def _feel(self, before: np.ndarray, meant: np.ndarray, here: np.ndarray) -> None:
        """Learn from a step: something stands where the body was held up."""
        lost = held_back(before, meant, here, self.step)
        if lost is None:
            return
        normal = lost / float(np.hypot(*lost))
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * self.step * normal
        beside = np.linspace(-HALF, HALF, 3)[None, :, None] * along
        points = (here + ahead + beside).reshape(-1, 2)
        self.known.held_up(points[np.any(self.known.cells(points) != self.known.cells(here), axis=1)])

    def _search(self, metres: np.ndarray, here: np.ndarray, ahead: np.ndarray) -> tuple[int, int]:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one."""
        known = self.known
        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - here))) < REACHED:
                self._looked(self._goal)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres)[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        rows, cols = np.nonzero(known.state == FLOOR)
        kept = (rows % EVERY == 0) & (cols % EVERY == 0) & np.isfinite(metres[rows, cols])
        cells = np.stack([rows[kept], cols[kept]], axis=-1)
        if not len(cells):
            row, col = known.cells(here + ahead)
            return int(row), int(col)
        worth = self._worth(cells, metres)
        best = int(worth.argmax())
        self._goal, self._promise = known.centres(cells[best]), float(worth[best])
        return int(cells[best, 0]), int(cells[best, 1])

    def _worth(self, cells: np.ndarray, metres: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        return self._tells(cells) / (metres[cells[:, 0], cells[:, 1]] + NEAREST_GOAL)

    def _tells(self, cells: np.ndarray) -> np.ndarray:
        """What a look from each of the cells ``(n, 2)`` is expected to tell, nats ``(n,)``: the thing is somewhere."""
        _, worth, reached = self._reached(cells, RAYS)
        here = worth * (_rays(RAYS)[1] / (self.known.worth.sum() * CELL**2))
        return information(here.reshape(len(cells), -1), self.recall * reached.reshape(len(cells), -1))

    def _reached(self, cells: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Along `count` rays from cells ``(n, 2)``: padded cells (flat), their worth, and how likely one sees them.

        All ``(n, count, k)``.
        """
        known, (rays, _) = self.known, _rays(count)
        veil = VEIL[np.pad(known.state, PAD)]
        width = veil.shape[1]
        flat = np.array([width, 1])
        index = ((cells + PAD) @ flat)[:, None, None] + rays @ flat
        dimmed = veil.take(index)
        reached = np.exp(dimmed - np.cumsum(dimmed, axis=2))
        return index, np.pad(known.worth, PAD, constant_values=1.0).take(index), reached

    def _looked(self, here: np.ndarray) -> None:
        """What could be seen from here has had its chance."""
        index, _, reached = self._reached(self.known.cells(here)[None], FINE)
        rows, cols = self.known.state.shape
        seen = np.zeros((rows + 2 * PAD, cols + 2 * PAD))
        np.maximum.at(seen.reshape(-1), index.reshape(-1), reached.reshape(-1))
        self.known.worth *= 1 - self.recall * seen[PAD:-PAD, PAD:-PAD]


@lru_cache(maxsize=2)
def _rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets ``(count, n, 2)`` of the cells along rays, and the square metres ``(n,)`` for which each stands."""
    metres = (np.arange(int(SIGHT / CELL)) + 0.5) * CELL
    angles = (np.arange(count) + 0.5) * 2 * math.pi / count
    offsets = np.stack([np.sin(angles)[:, None] * metres, np.cos(angles)[:, None] * metres], axis=-1)
    return np.round(offsets / CELL).astype(np.intp), 2 * math.pi / count * metres * CELL
