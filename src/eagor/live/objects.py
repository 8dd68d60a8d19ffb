"""What there is in recorded looks: each thing that was seen, with where it is now."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from eagor.evidence import BodyMask
from eagor.live.core import UNSURE
from eagor.perception.replay import RecordedLooks
from eagor.tracking import DirectionTracker, Estimate, TrackerConfig
from eagor.tracking.estimate import SURE


@dataclass(frozen=True, eq=False)
class ObjectSummary:
    """What is known of one thing: `looks`, in how many looks it was seen, of `among`; `last`, the stamp of the last.

    `query`: its class, or the words that were looked for.
    """

    query: str
    estimate: Estimate
    looks: int
    among: int
    last: float

    @property
    def sure(self) -> float:
        """The probability that it is here, and within 15 degrees of the answer."""
        return self.estimate.within(SURE) if self.estimate.direction is not None else 0.0


def summarise_objects(
    recorded: RecordedLooks, config: TrackerConfig, masks: Sequence[BodyMask], done: Callable[[], object]
) -> list[ObjectSummary]:
    """What was seen since the poses were last lost, the surest first, beside what `masks` hide; `done`: after each."""
    begins = max((number for number, each in enumerate(recorded.posed) if each.lost), default=0)
    found = []
    for query in recorded.asked_for():
        tracker, looks, among, last, now = DirectionTracker(config), 0, 0, -math.inf, 0.0
        for posed in (*recorded.posed[begins:], None):
            poses = recorded.after if posed is None else posed.poses[-1:] if posed.lost else posed.poses
            for pose in poses:
                tracker.add_pose(pose.stamp, pose.world_R_body, None if config.ranges is None else pose.position)
                now = pose.stamp
            if posed is None or posed.frame.problem or poses[-1].spread >= UNSURE:
                continue
            evidence, among = recorded.replay.looks_near(query, now), among + 1
            for mask in masks:
                evidence = tuple(each.covered(mask) for each in evidence)
            for each in evidence:
                tracker.observe(each.widened(poses[-1].spread))
            if any(each.detections is None or len(each.detections) for each in evidence):
                looks, last = looks + 1, now
        if looks:
            found.append(ObjectSummary(query, tracker.estimate(now), looks, among, last))
        done()
    return sorted(found, key=lambda each: -each.sure)
