"""The yardstick of `ideal.py`: what a contestant must do, and exact Bayes, which approximates nothing but integrals.

- `StillOrKnown`: directions on HEALPix. The density at a direction is the product of the exact likelihoods there; only
  its normaliser is a sum over cells. A constant turn is undone in the poses, a jump mixes in a uniform density; a
  random walk is a heat kernel in harmonics (there the density between cells is interpolated).
- `Walked`: places in space, in cells of direction and log range about the start of the walk, which are split in eight
  where the mass gathers. The density of a direction is a line integral of the exact posterior from the camera onwards.
- `Assigned`: which detections are of the target, which of each look-alike, which of nothing that lasts, where each of
  these has its own habit. Habits and places are integrated out in closed form; only the list of assignments is cut.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import healpy
import numpy as np
from ideal_worlds import ALIKE_HABIT, ALIKES, HABIT, STEP, Detector, Motion, near
from scipy.special import betaln, logsumexp, softmax

from eagor.sphere import unit

PRIOR_RANGE = (0.5, 12.0)  # metres about the start: direction uniform, log range uniform
NEAR = math.radians(15)
UNIFORM = -math.log(4 * math.pi)


class Contestant:
    """What a filter must do. Directions are in the body frame of the last look, densities per steradian.

    `direction`: the answer, about where the density is highest; `distance`: metres, of worlds with positions; `word`:
    what the filter says of its answer, where it does.
    """

    direction: np.ndarray | None = None
    distance: float | None = None
    word: str | None = None
    pose: np.ndarray
    heights: np.ndarray  # of `at`, at directions drawn from the density

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        """Predict to this look and update with it, and work out the answer: all that is timed."""
        raise NotImplementedError

    def at(self, points: np.ndarray) -> np.ndarray:
        """Log density at world directions ``(n, 3)``."""
        raise NotImplementedError

    def log_density(self, direction: np.ndarray) -> float:
        return float(self.at((self.pose @ direction)[None])[0])

    def mass_above(self, direction: np.ndarray) -> float:
        """Mass of the smallest region of highest density that reaches `direction`."""
        return float(np.mean(self.heights > self.log_density(direction)))

    def claim(self) -> tuple[float, float]:
        """Probability that it is there at all (0.5 before any look), and within 15 degrees of the answer if it is."""
        return math.nan, math.nan


def search_top(log_density: Any, start: np.ndarray, width: float) -> np.ndarray:
    """The highest direction about `start` ``(3,)``: a grid of 7 x 7 tangents `width` radians to each side, shrunk."""
    side = unit(np.cross(start, np.eye(3)[np.abs(start).argmin()]))
    axes = np.stack([side, np.cross(start, side)])
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 7)] * 2), axis=-1).reshape(-1, 2)
    centre = np.zeros(2)
    while width > math.radians(0.02):
        tried = centre + width * steps
        centre = tried[log_density(unit(start + tried @ axes)).argmax()]
        width /= 2.5
    return unit(start + centre @ axes)


# ---------- exact: directions


@cache
def cells(nside: int) -> np.ndarray:
    """Centres of the HEALPix cells ``(12 nside^2, 3)``."""
    return np.stack(healpy.pix2vec(nside, np.arange(healpy.nside2npix(nside))), axis=-1)


class StillOrKnown(Contestant):
    """Bayes on the sphere for a target that stands, or whose `motion` is known; the frame moves with a known turn."""

    def __init__(self, detector: Detector, motion: Motion | None = None, nside: int = 64) -> None:
        self.detector, self.motion, self.nside = detector, motion or Motion(), nside
        self.points = cells(nside)
        self.ratio = np.ones(len(self.points))  # density over that of the uniform one
        self.predicted = self.ratio
        self.looks: list[tuple[np.ndarray, float]] = []  # detections, and what they were worth
        self.pose = np.eye(3)

    @property
    def stay(self) -> float:
        return math.exp(-self.motion.jumps * STEP)

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        if self.looks:
            self.ratio = self._predict(self.ratio)
        self.predicted = self.ratio
        self.pose = self.motion.turned(time).T @ pose
        found = detections @ self.pose.T
        likelihood = self.detector.likelihood(self.points, found)
        worth = float(np.mean(likelihood * self.ratio))
        self.ratio = likelihood * self.ratio / worth
        self.looks.append((found, worth))
        if any(len(seen) for seen, _ in self.looks):
            top = search_top(self.at, self.points[self.ratio.argmax()], 1 / self.nside)
            self.direction = top @ self.pose

    def _predict(self, ratio: np.ndarray) -> np.ndarray:
        if self.motion.diffusion:
            lmax = 2 * self.nside
            alm = healpy.map2alm(ratio, lmax=lmax, iter=1)
            l = np.arange(lmax + 1)
            kernel = np.exp(-l * (l + 1) * self.motion.diffusion**2 * STEP / 2)
            ratio = healpy.alm2map(healpy.almxfl(alm, kernel), self.nside, lmax=lmax)
            return np.maximum(ratio, 1e-9)
        return self.stay * ratio + 1 - self.stay

    def at(self, points: np.ndarray) -> np.ndarray:
        """Log of density over uniform density at points ``(n, 3)`` of the frame, not only at the cells."""
        if self.motion.diffusion:
            before = healpy.get_interp_val(np.log(self.predicted), *healpy.vec2ang(points))
            found, worth = self.looks[-1]
            return before + np.log(self.detector.likelihood(points, found) / worth)
        ratio = np.ones(len(points))
        for index, (found, worth) in enumerate(self.looks):
            before = self.stay * ratio + 1 - self.stay if index else ratio
            ratio = before * self.detector.likelihood(points, found) / worth
        return np.log(np.maximum(ratio, 1e-300))

    def log_density(self, direction: np.ndarray) -> float:
        return UNIFORM + float(self.at((self.pose @ direction)[None])[0])

    def mass_above(self, direction: np.ndarray) -> float:
        level = math.exp(self.log_density(direction) - UNIFORM)
        return float(self.ratio[self.ratio > level].sum() / len(self.ratio))

    def claim(self) -> tuple[float, float]:
        odds = math.prod(worth for _, worth in self.looks)
        if self.direction is None:
            return odds / (1 + odds), math.nan
        near = self.points @ (self.pose @ self.direction) > math.cos(NEAR)
        return odds / (1 + odds), float(self.ratio[near].sum() / len(self.ratio))


# ---------- exact: places


class Walked(Contestant):
    """Bayes over places for a target that stands while the camera walks; the prior is `PRIOR_RANGE` about the start.

    `most`: no cell holds more of the mass than this; `rays`: points along a line; `drawn`: directions at which regions
    of highest density are measured. Twice the resolution changes the log density by less than 0.01 nats.
    """

    def __init__(self, detector: Detector, most: float = 5e-4, rays: int = 128, drawn: int = 256) -> None:
        self.detector, self.most, self.rays, self.drawn = detector, most, rays, drawn
        self.span = math.log(PRIOR_RANGE[1] / PRIOR_RANGE[0])
        side, shells = 16, 24
        pixel, shell = np.meshgrid(np.arange(healpy.nside2npix(side)), np.arange(shells), indexing="ij")
        self.level = np.zeros(pixel.size, dtype=int)  # times that it was split
        self.pixel, self.shell = pixel.ravel(), shell.ravel()
        self.places = self._centres(self.level, self.pixel, self.shell)
        self.log_mass = np.full(pixel.size, -math.log(pixel.size))  # of the prior; then of prior and looks, not summed
        self.looks: list[tuple[np.ndarray, np.ndarray]] = []  # from where, detections in world axes
        self.pose = np.eye(3)
        self.start = np.zeros(3)

    def _centres(self, level: np.ndarray, pixel: np.ndarray, shell: np.ndarray) -> np.ndarray:
        directions = np.stack(healpy.pix2vec(16 << level, pixel, nest=True), axis=-1)
        return directions * (PRIOR_RANGE[0] * np.exp((shell + 0.5) / (24 << level) * self.span))[:, None]

    def _log_likelihood(self, places: np.ndarray, looks: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        total = np.zeros(places.shape[:-1])
        for position, detections in looks:
            if len(detections):
                total += np.log(self.detector.likelihood(unit(places - position), detections))
            else:
                total += math.log(1 - self.detector.detection)
        return total

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        assert position is not None
        if not self.looks:
            self.start = position
        self.pose = pose
        self.looks.append((position - self.start, detections @ pose.T))
        self.log_mass += self._log_likelihood(self.places, self.looks[-1:])
        self._split()
        weight = self.weight
        offsets = self.places - self.looks[-1][0]
        far = np.log(np.linalg.norm(offsets, axis=1))
        held = far[weight > 1e-9]
        self.reach = np.linspace(held.min() - 0.2, held.max() + 0.2, self.rays)
        if not any(len(seen) for _, seen in self.looks):
            return
        order = np.argsort(far)
        self.distance = math.exp(far[order][np.searchsorted(np.cumsum(weight[order]), 0.5)])
        ranks = np.searchsorted(np.cumsum(weight), (np.arange(self.drawn) + 0.5) / self.drawn)
        self.directions = unit(offsets[ranks])
        self.heights = self.at(self.directions)
        top = self.directions[self.heights.argmax()]
        spread = math.sqrt(float(np.median(1 - self.directions @ top)) + 1e-6)
        self.direction = search_top(self.at, top, min(spread, 0.1)) @ pose

    def _split(self) -> None:
        """Split cells until none holds too much; what is new is measured by all looks so far."""
        while True:
            heavy = np.flatnonzero(self.weight > self.most)
            if not len(heavy):
                return
            keep = np.setdiff1d(np.arange(len(self.level)), heavy)
            level = np.repeat(self.level[heavy] + 1, 8)
            pixel = (4 * self.pixel[heavy][:, None, None] + np.arange(4)[:, None] + np.zeros(2, int)).ravel()
            shell = (2 * self.shell[heavy][:, None, None] + np.zeros(4, int)[:, None] + np.arange(2)).ravel()
            places = self._centres(level, pixel, shell)
            mass = self._log_likelihood(places, self.looks) - math.log(12 * 16**2 * 24) - level * math.log(8)
            for name, new in (("level", level), ("pixel", pixel), ("shell", shell), ("places", places)):
                setattr(self, name, np.concatenate([getattr(self, name)[keep], new]))
            self.log_mass = np.concatenate([self.log_mass[keep], mass])

    @property
    def log_total(self) -> float:
        return float(logsumexp(self.log_mass))

    @property
    def weight(self) -> np.ndarray:
        return softmax(self.log_mass)

    def at(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian at world directions ``(n, 3)`` from where the camera is now."""
        places = self.looks[-1][0] + np.exp(self.reach)[:, None] * directions[:, None, :]
        radius = np.linalg.norm(places, axis=-1)
        inside = (radius >= PRIOR_RANGE[0]) & (radius <= PRIOR_RANGE[1])
        value = np.full(radius.shape, -np.inf)
        value[inside] = self._log_likelihood(places[inside], self.looks)
        value += 3 * (self.reach - np.log(radius)) - math.log(4 * math.pi * self.span) - self.log_total
        top = np.maximum(value.max(axis=1), -700.0)
        step = self.reach[1] - self.reach[0]
        return top + np.log(np.exp(value - top[:, None]).sum(axis=1) * step + 1e-300)

    def claim(self) -> tuple[float, float]:
        odds = math.exp(self.log_total)
        return odds / (1 + odds), math.nan


