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
from eagor.tasks.looks import Chance, information
from eagor.tasks.policy import held_back
from eagor.tasks.situation import Situation

HALF = 0.1  # metres to each side of the way on which it was held up: there it would be, too
RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 7 * RAYS  # rays about the body itself, the others among them: what they reach has been looked at
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
OPEN_SIGHT = 0.5  # of sight that is left: looks that miss the thing then count
PATIENCE = 30  # times that the body is held up on its way to a place before it gives it up
NEAREST_GOAL = 0.8  # metres added to the way to a goal: a goal next to the body is not worth everything
REACHED = 0.3  # metres from a goal
WORTH = 0.4  # a goal is given up when it is worth less than this share of what it promised, per metre left
RANGE = 5.0  # metres to a target whose distance is unknown
ALIKE, FARTHER = math.radians(25), 0.3  # a belief that changes by less (distance: its logarithm) means the same place
FACED = 1e-6  # radians
STANDING = 0.25  # metres that a standing body counts for a step of a turn
EVERY = 3  # cells between the places that are weighed


@dataclass
class Searcher:
    """Chooses steps for one episode. `step` and `radius` in metres.

    `handover`: metres nearer, as believed, per metre walked along the answer that make it worth following. `hfov`: what
    the camera sees across, straight ahead, radians. If that is not all around, the body turns at most `turn` radians
    in a step, looks around before it walks as long as that tells more for the time, and walks ahead only. A body that
    stands has the step 0: it only turns.
    """

    step: float
    radius: float = 0.18
    handover: float = 0.2
    hfov: float = 2 * math.pi
    turn: float = math.radians(30)
    known: FloorSeen = field(default_factory=FloorSeen)
    searching: bool = True
    looks_down: bool = True
    _goal: np.ndarray | None = None
    _chance: Chance = field(default_factory=Chance)
    _from: np.ndarray | None = None  # where the last look was taken
    _facing: float | None = None  # a heading to turn to, world frame
    _promise: float = 0.0
    _last: tuple[np.ndarray, np.ndarray] | None = None
    _kept: np.ndarray | None = None  # where the thing should be
    _tried: list[np.ndarray] = field(default_factory=list)  # where the body stood beside that place, and was not there
    _vain: list[np.ndarray] = field(default_factory=list)  # where it should have been, and was not
    _held: int = 0  # times held up on the way there

    @property
    def around(self) -> bool:
        """Whether the camera sees all around."""
        return self.hfov >= 2 * math.pi

    def walk(self, now: Situation) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        here, yaw = np.array(now.position[:2], dtype=np.float64), heading(now.world_R_body)
        self.look(now)
        if self._last is not None:
            self._feel(*self._last, here)
        bearing = now.azimuth + yaw
        ahead = np.array([math.cos(bearing), math.sin(bearing)])
        target = self._target(now, here, ahead) if self._believes(now, here, ahead) else None
        self.searching = target is None
        if target is not None:
            self._goal = self._facing = None
            self.known.cover(np.minimum(here, target) - 1.0, np.maximum(here, target) + 1.0)
        ways = Ways.over(self.known, self.radius, here)
        end = None if target is None else self._beside(target, ways, here, now.distance is not None)
        if end is None:
            end = self._search(ways.metres, here, yaw, ahead)
        if end is None or not self.step:
            aim, metres = bearing if self._facing is None else self._facing, 0.0
        else:
            way = ways.first(end)
            aim, metres = math.atan2(way[1], way[0]), self.step
        turn = math.remainder(aim - yaw, 2 * math.pi)
        if not self.around and abs(turn) > self.turn + 1e-9:
            turn, metres = math.copysign(self.turn, turn), 0.0
        self._last = (here, metres * np.array([math.cos(aim), math.sin(aim)])) if metres else None
        return turn, metres

    def look(self, now: Situation) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing."""
        here = np.array(now.position[:2], dtype=np.float64)
        assert now.floor is not None
        self.known.look(now.floor, now.world_R_body, now.position, now.seen)
        self.known.walked(here, self.radius)
        if now.chance is None:
            return
        moved = 0.0 if self._from is None else float(np.hypot(*(here - self._from)))
        self._chance, self._from = now.chance, here
        self.known.looked *= now.chance.repeating.left(now.chance.elapsed, moved)
        self._looked(here, heading(now.world_R_body))

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
            self._tried, self._held = [], 0
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
        if end is None or self._held > PATIENCE:
            self._vain.append(target)
            return None
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
        self._held += 1
        normal = lost / float(np.hypot(*lost))
        along = np.array([-normal[1], normal[0]])
        ahead = np.linspace(0.5, 1.2, 3)[:, None, None] * self.step * normal
        beside = np.linspace(-HALF, HALF, 3)[None, :, None] * along
        points = (here + ahead + beside).reshape(-1, 2)
        self.known.held_up(points[np.any(self.known.cells(points) != self.known.cells(here), axis=1)])

    def _search(self, metres: np.ndarray, here: np.ndarray, yaw: float, ahead: np.ndarray) -> tuple[int, int] | None:
        """The cell to go to while nothing is believed: the old goal as long as it is worth it, or the best one.

        None: rather turn, to `_facing`.
        """
        known = self.known
        if self._facing is not None:
            if abs(math.remainder(self._facing - yaw, 2 * math.pi)) > FACED:
                return None
            self._facing = None
        if self._goal is not None:
            cell = known.cells(self._goal)
            if float(np.hypot(*(self._goal - here))) < REACHED:
                if self.around:
                    self._looked(self._goal, yaw)  # as good as there: steps end a little beside it
            elif self._worth(cell[None], metres, here)[0] > WORTH * self._promise and known.state[tuple(cell)] <= FLOOR:
                return int(cell[0]), int(cell[1])
        self._goal = None
        rows, cols = np.nonzero(known.state == FLOOR)
        kept = (rows % EVERY == 0) & (cols % EVERY == 0) & np.isfinite(metres[rows, cols])
        cells = np.stack([rows[kept], cols[kept]], axis=-1)
        if not self.around:
            cells = cells[np.hypot(*(known.centres(cells) - here).T) > REACHED]
        worth = self._worth(cells, metres, here) if self.step else np.zeros(0)
        promise = float(worth.max(initial=0.0))
        if not self.around:
            facing, told = self._best_turn(here, yaw)
            if told >= promise:
                self._facing = facing
                return None
        if not len(worth):
            row, col = known.cells(here + ahead)
            return int(row), int(col)
        best = int(worth.argmax())
        self._goal, self._promise = known.centres(cells[best]), promise
        return int(cells[best, 0]), int(cells[best, 1])

    def _best_turn(self, here: np.ndarray, yaw: float) -> tuple[float, float]:
        """The heading that tells most from here, and its nats per metre that one could have walked instead."""
        worth = self._tells(self.known.cells(here)[None])[0] / (self._turning(HEADINGS - yaw) + NEAREST_GOAL)
        worth[np.abs(np.remainder(HEADINGS - yaw + math.pi, 2 * math.pi) - math.pi) <= FACED] = 0.0
        best = int(worth.argmax())
        return float(HEADINGS[best]), float(worth[best])

    def _turning(self, angles: np.ndarray) -> np.ndarray:
        """Metres that one could walk in the time that it takes to turn by angles (radians)."""
        apart = np.abs(np.remainder(angles + math.pi, 2 * math.pi) - math.pi)
        return np.ceil(apart / self.turn - 1e-9) * (self.step or STANDING)

    def _worth(self, cells: np.ndarray, metres: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Nats ``(n,)`` that a look from each of the cells ``(n, 2)`` is expected to tell, per metre of the way."""
        told, cost = self._tells(cells), metres[cells[:, 0], cells[:, 1]] + NEAREST_GOAL
        if self.around:
            return told[:, 0] / cost
        to = self.known.centres(cells) - here  # as it arrives, it faces away from here; then it turns
        return (told / (cost[:, None] + self._turning(HEADINGS - np.arctan2(to[:, 1], to[:, 0])[:, None]))).max(axis=1)

    def _tells(self, cells: np.ndarray) -> np.ndarray:
        """What looks from the cells ``(n, 2)`` are expected to tell, nats: the thing is somewhere on the ground.

        ``(n, 1)`` for a camera that sees all around, else one ``(n, RAYS)`` for each of `HEADINGS`: what single rays
        tell, added up, as each is likely to find nothing.
        """
        index, reached = self._reached(cells, RAYS)
        here = _padded(self.known.worth, 1.0).take(index) * (_rays(RAYS)[1] / (self.known.worth.sum() * CELL**2))
        share = _padded(self._finds(), self._chance.recall).take(index) * reached
        if self.around:
            return information(here.reshape(len(cells), -1), share.reshape(len(cells), -1))[:, None]
        length = here.shape[-1]
        each = information(here.reshape(-1, length), share.reshape(-1, length)).reshape(-1, RAYS)
        return each @ self._in_view(RAYS, HEADINGS).T

    def _in_view(self, count: int, headings: np.ndarray) -> np.ndarray:
        """Which of `count` rays ``(..., count)`` a camera shows that faces `headings` ``(...)``, 1 or 0."""
        off = _angles(count) - np.asarray(headings)[..., None]
        return (np.abs(np.remainder(off + math.pi, 2 * math.pi) - math.pi) <= self.hfov / 2).astype(np.float64)

    def _finds(self) -> np.ndarray:
        """The probability ``(rows, cols)`` that a look finds a thing there, in full sight, after those that missed it.

        Of what repeats the mistakes of earlier looks only the share 1 - repeats tells something, as in a belief.
        """
        return 1 - (1 - self._chance.recall) ** (1 - self._chance.repeating.share * self.known.looked)

    def _reached(self, cells: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Along `count` rays from cells ``(n, 2)``: padded cells (flat), and how likely one sees them.

        Both ``(n, count, k)``.
        """
        known, (rays, _) = self.known, _rays(count)
        veil = VEIL[np.pad(known.state, PAD)]
        width = veil.shape[1]
        flat = np.array([width, 1])
        index = ((cells + PAD) @ flat)[:, None, None] + rays @ flat
        dimmed = veil.take(index)
        reached = np.exp(dimmed - np.cumsum(dimmed, axis=2))
        return index, reached

    def _looked(self, place: np.ndarray, yaw: float) -> None:
        """What could be seen from a place, facing `yaw`, has had its chance."""
        index, reached = self._reached(self.known.cells(place)[None], FINE)
        reached = reached * self._in_view(FINE, np.array(yaw))[:, None]
        rows, cols = self.known.state.shape
        seen = np.zeros((rows + 2 * PAD, cols + 2 * PAD))
        np.maximum.at(seen.reshape(-1), index.reshape(-1), reached.reshape(-1))
        seen = seen[PAD:-PAD, PAD:-PAD]
        self.known.worth *= 1 - self._finds() * seen
        np.maximum(self.known.looked, seen, out=self.known.looked)


def _padded(cells: np.ndarray, around: float) -> np.ndarray:
    return np.pad(cells, PAD, constant_values=around)


def _angles(count: int) -> np.ndarray:
    """The world's azimuths ``(count,)`` of as many rays around a place."""
    return (np.arange(count) + 0.5) * 2 * math.pi / count


@lru_cache(maxsize=2)
def _rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets ``(count, n, 2)`` of the cells along rays, and the square metres ``(n,)`` for which each stands."""
    metres = (np.arange(int(SIGHT / CELL)) + 0.5) * CELL
    angles = _angles(count)
    offsets = np.stack([np.sin(angles)[:, None] * metres, np.cos(angles)[:, None] * metres], axis=-1)
    return np.round(offsets / CELL).astype(np.intp), 2 * math.pi / count * metres * CELL


HEADINGS = np.arange(RAYS) * 2 * math.pi / RAYS  # that a camera which does not see all around may face
