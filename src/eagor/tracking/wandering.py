"""A target that wanders: a random walk on the sphere, one density for each pace.

A density on a grid is diffused exactly, by one product: the heat kernel multiplies the coefficients of degree l by
exp(-l (l + 1) sigma^2 / 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid
from eagor.tracking.motion import MotionModel

FAINTEST = 1e-12  # of a mean density: lower values are ringing of the truncated series


@dataclass(frozen=True, eq=False)
class Wandering:
    """The belief about a wandering target: `densities` ``(M, H, W)`` over a uniform one, on `grid`; world axes."""

    grid: ErpGrid
    densities: np.ndarray

    @classmethod
    def prior(cls, motion: MotionModel, degree: int) -> Wandering:
        """Before any look."""
        grid = decoding_grid(degree)
        return cls(grid, np.ones((len(motion.wander), *grid.shape)))

    def __len__(self) -> int:
        return len(self.densities)

    def mixed(self, weights: np.ndarray) -> np.ndarray:
        """The sum of the densities with `weights` ``(M,)``: ``(H, W)``."""
        return (weights @ self.densities.reshape(len(self), self.grid.height * self.grid.width)).reshape(
            self.grid.shape
        )

    def after(
        self, elapsed: float, motion: MotionModel, drift: float, flows: np.ndarray, stands: np.ndarray | float
    ) -> Wandering:
        """After `elapsed` seconds, with the inflow from the other cases.

        `flows`: probabilities of the transitions between the cases; `stands`: density of the standing target ``(H,
        W)``; `drift`: of the odometry.
        """
        grid = self.grid
        if not len(self):
            return self
        basis = RealHarmonics(grid.height // 2 - 1)  # the grid's: a density is narrower than its logarithm
        jumped = motion.jumped(elapsed)
        sigmas = np.hypot(motion.wander, drift) * math.sqrt(elapsed)
        spread = basis.synthesise(basis.smooth(basis.analyse(self.densities, grid), sigmas[:, None]), grid)
        roamed = (1 - jumped) * np.maximum(spread, FAINTEST) + jumped
        wander = slice(2, 2 + len(sigmas))
        born, begun, kept = (flow[wander, None, None] for flow in (flows[0], flows[1], np.diagonal(flows)))
        mixed = kept * roamed + begun * stands + born
        means = np.einsum("mij,ij->m", mixed, grid.weights) / (4 * math.pi)
        return replace(self, densities=mixed / means[:, None, None])

    def updated(self, ratio: np.ndarray, new: np.ndarray) -> tuple[Wandering, np.ndarray]:
        """After one more look of this likelihood `ratio` ``(H, W)``, and its logarithm for each pace ``(M,)``.

        `new` ``(H, W)``: the part of the ratio that does not repeat the look before.
        """
        if not len(self):
            return self, np.zeros(0)
        shares = self.grid.weights / (4 * math.pi)
        gains = np.log(np.einsum("mij,ij->m", self.densities, new * shares))
        densities = self.densities * ratio
        densities /= np.einsum("mij,ij->m", densities, shares)[:, None, None]
        return replace(self, densities=densities), gains
