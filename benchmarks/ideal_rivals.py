"""The other contestants of `ideal.py`: ours by its public calls, and PyRecEst's filters at their best."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from ideal_filters import NEAR, PRIOR_RANGE, UNIFORM, Contestant, cells
from ideal_worlds import ALIKE_HABIT, ALIKES, HABIT, Detector, Motion, near
from scipy.stats import qmc

import eagor
from eagor.sphere import unit

FLOOR = 0.002  # share of a uniform density in those of particles

# ---------- ours


def stated(detector: Detector) -> eagor.DetectorModel:
    """All of a detector whose looks are independent."""
    return replace(
        learnt(detector), detection_probability=detector.detection, false_alarms_per_look=detector.alarms, look_alikes=0
    )


def stated_habits(detector: Detector) -> eagor.DetectorModel:
    """All of a detector in the world `habits`."""
    return replace(
        learnt(detector),
        false_alarms_per_look=detector.alarms,
        look_alikes=ALIKES,
        habit=HABIT,
        look_alike_habit=ALIKE_HABIT,
        kept_for=None,
        kept_within=None,
    )


def learnt(detector: Detector) -> eagor.DetectorModel:
    """Only the spread is stated, and that no error repeats."""
    return eagor.DetectorModel(spread=math.radians(detector.spread), offset=0.0)


class Ours(Contestant):
    """What says its density and its regions itself: `said`."""

    said: eagor.Estimate | eagor.Belief

    def log_density(self, direction: np.ndarray) -> float:
        return float(self.said.log_density(direction[None])[0])

    def mass_above(self, direction: np.ndarray) -> float:
        return float(self.said.mass_above(direction))


class Tracker(Ours):
    """`DirectionTracker` by its public calls.

    `motion`: a turn that is known; poses are then given in axes that turn along.
    """

    def __init__(
        self, model: eagor.DetectorModel, config: eagor.TrackerConfig | None = None, motion: Motion | None = None
    ) -> None:
        self.model, self.motion = model, motion or Motion()
        self.tracker = eagor.DirectionTracker(replace(config or eagor.TrackerConfig(), clock_error=0.0))

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        self.tracker.add_pose(time, self.motion.turned(time).T @ pose, position)
        self.tracker.observe(eagor.Evidence.from_points(detections, detector=self.model, stamp=time))
        self.said = self.tracker.estimate(time)
        self.direction, self.word = self.said.direction, self.said.status
        self.distance = None if position is None else self.said.distance

    def claim(self) -> tuple[float, float]:
        presence = self.said.presence
        if self.direction is None:
            return presence, math.nan
        return presence, self.said.within(NEAR) / presence  # `within` counts that it may be absent


class Core(Ours):
    """`Belief` alone, turned and updated by hand."""

    def __init__(self, detector: Detector, degree: int) -> None:
        self.model = stated(detector)
        self.said = eagor.Belief.uniform(degree)
        self.pose: np.ndarray | None = None
        self.any = False

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        if self.pose is not None:
            self.said = self.said.predict(pose.T @ self.pose)
        self.pose = pose
        self.said = self.said.update(eagor.Evidence.from_points(detections, detector=self.model))
        self.any |= len(detections) > 0
        self.direction = self.said.mode() if self.any else None

    def claim(self) -> tuple[float, float]:
        return float(self.said.presence()), math.nan


# ---------- PyRecEst


class RivalGrid(Contestant):
    """PyRecEst's grid filter: density per HEALPix cell, and the mean of what lies near the highest cell as answer."""

    def __init__(self, detector: Detector, nside: int = 32) -> None:
        from pyrecest.distributions import HypersphericalGridDistribution
        from pyrecest.filters.abstract_grid_filter import AbstractGridFilter

        blank = HypersphericalGridDistribution(cells(nside), np.full(12 * nside**2, math.exp(UNIFORM)))
        self.filter = AbstractGridFilter(blank)
        self.detector = detector
        self.any = False

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        self.pose = pose
        self.filter.update_nonlinear(lambda z, grid: self.detector.likelihood(grid, z), detections @ pose.T)
        self.any |= len(detections) > 0
        if self.any:
            values, grid = self.filter.filter_state.grid_values, self.filter.filter_state.grid
            near = grid @ grid[values.argmax()] > math.cos(NEAR)
            self.direction = unit(values[near] @ grid[near]) @ pose

    def log_density(self, direction: np.ndarray) -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns that its own density is piecewise constant
            return math.log(max(float(self.filter.filter_state.pdf(self.pose @ direction)), 1e-30))

    def mass_above(self, direction: np.ndarray) -> float:
        values = self.filter.filter_state.grid_values
        return float(values[values > math.exp(self.log_density(direction))].sum() / values.sum())


