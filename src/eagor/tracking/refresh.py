"""Follows one target: poses and looks come in, and the answer at any time goes out.

To compute a belief takes milliseconds, to turn one with the camera microseconds. So a belief is computed anew when
there is reason to, and turned meanwhile. Nothing here reads a clock: time is what stamps say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor.evidence.evidence import Evidence
from eagor.tracking.config import TrackerConfig
from eagor.tracking.estimate import Estimate
from eagor.tracking.tracker import DirectionTracker

__all__ = ["Follower", "Refresh"]


@dataclass(frozen=True)
class Refresh:
    """When a belief is computed anew: with a new look, when the camera has gone `moved` metres, after `latest` seconds.

    Targets may come and go without a look, and near things are elsewhere once the camera has moved. `soonest`: seconds
    from one computation to the next, at least. The default computes for each new time.
    """

    soonest: float = 0.0
    latest: float = 0.0
    moved: float = 0.0


ALWAYS = Refresh()


class Follower:
    """One target, followed with one configuration. Stamps are seconds on one clock.

    Poses come in order of time, looks with or after the poses of their time. `tracker` may be asked directly;
    `computed` is the newest estimate that was computed, None before any.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.tracker = DirectionTracker(config)
        self.computed: Estimate | None = None
        self._first, self._last = -math.inf, -math.inf  # stamps of poses
        self._fresh = True
        self._position: np.ndarray | None = None  # where `computed` was computed

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None) -> None:
        """A pose of the camera: orientation ``(3, 3)``, and position ``(3,)`` in metres where it is known.

        A belief without ranges has no use for positions. Raises as `DirectionTracker.add_pose`.
        """
        self.tracker.add_pose(stamp, world_R_body, None if self.tracker.config.ranges is None else position)
        self._first, self._last = (stamp if math.isinf(self._first) else self._first), stamp

    def observe(self, evidence: Evidence) -> None:
        """A look, stamped with its time of capture. Raises as `DirectionTracker.observe`."""
        self.tracker.observe(evidence)
        self._fresh = True

    def placed(self, evidence: Evidence) -> Evidence:
        """`evidence` with its stamp clipped to the known poses: a detector's may be off by a few milliseconds."""
        stamp = evidence.stamp
        return evidence if stamp is None else replace(evidence, stamp=min(max(stamp, self._first), self._last))

    def estimate(self, now: float, refresh: Refresh = ALWAYS) -> Estimate:
        """The answer at `now`, which is not before the newest look; computed, or the last one turned (`Refresh`)."""
        last = self.computed
        if last is None or now < last.stamp:
            return self._compute(now)
        if now == last.stamp and not self._fresh:
            return last
        pose, position = self.tracker.pose_at(now)
        moved = 0.0
        if position is not None and self._position is not None:
            moved = float(np.linalg.norm(position - self._position))
        since = now - last.stamp
        due = self._fresh or moved > refresh.moved or since >= refresh.latest
        return self._compute(now) if due and since >= refresh.soonest else last.turned(now, pose)

    def _compute(self, now: float) -> Estimate:
        self.computed = self.tracker.estimate(now)
        self._position = self.tracker.pose_at(now)[1]
        self._fresh = False
        return self.computed
