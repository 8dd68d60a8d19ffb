"""From messages to poses of the camera: odometry, poses, an IMU's orientation, or transforms; live or from a bag.

Transforms are the tree of frames of ``/tf`` and ``/tf_static`` (REP-105): where one is in another, at a time. A
transform is (R, t): a point p of the child frame is ``R @ p + t`` in the parent frame.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from contextlib import suppress
from functools import lru_cache
from statistics import fmean, median
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from eagor.conventions import OPTICAL_R_BODY, is_optical
from eagor.errors import DeviceError, EagorError
from eagor.odometry.axes import AXES
from eagor.sources import Pose
from eagor.sources.ros_messages import IMU, ODOMETRY, TRANSFORMS, pose_from_msg, rotation_of, seconds, triple
from eagor.tracking.poses import PoseHistory

__all__ = [
    "BACK", "BODY", "IDENTITY", "TOLERATED", "PoseReader", "Transform", "TransformTree", "Turning", "contradiction",
    "optical",
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


def _composed(a: Transform, b: Transform) -> Transform:
    """First `b`, then `a`."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


@lru_cache(maxsize=64)
def optical(frame: str) -> np.ndarray:
    """The rotation ``frame_R_camera`` ``(3, 3)`` of a camera's own axes (x forward) in the frame that names it."""
    return OPTICAL_R_BODY if is_optical(frame) else IDENTITY[0]


def contradiction(frame: str, body_R_frame: np.ndarray) -> str | None:
    """In words, that a camera's frame is mounted as if its name were wrong: as an optical one, or none. Else None."""
    named, (_, y, z) = is_optical(frame), body_R_frame[2]  # how much the axes of the frame point up
    if named and z > STEEP:
        told = "named as an optical frame (x right, y down, z ahead: REP-103), and mounted with its z axis up: the"
        return f"{frame} is {told} camera is taken to look up. If x is ahead, name it otherwise; of a bag: --axes body"
    if not named and y < -STEEP:
        told = "not named as an optical frame, and mounted as one, with its y axis down: the camera is taken to look"
        fix = f"If z is ahead, name it {frame}_optical_frame (REP-103); of a bag: --axes optical"
        return f"{frame} is {told} along x, and to lie on its side. {fix}"
    return None


class TransformTree:
    """The frames that have been told of. Not for several threads."""

    def __init__(self) -> None:
        self._links: dict[str, tuple[str, Transform | PoseHistory]] = {}  # a frame's parent, and where it is in that
        self._newest: dict[str, float] = {}  # stamps of those that move

    @property
    def frames(self) -> set[str]:
        """All that are known, parents included."""
        return {*self._links, *(parent for parent, _ in self._links.values())}

    def add(self, received: Any, fixed: bool) -> set[str]:
        """Take in a TFMessage; returns the frames that have been moved. What is damaged or out of order is left out.

        Where the stamps of a frame go back by more than `BACK` its older transforms are forgotten, as tf2 does.
        """
        news = set()
        for each in received.transforms:
            parent, child, stamp = _named(each.header.frame_id), _named(each.child_frame_id), seconds(each.header.stamp)
            with suppress(EagorError):
                place = rotation_of(each.transform.rotation), triple(each.transform.translation)
                if fixed:
                    self.fix(parent, child, place)
                else:
                    before, history = self._links.get(child, ("", None))
                    if before != parent or child not in self._newest or stamp < self._newest[child] - BACK:
                        history = PoseHistory(KEPT)
                        self._links[child], self._newest[child] = (parent, history), stamp
                    assert isinstance(history, PoseHistory)
                    history.add(stamp, *place)
                    self._newest[child] = stamp
                news.add(child)
        return news

    def fix(self, parent: str, child: str, transform: Transform) -> None:
        """Take it that the child does not move in its parent."""
        self._links[child] = parent, transform
        self._newest.pop(child, None)

    def between(self, parent: str, child: str) -> list[str] | None:
        """The frames whose links lead from `child` to `parent`, in no order; None if these are not connected."""
        return (ways := self._ways(parent, child)) and ways[0] + ways[1]

    def newest(self, parent: str, child: str) -> float | None:
        """The newest time that all moving transforms between two frames reach; None if none moves."""
        moving = self.between(parent, child) or ()
        return min((self._newest[each] for each in moving if each in self._newest), default=None)

    def root(self, frame: str) -> str:
        """The last of the frame's parents."""
        return self._ancestors(_named(frame))[-1]

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
        return _composed((above[0].T, -above[0].T @ above[1]), below)

    def _ways(self, parent: str, child: str) -> tuple[list[str], list[str]] | None:
        """The frames whose links lead from `child`, and from `parent`, to the first frame that both lie in."""
        up, down = self._ancestors(_named(child)), self._ancestors(_named(parent))
        common = next((frame for frame in up if frame in down), None)
        return None if common is None else (up[: up.index(common)], down[: down.index(common)])

    def _climbed(self, frames: list[str], stamp: float) -> Transform:
        found = IDENTITY
        for frame in frames:
            step: Any = self._links[frame][1]
            step = step.at(stamp) if isinstance(step, PoseHistory) else step
            found = _composed(step, found)
        return found

    def _ancestors(self, frame: str) -> list[str]:
        found = [frame]
        while len(found) <= MOST and found[-1] in self._links:
            found.append(self._links[found[-1]][0])
        return found


