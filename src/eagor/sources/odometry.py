"""How the camera turns and moves: `open_poses` for what ``--poses`` means; `PosedFrames` for pictures with poses.

Packages add sources of poses under the entry points ``eagor.poses``: a name, and a function ``(text, *, camera, domain,
interface) -> PoseSource``, which gets the whole text, such as ``NAME:REST``.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eagor import plugins
from eagor._extras import require_extra
from eagor.errors import DeviceError, EagorError, PoseError
from eagor.odometry.axes import AXES, contradicted, settled
from eagor.odometry.files import BEYOND, GivenPoses, interpolated, is_near, pair, read_poses, usable
from eagor.odometry.imu import MotionTrack
from eagor.odometry.visual import WALKS, VisualOdometer
from eagor.sources import CameraSource, Frame, Pose, PoseSource
from eagor.sources.camera_sources import Footage, Images, warned
from eagor.sources.panorama import Picture
from eagor.sources.ros_sources import BagPoses, bag_odometry

__all__ = [
    "GivenPoses", "PosedFrame", "PosedFrames", "open_poses", "poses_for", "poses_in_words", "prefetched",
]  # fmt: skip

GROUP = "eagor.poses"
BUILT_IN = {"go2": "eagor.robots:go2_poses", "ros": "eagor.robots.ros:ros_poses"}
BY_SIGHT = ("auto", "level")
HOLE = 0.5  # seconds without a pose that are worth a word
LONGEST = 2.0  # and over which poses are interpolated: a robot may turn half round in them, either way

T = TypeVar("T")


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
    `eagor.odometry.axes.settled` (with a bag's odometry: those of the camera's frame); ``ros:/odom``, a topic of ROS 2
    or of a bag; ``go2``, a robot's odometry, over the DDS `domain` and network `interface`; or what another package
    brings. Poses of a file or a bag are compared with the pictures; where these are image files, a file tells when they
    were taken: `source` gives them at these times from then on. `say` is told what is found out (default: what is wrong
    is a `UserWarning`). Raises `DeviceError` for live poses of a recording, and the other way round, and what the
    source raises.
    """
    name, _, topic = text.partition(":")
    footage, own = source if isinstance(source, Footage) else None, getattr(source, "poses", None)
    bag, video = (None, None) if footage is None else (footage.bag, footage.video)
    if bag and footage and (text == "auto" or name == "ros"):
        found = bag_odometry(bag.bag, topic or None, bag.frame, axes)
        if found is not None:
            if axes != "body":
                _compare(BagPoses(bag.bag, found.topic, camera=bag.frame, axes=axes), footage, say or warned)
            return found
    if text == "auto" and video is not None and video.motion is not None:
        return video.motion
    if text == "auto" and own is not None:  # a simulated body knows its own
        return own
    if text in BY_SIGHT:
        require_extra("the rotation from pictures", "photos", "cv2")
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
    if isinstance(poses, MotionTrack):
        return "orientations from the video's IMU"
    if getattr(poses, "level", False):
        return "headings from the pictures themselves, which are taken as level"
    return "orientations from the pictures themselves"


# --- poses, and the pictures that were taken there ---


def _compare(poses: BagPoses, source: Footage, say: Callable[[str], object]) -> None:
    """Say where the odometry of a bag contradicts its pictures."""

    def posed() -> Iterator[tuple[Pose, Frame]]:
        for each in PosedFrames(Footage(source.items, source.latency, source.begins, bag=source.bag), poses):
            if each.pose is not None and each.frame.picture is not None:
                axes = AXES[poses.reader.axes][0]
                yield replace(each.pose, world_R_body=each.pose.world_R_body @ axes), each.frame

    with warnings.catch_warnings():  # who plays it again is told again
        warnings.simplefilter("ignore")
        wrong = contradicted(posed(), lambda: poses.reader.axes)
    if wrong:
        say(
            f"warning: {poses.topic} contradicts the pictures ({wrong}); --poses level takes headings from the pictures"
        )


