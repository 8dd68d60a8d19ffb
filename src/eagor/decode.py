"""Reading a belief: peaks, modes, regions and integrals of a field f whose exponential is a density on the sphere.

`peak` is the fast path (one synthesis, one argmax, one quadratic fit). `Posterior` holds exp(f) on a grid fine
enough for its sharpest peak and answers the rest. Both work on NumPy; `peak` on any array kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from eagor._arrays import Array, constant, namespace
from eagor.grids import ErpGrid
from eagor.harmonics import RealHarmonics

CELLS_PER_SIGMA = 3.0  # grid spacing against the width of the sharpest peak
MAX_ROWS = 512  # 0.35 degrees: nothing that a camera robot asks for is finer
NEGLIGIBLE = 18.0  # nats below the top: what lies there holds less than 1e-4 of the sharpest belief
PROMINENCE = 0.7  # nats: a peak counts as a mode if it stands out by a factor of two from the saddle around it
MIN_WEIGHT = 0.02  # ... and holds at least this share of the belief


def decoding_grid(degree: int) -> ErpGrid:
    """The grid on which a field of this degree is searched for its peak: four rows per degree."""
    rows = max(48, 4 * (degree + 1))
    return ErpGrid(rows, 2 * rows)


def peak(degree: int, coefficients: Array) -> Array:
    """Directions ``(..., 3)`` of the maxima of fields ``(..., size)``: on a grid, then to a fraction of its spacing.

    Where a field is constant every direction is a maximum, and forward (1, 0, 0) is returned.
    """
    grid = decoding_grid(degree)
    values = RealHarmonics(degree).synthesise(coefficients, grid)
    return peak_on_grid(grid, values)


def peak_on_grid(grid: ErpGrid, values: Array) -> Array:
    """Directions ``(..., 3)`` of the maxima of fields ``(..., H, W)``, refined by a quadratic fit to nine values."""
    if type(values) is np.ndarray and values.ndim == 2:
        flat = values.reshape(-1)
        best = int(flat.argmax())
        if flat[best] == flat[0] and not (flat - flat[0]).any():
            return np.array([1.0, 0.0, 0.0])
        return _refine_one(grid, flat, best)[0]
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
    flatland = xp.max(flat, axis=-1) == xp.min(flat, axis=-1)
    forward = xp.zeros_like(moved)
    forward = forward + constant(_forward, like=values)
    return xp.where(flatland[..., None], forward, moved)


def derivatives(grid: ErpGrid, values: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Gradient (u, v) and Hessian (uu, uv, vv) ``(..., H, W)`` of fields ``(..., H, W)``: u left, v up, per radian."""
    xp = namespace(values)
    flat = xp.reshape(values, (*values.shape[:-2], -1))
    nine = xp.take(flat, constant(_stencil_index, grid, like=values), axis=-1)
    nine = xp.reshape(nine, (*values.shape, 9))
    found = constant(_fit, grid, like=values)[:, None] @ nine[..., None]
    return tuple(found[..., i, 0] for i in range(5))  # type: ignore[return-value]


def _dot(a: Array, b: Array) -> Array:
    return namespace(a).sum(a * b, axis=-1)


def _forward() -> np.ndarray:
    return np.array([1.0, 0.0, 0.0])


def _refine_one(grid: ErpGrid, flat: np.ndarray, best: int) -> tuple[np.ndarray, float]:
    """Direction of the maximum near cell `best`, and the width (standard deviation, radians) of exp(f) across it."""
    width = grid.width
    row, column = divmod(best, width)
    rows, columns = _stencil(grid)[row]
    gu, gv, huu, huv, hvv = (_fit(grid)[row] @ flat[rows * width + (column + columns) % width]).tolist()
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