def _named(frame: str) -> str:
    return frame.lstrip("/")  # as tf of ROS 1 began them


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
        rate, self._rate = self._rate, None
        if before is None or (gap := pose.stamp - before.stamp) <= 0:
            return
        self._gaps.append(gap)
        if gap > HOLE * median(self._gaps):  # it may have turned about, and the shortest turn is none of it
            return
        self._rate = Rotation.from_matrix(before.world_R_body.T @ pose.world_R_body).as_rotvec() / gap, gap
        if rate is not None:
            change = self._rate[0] - rate[0]
            self._density.append(3 * float(change @ change) / (gap + rate[1]))

    @property
    def midway(self) -> float:
        """Standard deviation, radians, midway between two poses that are as far apart as most are."""
        many = len(self._density) >= FEWEST
        return math.sqrt(fmean(self._density) * median(self._gaps) ** 3 / 48) if many else 0.0

    def problem(self, topic: str) -> str | None:
        """That it is more than can be tolerated, in words."""
        return None if self.midway <= TOLERATED else (
            f"{topic} tells a pose every {median(self._gaps):.2f} s, too seldom for how the turning changes: between "
            f"two of them, directions are off by {math.degrees(self.midway):.1f} degrees (standard deviation); wanted "
            "odometry at a higher rate"
        )  # fmt: skip


