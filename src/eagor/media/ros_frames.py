"""From messages to poses of the camera: odometry, poses, an IMU's orientation, or transforms; live or from a bag.

Transforms are the tree of frames of ``/tf`` and ``/tf_static`` (REP-105): where one is in another, at a time. A
transform is (R, t): a point p of the child frame is ``R @ p + t`` in the parent frame.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from functools import lru_cache
from statistics import fmean, median
from typing import Any

import numpy as np

from eagor.conventions import OPTICAL_R_BODY, is_optical
from eagor.errors import DeviceError, EagorError
from eagor.media import Pose
from eagor.media.ros_messages import IMU, ODOMETRY, TRANSFORMS, pose_of, rotation_of, seconds, triple
from eagor.tracking.poses import PoseHistory

__all__ = [
    "BACK", "BODY", "IDENTITY", "TOLERATED", "WORLDS", "PoseReader", "Transform", "TransformTree", "Turning",
    "composed", "contradiction", "inverse", "optical", "unnamed",
]  # fmt: skip

KEPT = 10.0  # seconds of moving transforms, as tf2 keeps them
MOST = 100  # links from a frame to the root: more are a circle
OVERTAKEN = 0.1  # seconds: a message that comes so much after a newer one costs nothing
BACK = 1.0  # seconds by which stamps have to go back before it is a clock that was set, not a message out of order
STEEP = math.cos(math.radians(40))  # an axis that is nearer to the vertical points up, or down

Transform = tuple[np.ndarray, np.ndarray]
IDENTITY: Transform = (np.eye(3), np.zeros(3))

BODY = "base_link"
TOLERATED = math.radians(3.0)  # a detector is off by as much
HOLE = 2.5  # times as long as most: an interval in which poses are missing
RATES, FEWEST = 50, 10  # changes of the rate of turning that count, and that are enough
WORLDS = ("odom", "map")  # REP-105; odom does not jump


def composed(a: Transform, b: Transform) -> Transform:
    """First `b`, then `a`."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def inverse(a: Transform) -> Transform:
    """The way back."""
    return a[0].T, -a[0].T @ a[1]


@lru_cache(maxsize=64)
def optical(frame: str) -> np.ndarray:
    """The rotation ``frame_R_camera`` ``(3, 3)`` of a camera's own axes (x forward) in the frame that names it."""
    return OPTICAL_R_BODY if is_optical(frame) else IDENTITY[0]


def contradiction(frame: str, body_R_frame: np.ndarray) -> str | None:
    """In words, that a camera's frame is mounted as if its name were wrong: as an optical one, or none. Else None."""
    named, (_, y, z) = is_optical(frame), body_R_frame[2]  # how much the axes of the frame point up
    if named and z > STEEP:
        return (
            f"{frame} is named as an optical frame (x right, y down, z ahead: REP-103), and mounted with its z axis "
            "up: the camera is taken to look up. If x is ahead, name it without 'optical'"
        )
    if not named and y < -STEEP:
        return (
            f"{frame} is not named as an optical frame, and mounted as one, with its y axis down: the camera is taken "
            f"to look along x, and to lie on its side. If z is ahead, name it {frame}_optical_frame (REP-103)"
        )
    return None


class TransformTree:
    """The frames that have been told of. Not for several threads."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Transform]] = {}
        self._moving: dict[str, tuple[str, PoseHistory]] = {}
        self._newest: dict[str, float] = {}

    @property
    def frames(self) -> set[str]:
        """All that are known, parents included."""
        links = {**self._fixed, **self._moving}
        return {*links, *(parent for parent, _ in links.values())}

    def add(self, received: Any, fixed: bool) -> set[str]:
        """Take in a TFMessage; returns the frames that have been moved. What is damaged or out of order is left out.

        Where the stamps of a frame go back by more than `BACK` its older transforms are forgotten, as tf2 does.
        """
        news = set()
        for each in received.transforms:
            parent, child = _named(each.header.frame_id), _named(each.child_frame_id)
            try:
                rotation, place = rotation_of(each.transform.rotation), triple(each.transform.translation)
                if fixed:
                    self.fix(parent, child, (rotation, place))
                else:
                    known, stamp = self._moving.get(child), seconds(each.header.stamp)
                    if known is None or known[0] != parent or stamp < self._newest[child] - BACK:
                        known = self._moving[child] = parent, PoseHistory(KEPT)
                        self._fixed.pop(child, None)
                    known[1].add(stamp, rotation, place)
                    self._newest[child] = stamp
            except EagorError:
                continue
            news.add(child)
        return news

    def fix(self, parent: str, child: str, transform: Transform) -> None:
        """Take it that the child does not move in its parent."""
        self._fixed[child] = parent, transform
        self._moving.pop(child, None)

    def between(self, parent: str, child: str) -> list[str] | None:
        """The frames whose links lead from `child` to `parent`, in no order; None if these are not connected."""
        ways = self._ways(parent, child)
        return ways and ways[0] + ways[1]

    def moving(self, parent: str, child: str) -> list[str]:
        """Those of `between` that move."""
        return [frame for frame in self.between(parent, child) or () if frame in self._moving]

    def root(self, frame: str) -> str:
        """The last of the frame's parents."""
        return self._ancestors(_named(frame))[-1]

    def newest(self, frame: str) -> float:
        """The stamp of the newest transform of a moving frame."""
        return self._newest[frame]

    def at(self, parent: str, child: str, stamp: float) -> Transform | None:
        """Where `child` is in `parent` at a time; None if they are not connected, or the time is too long ago.

        Moving transforms are interpolated; the newest one holds beyond its stamp.
        """
        if (ways := self._ways(parent, child)) is None:
            return None
        try:
            below, above = (self._climbed(way, stamp) for way in ways)
        except EagorError:
            return None
        return composed(inverse(above), below)

    def _ways(self, parent: str, child: str) -> tuple[list[str], list[str]] | None:
        """The frames whose links lead from `child`, and from `parent`, to the first frame that both lie in."""
        up, down = self._ancestors(_named(child)), self._ancestors(_named(parent))
        common = next((frame for frame in up if frame in down), None)
        return None if common is None else (up[: up.index(common)], down[: down.index(common)])

    def _climbed(self, frames: list[str], stamp: float) -> Transform:
        found = IDENTITY
        for frame in frames:
            if frame in self._fixed:
                step = self._fixed[frame][1]
            else:
                rotation, place = self._moving[frame][1].at(stamp)
                assert place is not None
                step = rotation, place
            found = composed(step, found)
        return found

    def _ancestors(self, frame: str) -> list[str]:
        found = [frame]
        while len(found) <= MOST:
            link = self._fixed.get(found[-1]) or self._moving.get(found[-1])
            if link is None:
                break
            found.append(link[0])
        return found


