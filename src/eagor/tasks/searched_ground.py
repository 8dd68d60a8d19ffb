"""The ground around a body that searches: what looks have shown of it, and what further looks would tell.

It is made of the floor that looks show (`floor_seen`); no map is given and no depth is read. A look is worth taking for
what it could see: ground that no look has shown, as far as it may go on, and ground that was looked at but where the
perception may have missed the thing (a frontier search; Yamauchi, 1997, with expected information as in Bourgault et
al., 2002).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from eagor.sphere import heading
from eagor.tasks.floor_seen import CELL, CONTACT, THICK, UNKNOWN, FloorSeen
from eagor.tasks.looks import Chance, information
from eagor.tasks.situation import Situation

RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 7 * RAYS  # rays about the body itself, the others among them: what they reach has been looked at
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
AZIMUTHS = np.arange(RAYS) * 2 * math.pi / RAYS  # that a camera which does not see all around may face


@dataclass
class SearchedGround:
    """The ground, for one episode; `here` ``(2,)``: where the last look was taken, metres, odometry.

    `hfov`: what the camera sees across, straight ahead, radians; 2 pi and more: all around.
    """

    hfov: float = 2 * math.pi
    known: FloorSeen = field(default_factory=FloorSeen)
    here: np.ndarray = field(default_factory=lambda: np.zeros(2))
    _chance: Chance = field(default_factory=Chance)
    _from: np.ndarray | None = None  # where the last look was taken that had a chance

    @property
    def around(self) -> bool:
        """Whether the camera sees all around."""
        return self.hfov >= 2 * math.pi

    @property
    def headings(self) -> np.ndarray:
        """Azimuth and elevation ``(RAYS, 2)``, radians, world frame, of the looks that are weighed."""
        return np.stack([AZIMUTHS, np.zeros(RAYS)], axis=-1)

    def tells(self) -> np.ndarray:
        """What a look along each of the `headings` from here is expected to tell, nats ``(RAYS,)``."""
        return np.broadcast_to(self.tells_at(self.known.cells(self.here)[None])[0], RAYS)

    def look(self, now: Situation, radius: float) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing.

        `radius`: of the body that stands there, metres.
        """
        here = self.here = np.array(now.position[:2], dtype=np.float64)
        assert now.floor is not None
        self.known.look(now.floor, now.world_R_body, now.position, now.seen)
        self.known.walked(here, radius)
        if now.chance is None:
            return
        moved = 0.0 if self._from is None else float(np.hypot(*(here - self._from)))
        self._chance, self._from = now.chance, here
        self.known.looked *= now.chance.repeating.left(now.chance.elapsed, moved)
        self.looked(here, heading(now.world_R_body))

    def sight(self, here: np.ndarray, there: np.ndarray) -> float:
        """The probability that nothing hides `there` ``(2,)`` from `here`, by the floor that is known."""
        away = float(np.hypot(*(there - here)))
        at = np.arange(CELL, max(away - THICK, 0.0), CELL)[:, None] / max(away, CELL)
        cells = self.known.cells(here + at * (there - here))
        inside = self.known.inside(cells)
        rows, cols = cells[inside].T
        return float(np.exp(-VEIL[self.known.state[rows, cols]].sum() - VEIL[UNKNOWN] * (~inside).sum()))

    def free(self, here: np.ndarray, ahead: np.ndarray, farthest: float) -> float:
        """Metres to where something stands first in a direction, as far as is known; `farthest` if nothing does."""
        metres = np.arange(0.3, farthest, CELL / 2)
        cells = self.known.cells(here + metres[:, None] * ahead)
        inside = self.known.inside(cells)
        cells = np.where(inside[:, None], cells, 0)
        stands = inside & (self.known.state[cells[:, 0], cells[:, 1]] == CONTACT)
        return float(metres[stands.argmax()]) if stands.any() else farthest

    def looked(self, place: np.ndarray, yaw: float) -> None:
        """What could be seen from a place, facing `yaw`, has had its chance."""
        index, reached = self._reached(self.known.cells(place)[None], FINE)
        reached = reached * self._in_view(FINE, np.array(yaw))[:, None]
        rows, cols = self.known.state.shape
        seen = np.zeros((rows + 2 * PAD, cols + 2 * PAD))
        np.maximum.at(seen.reshape(-1), index.reshape(-1), reached.reshape(-1))
        seen = seen[PAD:-PAD, PAD:-PAD]
        self.known.worth *= 1 - self._finds() * seen
        np.maximum(self.known.looked, seen, out=self.known.looked)

    def tells_at(self, cells: np.ndarray) -> np.ndarray:
        """What looks from the cells ``(n, 2)`` are expected to tell, nats: the thing is somewhere on the ground.

        ``(n, 1)`` for a camera that sees all around, else one ``(n, RAYS)`` for each of `AZIMUTHS`: what single rays
        tell, added up, as each is likely to find nothing.
        """
        index, reached = self._reached(cells, RAYS)
        here = _padded(self.known.worth, 1.0).take(index) * (_rays(RAYS)[1] / (self.known.worth.sum() * CELL**2))
        share = _padded(self._finds(), self._chance.recall).take(index) * reached
        if self.around:
            return information(here.reshape(len(cells), -1), share.reshape(len(cells), -1))[:, None]
        length = here.shape[-1]
        each = information(here.reshape(-1, length), share.reshape(-1, length)).reshape(-1, RAYS)
        return each @ self._in_view(RAYS, AZIMUTHS).T

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
