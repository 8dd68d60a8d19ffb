"""Poses that are there already: recorded ones, and a video's motion track. Live ones are in `eagor.robots.poses`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from eagor.media.frames import Pose
from eagor.media.motion import MotionTrack

__all__ = ["GivenPoses", "MotionPoses"]

RATE = 100.0  # poses per second that are taken from a motion track


class GivenPoses:
    """Poses that are there already, in order of time."""

    def __init__(self, poses: Sequence[Pose]) -> None:
        self._poses = tuple(poses)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._poses)

    def close(self) -> None:
        """Nothing is held."""


class MotionPoses:
    """Orientations of a video's motion track, `RATE` per second."""

    def __init__(self, track: MotionTrack) -> None:
        self.track = track

    def __iter__(self) -> Iterator[Pose]:
        count = int((self.track.end - self.track.start) * RATE) + 1
        for number in range(count):
            stamp = self.track.start + number / RATE
            yield Pose(stamp, self.track.world_R_body(stamp))

    def close(self) -> None:
        """Nothing is held."""
