"""What a search knows, and what the next look is expected to tell about where a thing is: one measure for all searches.

The thing is in one of many cells: directions around a camera that only turns (`eagor.lab.tasks.hstar.search`), or
patches of the ground about a body (`SearchedGround`). Either is a `Space`. A look is worth taking for what it shows:
cells that no look has shown, and cells that were looked at but where the perception may have missed the thing. A search
takes the look that tells most for what it costs (`eagor.lab.agents.steering`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import numpy as np

from eagor._values import lazy
from eagor.conventions import rotation_from_wxyz
from eagor.evidence import Evidence
from eagor.evidence.detector import Habits
from eagor.lab.agents.floor_map import CELL, FLOOR, THICK, UNKNOWN, FloorMap
from eagor.lab.envs.places import Place, in_view
from eagor.lab.envs.rules import Camera
from eagor.sphere import heading, wrap
from eagor.tracking.looking import information

LEAST = 0.05  # recall: nobody looks with what finds less, whatever its calibration says
RAYS, SIGHT = 24, 3.0  # rays about a place from which it may look, and how far they go, metres
PAD = math.ceil(SIGHT / CELL) + 1  # cells around the grid
FINE = 7 * RAYS  # rays about the body itself, the others among them: what they reach has been looked at
OPEN = 1.5  # metres: how far one sees on average into what is unknown
VEIL = np.array([CELL / OPEN, 0.0, 50.0])  # log of the share of sight that is lost in a cell: unknown, floor, contact
EVERY = 3  # cells between the places that are weighed
AHEAD = np.zeros((1, 2))  # the heading of a camera that sees all around: it need not turn
HEADINGS = np.column_stack([np.arange(RAYS) * 2 * math.pi / RAYS, np.zeros(RAYS)])  # those of any other camera
MOST = 1000  # looks that are made again, some 3 ms each; of a longer way, so many of its poses


@dataclass(frozen=True)
class Chance:
    """What chance a look has to find what is in sight.

    `recall`: the probability that it reports it. `repeats`: the share of the mistakes of the look before that it
    repeats, which was taken `elapsed` seconds earlier: what was overlooked there is overlooked again. `habits`: of the
    detector, which fade with time and distance; None: nothing fades.
    """

    recall: float = 0.5
    repeats: float = 0.0
    habits: Habits | None = None
    elapsed: float = 0.0

    @classmethod
    def of(cls, evidence: Evidence, elapsed: float) -> Chance:
        """As the evidence itself has it, but `LEAST` at least.

        A detector's model states the recall, or a prior of it. Of a response, 1 - recall is the likelihood ratio where
        it reports nothing, which is most of what it covers. If that is 1 or more, silence says nothing.
        """
        if evidence.detections is not None:
            habits = evidence.detections.model.habits
            return cls(max(habits.mean, LEAST), habits.correlation, habits, elapsed)
        logs = np.asarray(evidence.log_ratio, dtype=np.float64)
        logs = logs if evidence.coverage is None else logs[evidence.coverage > 0.5]
        recall = -float(np.expm1(np.median(logs))) if logs.size else 0.0
        return cls(max(recall, LEAST), evidence.calibration.persistence, None, elapsed)

    def left(self, moved: float) -> float:
        """The share of the habits of places that is still the same `moved` metres after the look before."""
        return 1.0 if self.habits is None else 1 - self.habits.anew(self.elapsed, moved)


class Space(Protocol):
    """What a camera can look at from where it is, and what it has looked at so far."""

    @property
    def headings(self) -> np.ndarray:
        """The headings ``(n, 2)`` that it may face: azimuth and elevation, radians, world frame."""
        ...

    def tells(self) -> np.ndarray:
        """What a look at each of the headings ``(n,)`` is expected to tell about where the thing is, nats."""
        ...


def apart(angles: np.ndarray) -> np.ndarray:
    """The size of angles ``(...)``, the short way round, radians from 0 to pi."""
    return np.abs(wrap(angles))


def turned(headings: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """How far it is from `facing` ``(2,)`` to headings ``(..., 2)``, radians: in azimuth, and then in elevation."""
    return apart(headings[..., 0] - facing[0]) + np.abs(headings[..., 1] - facing[1])


@dataclass(frozen=True, eq=False)
class SteeringInput:
    """What is known at a step.

    - `azimuth` of the estimate, radians, body frame; `progress`: metres nearer to the thing, as believed, per metre
      walked that way, at most 1, if it is here; `presence`: probability of that; `distance` to the thing along the
      floor, metres, None if not known.
    - `position` ``(3,)``: of the camera by odometry, z in metres above the floor; `world_R_body` ``(3, 3)``.
    - `floor` ``(H, W)`` bool: which pixels of an equirectangular look show the floor; None if the policy needs none.
      `seen` ``(H, W)`` bool: which of them the camera shows; None: all. `chance`: to find, of that look; None if
      it could not be read.
    """

    azimuth: float
    progress: float
    presence: float
    distance: float | None
    position: np.ndarray
    world_R_body: np.ndarray
    floor: np.ndarray | None = None
    seen: np.ndarray | None = None
    chance: Chance | None = field(default_factory=Chance)

    @lazy
    def here(self) -> np.ndarray:
        """Where the body is on the floor ``(2,)``, metres, world frame."""
        return np.array(self.position[:2], dtype=np.float64)

    @lazy
    def yaw(self) -> float:
        """Where the body faces: an azimuth of the world, radians."""
        return heading(self.world_R_body)

    @lazy
    def bearing(self) -> float:
        """Where the estimate is: an azimuth of the world, radians."""
        return self.azimuth + self.yaw

    @lazy
    def ahead(self) -> np.ndarray:
        """A unit vector ``(2,)`` along the floor to the estimate, world frame."""
        return np.array([math.cos(self.bearing), math.sin(self.bearing)])


def along_floor(distance: float | None, direction: np.ndarray) -> float | None:
    """Metres along the floor to what is `distance` metres away in a direction ``(3,)`` of a level frame."""
    return None if distance is None else distance * math.hypot(float(direction[0]), float(direction[1]))


@dataclass
class SearchedGround:
    """The ground of one episode; a `Space` about the body that stands on it.

    `radius`: of the body, metres. `hfov`: what its camera sees across, straight ahead, radians; 2 pi: all around.
    `here` ``(2,)``: where the body is, metres, world frame. Cells ``(..., 2)`` are rows and columns of `known`.
    """

    radius: float = 0.18
    hfov: float = 2 * math.pi
    known: FloorMap = field(default_factory=FloorMap)
    here: np.ndarray = field(default_factory=lambda: np.zeros(2))
    _chance: Chance = field(default_factory=Chance)
    _from: np.ndarray | None = None  # where the last look was taken that could be read

    @classmethod
    def about(cls, camera: Camera) -> SearchedGround:
        """The ground about a body with this camera, before its first look."""
        return cls(camera.radius, 2 * math.pi if camera.around else math.radians(camera.hfov))

    @property
    def around(self) -> bool:
        """Whether the camera sees all around."""
        return self.hfov >= 2 * math.pi

    @property
    def headings(self) -> np.ndarray:
        """The headings ``(n, 2)`` that the camera may face, radians, world frame: level ones."""
        return AHEAD if self.around else HEADINGS

    def look(self, now: SteeringInput) -> None:
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


def looked_along(place: Place, poses: np.ndarray, camera: Camera) -> FloorMap:
    """What the looks from `poses` showed of the floor of `place`, to a body that searches.

    `poses` ``(n, 7)``: x, y, z (metres) of the camera in the world, and its orientation ``world_R_body`` as a
    quaternion w, x, y, z. They are the true ones: where odometry drifted, the body itself took the floor to be
    elsewhere.
    """
    ground = SearchedGround.about(camera)
    if len(poses) > MOST:  # evenly spread, the first and the last among them
        poses = poses[np.linspace(0, len(poses) - 1, MOST).round().astype(np.intp)]
    for x, y, z, *quaternion in poses:
        world_R_body = rotation_from_wxyz(np.array(quaternion) / np.linalg.norm(quaternion))
        eye = np.array([x, y, z])
        floor = place.floor_in(place.ids(eye, world_R_body), eye, world_R_body)
        seen = in_view(camera, len(floor))
        ground.look(
            SteeringInput(
                azimuth=0.0,  # nothing is believed here: only what a look shows is taken in
                progress=0.0,
                presence=0.0,
                distance=None,
                position=eye - [0.0, 0.0, place.ground.height(eye[:2])],
                world_R_body=world_R_body,
                floor=floor if seen is None else floor & seen,
                seen=seen,
            )
        )
    return ground.known
