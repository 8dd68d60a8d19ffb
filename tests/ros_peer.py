"""A robot of ROS 2 in a process of its own: it turns beside a red ball, and publishes pictures and odometry.

``python ros_peer.py '{"seconds": 10, "transport": "compressed"}'``; see `SETTINGS`.
"""

from __future__ import annotations

import io
import json
import math
import sys
import time
from types import SimpleNamespace

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from PIL import Image as Picture
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu
from std_msgs.msg import Header

from eagor.conventions import OPTICAL_R_BODY, xyzw_from_rotation
from eagor.sphere import world_R_body

BALL = 0.6  # radians: its azimuth in the world
SETTINGS = {
    "seconds": 20.0, "rate": 10.0, "rows": 128, "transport": "raw", "reliable": True, "poses": "odom", "turn": 0.5,
    "sim_time": False, "frame": "base_link", "namespace": "", "start": 0, "hfov_deg": 0, "tf": False, "static_after": 0,
}  # fmt: skip


def room(rows: int) -> np.ndarray:
    """A grey panorama ``(rows, 2 rows, 3)`` with a red ball of 12 degrees at `BALL`, on the horizon, of yaw 0."""
    azimuth = math.pi - (np.arange(2 * rows) + 0.5) * math.pi / rows
    elevation = math.pi / 2 - (np.arange(rows) + 0.5) * math.pi / rows
    near = np.hypot(azimuth[None] - BALL, elevation[:, None]) < math.radians(6)
    shade = 110 + 40 * np.sin(5 * azimuth)[None] * np.cos(3 * elevation)[:, None]
    return np.where(near[..., None], (200, 20, 20), shade[..., None]).astype(np.uint8)


def main() -> None:
    s = SimpleNamespace(**SETTINGS | json.loads(sys.argv[1]))
    rclpy.init()
    node = rclpy.create_node("robot", namespace=s.namespace)
    reliability = ReliabilityPolicy.RELIABLE if s.reliable else ReliabilityPolicy.BEST_EFFORT
    qos = QoSProfile(depth=5, reliability=reliability)
    compressed = s.transport == "compressed"
    topic = "x3/image" + "/compressed" * compressed
    pictures = node.create_publisher(CompressedImage if compressed else Image, topic, qos)
    kind = {"odom": Odometry, "pose": PoseStamped, "pose_with_covariance": PoseWithCovarianceStamped, "imu": Imu}
    poses = node.create_publisher(kind[s.poses], "wheels", 10) if s.poses in kind else None
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    infos = node.create_publisher(CameraInfo, "x3/camera_info", latched) if s.hfov_deg else None
    clock = node.create_publisher(Clock, "/clock", 10) if s.sim_time else None
    transforms = Transforms(node, s.static_after) if s.tf else None
    begun, sent, base = time.time(), 0, room(s.rows)
    zero = 1000.0 if s.sim_time else begun
    while (gone := time.time() - begun) < s.seconds:
        stamp = rclpy.time.Time(nanoseconds=round((zero + gone) * 1e9)).to_msg()
        yaw = math.remainder(s.start + s.turn * gone, math.tau)
        if clock is not None:
            clock.publish(Clock(clock=stamp))
        if poses is not None:
            poses.publish(posed(kind[s.poses], stamp, yaw))
        if transforms is not None:
            transforms.publish(stamp, yaw, gone)
        if gone * s.rate >= sent:
            ahead = yaw + math.pi / 2 * s.tf  # with transforms, the camera looks to the left
            seen = np.roll(base, round(ahead / math.tau * base.shape[1]), axis=1)
            if infos is not None:
                seen = cut(seen, s.hfov_deg)
                infos.publish(lens(seen, s.hfov_deg, stamp, s.frame))
            pictures.publish(picture(seen, stamp, s.frame, compressed))
            sent += 1
        rclpy.spin_once(node, timeout_sec=0.0)
        time.sleep(0.01)
    node.destroy_node()
    rclpy.shutdown()


class Transforms:
    """/tf of the odometry, and after some seconds /tf_static: a camera on the left of the robot, of optical axes."""

    def __init__(self, node, after: float) -> None:
        from tf2_msgs.msg import TFMessage

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.kind, self.after, self.moving = TFMessage, after, node.create_publisher(TFMessage, "/tf", 10)
        self.fixed = node.create_publisher(TFMessage, "/tf_static", latched)

    def publish(self, stamp, yaw: float, gone: float) -> None:
        self.moving.publish(self.told("odom", "base_link", stamp, world_R_body(yaw, 0, 0), (0.0, 0.0, 0.0)))
        if gone > self.after:
            turn = world_R_body(math.pi / 2, 0, 0) @ OPTICAL_R_BODY.T
            self.fixed.publish(self.told("base_link", "x3_optical_frame", stamp, turn, (0.2, 0.0, 0.5)))
            self.after = math.inf

    def told(self, parent: str, child: str, stamp, turn, place):
        one = TransformStamped(header=Header(stamp=stamp, frame_id=parent), child_frame_id=child)
        one.transform.translation.x, one.transform.translation.y, one.transform.translation.z = place
        one.transform.rotation = quaternion(turn)
        return self.kind(transforms=[one])


def quaternion(turn) -> Quaternion:
    return Quaternion(**dict(zip("xyzw", map(float, xyzw_from_rotation(turn)), strict=True)))


def cut(panorama: np.ndarray, hfov_deg: float) -> np.ndarray:
    """What an ordinary camera that looks ahead sees, 4:3."""
    from eagor.grids import PerspectiveGrid
    from eagor.sources.panorama import view

    return view(panorama, PerspectiveGrid(120, 160, math.radians(hfov_deg)))


def lens(seen: np.ndarray, hfov_deg: float, stamp, frame: str) -> CameraInfo:
    height, width = seen.shape[:2]
    focal = width / 2 / math.tan(math.radians(hfov_deg) / 2)
    k = [focal, 0.0, width / 2 - 0.5, 0.0, focal, height / 2 - 0.5, 0.0, 0.0, 1.0]
    header = Header(stamp=stamp, frame_id=frame)
    return CameraInfo(header=header, height=height, width=width, distortion_model="plumb_bob", d=[0.0] * 5, k=k)


def picture(seen: np.ndarray, stamp, frame: str, compressed: bool):
    header = Header(stamp=stamp, frame_id=frame)
    if compressed:
        buffer = io.BytesIO()
        Picture.fromarray(seen).save(buffer, "jpeg", quality=90)
        return CompressedImage(header=header, format="rgb8; jpeg compressed bgr8", data=buffer.getvalue())
    height, width = seen.shape[:2]
    made = Image(header=header, height=height, width=width, encoding="rgb8", step=3 * width)
    made.data.frombytes(np.ascontiguousarray(seen).tobytes())
    return made


def posed(kind, stamp, yaw: float):
    turn = quaternion(world_R_body(yaw, 0, 0))
    made = kind(header=Header(stamp=stamp, frame_id="base_link" if kind is Imu else "odom"))
    if kind is Imu:
        made.orientation = turn
    elif kind is PoseStamped:
        made.pose.orientation = turn
    else:
        made.pose.pose.orientation = turn
    if kind is Odometry:
        made.child_frame_id = "base_link"
    return made


if __name__ == "__main__":
    main()
