"""From messages to poses of the camera: odometry, poses, an IMU's orientation, or transforms; live or from a bag."""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean, median
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.errors import DeviceError
from eagor.media.bags.messages import IMU, ODOMETRY, TRANSFORMS, pose_of
from eagor.media.frames import Pose
from eagor.robots.ros.transforms import BACK, IDENTITY, Transform, TransformTree, composed, optical

__all__ = ["BODY", "TOLERATED", "WORLDS", "PoseReader", "Turning", "unnamed"]

BODY = "base_link"
TOLERATED = math.radians(3.0)  # a detector is off by as much
HOLE = 2.5  # times as long as most: an interval in which poses are missing
RATES, FEWEST = 50, 10  # changes of the rate of turning that count, and that are enough
WORLDS = ("odom", "map")  # REP-105; odom does not jump


def unnamed(body: str) -> str:
    """What to say of pictures whose headers name no frame."""
    return (
        f"the pictures name no frame (frame_id is empty): the camera's axes are taken for those of {body}; set it in "
        "the camera's driver, or name the frame (eagor ros --camera)"
    )


class Turning:
    """How far poses between two of odometry may be off, since nobody knows how the body turned there.

    The rate of turning is taken for a random walk. Its density `q` follows from how the measured rates change: over two
    intervals of `a` and `b` seconds by ``q (a + b) / 3`` (variance). What is interpolated midway in an interval of `t`
    seconds is off by ``q t^3 / 48``. What swings faster than poses come is not seen in them.
    """

    def __init__(self) -> None:
        self._pose: Pose | None = None
        self._rate: tuple[np.ndarray, float] | None = None  # radians per second in the body's axes, and their seconds
        self._density: deque[float] = deque(maxlen=RATES)
        self._gaps: deque[float] = deque(maxlen=RATES)

    def add(self, pose: Pose) -> None:
        """The next pose."""
        before, self._pose = self._pose, pose
        if before is None or (gap := pose.stamp - before.stamp) <= 0:
            self._rate = None
            return
        known = bool(self._gaps)
        self._gaps.append(gap)
        if known and gap > HOLE * median(self._gaps):  # it may have turned about, and the shortest turn is none of it
            self._rate = None
            return
        rate = Rotation.from_matrix(before.world_R_body.T @ pose.world_R_body).as_rotvec() / gap
        if self._rate is not None:
            change = rate - self._rate[0]
            self._density.append(3 * float(change @ change) / (gap + self._rate[1]))
        self._rate = rate, gap

    @property
    def midway(self) -> float:
        """Standard deviation, radians, midway between two poses that are as far apart as most are."""
        if len(self._density) < FEWEST:
            return 0.0
        return math.sqrt(fmean(self._density) * median(self._gaps) ** 3 / 48)

    def said(self, topic: str) -> str:
        """The same in words."""
        return (
            f"{topic} tells a pose every {median(self._gaps):.2f} s, too seldom for how the turning changes: between "
            f"two of them, directions are off by {math.degrees(self.midway):.1f} degrees (standard deviation); wanted "
            "odometry at a higher rate"
        )


