"""The maximum of a field: one synthesis, one argmax, one quadratic fit to nine values, in any array library.

The same fit gives the gradients and Hessians that `eagor.belief.direction` needs.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, constant, namespace, table_like
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import FORWARD

FLAT = 1e-5  # relative variation below which a field is constant, given the rounding of float32 evidence


@lru_cache(maxsize=64)
def decoding_grid(degree: int) -> ErpGrid:
    """The grid on which a field of this degree is searched for its peak: four rows per degree."""
    rows = max(48, 4 * (degree + 1))
    return ErpGrid(rows, 2 * rows)


def peak(degree: int, coefficients: Array) -> Array:
    """Directions ``(..., 3)`` of the maxima of fields ``(..., size)``; forward (1, 0, 0) for a constant field."""
    grid = decoding_grid(degree)
    values = RealHarmonics(degree).synthesise(coefficients, grid)
    return peak_on_grid(grid, values)


def peak_on_grid(grid: ErpGrid, values: Array) -> Array:
    """Directions ``(..., 3)`` of the maxima of fields ``(..., H, W)``, refined by a quadratic fit to nine values."""
    if type(values) is np.ndarray and values.ndim == 2:
        flat = values.reshape(-1)
        best = int(flat.argmax())
        top = float(flat[best])
        rounding = FLAT * max(1.0, abs(top))
        if top - float(flat[0]) <= rounding and top - float(flat.min()) <= rounding:
            return np.array(FORWARD)
        return refine(grid, flat, best)[0]
    xp = namespace(values)
    flat = xp.reshape(values, (*values.shape[:-2], -1))
    best = xp.argmax(flat, axis=-1)
    width = grid.width
    row, column = best // width, best % width
    stencil = xp.take(constant(_stencil, grid, like=values), xp.reshape(row, (-1,)), axis=0)
    near = xp.reshape(stencil[:, 0, :], (*row.shape, 9)) * width
    near = near + (column[..., None] + xp.reshape(stencil[:, 1, :], (*row.shape, 9))) % width
    nine = xp.take_along_axis(flat, near, axis=-1)
    fit = xp.reshape(xp.take(constant(_fit, grid, like=values), xp.reshape(row, (-1,)), axis=0), (*row.shape, 5, 9))
    gu, gv, huu, huv, hvv = (_dot(fit[..., i, :], nine) for i in range(5))
    det = huu * hvv - huv * huv
    good = (huu < 0) & (det > 0)
    det = xp.where(good, det, xp.ones_like(det))
    u, v = (huv * gv - hvv * gu) / det, (huv * gu - huu * gv) / det
    inside = good & (xp.hypot(u, v) < 1.5 * math.pi / grid.height)
    u, v = xp.where(inside, u, xp.zeros_like(u)), xp.where(inside, v, xp.zeros_like(v))
    frames = xp.take(constant(_frames, grid, like=values), xp.reshape(best, (-1,)), axis=0)
    frames = xp.reshape(frames, (*row.shape, 3, 3))
    moved = frames[..., 0, :] + u[..., None] * frames[..., 1, :] + v[..., None] * frames[..., 2, :]
    moved = moved / xp.sqrt(xp.sum(moved * moved, axis=-1, keepdims=True))
    top = xp.max(flat, axis=-1)
    flatland = top - xp.min(flat, axis=-1) <= FLAT * xp.clip(xp.abs(top), 1.0, math.inf)
    return xp.where(flatland[..., None], table_like(np.array(FORWARD), values), moved)


def derivatives(grid: ErpGrid, values: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Gradient (u, v) and Hessian (uu, uv, vv) ``(..., H, W)`` of fields ``(..., H, W)``: u left, v up, per radian."""
    xp = namespace(values)
    flat = xp.reshape(values, (*values.shape[:-2], -1))
    nine = xp.take(flat, constant(_stencil_index, grid, like=values), axis=-1)
    nine = xp.reshape(nine, (*values.shape, 9))
    found = constant(_fit, grid, like=values)[:, None, ...] @ nine[..., None]
    return tuple(found[..., i, 0] for i in range(5))  # type: ignore[return-value]


def _dot(a: Array, b: Array) -> Array:
    return namespace(a).sum(a * b, axis=-1)