# ---------- exact: habits


class Assigned(Contestant):
    """Bayes for the world `habits`: a Poisson multi-Bernoulli mixture of things that stand.

    (García-Fernández, Williams, Granström and Svensson, IEEE Transactions on Aerospace and Electronic Systems 54(4),
    2018.) A hypothesis parts all detections of T looks into the target's (perhaps none) and groups, with at most one of
    each look in a group; a group of several is a look-alike, one alone a look-alike or nothing that lasts. Against
    "none lasts", n detections with the sum s of their directions have the likelihood

        h(n) J,   h(n) = B(a + n, b + T - n) / B(a, b),   J = mean over the sphere of prod_i g(z_i | x) / lambda,

    for a habit of Beta(a, b); J is known in closed form, and where the thing is has density ~ exp(kappa s.x).
    Look-alikes that were never detected change nothing. All of it is exact, wherever things lie, but that only the
    `most` likeliest hypotheses are kept, and none below exp(-`depth`) of the best. Regions of highest density are
    measured at `drawn` directions.
    """

    def __init__(self, detector: Detector, most: int = 2000, depth: float = 14.0, drawn: int = 512) -> None:
        self.detector, self.most, self.depth, self.drawn = detector, most, depth, drawn
        # Of each hypothesis and group, the first of which is the target's: number and sum of the detections.
        self.counts, self.sums = np.zeros((1, 1), dtype=int), np.zeros((1, 1, 3))
        self.looks = 0
        self.any = False
        self.rng = np.random.default_rng(29)

    def _log_places(self, counts: np.ndarray, sums: np.ndarray) -> np.ndarray:
        """log J."""
        kappa = self.detector.concentration
        height = math.log(2 * kappa / (-math.expm1(-2 * kappa) * self.detector.alarms))
        length = kappa * np.maximum(np.linalg.norm(sums, axis=-1), 1e-9)
        # The closed form: (height exp(-kappa))^n sinh(kappa |s|) / (kappa |s|).
        return counts * (height - kappa) + length + np.log(-np.expm1(-2 * length) / (2 * length))

    def _log_groups(self, counts: np.ndarray, sums: np.ndarray) -> np.ndarray:
        """The log likelihood of each group, after so many looks."""
        many = np.arange(self.looks + 1)
        own, other = (betaln(a + many, b + self.looks - many) - betaln(a, b) for a, b in (HABIT, ALIKE_HABIT))
        other += math.log(ALIKES)
        alone = np.log1p(np.exp(other[1]) / self.detector.alarms)
        places = self._log_places(counts, sums)
        counts = np.minimum(counts, self.looks)
        found = np.where(counts > 1, other[counts] + places, np.where(counts == 1, alone, 0.0))
        found[:, 0] = own[counts[:, 0]] + places[:, 0]
        self.absent = -own[0]  # log of how much likelier nothing detected of the target is if it is absent
        return found

    def look(self, time: float, pose: np.ndarray, position: np.ndarray | None, detections: np.ndarray) -> None:
        self.looks += 1
        self.pose = pose
        self.logs = self._log_groups(self.counts, self.sums).sum(axis=1)
        used = np.zeros(self.counts.shape, dtype=bool)
        for detection in detections @ pose.T:
            used = self._assign(detection, used)
        self.any |= len(detections) > 0
        self._answer()

    def _assign(self, detection: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Part one more detection, in all ways that count; `used`: groups that have one of this look already."""
        self.counts = np.pad(self.counts, ((0, 0), (0, 1)))
        self.sums = np.pad(self.sums, ((0, 0), (0, 1), (0, 0)))
        used = np.pad(used, ((0, 0), (0, 1)))
        more = self._log_groups(self.counts + 1, self.sums + detection) - self._log_groups(self.counts, self.sums)
        free = (self.counts > 0) & ~used
        free[:, 0] = ~used[:, 0]
        free[:, -1] = True
        logs = np.where(free, self.logs[:, None] + more, -np.inf)
        worth = logs.copy()  # where the target has none, a hypothesis stands for its absence too
        worth[:, 1:] += np.where(self.counts[:, :1] == 0, np.logaddexp(0.0, self.absent), 0.0)
        best = np.flatnonzero(worth.ravel() > worth.max() - self.depth)
        if len(best) > self.most:
            best = best[np.argpartition(-worth.ravel()[best], self.most)[: self.most]]
        which, group = np.unravel_index(best, logs.shape)
        self.counts, self.sums, self.logs, used = self.counts[which], self.sums[which], logs[which, group], used[which]
        rows = np.arange(len(which))
        self.counts[rows, group] += 1
        self.sums[rows, group] += detection
        used[rows, group] = True
        return used

    def _answer(self) -> None:
        """The mixture over directions: one part for each set of detections that may be the target's."""
        weights = softmax(self.logs)
        none = self.counts[:, 0] == 0
        self.unseen = float(weights[none].sum())
        self.presence = 1 / (1 + self.unseen * math.exp(self.absent))
        sums, index = np.unique(self.sums[~none, 0].round(9), axis=0, return_inverse=True)
        self.shares = np.bincount(index.ravel(), weights[~none], minlength=len(sums))
        lengths = np.linalg.norm(sums, axis=1)
        self.centres, self.kappas = sums / np.maximum(lengths, 1e-9)[:, None], self.detector.concentration * lengths
        if self.any:
            ranks = np.searchsorted(np.cumsum(self.shares), (np.arange(self.drawn) + 0.5) / self.drawn)
            seen = ranks[ranks < len(sums)]
            elsewhere = unit(self.rng.normal(size=(self.drawn - len(seen), 3)))
            self.points = np.concatenate([near(self.centres[seen], self.kappas[seen], self.rng), elsewhere])
            self.heights = self.at(self.points)
            likely = self.centres[np.argsort(-self.shares, kind="stable")[:64]]
            self.direction = search_top(self.at, likely[self.at(likely).argmax()], 0.1) @ self.pose

    def at(self, directions: np.ndarray) -> np.ndarray:
        """Log density per steradian at world directions ``(n, 3)``."""
        tops = self.shares * self.kappas / (-2 * math.pi * np.expm1(-2 * self.kappas))
        seen = np.exp(self.kappas * (directions @ self.centres.T - 1)) @ tops
        return np.log(seen + self.unseen / (4 * math.pi))

    def claim(self) -> tuple[float, float]:
        if self.direction is None:
            return self.presence, math.nan
        return self.presence, float(np.mean(self.points @ (self.pose @ self.direction) > math.cos(NEAR)))
