"""ROS 2 messages and bags for tests: random messages of every type that we read."""

from __future__ import annotations

import numpy as np

from eagor.media.bags import messages as m
from eagor.media.bags.ros_types import store
from eagor.media.frames import Pose
from eagor.sphere import world_R_body

READ = {
    "/image": m.IMAGE,
    "/image/compressed": m.COMPRESSED,
    "/imu": m.IMU,
    "/odom": m.ODOMETRY,
    "/pose": m.POSE,
    "/tf": m.TRANSFORMS,
    "/direction": m.VECTOR,
    "/query": m.TEXT,
}


def cdr(kind, message):
    """The bytes of a message: two are equal if these are."""
    return bytes(store().serialize_cdr(message, kind))


def random_message(kind, rng, stamp):
    """A message of one of the types that we read, every field set at random."""
    pose = Pose(stamp, world_R_body(*rng.uniform(-3, 3, 3)), rng.normal(size=3))
    frame = "".join(rng.choice(list("abcdefgh_/"), rng.integers(0, 12)))
    picture = rng.integers(0, 256, (4, 8, 3), dtype=np.uint8)
    if kind == m.IMAGE:
        return m.image_message(picture, stamp, frame, str(rng.choice(["rgb8", "bgr8", "rgba8", "bgra8", "mono8"])))
    if kind == m.COMPRESSED:
        return m.compressed_message(picture, stamp, frame, kind=str(rng.choice(["jpeg", "png"])))
    if kind == m.IMU:
        found = m.imu_message(pose, frame, turning=rng.normal(size=3), felt=rng.normal(size=3))
        found.orientation_covariance = rng.normal(size=9)
        found.angular_velocity_covariance = rng.normal(size=9)
        found.linear_acceleration_covariance = rng.normal(size=9)
        return found
    if kind == m.ODOMETRY:
        found = m.odometry_message(pose, frame, "base", velocity=rng.normal(size=3), turning=rng.normal(size=3))
        found.pose.covariance, found.twist.covariance = rng.normal(size=36), rng.normal(size=36)
        return found
    if kind == m.POSE:
        return m.pose_message(pose, frame)
    if kind == m.TRANSFORMS:
        return m.transforms_message(
            *(
                m.transform_message(stamp, frame, f"child{i}", pose.world_R_body, pose.position)
                for i in range(rng.integers(0, 4))
            )
        )
    if kind == m.VECTOR:
        return m.vector_message(rng.normal(size=3), stamp, frame)
    return m.text_message(frame * int(rng.integers(0, 30)))