def _of_file(path: str, axes: str, source: Footage | None, say: Callable[[str], object]) -> GivenPoses:
    """The poses of a file, in our axes."""
    read = read_poses(path)
    near = read.made(usable(read, path))
    if source is not None and source.images is not None:
        source.images = _paired(source.images, read, near, path)
        source.items = source.images.items
    at = interpolated(near)

    def posed() -> Iterator[tuple[Pose, Frame]]:
        for frame in () if source is None else Footage(source.items):
            if frame.picture is not None:
                yield Pose(frame.stamp, *at(frame.stamp)), frame

    return settled(near, axes, path, None if source is None else posed, say)


def _paired(frames: Images, poses: GivenPoses, near: GivenPoses, name: str) -> Images:
    """The pictures at the times of their poses: by their names' times, by the names of frames, or else in order.

    Raises as `pair`. A picture whose pose cannot be one raises `PoseError` when it is read.
    """
    if poses.guessed and {path.name for path in frames.paths}.isdisjoint(pose.frame for pose in poses):
        poses = poses.made(replace(pose, frame=None) for pose in poses)
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
    refused = {image: pose for pose, image in pairs if not is_near(pose)}

    def read(path: Path) -> Picture:
        if path in refused:
            place = np.asarray(refused[path].position).tolist()
            raise PoseError(f"its pose has the position {place}; wanted metres that can be")
        return frames.read(path)

    paths, stamps = tuple(image for _, image in pairs), tuple(pose.stamp for pose, _ in pairs)
    return replace(frames, paths=paths, stamps=stamps, read=read)


# --- recorded pictures with their poses ---


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A picture, the `pose` at its time, and the poses since the picture `before` it; None where the camera stands.

    `looked`: whether the perception looks at it; otherwise it is only drawn. `lost`: whether nothing tells how the
    camera turned since the frame before, so that the belief has to start anew.
    """

    frame: Frame
    pose: Pose | None = None
    before: tuple[Pose, ...] = ()
    looked: bool = True
    lost: bool = False

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All of its poses, in order of time."""
        return self.before if self.pose is None else (*self.before, self.pose)


