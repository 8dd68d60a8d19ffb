"""What ``eagor track`` follows in a ROS 2 bag: its pictures, with its odometry between and at them.

Stamps are those of the messages' headers. Both are read in step, message by message: a long bag needs no more memory
than a short one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from eagor.cli.looking import checked_frame
from eagor.cli.poses import Pose, between
from eagor.cli.steps import BEYOND, Read, Step
from eagor.cli.terminal import log, warning
from eagor.errors import PoseError
from eagor.media.bags.reader import Bag
from eagor.media.frames import Pose as GivenPose
from eagor.media.panorama import PanoramaFile
from eagor.robots.ros.graph import MOTION, TF_STATIC
from eagor.robots.ros.sources import BagCamera, BagPoses

HOLE = 0.5  # seconds without a pose that are worth a word

__all__ = ["BagFilm", "odometry_of", "with_odometry"]


@dataclass(frozen=True)
class BagFilm:
    """The pictures of a bag, `rate` of them per second, from `start` to `end` (seconds from the first)."""

    camera: BagCamera
    rate: float
    start: float
    end: float | None
    force: bool

    @property
    def count(self) -> int | None:
        return None

    @property
    def level_R_body(self) -> np.ndarray | None:
        return None

    def frames(self) -> Iterator[tuple[float, str, Read]]:
        said: set[str] = set()
        tick = -math.inf
        for stamp, read in self.camera.pictures():
            at = stamp - self.camera.begins
            if at < self.start or (number := math.floor(at * self.rate + 1e-6)) <= tick:
                continue
            if self.end is not None and at > self.end:
                return
            tick, name = number, f"{self.camera.topic} at {stamp:.3f} s"
            yield stamp, name, partial(self._checked, read, name, said)

    def _checked(self, read: Any, name: str, said: set[str]) -> PanoramaFile:
        return checked_frame(PanoramaFile(read(), self.camera.unseen), name, self.force, said)


def odometry_of(bag: Bag, topic: str | None, camera: BagCamera) -> BagPoses | None:
    """The odometry of a bag, as poses of its camera; None if no topic is named and it has none."""
    if topic is None and not any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items()):
        return None
    return BagPoses(bag, topic, camera=camera.frame)


def with_odometry(source: BagFilm, poses: BagPoses) -> Iterator[Step]:
    """Frames with the poses of the bag's odometry, interpolated at their stamps.

    Frames before the first pose and after the last one are left out, which is said. Raises `PoseError` if all are.
    """
    coming = iter(poses)
    last: GivenPose | None = None
    ahead = next(coming, None)
    first = math.nan if ahead is None else ahead.stamp
    early = late = used = 0
    told = False
    for stamp, name, read in source.frames():
        while ahead is not None and ahead.stamp < stamp:
            if used:
                yield Step(Pose(ahead.stamp, ahead.world_R_body, ahead.position, None))
            last, ahead = ahead, next(coming, None)
        if poses.problem and not told:
            told = True
            warning(poses.problem)
        if last is None and (ahead is None or ahead.stamp - stamp > BEYOND):
            early += 1
            continue
        if ahead is None and last is not None and stamp - last.stamp > BEYOND:
            late += 1
            continue
        pose = between(last, ahead, stamp)
        if last is not None and ahead is not None and ahead.stamp - last.stamp > HOLE:
            warning(f"{name}: {poses.topic} has no pose for {ahead.stamp - last.stamp:.2f} s about it")
        used += 1
        yield Step(Pose(stamp, *pose, name), name, read)
    if not used and early + late:
        raise PoseError(
            f"no picture of {source.camera.topic} has a pose of {poses.topic}, which tells those from {first:.3f} to "
            f"{math.nan if last is None else last.stamp:.3f} s; the pictures begin at {source.camera.begins:.3f} s. "
            "Are both stamped by one clock? Or --poses level: headings from the pictures themselves"
        )
    for count, side in ((early, "before the first"), (late, "after the last")):
        if count:
            log(f"{count} pictures {side} pose of {poses.topic} are left out")
