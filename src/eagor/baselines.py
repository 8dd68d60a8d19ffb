"""Rivals of `eagor.Belief`, fed the same evidence through the same two calls.

Every rival is an immutable value: ``predict(new_R_old, translation=None)`` and ``update(evidence)`` return a new one and leave
the old one as it was; ``direction()`` is a unit vector ``(3,)`` in the body frame, forward while nothing is known. Where there
is a distribution, ``log_density(directions)`` gives it per steradian, normalised.

- As in the paper's comparison, untuned: `Centroid`, `CircularCentroid` (per frame), `GridFilter`, `Published`.
- Stronger ones, whose defaults were chosen on the development seeds of ``benchmarks/quality.py`` with the same number of trials
  as our own: `VonMisesFisherFilter`, `HistogramFilter`, `ParticleFilter`. They keep their own `Calibration`.

All of them take `translation` and ignore it: a belief over distance is what `eagor.RangedBelief` adds. Evidence has no batch
dimension here. Bad rotations raise `RotationError`, batches of evidence `ResponseError`.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from eagor._arrays import to_numpy
from eagor.belief import Belief
from eagor.coverage import taper
from eagor.decode import peak_on_grid
from eagor.errors import ResponseError
from eagor.evidence import Calibration, Evidence
from eagor.grids import ErpGrid, Grid
from eagor.sphere import FORWARD, azimuth_elevation, check_rotation, direction, unit

GRID = ErpGrid(64, 128)  # cells of 2.8 degrees, for the rivals that keep a map
SILENT = 1e-6  # a response below this everywhere names no direction (its recovery from float32 evidence leaves 1e-8)
MAX_CONCENTRATION = 1e6


class DirectionFilter(Protocol):
    """The face that all rivals share."""

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self: ...
    def update(self, evidence: Evidence) -> Self: ...
    def direction(self) -> np.ndarray: ...


def _forward() -> np.ndarray:
    return np.array(FORWARD)


# Per frame: no memory but the last answer


@dataclass(frozen=True, eq=False)
class Centroid:
    """Response-weighted mean of the pixel coordinates, linear in u, so that it breaks at the seam. Per frame.

    It knows nothing of rotations: `predict` returns it unchanged, and while a response is zero everywhere the last
    answer stands where it was in the image.
    """

    last: np.ndarray = field(default_factory=_forward)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Centroid:
        """Unchanged: a per-frame method is not told of the camera's turns."""
        check_rotation(new_R_old)
        return self

    def update(self, evidence: Evidence) -> Centroid:
        """The answer of this frame."""
        response = _seen_response(evidence)
        if response.max() < SILENT:
            return self
        height, width = response.shape
        x = response.sum(axis=0) @ (np.arange(width) + 0.5) / response.sum()
        y = response.sum(axis=1) @ (np.arange(height) + 0.5) / response.sum()
        return Centroid(evidence.grid.unproject(x, y))

    def direction(self) -> np.ndarray:
        return self.last


@dataclass(frozen=True, eq=False)
class CircularCentroid:
    """Circular mean of the azimuth, linear mean of the elevation, over pixels weighted by the response. Per frame.

    It holds its last answer as `Centroid` does.
    """

    last: np.ndarray = field(default_factory=_forward)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> CircularCentroid:
        """Unchanged: a per-frame method is not told of the camera's turns."""
        check_rotation(new_R_old)
        return self

    def update(self, evidence: Evidence) -> CircularCentroid:
        """The answer of this frame."""
        response = _seen_response(evidence)
        if response.max() < SILENT:
            return self
        azimuth, elevation = azimuth_elevation(evidence.grid.directions)
        sine, cosine = np.sum(response * np.sin(azimuth)), np.sum(response * np.cos(azimuth))
        return CircularCentroid(direction(np.arctan2(sine, cosine), np.sum(response * elevation) / response.sum()))

    def direction(self) -> np.ndarray:
        return self.last


# As published


