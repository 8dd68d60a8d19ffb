"""The body's recent poses, at any time."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import checked_stamp
from eagor.errors import PoseError, TimeError
from eagor.sphere import checked_pose, interpolate_rotation

__all__ = ["PoseHistory"]

HELD = 3600.0  # seconds: a longer gap between stamps looks like a wrong stamp
POSES = 20_000  # most poses that are kept
FARTHEST = 1e9  # metres from the origin: a larger position must be an error


@dataclass(eq=False)
class PoseHistory:
    """Stamped poses of the last `seconds`, in order of time, with interpolation.

    Orientation is interpolated along the shortest turn, position along a line. The last pose holds beyond its stamp.
    Before any pose the orientation is the identity and the position unknown.

    Gaps longer than `HELD` do not count (`_awake` is the time without them): poses before a gap are kept until poses
    after it span `seconds`, since only then their stamps are known to be right.
    """

    seconds: float
    _stamps: list[float] = field(default_factory=list)
    _poses: list[tuple[np.ndarray, np.ndarray | None]] = field(default_factory=list)
    _awake: list[float] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def first(self) -> float:
        """The stamp of the oldest pose."""
        return self._stamps[0] if self._stamps else -math.inf

    def reach(self, stamp: float) -> bool:
        """Whether there is a pose at or after `stamp`, so that later poses cannot change the one at `stamp`."""
        return bool(self._stamps) and stamp <= self._stamps[-1]

    def copied(self) -> PoseHistory:
        """A copy with its own lists."""
        return PoseHistory(self.seconds, self._stamps.copy(), self._poses.copy(), self._awake.copy())

    def check_ahead(self, stamp: float) -> None:
        """Raise `TimeError` if `stamp` is more than `HELD` ahead of the last pose."""
        if self._stamps and stamp > self._stamps[-1] + HELD:
            raise TimeError(
                f"evidence of t = {stamp:.3f} s lies {stamp - self._stamps[-1]:.3f} s ahead of the last pose, at "
                f"{self._stamps[-1]:.3f} s; wanted {HELD:g} s at most. Are both stamps of one clock? Where the body "
                "stands still for long, give its pose again"
            )

    def add(self, stamp: float, world_R_body: Any, position: np.ndarray | None = None) -> list[float]:
        """Append a pose; it replaces the last one if it has the same stamp. Errors as in `DirectionTracker.add_pose`.

        Poses after a long gap have wrong stamps if a later pose falls before the gap again. They are then dropped, and
        their stamps returned.
        """
        stamp = checked_stamp(stamp)
        wrong = self._ahead(stamp)
        if wrong == len(self) and self._stamps and stamp < self._stamps[-1]:
            raise TimeError(
                f"pose at t = {stamp:.6f} s came after one at {self._stamps[-1]:.6f} s; time ran backwards. "
                "Sort the poses, or call tracker.reset() where the clock was reset"
            )
        pose = checked_pose(world_R_body).copy()
        place = None
        if position is not None:
            place = np.array(to_numpy(position), dtype=np.float64)
            if place.shape != (3,) or not (np.abs(place) <= FARTHEST).all():
                raise PoseError(
                    f"position = {place.tolist()}; wanted (x, y, z) in metres of the world frame, each within "
                    f"{FARTHEST:g} m of its origin"
                )
        elif self._poses and self._poses[-1][1] is not None:
            raise PoseError(
                f"the pose at t = {stamp:.6f} s has no position, earlier ones have; repeat the last known position "
                "if it is lost for a while, or never give one"
            )
        left_out = self._stamps[wrong:]
        self._drop(slice(wrong, None))
        if self._stamps and stamp == self._stamps[-1]:
            self._poses[-1] = (pose, place)
            return left_out
        silence = stamp - self._stamps[-1] if self._stamps else 0.0
        self._awake.append((self._awake[-1] if self._awake else 0.0) + (silence if silence <= HELD else 0.0))
        self._stamps.append(stamp)
        self._poses.append((pose, place))
        # Keep one pose older than the history, to interpolate over its whole length.
        old = bisect.bisect_right(self._awake, self._awake[-1] - self.seconds) - 1
        self._drop(slice(max(0, old, len(self) - POSES)))
        return left_out

    def _ahead(self, stamp: float) -> int:
        """Index of the first pose after a long gap that is far ahead of this stamp too; else their number."""
        first = bisect.bisect_right(self._stamps, stamp)
        if first == len(self) or (first == 0 and len(self) > 1):
            return len(self)
        before = max(stamp, self._stamps[first - 1]) if first else stamp
        return first if self._stamps[first] > before + HELD else len(self)

    def _drop(self, which: slice) -> None:
        del self._stamps[which], self._poses[which], self._awake[which]

    def turning_rate(self, stamp: float) -> float:
        """Radians per second at which the body turns at a time, from the poses before and after it; 0 without."""
        after = min(bisect.bisect_left(self._stamps, stamp), len(self) - 1)
        if after < 1:  # not from the next pose: an answer must not depend on when a look arrives
            return 0.0
        (start, _), (end, _) = self._poses[after - 1], self._poses[after]
        angle = 2 * math.asin(min(float(np.linalg.norm(end - start)) / math.sqrt(8), 1.0))  # of the chord
        return angle / (self._stamps[after] - self._stamps[after - 1])

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
                f"no pose for t = {stamp:.6f} s: poses are known from {self._stamps[0]:.6f} s on. Call "
                f"add_pose() before observe(), or raise the history (now {self.seconds:g} s; at most {POSES} poses are "
                "kept)"
            )
        start, end = self._stamps[after - 1], self._stamps[after]
        (pose_a, place_a), (pose_b, place_b) = self._poses[after - 1], self._poses[after]
        fraction = (stamp - start) / (end - start)
        place = None if place_a is None or place_b is None else place_a + fraction * (place_b - place_a)
        return interpolate_rotation(pose_a, pose_b, fraction), place
