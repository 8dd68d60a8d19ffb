"""Evidence: what one look at the world says about each direction, as a log-likelihood ratio.

A perception returns a response l in [0, 1] on a grid. A `Calibration` turns it into a log-likelihood ratio:
positive where the response speaks for the target, negative (and bounded) where we looked and saw nothing, exactly zero
where we did not look. The logarithm is taken on the response's own grid, and the coefficients integrate each cell over
its solid angle. (Upsampling before the logarithm would turn the skirts of isolated cells into large areas of evidence.)

With a `Calibration.spread`, the likelihood ratios are averaged over that angle before truncation (`averaging`);
otherwise a small thing would nearly vanish.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from eagor._arrays import Array, frozen, namespace, table_like, to_numpy
from eagor._checks import checked_stamp
from eagor._values import changed
from eagor.errors import ResponseError
from eagor.evidence.averaging import averaged
from eagor.evidence.calibration import (
    SILENT,
    Calibration,
    checked_coverage,
    checked_response,
    log_ratios,
    peak_of,
    where_covered,
)
from eagor.evidence.coverage import Region, confine, region, taper
from eagor.evidence.detections import Detections, View, anisotropic, isotropic
from eagor.evidence.detector import DetectorModel, Habits
from eagor.evidence.masking import BodyMask
from eagor.evidence.shapes import (
    MIN_SPREAD,
    WHOLE_SPHERE,
    bump,
    canvas_of,
    check_on_picture,
    mask_moments,
    moments,
    widened,
)
from eagor.grids import FisheyeGrid, Grid, PerspectiveGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import unit

__all__ = ["Evidence"]


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """One look: log-likelihood ratios ``(..., H, W)`` on a grid, when it was taken, and what it covered.

    Make it with `from_response`, `from_boxes`, `from_mask` or `from_points`. `stamp` is the time of CAPTURE in seconds
    (None where time plays no role). `source`: what produced it (model, revision, token counts, milliseconds, ...),
    plain values for people and reports; nothing here reads them. `looked_for`: what the perception looked for, in
    words, where that is another word than was asked. Evidence is immutable.

        >>> picture = eagor.ErpGrid(512, 1024)
        >>> eagor.Evidence.from_boxes([[500, 240, 540, 280]], picture, scores=[0.9], stamp=0.0)
        Evidence(t=0 s, 1 detection on PatchGrid, read by DetectorModel())
    """

    drawn: Array | None = field(repr=False)  # None: the detections are drawn on demand
    grid: Grid
    calibration: Calibration
    stamp: float | None = None
    seen: Region | None = field(default=None, repr=False)
    peak: float = 1.0  # what the response was divided by (scale_to_max)
    source: Mapping[str, object] | None = None
    coverage: np.ndarray | None = field(default=None, repr=False)  # (H, W) in [0, 1]; None: the whole grid
    detections: Detections | None = None  # the detections, if a `DetectorModel` reads the evidence
    looked_for: str = ""

    def __repr__(self) -> str:
        rows, columns = self.grid.shape
        what = f"{rows} x {columns} responses"
        if self.detections is not None:
            count = len(self.detections)
            what = f"{count or 'no'} detection{'' if count == 1 else 's'}"
        elif len(self.log_ratio.shape) > 2:
            what = f"batch {tuple(self.log_ratio.shape[:-2])} of {what}"
        stamp = "no stamp" if self.stamp is None else f"t={self.stamp:g} s"
        return f"Evidence({stamp}, {what} on {type(self.grid).__name__}, read by {changed(self.sensor_model)})"

    def _repr_html_(self) -> str:
        """A small picture, for notebooks."""
        from eagor import thumbnail

        if self.detections is None:
            return thumbnail.ratio_html(repr(self), *thumbnail.on_grid(self.log_ratio, self.grid, self.coverage))
        values = np.log(self.detections.ratio(thumbnail.GRID.directions))
        seen = np.asarray(self.detections.share(thumbnail.GRID.directions)) > 0
        return thumbnail.ratio_html(repr(self), values, np.broadcast_to(seen, values.shape))

    @classmethod
    def from_detections(cls, detections: Detections, grid: Grid, stamp: float | None = None) -> Evidence:
        """Evidence from a set of detections; `grid` is what its values are drawn on."""
        stamp = None if stamp is None else checked_stamp(stamp)
        return cls(None, grid, _DEFAULT, stamp, detections=detections)

    @classmethod
    def from_moments(
        cls,
        found: Sequence[tuple[np.ndarray, np.ndarray]],
        scores: np.ndarray | None,
        view: View,
        detector: DetectorModel | None = None,
        stamp: float | None = None,
    ) -> Evidence:
        """Evidence from detections with mean directions ``(3,)`` and covariances ``(2, 2)`` about them, in `view`.

        `detector` (default: `DetectorModel()`) says how far each may be off. `scores` ``(n,)`` in [0, 1].
        """
        model = _checked_reading(detector, DetectorModel) or DetectorModel()
        points = np.array([centre for centre, _ in found]).reshape(-1, 3)
        own = np.array([spread for _, spread in found]).reshape(-1, 2, 2)
        # A box whose solid angle has the standard deviation s along an axis goes sqrt(3) s to each side.
        sizes = np.minimum(np.sqrt(3 * np.linalg.eigvalsh(own).max(axis=-1, initial=0.0)), np.pi)
        axes = anisotropic(points, model.spread_of_size**2 * own + model.spread**2 * np.eye(2))
        detections = Detections.around(model, points, axes, scores, view, sizes)
        return cls.from_detections(detections, canvas_of(view.grid), stamp)

    @property
    def log_ratio(self) -> Array:
        """The log-likelihood ratios ``(..., H, W)`` on the grid."""
        if self.drawn is not None:
            return self.drawn
        assert self.detections is not None
        return np.log(self.detections.ratio(self.grid.directions)).astype(np.float32)

    @classmethod
    def from_response(
        cls,
        response: Array,
        grid: Grid,
        calibration: Calibration | None = None,
        stamp: float | None = None,
        coverage: np.ndarray | None = None,
        source: Mapping[str, object] | None = None,
    ) -> Evidence:
        """Evidence from a response ``(..., H, W)`` in [0, 1] on `grid`.

        `coverage` ``(H, W)`` in [0, 1] (or bool) is how far each cell was looked at; default: fully. Where it is 0 the
        response is ignored and may be NaN. `source` tells what produced the response. Raises `ResponseError` on another
        shape, an empty array, NaN, or values outside [0, 1]. An all-zero response is valid: we looked and saw nothing.
        """
        calibration = _checked_reading(calibration, Calibration) or _DEFAULT
        response = checked_response(response, _checked_grid(grid))
        mask = None
        if coverage is not None:
            coverage = checked_coverage(coverage, grid)
            mask = coverage > 0
            response = where_covered(response, mask)
        peak = peak_of(response) if calibration.scale_to_max else 1.0
        log_ratio = log_ratios(response, calibration, peak)
        if stamp is not None:
            stamp = checked_stamp(stamp)
        if coverage is not None:
            log_ratio = log_ratio * table_like(coverage, log_ratio)
            coverage = None if (coverage == 1).all() else frozen(coverage)
        return cls(log_ratio, grid, calibration, stamp, region(grid, mask), peak, source, coverage)

    @classmethod
    def from_mask(
        cls,
        masks: Array,
        grid: Grid,
        scores: Array | None = None,
        calibration: Calibration | None = None,
        stamp: float | None = None,
        min_spread: float = MIN_SPREAD,
        detector: DetectorModel | None = None,
    ) -> Evidence:
        """Evidence from one mask ``(H, W)`` or several ``(n, H, W)``, bool; ``n = 0`` means looked and saw nothing.

        Each mask is a detection: its mean direction, as wide as the mask and as `detector` spreads it (default:
        `DetectorModel()`). `scores` ``(n,)`` in [0, 1].

        With a `calibration` the masks are read as a response map instead: where they overlap, the best score counts,
        and small masks are widened to a bump of `min_spread` radians (0: not widened).
        """
        masks, grid = np.asarray(to_numpy(masks)), _checked_grid(grid)
        if masks.dtype.kind == "f" and not np.isin(masks, (0, 1)).all():
            raise ResponseError("a mask has values other than 0 and 1; wanted bool: apply a threshold first")
        masks = masks.astype(bool)
        masks = masks[None] if masks.ndim == 2 else masks
        if masks.ndim != 3 or masks.shape[1:] != tuple(grid.shape):
            raise ResponseError(f"masks have shape {masks.shape}; the grid wants (n, {grid.shape[0]}, {grid.shape[1]})")
        weights = _checked_scores(scores, len(masks))
        if calibration is None or detector is not None:
            found = [mask_moments(mask, grid) for mask in masks if mask.any()]
            kept = None if scores is None else weights[[bool(mask.any()) for mask in masks]]
            return cls.from_moments(found, kept, View(grid), detector, stamp)
        response = np.zeros(grid.shape)
        for mask, weight in zip(masks, weights, strict=True):
            response = np.maximum(response, weight * widened(mask, grid, min_spread))
        return cls.from_response(response.astype(np.float32), grid, calibration, stamp)

    @classmethod
    def from_boxes(
        cls,
        boxes: Array,
        grid: Grid,
        scores: Array | None = None,
        calibration: Calibration | None = None,
        stamp: float | None = None,
        min_spread: float = MIN_SPREAD,
        detector: DetectorModel | None = None,
    ) -> Evidence:
        """Evidence from detections, boxes ``(n, 4)`` x0, y0, x1, y1 in the pixels of the image that `grid` describes.

        Coordinates are continuous: pixel j spans [j, j + 1]. On an equirectangular image a box with x0 > x1, or one
        that runs past the border, crosses the seam. `scores` ``(n,)`` in [0, 1], default 1. No boxes at all is valid
        input.

        Each box is a detection in the mean direction of its solid angle, with that solid angle's second moments,
        widened by the spread of `detector` (default: `DetectorModel()`).

        With a `calibration` the boxes are read as a response map instead: smooth bumps with these moments, widened by
        `min_spread` (radians). The values are drawn on a grid of their own: cells of 2 degrees for a panorama, a coarse
        copy of a large view.
        """
        table, grid = _rows(boxes, 4, "boxes"), _checked_grid(grid)
        weights = _checked_scores(scores, len(table))
        for box in table:
            check_on_picture(box, grid)
        if calibration is None or detector is not None:
            found = [moments(box, grid) for box in table]
            return cls.from_moments(found, None if scores is None else weights, View(grid), detector, stamp)
        canvas = canvas_of(grid)
        response = np.zeros(canvas.shape)
        for box, weight in zip(table, weights, strict=True):
            centre, spread = moments(box, grid)
            drawn = bump(canvas.directions, centre, spread + min_spread**2 * np.eye(2))
            response = np.maximum(response, weight * drawn)
        return cls.from_response(response.astype(np.float32), canvas, calibration, stamp)

    @classmethod
    def from_points(
        cls,
        directions: Array,
        concentration: Array | None = None,
        scores: Array | None = None,
        grid: Grid | None = None,
        calibration: Calibration | None = None,
        stamp: float | None = None,
        detector: DetectorModel | None = None,
    ) -> Evidence:
        """Evidence from points: directions ``(n, 3)``, each a detection spread as `detector` says.

        `detector`: how the detector errs (default: `DetectorModel()`). `concentration` (von Mises-Fisher, scalar or
        ``(n,)``, > 0): replaces the model's spread; a spread of s radians is a concentration of 1 / s^2. `grid` tells
        what was looked at (default: everything). ``n = 0`` means looked and saw nothing.

        With a `calibration` the points are read as a response map instead, the highest of ``score * exp(concentration *
        (cos(angle) - 1))``.
        """
        points = _rows(directions, 3, "directions")
        points = unit(points) if len(points) else points
        model = _checked_reading(detector, DetectorModel) or DetectorModel()
        if concentration is None:
            concentration = model.spread**-2
        kappa = np.asarray(to_numpy(concentration), dtype=np.float64)
        if kappa.shape not in ((), (1,), (len(points),)) or not (np.isfinite(kappa).all() and (kappa > 0).all()):
            raise ResponseError(
                f"concentration is {concentration!r} for {len(points)} directions; wanted one positive number, or one "
                "for each: 1 / spread^2, with the spread in radians"
            )
        kappa = np.broadcast_to(kappa, (len(points),))
        if isinstance(grid, PerspectiveGrid):
            _check_in_view(points, kappa, grid)
        weights = _checked_scores(scores, len(points))
        canvas = WHOLE_SPHERE if grid is None else canvas_of(grid)
        if calibration is None or detector is not None:
            told = None if scores is None else weights
            view = View(canvas if grid is None else grid)
            found = Detections.around(model, points, isotropic(points, kappa**-0.5), told, view)
            return cls.from_detections(found, canvas, stamp)
        cosines = canvas.directions @ points.T
        response = np.max(weights * np.exp(kappa * (cosines - 1)), axis=-1, initial=0.0)
        return cls.from_response(response.astype(np.float32), canvas, calibration, stamp)

    def coefficients(self, degree: int) -> Array:
        """The evidence in spherical harmonics ``(..., (degree + 1)^2)``, body frame at the time of capture.

        Detections are widened to what a field of this degree can hold.
        """
        basis, grid = RealHarmonics(degree), self.grid
        if self.detections is not None:
            return self.detections.coefficients(degree)
        values = self.log_ratio
        # Plans are cached per lens: compute for the view that looks forward, and rotate at the end.
        turn = np.asarray(grid.body_R_view) if isinstance(grid, PerspectiveGrid | FisheyeGrid) else None
        if turn is not None:
            grid = replace(grid, body_R_view=np.eye(3))
        if self.seen is not None:
            values = values * taper(degree, self.seen, values)
        if self.calibration.spread > 0:
            least, most = min(self.calibration.empty, 0.0), max(self.calibration.full, 0.0)
            values, grid = averaged(values, grid, self.calibration.spread, least, most)
        found = basis.analyse(values, grid)
        if self.seen is not None:
            found = confine(degree, found, self.seen)
        return found if turn is None else basis.rotate(found, turn)

    @property
    def response(self) -> Array:
        """The response ``(..., H, W)`` in [0, 1] that this evidence was made from (before any scaling), to rounding.

        Where nothing was covered it is `Calibration.neutral`.
        """
        if self.detections is not None:
            return self.detections.response(self.grid.directions)
        ratio, xp = self.log_ratio, namespace(self.log_ratio)
        if self.coverage is not None:
            share = table_like(self.coverage, ratio)
            ratio = ratio / xp.where(share > 0, share, xp.ones_like(share))
        scale = self.calibration.neutral + self.calibration.floor
        found = scale * xp.exp(ratio / self.calibration.temperature) - self.calibration.floor
        found = xp.where(found > SILENT, found, xp.zeros_like(found))
        return xp.clip(found, 0.0, 1.0) * self.peak

    def with_calibration(self, calibration: Calibration) -> Evidence:
        """The same look, read with another calibration."""
        if calibration == self.calibration and self.detections is None:
            return self
        return Evidence.from_response(
            self.response, self.grid, calibration, self.stamp, coverage=self.coverage, source=self.source
        )

    def with_detector(self, model: DetectorModel) -> Evidence:
        """The same detections, read with another model. A response map is returned unchanged."""
        if self.detections is None or model == self.detections.model:
            return self
        found = Evidence.from_detections(self.detections.read(model), self.grid, self.stamp)
        return replace(found, source=self.source)

    def covered(self, mask: BodyMask) -> Evidence:
        """The same look without what `mask` hides: it says nothing there, neither by finding nor by missing.

        A detection counts unless its own extent lies mostly under the mask. Other detections, and responses outside of
        it, stay as they are.
        """
        if self.detections is not None:
            return replace(self, detections=mask.detections(self.detections))
        share = mask.share(self.grid)
        coverage = share if self.coverage is None else share * self.coverage
        if self.calibration.scale_to_max:  # the maximum may have been under the mask
            found = Evidence.from_response(self.response, self.grid, self.calibration, self.stamp, coverage=coverage)
            return replace(found, source=self.source, looked_for=self.looked_for)
        ratio = self.log_ratio * table_like(share, self.log_ratio)
        kept = None if (coverage == 1).all() else frozen(coverage)
        return replace(self, drawn=ratio, coverage=kept, seen=region(self.grid, coverage > 0))

    def widened(self, spread: float) -> Evidence:
        """The same from a camera whose pose is only known to a deviation of `spread` (radians per axis).

        Detections become wider. A response map stays as it is.
        """
        if self.detections is None or spread <= 0:
            return self
        return replace(self, detections=self.detections.widened(spread))

    @property
    def sensor_model(self) -> Calibration | DetectorModel:
        """What turns it into likelihood ratios."""
        return self.calibration if self.detections is None else self.detections.model

    @property
    def habits(self) -> Habits:
        """How often places are detected, and for how long they keep that."""
        return self.sensor_model.habits


_DEFAULT = Calibration()
Reading = TypeVar("Reading", Calibration, DetectorModel)


def _checked_reading(found: Any, kind: type[Reading]) -> Reading | None:
    """What turns a look into likelihood ratios, or None. Raises `ResponseError` for anything else."""
    if found is not None and not isinstance(found, kind):
        name = {Calibration: "calibration", DetectorModel: "detector"}[kind]
        raise ResponseError(f"{name} is {type(found).__name__}; wanted eagor.{kind.__name__}")
    return found


def _checked_grid(grid: Any) -> Any:
    if not hasattr(type(grid), "directions"):  # of a large grid they are gigabytes: they must not be computed here
        raise ResponseError(f"grid is {grid!r}; wanted a grid, such as eagor.ErpGrid(height, width)")
    return grid


def _check_in_view(points: np.ndarray, kappa: np.ndarray, grid: PerspectiveGrid) -> None:
    """Raise `ResponseError` for a point that lies outside of a view by more than three deviations."""
    ahead = points @ np.asarray(grid.body_R_view)[:, 0]
    corner = math.atan(math.hypot(1, grid.height / grid.width) * math.tan(grid.hfov / 2))
    outside = np.arccos(np.clip(ahead, -1, 1)) > corner + 3 * kappa**-0.5
    if outside.any():
        raise ResponseError(
            f"the direction {np.round(points[outside][0], 3).tolist()} is not in the view of "
            f"{math.degrees(grid.hfov):.0f} degrees; wanted directions of the body frame (x forward, y left, z up), "
            "not of the world"
        )


def _rows(values: Array, columns: int, name: str) -> np.ndarray:
    """`values` as a table ``(n, columns)``; one row and an empty list are tables too."""
    try:
        table = np.asarray(to_numpy(values), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ResponseError(f"{name} are not a table of numbers ({error}); wanted (n, {columns})") from error
    if table.size == 0:
        return np.zeros((0, columns))
    if table.ndim > 2 or table.shape[-1:] != (columns,):
        raise ResponseError(f"{name} have shape {table.shape}; wanted (n, {columns})")
    return table.reshape(-1, columns)


def _checked_scores(scores: Array | None, count: int) -> np.ndarray:
    """Scores ``(count,)`` in [0, 1], all 1 by default."""
    if scores is None:
        return np.ones(count)
    try:
        weights = np.asarray(to_numpy(scores), dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ResponseError(f"scores are no numbers ({error}); wanted {count} in [0, 1]") from error
    if weights.shape != (count,) or not ((weights >= 0) & (weights <= 1)).all():
        raise ResponseError(f"scores must be {count} numbers in [0, 1], one per detection; got {weights.tolist()[:5]}")
    return weights