@dataclass(frozen=True, eq=False)
class CredibleRegion:
    """The smallest part of the sphere that holds `mass` of a belief (highest-density region).

    `area` in steradians; `angle` (radians): half-angle of the cone about the `mode` that holds the same mass, which
    for several modes is wide, as it should be; `threshold`: the log-density (per steradian) at the region's border.
    """

    mass: float
    threshold: float
    area: float
    angle: float
    mode: np.ndarray
    log_density: Callable[[np.ndarray], np.ndarray]

    def contains(self, directions: np.ndarray) -> np.ndarray:
        """Which of the directions ``(..., 3)`` lie in the region, bool ``(...)``."""
        return self.log_density(np.asarray(directions)) >= self.threshold - 1e-9


@dataclass(frozen=True, eq=False)
class Posterior:
    """exp(f) on a grid that resolves its sharpest peak. One belief, no batch.

    `field` ``(H, W)`` is f on `grid`; `coarse` is f on a grid that resolves f itself, where peaks and basins are
    looked for.
    """

    grid: ErpGrid
    field: np.ndarray
    coarse: np.ndarray

    @classmethod
    def resolve(cls, field: Callable[[ErpGrid], np.ndarray], rows: int) -> Posterior:
        """Evaluate `field` on `rows` rows, and again on as many as its sharpest peak asks for."""
        grid = ErpGrid(rows, 2 * rows)
        values = field(grid)
        _, sigma = _refine_one(grid, values.reshape(-1), int(values.argmax()))
        wanted = CELLS_PER_SIGMA * math.pi / sigma
        times = min(math.ceil(wanted / rows), max(1, MAX_ROWS // rows))
        if times <= 1:
            return cls(grid, values, values)
        grid = ErpGrid(times * rows, 2 * times * rows)
        return cls(grid, field(grid), values)

    @cached_property
    def log_total(self) -> float:
        """log of the integral of exp(f) over the sphere."""
        top = float(self.field.max())
        return top + math.log(float(np.sum(np.exp(self.field - top) * self.grid.weights)))

    @cached_property
    def probability(self) -> np.ndarray:
        """Probability of each cell ``(H, W)``; sums to 1."""
        return np.exp(self.field - self.log_total) * self.grid.weights

    @cached_property
    def mode(self) -> np.ndarray:
        """The direction of highest density ``(3,)``."""
        return peak_on_grid(ErpGrid(*self.coarse.shape), self.coarse)

    def entropy(self) -> float:
        """Differential entropy in nats; log(4 pi) = 2.53 for the uniform belief."""
        return self.log_total - float(np.sum(self.probability * self.field))

    def cone(self, mass: float) -> float:
        """Half-angle (radians) of the cone about the mode that holds `mass`."""
        keep = self.field > self.field.max() - NEGLIGIBLE
        cosine, probability = self.grid.directions[keep] @ self.mode, self.probability[keep]
        order = np.argsort(-cosine)
        cosine, probability = cosine[order], probability[order]
        reached = np.cumsum(probability) - probability / 2
        return math.acos(min(1.0, float(np.interp(mass, reached, cosine))))

    def level(self, mass: float) -> tuple[float, float]:
        """The value of f above which `mass` lies, and the solid angle above it.

        Cells that the border cuts count in part: f is taken as uniform over the range that its slope spans in the cell.
        """
        top = float(self.field.max())
        rows = np.flatnonzero(self.field.max(axis=1) > top - NEGLIGIBLE)
        band = slice(rows[0], rows[-1] + 1)
        f, probability, weights = self.field[band], self.probability[band], self.grid.weights[band]
        side = (np.roll(f, -1, axis=1) - np.roll(f, 1, axis=1)) / 2
        spread = np.maximum(np.hypot(side, np.gradient(f, axis=0) if len(f) > 1 else 0.0), 1e-9)
        keep = f > top - NEGLIGIBLE
        p, v, s = probability[keep], f[keep], spread[keep]
        low, high = float(v.min()) - 1, top + 1
        for _ in range(40):
            middle = (low + high) / 2
            if float(np.sum(p * np.clip(0.5 + (v - middle) / s, 0, 1))) >= mass:
                low = middle
            else:
                high = middle
        return low, float(np.sum(weights[keep] * np.clip(0.5 + (v - low) / s, 0, 1)))

    def modes(self, count: int, prominence: float, min_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` and weights ``(n,)`` of at most `count` modes, highest density first.

        Each cell climbs to its peak; basins whose peak stands less than `prominence` nats above the saddle to a higher
        one join that one. A mode's weight is the probability of its basin.
        """
        height, width = self.coarse.shape
        label = _merge(self.coarse, _climb(self.coarse), prominence)
        peaks, inverse = np.unique(label, return_inverse=True)
        fine = self.probability.reshape(height, self.grid.height // height, width, self.grid.width // width)
        weight = np.bincount(inverse.reshape(-1), fine.sum(axis=(1, 3)).reshape(-1))
        flat = self.coarse.reshape(-1)
        order = [i for i in np.argsort(-flat[peaks]) if weight[i] >= min_weight][:count]
        if not order:
            order = [int(np.argmax(flat[peaks]))]
        if len(peaks) == 1:
            return self.mode[None], weight
        grid = ErpGrid(height, width)
        return np.array([_refine_one(grid, flat, int(peaks[i]))[0] for i in order]), weight[order]


def _over_pole(row: np.ndarray) -> np.ndarray:
    """The row ``(1, W)`` that lies beyond the pole from this one."""
    return np.roll(row, row.shape[1] // 2, axis=1)


def _neighbours(values: np.ndarray) -> list[np.ndarray]:
    """`values` ``(H, W)`` of each cell's right, lower-left, lower and lower-right neighbours, then the opposites."""
    tall = np.concatenate([_over_pole(values[:1]), values, _over_pole(values[-1:])])
    shifts = [(1, -1), (2, 1), (2, 0), (2, -1), (1, 1), (0, -1), (0, 0), (0, 1)]
    return [np.roll(tall[row : row + len(values)], side, axis=1) for row, side in shifts]


def _climb(field: np.ndarray) -> np.ndarray:
    """For each cell, the index of the peak that steepest ascent leads to ``(H, W)``."""
    index = np.arange(field.size).reshape(field.shape)
    best, target = field.copy(), index.copy()
    for value, where in zip(_neighbours(field), _neighbours(index), strict=True):
        # Equal values lead to the larger index, so that plateaus have one peak and no cycles.
        better = (value > best) | ((value == best) & (where > target))
        best, target = np.where(better, value, best), np.where(better, where, target)
    target = target.reshape(-1)
    while True:
        further = target[target]
        if np.array_equal(further, target):
            return target.reshape(field.shape)
        target = further


def _merge(field: np.ndarray, label: np.ndarray, prominence: float) -> np.ndarray:
    """Labels after basins that do not stand out have joined a higher neighbour (persistence, highest saddle first)."""
    saddles: dict[tuple[int, int], float] = {}
    for value, other in zip(_neighbours(field)[:4], _neighbours(label)[:4], strict=True):
        border = label != other
        height = np.minimum(field[border], value[border])
        for a, b, h in zip(label[border].tolist(), other[border].tolist(), height.tolist(), strict=True):
            key = (a, b) if a < b else (b, a)
            if h > saddles.get(key, -math.inf):
                saddles[key] = h
    flat = field.reshape(-1)
    parent = {int(peak): int(peak) for peak in np.unique(label)}

    def root(peak: int) -> int:
        while parent[peak] != peak:
            peak = parent[peak]
        return peak

    for (a, b), height in sorted(saddles.items(), key=lambda item: -item[1]):
        low, high = sorted((root(a), root(b)), key=lambda peak: flat[peak])
        if low != high and flat[low] - height < prominence:
            parent[low] = high
    table = np.arange(flat.size)
    for peak in parent:
        table[peak] = root(peak)
    return table[label]
