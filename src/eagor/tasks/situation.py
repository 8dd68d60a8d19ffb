"""What a body that walks knows at a step, and what steers it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from eagor._lazy import lazy
from eagor.sphere import heading
from eagor.tasks.looks import Chance


@dataclass(frozen=True, eq=False)
class Situation:
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


class Steering(Protocol):
    """Chooses steps for one episode.

    `searching`: whether the last step was one of a search. `looks_down`: whether it wants to know the floor of each
    look, and what is believed; without that, `Situation.progress` and `presence` are 1.
    """

    searching: bool
    looks_down: bool

    def walk(self, now: Situation) -> tuple[float, float]:
        """The next step: a turn, radians, positive left, in (-pi, pi], and then so many metres straight ahead."""
        ...


def along_floor(distance: float | None, direction: np.ndarray) -> float | None:
    """Metres along the floor to what is `distance` metres away in a direction ``(3,)`` of a level frame."""
    return None if distance is None else distance * math.hypot(float(direction[0]), float(direction[1]))
