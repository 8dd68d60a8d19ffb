"""Our tracker in a session: computed anew when there is news, turned with the camera in between."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eagor.errors import PoseError, TimeError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid
from eagor.studio.steps import belief_of, estimate_json
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig

__all__ = ["Following", "warm"]

SOONEST = 0.05  # seconds between two computations, at least: every step, where the machine can bear it
LATEST = 1.0  # seconds after which the belief is computed anew without news: targets may come and go
HISTORY = 60.0  # seconds by which a look may be late: many pages share one eye
MOVED = 0.02  # metres of the camera that are worth a computation


@dataclass
class Following:
    """One query, followed with one configuration; stamps are seconds of the session.

    `belief` and `coefficients` are those of the newest computation; `news` says whether they have been taken.
    """

    config: TrackerConfig
    tracker: DirectionTracker = field(init=False)
    estimate: Estimate | None = None
    entropy: float = math.log(4 * math.pi)
    belief: dict[str, Any] = field(default_factory=dict)
    coefficients: bytes = b""
    news: bool = False
    took: float = 0.0  # seconds of the newest answer, if it was a computation
    _fresh: bool = True
    _at: np.ndarray | None = None
    _stamp: float = -math.inf

    def __post_init__(self) -> None:
        self.tracker = DirectionTracker(replace(self.config, history=max(self.config.history, HISTORY)))

    def pose(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """A pose of the camera; once for every stamp, in order."""
        self.tracker.add_pose(stamp, world_R_body, position)

    def look(self, evidence: Evidence) -> None:
        """A look, stamped with the time of a pose. One that comes later than the history reaches is left out."""
        with suppress(PoseError, TimeError):
            self.tracker.observe(evidence)
            self._fresh = True

    def answer(self, stamp: float, soonest: float = SOONEST) -> Estimate:
        """The estimate at the newest pose, computed anew not more often than every `soonest` seconds."""
        pose, position = self.tracker.pose_at(stamp)
        moved = position is not None and self._at is not None and float(np.linalg.norm(position - self._at)) > MOVED
        due = self.estimate is None or self._fresh or moved or stamp - self._stamp >= max(LATEST, soonest)
        self.took = 0.0
        if self.estimate is None or (due and stamp - self._stamp >= soonest):
            began = time.perf_counter()
            self.estimate = self.tracker.estimate(stamp)
            self.entropy = self.estimate.posterior.entropy()
            self.belief, self.coefficients = belief_of(self.estimate, stamp, self.config.degree)
            self._fresh, self._at, self._stamp, self.news = False, position, stamp, True
            self.took = time.perf_counter() - began
            return self.estimate
        return self.estimate.turned(stamp, pose)


def warm(config: TrackerConfig) -> None:
    """Make the tables that the first answers need, which take tenths of a second."""
    following = Following(config)
    for number in range(3):
        stamp = float(number)
        following.pose(stamp, np.eye(3), np.array([0.1 * number, 0.0, 1.25]))
        following.look(Evidence.from_points(np.array([[1.0, 0.1, 0.0]]), scores=np.full(1, 0.8), stamp=stamp))
        following.look(Evidence.from_response(np.full((32, 64), 0.1), ErpGrid(32, 64), stamp=stamp))
        estimate_json(following.answer(stamp, 0.0), following.entropy)
