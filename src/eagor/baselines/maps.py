"""Shared by the baselines: reading evidence, and maps of a density on one grid."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor._arrays import to_numpy
from eagor.belief.density import log_integral
from eagor.belief.field import SphereField
from eagor.errors import ResponseError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.coverage import looked_at
from eagor.grids import ErpGrid, Grid
from eagor.sphere import unit

GRID = ErpGrid(64, 128)
"""The cells (2.8 degrees) of the baselines with a map."""
NOTHING_KNOWN = -math.log(4 * math.pi)


def _check_single(evidence: Evidence) -> None:
    if len(evidence.log_ratio.shape) != 2:
        raise ResponseError(
            f"evidence has shape {tuple(evidence.log_ratio.shape)}; the baselines read one look (H, W) at a time. "
            "Loop over the batch"
        )


def seen_response(evidence: Evidence) -> np.ndarray:
    """The response ``(H, W)`` in float64, zero in cells that were not looked at."""
    _check_single(evidence)
    response = to_numpy(evidence.response).astype(np.float64) * (evidence.grid.weights > 0)
    if evidence.seen is not None and evidence.seen[-1]:
        response = response * looked_at(evidence.seen)
    return response


def strongest(response: np.ndarray, grid: Grid) -> np.ndarray:
    """The direction ``(3,)``, body frame, of the strongest response of ``(H, W)``, which are not all zero."""
    best = response >= 0.999 * response.max()
    # The middle of equally strong cells (such as a whole view in which the thing is reported).
    middle = np.sum((grid.weights * best)[..., None] * grid.directions, axis=(0, 1)) / np.sum(grid.weights * best)
    if np.linalg.norm(middle) < 0.5:  # they are scattered and have no middle
        return grid.directions[np.unravel_index(np.argmax(response), response.shape)]
    return unit(middle)


def log_ratio(evidence: Evidence, calibration: Calibration, directions: np.ndarray) -> np.ndarray:
    """The log ratio ``(...)`` at directions ``(..., 3)`` of the body frame: bilinear, zero where nothing was seen."""
    _check_single(evidence)
    values = to_numpy(evidence.with_calibration(calibration).log_ratio).astype(np.float64)
    return sample(values, evidence.grid, directions)


def sample(values: np.ndarray, grid: Grid, directions: np.ndarray) -> np.ndarray:
    """`values` ``(H, W)`` at directions ``(..., 3)``: bilinear between cell centres, zero outside the grid.

    A panorama continues across the seam and over the poles; a view keeps the value of its outermost cells up to its
    border.
    """
    if not hasattr(grid, "body_R_view"):
        return SphereField(ErpGrid(*grid.shape), values).smooth(directions, 1)
    from scipy.ndimage import map_coordinates

    x, y, inside = grid.project(directions)
    places = np.where(inside, np.stack([y, x]) - 0.5, 0.0).reshape(2, -1)
    return np.where(inside, map_coordinates(values, places, order=1, mode="nearest").reshape(x.shape), 0.0)


def log_density(log_map: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """log of the density of `log_map` on `GRID`; the density is interpolated, which keeps its mass."""
    return np.log(np.maximum(sample(np.exp(log_map), GRID, directions), 1e-300))


def normalised(log_values: np.ndarray) -> np.ndarray:
    """`log_values` on `GRID`, shifted so that their exponential integrates to one."""
    return log_values - log_integral(log_values, GRID.weights)


def log_mixed(density: np.ndarray, share: float) -> np.ndarray:
    """log of `density` on `GRID` with `share` of it made uniform."""
    return np.log(np.maximum((1 - share) * density + share / (4 * math.pi), 1e-300))


def spread(density: np.ndarray, sigma: float) -> np.ndarray:
    """`density` on `GRID` convolved with a von Mises-Fisher kernel of `sigma` radians per axis; the mass is kept."""
    spectrum = np.fft.rfft(density, axis=1).T[..., None]
    return np.maximum(np.fft.irfft((_kernel(sigma) @ spectrum)[..., 0].T, GRID.width, axis=1), 0.0)


@lru_cache(maxsize=32)
def _kernel(sigma: float) -> np.ndarray:
    """The kernel of `spread` ``(W / 2 + 1, H, H)``: the Fourier transform over azimuth differences."""
    cosine = GRID.directions @ GRID.directions[:, 0].T  # row, column; row of the source, which is in column 0
    kernel = np.exp((cosine - 1) / sigma**2)
    mass = np.einsum("ijk,i->k", kernel, GRID.weights[:, 0])
    return np.ascontiguousarray(np.fft.rfft(kernel * (GRID.weights[:, 0] / mass), axis=1).real.transpose(1, 0, 2))
