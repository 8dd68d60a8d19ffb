"""A prior from floors: things stand on them, so the camera's height relates direction and range."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from eagor.belief.ranged import RangedBelief, log_shares
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid

# Heights (metres) of the middles of things above the floor: furniture about half a metre, things on walls or on
# furniture up to two.
MIDDLE, SPREAD = 0.7, 0.5
ODD = 0.02  # share of things at any height


def height_prior(
    degree: int, ranges: np.ndarray, camera: float, middle: float = MIDDLE, spread: float = SPREAD
) -> np.ndarray:
    """The prior that things stand on a floor: ``(K, (degree + 1)^2)`` for `RangedBelief`, z up.

    A thing at range r and elevation e is at the height `camera` + r sin(e) above the floor (metres). Heights are
    normally distributed about `middle`, or with probability `ODD` uniform. The prior is a log ratio against a uniform
    one in direction and log range; its mean likelihood is 1.
    """
    grid, ranges = decoding_grid(degree), np.asarray(ranges, dtype=np.float64)
    likely = likely_height(camera + ranges[:, None, None] * grid.directions[..., 2], middle, spread)
    mean = np.sum(log_shares(ranges)[:, None, None] * likely * grid.weights) / (4 * math.pi)
    return RealHarmonics(degree).analyse(np.log(likely / mean), grid)


def likely_height(height: np.ndarray, middle: float = MIDDLE, spread: float = SPREAD) -> np.ndarray:
    """Density of things at these heights (metres above the floor), over its maximum."""
    return ODD + (1 - ODD) * np.exp(-0.5 * ((height - middle) / spread) ** 2)


@lru_cache(maxsize=64)
def height_level(degree: int, ranges: tuple[float, ...], camera: float) -> float:
    """log of the mean of `likely_height` over all directions and ranges."""
    grid, shells = decoding_grid(degree), np.array(ranges)
    likely = likely_height(camera + shells[:, None, None] * grid.directions[..., 2])
    return math.log(float(np.sum(log_shares(shells)[:, None, None] * likely * grid.weights)) / (4 * math.pi))


def with_heights(belief: RangedBelief, camera: float | None) -> RangedBelief:
    """The same belief with the prior of a camera at this height (metres above the floor; None: unknown)."""
    if camera is None:
        return belief if belief.prior is None else replace(belief, prior=None)
    return replace(belief, prior=_prior(belief.degree, tuple(belief.ranges.tolist()), camera))


def log_heights(belief: RangedBelief, camera: float, rise: np.ndarray) -> np.ndarray:
    """The prior ``(...)`` at points `rise` metres above the camera, not truncated."""
    level = height_level(belief.degree, tuple(belief.ranges.tolist()), camera)
    return np.log(likely_height(camera + rise)) - level


@lru_cache(maxsize=64)
def _prior(degree: int, ranges: tuple[float, ...], camera: float) -> np.ndarray:
    found = height_prior(degree, np.array(ranges), camera)
    found.setflags(write=False)
    return found
