"""Rivals of `eagor.Belief`, fed the same evidence through the same two calls.

Every rival is an immutable value: ``predict(new_R_old, translation=None)`` and ``update(evidence)`` return a new one
and leave the old one as it was; ``direction()`` is a unit vector ``(3,)`` in the body frame, forward while nothing is known.
Where there is a distribution, ``log_density(directions)`` gives it per steradian, normalised.

- As in the paper's comparison, untuned: `Centroid`, `CircularCentroid` (per frame), `GridFilter`, `Published`.
- Stronger ones, whose defaults were chosen on the development seeds of ``benchmarks/quality.py`` with the same
  number of trials as our own: `VonMisesFisherFilter`, `HistogramFilter`, `ParticleFilter`. They keep their own `Calibration`.

All of them take `translation` and ignore it: a belief over distance is what `eagor.RangedBelief` adds. Evidence has
no batch dimension here. Bad rotations raise `RotationError`, batches of evidence `ResponseError`.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from eagor._arrays import to_numpy
from eagor.belief import Belief
from eagor.coverage import taper
from eagor.errors import ResponseError
from eagor.evidence import Calibration, Evidence
from eagor.grids import ErpGrid, Grid
from eagor.peaks import peak_on_grid
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
    """The paper's Grid: an equirectangular map of log(l + 1e-3), resampled bilinearly at each turn, read at its
    maximum.

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
        exponent = _sample_log_ratio(evidence, self.calibration, GRID.directions)
        if self.gated:
            exponent = exponent + GRID.directions @ self.eta
        density = np.exp(_normalised(exponent)) * GRID.weights
        moment = np.einsum("ij,ijk->k", density, GRID.directions)
        length = float(np.linalg.norm(moment))
        matched = moment * (concentration(length) / length) if length > 1e-9 else np.zeros(3)
        return replace(self, eta=matched if self.gated else self.eta + matched)

    def direction(self) -> np.ndarray:
        return unit(self.eta) if self.eta.any() else _forward()

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``: kappa / (4 pi sinh kappa) exp(eta . omega)."""
        kappa = float(np.linalg.norm(self.eta))
        log_sinhc = kappa + math.log(-math.expm1(-2 * kappa) / (2 * kappa)) if kappa > 1e-6 else 0.0
        return directions @ self.eta - math.log(4 * math.pi) - log_sinhc


@dataclass(frozen=True, eq=False)
class HistogramFilter:
    """A Bayes filter on a grid of probabilities.

    The grid stays fixed in the world: turns are composed and the evidence is looked up through them, so that nothing
    is ever resampled (the published Grid loses itself by resampling).

    - `diffusion`: radians per axis by which the target may wander between two looks: a convolution of the density.
    - `mixing`: share of the density that is spread evenly before each look, so that a lost target can be found again.
    """

    log_density_map: np.ndarray = field(default_factory=lambda: np.full(GRID.shape, -math.log(4 * math.pi)))
    body_R_grid: np.ndarray = field(default_factory=lambda: np.eye(3))
    calibration: Calibration = Calibration(floor=0.05, neutral=0.05)
    diffusion: float = math.radians(4)
    mixing: float = 0.01

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> HistogramFilter:
        """Turned exactly, then spread and mixed."""
        turned = check_rotation(new_R_old) @ self.body_R_grid
        density = np.exp(self.log_density_map)
        if self.diffusion > 0:
            density = _spread(density, self.diffusion)
        density = (1 - self.mixing) * density + self.mixing / (4 * math.pi)
        return replace(self, log_density_map=np.log(np.maximum(density, 1e-300)), body_R_grid=turned)

    def update(self, evidence: Evidence) -> HistogramFilter:
        """Bayes' rule, cell by cell."""
        looked_at = GRID.directions @ self.body_R_grid.T
        log_ratio = _sample_log_ratio(evidence, self.calibration, looked_at)
        return replace(self, log_density_map=_normalised(self.log_density_map + log_ratio))

    def direction(self) -> np.ndarray:
        return _known(self.body_R_grid @ peak_on_grid(GRID, self.log_density_map), self.log_density_map)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``."""
        return _sample(self.log_density_map, GRID, directions @ self.body_R_grid)


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """Equally weighted directions, turned exactly, roughened, weighed by the evidence and resampled systematically.

    Sources: Gordon, Salmond and Smith, IEE Proceedings F 140(2), 1993 (bootstrap filter, roughening); Lenser and
    Veloso, ICRA 2000 (sensor resetting). Randomness comes in as a Generator; each step draws from a copy of it, which the new filter
    keeps, so that a filter never changes and the same steps give the same particles.

    - `roughening`: radians per axis of noise at each prediction.
    - `reborn`: share of the particles drawn afresh at each look, from the response where there is one, else anywhere.
    - `kernel`: radians; the width with which the particles are smoothed into a density to find where they are densest.
    """

    particles: np.ndarray
    rng: np.random.Generator
    calibration: Calibration = Calibration(floor=0.05, neutral=0.05)
    roughening: float = math.radians(4)
    reborn: float = 0.02
    kernel: float = math.radians(4)

    @classmethod
    def uniform(cls, count: int, rng: np.random.Generator, **settings: object) -> ParticleFilter:
        """`count` particles all over the sphere; `settings` are the other fields."""
        rng = copy.deepcopy(rng)
        return cls(unit(rng.normal(size=(count, 3))), rng, **settings)  # type: ignore[arg-type]

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> ParticleFilter:
        """The particles turned, each moved a little at random."""
        rng = copy.deepcopy(self.rng)
        turned = self.particles @ check_rotation(new_R_old).T
        return replace(self, particles=unit(turned + rng.normal(0.0, self.roughening, turned.shape)), rng=rng)

    def update(self, evidence: Evidence) -> ParticleFilter:
        """Weighed, resampled, and a few reborn."""
        rng, count = copy.deepcopy(self.rng), len(self.particles)
        log_ratio = _sample_log_ratio(evidence, self.calibration, self.particles)
        weights = np.exp(log_ratio - log_ratio.max())
        edges = np.cumsum(weights) / weights.sum()
        chosen = np.searchsorted(edges, (np.arange(count) + rng.random()) / count)
        particles = self.particles[np.minimum(chosen, count - 1)]
        fresh = rng.random(count) < self.reborn
        particles[fresh] = _drawn(evidence, int(fresh.sum()), rng)
        return replace(self, particles=particles, rng=rng)

    def direction(self) -> np.ndarray:
        """The mean of the particles within two kernel widths of where they are densest."""
        densest = GRID.directions.reshape(-1, 3)[np.argmax(self._density)]
        near = self.particles @ densest > math.cos(2 * self.kernel)
        return unit(self.particles[near].sum(axis=0)) if near.any() else densest

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian ``(...)`` at directions ``(..., 3)``: the smoothed particles."""
        return _sample(np.log(np.maximum(self._density, 1e-300)), GRID, directions)

    @cached_property
    def _density(self) -> np.ndarray:
        """Smoothed histogram of the particles ``(H, W)`` per steradian; a share as large as the reborn lies anywhere."""
        x, y, _ = GRID.project(self.particles)
        row, column = np.clip(y.astype(int), 0, GRID.height - 1), x.astype(int) % GRID.width
        counts = np.bincount(row * GRID.width + column, minlength=GRID.height * GRID.width).reshape(GRID.shape)
        share = max(self.reborn, 1 / len(self.particles))
        return (1 - share) * _spread(counts / counts.sum() / GRID.weights, self.kernel) + share / (4 * math.pi)


