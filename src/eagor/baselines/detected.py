"""Baselines that keep one detection and turn it with the camera: what a detector and odometry give without a filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from eagor._reprs import changed
from eagor.baselines.maps import seen_response, strongest
from eagor.evidence import Evidence
from eagor.evidence.response import SILENT
from eagor.sphere import FORWARD, check_rotation, unit


@dataclass(frozen=True, eq=False)
class _Kept:
    """One detection: its direction `found` ``(3,)`` in the body frame, None before the first, and its `score`.

    Looks without a detection change nothing.
    """

    found: np.ndarray | None = None
    score: float = -math.inf

    __repr__ = changed

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self:
        turn = check_rotation(new_R_old)
        return self if self.found is None else replace(self, found=unit(turn @ self.found))

    def update(self, evidence: Evidence) -> Self:
        best = _best(evidence)
        if best is None or not self._takes(best[1]):
            return self
        return replace(self, found=best[0], score=best[1])

    def direction(self) -> np.ndarray:
        return np.array(FORWARD) if self.found is None else self.found

    def _takes(self, score: float) -> bool:
        raise NotImplementedError


class BestDetection(_Kept):
    """The detection with the highest score of all looks so far, turned with the camera; of equal ones the newest."""

    def _takes(self, score: float) -> bool:
        return score >= self.score


class LastDetection(_Kept):
    """The best detection of the newest look that has any, turned with the camera."""

    def _takes(self, score: float) -> bool:
        return True


def _best(evidence: Evidence) -> tuple[np.ndarray, float] | None:
    """The direction ``(3,)`` and the score of a look's best detection; for a response map of its strongest response."""
    found = evidence.detections
    if found is None:
        response = seen_response(evidence)
        highest = float(response.max())
        return None if highest < SILENT else (unit(strongest(response, evidence.grid)), highest)
    if not len(found):
        return None
    index = int(np.argmax(found.scores))
    return unit(np.asarray(found.directions[index], dtype=np.float64)), float(found.scores[index])
