"""What a simulated Go2 says of its body: the fields of its state message, and odometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eagor.media.frames import Pose
from eagor.robots.go2.plant import GRAVITY, WALKING, Motion
from eagor.robots.go2.wire import SportFields

__all__ = ["odometry_of", "sport_fields"]

LIFT = 0.09  # metres by which a trotting Go2 lifts its feet


def sport_fields(motion: Motion, stamp: float, error_code: int = 0) -> SportFields:
    """The state message of a body that moves so, at `stamp` seconds of the robot's clock."""
    pose = motion.pose
    assert pose.position is not None
    (m00, _, _), (m10, _, _), (m20, m21, m22) = pose.world_R_body.tolist()
    roll, pitch, yaw = math.atan2(m21, m22), -math.asin(max(-1.0, min(1.0, m20))), math.atan2(m10, m00)
    second = math.floor(stamp)
    return SportFields(
        second,
        min(int(1e9 * (stamp - second)), 999_999_999),
        error_code,
        _wxyz(roll, pitch, yaw),
        tuple(motion.rates.tolist()),
        (GRAVITY * m20, GRAVITY * m21, GRAVITY * m22),
        (roll, pitch, yaw),
        motion.mode,
        gait_type=1 if motion.mode == WALKING else 0,
        foot_raise_height=LIFT,
        position=tuple(pose.position.tolist()),
        body_height=float(pose.position[2]),
        velocity=tuple(motion.velocity.tolist()),
        yaw_speed=motion.yaw_rate,
    )


def _wxyz(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion of a body turned by `yaw`, then `pitch`, then `roll`: half angles, multiplied out."""
    a, b, c = math.cos(roll / 2), math.cos(pitch / 2), math.cos(yaw / 2)
    x, y, z = math.sin(roll / 2), math.sin(pitch / 2), math.sin(yaw / 2)
    return a * b * c + x * y * z, x * b * c - a * y * z, a * y * c + x * b * z, a * b * z - x * y * c


def odometry_of(motion: Motion, stamp: float, frame: str = "odom") -> Any:
    """A nav_msgs/Odometry of the body, at `stamp` seconds; its twist is in the body frame."""
    from eagor.media.bags.messages import odometry_message

    pose = Pose(stamp, motion.pose.world_R_body, motion.pose.position)
    return odometry_message(
        pose, frame, velocity=pose.world_R_body.T @ motion.velocity, turning=np.asarray(motion.rates)
    )