@dataclass(frozen=True, eq=False)
class GridFilter:
    """The paper's Grid: an equirectangular map of log(l + 1e-3), resampled bilinearly at each turn, read at its maximum.

    Every resampling blurs; that is the weakness which rotating coefficients avoids.
    """

    values: np.ndarray = field(default_factory=lambda: np.zeros(GRID.shape))

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> GridFilter:
        """The map as seen from the new orientation, resampled (not at all where nothing turned)."""
        turn = check_rotation(new_R_old)
        if np.array_equal(turn, np.eye(3)):
            return self
        return GridFilter(_sample(self.values, GRID, GRID.directions @ turn))

    def update(self, evidence: Evidence) -> GridFilter:
        """The map with this frame's log response added."""
        return GridFilter(self.values + _sample_log_ratio(evidence, Calibration.paper(), GRID.directions))

    def direction(self) -> np.ndarray:
        if np.ptp(self.values) == 0:
            return _forward()
        return GRID.directions.reshape(-1, 3)[np.argmax(self.values)]

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``, reading the map as a log-posterior."""
        return _sample(_normalised(self.values), GRID, directions)


@dataclass(frozen=True, eq=False)
class Published:
    """EAGOR as published: degree 7, log(l + 1e-3) of the response scaled to its maximum, read by the mean of the log field."""

    belief: Belief = field(default_factory=lambda: Belief.uniform(7))

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Published:
        """The belief turned, not translated."""
        return Published(self.belief.predict(new_R_old))

    def update(self, evidence: Evidence) -> Published:
        """The belief with this frame added."""
        return Published(self.belief.update(_read(evidence, Calibration.paper())))

    def direction(self) -> np.ndarray:
        return self.belief.mean_direction()

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``: exp of the published field, normalised."""
        return self.belief.log_density(directions)


# Beyond the paper


@dataclass(frozen=True, eq=False)
class VonMisesFisherFilter:
    """One mean direction and one concentration, as the natural parameter eta = kappa mu.

    Sources: Kurz, Gilitschenski and Hanebeck, IEEE Signal Processing Letters 23(4), 2016 (moment matching; noise as a
    convolution, A_3(kappa) <- A_3(kappa) A_3(noise) with A_3(k) = coth k - 1/k); Mardia and Jupp, Directional Statistics, 2000.

    - `noise`: radians by which the target may wander between two looks.
    - `gated`: match the moments of the posterior (prior times likelihood: what lies far from the prior hardly counts);
      else those of the likelihood alone, whose natural parameter is then added.
    """

    eta: np.ndarray = field(default_factory=lambda: np.zeros(3))
    calibration: Calibration = Calibration(floor=0.05, neutral=0.05)
    noise: float = math.radians(4)
    gated: bool = True

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> VonMisesFisherFilter:
        """The mean turned, the concentration lowered by the noise."""
        kappa = float(np.linalg.norm(self.eta))
        if kappa == 0.0:
            check_rotation(new_R_old)
            return self
        after = concentration(mean_length(kappa) * mean_length(1 / self.noise**2)) if self.noise > 0 else kappa
        return replace(self, eta=check_rotation(new_R_old) @ self.eta * (after / kappa))

    def update(self, evidence: Evidence) -> VonMisesFisherFilter:
        """The nearest von Mises-Fisher distribution to the posterior (or to the likelihood, times the prior)."""
        points, weights = evidence.grid.directions, evidence.grid.weights
        log_ratio = to_numpy(_read(evidence, self.calibration).log_ratio).astype(np.float64)
        exponent = log_ratio + points @ self.eta if self.gated else log_ratio
        top = float(exponent.max())
        inside = np.exp(exponent - top) * weights
        mass, moment = inside.sum(), np.einsum("ij,ijk->k", inside, points)
        prior = self.eta if self.gated else np.zeros(3)
        outside = _integral_of_exp(prior, top) - np.sum(np.exp(points @ prior - top) * weights)
        if outside > 1e-6 * mass:  # what this look did not see keeps its prior
            mass = mass + outside
            moment = moment + _moment_of_exp(prior, top) - np.einsum("ij,ijk->k", np.exp(points @ prior - top) * weights, points)
        length = float(np.linalg.norm(moment))
        if length < 1e-9 * mass:
            return replace(self, eta=np.zeros(3)) if self.gated else self
        matched = moment * (concentration(length / float(mass)) / length)
        return replace(self, eta=matched if self.gated else self.eta + matched)

    def direction(self) -> np.ndarray:
        return unit(self.eta) if self.eta.any() else _forward()

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``, in closed form."""
        return directions @ self.eta - _log_integral_of_exp(self.eta)
