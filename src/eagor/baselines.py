"""Rivals of `eagor.Belief`, fed the same evidence through the same two calls.

Every rival is an immutable value: ``predict(new_R_old, translation=None)`` and ``update(evidence)`` return a new one,
``direction()`` is a unit vector ``(3,)`` in the body frame, forward while nothing is known. Where there is a
distribution, ``log_density(directions)`` gives its logarithm ``(...)`` per steradian at unit vectors ``(..., 3)``.

- As in the published comparison, nothing to tune: `Centroid`, `CircularCentroid`, `GridFilter`, `Published`. The last
  two read log(l + 1e-3), which is negative wherever one looks: they are made for whole panoramas, not for views.
- Stronger ones: `VonMisesFisherFilter`, `HistogramFilter`, `ParticleFilter`. They read the evidence with a
  calibration of their own; their defaults won on the development seeds of ``benchmarks/quality.py``, with as many
  trials as ours had.

All accept `translation` and ignore it: distance is what `eagor.RangedBelief` adds. They raise `RotationError` for
what is no rotation and `ResponseError` for evidence with batch dimensions.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from eagor._arrays import to_numpy
from eagor.belief import Belief
from eagor.coverage import taper
from eagor.errors import ResponseError
from eagor.evidence import SILENT, Calibration, Evidence
from eagor.grids import ErpGrid, Grid
from eagor.peaks import peak_on_grid
from eagor.posterior import log_integral
from eagor.sphere import FORWARD, azimuth_elevation, check_rotation, direction, unit

GRID = ErpGrid(64, 128)  # cells of 2.8 degrees, for the rivals that keep a map
NOTHING_KNOWN = -math.log(4 * math.pi)


class DirectionFilter(Protocol):
    """The face that all rivals share."""

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self: ...
    def update(self, evidence: Evidence) -> Self: ...
    def direction(self) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class _PerFrame:
    """No memory but the last answer, which stands where it was in the image while the response is zero everywhere.

    Carrying it along with the camera is no part of the published methods: `predict` changes nothing.
    """

    last: np.ndarray = field(default_factory=lambda: np.array(FORWARD))

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Self:
        check_rotation(new_R_old)
        return self

    def update(self, evidence: Evidence) -> Self:
        response = _seen_response(evidence)
        return (
            self
            if response.max() < SILENT
            else replace(self, last=self._read(response / response.sum(), evidence.grid))
        )

    def direction(self) -> np.ndarray:
        return self.last

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        raise NotImplementedError


class Centroid(_PerFrame):
    """Response-weighted mean of the pixel coordinates, per frame: linear in u, so that it breaks at the seam."""

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
    """The direction of the strongest response, per frame: what a model that is simply asked would answer."""

    def _read(self, share: np.ndarray, grid: Grid) -> np.ndarray:
        best = share >= 0.999 * share.max()
        # Several cells that are equally strong (a whole view in which the thing is said to be): their middle.
        middle = np.sum((grid.weights * best)[..., None] * grid.directions, axis=(0, 1)) / np.sum(grid.weights * best)
        if np.linalg.norm(middle) < 0.5:  # they are scattered: no middle
            return grid.directions[np.unravel_index(np.argmax(share), share.shape)]
        return unit(middle)


@dataclass(frozen=True, eq=False)
class GridFilter:
    """The published Grid: a panorama of summed log(l + 1e-3), resampled bilinearly at each turn, read at its maximum.

    Every resampling blurs; rotating coefficients does not.
    """

    values: np.ndarray = field(default_factory=lambda: np.zeros(GRID.shape))

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> GridFilter:
        turn = check_rotation(new_R_old)
        return (
            self if np.array_equal(turn, np.eye(3)) else GridFilter(_sample(self.values, GRID, GRID.directions @ turn))
        )

    def update(self, evidence: Evidence) -> GridFilter:
        return GridFilter(self.values + _log_ratio(evidence, Calibration.paper(), GRID.directions))

    def direction(self) -> np.ndarray:
        known = np.ptp(self.values) > 0
        return GRID.directions.reshape(-1, 3)[np.argmax(self.values)] if known else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return _log_density(_normalised(self.values), directions)


@dataclass(frozen=True, eq=False)
class Published:
    """EAGOR as published: degree 7, log(l + 1e-3) of the response over its maximum, mean direction of the log field."""

    belief: Belief = field(default_factory=lambda: Belief.uniform(7))

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> Published:
        return Published(self.belief.predict(new_R_old))

    def update(self, evidence: Evidence) -> Published:
        return Published(self.belief.update(_calibrated(evidence, Calibration.paper())))

    def direction(self) -> np.ndarray:
        return self.belief.mean_direction()

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return self.belief.log_density(directions)


@dataclass(frozen=True, eq=False)
class VonMisesFisherFilter:
    """A von Mises-Fisher distribution, as its natural parameter `eta` = concentration times mean direction, ``(3,)``.

    Bayes' rule, then the distribution of the same mean resultant (assumed density filter). It holds one mode, and what
    lies far from that hardly counts. `noise`: radians per axis by which the target may wander between two looks; the
    noise convolves, A(kappa) <- A(kappa) A(1 / noise^2) with A(k) = coth k - 1 / k.

    Sources: Kurz, Gilitschenski and Hanebeck, IEEE Signal Processing Letters 23(4), 2016; Mardia and Jupp, Directional
    Statistics, 2000.
    """

    eta: np.ndarray = field(default_factory=lambda: np.zeros(3))
    calibration: Calibration = field(default_factory=lambda: Calibration(floor=0.4, neutral=0.05, temperature=8.0))
    noise: float = math.radians(10)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> VonMisesFisherFilter:
        turned, kappa = check_rotation(new_R_old) @ self.eta, float(np.linalg.norm(self.eta))
        if kappa > 0 and self.noise > 0:
            turned = turned * (concentration(mean_length(kappa) * mean_length(self.noise**-2)) / kappa)
        return replace(self, eta=turned)

    def update(self, evidence: Evidence) -> VonMisesFisherFilter:
        log_posterior = _log_ratio(evidence, self.calibration, GRID.directions) + GRID.directions @ self.eta
        moment = np.einsum("ij,ijk->k", np.exp(_normalised(log_posterior)) * GRID.weights, GRID.directions)
        length = float(np.linalg.norm(moment))
        return replace(self, eta=moment * (concentration(length) / length) if length > 1e-9 else np.zeros(3))

    def direction(self) -> np.ndarray:
        return unit(self.eta) if self.eta.any() else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        kappa = float(np.linalg.norm(self.eta))
        log_sinhc = kappa + math.log(-math.expm1(-2 * kappa) / (2 * kappa)) if kappa > 1e-6 else 0.0
        return directions @ self.eta + NOTHING_KNOWN - log_sinhc


@dataclass(frozen=True, eq=False)
class HistogramFilter:
    """A Bayes filter on a grid of probabilities.

    The grid stays fixed in the world; turns are composed and the evidence is looked up through them, so that nothing is
    resampled. Before each look a share `mixing` of the density is spread evenly, so that a lost target can be found
    again, and the rest is convolved with a kernel of `diffusion` (radians per axis: how far the target may wander
    between two looks; the grid carries none below half a cell, 0.025). With the mixing, no diffusion did best in
    development, even with drifting targets.
    """

    log_map: np.ndarray = field(default_factory=lambda: np.full(GRID.shape, NOTHING_KNOWN))
    body_R_grid: np.ndarray = field(default_factory=lambda: np.eye(3))
    calibration: Calibration = field(default_factory=lambda: Calibration(floor=0.4, neutral=0.05, temperature=8.0))
    diffusion: float = 0.0
    mixing: float = 0.02

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> HistogramFilter:
        turned = check_rotation(new_R_old) @ self.body_R_grid
        density = np.exp(self.log_map)
        if self.diffusion > 0:
            density = _spread(density, self.diffusion)
        return replace(self, log_map=_log_mixed(density, self.mixing), body_R_grid=turned)

    def update(self, evidence: Evidence) -> HistogramFilter:
        looked_at = GRID.directions @ self.body_R_grid.T
        return replace(self, log_map=_normalised(self.log_map + _log_ratio(evidence, self.calibration, looked_at)))

    def direction(self) -> np.ndarray:
        known = np.ptp(self.log_map) > 1e-9
        return self.body_R_grid @ peak_on_grid(GRID, self.log_map) if known else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return _log_density(self.log_map, directions @ self.body_R_grid)


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """Directions of equal weight: turned exactly, roughened, weighed by the evidence, resampled systematically.

    `roughening`: radians per axis of noise at each prediction. `reborn`: share of the particles drawn afresh at each
    look, from the response, or from anywhere while that is silent. `kernel`: radians, the width with which the
    particles are smoothed into a density; the answer is their mean within two of it from where they are densest.

    Each step draws from a copy of `rng`, which the new filter keeps: a filter never changes, and the same steps give
    the same particles. Sources: Gordon, Salmond and Smith, IEE Proceedings F 140(2), 1993 (bootstrap filter,
    roughening); Lenser and Veloso, ICRA 2000 (sensor resetting).
    """

    particles: np.ndarray
    rng: np.random.Generator
    calibration: Calibration = field(default_factory=lambda: Calibration(floor=1.0, neutral=0.05, temperature=8.0))
    roughening: float = math.radians(2)
    reborn: float = 0.05
    kernel: float = math.radians(4)

    @classmethod
    def uniform(cls, count: int, rng: np.random.Generator, **settings: Any) -> ParticleFilter:
        """`count` particles all over the sphere; `settings` are the fields beside `particles` and `rng`."""
        rng = copy.deepcopy(rng)
        return cls(unit(rng.normal(size=(count, 3))), rng, **settings)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> ParticleFilter:
        rng = copy.deepcopy(self.rng)
        turned = self.particles @ check_rotation(new_R_old).T
        return replace(self, particles=unit(turned + rng.normal(0.0, self.roughening, turned.shape)), rng=rng)

    def update(self, evidence: Evidence) -> ParticleFilter:
        rng, count = copy.deepcopy(self.rng), len(self.particles)
        log_ratio = _log_ratio(evidence, self.calibration, self.particles)
        reached = np.cumsum(np.exp(log_ratio - log_ratio.max()))
        chosen = np.searchsorted(reached / reached[-1], (np.arange(count) + rng.random()) / count)
        particles = self.particles[np.minimum(chosen, count - 1)]
        fresh = rng.random(count) < self.reborn
        particles[fresh] = _drawn(evidence, int(fresh.sum()), rng)
        return replace(self, particles=particles, rng=rng)

    def direction(self) -> np.ndarray:
        densest = GRID.directions.reshape(-1, 3)[np.argmax(self._log_map)]
        near = self.particles @ densest > math.cos(2 * self.kernel)
        return unit(self.particles[near].sum(axis=0)) if near.any() else densest

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return _log_density(self._log_map, directions)

    @cached_property
    def _log_map(self) -> np.ndarray:
        """Log density of the smoothed particles on `GRID`; a share as large as the reborn lies anywhere."""
        x, y, _ = GRID.project(self.particles)
        cell = np.clip(y.astype(np.intp), 0, GRID.height - 1) * GRID.width + x.astype(np.intp) % GRID.width
        counts = np.bincount(cell, minlength=GRID.height * GRID.width).reshape(GRID.shape)
        density = _spread(counts / len(self.particles) / GRID.weights, self.kernel)
        return _log_mixed(density, max(self.reborn, 1 / len(self.particles)))


def mean_length(kappa: float) -> float:
    """A(kappa) = coth kappa - 1 / kappa, the mean resultant length of a von Mises-Fisher distribution on the sphere."""
    return 1 / math.tanh(kappa) - 1 / kappa if kappa > 1e-3 else kappa / 3


def concentration(length: float) -> float:
    """The inverse of `mean_length`, for 0 <= length < 1: Banerjee's approximation, then Newton's method (Sra 2012)."""
    length = min(max(length, 0.0), 1 - 1e-6)
    kappa = length * (3 - length**2) / (1 - length**2)
    for _ in range(4):
        if kappa < 1e-3:
            return 3 * length
        found = mean_length(kappa)
        kappa -= (found - length) / (1 - found**2 - 2 * found / kappa)
    return kappa


def _check_single(evidence: Evidence) -> None:
    if len(evidence.log_ratio.shape) != 2:
        raise ResponseError(
            f"evidence has shape {tuple(evidence.log_ratio.shape)}; the baselines read one look (H, W) at a time. "
            "Loop over the batch"
        )


def _seen_response(evidence: Evidence) -> np.ndarray:
    """The response ``(H, W)`` in float64, zero in cells that were not looked at."""
    _check_single(evidence)
    response = to_numpy(evidence.response).astype(np.float64) * (evidence.grid.weights > 0)
    if evidence.seen is not None and evidence.seen[-1]:
        response = response * (taper(0, evidence.seen, response) > 0)
    return response


def _calibrated(evidence: Evidence, calibration: Calibration) -> Evidence:
    """`evidence` read with `calibration`."""
    _check_single(evidence)
    return evidence.with_calibration(calibration)


def _log_ratio(evidence: Evidence, calibration: Calibration, directions: np.ndarray) -> np.ndarray:
    """The log ratio ``(...)`` at directions ``(..., 3)`` of the body frame: bilinear, zero where nothing was seen."""
    values = to_numpy(_calibrated(evidence, calibration).log_ratio).astype(np.float64)
    return _sample(values, evidence.grid, directions)


def _sample(values: np.ndarray, grid: Grid, directions: np.ndarray) -> np.ndarray:
    """`values` ``(H, W)`` at directions ``(..., 3)``: bilinear between cell centres, zero outside the grid.

    A panorama goes on across the seam and over the poles; a view keeps the value of its outermost cells up to its
    border.
    """
    height, width = grid.shape
    x, y, inside = grid.project(directions)
    padded = np.pad(values, 1, mode="edge")
    if not hasattr(grid, "body_R_view"):
        padded[[0, -1], 1:-1] = np.roll(values[[0, -1]], width // 2, axis=1)
        padded[:, 0], padded[:, -1] = padded[:, -2], padded[:, 1]
    right, column = np.modf(np.where(inside, np.clip(x + 0.5, 0, width + 1), 0.0))
    down, row = np.modf(np.where(inside, np.clip(y + 0.5, 0, height + 1), 0.0))
    flat, stride = padded.reshape(-1), width + 2
    first = np.minimum(row.astype(np.intp), height) * stride + np.minimum(column.astype(np.intp), width)
    upper = flat[first] * (1 - right) + flat[first + 1] * right
    lower = flat[first + stride] * (1 - right) + flat[first + stride + 1] * right
    return np.where(inside, upper * (1 - down) + lower * down, 0.0)


def _log_density(log_map: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """log of the density that `log_map` holds on `GRID`: the density is interpolated, so that it keeps its mass."""
    return np.log(np.maximum(_sample(np.exp(log_map), GRID, directions), 1e-300))


def _normalised(log_values: np.ndarray) -> np.ndarray:
    """`log_values` on `GRID`, shifted so that their exponential integrates to one."""
    return log_values - log_integral(log_values, GRID.weights)


def _log_mixed(density: np.ndarray, share: float) -> np.ndarray:
    """log of `density` on `GRID` with `share` of it spread evenly."""
    return np.log(np.maximum((1 - share) * density + share / (4 * math.pi), 1e-300))


def _spread(density: np.ndarray, sigma: float) -> np.ndarray:
    """`density` on `GRID` convolved with a von Mises-Fisher kernel of `sigma` radians per axis; the mass is kept."""
    spectrum = np.fft.rfft(density, axis=1).T[..., None]
    return np.maximum(np.fft.irfft((_kernel(sigma) @ spectrum)[..., 0].T, GRID.width, axis=1), 0.0)


@lru_cache(maxsize=32)
def _kernel(sigma: float) -> np.ndarray:
    """The kernel of `_spread`, ``(W / 2 + 1, H, H)``: it depends on the difference in azimuth alone, so that a Fourier
    transform over the columns leaves one small matrix per frequency.
    """  # noqa: D205
    cosine = GRID.directions @ GRID.directions[:, 0].T  # row, column; row of the source, which is in column 0
    kernel = np.exp((cosine - 1) / sigma**2)
    mass = np.einsum("ijk,i->k", kernel, GRID.weights[:, 0])
    return np.ascontiguousarray(np.fft.rfft(kernel * (GRID.weights[:, 0] / mass), axis=1).real.transpose(1, 0, 2))


def _drawn(evidence: Evidence, count: int, rng: np.random.Generator) -> np.ndarray:
    """`count` directions drawn from the response as a density, or from the whole sphere while it is silent."""
    response = _seen_response(evidence)
    if response.max() < SILENT:
        return unit(rng.normal(size=(count, 3)))
    share = (response * evidence.grid.weights).reshape(-1)
    row, column = np.divmod(rng.choice(share.size, size=count, p=share / share.sum()), response.shape[1])
    return evidence.grid.unproject(column + rng.random(count), row + rng.random(count))
