"""What Bayes can do that is not told how the target moves: the floor of `ideal.py` for every filter with our prior.

Still, or a random walk of one of two speeds, each filtered exactly and weighed by what it foretold. (Of a steady turn
neither whose axis nor whose rate is known no exact filter is at hand. Where a line is fitted to places with errors, the
variance at its end is four times that of their mean: for two axes that is ln 4 = 1.4 nats behind whoever knows.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from ideal_filters import UNIFORM, Contestant, StillOrKnown, search_top
from ideal_worlds import Detector, Motion

KINDS = {  # the prior of `eagor.MotionModel` but for its turns
    Motion(): 0.8,
    Motion(diffusion=math.radians(2.5)): 0.1,
    Motion(diffusion=math.radians(10)): 0.1,
}


class KindUnknown(Contestant):
    """A mixture of exact filters, one for each kind of motion."""

    def __init__(self, detector: Detector, kinds: Mapping[Motion, float] | None = None, nside: int = 32) -> None:
        kinds = KINDS if kinds is None else kinds
        self.filters = [StillOrKnown(detector, motion, nside) for motion in kinds]
        self.weights = np.array(list(kinds.values()))

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        for filter_ in self.filters:
            filter_.look(time, pose, position, detections)
        self.weights = self.weights * [filter_.looks[-1][1] for filter_ in self.filters]
        self.weights /= self.weights.sum()
        self.ratio = self.weights @ [f.ratio for f in self.filters]
        if any(len(seen) for seen, _ in self.filters[0].looks):
            points = self.filters[0].points
            top = search_top(self.at, points[self.ratio.argmax()], 1 / self.filters[0].nside)
            self.direction, self.pose = top @ pose, pose

    def at(self, points: np.ndarray) -> np.ndarray:
        """Log of density over uniform density at points ``(n, 3)`` of the world."""
        logs = [np.log(max(w, 1e-300)) + f.at(points) for w, f in zip(self.weights, self.filters, strict=True)]
        return np.logaddexp.reduce(logs, axis=0)

    def log_density(self, direction: np.ndarray) -> float:
        return UNIFORM + float(self.at((self.filters[0].pose @ direction)[None])[0])

    def mass_above(self, direction: np.ndarray) -> float:
        level = math.exp(self.log_density(direction) - UNIFORM)
        return float(self.ratio[self.ratio > level].sum() / len(self.ratio))
