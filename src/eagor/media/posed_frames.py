"""A stream of poses, and of the frames that were taken there.

Poses come from a file, from a video's IMU, from the odometry of a bag, or from the pictures themselves. Frames and
poses are read in step.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Semaphore, Thread
from typing import Any

import numpy as np

from eagor.errors import EagorError, PoseError
from eagor.media import Pose
from eagor.media.footage import BagFrames, Frames, ImageFrames, Read
from eagor.media.panorama import Picture
from eagor.odometry.files import BEYOND, FramePose, interpolated, pair, usable
from eagor.odometry.times import times_of

__all__ = ["PosedFrame", "ahead", "posed_by_file", "posed_by_imu", "posed_by_odometry", "posed_by_sight", "thinned"]

HOLE = 0.5  # seconds without a pose that are worth a word
LONGEST = 2.0  # and over which poses are interpolated: a robot may turn half round in them, either way


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A pose, and the frame that was taken there.

    `frame`: its name; None for odometry between the frames. `read`: gives its panorama, or raises `EagorError`.
    `looked`: whether the perception looks at it; otherwise it is only drawn. `lost`: whether nothing tells how the
    camera turned since the frame before, so that the belief has to start anew. `spread`: deviation of the pose's error,
    radians per axis, where it is known.
    """

    pose: FramePose
    frame: str | None = None
    read: Read | None = None
    looked: bool = True
    lost: bool = False
    spread: float = 0.0


def posed_by_file(source: Frames, poses: Sequence[FramePose], name: Path) -> Iterator[PosedFrame]:
    """Frames with the poses of a file: images by name or in order, frames of a video by time.

    Poses that cannot be are left out (`usable`), and with them the images that were taken there.
    """
    near = usable(poses, name)
    if isinstance(source, ImageFrames):
        if (timed := _timed(source, near, len(poses), name)) is not None:
            return _by_time(timed, near, name)
        return _by_image(pair(poses, source.paths, name), near[0], source)
    return _by_time(source, near, name)


def _timed(source: ImageFrames, poses: Sequence[FramePose], count: int, name: Path) -> ImageFrames | None:
    """The pictures at the times that their names tell, among `poses`; None where they are paired otherwise.

    Those before the first pose, and after the last one, are left out.
    """
    times = times_of([path.stem for path in source.paths])
    if times is None or len({*times}) < len(times) or any(pose.frame for pose in poses):
        return None
    paired = sorted(zip(times, source.paths, strict=True))
    inside = [each for each in paired if poses[0].stamp - BEYOND <= each[0] <= poses[-1].stamp + BEYOND]
    if len(inside) < len(paired) == count:
        return None  # numbers of another kind; as many poses as pictures: in order
    if 0 < len(inside) < len(paired):
        lost = len(paired) - len(inside)
        text = f"{lost} of {len(paired)} pictures are left out: {name} has no poses for the times of their names"
        warnings.warn(text, UserWarning, stacklevel=3)
    stamps, paths = zip(*(inside or paired), strict=True)
    return replace(source, paths=paths, stamps=stamps)


def _by_image(
    pairs: Sequence[tuple[FramePose, Path | None]], pose: FramePose, source: ImageFrames
) -> Iterator[PosedFrame]:
    """Each pose of a file, and the image that was taken there, of several cameras each one's."""
    for told, image in pairs:
        if told.near:
            pose = told
            if image is None:
                yield PosedFrame(pose)
                continue
            for name, read in source.moment(image):
                yield PosedFrame(pose, name, read)
        elif image is not None:  # the frame is told of, at the pose before
            here = pose._replace(stamp=told.stamp, frame=told.frame)
            yield PosedFrame(here, image.name, partial(_refused, told))


def _refused(pose: FramePose) -> Picture:
    raise PoseError(f"its pose has the position {np.asarray(pose.position).tolist()}; wanted metres that can be")


def _by_time(source: Frames, poses: Sequence[FramePose], name: Path) -> Iterator[PosedFrame]:
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
            yield PosedFrame(poses[fed])
            fed += 1
        yield PosedFrame(FramePose(stamp, *at(stamp), frame), frame, read)


def posed_by_imu(source: Frames, motion: Any) -> Iterator[PosedFrame]:
    """Frames of a video with the orientations that its IMU track tells."""
    for stamp, frame, read in source.frames():
        yield PosedFrame(FramePose(stamp, motion.world_R_body(stamp), None, frame), frame, read)


