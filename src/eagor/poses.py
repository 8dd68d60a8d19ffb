"""Where the body was, and how it was turned, at any time of the recent past."""

from __future__ import annotations

import bisect
import math

import numpy as np

from eagor._arrays import to_numpy
from eagor.errors import PoseError, TimeError
from eagor.evidence import checked_stamp
from eagor.sphere import check_rotation, interpolate_rotation


class PoseHistory:
    """Stamped poses in order of time, interpolated between, for the last `seconds`.

    Orientation moves along the shortest turn, position along a line; the last pose is held beyond its stamp. Before
    any pose the body stands unturned at an unknown place.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._stamps: list[float] = []
        self._poses: list[tuple[np.ndarray, np.ndarray | None]] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def first(self) -> float:
        """The stamp of the oldest pose that is kept."""
        return self._stamps[0] if self._stamps else -math.inf

    def covers(self, stamp: float) -> bool:
        """Whether the pose at `stamp` is known, and not only held from the last one before it."""
        return bool(self._stamps) and self._stamps[0] <= stamp <= self._stamps[-1]

    def add(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None) -> None:
        """Append a pose; one with the stamp of the last replaces it. Errors as in `DirectionTracker.rotate`."""
        stamp = checked_stamp(stamp)
        if self._stamps and stamp < self._stamps[-1]:
            raise TimeError(
                f"pose at t = {stamp:.6f} s came after one at {self._stamps[-1]:.6f} s; time ran backwards. "
                "Sort the poses, or start a new tracker where the clock was reset"
            )
        pose = np.array(to_numpy(check_rotation(world_R_body, "world_R_body")), dtype=np.float64)
        place = None
        if position is not None:
            place = np.array(to_numpy(position), dtype=np.float64)
            if place.shape != (3,) or not np.isfinite(place).all():
                raise PoseError(f"position = {place.tolist()}; wanted (x, y, z) in metres of the world frame")
        elif self._poses and self._poses[-1][1] is not None:
            raise PoseError(
                f"the pose at t = {stamp:.6f} s has no position, earlier ones have; repeat the last known position "
                "if it is lost for a while, or never give one"
            )
        if self._stamps and stamp == self._stamps[-1]:
            self._poses[-1] = (pose, place)
            return
        self._stamps.append(stamp)
        self._poses.append((pose, place))
        # One pose older than the history stays, so that its whole length can be interpolated.
        first = max(0, bisect.bisect_right(self._stamps, stamp - self.seconds) - 1)
        del self._stamps[:first], self._poses[:first]

    def at(self, stamp: float) -> tuple[np.ndarray, np.ndarray | None]:
        """`world_R_body` ``(3, 3)`` and position ``(3,)`` or None at a time. Raises `PoseError` if it is too old."""
        stamp = checked_stamp(stamp)
        if not self._stamps:
            return np.eye(3), None
        after = bisect.bisect_left(self._stamps, stamp)
        if after == len(self._stamps):
            return self._poses[-1]
        if self._stamps[after] == stamp:
            return self._poses[after]
        if after == 0:
            raise PoseError(
                f"no pose for t = {stamp:.6f} s: poses are known from {self._stamps[0]:.6f} s on. Feed rotate() before "
                f"observe(), or raise the history (now {self.seconds:g} s)"
            )
        start, end = self._stamps[after - 1], self._stamps[after]
        (pose_a, place_a), (pose_b, place_b) = self._poses[after - 1], self._poses[after]
        fraction = (stamp - start) / (end - start)
        place = None if place_a is None or place_b is None else place_a + fraction * (place_b - place_a)
        return interpolate_rotation(pose_a, pose_b, fraction), place
