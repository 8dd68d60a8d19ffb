"""From values on a grid to coefficients, and back.

- Equirectangular pixels: samples at their centres, Fejer weights, exact for band-limited fields.
- Patches: a constant value per cell, each basis function integrated exactly over the cell.
- Views (perspective, fisheye): the cells are gathered into blocks much smaller than the finest harmonic, and the basis
  is integrated over each block by Gauss points. The plan depends on the lens, not on the pose: coefficients are
  computed in the view's frame and rotated into the body's.

The first two are separable: one matrix product over longitude, one small one per order over latitude.

The latitude part of all orders together has (2 degree + 1) (degree + 1) rows numbers: gigabytes from degree 200 on.
Where it is too large, it is computed for a few orders at a time, used, and dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

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
from eagor.harmonics.legendre import degrees, evaluate, latitude_functions_of, latitude_table, longitude_table, orders
from eagor.harmonics.rotation import rotate
from eagor.sphere import check_directions

BLOCK = 0.25  # side of a view's block, in units of the angular scale 1 / (degree + 1)
WIDEST = 2 * BLOCK  # the largest side, for plans that would take too much memory otherwise
SMALL = 1_000_000  # OpenBLAS has special kernels for products up to 100^3
TABLE_BYTES = 64e6  # a larger latitude table is recomputed at every call, a few orders at a time
PLAN_BYTES = 256e6  # a view plan that is larger even so is computed block row by block row and not cached


def analyse(degree: int, values: Array, grid: Grid) -> Array:
    """Coefficients ``(..., (degree + 1)^2)`` of `values` ``(..., H, W)`` on `grid`: the integrals of values * Y_lm."""
    if isinstance(grid, ErpGrid | PatchGrid):
        xp = namespace(values)
        # (..., H, W) @ (W, 2L+1) -> (2L+1, H, ...) ; the long sum runs in the precision of the values.
        rings = _product(values, constant(_longitude_plan, degree, grid, like=values))
        if _is_large(degree, grid.height):
            batch = rings.shape[:-2]
            rings = xp.permute_dims(xp.reshape(rings, (-1, *rings.shape[-2:])), (2, 1, 0))
            packed = analysed(degree, rings, *_rows(degree, grid))
            packed = xp.reshape(packed, (-1, packed.shape[-1])).T
            return xp.reshape(xp.take(packed, constant(_unpack, degree, like=rings), axis=1), (*batch, -1))
        if values.ndim == 2:
            packed = constant(_latitude_plan, degree, grid, like=rings) @ rings.T[..., None]
            return xp.take(xp.reshape(packed, (-1,)), constant(_unpack, degree, like=rings))
        batch = rings.shape[:-2]
        rings = xp.reshape(rings, (-1, *rings.shape[-2:]))
        packed = constant(_latitude_plan, degree, grid, like=rings) @ xp.permute_dims(rings, (2, 1, 0))
        packed = xp.reshape(packed, (-1, packed.shape[-1])).T
        found = xp.take(packed, constant(_unpack, degree, like=rings), axis=1)
        return xp.reshape(found, (*batch, found.shape[-1]))
    return _analyse_view(degree, values, grid)


def synthesise(degree: int, coefficients: Array, where: Grid | ErpWindow | Array) -> Array:
    """Values of the field: ``(..., H, W)`` on a grid, or ``(..., n...)`` at an array of directions ``(n..., 3)``."""
    xp = namespace(coefficients)
    if isinstance(where, ErpGrid | PatchGrid | ErpWindow):
        whole = where.whole if isinstance(where, ErpWindow) else where
        if isinstance(where, ErpGrid | PatchGrid) and _is_large(degree, where.height):
            packed = xp.take(coefficients, constant(_pack, degree, like=coefficients), axis=-1)
            packed = xp.permute_dims(xp.reshape(packed, (-1, 2 * degree + 1, degree + 1)), (1, 0, 2))
            rings = synthesised(degree, packed, np.sin(ErpGrid(where.height, 1).latitudes))
            over_columns = constant(_longitude_values, degree, where.width, like=coefficients)
            found = xp.permute_dims(rings, (1, 2, 0)) @ over_columns
            return xp.reshape(found, (*coefficients.shape[:-1], *where.shape))
        over_rows = constant(_latitude_values, degree, whole.height, like=coefficients)
        over_columns = constant(_longitude_values, degree, whole.width, like=coefficients)
        if isinstance(where, ErpWindow):
            over_rows = over_rows[..., where.top : where.top + where.rows]
            over_columns = xp.take(over_columns, table_like(where.columns, coefficients), axis=1)
        packed = xp.take(coefficients, constant(_pack, degree, like=coefficients), axis=-1)
        packed = xp.permute_dims(xp.reshape(packed, (-1, 2 * degree + 1, degree + 1)), (1, 0, 2))
        rings = xp.reshape(packed @ over_rows, (2 * degree + 1, -1))
        return xp.reshape(xp.matrix_transpose(rings) @ over_columns, (*coefficients.shape[:-1], *where.shape))
    points = where.directions if isinstance(where, PerspectiveGrid | FisheyeGrid) else as_float(where)
    check_directions(points)
    if xp is np:
        points = to_numpy(points).astype(coefficients.dtype, copy=False)
        flat = points.reshape(-1, 3)
        parts = [coefficients @ evaluate(degree, flat[i : i + 512]).T for i in range(0, len(flat), 512)]
        values = np.concatenate(parts, axis=-1) if parts else np.zeros((*coefficients.shape[:-1], 0))
        return values.reshape((*coefficients.shape[:-1], *points.shape[:-1]))
    if isinstance(points, np.ndarray):
        points = table_like(points, coefficients)
    basis = evaluate(degree, xp.reshape(points, (-1, 3)))
    return xp.reshape(coefficients @ basis.T, (*coefficients.shape[:-1], *points.shape[:-1]))


def _product(values: Array, table: Array) -> Array:
    """``values @ table``; a large single map in strips of SMALL multiplications, for BLAS's small kernels."""
    if values.ndim != 2 or not isinstance(values, np.ndarray) or values.size * table.shape[1] < 4 * SMALL:
        return values @ table
    rows = max(1, SMALL // table.size)
    return np.concatenate([values[start : start + rows] @ table for start in range(0, len(values), rows)])


def _longitude_plan(degree: int, grid: ErpGrid | PatchGrid) -> np.ndarray:
    """Integrals over each column of the sines and cosines ``(W, 2 degree + 1)``, signed order."""
    plan = longitude_table(degree, grid.longitudes) * (2 * math.pi / grid.width)
    if isinstance(grid, PatchGrid):  # the mean over a cell is the value at its centre times a sinc
        plan *= np.sinc(np.arange(-degree, degree + 1) / grid.width)
    return plan


def _is_large(degree: int, height: int) -> bool:
    """Whether the latitude table of a grid with this many rows is computed in pieces and not cached."""
    return 8 * (2 * degree + 1) * (degree + 1) * height > TABLE_BYTES


def _latitude_plan(degree: int, grid: ErpGrid | PatchGrid) -> np.ndarray:
    """Integrals over each row of the latitude functions ``(2 degree + 1, degree + 1, H)``."""
    sines, integrals = _rows(degree, grid)
    return integrals(latitude_table(degree, sines))


def _rows(degree: int, grid: ErpGrid | PatchGrid) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Sines ``(n,)`` of latitudes, and a function from values there to integrals over the rows ``(..., H)``."""
    if isinstance(grid, ErpGrid):
        return np.sin(grid.latitudes), lambda table: table * fejer_weights(grid.height)
    # The integrand is a trigonometric polynomial of degree + 1 in latitude: Gauss points converge to rounding.
    half_row = math.pi / grid.height / 2
    count = 8 + math.ceil((degree + 1) * half_row)
    nodes, weights = np.polynomial.legendre.leggauss(count)
    latitudes = grid.latitudes[:, None] + half_row * nodes
    area = half_row * weights * np.cos(latitudes)
    return np.sin(latitudes).ravel(), lambda table: np.einsum(
        "...hc,hc->...h", table.reshape(*table.shape[:-1], *area.shape), area
    )


def _latitude_values(degree: int, height: int) -> np.ndarray:
    """Latitude functions at the row centres ``(2 degree + 1, degree + 1, H)``."""
    return latitude_table(degree, np.sin(ErpGrid(height, 1).latitudes))


def _longitude_values(degree: int, width: int) -> np.ndarray:
    """Sines and cosines at the column centres ``(2 degree + 1, W)``."""
    return longitude_table(degree, ErpGrid(1, width).longitudes).T


@lru_cache(maxsize=64)
def _unpack(degree: int) -> np.ndarray:
    """The index of coefficient i in the flattened (order, degree) table."""
    return (orders(degree) + degree) * (degree + 1) + degrees(degree)


@lru_cache(maxsize=64)
def _pack(degree: int) -> np.ndarray:
    """For each entry of the (order, degree) table, its coefficient; an arbitrary one (the first) where l < |m|."""
    packed = np.zeros((2 * degree + 1) * (degree + 1), dtype=np.intp)
    packed[_unpack(degree)] = np.arange((degree + 1) ** 2)
    return packed


def _analyse_view(degree: int, values: Array, grid: Grid) -> Array:
    """For views: block means times block integrals, in the view's own frame, then one rotation."""
    if not isinstance(grid, PerspectiveGrid | FisheyeGrid):
        raise TypeError(f"cannot analyse values on a {type(grid).__name__}; wanted one of the grids of eagor.grids")
    xp = namespace(values)
    lens = view_key(grid)
    rows, columns = _block_edges(lens, degree)
    weights = constant(_lens_weights, lens, like=values)
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


def _lens_weights(lens: ViewKey) -> np.ndarray:
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


_BLOCK_BYTES = 1 << 25

Made = Callable[[np.ndarray], np.ndarray]


def analysed(degree: int, rings: Array, sines: np.ndarray, made: Made) -> Array:
    """Coefficients by signed order and degree ``(2 degree + 1, degree + 1, B)`` of `rings` ``(2 degree + 1, H, B)``.

    `made` turns latitude functions ``(..., n)`` at `sines` ``(n,)`` into their integrals over the rows ``(..., H)``.
    """
    xp = namespace(rings)
    sine, cosine = [], []
    for first, last, table in _blocks(degree, sines):
        table = table_like(made(table), rings)
        cosine.append(table @ rings[degree + first : degree + last, ...])
        sine.append(table @ xp.flip(rings[degree - last + 1 : degree - first + 1, ...], axis=0))
    return _signed(xp, sine, cosine)


def synthesised(degree: int, packed: Array, sines: np.ndarray) -> Array:
    """The rings ``(2 degree + 1, B, H)`` at `sines` ``(H,)`` of coefficients ``(2 degree + 1, B, degree + 1)``."""
    xp = namespace(packed)
    sine, cosine = [], []
    for first, last, table in _blocks(degree, sines):
        table = table_like(table, packed)
        cosine.append(packed[degree + first : degree + last, ...] @ table)
        sine.append(xp.flip(packed[degree - last + 1 : degree - first + 1, ...], axis=0) @ table)
    return _signed(xp, sine, cosine)


def _blocks(degree: int, sines: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """First and last order (exclusive) of each block, with its latitude functions ``(orders, degree + 1, n)``."""
    most = max(1, math.floor(_BLOCK_BYTES / (8 * (degree + 1) * sines.size)))
    for first in range(0, degree + 1, most):
        last = min(first + most, degree + 1)
        yield first, last, latitude_functions_of(degree, sines, first, last)


def _signed(xp: Any, sine: list[Array], cosine: list[Array]) -> Array:
    """Both by signed order, from -degree to degree."""
    below = xp.flip(xp.concat(sine), axis=0)
    return xp.concat([below[:-1, ...], *cosine])