def posed_by_sight(source: Frames, level: bool) -> Iterator[PosedFrame]:
    """Frames with the orientations that the pictures themselves tell (`eagor.odometry.visual`).

    `level`: the camera keeps its pictures level; only the heading turns.
    """
    from eagor.odometry.visual import VisualOdometer

    odometer, met = VisualOdometer(level=level), False
    upright = np.eye(3) if source.level_R_body is None else source.level_R_body
    turn = upright
    for stamp, frame, read in source.frames():
        try:
            found = read()
        except EagorError:  # the caller meets it again, and says so
            yield PosedFrame(FramePose(stamp, turn, None, frame), frame, read)
            continue
        turned = odometer.add(found.picture, None if found.grid is None else stamp, found.grid)
        turn = upright @ turned.world_R_body
        pose = FramePose(stamp, turn, None, frame)
        lost = turned.lost and met
        yield PosedFrame(pose, frame, lambda found=found: found, lost=lost, spread=turned.std)
        met = True


def posed_by_odometry(
    source: BagFrames,
    poses: Any,
    say: Callable[[str], object] = lambda text: None,
    lost: Callable[[str], object] = lambda text: None,
) -> Iterator[PosedFrame]:
    """Frames of a bag with the `poses` of its odometry (`eagor.media.bag_sources`), interpolated at their stamps.

    Frames before the first pose and after the last one are left out, and `say` is told of it, and of what is wrong with
    the poses. Those in a hole of more than `LONGEST` seconds are as well, and `lost` is told. Raises `PoseError` if all
    are left out.
    """
    coming: Iterator[Pose] = iter(poses)
    last: Pose | None = None
    ahead = next(coming, None)
    first = math.nan if ahead is None else ahead.stamp
    early = late = within = used = 0
    told = False
    for stamp, name, read in source.frames():
        while ahead is not None and ahead.stamp < stamp:
            if used:
                yield PosedFrame(FramePose(ahead.stamp, ahead.world_R_body, ahead.position, None))
            last, ahead = ahead, next(coming, None)
        if poses.problem and not told:
            told = True
            say(f"warning: {poses.problem}")
        if last is None and (ahead is None or ahead.stamp - stamp > BEYOND):
            early += 1
            continue
        if ahead is None and last is not None and stamp - last.stamp > BEYOND:
            late += 1
            continue
        hole = 0.0 if last is None or ahead is None else ahead.stamp - last.stamp
        if last is not None and ahead is not None and hole > LONGEST:
            if min(stamp - last.stamp, ahead.stamp - stamp) > BEYOND:
                within += 1
                continue
        elif hole > HOLE:
            say(f"warning: {name}: {poses.topic} has no pose for {hole:.2f} s about it")
        pose = interpolated([each for each in (last, ahead) if each is not None])(stamp)
        used += 1
        yield PosedFrame(FramePose(stamp, *pose, name), name, read)
    if within and used:
        lost(f"{within} pictures are left out: {poses.topic} has no pose for more than {LONGEST:g} s about them")
    if not used and early + late + within:
        holes = f" with a hole of more than {LONGEST:g} s about {within} of the pictures" if within else ""
        raise PoseError(
            f"no picture of {source.camera.topic} has a pose of {poses.topic}, which tells those from {first:.3f} to "
            f"{math.nan if last is None else last.stamp:.3f} s{holes}; the pictures begin at "
            f"{source.camera.begins:.3f} s. Are both stamped by one clock? Or --poses level: headings from the "
            "pictures themselves"
        )
    for count, side in ((early, "before the first"), (late, "after the last")):
        if count:
            say(f"{count} pictures {side} pose of {poses.topic} are left out")


def thinned(
    frames: Iterable[PosedFrame], rate: float | None, begins: float = 0.0, lenses: int = 1
) -> Iterator[PosedFrame]:
    """The same, with `rate` frames per second from `begins` on looked at (None: all); of each of so many `lenses`."""
    tick, left = -math.inf, 0
    for each in frames:
        if rate is None or each.frame is None or each.lost:
            yield each
            continue
        number = math.floor((each.pose.stamp - begins) * rate + 1e-6)
        left = lenses if number > tick else left
        yield each if left > 0 else replace(each, looked=False)
        tick, left = max(tick, number), left - 1


def ahead(frames: Iterable[PosedFrame], most: int = 2) -> Iterator[PosedFrame]:
    """The same, made by a thread of their own while the caller works on the ones before: at most so many wait.

    Decoding and finding the camera's rotation let go of Python's lock. What making them raises is raised here, at its
    place. The thread ends with the iterator.
    """
    made: SimpleQueue[PosedFrame | BaseException | None] = SimpleQueue()
    room, stop = Semaphore(most), Event()

    def make() -> None:
        source = iter(frames)
        try:
            for each in source:
                while each.read is not None and not room.acquire(timeout=0.1):
                    if stop.is_set():
                        return
                if stop.is_set():
                    return
                made.put(each)
            made.put(None)
        except BaseException as error:
            made.put(error)
        finally:
            if isinstance(source, Generator):
                source.close()

    thread = Thread(target=make, name="eagor-frames", daemon=True)
    thread.start()
    try:
        while (each := made.get()) is not None:
            if isinstance(each, BaseException):
                raise each
            if each.read is not None:
                room.release()
            yield each
    finally:
        stop.set()
        thread.join()
