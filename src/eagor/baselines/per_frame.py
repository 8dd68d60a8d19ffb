"""Baselines that read each look by itself: a mean of its response, or its maximum."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from eagor._reprs import changed
from eagor.baselines.maps import seen_response, strongest
from eagor.evidence import Evidence
from eagor.evidence.response import SILENT
from eagor.grids import Grid
from eagor.sphere import FORWARD, azimuth_elevation, check_rotation, direction


@dataclass(frozen=True, eq=False)
class _PerFrame:
    """Keeps only the last answer, at the same place in the image, while the response is zero everywhere.

    `predict` changes nothing: the published methods do not move the answer with the camera.
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
        raise NotImplementedError


class Centroid(_PerFrame):
    """Response-weighted mean of the pixel coordinates, per frame: linear in u, so it fails at the seam."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        height, width = share.shape
        return grid.unproject(
            share.sum(axis=0) @ (np.arange(width) + 0.5), share.sum(axis=1) @ (np.arange(height) + 0.5)
        )


class CircularCentroid(_PerFrame):
    """Circular mean of the azimuth and linear mean of the elevation over response-weighted pixels, per frame."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        azimuth, elevation = azimuth_elevation(grid.directions)
        mean = np.arctan2(np.sum(share * np.sin(azimuth)), np.sum(share * np.cos(azimuth)))
        return direction(mean, np.sum(share * elevation))


class Plain(_PerFrame):
    """The direction of the strongest response, per frame: the answer of a model without a filter."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        return strongest(share, grid)
