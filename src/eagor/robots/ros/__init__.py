"""ROS 2: one node, and its topics as cameras and poses, on `rclpy`.

That comes from a ROS installation (Humble, Jazzy, Kilted) or, on x86-64 Linux, from the extra ``ros``. `topics`:
cameras and poses; `node`: the node. Here: what it can be told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from eagor._extras import how_to_install
from eagor.errors import MissingExtraError
from eagor.sources.ros_messages import IMU, ODOMETRY, POSE, POSE_WITH_COVARIANCE, TRANSFORMS

if TYPE_CHECKING:
    from eagor.robots.ros.topics import RosCamera, RosPoses

__all__ = ["PARAMETERS", "SOURCES", "RosCamera", "RosPoses", "need_rclpy", "ros_poses"]

# How the camera's motion is known: the topic and its type, or what `Loop` takes as poses.
SOURCES: Mapping[str, Any] = {
    "odom": ("odom", ODOMETRY), "pose": ("pose", POSE), "pose_with_covariance": ("pose", POSE_WITH_COVARIANCE),
    "imu": ("imu", IMU), "tf": ("/tf", TRANSFORMS), "visual": "auto", "level": "level", "still": None,
}  # fmt: skip
UNSET = math.nan
PARAMETERS: Mapping[str, tuple[Any, str]] = {
    "queries": ([""], "what to look for; ~/query changes it, too"),
    "perception": ("", "the detector, as --perception of other commands; '' is chosen by the queries"),
    "image_topics": (["image"], "topics of pictures, several for several cameras; remap them as usual"),
    "image_transport": ("raw", "raw or compressed: what comes after the topics' names"),
    "image_delay": (0.0, "seconds from capture to the stamp of the pictures, for drivers that stamp late"),
    "pose_source": ("odom", f"how the camera's motion is known: {', '.join(SOURCES)}"),
    "base_frame": ("base_link", "the frame of the answers"),
    "world_frame": ("", "the frame of the poses from /tf; '' is odom, else map"),
    "mount_xyz": ([UNSET] * 3, "metres: where the camera is in base_frame, where no transform tells it"),
    "mount_rpy_deg": ([0.0] * 3, "degrees, with mount_xyz: roll, pitch (nose down), yaw (left) of the camera, x ahead"),
    "rate": (20.0, "answers per second"),
    "patience": (60.0, "seconds that one look may take; then the detector is ended and started anew"),
    "rig": ("", "a YAML file with the lenses, if the pictures are those of fisheye lenses"),
    "intrinsics": ("", "a file with the lens of an ordinary camera without camera_info"),
    "hfov_deg": (UNSET, "degrees that an ordinary camera without camera_info sees across"),
    "floor": (UNSET, "metres: height of the floor in the world of the poses; things stand on it"),
    "calibration": ("", "a file from eagor calibrate"),
    "detector": ("", "how well the detector does, as --detector of other commands"),
    "static": (False, "things never move"),
    "autostart": (True, "configure and activate by itself"),
}


def need_rclpy() -> None:
    """Raise `MissingExtraError` if there is no `rclpy`."""
    if find_spec("rclpy") is None:
        raise MissingExtraError(
            "ROS 2 needs rclpy: source a ROS installation in this shell (source /opt/ros/jazzy/setup.bash), with "
            f"its Python; or, on x86-64 Linux: {how_to_install('ros')}"
        )


def ros_poses(text: str, *, camera: str | None, **_: object) -> RosPoses:
    """The poses on the topic that "ros:/odom" names, of the `camera` with this frame, for `eagor.open_poses`."""
    need_rclpy()
    from eagor.robots.ros import topics

    return topics.RosPoses(text.partition(":")[2] or None, camera=camera)


def __getattr__(name: str) -> Any:
    if name not in ("RosCamera", "RosPoses"):
        raise AttributeError(name)
    need_rclpy()
    from eagor.robots.ros import topics

    return getattr(topics, name)