def refine(grid: ErpGrid, flat: np.ndarray, best: int) -> tuple[np.ndarray, float]:
    """Direction of the maximum near cell `best`, and the width (standard deviation, radians) of exp(f) across it."""
    gu, gv, huu, huv, hvv = (_fit(grid)[best // grid.width] @ flat[neighbours(grid, best)]).tolist()
    across, u, v = math.pi / grid.height, 0.0, 0.0
    det = huu * hvv - huv * huv
    sigma = math.inf
    if huu < 0 and det > 0:
        u, v = (huv * gv - hvv * gu) / det, (huv * gu - huu * gv) / det
        if u * u + v * v > (1.5 * across) ** 2:
            u = v = 0.0
        sharpest = -(huu + hvv) / 2 + math.sqrt((huu - hvv) ** 2 / 4 + huv * huv)
        sigma = 1 / math.sqrt(sharpest)
    frame = _frames(grid)[best]
    moved = np.array([1.0, u, v]) @ frame
    return moved / math.sqrt(float(moved @ moved)), sigma


def neighbours(grid: ErpGrid, cell: int) -> np.ndarray:
    """The flat indices ``(9,)`` of a cell and the eight around it, across seam and poles."""
    row, column = divmod(cell, grid.width)
    rows, columns = _stencil(grid)[row]
    return rows * grid.width + (column + columns) % grid.width


@lru_cache(maxsize=16)
def _stencil(grid: ErpGrid) -> np.ndarray:
    """For each row, nine neighbours ``(H, 2, 9)``: their rows, and their column offsets.

    Columns are as far apart as rows on the sphere (many columns near a pole), and rows continue across the poles.
    """
    height, width = grid.shape
    stride = np.clip(np.rint(1 / np.cos(grid.latitudes)).astype(int), 1, width // 4)
    table = np.zeros((height, 2, 9), dtype=np.intp)
    for row in range(height):
        places = [(row + down, side * stride[row]) for down in (-1, 0, 1) for side in (-1, 0, 1)]
        for n, (r, c) in enumerate(places):
            over = r < 0 or r >= height
            table[row, :, n] = (-1 - r if r < 0 else 2 * height - 1 - r) if over else r, c + (width // 2 if over else 0)
    return table


def _stencil_index(grid: ErpGrid) -> np.ndarray:
    """The flat indices of every cell's nine neighbours ``(H W 9,)``."""
    stencil = _stencil(grid)
    columns = (np.arange(grid.width)[:, None] + stencil[:, None, 1]) % grid.width
    return (stencil[:, None, 0] * grid.width + columns).reshape(-1)


@lru_cache(maxsize=16)
def _fit(grid: ErpGrid) -> np.ndarray:
    """For each row ``(H, 5, 9)``: gradient and Hessian (u, v, uu, uv, vv) of the quadratic through nine values.

    Coordinates are gnomonic, (u, v) = (left, up) over the cell's tangent plane, in radians near its centre.
    """
    stencil, frames = _stencil(grid), _frames(grid).reshape(*grid.shape, 3, 3)
    found = np.zeros((grid.height, 5, 9))
    for row in range(grid.height):
        near = grid.directions[stencil[row, 0], stencil[row, 1] % grid.width]
        ahead, u, v = frames[row, 0] @ near.T
        u, v = u / ahead, v / ahead
        design = np.stack([np.ones(9), u, v, u * u / 2, u * v, v * v / 2], axis=1)
        found[row] = np.linalg.pinv(design)[1:]
    return found


@lru_cache(maxsize=16)
def _frames(grid: ErpGrid) -> np.ndarray:
    """At each cell ``(H W, 3, 3)``: its direction, the unit vector to the left and the one up, as rows."""
    elevation, azimuth = np.meshgrid(grid.latitudes, grid.longitudes, indexing="ij")
    sin_e, cos_e, sin_a, cos_a = np.sin(elevation), np.cos(elevation), np.sin(azimuth), np.cos(azimuth)
    ahead = np.stack([cos_e * cos_a, cos_e * sin_a, sin_e], axis=-1)
    left = np.stack([-sin_a, cos_a, np.zeros_like(sin_a)], axis=-1)
    up = np.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], axis=-1)
    return np.stack([ahead, left, up], axis=-2).reshape(-1, 3, 3)
