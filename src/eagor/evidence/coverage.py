"""Directions that were not looked at get no evidence, even after truncation.

A view's evidence ends at its border, but a band-limited field cannot end anywhere. Truncated at degree L, it rings far
into directions outside of the view, and over many views the ringing adds up to false belief. Two linear steps prevent
this; both depend only on the lens (or the mask) and the degree:

- a taper inside the seen region: evidence rises from zero at the border to full weight within pi / (L + 1);
- a weighted least-squares fit of degree L to the tapered evidence, in which an error more than pi / (L + 1) outside of
  the border costs `PENALTY` times as much as one inside.

A taper alone, even twice as wide, leaks more and keeps less of what is near the border.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, frozen, recent
from eagor.grids import ErpGrid, FisheyeGrid, Grid, PatchGrid, PerspectiveGrid, beyond_edges, forward_view, view_key
from eagor.harmonics import RealHarmonics

PENALTY = 1000.0
CONFINE_UP_TO = 31  # above this degree the ringing is narrow and only the taper is used

# A region: what was seen, hashable. The grid's kind and size (or the lens), and the packed mask where one was given.
Region = tuple[str, int, int, "float | tuple[float, ...]", bytes]


def region(grid: Grid, mask: np.ndarray | None) -> Region | None:
    """The region that was looked at, None for the whole sphere; `mask` ``(H, W)`` is True there."""
    packed = b"" if mask is None or mask.all() else np.packbits(mask).tobytes()
    if not packed and grid.depth_inside() is None:
        return None
    if isinstance(grid, PerspectiveGrid | FisheyeGrid):
        return *view_key(grid), packed
    return "pixels" if isinstance(grid, ErpGrid) else "patches", *grid.shape, 0.0, packed


def taper(degree: int, where: Region, like: Array) -> Array:
    """Weights ``(H, W)`` in [0, 1]: zero at the border of the seen region, one from pi / (degree + 1) inside."""
    return recent(_taper, degree, where, like=like)


def confine(degree: int, coefficients: Array, where: Region) -> Array:
    """The least-squares field ``(..., size)`` that stays inside the seen region, in the frame of the grid's lens."""
    if degree > CONFINE_UP_TO:
        return coefficients
    return coefficients @ recent(_confinement, degree, where, like=coefficients)


def _forward_grid(where: Region) -> PerspectiveGrid | FisheyeGrid | ErpGrid | PatchGrid:
    whole = {"pixels": ErpGrid, "patches": PatchGrid}
    return whole[where[0]](*where[1:3]) if where[0] in whole else forward_view(where[:4])


@lru_cache(maxsize=32)
def looked_at(where: Region) -> np.ndarray:
    """The cells ``(H, W)`` that were looked at, bool."""
    _, height, width, _, packed = where
    seen = np.ones((height, width), dtype=bool)
    if packed:
        bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=height * width)
        seen = bits.astype(bool).reshape(height, width)
    return frozen(seen & (_forward_grid(where).weights > 0))


def _taper(degree: int, where: Region) -> np.ndarray:
    """sin^2 of the depth inside the seen region."""
    grid, seen = _forward_grid(where), looked_at(where)
    border = grid.depth_inside()
    depth = np.where(seen, math.pi if border is None else border, 0.0)
    if where[-1]:
        hidden = ~seen & (grid.weights > 0) & _beside(seen, grid)
        apart = _distance(grid.directions[seen], grid.directions[hidden], math.pi / (degree + 1))
        depth[seen] = np.minimum(depth[seen], apart)
    return np.sin(np.clip(depth * (degree + 1) / 2, 0, math.pi / 2)) ** 2


def _confinement(degree: int, where: Region) -> np.ndarray:
    """The inverse of (1 + (PENALTY - 1) * Gram matrix of the basis over the far unseen), symmetric."""
    basis = RealHarmonics(degree)
    fine, reach = basis.quadrature(), math.pi / (degree + 1)
    far = ~_contains(where, fine.directions) & (_distance(fine.directions, _rim(where), reach) > reach)
    values = basis.evaluate(fine.directions[far])
    gram = (values * fine.weights[far][:, None]).T @ values
    return np.linalg.inv(np.eye(basis.size) + (PENALTY - 1) * gram)


def _contains(where: Region, directions: np.ndarray) -> np.ndarray:
    """Which of `directions` ``(..., 3)`` lie in a cell that was looked at."""
    grid, seen = _forward_grid(where), looked_at(where)
    x, y, inside = grid.project(directions)
    row, column = (np.clip(at.astype(np.intp), 0, n - 1) for at, n in zip((y, x), grid.shape, strict=True))
    return inside & seen[row, column]


def _rim(where: Region) -> np.ndarray:
    """Directions ``(n, 3)`` along the border of the seen region, on its inner side."""
    grid, seen = _forward_grid(where), looked_at(where)
    if not where[-1] and isinstance(grid, PerspectiveGrid):  # cell centres would miss the outer half cells
        side, width, height = np.linspace(0, 1, 100), grid.width, grid.height
        x = np.concatenate([side * width, side * width, 0 * side, 0 * side + width])
        y = np.concatenate([0 * side, 0 * side + height, side * height, side * height])
        return grid.unproject(x, y)
    return grid.directions[seen & _beside(~seen, grid, beyond=True)]


def _beside(marked: np.ndarray, grid: Grid, beyond: bool = False) -> np.ndarray:
    """Which cells ``(H, W)`` have a `marked` neighbour (of eight); `beyond` is the value past a view's edge.

    A panorama continues across the seam and the poles.
    """
    if isinstance(grid, ErpGrid | PatchGrid):
        padded = marked.reshape(-1)[beyond_edges(*marked.shape, 1)]
    else:
        padded = np.pad(marked, 1, constant_values=beyond)
    across = padded[:-2] | padded[1:-1] | padded[2:]
    return across[:, :-2] | across[:, 1:-1] | across[:, 2:]


def _distance(points: np.ndarray, targets: np.ndarray, within: float = math.pi) -> np.ndarray:
    """Angle (radians) from each of `points` ``(..., 3)`` to the nearest of `targets` ``(n, 3)``; pi beyond `within`."""
    if len(targets) == 0:
        return np.full(points.shape[:-1], math.pi)
    from scipy.spatial import KDTree

    most = 2 * math.sin(within / 2) * (1 + 1e-9) if within < math.pi else math.inf
    chord = KDTree(targets).query(points.reshape(-1, 3), distance_upper_bound=most)[0].reshape(points.shape[:-1])
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))
