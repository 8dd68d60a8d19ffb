"""How the camera turns and moves: `open_poses` for what ``--poses`` means.

Packages add sources of poses under the entry points ``eagor.poses``: a name, and a function ``(text, *, camera, domain,
interface) -> PoseSource``, which gets the whole text, such as ``NAME:REST``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import plugins
from eagor._extras import need
from eagor.errors import DeviceError, PoseError
from eagor.media import CameraSource, Pose, PoseSource
from eagor.media.bag_sources import BagPoses, bag_odometry
from eagor.media.footage import Footage, ImageFrames, warned
from eagor.media.panorama import Picture
from eagor.odometry.axes import settled
from eagor.odometry.files import BEYOND, FramePose, Poses, interpolated, pair, read_poses, usable

if TYPE_CHECKING:
    from eagor.odometry.imu import MotionTrack
    from eagor.odometry.visual import VisualOdometer

__all__ = ["GivenPoses", "MotionPoses", "open_poses", "poses_for", "poses_in_words"]

GROUP = "eagor.poses"
BUILT_IN = {"go2": "eagor.robots:go2_poses", "ros": "eagor.robots.ros:ros_poses"}
BY_SIGHT = ("auto", "level")
MOTION_RATE = 100.0  # poses per second that are taken from a motion track


class GivenPoses:
    """Poses that are there already, in order of time; `name`: where they are from, `ends`: the stamp of the last."""

    def __init__(self, poses: Sequence[Pose], name: str = "the poses") -> None:
        self._poses, self.name = tuple(poses), name
        self.ends = self._poses[-1].stamp if self._poses else float("nan")

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._poses)

    def close(self) -> None:
        """Nothing is held."""


class MotionPoses:
    """Orientations of a video's motion track, `MOTION_RATE` per second."""

    def __init__(self, track: MotionTrack) -> None:
        self.track = track

    def __iter__(self) -> Iterator[Pose]:
        for number in range(int((self.track.end - self.track.start) * MOTION_RATE) + 1):
            yield self.at(self.track.start + number / MOTION_RATE)

    def at(self, stamp: float) -> Pose:
        """The pose at any time."""
        return Pose(stamp, self.track.world_R_body(stamp))

    def close(self) -> None:
        """Nothing is held."""


def open_poses(
    text: str = "auto",
    source: CameraSource | None = None,
    *,
    axes: str = "auto",
    domain: int | None = None,
    interface: str | None = None,
    say: Callable[[str], object] | None = None,
) -> PoseSource | VisualOdometer | None:
    """The poses that `text` names, for the pictures of `source`; None for a camera that stands still.

    "auto": a bag's odometry or a video's IMU, where `source` has them, else what the pictures themselves tell (rotation
    only); "level": the same for a camera that keeps its pictures level; "still"; a file, whose `axes` are as of
    `eagor.odometry.axes.settled`; ``ros:/odom``, a topic of ROS 2 or of a bag; ``go2``, a robot's odometry, over the
    DDS `domain` and network `interface`; or what another package brings. A file of poses is compared with the pictures,
    and where these are image files, tells when they were taken: `source` gives them at these times from then on. `say`
    is told what is found out about a file (default: what is wrong is a `UserWarning`).

    Raises `DeviceError` for live poses of a recording, and the other way round, and what the source raises.
    """
    name, _, topic = text.partition(":")
    footage, own = source if isinstance(source, Footage) else None, getattr(source, "poses", None)
    bag = None if footage is None else footage.bag
    found = bag_odometry(bag.bag, topic or None, bag.frame) if bag and (text == "auto" or name == "ros") else None
    if found is not None:
        return found
    if text == "auto" and footage is not None and footage.motion is not None:
        return MotionPoses(footage.motion)
    if text == "auto" and own is not None:  # a simulated body knows its own
        return own
    if text in BY_SIGHT:
        need("the rotation from pictures", "photos", "cv2")
        from eagor.odometry.visual import VisualOdometer

        return VisualOdometer(level=text == "level")
    if text == "still":
        return None
    known = plugins.known(GROUP, BUILT_IN)
    if name in known:
        if source is not None and not source.live:
            raise DeviceError(f"the poses {text} are live, and the pictures are a recording; wanted a file of poses")
        frame = getattr(source, "frame", None)
        return plugins.bring(known[name], "poses")(text, camera=frame, domain=domain, interface=interface)
    if source is not None and source.live:
        names = ", ".join(f"{each}:..." for each in sorted(known))
        raise DeviceError(f"poses {text!r}: a live camera needs live poses; wanted auto, level, still, {names}")
    return _of_file(text, axes, footage, say or warned)


