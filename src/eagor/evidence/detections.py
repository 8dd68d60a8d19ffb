"""The set of detections of one look, and its likelihood (`eagor.evidence.detector` has the formula)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._values import altered, lazy
from eagor.evidence.coverage import Region, confine, region, taper
from eagor.evidence.detector import ClutterRate, DetectorModel
from eagor.grids import FisheyeGrid, Grid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.harmonics.peaks import decoding_grid

LEAST_RATIO = 1e-3  # of a score: no single one is a proof of absence
LOWEST = -600.0  # nats: nothing; for what underflows, the exponential and products take ten times as long
RESOLVED = math.radians(115)  # over degree + 1: the narrowest likelihood that the degree represents without loss


@dataclass(frozen=True, eq=False)
class View:
    """What one picture covered: a grid in the body frame, and the coverage of its cells (None: full)."""

    grid: Grid
    coverage: np.ndarray | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it covers the whole sphere."""
        around = not isinstance(self.grid, PerspectiveGrid | FisheyeGrid)
        if isinstance(self.grid, FisheyeGrid):
            around = self.grid.depth_inside() is None
        return around and self.coverage is None

    def share(self, directions: np.ndarray) -> np.ndarray:
        """v ``(...)`` in [0, 1] at directions ``(..., 3)`` of the body frame."""
        x, y, inside = self.grid.project(directions)
        share = inside.astype(np.float64)
        if self.coverage is not None:
            height, width = self.grid.shape
            column, row = np.where(inside, x, 0.0).astype(int), np.where(inside, y, 0.0).astype(int)
            share *= self.coverage[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
        return share


@dataclass(frozen=True, eq=False)
class Detections:
    """The set Z of one look, body frame at capture: n detections in what its `views` covered.

    `directions` ``(n, 3)``, with `scores` ``(n,)``. `axes` ``(n, 2, 3)``: its principal axes, each divided by the
    standard deviation along it (radians). `ratios` ``(n,)``: s. `clutter` ``(n,)``: relative density of
    false alarms there. `sizes` ``(n,)``: half the angular size of each, radians; 0 for points. `views`: empty where the
    whole sphere was looked at. `scored`: whether the detector told scores; else they are 1.
    """

    model: DetectorModel
    directions: np.ndarray
    axes: np.ndarray
    ratios: np.ndarray
    clutter: np.ndarray
    scores: np.ndarray
    sizes: np.ndarray
    views: tuple[View, ...] = ()
    scored: bool = True

    @classmethod
    def around(
        cls,
        model: DetectorModel,
        directions: np.ndarray,
        axes: np.ndarray,
        scores: np.ndarray | None,
        view: View,
        sizes: np.ndarray | None = None,
    ) -> Detections:
        """The set of one picture."""
        count = len(directions)
        ratios, clutter = model.ratios(scores, count), model.clutter_at(directions)
        each, sizes = np.ones(count) if scores is None else scores, np.zeros(count) if sizes is None else sizes
        views = () if view.is_whole else (view,)
        return cls(model, directions, axes, ratios, clutter, each, sizes, views, scores is not None)

    def __len__(self) -> int:
        return len(self.directions)

    def __repr__(self) -> str:
        views = f"{len(self.views)} view{'' if len(self.views) == 1 else 's'}" if self.views else "a whole look"
        return f"Detections({len(self)} in {views})"

    def joined(self, other: Detections) -> Detections:
        """The joint set of two pictures of the same moment."""
        views = () if not self.views or not other.views else (*self.views, *other.views)
        pairs = {
            key: np.concatenate([getattr(self, key), getattr(other, key)])
            for key in ("directions", "axes", "ratios", "clutter", "scores", "sizes")
        }
        return altered(self, views=views, scored=self.scored or other.scored, **pairs)

    def turned(self, new_R_old: np.ndarray) -> Detections:
        """The detections in other axes; `share` still takes directions of the body."""
        return altered(self, directions=self.directions @ new_R_old.T, axes=self.axes @ new_R_old.T)

    def widened(self, spread: float) -> Detections:
        """The same where the pose of the camera is only known to a deviation of `spread` (radians per axis)."""
        deviations = 1 / np.linalg.norm(self.axes, axis=-1, keepdims=True)
        return altered(self, axes=self.axes * deviations / np.hypot(deviations, spread))

    def share(self, directions: np.ndarray) -> np.ndarray | float:
        """v ``(...)``: how far any of the views covered each direction ``(..., 3)`` of the body frame."""
        if not self.views:
            return 1.0
        missed = np.ones(directions.shape[:-1])
        for view in self.views:
            missed *= 1 - view.share(directions)
        return 1 - missed

    def coefficients(self, degree: int) -> np.ndarray:
        """log L in harmonics ``(size,)``, body frame; detections are widened to what the degree can hold.

        v fades to 0 inside the border of the covered region (`eagor.evidence.coverage`).
        """
        grid, basis = decoding_grid(degree), RealHarmonics(degree)
        share, where = self.grid_share(degree)
        found = basis.analyse(np.log(self.ratio(grid.directions, share, resolved(degree))), grid)
        return found if where is None else confine(degree, found, where)

    def grid_share(self, degree: int) -> tuple[np.ndarray | float, Region | None]:
        """v on the decoding grid ``(H, W)``, fading towards its border, and the covered region."""
        if not self.views:
            return 1.0, None
        grid = decoding_grid(degree)
        share = np.asarray(self.share(grid.directions))
        where = region(grid, share >= 0.5)
        return (share, None) if where is None else (share * taper(degree, where, share), where)

    @property
    def log_ratios(self) -> np.ndarray:
        """The logarithms of `ratios` ``(n,)``."""
        return np.log(np.maximum(self.ratios, LEAST_RATIO))

    @lazy
    def area(self) -> float:
        """Covered solid angle, steradians."""
        if not self.views:
            return 4 * math.pi
        grid = decoding_grid(15)
        return max(float(np.sum(np.asarray(self.share(grid.directions)) * grid.weights)), 1e-3)

    @property
    def own(self) -> np.ndarray:
        """The variances ``(n, 2)`` of a box's area along each axis; 0 for points."""
        lengths = np.linalg.norm(self.axes, axis=-1)
        return np.maximum(lengths**-2 - self.model.spread**2, 0.0) / self.model.spread_of_size**2

    def read(self, model: DetectorModel) -> Detections:
        """The same set with another model; its spread replaces the former one."""
        lengths = np.linalg.norm(self.axes, axis=-1, keepdims=True)
        each = model.spread_of_size**2 * self.own + model.spread**2
        axes = self.axes / lengths / np.sqrt(each)[..., None]
        scores = self.scores if self.scored else None
        ratios, clutter = model.ratios(scores, len(self)), model.clutter_at(self.directions)
        return altered(self, model=model, axes=axes, ratios=ratios, clutter=clutter)

    @lazy
    def again(self) -> np.ndarray:
        """The density ``(n,)`` of detections that show once more what one with a better score in the same look shows.

        Relative to that of one false alarm a look. Overlapping views, or boxes of one thing: two that agree are no sign
        of many false alarms.
        """
        if len(self) < 2:
            return np.zeros(len(self))
        rank = np.argsort(np.argsort(-self.ratios, kind="stable"))
        drawn = self.densities(self.directions, np.ones(1), np.eye(len(self)))[0]
        return self.area * (drawn * (rank[:, None] < rank)).sum(axis=0)

    def covariances(self, scale: np.ndarray | float = 1.0) -> np.ndarray:
        """Of each detection ``(..., n, 3, 3)``, at each of the factors `scale` ``(...)`` on its deviations."""
        deviations = self.axes / self._lengths[..., None] ** 2
        single = np.einsum("nai,naj->nij", deviations, deviations)
        return np.reshape(scale, (*np.shape(scale), 1, 1, 1)) ** 2 * single

    def response(self, directions: np.ndarray) -> np.ndarray:
        """The set drawn as a response ``(...)`` in [0, 1]: the maximum of score times bump."""
        if not len(self):
            return np.zeros(directions.shape[:-1], dtype=np.float32)
        drawn = self.scores[:, None] * np.exp(-self._exponents(directions).sum(axis=1))
        seen = np.asarray(self.share(directions)) > 0
        return (drawn.max(axis=0).reshape(directions.shape[:-1]) * seen).astype(np.float32)

    def densities(
        self, directions: np.ndarray, scales: np.ndarray, rows: np.ndarray, least: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Sums of g(z_i | w) over the relative clutter at directions w ``(..., 3)``, per steradian ``(S, k, ...)``.

        `rows` ``(k, n)``: the weights of the detections in each sum. Detections are widened by each of `scales`
        ``(S,)``, and to at least `least` radians (or ``(n,)``); their mass is kept.
        """
        lengths, exponents = self._lengths, self._exponents(directions)
        factors = 1 / np.maximum(scales[:, None, None], np.reshape(least, (-1, 1)) * lengths)  # (S, n, 2)
        first, second = (-(factors**2)).transpose(2, 0, 1)[..., None]
        falls = np.exp(np.maximum(first * exponents[:, 0] + second * exponents[:, 1], LOWEST))
        heights = rows / self.clutter * bump_norms(lengths * factors)[:, None]  # (S, k, n)
        return (heights @ falls).reshape(len(scales), len(rows), *directions.shape[:-1])

    @lazy
    def _lengths(self) -> np.ndarray:
        """1 over the standard deviation ``(n, 2)`` along each axis."""
        return np.sqrt(np.einsum("nij,nij->ni", self.axes, self.axes))

    def _exponents(self, directions: np.ndarray) -> np.ndarray:
        """-log of g over its maximum, along each axis of each detection ``(n, 2, N)`` at N directions ``(..., 3)``.

        g is Gaussian in Lambert's equal-area plane about z_i: where both axes are alike, von Mises-Fisher.
        """
        flat = directions.reshape(-1, 3).T
        along = (self.axes.reshape(-1, 3) @ flat).reshape(len(self), 2, -1)
        return along * along / np.maximum(1 + self.directions @ flat, 1e-9)[:, None]

    def ratio(
        self, directions: np.ndarray, share: np.ndarray | float | None = None, least: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """L ``(...)`` of this look alone at directions ``(..., 3)``, in the axes of the detections.

        `share`: v there (default: `self.share`, which takes body axes). `least`: radians, the narrowest width of a
        detection.
        """
        share = self.share(directions) if share is None else share
        speaks = 0.0
        if len(self):
            alarms = ClutterRate.prior(self.model).after(self.again)
            speaks = (
                alarms.mean_inverse_rate
                * self.area
                * self.densities(directions, np.ones(1), self.ratios[None], least)[0, 0]
            )
        recall = self.model.habits.mean
        return np.ones(directions.shape[:-1]) + share * recall * (speaks - 1)

    def speaks(
        self,
        directions: np.ndarray,
        scales: np.ndarray,
        alarms: ClutterRate,
        least: np.ndarray | float = 0.0,
        told: np.ndarray | float = 1.0,
        otherwise: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray]:
        """S ``(S, ...)``: the sum of g(z_i | w) / lambda(z_i) at directions ``(..., 3)``, at each of `scales` ``(S,)``.

        Also, of the detections that speak for each direction, the mean log score ratio ``(...)``, None without scores,
        and the mean of `sizes` ``(...)``, None for points. `told` ``(n,)``: factors on the terms of the sum. Last, S
        with the factors `otherwise` ``(n,)`` instead; None: the same.
        """
        if not len(self):
            nothing = np.zeros((len(scales), *directions.shape[:-1]))
            return nothing, None, None, nothing
        scored, sized = bool((self.ratios != 1).any()), bool(self.sizes.any())
        rows = [np.ones(len(self))]
        rows += [self.log_ratios] if scored else []
        rows += [self.sizes] if sized else []
        factors = [row * told for row in rows] + ([] if otherwise is None else [otherwise])
        found = self.densities(directions, scales, np.array(factors), least)
        means = list(found[:, 1 : len(rows)].sum(axis=0) / np.maximum(found[:, 0].sum(axis=0), 1e-300))
        scores = means.pop(0) if scored else None
        sizes = means.pop(0) if sized else None
        share = alarms.mean_inverse_rate * self.area
        ratio = share * found[:, 0]
        return ratio, scores, sizes, ratio if otherwise is None else share * found[:, -1]


def bump_norms(lengths: np.ndarray) -> np.ndarray:
    """1 / integral ``(...)`` of Gaussians in Lambert's plane, which ends at the antipode, at distance 2.

    `lengths` ``(..., 2)``: 1 over the standard deviation along each axis.
    """
    product = lengths[..., 0] * lengths[..., 1]
    return product / (2 * math.pi * -np.expm1(-2 * product))


def isotropic(directions: np.ndarray, spreads: np.ndarray) -> np.ndarray:
    """The axes ``(n, 2, 3)`` of round detections with standard deviations `spreads` ``(n,)``."""
    frames = tangent_frames(directions)
    return frames / np.reshape(spreads, (-1, 1, 1))


def anisotropic(directions: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """The axes ``(n, 2, 3)`` of detections with covariances ``(n, 2, 2)`` in `tangent_frame` of their directions."""
    return scaled_frames(tangent_frames(directions), covariances)


def scaled_frames(frames: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """The axes ``(n, 2, 3)`` of detections with covariances ``(n, 2, 2)`` along the `frames` ``(n, 2, 3)``."""
    if not len(frames):
        return np.zeros((0, 2, 3))
    variances, turns = np.linalg.eigh(covariances)
    return np.einsum("nij,nik->njk", turns, frames) / np.sqrt(variances)[..., None]


def resolved(degree: int) -> float:
    """The narrowest detection that a field of this degree can hold, radians."""
    return RESOLVED / (degree + 1)


def tangent_frames(directions: np.ndarray) -> np.ndarray:
    """Two orthonormal tangent vectors ``(n, 2, 3)`` at each of the directions ``(n, 3)``."""
    x, y, z = directions.T
    level = np.abs(z) < 0.9
    zero = np.zeros_like(x)
    first = np.array([np.where(level, -y, zero), np.where(level, x, -z), np.where(level, zero, y)]).T
    first /= np.sqrt(np.einsum("ni,ni->n", first, first))[:, None]
    frames = np.empty((len(directions), 2, 3))
    frames[:, 0], (a, b, c) = first, first.T
    frames[:, 1, 0], frames[:, 1, 1], frames[:, 1, 2] = y * c - z * b, z * a - x * c, x * b - y * a
    return frames


def tangent_frame(direction: np.ndarray) -> np.ndarray:
    """The same ``(2, 3)`` for one direction ``(3,)``."""
    return tangent_frames(direction[None])[0]