# Helpers


def mean_length(kappa: float) -> float:
    """A_3(kappa) = coth(kappa) - 1 / kappa: the mean resultant length of a von Mises-Fisher distribution on the sphere."""
    return 1 / math.tanh(kappa) - 1 / kappa if kappa > 1e-3 else kappa / 3


def concentration(length: float) -> float:
    """The inverse of `mean_length` for a length in [0, 1): Banerjee's approximation and Newton's method (Sra 2012)."""
    length = min(max(length, 0.0), 1 - 1 / MAX_CONCENTRATION)
    kappa = length * (3 - length**2) / (1 - length**2)
    for _ in range(4):
        if kappa < 1e-3:
            return 3 * length
        found = mean_length(kappa)
        kappa = max(kappa - (found - length) / (1 - found**2 - 2 * found / kappa), kappa / 4)
    return kappa


def _known(found: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`found`, or forward where `values` are all alike, so that nothing is known."""
    return found if np.ptp(values) > 1e-9 else _forward()


def _check_single(evidence: Evidence) -> None:
    if len(evidence.log_ratio.shape) != 2:
        raise ResponseError(
            f"evidence has shape {tuple(evidence.log_ratio.shape)}; the baselines read one look (H, W) at a time. "
            "Loop over the batch"
        )


def _seen_response(evidence: Evidence) -> np.ndarray:
    """The response ``(H, W)`` in float64, zero where this look saw nothing of the sphere."""
    _check_single(evidence)
    response = to_numpy(evidence.response).astype(np.float64) * (evidence.grid.weights > 0)
    if evidence.seen is not None and evidence.seen[-1]:
        response = response * (taper(0, evidence.seen, response) > 0)
    return response


def _read(evidence: Evidence, calibration: Calibration) -> Evidence:
    """`evidence` read with `calibration`; rounding in a silent response is not scaled up to a detection."""
    _check_single(evidence)
    if calibration.scale_to_max and to_numpy(evidence.response).max() < SILENT:
        calibration = replace(calibration, scale_to_max=False)
    return evidence.with_calibration(calibration)


def _sample_log_ratio(evidence: Evidence, calibration: Calibration, directions: np.ndarray) -> np.ndarray:
    """The log ratio at directions ``(..., 3)`` of the body frame: interpolated, zero where nothing was looked at."""
    return _sample(to_numpy(_read(evidence, calibration).log_ratio).astype(np.float64), evidence.grid, directions)


def _sample(values: np.ndarray, grid: Grid, directions: np.ndarray) -> np.ndarray:
    """`values` ``(H, W)`` at directions ``(..., 3)``, bilinear between cell centres, zero outside the grid.

    A panorama continues across the seam and over the poles; a view is held constant in its outer half cell.
    """
    height, width = grid.shape
    x, y, inside = grid.project(directions)
    column, row = np.floor(x - 0.5), np.floor(y - 0.5)
    right, down = x - 0.5 - column, y - 0.5 - row
    if grid.depth_inside() is None and not hasattr(grid, "body_R_view"):
        beyond = np.concatenate([values[:1], values[-1:]])
        beyond = np.roll(beyond, width // 2, axis=1)
        padded = np.concatenate([beyond[:1], values, beyond[1:]])
        padded = np.concatenate([padded, padded[:, :1]], axis=1)
        first = (row.astype(np.intp) + 1) * (width + 1) + column.astype(np.intp) % width
    else:
        padded = np.pad(values, 1, mode="edge")
        first = np.clip(row + 1, 0, height) * (width + 2) + np.clip(column + 1, 0, width)
        first = np.where(inside, first, 0).astype(np.intp)
    flat, stride = padded.reshape(-1), padded.shape[1]
    upper = flat[first] * (1 - right) + flat[first + 1] * right
    lower = flat[first + stride] * (1 - right) + flat[first + stride + 1] * right
    return np.where(inside, upper * (1 - down) + lower * down, 0.0)


def _normalised(log_values: np.ndarray) -> np.ndarray:
    """`log_values` on `GRID`, shifted so that their exponential integrates to one."""
    top = float(log_values.max())
    return log_values - top - math.log(float(np.sum(np.exp(log_values - top) * GRID.weights)))


def _spread(density: np.ndarray, sigma: float) -> np.ndarray:
    """`density` on `GRID` convolved with a von Mises-Fisher kernel of `sigma` radians per axis; the mass is kept."""
    spectrum = np.fft.rfft(density, axis=1).T[..., None]
    return np.maximum(np.fft.irfft((_kernel(sigma) @ spectrum)[..., 0].T, GRID.width, axis=1), 0.0)


@lru_cache(maxsize=32)
def _kernel(sigma: float) -> np.ndarray:
    """The convolution on `GRID`, one matrix ``(W / 2 + 1, H, H)`` per frequency in azimuth.

    The kernel depends on the difference in azimuth alone, so that the Fourier transform over columns makes it a
    product.
    """
    cosine = GRID.directions @ GRID.directions[:, 0].T  # (row, column, row of the source, whose column is 0)
    kernel = np.exp((cosine - 1) / sigma**2) * GRID.weights[:, 0]
    sums = np.einsum("ijb,i->b", kernel, GRID.weights[:, 0]) / GRID.weights[:, 0]
    return np.ascontiguousarray(np.fft.rfft(kernel / sums, axis=1).real.transpose(1, 0, 2))


def _drawn(evidence: Evidence, count: int, rng: np.random.Generator) -> np.ndarray:
    """`count` directions drawn from the response as a density, or from the whole sphere where it is silent."""
    share = (_seen_response(evidence) * evidence.grid.weights).reshape(-1)
    if share.max() < SILENT * evidence.grid.weights.max():
        return unit(rng.normal(size=(count, 3)))
    cell = rng.choice(share.size, size=count, p=share / share.sum())
    row, column = np.divmod(cell, evidence.grid.shape[1])
    return evidence.grid.unproject(column + rng.random(count), row + rng.random(count))
