"""The body that carries the camera: its true pose and its odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.sphere import world_R_body
from eagor.tasks.rules import Camera, Disturbances

BOBS_PER_SECOND = 2.0


@dataclass(frozen=True, eq=False)
class Pose:
    """Camera pose: `position` ``(3,)`` metres, `world_R_body` ``(3, 3)``."""

    position: np.ndarray
    world_R_body: np.ndarray

    def towards(self, point: np.ndarray) -> tuple[np.ndarray, float]:
        """Direction ``(3,)`` in the body frame and distance (metres) of a point in the world frame."""
        offset = self.world_R_body.T @ (np.asarray(point) - self.position)
        distance = float(np.linalg.norm(offset))
        return (offset / distance if distance > 0 else np.array([1.0, 0.0, 0.0])), distance


@dataclass
class Carrier:
    """Moves on the floor along its heading, with bobbing and swaying; `rng` draws the odometry's drift.

    `floor`: the height of the ground under it, metres, which the odometry measures.
    """

    camera: Camera
    disturbances: Disturbances
    rng: np.random.Generator
    xy: np.ndarray
    yaw: float
    floor: float = 0.0
    steps: int = 0
    walked: float = 0.0
    _believed_xy: np.ndarray = field(init=False)
    _believed_yaw: float = field(init=False)
    _scale: float = field(init=False)
    _phase: float = field(init=False)

    def __post_init__(self) -> None:
        self._believed_xy, self._believed_yaw = self.xy.copy(), self.yaw
        self._scale = 1.0 + self.disturbances.scale_drift * float(self.rng.standard_normal())
        self._phase = float(self.rng.uniform(0, 2 * math.pi))

    @property
    def stamp(self) -> float:
        """Seconds since the start."""
        return self.steps * self.camera.seconds

    def move(self, xy: np.ndarray, yaw: float, floor: float = 0.0) -> None:
        """One step, to the given place and heading; `floor`: the height of the ground there."""
        step, turned = xy - self.xy, math.remainder(yaw - self.yaw, 2 * math.pi)
        length = float(np.hypot(*step))
        slip = math.radians(self.disturbances.yaw_drift) * math.sqrt(length) * float(self.rng.standard_normal())
        # The odometry's measurement: the step in the body frame, with errors in scale and heading.
        off = self._believed_yaw - self.yaw
        c, s = math.cos(off), math.sin(off)
        self._believed_xy = self._believed_xy + self._scale * np.array(
            [c * step[0] - s * step[1], s * step[0] + c * step[1]]
        )
        self._believed_yaw += turned + slip
        self.walked += math.hypot(length, floor - self.floor)
        self.xy, self.yaw, self.floor = np.asarray(xy, dtype=np.float64), yaw, floor
        self.steps += 1

    @property
    def pose(self) -> Pose:
        """The true camera pose."""
        return self._pose(self.xy, self.yaw)

    @property
    def odometry(self) -> Pose:
        """The camera pose according to the odometry."""
        return self._pose(self._believed_xy, self._believed_yaw)

    def _pose(self, xy: np.ndarray, yaw: float) -> Pose:
        phase = self._phase + 2 * math.pi * BOBS_PER_SECOND * self.stamp * 0.93  # 0.93: not in step with panoramas
        height = self.floor + self.camera.height + self.disturbances.bob * math.sin(phase)
        sway = math.radians(self.disturbances.sway)
        turned = world_R_body(yaw, sway * math.sin(phase / 2 + 1.0), sway * math.sin(phase / 2))
        return Pose(np.array([xy[0], xy[1], height]), turned)
