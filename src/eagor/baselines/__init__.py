"""Baselines for `eagor.Belief`: they get the same evidence through the same two calls.

Every baseline is an immutable value: ``predict(new_R_old, translation=None)`` and ``update(evidence)`` return a new
one, ``direction()`` is a unit vector ``(3,)`` in the body frame, forward while nothing is known. Those with a
distribution have ``log_density(directions)``, its logarithm ``(...)`` per steradian at unit vectors ``(..., 3)``.

- From the published comparison, without parameters: `Centroid`, `CircularCentroid`, `GridFilter`. The last reads
  log(l + 1e-3), which is negative in every direction looked at: it needs whole panoramas, not views. The published
  method itself is `eagor.TrackerConfig.paper`.
- `Plain`: the strongest response of each look, as a model answers without a belief.
- `BestDetection`, `LastDetection`: one detection, turned with the camera: the best so far, or the best of the newest
  look that has any. They read detections as such; of a response map they take the strongest response.
- Stronger ones: `VonMisesFisherFilter`, `HistogramFilter`, `ParticleFilter`. They read the evidence with a
  calibration of their own. Their defaults were the best on development seeds, with as many trials as for ours
  (``benchmarks/quality.py`` of commit 5a35d191).

All accept `translation` and ignore it: distance is what `eagor.RangedBelief` adds. They raise `RotationError` for an
invalid rotation and `ResponseError` for evidence with batch dimensions. Tensors are read as NumPy arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from eagor.baselines.filters import GridFilter, HistogramFilter, ParticleFilter, VonMisesFisherFilter
from eagor.baselines.maps import GRID
from eagor.baselines.one_look import BestDetection, Centroid, CircularCentroid, LastDetection, Plain
from eagor.evidence import Evidence

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "GRID",
    "BestDetection",
    "Centroid",
    "CircularCentroid",
    "DirectionFilter",
    "GridFilter",
    "HistogramFilter",
    "LastDetection",
    "ParticleFilter",
    "Plain",
    "VonMisesFisherFilter",
]


class DirectionFilter(Protocol):
    """The interface of all baselines."""

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self: ...
    def update(self, evidence: Evidence) -> Self: ...
    def direction(self) -> np.ndarray: ...
