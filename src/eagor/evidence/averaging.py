"""Averaging likelihood ratios over the angular error of a response.

The direction of a response is uncertain: a network's peak lies beside the thing, and a cell is a region. If the offset
has density k, the likelihood ratio of a target in direction omega is the mean of the ratios around it,

    r'(omega) = log integral k(angle(omega, omega')) exp(r(omega')) d omega',

not a mean of logarithms. Truncation at a low degree does average LOGARITHMS over its resolution: a small thing, however
surely seen, then ends up below a weak wide response. Averaged as a ratio first, it keeps nearly all of its height: a
tenth of the area costs 2.3 nats.

k is the heat kernel of the sphere, with spectrum exp(-l (l + 1) sigma^2 / 2); it is nearly Gaussian at these widths.

A view is first resampled to a panorama whose cells are finer than the kernel. Each pixel is shared among the four cells
around it, which keeps its centre and widens the kernel by 1 or 2 %. (Harmonics of so high a degree, integrated over
every pixel, would need a table of gigabytes.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, constant, namespace, recent
from eagor.grids import ErpGrid, FisheyeGrid, Grid, PatchGrid, ViewKey, forward_view, view_key
from eagor.harmonics import RealHarmonics
from eagor.harmonics.projection import largest_cell, lens_weights, pool

_MOST_POINTS = 1_000_000  # sample points of a view: at most half a kernel apart, even if pixels are very large
_MARGIN = 3.0  # nats: the truncated part of the kernel stays so far below the lowest ratio


def averaged(log_ratio: Array, grid: Grid, spread: float, least: float, most: float) -> tuple[Array, ErpGrid]:
    """r' of log ratios ``(..., H, W)`` on `grid`: values ``(..., H', W')`` and their grid of the whole sphere.

    `spread`: of the kernel, radians per axis. `least`, `most`: the lowest and the highest possible log ratio. Outside
    of `grid` the log ratio counts as 0: nothing is known there.
    """
    # Beyond this degree a kernel as high as the highest ratio has faded into the lowest.
    basis = RealHarmonics(math.ceil(math.sqrt(2 * (most - least + _MARGIN)) / spread))
    gain, whole, xp = _gain(basis, log_ratio, grid), basis.quadrature(1), namespace(log_ratio)
    gain = basis.synthesise(basis.smooth(gain, spread), whole)
    # 1 + gain, clipped: truncation may leave values below the lowest ratio.
    return xp.log1p(xp.clip(gain, math.expm1(least), math.expm1(most))), whole


def _gain(basis: RealHarmonics, log_ratio: Array, grid: Grid) -> Array:
    """Likelihood ratio minus 1, as coefficients ``(..., size)``."""
    values = namespace(log_ratio).expm1(log_ratio)
    if isinstance(grid, ErpGrid | PatchGrid):  # a coarse picture has no samples for so high a degree
        return basis.analyse(values, PatchGrid(*grid.shape))
    found = basis.analyse(_laid_out(values, view_key(grid), basis.degree), _panorama(basis.degree))
    ahead = np.array_equal(grid.body_R_view, np.eye(3))
    return found if ahead else basis.rotate(found, grid.body_R_view)


def _panorama(degree: int) -> ErpGrid:
    """The grid to which views are resampled: cells half as wide as the half wave of the finest harmonic."""
    return RealHarmonics(degree).quadrature(2)


def _laid_out(values: Array, lens: ViewKey, degree: int) -> Array:
    """`values` ``(..., h, w)`` of a view that looks forward as a density on `_panorama` ``(..., H, W)``, else 0."""
    xp = namespace(values)
    rows, columns = _blocks(lens, degree)
    sums = pool(pool(values * constant(lens_weights, lens, like=values), rows, -2), columns, -1)
    sums = xp.reshape(sums, (*sums.shape[:-2], -1))
    block, share, place = (recent(_part, lens, degree, index, like=values) for index in range(3))
    parts = pool(xp.take(sums, block, axis=-1) * share, _plan(lens, degree)[3], -1)
    cells = xp.concat([parts, xp.zeros_like(parts[..., :1])], axis=-1)
    cells = xp.take(cells, place, axis=-1)
    return xp.reshape(cells, (*values.shape[:-2], *_panorama(degree).shape))


@lru_cache(maxsize=4)
def _plan(lens: ViewKey, degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
    """How the blocks of a view are shared among the cells of the panorama, in parts.

    The block of each part, and its share of that block per steradian; the number of each cell of the panorama among
    those that get something, the last for none; and the edges between which the parts of one cell stand.
    """
    from scipy.sparse import csr_array

    panorama, view = _panorama(degree), forward_view(lens)
    x, y, block, share = _nodes(lens, degree)
    right, down, _ = panorama.project(view.unproject(x, y))
    cells, shares = [], []
    for cell, part in _four(panorama, right - 0.5, down - 0.5):
        cells.append(cell)
        shares.append(part * share)
    blocks = int(block.max()) + 1
    table = csr_array(
        (np.concatenate(shares), (np.concatenate(cells), np.tile(block, 4))), shape=(panorama.weights.size, blocks)
    )
    counts = np.diff(table.indptr)
    given = np.flatnonzero(counts)
    place = np.full(counts.shape, len(given), dtype=np.intp)
    place[given] = np.arange(len(given))
    density = table.data / np.repeat(panorama.weights.reshape(-1)[given], counts[given])
    edges = (0, *np.cumsum(counts[given]).tolist())
    return table.indices.astype(np.intp), density, place, edges


def _four(panorama: ErpGrid, u: np.ndarray, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The four cells around points ``(n,)``, in columns and rows from the first cell's centre, and each one's share."""
    left, top = np.floor(u), np.floor(v)
    for row, share in ((top, 1 - v + top), (top + 1, v - top)):
        over = (row < 0) | (row >= panorama.height)  # beyond a pole: half a turn further
        inside = np.clip(row, 0, panorama.height - 1)
        for column, part in ((left, 1 - u + left), (left + 1, u - left)):
            along = (column + over * (panorama.width // 2)) % panorama.width
            yield (inside * panorama.width + along).astype(np.intp), share * part


def _nodes(lens: ViewKey, degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sample points of a view: x and y ``(n,)`` in its pixels, the block that each is in, and its share of it."""
    view = forward_view(lens)
    rows, columns = (np.asarray(edges) for edges in _blocks(lens, degree))
    side = largest_cell(lens) * max(int(np.diff(rows).max()), int(np.diff(columns).max()))
    count = max(1, math.ceil(side / _half_cell(degree)))
    count = min(count, max(1, math.isqrt(_MOST_POINTS // ((len(rows) - 1) * (len(columns) - 1)))))
    (y, of_row), (x, of_column) = _fine(rows, count), _fine(columns, count)
    x, y = np.broadcast_arrays(x, y[:, None])
    share = view.density(x, y)
    if isinstance(view, FisheyeGrid):
        share = np.where(view.project(view.unproject(x, y))[2], share, 0.0)
    whole = share.reshape(len(rows) - 1, count, len(columns) - 1, count).sum(axis=(1, 3))[np.ix_(of_row, of_column)]
    share = np.divide(
        share, whole, out=np.full(share.shape, 1 / count**2), where=whole > 0
    )  # a rim: through its middle
    block = of_row[:, None] * (len(columns) - 1) + of_column
    return x.reshape(-1), y.reshape(-1), block.reshape(-1), share.reshape(-1)


def _fine(edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The middles of `count` equal parts between each two `edges`, and the number of the space that each lies in."""
    steps = (np.arange(count) + 0.5) / count
    inner = edges[:-1, None] + np.diff(edges)[:, None] * steps
    return inner.reshape(-1), np.repeat(np.arange(len(edges) - 1), count)


@lru_cache(maxsize=64)
def _blocks(lens: ViewKey, degree: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """First row and column of each block of pixels, and one past the last: at most half a cell of the panorama wide."""
    pixels = max(1, int(_half_cell(degree) / largest_cell(lens)))
    return tuple(tuple([*range(0, n, pixels), n]) for n in lens[1:3])  # type: ignore[return-value]


def _half_cell(degree: int) -> float:
    return math.pi / _panorama(degree).height / 2


def _part(lens: ViewKey, degree: int, index: int) -> np.ndarray:
    return np.asarray(_plan(lens, degree)[index])
