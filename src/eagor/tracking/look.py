"""A look as a tracker uses it: all evidence of one moment, in world axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor._arrays import to_numpy
from eagor._lazy import lazy
from eagor.belief.field import SphereField
from eagor.evidence import Evidence
from eagor.evidence.detections import Detections, resolved
from eagor.evidence.detector import STATED, Rates, Spread
from eagor.evidence.repeating import Repeating
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid, neighbours, refine

SIGHTINGS = 4  # of a response map


@dataclass(frozen=True, eq=False)
class Sight:
    """All evidence of one moment, in world axes, before the detector's rates are applied.

    Views of one moment are one look, in any order: response maps add, detections form one set.
    """

    stamp: float
    position: np.ndarray | None
    world_R_body: np.ndarray
    degree: int
    detections: Detections | None
    mapped: np.ndarray | None  # coefficients of the response maps
    repeating: Repeating
    bias: float  # radians: the part of its angular error that an immediate next look repeats

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
        most = max((look.repeating for look in looks), key=lambda found: (found.share, found.left(1.0, 1.0)))
        bias = max(look.bias for look in looks)
        return cls(stamp, position, world_R_body, degree, joint, mapped, most, bias)

    @property
    def tells(self) -> bool:
        """Whether it speaks for any direction: an empty set of detections does not."""
        return self.mapped is not None or (self.detections is not None and len(self.detections) > 0)

    def read(self, rates: Rates | None, spread: Spread = STATED) -> Look:
        """The look as log ratios, for a standing target; `rates` and `spread` are the detector's before this look."""
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
            if not self.detections.views or len(spread.scales) > 1:
                by_scale = world.ratios_by(spread.scales, grid.directions, given, share, resolved(self.degree))
            if self.detections.views:
                found = basis.rotate(self.detections.coefficients(self.degree, given, spread), self.world_R_body)
                values = values + basis.synthesise(found, grid)
            else:
                drawn = np.log(np.tensordot(spread.weights, by_scale, axes=1))  # type: ignore[arg-type]
                values, found = values + drawn, basis.analyse(drawn, grid)
            coefficients = found if coefficients is None else coefficients + found
        assert coefficients is not None
        return Look(self, values, coefficients, world, given, spread, by_scale)


@dataclass(frozen=True, eq=False)
class Sightings:
    """A likelihood ratio as a sum: a background, and a Gaussian about each detection.

    `directions` ``(n, 3)``; `amplitudes` ``(n,)``: their integrals over the sphere; `covariances` ``(n, 3, 3)``.
    `beside`: the background. `scaled` ``(S, n, 3, 3)``: the covariances at each scale of the spread.
    """

    directions: np.ndarray
    amplitudes: np.ndarray
    covariances: np.ndarray
    beside: SphereField
    scaled: np.ndarray

    def missed(self, where: np.ndarray) -> np.ndarray:
        """The background ``(n,)`` at directions ``(n, 3)``."""
        return self.beside.smooth(where, 1) if len(where) else np.zeros(0)

    @lazy
    def mean_missed(self) -> float:
        """The mean of the background over the sphere."""
        return float(np.sum(self.beside.values * self.beside.grid.weights)) / (4 * np.pi)


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
    def moving(self) -> np.ndarray:
        """`values` for a moving target."""
        if self.by_scale is None or len(self.by_scale) == 1:
            return self.values
        weights = np.stack([self.spread.otherwise, self.spread.weights])
        logs = np.log(np.tensordot(weights, self.by_scale, axes=1))
        return self.values + logs[0] - logs[1]

    @lazy
    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` of the strongest detections, and the larger standard deviation ``(n,)`` of each."""
        if self.world is None or not len(self.world):
            return np.zeros((0, 3)), np.zeros(0)
        order = np.argsort(-self.world.ratios, kind="stable")[:8]
        widths = 1 / np.linalg.norm(self.world.axes[order], axis=-1).min(axis=-1)
        return self.world.directions[order], widths

    @lazy
    def sightings(self) -> Sightings:
        """The look as a sum of Gaussians: its detections, or the peaks of its response map."""
        grid = decoding_grid(self.sight.degree)
        if self.world is None or self.rates is None:
            return self._peaks()
        share = self.world.share(grid.directions @ self.sight.world_R_body) if self.world.views else 1.0
        beside = np.broadcast_to(1 - np.asarray(share) * self.rates.recall, grid.shape)
        amplitudes = self.rates.gain * self.world.area * self.world.ratios / self.world.clutter
        scales = self.spread.scales if len(self.spread.scales) > 1 else self.spread.scales[:0]
        scales = np.array([self.spread.precision**-0.5, *scales])[:, None, None]
        lengths = np.linalg.norm(self.world.axes, axis=-1)
        widths = scales / lengths
        deviations = self.world.axes * (widths / lengths)[..., None]
        covariances = np.einsum("snai,snaj->snij", deviations, deviations)
        return Sightings(self.world.directions, amplitudes, covariances[0], SphereField(grid, beside), covariances[1:])

    def _peaks(self) -> Sightings:
        """The peaks of the response map with positive log ratio."""
        grid = decoding_grid(self.sight.degree)
        left, flat = self.values.reshape(-1).copy(), self.values.reshape(-1)
        found: list[tuple[np.ndarray, float, float]] = []
        while len(found) < SIGHTINGS and left[best := int(left.argmax())] > 0:
            centre, width = refine(grid, flat, best)
            if flat[neighbours(grid, best)].max() <= flat[best] and np.isfinite(width):
                found.append((centre, min(width, 1.0), float(np.expm1(min(flat[best], 50.0)))))
            near = grid.directions.reshape(-1, 3) @ centre > np.cos(
                min(max(2 * width, resolved(self.sight.degree)), 1.0)
            )
            left[near] = -np.inf
            left[best] = -np.inf
        directions = np.array([centre for centre, _, _ in found]).reshape(-1, 3)
        widths = np.array([width for _, width, _ in found])
        heights = np.array([height for _, _, height in found])
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        beside = SphereField(grid, np.exp(np.minimum(self.values, 0.0)))
        covariances = across * (widths**2)[:, None, None]
        return Sightings(directions, heights * 2 * np.pi * widths**2, covariances, beside, covariances[None][:0])

    def at(self, directions: np.ndarray, least: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """Log ratios ``(S, ...)`` at directions ``(..., 3)``; detections are widened to `least` ``(n,)`` radians.

        `scales` ``(S,)``: factors on the detections' stated spread.
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
