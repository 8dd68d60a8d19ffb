"""The demo's little world: a camera walks and turns in the painted room, and one red ball is what it looks for.

What makes it hard is what makes it hard on a robot: the camera turns about all three axes, so that the ball crosses the
seam behind it; it walks, so that bearings change without turning; another red thing, smaller, rolls about; one look in
seven misses everything; and for a while the camera is covered, so that only the odometry is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.evidence import Evidence
from eagor.perception import Perception
from eagor.sphere import world_R_body
from eagor.worlds.painted import Ball, Room, bearing, paint

QUERY = "red ball"
TARGET = Ball((2.6, -1.3, 0.35), 0.35, "red")
BYSTANDERS = (
    Ball((1.2, 2.0, 0.3), 0.3, "blue"),
    Ball((-2.4, 1.0, 0.4), 0.4, "yellow"),
    Ball((-1.5, -1.8, 0.25), 0.25, "green"),
)
INTERVAL = 0.25  # seconds between panoramas
MISS_RATE = 1 / 7
COVERED = (0.50, 0.68)  # as shares of the walk
LOOK_ROWS = 128  # of the panorama that the perception sees; pictures have twice as many


@dataclass(frozen=True, eq=False)
class Moment:
    """One step of the walk: the camera's pose, the room as it is then, and what is true."""

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray
    room: Room
    truth: np.ndarray
    distance: float
    covered: bool
    missed: bool

    def panorama(self, rows: int = LOOK_ROWS) -> np.ndarray:
        """What the camera would see if nothing covered it, ``(rows, 2 rows, 3)`` uint8."""
        return paint(self.room, tuple(self.position), self.world_R_body, rows, 2 * rows)

    def look(self, perception: Perception) -> tuple[Evidence, ...]:
        """The evidence of this moment: none if covered; a missed detection is a look that saw nothing."""
        if self.covered:
            return ()
        found = perception(self.panorama(), QUERY, stamp=self.stamp)
        if self.missed:
            nothing = np.zeros(found.grid.shape, dtype=np.float32)
            found = Evidence.from_response(nothing, found.grid, calibration=found.calibration, stamp=self.stamp)
        return (found,)


def walk(steps: int, seed: int) -> list[Moment]:
    """A walk of so many panoramas: once around the room and a little more, turning more than that."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(0, math.tau)
    missed = rng.random(steps) < MISS_RATE
    first, last = (round(share * steps) for share in COVERED)
    return [_moment(i, steps, start, first <= i < last, bool(missed[i])) for i in range(steps)]


def _moment(index: int, steps: int, start: float, covered: bool, missed: bool) -> Moment:
    share = index / steps
    around = start + math.tau * 1.1 * share
    yaw = start + math.pi / 2 + math.tau * 1.6 * share + 0.3 * math.sin(1.7 * around)
    pitch = math.radians(9) * math.sin(2.1 * around + 1)
    roll = math.radians(8) * math.sin(2.9 * around + 2)
    x, y = 1.5 * math.cos(around) + 0.25 * math.sin(3 * around), 1.1 * math.sin(around)
    position = np.array([x, y, 1.3 + 0.08 * math.sin(2.3 * around)])
    pose = world_R_body(yaw, pitch, roll)
    truth, distance = bearing(TARGET, tuple(position), pose)
    room = Room(balls=(TARGET, _toy(share), *BYSTANDERS))
    return Moment(index * INTERVAL, pose, position, room, truth, distance, covered, missed)


def _toy(share: float) -> Ball:
    """The other red thing, on its way around the room."""
    angle = math.tau * (0.35 + 1.7 * share)
    return Ball((2.0 * math.cos(angle), 1.9 * math.sin(angle), 0.16), 0.16, "red")
