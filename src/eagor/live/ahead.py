"""Where the camera points after its newest pose, and how far that may be wrong.

How well a camera can be foretold is seen in its own poses: the same extrapolation from earlier poses is compared with
the poses that came later. So a camera on wheels is foretold better than one in a hand, and late poses cost more.
"""

from __future__ import annotations

import bisect
import math

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

__all__ = ["RecentPoses", "deviation"]

RECENT = 2.0  # seconds over which extrapolations are tried
FARTHEST = 1.0  # seconds: longer extrapolations are not tried
TRIALS = 16
POSES = 64  # that are looked at, evenly spaced
LEVEL = 1.2  # deviations are rounded to powers of this, so that answers can share what they compute
LEAST = math.radians(0.2)  # a smaller deviation counts as 0
MOST = math.pi / 2  # radians: nothing is known of the direction any more


class RecentPoses:
    """Orientations of the last seconds. `acceleration`: see `eagor.live.core.Settings`."""

    def __init__(self, acceleration: float) -> None:
        self.acceleration = acceleration
        self._stamps: list[float] = []
        self._poses: list[np.ndarray] = []
        self._known: tuple[float, np.ndarray, float] | None = None  # what was asked last

    def add(self, stamp: float, world_R_body: np.ndarray) -> None:
        """The next pose; stamps rise."""
        self._known = None
        self._stamps.append(stamp)
        self._poses.append(world_R_body)
        old = bisect.bisect_left(self._stamps, stamp - RECENT - 2 * FARTHEST)
        del self._stamps[:old], self._poses[:old]

    def clear(self) -> None:
        """Later poses have nothing to do with those so far."""
        self._known = None
        self._stamps.clear()
        self._poses.clear()

    def after(self, seconds: float) -> tuple[np.ndarray, float]:
        """`world_R_body` ``(3, 3)`` so many seconds after the newest pose, and the deviation (radians per axis).

        The camera holds the newest pose, or turns on as fast as it did over the same time before: whichever would have
        missed its later poses by less. The root mean square of these misses, with that of `acceleration` as one more,
        is the deviation. It is taken for that of a turn across the line of sight, which moves what is seen the most.
        """
        if self._known is None or self._known[0] != seconds:
            self._known = seconds, *self._after(seconds)
        return self._known[1:]

    def _after(self, seconds: float) -> tuple[np.ndarray, float]:
        if not self._poses:
            return np.eye(3), 0.0
        newest, count = self._poses[-1], len(self._poses)
        if seconds <= 0:
            return newest, 0.0
        if count < 3:
            return newest, deviation((0.5 * self.acceleration * seconds * seconds) ** 2 / 2)
        # What is longer than can be tried goes on at the same rate, and what it misses grows with the square of time.
        tried = min(seconds, FARTHEST, (self._stamps[-1] - self._stamps[0]) / 3)
        longer = seconds / tried
        span = max(tried, (self._stamps[-1] - self._stamps[0]) / (count - 1))
        guessed = (0.5 * self.acceleration * tried * (tried + span)) ** 2
        unseen = (0.5 * self.acceleration * (seconds - tried) ** 2) ** 2
        first = min(bisect.bisect_left(self._stamps, self._stamps[-1] - RECENT - tried - span), count - 3)
        chosen = np.unique(np.linspace(first, count - 1, POSES).astype(int))
        stamps = np.array([self._stamps[index] for index in chosen])
        # The last start is the newest pose, of which only the turn before it is known.
        starts = np.append(np.linspace(stamps[0] + span, stamps[-1] - tried, TRIALS), stamps[-1])
        times = np.clip(starts + np.array([[-span], [0.0], [tried]]), stamps[0], stamps[-1])  # for what rounding adds
        slerp = Slerp(stamps, Rotation.from_matrix(np.array([self._poses[index] for index in chosen])))
        before, here, there = np.split(slerp(times.ravel()).as_quat(), 3)
        before, here, there = map(Rotation.from_quat, (before, here, there[:-1]))
        turns = (before.inv() * here).as_rotvec() * (tried / span)
        held, turned = ((guess[:-1].inv() * there).magnitude() for guess in (here, here * Rotation.from_rotvec(turns)))
        held, turned = (float((guessed + misses @ misses) / (TRIALS + 1)) for misses in (held, turned))
        found = here[-1] if held <= turned else here[-1] * Rotation.from_rotvec(turns[-1] * longer)
        return found.as_matrix(), deviation((min(held, turned) * longer**4 + unseen) / 2)


def deviation(variance: float) -> float:
    """The root of a variance, rounded, so that what is computed for one can be used for the next."""
    root = math.sqrt(variance)
    if root < LEAST:
        return 0.0
    return min(LEAST * LEVEL ** round(math.log(root / LEAST, LEVEL)), MOST)
