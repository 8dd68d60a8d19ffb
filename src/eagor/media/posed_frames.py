"""Recorded pictures, each with the pose of the camera at its time.

Poses come from odometry (a file, a video's IMU, a bag), or from the pictures themselves. Both are read in step.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from eagor.errors import EagorError, PoseError
from eagor.media import CameraSource, Frame, Pose, PoseSource
from eagor.media.footage import Footage
from eagor.media.odometry import GivenPoses, MotionPoses
from eagor.odometry.files import BEYOND, interpolated
from eagor.odometry.visual import VisualOdometer

__all__ = ["PosedFrame", "PosedFrames", "prefetched"]

HOLE = 0.5  # seconds without a pose that are worth a word
LONGEST = 2.0  # and over which poses are interpolated: a robot may turn half round in them, either way

T = TypeVar("T")


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
        elif isinstance(poses, MotionPoses):
            found = (PosedFrame(frame, poses.at(frame.stamp)) for frame in self.source)
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
        told = self.source.level_R_body if isinstance(self.source, Footage) else None
        pose = upright = np.eye(3) if told is None else told
        met = False
        for frame in self.source:
            lost, spread = False, 0.0
            if frame.picture is not None:
                with suppress(EagorError):  # the perception meets it again, and says so
                    turned = odometer.add(frame.picture, None if frame.grid is None else frame.stamp, frame.grid)
                    pose, spread = upright @ turned.world_R_body, turned.std
                    lost, met = turned.lost and met, True
            yield PosedFrame(frame, Pose(frame.stamp, pose, spread=spread), lost=lost)

    def _by_odometry(self, poses: PoseSource) -> Iterator[PosedFrame]:
        """With poses interpolated at the times of the pictures."""
        name = getattr(poses, "topic", "") or getattr(poses, "name", "odometry")
        strict = isinstance(poses, GivenPoses)  # a file that does not fit is the wrong one
        coming, last, before, problem = iter(poses), None, list[Pose](), ""
        ahead = next(coming, None)
        begins, posed_at, lacking = math.nan if ahead is None else ahead.stamp, -math.inf, [0, 0, 0]
        for frame in self.source:
            stamp = frame.stamp
            while ahead is not None and ahead.stamp < stamp:
                before += [ahead] if (strict or posed_at > -math.inf) and ahead.stamp > posed_at else []
                last, ahead = ahead, next(coming, None)
            if not problem and (problem := getattr(poses, "problem", None) or ""):
                self._say(f"warning: {problem}")
            early = last is None and (ahead is None or stamp < ahead.stamp - BEYOND)
            late = ahead is None and last is not None and stamp > last.stamp + BEYOND
            hole = 0.0 if strict or last is None or ahead is None else ahead.stamp - last.stamp
            deep = hole > LONGEST and min(stamp - last.stamp, ahead.stamp - stamp) > BEYOND  # type: ignore[union-attr]
            if isinstance(poses, GivenPoses) and (early or late) and not frame.problem:
                raise PoseError(
                    f"{frame.name} has no pose: {name} tells those from {begins:.10g} to {poses.ends:.10g} s. The "
                    "clock of a video begins at 0, that of a bag is in its headers. Shift the stamps of the file, or "
                    "cut with --start, --end"
                )
            if not strict and (early or late or deep):
                lacking = [count + is_so for count, is_so in zip(lacking, (early, late, deep), strict=True)]
                continue
            if HOLE < hole <= LONGEST:
                self._say(f"warning: {frame.name}: {name} has no pose for {hole:.2f} s about it")
            posed_at, at = stamp, interpolated([each for each in (last, ahead) if each is not None])
            yield PosedFrame(frame, Pose(stamp, *at(stamp)), tuple(before))
            before.clear()
        early, late, within = lacking
        if posed_at == -math.inf and any(lacking):
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
        for count, side in ((early, "before the first"), (late, "after the last")):
            if count:
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
