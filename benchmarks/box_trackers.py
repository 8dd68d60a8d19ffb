"""ByteTrack and BoT-SORT as rivals: trackers of boxes in a picture, on the boxes of panoramas.

They come from the package `trackers` (pip install --no-deps trackers, beside supervision). Such a tracker follows boxes
from picture to picture by their overlap and numbers the things. A camera that turns by 20 degrees a frame leaves no
overlap, so the boxes are turned with the poses first, into a panorama that stands still in the world: what one would do
with odometry at hand. Boxes are made as wide as the detector errs, so that small ones overlap, too. Nothing is
forgotten. The answer is the thing whose boxes' scores sum to most; before any is confirmed, the best box so far.
"""

from __future__ import annotations

from collections import Counter
from importlib.util import find_spec
from typing import Any

import numpy as np

from eagor.evidence import Evidence
from eagor.lab.agents.methods import Estimator
from eagor.sphere import FORWARD, azimuth_elevation

KINDS = {"byte_track": "ByteTrackTracker", "bot_sort": "BoTSORTTracker"}
NAMES = tuple(KINDS) if find_spec("trackers") else ()
LEAST, HIGH = 0.2, 0.3  # scores of `coco`: the least that it tells, and what is right more often than not
FOREVER = 10_000  # frames until a thing that is not seen is given up


class BoxTracker(Estimator):
    """One of `NAMES`, as `eagor.lab.agents.methods.Estimator`."""

    def __init__(self, name: str) -> None:
        import trackers

        more: dict[str, Any] = {"enable_cmc": False} if name == "bot_sort" else {}  # the poses are known
        self._tracker: Any = getattr(trackers, KINDS[name])(
            lost_track_buffer=FOREVER, track_activation_threshold=LEAST, high_conf_det_threshold=HIGH, **more
        )
        self._pose = np.eye(3)
        self._best, self._best_score = np.array(FORWARD), 0.0
        self._scores: Counter[int] = Counter()
        self._newest: dict[int, np.ndarray] = {}

    def move(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None) -> None:
        """The pose of the next look."""
        self._pose = world_R_body

    def see(self, evidence: Evidence) -> None:
        """The boxes of a look, turned into the world."""
        import supervision

        found = evidence.detections
        assert found is not None
        where, scores = found.directions @ self._pose.T, np.asarray(found.scores, dtype=np.float64)
        if len(where) and scores.max() >= self._best_score:
            self._best, self._best_score = where[int(scores.argmax())], float(scores.max())
        boxes = supervision.Detections(on_panorama(where, found.axes @ self._pose.T), confidence=scores)
        boxes.data["where"] = where
        followed = self._tracker.update(boxes)
        if not len(followed):
            return
        for number, score, place in zip(followed.tracker_id, followed.confidence, followed.data["where"], strict=True):
            if number >= 0:
                self._scores[int(number)] += float(score)
                self._newest[int(number)] = place

    def direction(self) -> np.ndarray:
        """The answer ``(3,)`` in the body frame."""
        best = self._newest[max(self._scores, key=self._scores.__getitem__)] if self._scores else self._best
        return best @ self._pose


def on_panorama(directions: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Boxes ``(n, 4)`` in pixels of a panorama with one pixel a degree, of even boxes with the moments of detections.

    `directions` ``(n, 3)``; `axes` ``(n, 2, 3)``: principal axes, each divided by the standard deviation along it. A
    box that crosses the seam goes on beyond the picture's edge.
    """
    if not len(directions):
        return np.empty((0, 4))
    azimuth, elevation = azimuth_elevation(directions)
    deviations = axes / np.sum(axes**2, axis=-1, keepdims=True)
    up = np.stack([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)], -1)
    left = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], -1)
    wide, high = (np.sqrt(12 * np.sum(np.einsum("nij,nj->ni", deviations, side) ** 2, -1)) for side in (left, up))
    half = np.degrees(np.stack([wide / np.maximum(np.cos(elevation), 0.1), high], -1)) / 2
    centre = np.stack([180 - np.degrees(azimuth), 90 - np.degrees(elevation)], -1)
    return np.concatenate([centre - half, centre + half], -1)
