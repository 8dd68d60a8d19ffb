"""A belief as heat: its density in colours, and the border of the smallest region that holds 90 % of it.

Rasters are panoramas in the layout of `eagor.sphere`: azimuth +180 at the left edge, elevation +90 at the top.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor.belief.posterior import Readable
from eagor.cameras import Sampler
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.thumbnail import undrawn
from eagor.tracking.estimate import Estimate

__all__ = ["MASS", "Heat", "heat_of", "reader_of_heat"]

ROWS, COARSE = 540, 180  # of the map, and of the cells on which the density is computed
MARGIN = 4  # cells around the coarse ones, beyond the seam and the poles
MASS = 0.9
FLAT = 1e-6  # a density that varies by less than this share of its mean is uniform


@dataclass(frozen=True, eq=False)
class Heat:
    """A belief as heat.

    `rgba` ``(H, W, 4)`` uint8, a whole panorama; `border`: the polylines around the 90 % region ``(n, 2)``, azimuth and
    elevation in degrees, empty where it is not drawn, and `missing` then says why. `share` ``(H, W)``: the root of the
    share of the highest density, 0 to 1; `contrast`: 0 for a uniform belief, 1 for a sharp one.
    """

    rgba: np.ndarray
    border: tuple[np.ndarray, ...]
    missing: str
    share: np.ndarray
    contrast: float


@lru_cache(maxsize=1)  # a video and a page draw the same estimate one after the other
def heat_of(belief: Estimate | Readable, rows: int = ROWS) -> Heat | None:
    """The density as heat of so many rows, a multiple of 180, with the border of its 90 % region.

    None for a uniform belief, and while nothing is known. The border is missing if the region is larger than half of
    the sphere or if ripples alone decide where it runs.
    """
    if isinstance(belief, Estimate):
        if belief.direction is None:
            return None
        level, area = belief.region(MASS)
    else:
        region = belief.credible_region(MASS)
        level, area = region.threshold, region.area
    log_density = _density(belief, rows // COARSE)
    times = 4 * math.pi * np.exp(log_density)  # relative to the uniform density
    most = float(times.max())
    if most - float(times.min()) < FLAT:
        return None
    share = np.sqrt(np.clip((times - 1) * (1 / (most - 1)), 0, 1))
    contrast = 1 - 1 / most
    rgba = _colours(contrast)[np.rint(255 * share).astype(np.uint8)]
    if why := undrawn(log_density, _grid(rows).weights, level, area):
        return Heat(rgba, (), f"{100 * MASS:.0f} % region not drawn: {why}", share, contrast)
    return Heat(rgba, _contour(log_density, level), "", share, contrast)


@lru_cache(maxsize=4)
def reader_of_heat(grid: PerspectiveGrid, height: int, width: int, rows: int = ROWS) -> Sampler:
    """What reads `Heat.rgba` of so many rows where the pixels ``(height, width)`` of an ordinary picture look."""
    return Sampler(ErpGrid(rows, 2 * rows), grid.resized(height, width).directions)


@lru_cache(maxsize=3)
def _grid(rows: int) -> PatchGrid:
    return PatchGrid(rows, 2 * rows)


def _density(belief: Estimate | Readable, times: int) -> np.ndarray:
    """The log density ``(H, W)``, float32: computed on coarse cells, cubic between them, `times` as many a side.

    The logarithm of a lobe is nearly a parabola, so that even one that is as narrow as a cell keeps its shape.
    """
    from PIL import Image

    cells = np.asarray(belief.log_density(_grid(COARSE).directions), dtype=np.float32)
    if times == 1:
        return cells
    beyond = np.roll(cells, COARSE, axis=1)[::-1]  # a pole: it goes on half a turn away
    cells = np.pad(np.concatenate([beyond[-MARGIN:], cells, beyond[:MARGIN]]), ((0, 0), (MARGIN, MARGIN)), "wrap")
    size = times * cells.shape[1], times * cells.shape[0]
    inner = slice(times * MARGIN, -times * MARGIN)
    return np.asarray(Image.fromarray(cells).resize(size, Image.Resampling.BICUBIC))[inner, inner]


def _colours(contrast: float) -> np.ndarray:
    """The colours ``(256, 4)`` uint8 of densities from none to the highest, paler for a belief of little contrast."""
    from matplotlib import colormaps

    share = np.linspace(0, 1, 256)
    found = colormaps["inferno"](0.35 + 0.6 * share, bytes=True)
    found[:, 3] = np.rint(255 * 0.85 * contrast * np.clip(1.3 * share, 0, 1))
    return found


def _contour(log_density: np.ndarray, level: float) -> tuple[np.ndarray, ...]:
    """Where the density is at `level`. A few more columns on either side let it run across the seam into the frame."""
    from contourpy import contour_generator  # matplotlib draws contours with it

    height, width = log_density.shape
    (inside,) = np.nonzero((log_density >= level).any(axis=1))
    if not len(inside):
        return ()
    rows = slice(max(0, inside[0] - 2), inside[-1] + 3)
    azimuth = 180 - 360 * (np.arange(-8, width + 8) + 0.5) / width
    elevation = 90 - 180 * (np.arange(height)[rows] + 0.5) / height
    wide = np.pad(log_density[rows], ((0, 0), (8, 8)), "wrap")
    return tuple(map(np.asarray, contour_generator(azimuth, elevation, wide).lines(level)))