def poses_for(text: str, source: CameraSource, **how: Any) -> Any:
    """As `open_poses`, or a function that does so, for poses that are live: who may not be there yet, or may go."""
    live = source.live and text.partition(":")[0] in plugins.known(GROUP, BUILT_IN)
    return partial(open_poses, text, source, **how) if live else open_poses(text, source, **how)


def poses_in_words(poses: Any) -> str:
    """Where poses come from."""
    if poses is None:
        return "a camera that stands still"
    if isinstance(poses, GivenPoses | BagPoses):
        return f"poses from {poses.name if isinstance(poses, GivenPoses) else poses.topic}"
    if isinstance(poses, MotionPoses):
        return "orientations from the video's IMU"
    if getattr(poses, "level", False):
        return "headings from the pictures themselves, which are taken as level"
    return "orientations from the pictures themselves"


# --- a file of poses, and the pictures that were taken there ---


def _of_file(path: str, axes: str, source: Footage | None, say: Callable[[str], object]) -> GivenPoses:
    """The poses of a file, in our axes."""
    read = read_poses(path)
    near = read.made(usable(read, path))
    if source is not None and isinstance(source.frames, ImageFrames):
        source.frames = _paired(source.frames, read, near, path)
    at = interpolated(near)

    def posed() -> Iterator[tuple[FramePose, Callable[[], Picture]]]:
        for frame in () if source is None else Footage(source.frames, rows=source.rows):
            if frame.picture is not None:
                picture = Picture(frame.picture, grid=frame.grid)
                yield FramePose(frame.stamp, *at(frame.stamp), frame.name), lambda picture=picture: picture

    found = settled(near, axes, path, None if source is None else posed, say)
    return GivenPoses([Pose(each.stamp, each.world_R_body, each.position) for each in found], path)


def _paired(frames: ImageFrames, poses: Poses, near: Poses, name: str) -> ImageFrames:
    """The pictures at the times of their poses: by their names' times, by the names of frames, or else in order.

    Raises as `pair`. A picture whose pose cannot be one raises `PoseError` when it is read.
    """
    if frames.stamps and not any(pose.frame for pose in poses):
        first, last = near[0].stamp - BEYOND, near[-1].stamp + BEYOND
        inside = [each for each in zip(frames.stamps, frames.paths, strict=True) if first <= each[0] <= last]
        if len(inside) == len(frames.paths) or len(frames.paths) != len(poses):  # else as many poses: in order
            if 0 < len(inside) < len(frames.paths):
                lost = len(frames.paths) - len(inside)
                text = f"{lost} of {len(frames.paths)} pictures are left out: {name} has no poses for the times of "
                warnings.warn(f"{text}their names", UserWarning, stacklevel=4)
                stamps, paths = zip(*inside, strict=True)
                return replace(frames, paths=paths, stamps=stamps)
            return frames
    pairs = [(pose, image) for pose, image in pair(poses, frames.paths, name) if image is not None]
    refused = {image: pose for pose, image in pairs if not pose.near}

    def read(path: Path) -> Picture:
        if path in refused:
            place = np.asarray(refused[path].position).tolist()
            raise PoseError(f"its pose has the position {place}; wanted metres that can be")
        return frames.read(path)

    paths, stamps = tuple(image for _, image in pairs), tuple(pose.stamp for pose, _ in pairs)
    return replace(frames, paths=paths, stamps=stamps, read=read)
