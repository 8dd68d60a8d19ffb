"""Rivals of `eagor.Belief`, fed the same evidence through the same two calls.

Every rival is an immutable value: ``predict(new_R_old, translation=None)`` and ``update(evidence)`` return a new one,
``direction()`` is a unit vector ``(3,)`` in the body frame, forward while nothing is known. Where there is a
distribution, ``log_density(directions)`` gives its logarithm ``(...)`` per steradian at unit vectors ``(..., 3)``.

- As in the published comparison, nothing to tune: `Centroid`, `CircularCentroid`, `GridFilter`, `Published`. The last
  two read log(l + 1e-3), which is negative wherever one looks: they are made for whole panoramas, not for views.
- `Plain`: the strongest response of each look, for what a model says without a belief.
- Stronger ones: `VonMisesFisherFilter`, `HistogramFilter`, `ParticleFilter`. They read the evidence with a
  calibration of their own; their defaults won on the development seeds of ``benchmarks/quality.py``, with as many
  trials as ours had.

All accept `translation` and ignore it: distance is what `eagor.RangedBelief` adds. They raise `RotationError` for
what is no rotation and `ResponseError` for evidence with batch dimensions. Tensors are read as NumPy arrays.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from eagor.baselines.filters import GridFilter, HistogramFilter, ParticleFilter, Published, VonMisesFisherFilter
from eagor.baselines.maps import GRID
from eagor.baselines.per_frame import Centroid, CircularCentroid, Plain
from eagor.evidence import Evidence

__all__ = [
    "GRID",
    "Centroid",
    "CircularCentroid",
    "DirectionFilter",
    "GridFilter",
    "HistogramFilter",
    "ParticleFilter",
    "Plain",
    "Published",
    "VonMisesFisherFilter",
]


class DirectionFilter(Protocol):
    """The face that all rivals share."""

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self: ...
    def update(self, evidence: Evidence) -> Self: ...
    def direction(self) -> np.ndarray: ...
