"""A field on the sphere: a coarse grid of the whole sphere, and fine patches about its peaks.

Between the nodes of a patch values are cubic splines, mirrored at the borders: the same as
``scipy.ndimage.map_coordinates(..., order=3, mode="mirror")``, but vectorised over points, and with weights shared by
fields on the same nodes: under half of SciPy's time for one field, under a third for three. Beside a steep flank of
hundreds of nats a spline swings by many, which `over` limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._arrays import frozen
from eagor._values import altered, inherited, known, lazy
from eagor.grids import ErpGrid, ErpWindow, PatchGrid, beyond_edges

if TYPE_CHECKING:
    from typing_extensions import Self


def interpolated(
    values: np.ndarray, places: np.ndarray, over: float | None = None, spline: np.ndarray | None = None
) -> np.ndarray:
    """Fields ``(..., n_1, ..., n_d)`` at `places` ``(d, m...)``, counted in nodes from 0 to n - 1: ``(..., m...)``.

    By at most `over` they exceed the nodes around a place. `spline`: that of the values, if it is known.
    """
    shape = values.shape[-len(places) :]
    lower = places.astype(np.intp).reshape(len(places), -1)
    weights = np.stack(_weights(places.reshape(lower.shape) - lower), axis=1)
    first = np.zeros(lower.shape[1], dtype=np.intp)
    for axis, count in enumerate(shape):
        first = first * (count + 3) + lower[axis]
    coefficients = spline_through(values, len(shape)) if spline is None else spline
    near = coefficients.reshape(-1, coefficients[(0,) * (values.ndim - len(shape))].size)
    near = near.take(first + _neighbours(shape), axis=1).reshape(len(near), *[4] * len(shape), len(first))
    for weight in weights[::-1]:
        near = np.einsum("...an,an->...n", near, weight)
    if over is not None:
        corners = values.reshape(-1, math.prod(shape)).take(_first(lower, shape) + _corners(shape), axis=1)
        near = np.clip(near, corners.min(axis=1) - over, corners.max(axis=1) + over)
    return near.reshape(*values.shape[: -len(shape)], *places.shape[1:])


def spline_through(values: np.ndarray, dimensions: int) -> np.ndarray:
    """The coefficients ``(..., n_1 + 3, ..., n_d + 3)`` of the splines through fields ``(..., n_1, ..., n_d)``."""
    for axis in range(-dimensions, 0):
        values = np.swapaxes(np.swapaxes(values, axis, -1) @ _coefficients(values.shape[axis]), axis, -1)
    return values


def _first(lower: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The flat index ``(m,)`` of the node below each of m places, the last but one at the upper border."""
    highest = np.array(shape)[:, None] - 2
    return np.asarray(np.ravel_multi_index(tuple(np.minimum(lower, highest)), shape))


@lru_cache(maxsize=16)
def _corners(shape: tuple[int, ...]) -> np.ndarray:
    """How far behind the node below a place each of the nodes around it lies ``(2^d, 1)``."""
    return np.ravel_multi_index(np.ix_(*[np.arange(2)] * len(shape)), shape).reshape(-1, 1)


def _weights(beyond: Any) -> list[Any]:
    """Of the four nodes around points of which the second lies `beyond` ``(...)`` before them: the cubic B-spline."""
    short = 1 - beyond
    squared, rest = beyond * beyond, short * short
    return [rest * short / 6, 2 / 3 - squared * (1 - beyond / 2), 2 / 3 - rest * (1 - short / 2), squared * beyond / 6]


@lru_cache(maxsize=16)
def _coefficients(count: int) -> np.ndarray:
    """From `count` values to the coefficients of the spline through them ``(count, count + 3)``.

    One before and two beyond the nodes are mirrored.
    """
    at = np.abs(np.arange(-1, count + 2))
    mirrored = np.eye(count)[np.where(at >= count, 2 * count - 2 - at, at)]
    sampled = (mirrored[:-3] + 4 * mirrored[1:-2] + mirrored[2:-1]) / 6  # the spline at its nodes
    return np.linalg.solve(sampled.T, mirrored.T)


@lru_cache(maxsize=16)
def _neighbours(shape: tuple[int, ...]) -> np.ndarray:
    """How far behind the first of the 4^d coefficients around a point each of them lies ``(4^d, 1)``."""
    places = np.ix_(*[np.arange(4)] * len(shape))
    return np.ravel_multi_index(places, [count + 3 for count in shape]).reshape(-1, 1)


