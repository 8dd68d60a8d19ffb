"""Baselines with memory: the published ones, and Bayes filters of other kinds."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from eagor._checks import above, require, within
from eagor._values import changed, lazy
from eagor.baselines import maps
from eagor.baselines.maps import GRID
from eagor.evidence import Evidence
from eagor.evidence.calibration import SILENT, Calibration
from eagor.harmonics.peaks import peak_on_grid
from eagor.sphere import FORWARD, check_rotation, unit


@dataclass(frozen=True, eq=False)
class GridFilter:
    """The published Grid: a panorama of summed log(l + 1e-3), resampled bilinearly at each turn, read at its maximum.

    Every resampling blurs it; rotating coefficients does not.
    """

    values: np.ndarray = field(default_factory=lambda: np.zeros(GRID.shape))

    __repr__ = changed

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> GridFilter:
        turn = check_rotation(new_R_old)
        if np.array_equal(turn, np.eye(3)):
            return self
        return GridFilter(maps.sample(self.values, GRID, GRID.directions @ turn))

    def update(self, evidence: Evidence) -> GridFilter:
        return GridFilter(self.values + maps.log_ratio(evidence, Calibration.paper(), GRID.directions))

    def direction(self) -> np.ndarray:
        known = np.ptp(self.values) > 0
        return GRID.directions.reshape(-1, 3)[np.argmax(self.values)] if known else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return maps.log_density(maps.normalised(self.values), directions)


@dataclass(frozen=True, eq=False)
class VonMisesFisherFilter:
    """A von Mises-Fisher distribution, as its natural parameter `eta` = concentration times mean direction, ``(3,)``.

    Bayes' rule, then the distribution of the same mean resultant (assumed density filter). It holds a single mode, and
    evidence far from it hardly counts. `noise`: radians per axis by which the target may move between two looks; the
    noise convolves, A(kappa) <- A(kappa) A(1 / noise^2) with A(k) = coth k - 1 / k.

    Sources: Kurz, Gilitschenski and Hanebeck, IEEE Signal Processing Letters 23(4), 2016; Mardia and Jupp, Directional
    Statistics, 2000.
    """

    eta: np.ndarray = field(default_factory=lambda: np.zeros(3))
    calibration: Calibration = field(default_factory=lambda: Calibration(floor=0.4, neutral=0.05, temperature=8.0))
    noise: float = math.radians(10)

    __repr__ = changed

    def __post_init__(self) -> None:
        require(self, {"noise": (within(self.noise, 0), "radians per look, from 0 on")})

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> VonMisesFisherFilter:
        turned, kappa = check_rotation(new_R_old) @ self.eta, float(np.linalg.norm(self.eta))
        if kappa > 0 and self.noise > 0:
            turned = turned * (concentration(mean_length(kappa) * mean_length(self.noise**-2)) / kappa)
        return replace(self, eta=turned)

    def update(self, evidence: Evidence) -> VonMisesFisherFilter:
        log_posterior = maps.log_ratio(evidence, self.calibration, GRID.directions) + GRID.directions @ self.eta
        moment = np.einsum("ij,ijk->k", np.exp(maps.normalised(log_posterior)) * GRID.weights, GRID.directions)
        length = float(np.linalg.norm(moment))
        return replace(self, eta=moment * (concentration(length) / length) if length > 1e-9 else np.zeros(3))

    def direction(self) -> np.ndarray:
        return unit(self.eta) if self.eta.any() else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        kappa = float(np.linalg.norm(self.eta))
        log_sinhc = kappa + math.log(-math.expm1(-2 * kappa) / (2 * kappa)) if kappa > 1e-6 else 0.0
        return directions @ self.eta + maps.NOTHING_KNOWN - log_sinhc


@dataclass(frozen=True, eq=False)
class HistogramFilter:
    """A Bayes filter on a grid of probabilities.

    The grid is fixed in the world; turns are composed and the evidence is looked up through them, so nothing is
    resampled. Before each look a share `mixing` of the density becomes uniform, so that a lost target can be found
    again, and the rest is convolved with a kernel of `diffusion` (radians per axis: the target's motion between two
    looks; below half a cell, 0.025, the grid cannot represent it). With the mixing, no diffusion did best in
    development, even with drifting targets.
    """

    log_map: np.ndarray = field(default_factory=lambda: np.full(GRID.shape, maps.NOTHING_KNOWN))
    body_R_grid: np.ndarray = field(default_factory=lambda: np.eye(3))
    calibration: Calibration = field(default_factory=lambda: Calibration(floor=0.4, neutral=0.05, temperature=8.0))
    diffusion: float = 0.0
    mixing: float = 0.02

    __repr__ = changed

    def __post_init__(self) -> None:
        wanted = {
            "diffusion": (within(self.diffusion, 0), "radians per look, from 0 on"),
            "mixing": (within(self.mixing, 0, 1), "a share from 0 to 1"),
        }
        require(self, wanted)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> HistogramFilter:
        turned = check_rotation(new_R_old) @ self.body_R_grid
        density = np.exp(self.log_map)
        if self.diffusion > 0:
            density = maps.spread(density, self.diffusion)
        return replace(self, log_map=maps.log_mixed(density, self.mixing), body_R_grid=turned)

    def update(self, evidence: Evidence) -> HistogramFilter:
        found = maps.log_ratio(evidence, self.calibration, GRID.directions @ self.body_R_grid.T)
        return replace(self, log_map=maps.normalised(self.log_map + found))

    def direction(self) -> np.ndarray:
        known = np.ptp(self.log_map) > 1e-9
        return self.body_R_grid @ peak_on_grid(GRID, self.log_map) if known else np.array(FORWARD)

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        return maps.log_density(self.log_map, directions @ self.body_R_grid)


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """Particles of equal weight on the sphere: rotated exactly, roughened, weighted by the evidence, resampled.

    `roughening`: radians per axis of noise at each prediction. `reborn`: share of the particles redrawn at each look,
    from the response, or uniformly if that is zero. `kernel`: radians, the width of the kernel that turns particles
    into a density; the answer is their mean within two widths of the density's maximum. Resampling is systematic.

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

    __repr__ = changed

    def __post_init__(self) -> None:
        wanted = {
            "roughening": (within(self.roughening, 0), "radians per look, from 0 on"),
            "reborn": (within(self.reborn, 0, 1), "a share from 0 to 1"),
            "kernel": (above(self.kernel, 0), "radians above 0"),
        }
        require(self, wanted)

    @classmethod
    def uniform(cls, count: int, rng: np.random.Generator, **settings: Any) -> ParticleFilter:
        """`count` particles, uniform on the sphere; `settings` are the fields except `particles` and `rng`."""
        rng = copy.deepcopy(rng)
        return cls(unit(rng.normal(size=(count, 3))), rng, **settings)

    def predict(self, new_R_old: np.ndarray, translation: ArrayLike | None = None) -> ParticleFilter:
        rng = copy.deepcopy(self.rng)
        turned = self.particles @ check_rotation(new_R_old).T
        return replace(self, particles=unit(turned + rng.normal(0.0, self.roughening, turned.shape)), rng=rng)

    def update(self, evidence: Evidence) -> ParticleFilter:
        rng, count = copy.deepcopy(self.rng), len(self.particles)
        log_ratio = maps.log_ratio(evidence, self.calibration, self.particles)
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
        return maps.log_density(self._log_map, directions)

    @lazy
    def _log_map(self) -> np.ndarray:
        """Log density of the smoothed particles on `GRID`; a share as large as `reborn` is uniform."""
        x, y, _ = GRID.project(self.particles)
        cell = np.clip(y.astype(np.intp), 0, GRID.height - 1) * GRID.width + x.astype(np.intp) % GRID.width
        counts = np.bincount(cell, minlength=GRID.height * GRID.width).reshape(GRID.shape)
        density = maps.spread(counts / len(self.particles) / GRID.weights, self.kernel)
        return maps.log_mixed(density, max(self.reborn, 1 / len(self.particles)))


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


def _drawn(evidence: Evidence, count: int, rng: np.random.Generator) -> np.ndarray:
    """`count` directions drawn from the response as a density, or uniformly on the sphere if it is zero."""
    response = maps.seen_response(evidence)
    if response.max() < SILENT:
        return unit(rng.normal(size=(count, 3)))
    share = (response * evidence.grid.weights).reshape(-1)
    row, column = np.divmod(rng.choice(share.size, size=count, p=share / share.sum()), response.shape[1])
    return evidence.grid.unproject(column + rng.random(count), row + rng.random(count))