class Moved:
    """The transition model that PyRecEst's `predict_model` asks for: how particles move after they were resampled.

    By `smoothing` standard deviations of all. `shrunk`: along the covariance of the particles, which are drawn to their
    mean first so that it stays as it is (Liu and West 2001); else each axis is roughened by itself (Gordon, Salmond and
    Smith 1993). `project` brings what was moved back in place.
    """

    def __init__(
        self, smoothing: float, shrunk: bool, rng: np.random.Generator, project: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        self.smoothing, self.shrunk, self.rng, self.project = smoothing, shrunk, rng, project

    def sample_next(self, particles: np.ndarray) -> np.ndarray:
        push = self.smoothing * self.rng.normal(size=particles.shape)
        if not self.shrunk:
            return self.project(particles + push * particles.std(axis=0))
        mean = particles.mean(axis=0)
        root = np.linalg.cholesky(np.cov(particles.T) + 1e-12 * np.eye(3))
        shrunk = mean + math.sqrt(1 - self.smoothing**2) * (particles - mean)
        return self.project(shrunk + push @ root.T)


class RivalParticles(Contestant):
    """PyRecEst's particle filters, drawn from the prior by a Sobol sequence, resampled when fewer than half count.

    `walks`: `EuclideanParticleFilter` over places, with the exact filter's prior; else `HypersphericalParticleFilter`
    over directions. Its density over directions is a mixture of von Mises-Fisher kernels on the bearings of its
    particles over a small uniform one. Its answer is the mean bearing of those within 15 degrees of the densest of a
    few of them.
    """

    def __init__(
        self, detector: Detector, seed: int, count: int, smoothing: float, shrunk: bool, walks: bool = False
    ) -> None:
        from pyrecest.distributions import HypersphericalDiracDistribution, LinearDiracDistribution
        from pyrecest.filters import EuclideanParticleFilter, HypersphericalParticleFilter

        self.detector, self.count, self.walks = detector, count, walks
        self.rng = np.random.default_rng((23, seed))
        np.random.seed(seed)  # noqa: NPY002 (what PyRecEst draws from)
        self.filter = EuclideanParticleFilter(count, 3) if walks else HypersphericalParticleFilter(count, 2)
        self.filter.set_resampling_criterion(lambda state: 1 / np.sum(state.w**2) < count / 2)
        self.prior: Any = LinearDiracDistribution if walks else HypersphericalDiracDistribution
        self.moved = Moved(smoothing, shrunk, self.rng, (lambda places: places) if walks else unit)
        self.resampled = self.any = False

    def _places(self) -> np.ndarray:
        z, azimuth, far = qmc.Sobol(3, rng=self.rng).random_base2(math.ceil(math.log2(self.count)))[: self.count].T
        z, azimuth = 2 * z - 1, 2 * math.pi * azimuth
        level = np.sqrt(1 - z**2)
        directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), z], axis=1)
        far = PRIOR_RANGE[0] * (PRIOR_RANGE[1] / PRIOR_RANGE[0]) ** far
        return far[:, None] * directions if self.walks else directions

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        here = np.zeros(3) if position is None else position
        if self.prior is not None:
            self.filter.filter_state, self.prior = self.prior(here + self._places()), None
        if self.resampled:
            self.filter.predict_model(self.moved)
        self.pose, found = pose, detections @ pose.T
        self.resampled = self.filter.update_nonlinear_using_likelihood(
            lambda places: self.detector.likelihood(unit(places - here), found), return_diagnostics=True
        ).resampled
        state = self.filter.filter_state
        self.weights, offsets = state.w, state.d - here
        far = np.linalg.norm(offsets, axis=1)
        self.bearings = offsets / far[:, None]
        self.any |= len(detections) > 0
        if self.any:
            self.distance = math.exp(self.weights @ np.log(far))
            few, many = self._drawn(64), self._drawn(512)
            densest = few[np.exp((few @ many.T - 1) / math.radians(5) ** 2).sum(axis=1).argmax()]
            near = self.bearings @ densest > math.cos(NEAR)
            self.top = unit(self.weights[near] @ self.bearings[near])
            self.direction = self.top @ pose
        self._kernel = None

    def _drawn(self, count: int) -> np.ndarray:
        ranks = np.searchsorted(np.cumsum(self.weights), (np.arange(count) + 0.5) / count)
        return self.bearings[np.minimum(ranks, self.count - 1)]

    @property
    def concentration(self) -> float:
        """Of the kernels: Silverman's width for two dimensions, the spread taken where half of the mass is."""
        if self._kernel is None:
            if not self.any:
                return 0.5
            away = 1 - self.bearings @ self.top
            order = np.argsort(away)
            half = away[order[np.searchsorted(np.cumsum(self.weights[order]), 0.5)]]
            spread = math.sqrt(half / math.log(2))  # of a Gaussian with half of its mass this near
            effective = 1 / np.sum(self.weights**2)
            self._kernel = max(0.5, 1 / (spread * effective ** (-1 / 6)) ** 2)
        return self._kernel

    def at(self, directions: np.ndarray) -> np.ndarray:
        kappa = self.concentration
        height = kappa / (2 * math.pi * -math.expm1(-2 * kappa))
        bumps = np.exp(kappa * (directions @ self.bearings.T - 1)) @ self.weights
        return np.log((1 - FLOOR) * height * bumps + FLOOR / (4 * math.pi))

    def mass_above(self, direction: np.ndarray) -> float:
        """At bearings drawn from the kernels themselves: their width is a part of what it believes."""
        drawn = np.array([near(centre, self.concentration, self.rng) for centre in self._drawn(128)])
        return float(np.mean(self.at(drawn) > self.log_density(direction)))
