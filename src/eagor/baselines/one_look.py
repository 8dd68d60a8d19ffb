"""Baselines without a filter: they read each look by itself, or keep one detection and turn it with the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from eagor._values import changed
from eagor.baselines.maps import seen_response, strongest
from eagor.evidence import Evidence
from eagor.evidence.calibration import SILENT
from eagor.grids import Grid
from eagor.sphere import FORWARD, azimuth_elevation, check_rotation, direction, unit

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, eq=False)
class LastDetection:
    """The best detection of the newest look that has any, turned with the camera.

    `found` ``(3,)``: its direction in the body frame, None before the first.
    """

    found: np.ndarray | None = None
    score: float = -math.inf

    __repr__ = changed

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self:
        turn = check_rotation(new_R_old)
        return self if self.found is None else replace(self, found=unit(turn @ self.found))

    def update(self, evidence: Evidence) -> Self:
        best = _best(evidence)
        return replace(self, found=best[0], score=best[1]) if best is not None and self._takes(best[1]) else self

    def direction(self) -> np.ndarray:
        return np.array(FORWARD) if self.found is None else self.found

    def _takes(self, score: float) -> bool:
        return True


class BestDetection(LastDetection):
    """The detection with the highest score of all looks so far, turned with the camera; of equal ones the newest."""

    def _takes(self, score: float) -> bool:
        return score >= self.score


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


@dataclass(frozen=True, eq=False)
class Plain:
    """The direction of the strongest response, per frame: the answer of a model without a filter.

    Keeps only the last answer, at the same place in the image, while the response is zero everywhere: the published
    methods do not move the answer with the camera.
    """

    last: np.ndarray = field(default_factory=lambda: np.array(FORWARD))

    __repr__ = changed

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self:
        check_rotation(new_R_old)
        return self

    def update(self, evidence: Evidence) -> Self:
        response = seen_response(evidence)
        if response.max() < SILENT:
            return self
        return replace(self, last=self._read(response / response.sum(), evidence.grid))

    def direction(self) -> np.ndarray:
        return self.last

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        return strongest(share, grid)


class Centroid(Plain):
    """Response-weighted mean of the pixel coordinates, per frame: linear in u, so it fails at the seam."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        height, width = share.shape
        return grid.unproject(
            share.sum(axis=0) @ (np.arange(width) + 0.5), share.sum(axis=1) @ (np.arange(height) + 0.5)
        )


class CircularCentroid(Plain):
    """Circular mean of the azimuth and linear mean of the elevation over response-weighted pixels, per frame."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        azimuth, elevation = azimuth_elevation(grid.directions)
        mean = np.arctan2(np.sum(share * np.sin(azimuth)), np.sum(share * np.cos(azimuth)))
        return direction(mean, np.sum(share * elevation))
