"""ROS 2 messages and bags for tests: random messages of every type that we read."""

from __future__ import annotations

import numpy as np

from eagor.sources import Pose
from eagor.sources import ros_messages as m
from eagor.sources.ros_messages import store
from eagor.sphere import world_R_body

READ = {
    "/image": m.IMAGE,
    "/image/compressed": m.COMPRESSED,
    "/camera_info": m.CAMERA_INFO,
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


def camera_info(
    size, k, d=(), model="plumb_bob", *, p=None, stamp=0.0, frame="camera_optical_frame", binning=1, roi=None
):
    """A sensor_msgs/CameraInfo: `k` is fx, fy, cx, cy; `p` those of rectified pictures; `roi` x, y, width, height."""
    (fx, fy, cx, cy), (rfx, rfy, rcx, rcy) = k, k if p is None else p
    left, top, wide, high = roi or (0, 0, 0, 0)
    region = m.message(
        "sensor_msgs/msg/RegionOfInterest", x_offset=left, y_offset=top, height=high, width=wide, do_rectify=False
    )
    return m.message(
        m.CAMERA_INFO, header=m.header(stamp, frame), height=size[1], width=size[0], distortion_model=model,
        d=np.array(d, dtype=float), k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]), r=np.eye(3).reshape(-1),
        p=np.array([rfx, 0, rcx, 0, 0, rfy, rcy, 0, 0, 0, 1.0, 0]), binning_x=binning, binning_y=binning, roi=region,
    )  # fmt: skip


def pose_message(pose, frame="odom"):
    """A geometry_msgs/PoseStamped."""
    return m.message(m.POSE, header=m.header(pose.stamp, frame), pose=m.odometry_message(pose).pose.pose)


def imu_message(pose, frame="imu_link", *, turning=(0, 0, 0), felt=(0, 0, 9.81)):
    """A sensor_msgs/Imu; `turning` rad/s, `felt` acceleration m/s2, in the axes of the body."""
    return m.message(
        m.IMU, header=m.header(pose.stamp, frame), orientation=m.quaternion(pose.world_R_body),
        orientation_covariance=np.zeros(9), angular_velocity=m.vector(turning),
        angular_velocity_covariance=np.zeros(9), linear_acceleration=m.vector(felt),
        linear_acceleration_covariance=np.zeros(9),
    )  # fmt: skip


def image_of(encoding, pixels, *, size=None, big=False, padded=0, stamp=5.0):
    """A sensor_msgs/Image whose rows ``(H, W, ...)`` are those of `pixels`, each with so many bytes more."""
    height, width = size or pixels.shape[:2]
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    return m.message(
        m.IMAGE, header=m.header(stamp, "x3"), height=height, width=width, encoding=encoding,
        is_bigendian=int(big), step=rows.shape[1] + padded,
        data=np.pad(rows, ((0, 0), (0, padded)), constant_values=99).reshape(-1),
    )  # fmt: skip


def random_message(kind, rng, stamp):
    """A message of one of the types that we read, every field set at random."""
    pose = Pose(stamp, world_R_body(*rng.uniform(-3, 3, 3)), rng.normal(size=3))
    frame = "".join(rng.choice(list("abcdefgh_/"), rng.integers(0, 12)))
    picture = rng.integers(0, 256, (4, 8, 3), dtype=np.uint8)
    if kind == m.IMAGE:
        return m.image_message(picture, stamp, frame)
    if kind == m.COMPRESSED:
        return m.compressed_message(picture, stamp, frame, kind=str(rng.choice(["jpeg", "png"])))
    if kind == m.CAMERA_INFO:
        return camera_info(
            (8, 4), rng.normal(size=4), rng.normal(size=5), p=rng.normal(size=4), stamp=stamp, frame=frame
        )
    if kind == m.IMU:
        found = imu_message(pose, frame, turning=rng.normal(size=3), felt=rng.normal(size=3))
        found.orientation_covariance = rng.normal(size=9)
        found.angular_velocity_covariance = rng.normal(size=9)
        found.linear_acceleration_covariance = rng.normal(size=9)
        return found
    if kind == m.ODOMETRY:
        found = m.odometry_message(pose, frame, "base", velocity=rng.normal(size=3), turning=rng.normal(size=3))
        found.pose.covariance, found.twist.covariance = rng.normal(size=36), rng.normal(size=36)
        return found
    if kind == m.POSE:
        return pose_message(pose, frame)
    if kind == m.TRANSFORMS:
        return m.transforms_message(
            *(
                m.transform_message(stamp, frame, f"child{i}", pose.world_R_body, pose.position)
                for i in range(rng.integers(0, 4))
            )
        )
    if kind == m.VECTOR:
        return m.message(m.VECTOR, header=m.header(stamp, frame), vector=m.vector(rng.normal(size=3)))
    return m.message(m.TEXT, data=frame * int(rng.integers(0, 30)))
