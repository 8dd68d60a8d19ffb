"""A look as a tracker uses it: evidence of one moment, turned into the axes of the odometry's world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor._arrays import to_numpy
from eagor._lazy import lazy
from eagor.detection_set import Detections, resolved
from eagor.detector import STATED, Rates, Spread
from eagor.evidence import Evidence
from eagor.harmonics import RealHarmonics
from eagor.peaks import decoding_grid


@dataclass(frozen=True, eq=False)
class Sight:
    """All evidence of one moment, in the axes of the world, before anybody says how the detector errs there.

    Views of one moment are one look, whatever their order: response maps add, detections are one set.
    """

    stamp: float
    position: np.ndarray | None
    world_R_body: np.ndarray
    degree: int
    detections: Detections | None
    mapped: np.ndarray | None  # coefficients of the response maps
    repeats: float
    bias: float  # radians: the part of the error of its directions that the next look repeats

    @classmethod
    def of(
        cls, looks: Sequence[Evidence], degree: int, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None
    ) -> Sight:
        """The looks of one moment, seen from `position` with this orientation."""
        joint: Detections | None = None
        mapped: np.ndarray | None = None
        for look in looks:
            if look.detections is not None:
                joint = look.detections if joint is None else joint.joined(look.detections)
            else:
                found = to_numpy(look.coefficients(degree)).astype(np.float64)
                mapped = found if mapped is None else mapped + found
        if mapped is not None:
            mapped = RealHarmonics(degree).rotate(mapped, world_R_body)
        repeats, bias = max(look.repeats for look in looks), max(look.bias for look in looks)
        return cls(stamp, position, world_R_body, degree, joint, mapped, repeats, bias)

    def read(self, rates: Rates | None, spread: Spread = STATED) -> Look:
        """The look as log ratios; `rates` and `spread` of the detector, from before this look."""
        grid, basis = decoding_grid(self.degree), RealHarmonics(self.degree)
        values = np.zeros(grid.shape) if self.mapped is None else basis.synthesise(self.mapped, grid)
        given, world, by_scale = None, None, None
        coefficients = self.mapped
        if self.detections is not None:
            before = Rates.prior(self.detections.model) if rates is None else rates
            given = before.given(len(self.detections))
            world = self.detections.turned(self.world_R_body)
            share: np.ndarray | float = 1.0
            if self.detections.views:
                share = world.share(grid.directions @ self.world_R_body)
            by_scale = world.ratios_by(spread.scales, grid.directions, given, share, resolved(self.degree))
            if self.detections.views:
                found = basis.rotate(self.detections.coefficients(self.degree, given, spread), self.world_R_body)
                values = values + basis.synthesise(found, grid)
            else:
                drawn = np.log(np.tensordot(spread.weights, by_scale, axes=1))
                values, found = values + drawn, basis.analyse(drawn, grid)
            coefficients = found if coefficients is None else coefficients + found
        assert coefficients is not None
        return Look(self, values, coefficients, world, given, spread, by_scale)


@dataclass(frozen=True, eq=False)
class Look:
    """Log ratios of a `Sight`: `values` ``(H, W)`` on the decoding grid and `coefficients` ``(size,)``, world axes.

    `by_scale` ``(S, H, W)``: ratios of the detections for each scale of their `spread`.
    """

    sight: Sight
    values: np.ndarray
    coefficients: np.ndarray
    world: Detections | None
    rates: Rates | None
    spread: Spread
    by_scale: np.ndarray | None

    @lazy
    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` of the detections that say most, and the larger standard deviation ``(n,)`` of each."""
        if self.world is None or not len(self.world):
            return np.zeros((0, 3)), np.zeros(0)
        order = np.argsort(-self.world.ratios, kind="stable")[:8]
        widths = 1 / np.linalg.norm(self.world.axes[order], axis=-1).min(axis=-1)
        return self.world.directions[order], widths

    def at(self, directions: np.ndarray, least: float, scales: np.ndarray) -> np.ndarray:
        """Log ratios ``(S, ...)`` at directions ``(..., 3)``, nothing narrower than `least` radians.

        `scales` ``(S,)``: how many times as wide as their model says detections are taken to be.
        """
        found = np.zeros((len(scales), *directions.shape[:-1]))
        if self.sight.mapped is not None:
            found += RealHarmonics(self.sight.degree).synthesise(self.sight.mapped, directions)
        if self.world is not None:
            share: np.ndarray | float = 1.0
            if self.world.views:
                share = self.world.share(directions @ self.sight.world_R_body)
            found += np.log(self.world.ratios_by(scales, directions, self.rates, share, least))
        return found
