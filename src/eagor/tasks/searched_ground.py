"""The ground about a body that searches: what looks showed of it, what they could see, and what more looks would tell.

The thing stands somewhere on the ground. A look is worth taking for what it shows: ground that no look has shown, as
far as it may go on, and ground that was looked at but where the perception may have missed the thing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from eagor.tasks.floor_seen import CELL, FLOOR, THICK, UNKNOWN, FloorSeen
from eagor.tasks.looks import Chance, apart, information
from eagor.tasks.situation import Situation

RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 7 * RAYS  # rays about the body itself, the others among them: what they reach has been looked at
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
EVERY = 3  # cells between the places that are weighed
AHEAD = np.zeros((1, 2))  # the heading of a camera that sees all around: it need not turn
HEADINGS = np.column_stack([np.arange(RAYS) * 2 * math.pi / RAYS, np.zeros(RAYS)])  # those of any other camera


@dataclass
class SearchedGround:
    """The ground of one episode; an `eagor.tasks.looks.Space` about the body that stands on it.

    `radius`: of the body, metres. `hfov`: what its camera sees across, straight ahead, radians; 2 pi: all around.
    `here` ``(2,)``: where the body is, metres, world frame. Cells ``(..., 2)`` are rows and columns of `known`.
    """

    radius: float = 0.18
    hfov: float = 2 * math.pi
    known: FloorSeen = field(default_factory=FloorSeen)
    here: np.ndarray = field(default_factory=lambda: np.zeros(2))
    _chance: Chance = field(default_factory=Chance)
    _from: np.ndarray | None = None  # where the last look was taken that could be read

    @property
    def around(self) -> bool:
        """Whether the camera sees all around."""
        return self.hfov >= 2 * math.pi

    @property
    def headings(self) -> np.ndarray:
        """The headings ``(n, 2)`` that the camera may face, radians, world frame: level ones."""
        return AHEAD if self.around else HEADINGS

    def look(self, now: Situation) -> None:
        """Take in what a look shows of the floor, and that it had its chance to find the thing."""
        here = self.here = now.here
        assert now.floor is not None
        self.known.look(now.floor, now.world_R_body, now.position, now.seen)
        self.known.walked(here, self.radius)
        if now.chance is None:
            return
        moved = 0.0 if self._from is None else float(np.hypot(*(here - self._from)))
        self._chance, self._from = now.chance, here
        self.known.looked *= now.chance.left(moved)
        self.looked_from(here, now.yaw)

    def looked_from(self, place: np.ndarray, yaw: float) -> None:
        """What can be seen from a place ``(2,)``, facing the azimuth `yaw`, has had its chance."""
        index, reached = self._reached(self.known.cells(place)[None], FINE)
        reached = reached * self._in_view(FINE, np.array(yaw))[:, None]
        rows, cols = self.known.state.shape
        seen = np.zeros((rows + 2 * PAD, cols + 2 * PAD))
        np.maximum.at(seen.reshape(-1), index.reshape(-1), reached.reshape(-1))
        seen = seen[PAD:-PAD, PAD:-PAD]
        self.known.worth *= 1 - self._finds() * seen
        np.maximum(self.known.looked, seen, out=self.known.looked)

    def tells(self) -> np.ndarray:
        """What looks from here at each of the headings ``(n,)`` are expected to tell, nats."""
        return self.tells_from(self.known.cells(self.here)[None])[0]

    def tells_from(self, cells: np.ndarray) -> np.ndarray:
        """What looks from cells ``(m, 2)`` at each of the headings ``(m, n)`` are expected to tell, nats.

        For a camera that does not see all around: what single rays tell, added up, as each is likely to find nothing.
        """
        index, reached = self._reached(cells, RAYS)
        here = _padded(self.known.worth, 1.0).take(index) * (_rays(RAYS)[1] / (self.known.worth.sum() * CELL**2))
        share = _padded(self._finds(), self._chance.recall).take(index) * reached
        if self.around:
            return information(here.reshape(len(cells), -1), share.reshape(len(cells), -1))[:, None]
        length = here.shape[-1]
        each = information(here.reshape(-1, length), share.reshape(-1, length)).reshape(-1, RAYS)
        return each @ self._in_view(RAYS, HEADINGS[:, 0]).T

    def places(self) -> np.ndarray:
        """Cells ``(m, 2)`` of the known floor from which one may look: not all of them, but evenly spread."""
        rows, cols = np.nonzero(self.known.state == FLOOR)
        kept = (rows % EVERY == 0) & (cols % EVERY == 0)
        return np.stack([rows[kept], cols[kept]], axis=-1)

    def sight(self, there: np.ndarray) -> float:
        """The probability that nothing hides a place ``(2,)`` from here, by the floor that is known."""
        here, away = self.here, float(np.hypot(*(there - self.here)))
        at = np.arange(CELL, max(away - THICK, 0.0), CELL)[:, None] / max(away, CELL)
        cells = self.known.cells(here + at * (there - here))
        inside = self.known.inside(cells)
        rows, cols = cells[inside].T
        return float(np.exp(-VEIL[self.known.state[rows, cols]].sum() - VEIL[UNKNOWN] * (~inside).sum()))

    def _in_view(self, count: int, azimuths: np.ndarray) -> np.ndarray:
        """Which of `count` rays ``(..., count)`` a camera shows that faces `azimuths` ``(...)``, 1 or 0."""
        off = _angles(count) - np.asarray(azimuths)[..., None]
        return (apart(off) <= self.hfov / 2).astype(np.float64)

    def _finds(self) -> np.ndarray:
        """The probability ``(rows, cols)`` that a look finds a thing there, in full sight, after those that missed it.

        Of what repeats the mistakes of earlier looks only the share 1 - repeats tells something, as in a belief.
        """
        return 1 - (1 - self._chance.recall) ** (1 - self._chance.repeats * self.known.looked)

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