MARGIN = 4  # cells of padding that interpolation needs
LARGEST = 700.0  # nats: the exponential still fits a float64
FINER = 4  # refinement (per side) of patches and heavy cells where masses are summed
EVEN = 1e-3  # a smaller bend counts as 0


@dataclass(frozen=True, eq=False)
class Nodes:
    """Values ``(..., n, n)`` on the tangent plane at the direction ``frame[0]`` (gnomonic projection).

    `frame` ``(3, 3)``: that direction and the axes u, v of the plane, as rows. `half` ``(2,)``: half widths, in units
    of the plane (tangents of angles). `bend` b ``(2,)``: along each axis the node at t in [-1, 1], evenly spaced, lies
    at sinh(b t) / sinh(b) of that: dense in the middle, far apart at the borders.
    """

    frame: np.ndarray
    half: np.ndarray
    values: np.ndarray
    bend: np.ndarray = field(default_factory=lambda: np.full(2, EVEN))

    def like(self, values: np.ndarray) -> Self:
        """The same nodes with other values; cached geometry is kept."""
        return inherited(altered(self, values=values), self, "directions", "weights", "spacing", "_scale")

    @lazy
    def directions(self) -> np.ndarray:
        """Unit vectors ``(n, n, 3)`` of the nodes."""
        return plane_directions(self.values.shape[-1], self.frame, self.half, self.bend)

    @lazy
    def weights(self) -> np.ndarray:
        """Solid angles ``(n, n)`` of the nodes."""
        return plane_weights(self.values.shape[-1], self.half, self.bend)

    @lazy
    def spacing(self) -> np.ndarray:
        """Spacing ``(2,)`` of the nodes in the middle, in units of the plane."""
        return 2 / (self.values.shape[-1] - 1) * self.half * self.bend / np.sinh(self.bend)

    @lazy
    def _scale(self) -> np.ndarray:
        return np.sinh(self.bend) / self.half

    def located(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The t ``(2, ...)`` of directions ``(..., 3)`` of any length, and their components ``(...)`` along the middle.

        Where a component is not above 0, the t are meaningless.
        """
        local = (self.frame @ directions.reshape(-1, 3).T).reshape(3, *directions.shape[:-1])
        across = local[1:] / np.maximum(local[0], 1e-6)
        shape = (2, *[1] * (across.ndim - 1))
        return np.arcsinh(across * self._scale.reshape(shape)) / self.bend.reshape(shape), local[0]

    def places(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The t ``(2, ...)`` of directions ``(..., 3)``, -1 to 1, and which of them lie inside."""
        found, ahead = self.located(directions)
        return found, (ahead > 0) & (np.abs(found).max(axis=0) <= 1)


@dataclass(frozen=True, eq=False)
class Patch(Nodes):
    """A part of a field on the sphere: values ``(n, n)``."""

    def cells(self, grid: ErpGrid) -> np.ndarray:
        """The flat indices ``(m,)`` of the cells of a grid whose middles lie inside."""
        directions = grid.directions.reshape(-1, 3)
        near = (directions @ self.frame[0] > self.least_ahead).nonzero()[0]
        return near[self.places(directions.take(near, axis=0))[1]]

    def at(self, places: np.ndarray) -> np.ndarray:
        """Values at coordinates ``(2, m)`` as `places` gives them, by a cubic spline."""
        return interpolated(self.values, (places + 1) * ((self.values.shape[0] - 1) / 2), spline=self._spline)

    @lazy
    def _spline(self) -> np.ndarray:
        return spline_through(self.values, 2)

    def finer(self) -> np.ndarray:
        """Values ``(m, m)`` at nodes `FINER` times as dense, m = (n - 1) FINER + 1, by the same spline."""
        table = _refining(len(self.values), FINER)
        return table @ self.values @ table.T

    @property
    def top(self) -> np.ndarray:
        """The direction ``(3,)`` of the node with the highest value."""
        return self.directions.reshape(-1, 3)[int(self.values.argmax())]

    @property
    def least_ahead(self) -> float:
        """The cosine of the angle from the middle to a corner."""
        return 1 / math.sqrt(1 + float(self.half @ self.half)) - 1e-12


@lru_cache(maxsize=16)
def _refining(count: int, times: int) -> np.ndarray:
    """From values at `count` nodes along an axis to those at nodes `times` as dense, a matrix ``(m, count)``."""
    fine = np.linspace(0, count - 1, (count - 1) * times + 1)
    return interpolated(np.eye(count), fine[None]).T


def cells_of(grid: ErpGrid | PatchGrid, directions: np.ndarray) -> np.ndarray:
    """The flat index ``(...)`` of the cell of a grid that each direction ``(..., 3)`` lies in."""
    x, y, _ = grid.project(directions)
    return np.minimum(y.astype(np.intp), grid.height - 1) * grid.width + x.astype(np.intp) % grid.width


@lru_cache(maxsize=16)
def even(count: int) -> np.ndarray:
    """`count` numbers from -1 to 1."""
    return frozen(np.linspace(-1, 1, count))


def bent(at: np.ndarray, half: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates ``(2, n)`` on the plane of nodes at t = `at` ``(n,)``, and their derivatives by t."""
    scale, steps = (half / np.sinh(bend))[:, None], bend[:, None] * at
    return scale * np.sinh(steps), scale * bend[:, None] * np.cosh(steps)


def blurred(patch: Patch, sigma: float, reach: float) -> Patch:
    """The density exp(values) convolved with a Gaussian of `sigma` radians, on a patch that has room for it.

    `reach`: standard deviations from the middle of a patch to its border. The plane is treated as flat: sigma is small.
    """
    half = np.hypot(patch.half, reach * math.tan(sigma))
    # Splines between nodes swing beside a steep peak: they are for nodes that are not dense against the blur.
    values = patch.values if float(patch.spacing.max()) < sigma / 3 else patch.finer()
    top = float(patch.values.max())
    new = bent(even(len(patch.values)), half, patch.bend)[0]
    old = bent(even(len(values)), patch.half, patch.bend)[0]
    first, second = (_convolving(x, u, sigma) for x, u in zip(new, old, strict=True))
    density = first @ np.exp(values - top) @ second.T
    return Patch(patch.frame, half, np.log(np.maximum(density, 1e-300)) + top, patch.bend)


def _convolving(x: np.ndarray, u: np.ndarray, sigma: float) -> np.ndarray:
    """The matrix ``(m, n)`` that takes values at nodes `u` ``(n,)`` to those at `x` ``(m,)`` after a convolution.

    With a Gaussian of this sigma, of the function that is linear between the nodes and 0 beyond them. Where they are
    dense it is a sum over them: differences of the Gaussian's second integral would cancel.
    """
    from scipy.special import ndtr

    gaps = np.diff(u)
    z = (x[:, None] - u) / sigma
    bell = np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi)
    rise = np.diff(sigma * (z * ndtr(z) + bell), axis=1) / gaps  # minus that of each ramp
    above = ndtr(z)
    exact = np.hstack([above[:, :1] + rise[:, :1], np.diff(rise, axis=1), -rise[:, -1:] - above[:, -1:]])
    shares = (np.append(gaps, 0.0) + np.append(0.0, gaps)) / 2
    return np.where(shares < sigma / 3, shares * bell / sigma, exact)


def plane_directions(count: int, frame: np.ndarray, half: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Unit vectors ``(count, count, 3)`` of nodes on the plane of a `Patch`; the first axis is u."""
    (u, v), _ = bent(even(count), half, bend)
    plane = frame[0] + u[:, None, None] * frame[1] + v[None, :, None] * frame[2]
    return plane / np.sqrt(np.einsum("...i,...i->...", plane, plane))[..., None]


def plane_weights(count: int, half: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Solid angles ``(count, count)`` of such nodes: du dv / (1 + u^2 + v^2)^(3/2), half of it at a border."""
    share = np.full(count, 2 / (count - 1))
    share[[0, -1]] /= 2
    (u, v), (du, dv) = bent(even(count), half, bend)
    return (share * du)[:, None] * (share * dv) * (1 + (u * u)[:, None] + v * v) ** -1.5


@dataclass(frozen=True, eq=False)
class SphereField:
    """`values` ``(H, W)`` on a `grid` of the whole sphere; patches replace the values where they lie."""

    grid: ErpGrid
    values: np.ndarray
    patches: tuple[Patch, ...] = ()

    def __call__(self, where: ErpGrid | ErpWindow | np.ndarray) -> np.ndarray:
        """The field on a grid ``(H, W)``, or at unit vectors ``(..., 3)``."""
        if not self.patches:
            return self.smooth(where)
        if not isinstance(where, np.ndarray):
            found = self.smooth(where)
            return self.with_patches(found.reshape(-1), where.directions.reshape(-1, 3)).reshape(found.shape)
        directions = where.reshape(-1, 3)
        found, inside = self._in_patches(directions)
        around = (~inside).nonzero()[0]
        if len(around):
            found[around] = self.smooth(directions[around])
        return found.reshape(where.shape[:-1])

    def with_patches(self, values: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """`values` ``(n,)`` at directions ``(n, 3)``, replaced by those of the patches where they lie."""
        found, inside = self._in_patches(directions)
        return np.where(inside, found, values)

    def _in_patches(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values ``(n,)`` of the patches at directions ``(n, 3)``, and the mask ``(n,)`` of where they lie."""
        found, nearest = np.zeros(len(directions)), np.full(len(directions), np.inf)
        for patch in self.patches:
            near = np.flatnonzero(directions @ patch.frame[0] > patch.least_ahead)
            if not len(near):
                continue
            places, inside = patch.places(directions[near])
            depth = np.abs(places).max(axis=0)
            inside &= depth < nearest[near]
            found[near[inside]] = patch.at(places[:, inside])
            nearest[near[inside]] = depth[inside]
        return found, nearest < np.inf

    @lazy
    def _spline(self) -> np.ndarray:
        """The coefficients of the cubic spline through the cells, with `MARGIN` around the grid."""
        from scipy.ndimage import spline_filter

        return spline_filter(self.values.reshape(-1)[beyond_edges(*self.grid.shape, MARGIN)], 3, mode="mirror")

    def smooth(self, where: ErpGrid | ErpWindow | np.ndarray, order: int = 3) -> np.ndarray:
        """The values of the grid alone, by cubic splines (order 3), or linear (1), which is several times as fast."""
        from scipy.ndimage import map_coordinates

        if isinstance(where, ErpGrid) and where == self.grid:
            return self.values
        if isinstance(where, np.ndarray) and where.ndim == 1:
            return self.smooth(where[None], order)[0]
        height, width = self.grid.shape
        if isinstance(where, np.ndarray):
            x, y, _ = self.grid.project(where)
        else:
            whole = where.whole if isinstance(where, ErpWindow) else where
            top, left = (where.top, where.left) if isinstance(where, ErpWindow) else (0, 0)
            rows, columns = where.shape
            y = (np.arange(rows) + top + 0.5)[:, None] * (height / whole.height) + np.zeros(columns)
            x = ((np.arange(columns) + left + 0.5) * (width / whole.width))[None, :] % width + np.zeros((rows, 1))
        y, x = y + (MARGIN - 0.5), x + (MARGIN - 0.5)
        if order > 1:
            return map_coordinates(self._spline, np.stack([y, x]), order=3, mode="mirror", prefilter=False)
        flat, around = self.values.reshape(-1), beyond_edges(*self.grid.shape, MARGIN)
        top, left = y.astype(np.intp), x.astype(np.intp)
        start, high, wide = top * around.shape[1] + left, 1 - (y - top), 1 - (x - left)
        low, beside = 1 - high, 1 - wide
        a, b, c, d = (flat[around.take(start + step)] for step in (0, 1, around.shape[1], around.shape[1] + 1))
        return a * high * wide + b * high * beside + c * low * wide + d * low * beside

    def plus(self, values: np.ndarray | float, patches: Sequence[np.ndarray | float]) -> SphereField:
        """With `values` ``(H, W)`` added, and to the patches what `patches` ``(n, n)`` hold."""
        added = [patch.values + x for patch, x in zip(self.patches, patches, strict=True)]
        return self.like(self.values + values, added)

    def like(self, values: np.ndarray, patches: Sequence[np.ndarray]) -> SphereField:
        """The same grid and patches with other values ``(H, W)`` and ``(n, n)``."""
        return self.redrawn(values, tuple(p.like(x) for p, x in zip(self.patches, patches, strict=True)))

    def redrawn(self, values: np.ndarray, patches: tuple[Patch, ...]) -> SphereField:
        """With other `values` ``(H, W)``, and patches on the same nodes."""
        return known(SphereField(self.grid, values, patches), layout=self.layout)

    @lazy
    def layout(self) -> Layout:
        """The geometry, which fields on the same nodes share."""
        return Layout(self.grid, self.patches)

    @lazy
    def logs(self) -> np.ndarray:
        """Values ``(n,)`` of the cells in no patch and the nodes of patches, in the order of the `layout`."""
        cells = self.values.reshape(-1).take(self.layout.free)
        return np.concatenate([cells, *(patch.values.reshape(-1) for patch in self.patches)])

    def averaged(self, level: float) -> np.ndarray:
        """exp(field - level), averaged over each cell of the grid ``(H, W)``.

        Patches are integrated over the cells, which are too wide to sample a sharp peak.
        """
        found = np.exp(np.minimum(self.values - level, LARGEST)).reshape(-1)
        weights = self.grid.weights.reshape(-1)
        for patch, shares, inside in zip(self.patches, self.layout.shares, self.layout.inside, strict=True):
            mass = float(np.sum(np.exp(np.minimum(patch.values - level, LARGEST)) * shares))
            cells = float(found[inside] @ weights[inside])
            if cells > 0:
                found[inside] *= mass / cells
            elif not len(inside):  # the patch contains no cell centre
                nearest = int((self.grid.directions @ patch.frame[0]).argmax())
                found[nearest] += mass / weights.min()
        return found.reshape(self.grid.shape)

    @lazy
    def log_mean(self) -> float:
        """log of the mean of exp(field) over the sphere."""
        top = float(self.logs.max())
        return top + math.log(float(np.exp(self.logs - top) @ self.layout.weights) / (4 * math.pi))


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the values of a field lie: the cells of a `grid` that are in none of its `patches`, and the patches."""

    grid: ErpGrid
    patches: tuple[Patch, ...]

    @lazy
    def outside(self) -> np.ndarray:
        """Mask ``(H, W)`` of the cells outside of all patches."""
        free = np.ones(self.grid.shape, dtype=bool)
        for cells in self.inside:
            free.reshape(-1)[cells] = False
        return free

    @lazy
    def inside(self) -> list[np.ndarray]:
        """The flat indices ``(m,)`` of the cells whose middles lie in each patch."""
        return [patch.cells(self.grid) for patch in self.patches]

    @lazy
    def free(self) -> np.ndarray:
        """The flat indices ``(m,)`` of the cells outside of all patches."""
        return self.outside.reshape(-1).nonzero()[0]

    @lazy
    def shares(self) -> tuple[np.ndarray, ...]:
        """Solid angles ``(n, n)`` of the nodes of each patch; 0 where a node lies deeper in another patch."""
        return tuple(self._owned(index, patch.directions, patch.weights) for index, patch in enumerate(self.patches))

    def _owned(self, index: int, directions: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """`weights` ``(...)`` of `directions` ``(..., 3)`` in one patch; 0 for what lies deeper in another."""
        if len(self.patches) == 1:
            return weights
        depth = np.abs(self.patches[index].places(directions)[0]).max(axis=0)
        weights = weights.copy()
        for other, patch in enumerate(self.patches):
            if other != index:
                places, inside = patch.places(directions)
                rival = np.abs(places).max(axis=0)
                weights[inside & ((rival < depth) | ((rival == depth) & (other < index)))] = 0.0
        return weights

    @lazy
    def weights(self) -> np.ndarray:
        """Solid angles ``(n,)`` of the cells in no patch and the nodes of patches."""
        cells = self.grid.weights.reshape(-1)
        return np.concatenate([cells.take(self.free), *(share.reshape(-1) for share in self.shares)])

    @lazy
    def directions(self) -> np.ndarray:
        """Directions ``(n, 3)`` of the same."""
        cells = self.grid.directions.reshape(-1, 3)
        return np.concatenate([cells.take(self.free, axis=0), *(p.directions.reshape(-1, 3) for p in self.patches)])

    @lazy
    def fine(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Of nodes `FINER` times as dense in each patch, where they lie deeper than in any other.

        Which these are ``(m,)``, their solid angles ``(m,)``, directions ``(m, 3)``, and the cell around each ``(m,)``.
        """
        found = []
        for index, patch in enumerate(self.patches):
            count = (len(patch.values) - 1) * FINER + 1
            directions = plane_directions(count, patch.frame, patch.half, patch.bend).reshape(-1, 3)
            shares = self._owned(index, directions, plane_weights(count, patch.half, patch.bend).reshape(-1))
            counts = shares.nonzero()[0]
            directions = directions.take(counts, axis=0)
            found.append((counts, shares[counts], directions, cells_of(self.grid, directions)))
        return found