class PoseReader:
    """Makes poses of the messages on one `topic` of type `kind`.

    `camera`: the camera's frame; its pose is told, by the transforms between it and the frame of the message; that its
    name contradicts them is a `UserWarning`, once. "": its pictures name none: its axes are taken for those of the
    `body`, which is a problem. None: the pose of the `body` is wanted. `axes`: those of the camera's frame, a name of
    `eagor.odometry.axes.AXES`, or "auto": as its name says. `strict`: give no pose before these transforms are known;
    otherwise the camera's axes are taken for those of the message. `world`: the frame of the poses for
    transforms (default: odom, else map, else the root). `rewinds`: stamps may go back by more than a second, as those
    of a clock that was set; otherwise such poses are left out, said once, and counted in `back`. `problem`: what is
    missing, in words, or None. After a pose `axes` are those that were taken.
    """

    def __init__(
        self,
        topic: str,
        kind: str,
        *,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
        axes: str = "auto",
        strict: bool = False,
        rewinds: bool = False,
    ) -> None:
        self.topic, self.kind = topic, kind
        self.camera, self.body, self.world, self.strict = camera and _named(camera), _named(body), world, strict
        self.rewinds, self.tree, self.turning = rewinds, TransformTree(), Turning()
        self._unnamed = (
            f"the pictures name no frame (frame_id is empty): the camera's axes are taken for those of {body}; set it "
            "in the camera's driver, or name the frame (eagor ros --camera)"
        ) if camera == "" else None  # fmt: skip
        self.problem = self._unnamed
        self._frames: tuple[str, str] | None = None
        self._last, self.back, self._mounted = -math.inf, 0, axes != "auto"
        self._axes, self.axes = axes, "body"

    def transforms(self, received: Any, fixed: bool) -> list[Pose]:
        """Take in a message of /tf_static (`fixed`) or /tf; the poses that it gives, if these come from /tf."""
        news = self.tree.add(received, fixed)
        return self._of_tree() if self.kind == TRANSFORMS and news and not fixed else []

    def take(self, received: Any) -> list[Pose]:
        """Take in a message of the topic; the poses that it gives.

        Raises `PoseError` for a message that holds no pose, `DeviceError` if two robots, or two sources of odometry,
        speak on the topic: its frames change.
        """
        if self.kind == TRANSFORMS:
            return self.transforms(received, fixed=False)
        frames = _named(received.header.frame_id), _named(getattr(received, "child_frame_id", ""))
        if self._frames not in (None, frames):
            one, other = (" in ".join(filter(None, each[::-1])) or "no frame" for each in (self._frames or (), frames))
            advice = "two publishers? Stop one of them, or take another topic"
            raise DeviceError(f"{self.topic} has poses of {one} and of {other}: {advice}")
        self._frames = frames
        pose = pose_from_msg(received)
        mount = self._mount(frames[0] if self.kind == IMU else frames[1] or self.body, pose.stamp)
        if mount is None:
            return []
        position = None if pose.position is None else pose.position + pose.world_R_body @ mount[1]
        return self._in_order(Pose(pose.stamp, pose.world_R_body @ mount[0], position))

    def _mount(self, source: str, stamp: float) -> Transform | None:
        """Where the camera is in the frame `source`; None while that is not known and has to be."""
        target, self.problem = self.camera or self.body, self._unnamed
        if target in (source, "") or not source:
            return self._lens(target), IDENTITY[1]
        untold = self.kind == ODOMETRY and source not in self.tree.frames  # base_footprint, where base_link is
        found = self.tree.at(self.body if untold else source, target, stamp)
        if found is not None:
            return _composed(found, (self._lens(target), IDENTITY[1]))
        if not (self.camera or self.strict):  # the body is what the odometry tells of
            return IDENTITY
        self.problem = f"/tf_static and /tf do not tell where {target} is in {source}"
        if self.strict:
            return None
        self.problem += ": the camera is taken to look ahead along it"
        return self._lens(""), IDENTITY[1]

    def _lens(self, frame: str) -> np.ndarray:
        """As `optical`, with the `axes` that are said to be the camera's; keeps their name."""
        named = "optical" if is_optical(frame) else "body"
        self.axes = named if self._axes == "auto" or self.camera is None else self._axes
        return AXES[self.axes][0].T

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
        stamp = self.tree.newest(world, target)
        if stamp is None:
            known = ", ".join(sorted(self.tree.frames))
            self.problem = f"/tf does not tell how {target} moves in {world}; it has {known}"
            return []
        found = self.tree.at(world, target, stamp)
        if found is None:
            return []
        self.problem = unknown or self._unnamed
        return self._in_order(Pose(stamp, *_composed(found, (self._lens(target), IDENTITY[1]))))

    def _in_order(self, pose: Pose) -> list[Pose]:
        late = self._last - pose.stamp
        if late >= 0 and not (self.rewinds and late > BACK):
            if late > (0.0 if self.back else OVERTAKEN) and not self.rewinds:
                if not self.back:
                    warnings.warn(
                        f"the stamps of {self.topic} go back by {late:.2f} s at {self._last:.3f} s: its poses are left "
                        "out until they have passed that, and may be those of other times after it",
                        UserWarning,
                        stacklevel=2,
                    )
                self.back += 1
            return []
        self._last = pose.stamp
        body = self.body
        if self._frames is not None and self.kind == ODOMETRY and body not in self.tree.frames:
            body = self._frames[1] or body  # the name that it has here
        look = self.camera if self.camera != body and not self._mounted else None
        if look and (found := self.tree.at(body, look, pose.stamp)) is not None:
            self._mounted = True  # what contradicts its name is said once
            if (told := contradiction(look, found[0])) is not None:
                warnings.warn(told, UserWarning, stacklevel=3)
        self.turning.add(pose)
        self.problem = self.problem or self.turning.problem(self.topic)
        return [pose]