class PoseReader:
    """Makes poses of the messages on one `topic` of type `kind`.

    `camera`: the camera's frame; its pose is told, by the transforms between it and the frame of the message. "": its
    pictures name none, so that its axes are taken for those of the `body`, which is a problem. None: the pose of the
    `body` is wanted. `strict`: give no pose before these transforms are known; otherwise the camera's axes are
    taken for those of the message. `world`: the frame of the poses for transforms (default: odom, else map, else the
    root of the tree). `rewinds`: whether the stamps may go back by more than a second, as those of a clock that was
    set; otherwise such poses are left out. `turning`: how well the poses tell what lies between them. `problem`: what
    is missing, in words, or None.
    """

    def __init__(
        self,
        topic: str,
        kind: str,
        *,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
        strict: bool = False,
        rewinds: bool = False,
    ) -> None:
        self.topic, self.kind = topic, kind
        self.camera, self.body, self.world, self.strict = camera, body, world, strict
        self.rewinds = rewinds
        self.problem = self._unnamed = unnamed(body) if camera == "" else None
        self.tree = TransformTree()
        self.turning = Turning()
        self._frames: tuple[str, str] | None = None
        self._last = -math.inf

    def transforms(self, received: Any, fixed: bool) -> list[Pose]:
        """Take in a message of /tf_static (`fixed`) or /tf; the poses that it gives, if these come from /tf."""
        news = self.tree.add(received, fixed)
        if self.kind != TRANSFORMS or fixed or not news:
            return []
        return self._of_tree()

    def take(self, received: Any) -> list[Pose]:
        """Take in a message of the topic; the poses that it gives.

        Raises `PoseError` for a message that holds no pose, `DeviceError` if two robots, or two sources of odometry,
        speak on the topic: its frames change.
        """
        if self.kind == TRANSFORMS:
            return self.transforms(received, fixed=False)
        frames = received.header.frame_id.lstrip("/"), getattr(received, "child_frame_id", "").lstrip("/")
        if self._frames not in (None, frames):
            raise DeviceError(
                f"{self.topic} has poses of {self._said(self._frames)} and of {self._said(frames)}: two publishers? "
                "Stop one of them, or take another topic"
            )
        self._frames = frames
        pose = pose_of(received)
        mount = self._mount(self._source(frames), pose.stamp)
        if mount is None:
            return []
        rotation, place = mount
        position = None if pose.position is None else pose.position + pose.world_R_body @ place
        return self._in_order(Pose(pose.stamp, pose.world_R_body @ rotation, position))

    def body_R_camera(self, stamp: float = 0.0) -> np.ndarray:
        """The rotation ``(3, 3)`` of the camera's axes in those of the body; the identity if nothing is known of it."""
        if self.camera is None:
            return np.eye(3)
        body = self.body
        if self._frames is not None and self.kind == ODOMETRY and body not in self.tree.frames:
            body = self._frames[1] or body
        found = self.tree.at(body, self.camera, stamp)
        return (np.eye(3) if found is None else found[0]) @ optical(self.camera)

    def _source(self, frames: tuple[str, str]) -> str:
        """The frame whose pose a message tells."""
        if self.kind == IMU:
            return frames[0]
        return frames[1] or self.body

    def _mount(self, source: str, stamp: float) -> Transform | None:
        """Where the camera is in the frame `source`; None while that is not known and has to be."""
        target = self.camera or self.body
        if target in (source, "") or not source:
            found: Transform | None = IDENTITY
        else:
            found = self.tree.at(source, target, stamp)
        self.problem = self._unnamed
        if found is None:
            self.problem = f"/tf_static and /tf do not tell where {target} is in {source}"
            if self.strict:
                return None
            if self.camera:
                self.problem += ": its axes are taken for the same"
            else:
                self.problem = self._unnamed  # the body is what the odometry tells of
            found = IDENTITY
        return found[0] @ optical(target), found[1]

    def _of_tree(self) -> list[Pose]:
        """The pose at the newest time that all transforms from the world to the camera reach."""
        target = self.camera if self.camera in self.tree.frames else self.body
        if self.strict and target != (self.camera or self.body):
            self.problem = f"/tf and /tf_static do not tell where {self.camera} is"
            return []
        world = self.world or next((w for w in WORLDS if self.tree.between(w, target)), None) or self.tree.root(target)
        moving = self.tree.moving(world, target)
        if not moving:
            self.problem = (
                f"/tf does not tell how {target} moves in {world}; it has {', '.join(sorted(self.tree.frames))}"
            )
            return []
        stamp = min(self.tree.newest(frame) for frame in moving)
        found = self.tree.at(world, target, stamp)
        if found is None:
            return []
        self.problem = self._unnamed
        rotation, place = composed(found, (optical(target), np.zeros(3)))
        return self._in_order(Pose(stamp, rotation, place))

    def _in_order(self, pose: Pose) -> list[Pose]:
        if pose.stamp <= self._last and not (self.rewinds and pose.stamp < self._last - BACK):
            return []
        self._last = pose.stamp
        self.turning.add(pose)
        if self.problem is None and self.turning.midway > TOLERATED:
            self.problem = self.turning.said(self.topic)
        return [pose]

    @staticmethod
    def _said(frames: tuple[str, str] | None) -> str:
        return " in ".join(reversed([frame or "no frame" for frame in frames or () if frame])) or "no frame"
