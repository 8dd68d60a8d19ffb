"""What ``eagor track`` follows: a stream of poses, and of the frames that were taken there.

Frames come from images or from a video. Poses come from a file, from the video's IMU, or from the pictures themselves.
Pictures are read one by one: a long video needs no more memory than a short one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eagor.cli.looking import checked_frame, find_frames, read_frame
from eagor.cli.poses import Pose, interpolated, pair, usable
from eagor.cli.stitched import LensPictures
from eagor.cli.terminal import UsageError
from eagor.errors import EagorError, PoseError
from eagor.media.panorama import PanoramaFile

VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".insv", ".avi", ".ts", ".mpg", ".mpeg", ".360")
LEAST_ROWS = 960  # of a video's frames: enough to look nice, and little memory
BEYOND = 0.05  # seconds: a frame so far outside of the poses still takes the nearest one

Read = Callable[[], PanoramaFile]


@dataclass(frozen=True, eq=False)
class Step:
    """A pose, and the frame that was taken there.

    `frame`: its name; None for odometry between the frames. `read`: gives its panorama, or raises `EagorError`.
    `looked`: whether the perception looks at it; otherwise it is only drawn. `lost`: whether nothing tells how the
    camera turned since the frame before, so that the belief has to start anew.
    """

    pose: Pose
    frame: str | None = None
    read: Read | None = None
    looked: bool = True
    lost: bool = False


class Source(Protocol):
    """Frames in order of time: stamp in seconds, name, and what reads the panorama."""

    @property
    def count(self) -> int | None:
        """How many frames will come, if known."""
        ...

    def frames(self) -> Iterator[tuple[float, str, Read]]:
        """The frames."""
        ...

    @property
    def level_R_body(self) -> np.ndarray | None:
        """The rotation ``(3, 3)`` that makes the first frame level, if the file says so."""
        ...


@dataclass(frozen=True)
class Images:
    """Panoramas in files, `rate` per second."""

    paths: tuple[Path, ...]
    rate: float
    force: bool
    lenses: LensPictures | None = None

    @property
    def count(self) -> int:
        return len(self.paths)

    @property
    def level_R_body(self) -> np.ndarray | None:
        return None

    def frames(self) -> Iterator[tuple[float, str, Read]]:
        read = self.reader()
        for number, path in enumerate(self.paths):
            yield number / self.rate, path.name, partial(read, path)

    def reader(self) -> Callable[[Path], PanoramaFile]:
        """What reads one of them."""
        if self.lenses is not None:
            return self.lenses.read
        return partial(read_frame, force=self.force, said=set())


@dataclass(frozen=True)
class Film:
    """The frames of a video (`eagor.media.video.Video`)."""

    video: Any
    force: bool

    @property
    def count(self) -> int | None:
        return self.video.count

    @property
    def level_R_body(self) -> np.ndarray | None:
        return self.video.level_R_body

    def frames(self) -> Iterator[tuple[float, str, Read]]:
        said: set[str] = set()
        for frame in self.video:
            found = PanoramaFile(frame.panorama, self.video.unseen)
            yield frame.stamp, frame.name, partial(checked_frame, found, frame.name, self.force, said)


def is_video(places: Sequence[Path], rig: Path | None = None) -> bool:
    """Whether the one place is a video, by its name; with a `rig` there may be one for each lens."""
    many = len(places) > 1 and rig is None
    return not many and all(place.suffix.lower() in VIDEOS and not place.is_dir() for place in places)


def images(places: Sequence[Path], rate: float, force: bool, rig: Path | None = None) -> Images:
    """The panoramas in a folder, or in image files; with a `rig`, pictures of lenses."""
    if films := [place for place in places if place.suffix.lower() in VIDEOS and not place.is_dir()]:
        raise UsageError(f"{films[0]} is a video, beside other files; give one video, a folder, or image files")
    return Images(find_frames(places), rate, force, None if rig is None else LensPictures(rig))


def with_file(source: Source, poses: Sequence[Pose], name: Path) -> Iterator[Step]:
    """Frames with the poses of a file: images by name or in order, frames of a video by time.

    Poses that cannot be are left out (`usable`), and with them the images that were taken there.
    """
    near = usable(poses, name)
    if isinstance(source, Images):
        return _by_image(pair(poses, source.paths, name), near[0], source.reader())
    return _by_time(source, near, name)


def _by_image(
    pairs: Sequence[tuple[Pose, Path | None]], pose: Pose, read: Callable[[Path], PanoramaFile]
) -> Iterator[Step]:
    """Each pose of a file, and the image that was taken there."""
    for told, image in pairs:
        if told.near:
            pose = told
            yield Step(pose) if image is None else Step(pose, image.name, partial(read, image))
        elif image is not None:  # the frame is told of, at the pose before
            yield Step(pose._replace(stamp=told.stamp, frame=told.frame), image.name, partial(_placeless, told))


def _placeless(pose: Pose) -> PanoramaFile:
    assert pose.position is not None
    raise PoseError(f"its pose has the position {pose.position.tolist()}; wanted metres that can be")


def _by_time(source: Source, poses: Sequence[Pose], name: Path) -> Iterator[Step]:
    """Each frame at its own time, its pose interpolated, among the poses of the file."""
    at = interpolated(poses)
    first, last, fed = poses[0].stamp, poses[-1].stamp, 0
    for stamp, frame, read in source.frames():
        if not first - BEYOND <= stamp <= last + BEYOND:
            raise PoseError(
                f"{frame} has no pose: {name} tells those from {first:.10g} to {last:.10g} s. The clock of a video "
                "begins at 0, that of a bag is in its headers. Shift the stamps of the file, or cut with --start, --end"
            )
        while fed < len(poses) and poses[fed].stamp < stamp:
            yield Step(poses[fed])
            fed += 1
        yield Step(Pose(stamp, *at(stamp), frame), frame, read)


def with_imu(source: Source, motion: Any) -> Iterator[Step]:
    """Frames of a video with the orientations that its IMU track tells."""
    for stamp, frame, read in source.frames():
        yield Step(Pose(stamp, motion.world_R_body(stamp), None, frame), frame, read)


def with_sight(source: Source, level: bool) -> Iterator[Step]:
    """Frames with the orientations that the pictures themselves tell (`eagor.media.rotation`)."""
    from eagor.media.rotation import VisualOdometer

    odometer, met = VisualOdometer(level=level), False
    upright = np.eye(3) if source.level_R_body is None else source.level_R_body
    turn = upright
    for stamp, frame, read in source.frames():
        try:
            found = read()
        except EagorError:  # the caller meets it again, and says so
            yield Step(Pose(stamp, turn, None, frame), frame, read)
            continue
        turned = odometer.add(found.panorama)
        turn = upright @ turned.world_R_body
        yield Step(Pose(stamp, turn, None, frame), frame, partial(_same, found), lost=turned.lost and met)
        met = True


def _same(found: PanoramaFile) -> PanoramaFile:
    return found


def thinned(steps: Iterator[Step], rate: float | None, begins: float = 0.0) -> Iterator[Step]:
    """The same steps, `rate` of their frames per second from `begins` on looked at (None: all)."""
    tick = -math.inf
    for step in steps:
        if rate is None or step.frame is None or step.lost:
            yield step
            continue
        number = math.floor((step.pose.stamp - begins) * rate + 1e-6)
        yield step if number > tick else Step(step.pose, step.frame, step.read, looked=False)
        tick = max(tick, number)