def _named(frame: str) -> str:
    return frame.lstrip("/")  # as tf of ROS 1 began them


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
        turn = before.world_R_body.T @ pose.world_R_body
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])  # 2 sin(angle)
        sine = float(np.linalg.norm(axis))
        rate = axis * (math.atan2(sine, float(np.trace(turn)) - 1) / (max(sine, 1e-12) * gap))
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

    `camera`: the camera's frame; its pose is told, by the transforms between it and the frame of the message; that its
    name contradicts them is a `UserWarning`, once. "": its pictures name none, so that its axes are taken for those of
    the `body`, which is a problem. None: the pose of the `body` is wanted. `strict`: give no pose before these
    transforms are known; otherwise the camera's axes are taken for those of the message. `world`: the frame of the
    poses for transforms (default: odom, else map, else the root of the tree). `rewinds`: whether the stamps may go back
    by more than a second, as those of a clock that was set; otherwise such poses are left out, which is said once, from
    `OVERTAKEN` on, and `back` counts them. `turning`: how well the poses tell what lies between them. `problem`: what
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
        self.camera, self.body, self.world, self.strict = camera and _named(camera), _named(body), world, strict
        self.rewinds = rewinds
        self.problem = self._unnamed = unnamed(body) if camera == "" else None
        self.tree = TransformTree()
        self.turning = Turning()
        self._frames: tuple[str, str] | None = None
        self._last, self.back, self._mounted = -math.inf, 0, False

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

    def _base(self) -> str:
        """The frame of the body, by the name that it has here."""
        if self._frames is not None and self.kind == ODOMETRY and self.body not in self.tree.frames:
            return self._frames[1] or self.body
        return self.body

    def _check_mount(self, stamp: float) -> None:
        """Say once that the camera is mounted as its name does not have it."""
        if self._mounted or not self.camera or self.camera == self._base():
            return
        if (found := self.tree.at(self._base(), self.camera, stamp)) is not None:
            self._mounted = True
            if (told := contradiction(self.camera, found[0])) is not None:
                warnings.warn(told, UserWarning, stacklevel=4)

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
            untold = self.kind == ODOMETRY and source not in self.tree.frames  # base_footprint, where base_link is
            known = self.body if untold else source
            found = self.tree.at(known, target, stamp)
        self.problem = self._unnamed
        if found is None:
            self.problem = f"/tf_static and /tf do not tell where {target} is in {source}"
            if self.strict:
                return None
            if self.camera:
                self.problem += ": the camera is taken to look ahead along it"
            else:
                self.problem = self._unnamed  # the body is what the odometry tells of
            return IDENTITY
        return found[0] @ optical(target), found[1]

    def _of_tree(self) -> list[Pose]:
        """The pose at the newest time that all transforms from the world to the camera reach."""
        target, unknown = self.camera or self.body, None
        if target not in self.tree.frames and self.camera:
            unknown = f"/tf and /tf_static do not tell where {self.camera} is"
            if self.strict:
                self.problem = unknown
                return []
            target, unknown = self.body, f"{unknown}: it is taken to look ahead along {self.body}"
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
        self.problem = unknown or self._unnamed
        rotation, place = composed(found, (optical(target), np.zeros(3)))
        return self._in_order(Pose(stamp, rotation, place))

    def _in_order(self, pose: Pose) -> list[Pose]:
        if pose.stamp <= self._last and not (self.rewinds and pose.stamp < self._last - BACK):
            if pose.stamp < self._last - (0.0 if self.back else OVERTAKEN) and not self.rewinds:
                if not self.back:
                    warnings.warn(
                        f"the stamps of {self.topic} go back by {self._last - pose.stamp:.2f} s at {self._last:.3f} s: "
                        "its poses are left out until they have passed that, and may be those of other times after it",
                        UserWarning,
                        stacklevel=2,
                    )
                self.back += 1
            return []
        self._last = pose.stamp
        self._check_mount(pose.stamp)
        self.turning.add(pose)
        if self.problem is None and self.turning.midway > TOLERATED:
            self.problem = self.turning.said(self.topic)
        return [pose]

    @staticmethod
    def _said(frames: tuple[str, str] | None) -> str:
        return " in ".join(reversed([frame or "no frame" for frame in frames or () if frame])) or "no frame"