class PosedFrames:
    """Iterate for each picture of a recording with its pose; `looks` a second are looked at (None: all).

    Of the pictures of a bag, those before its first pose and after its last one are left out, which `say` is told, and
    those in a hole of more than `LONGEST` seconds: `left_out` tells it in the end, and what was out of order. Raises
    `PoseError` if all are left out, and for a picture outside of the poses of a file; otherwise as the source.
    """

    def __init__(
        self,
        source: CameraSource,
        poses: PoseSource | VisualOdometer | None,
        looks: float | None = None,
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.source, self.poses, self.looks, self._say = source, poses, looks, say
        self._begins = source.begins if isinstance(source, Footage) else 0.0
        self.left_out: list[str] = []

    def __iter__(self) -> Iterator[PosedFrame]:
        poses, last = self.poses, -1
        if isinstance(poses, VisualOdometer):
            found = self._by_sight(poses)
        elif isinstance(poses, MotionTrack):
            found = (PosedFrame(each, Pose(each.stamp, poses.world_R_body(each.stamp))) for each in self.source)
        else:
            found = map(PosedFrame, self.source) if poses is None else self._by_odometry(poses)
        for each in found:
            if self.looks is None or each.lost:
                yield each
                continue
            tick = math.floor((each.frame.stamp - self._begins) * self.looks + 1e-6)
            yield replace(each, looked=tick > last)
            last = max(tick, last)
        bag = self.source.bag if isinstance(self.source, Footage) else None
        if bag is not None and bag.back:
            self.left_out.append(f"{bag.back} pictures of {bag.topic} whose stamps go back are left out")

    def _by_sight(self, odometer: VisualOdometer) -> Iterator[PosedFrame]:
        """With the orientations that the pictures themselves tell; the first one is level if its file says how."""
        video = self.source.video if isinstance(self.source, Footage) else None
        told = None if video is None else video.level_R_body
        pose = upright = np.eye(3) if told is None else told
        met = False
        for frame in self.source:
            lost, spread, walked = False, 0.0, odometer.walks
            if frame.picture is not None:
                with suppress(EagorError):  # the perception meets it again, and says so
                    turned = odometer.add(frame.picture, None if frame.grid is None else frame.stamp, frame.grid)
                    pose, spread = upright @ turned.world_R_body, turned.std
                    lost, met = turned.lost and met, True
            if odometer.walks and not walked:
                self._say(WALKS)
            yield PosedFrame(frame, Pose(frame.stamp, pose, spread=spread, walks=odometer.walks), lost=lost)

    def _by_odometry(self, poses: PoseSource) -> Iterator[PosedFrame]:
        """With poses interpolated at the times of the pictures."""
        name = getattr(poses, "topic", "") or getattr(poses, "name", "odometry")
        strict = isinstance(poses, GivenPoses)  # a file that does not fit is the wrong one
        coming, last, before, problem = iter(poses), None, list[Pose](), ""
        ahead = next(coming, None)
        begins, posed_at, lacking = math.nan if ahead is None else ahead.stamp, -math.inf, Counter[str]()
        for frame in self.source:
            stamp, lacks = frame.stamp, ""
            while ahead is not None and ahead.stamp < stamp:
                before += [ahead] if (strict or posed_at > -math.inf) and ahead.stamp > posed_at else []
                last, ahead = ahead, next(coming, None)
            if not problem and (problem := getattr(poses, "problem", None) or ""):
                self._say(f"warning: {problem}")
            hole = 0.0 if strict or last is None or ahead is None else ahead.stamp - last.stamp
            if last is None and (ahead is None or stamp < ahead.stamp - BEYOND):
                lacks = "before the first"
            elif last is not None and ahead is None and stamp > last.stamp + BEYOND:
                lacks = "after the last"
            elif hole > LONGEST and min(stamp - last.stamp, ahead.stamp - stamp) > BEYOND:  # type: ignore[union-attr]
                lacks = "within"
            if lacks and isinstance(poses, GivenPoses) and not frame.problem:
                ends = poses[-1].stamp if poses else math.nan
                raise PoseError(
                    f"{frame.name} has no pose: {name} tells those from {begins:.10g} to {ends:.10g} s. The "
                    "clock of a video begins at 0, that of a bag is in its headers. Shift the stamps of the file, or "
                    "cut with --start, --end"
                )
            if lacks and not strict:
                lacking[lacks] += 1
                continue
            if HOLE < hole <= LONGEST:
                self._say(f"warning: {frame.name}: {name} has no pose for {hole:.2f} s about it")
            posed_at, at = stamp, interpolated([each for each in (last, ahead) if each is not None])
            yield PosedFrame(frame, Pose(stamp, *at(stamp)), tuple(before))
            before.clear()
        within = lacking.pop("within", 0)
        if posed_at == -math.inf and (lacking or within):
            ends = max((each.stamp for each in (last, ahead, *coming) if each is not None), default=math.nan)
            holes = f" with a hole of more than {LONGEST:g} s about {within} of the pictures" if within else ""
            raise PoseError(
                f"no picture has a pose of {name}, which tells those from {begins:.3f} to {ends:.3f} s{holes}; the "
                f"pictures begin at {self._begins:.3f} s. Are both stamped by one clock? Or --poses level: headings "
                "from the pictures themselves"
            )
        if within:
            about = f"{name} has no pose for more than {LONGEST:g} s about them"
            self.left_out.append(f"{within} pictures are left out: {about}")
        for side, count in lacking.items():
            self._say(f"{count} pictures {side} pose of {name} are left out")
        reader = getattr(poses, "reader", None)
        if reader is not None and reader.back:
            self.left_out.append(f"{reader.back} poses of {name} whose stamps go back are left out")


def prefetched(items: Iterable[T], most: int = 2) -> Generator[T, None, None]:
    """The same, made by a thread of their own while the caller works on the ones before: at most so many wait.

    Decoding and finding the camera's rotation let go of Python's lock. What making them raises is raised here, at its
    place. The thread ends with the iterator.
    """
    source, ahead = iter(items), deque[Future[T | None]]()
    with ThreadPoolExecutor(1, "eagor-frames") as pool:
        try:
            while True:
                while len(ahead) <= most:
                    ahead.append(pool.submit(next, source, None))
                each = ahead.popleft().result()
                if each is None:
                    return
                yield each
        finally:
            for waiting in ahead:
                waiting.cancel()
            if isinstance(source, Generator):
                pool.submit(source.close).result()
