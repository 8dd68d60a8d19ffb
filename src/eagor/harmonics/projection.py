"""From values on a grid to coefficients, and back.

- Equirectangular pixels: samples at their centres, Fejer weights, exact for band-limited fields.
- Patches: a constant value per cell, each basis function integrated exactly over the cell.
- Views (perspective, fisheye): the cells are gathered into blocks much smaller than the finest harmonic, and the basis
  is integrated over each block by Gauss points. The plan depends on the lens, not on the pose: coefficients are
  computed in the view's frame and rotated into the body's.

The first two are separable: one matrix product over longitude, one small one per order over latitude. In between,
tables run over the orders m >= 0, cosine and sine in turn.

The latitude part of all orders together has (degree + 1)^2 rows numbers: gigabytes from degree 300 on. Where it is too
large, it is computed for a few orders at a time, used, and dropped.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, as_float, constant, namespace, recent, table_like, to_numpy
from eagor.grids import (
    ErpGrid,
    ErpWindow,
    FisheyeGrid,
    Grid,
    PatchGrid,
    PerspectiveGrid,
    ViewKey,
    fejer_weights,
    forward_view,
    view_key,
)
from eagor.harmonics.legendre import coefficient_of, entry_of, evaluate, latitude_functions, longitude_table
from eagor.harmonics.rotation import rotate
from eagor.sphere import check_directions

BLOCK = 0.25  # side of a view's block, in units of the angular scale 1 / (degree + 1)
WIDEST = 2 * BLOCK  # the largest side, for plans that would take too much memory otherwise
SMALL = 1_000_000  # OpenBLAS has special kernels for products up to 100^3
TABLE_BYTES = 64e6  # a larger latitude table is recomputed at every call, BLOCK_BYTES at a time
BLOCK_BYTES = 1 << 25
PLAN_BYTES = 256e6  # a view plan that is larger even so is computed block row by block row and not cached


def analyse(degree: int, values: Array, grid: Grid) -> Array:
    """Coefficients ``(..., (degree + 1)^2)`` of `values` ``(..., H, W)`` on `grid`: the integrals of values * Y_lm."""
    if not isinstance(grid, ErpGrid | PatchGrid):
        return _analyse_view(degree, values, grid)
    xp, batch, count, height = namespace(values), values.shape[:-2], degree + 1, grid.height
    # The long sum runs in the precision of the values.
    rings = _product(values, constant(_longitude_plan, degree, grid, like=values))
    rings = xp.permute_dims(xp.reshape(rings, (-1, height, count, 2)), (2, 3, 1, 0))
    packed = _by_order(operator.matmul, degree, height, type(grid), rings)
    packed = xp.reshape(packed, (2 * count**2, -1))
    return xp.reshape(xp.take(packed, constant(entry_of, degree, like=rings), axis=0).T, (*batch, count**2))


def synthesise(degree: int, coefficients: Array, where: Grid | ErpWindow | Array) -> Array:
    """Values of the field: ``(..., H, W)`` on a grid, or ``(..., n...)`` at an array of directions ``(n..., 3)``."""
    xp, batch = namespace(coefficients), coefficients.shape[:-1]
    if isinstance(where, ErpGrid | PatchGrid | ErpWindow):
        whole, count = where.whole if isinstance(where, ErpWindow) else where, degree + 1
        packed = xp.take(coefficients, constant(coefficient_of, degree, like=coefficients), axis=-1)
        packed = xp.permute_dims(xp.reshape(packed, (-1, count, 2, count)), (1, 2, 0, 3))
        over_columns = constant(_longitude_values, degree, whole.width, like=coefficients)
        rows = slice(None)
        if isinstance(where, ErpWindow):
            rows = slice(where.top, where.top + where.rows)
            over_columns = xp.take(over_columns, table_like(where.columns, coefficients), axis=1)
        rings = _by_order(lambda table, part: part @ table[..., rows], degree, whole.height, None, packed)
        rings = xp.reshape(rings, (2 * count, -1))
        # A product for each map is too small for OpenBLAS to wake its threads, which would wait for each other.
        maps = xp.reshape(xp.matrix_transpose(rings), (-1, where.shape[0], 2 * count))
        return xp.reshape(maps @ over_columns, (*batch, *where.shape))
    points = where.directions if isinstance(where, PerspectiveGrid | FisheyeGrid) else as_float(where)
    check_directions(points)
    if xp is np:
        points = to_numpy(points).astype(coefficients.dtype, copy=False)
        flat = points.reshape(-1, 3)
        parts = [coefficients @ evaluate(degree, flat[i : i + 512]).T for i in range(0, len(flat), 512)]
        values = np.concatenate(parts, axis=-1) if parts else np.zeros((*batch, 0))
        return values.reshape((*batch, *points.shape[:-1]))
    if isinstance(points, np.ndarray):
        points = table_like(points, coefficients)
    basis = evaluate(degree, xp.reshape(points, (-1, 3)))
    return xp.reshape(coefficients @ basis.T, (*batch, *points.shape[:-1]))


def _product(values: Array, table: Array) -> Array:
    """``values @ table``; a large single map in strips of SMALL multiplications, for BLAS's small kernels."""
    if values.ndim != 2 or not isinstance(values, np.ndarray) or values.size * table.shape[1] < 4 * SMALL:
        return values @ table
    rows = max(1, SMALL // table.size)
    return np.concatenate([values[start : start + rows] @ table for start in range(0, len(values), rows)])


def _longitude_plan(degree: int, grid: ErpGrid | PatchGrid) -> np.ndarray:
    """Integrals over each column of the cosines and sines ``(W, 2 (degree + 1))``."""
    plan = longitude_table(degree, grid.longitudes) * (2 * math.pi / grid.width)
    if isinstance(grid, PatchGrid):  # the mean over a cell is the value at its centre times a sinc
        plan *= np.sinc(np.repeat(np.arange(degree + 1), 2) / grid.width)
    return plan


def _longitude_values(degree: int, width: int) -> np.ndarray:
    """Cosines and sines at the column centres ``(2 (degree + 1), W)``."""
    return longitude_table(degree, ErpGrid(1, width).longitudes).T


def _by_order(product: Callable, degree: int, height: int, over: type | None, packed: Array) -> Array:
    """The `product` of `_latitude_plan` and `packed` ``(orders, ...)``: all at once, or of a few orders at a time."""
    row_bytes, count = 8 * (degree + 1) * height, degree + 1
    if count * row_bytes <= TABLE_BYTES:
        return product(constant(_latitude_plan, degree, height, over, 0, count, like=packed), packed)
    parts = []
    for first in range(0, count, max(1, BLOCK_BYTES // row_bytes)):
        last = min(first + max(1, BLOCK_BYTES // row_bytes), count)
        table = table_like(_latitude_plan(degree, height, over, first, last), packed)
        parts.append(product(table, packed[first:last, ...]))
    return namespace(packed).concat(parts)


def _latitude_plan(degree: int, height: int, over: type | None, first: int, last: int) -> np.ndarray:
    """Latitude functions of the orders `first` to `last` - 1, ``(orders, 1, degree + 1, H)``.

    At the row centres, or integrated over the rows of grids of the class `over`.
    """
    latitudes = ErpGrid(height, 1).latitudes
    if over is not PatchGrid:
        table = latitude_functions(degree, np.sin(latitudes), first, last).swapaxes(0, 1)[:, None]
        return table * fejer_weights(height) if over is ErpGrid else table
    # The integrand is a trigonometric polynomial of degree + 1 in latitude: Gauss points converge to rounding.
    half_row = math.pi / height / 2
    nodes, weights = np.polynomial.legendre.leggauss(8 + math.ceil((degree + 1) * half_row))
    latitudes = latitudes[:, None] + half_row * nodes
    area = half_row * weights * np.cos(latitudes)
    table = latitude_functions(degree, np.sin(latitudes).ravel(), first, last)
    return np.einsum("lmhc,hc->mlh", table.reshape(*table.shape[:2], *area.shape), area)[:, None]


def _analyse_view(degree: int, values: Array, grid: Grid) -> Array:
    """For views: block means times block integrals, in the view's own frame, then one rotation."""
    if not isinstance(grid, PerspectiveGrid | FisheyeGrid):
        raise TypeError(f"cannot analyse values on a {type(grid).__name__}; wanted one of the grids of eagor.grids")
    xp = namespace(values)
    lens = view_key(grid)
    rows, columns = _block_edges(lens, degree)
    weights = constant(lens_weights, lens, like=values)
    area = constant(_block_areas, lens, degree, like=values)
    sums = values * weights
    sums = pool(pool(sums, rows, -2), columns, -1)
    means = xp.where(area > 0, sums / xp.where(area > 0, area, xp.ones_like(area)), xp.zeros_like(sums))
    if _plan_bytes(rows, columns, degree) <= PLAN_BYTES:
        flat = xp.reshape(means, (*means.shape[:-2], -1))
        found = flat @ recent(_block_plan, lens, degree, like=values)
    else:
        found = sum(means[..., i, :] @ table_like(_block_row(lens, degree, i), values) for i in range(area.shape[0]))
    return rotate(degree, found, grid.body_R_view)


def lens_weights(lens: ViewKey) -> np.ndarray:
    """The solid angles ``(H, W)`` of a view's pixels."""
    return forward_view(lens).weights


@lru_cache(maxsize=64)
def _block_edges(lens: ViewKey, degree: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """First row and column of each block, and one past the last: whole cells, at most BLOCK / (degree + 1) wide.

    At most WIDEST / (degree + 1) if the plan is too large to cache.
    """
    finest, widest = (max(1, int(side / (degree + 1) / largest_cell(lens))) for side in (BLOCK, WIDEST))
    rows: tuple[int, ...] = ()
    columns: tuple[int, ...] = ()
    for cells in range(finest, widest + 1):
        rows, columns = (tuple([*range(0, n, cells), n]) for n in lens[1:3])
        if _plan_bytes(rows, columns, degree) <= PLAN_BYTES:
            break
    return rows, columns


def _plan_bytes(rows: tuple[int, ...], columns: tuple[int, ...], degree: int) -> int:
    """The size of `_block_plan` for blocks between these edges."""
    return 8 * (len(rows) - 1) * (len(columns) - 1) * (degree + 1) ** 2


def largest_cell(lens: ViewKey) -> float:
    """The side (radians) of the cell in the middle of the view, where cells are largest."""
    _, height, width, _ = lens
    return math.sqrt(float(forward_view(lens).density(np.array(width / 2), np.array(height / 2))))


def _block_areas(lens: ViewKey, degree: int) -> np.ndarray:
    rows, columns = _block_edges(lens, degree)
    return pool(pool(forward_view(lens).weights, rows, -2), columns, -1)


def _block_plan(lens: ViewKey, degree: int) -> np.ndarray:
    """Integrals of the basis over every block ``(blocks, (degree + 1)^2)``."""
    rows, _ = _block_edges(lens, degree)
    return np.concatenate([_block_row(lens, degree, i) for i in range(len(rows) - 1)])


def _block_row(lens: ViewKey, degree: int, row: int) -> np.ndarray:
    """The same for one row of blocks: Gauss points in pixel coordinates, scaled to the block's exact solid angle."""
    grid = forward_view(lens)
    rows, columns = (np.asarray(edges) for edges in _block_edges(lens, degree))
    height, width = rows[row + 1] - rows[row], np.diff(columns)
    side = largest_cell(lens) * max(height, int(width.max()))
    waves = side * (degree + 1)  # two points integrate a block of normal size to 1e-5
    nodes, weights = np.polynomial.legendre.leggauss(2 if waves <= WIDEST else min(16, 2 + math.ceil(waves)))
    nodes, weights = (nodes + 1) / 2, weights / 2
    y = (rows[row] + height * nodes)[None, :, None]
    x = columns[:-1, None, None] + width[:, None, None] * nodes
    share = grid.density(x, y) * weights[:, None] * weights
    if isinstance(grid, FisheyeGrid):
        share = np.where(grid.project(grid.unproject(x, y))[2], share, 0.0)
    area = _block_areas(lens, degree)[row]
    total = share.sum(axis=(1, 2))
    share *= np.divide(area, total, out=np.zeros_like(area), where=total > 0)[:, None, None]
    basis = evaluate(degree, grid.unproject(x, y))
    return np.einsum("bij,bijn->bn", share, basis)


def pool(values: Array, edges: tuple[int, ...], axis: int) -> Array:
    """Sums of `values` between consecutive `edges` along `axis`."""
    xp = namespace(values)
    if len(edges) == values.shape[axis] + 1:
        return values
    if xp is np:
        return np.add.reduceat(values, np.asarray(edges[:-1]), axis=axis)
    total = xp.cumulative_sum(values, axis=axis)
    last = xp.take(total, table_like(np.asarray(edges[1:]) - 1, values), axis=axis)
    first = xp.zeros_like(xp.take(last, table_like(np.asarray([0]), values), axis=axis))
    kept = xp.take(last, table_like(np.arange(len(edges) - 2), values), axis=axis)
    return last - xp.concat([first, kept], axis=axis)
