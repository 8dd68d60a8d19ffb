"""What was not looked at gains nothing, even after truncation.

A view's evidence ends at its border, but a band-limited field cannot end anywhere: cut at degree L, the evidence rings
far into directions that nobody looked at, and over many views the ringing adds up to false belief. Two measures
keep it home, both linear, both fixed by the lens (or the mask) and the degree:

- a taper inside the seen region: evidence rises from zero at the border to full weight within pi / (L + 1);
- among the fields of degree L, the one nearest to the tapered evidence is taken in a least-squares sense in which an
  error beyond pi / (L + 1) outside the border costs `PENALTY` times more than an error inside.

``benchmarks/leak.py`` measures both, and a taper alone: even twice as wide it leaks more, and keeps less of what is
seen near the border.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor._arrays import Array, constant
from eagor.grids import ErpGrid, FisheyeGrid, Grid, Lens, PatchGrid, PerspectiveGrid, forward_view, lens_of
from eagor.harmonics import RealHarmonics

PENALTY = 1000.0
CONFINE_UP_TO = 31  # above this degree the ringing is narrow and the dense solve is not worth it: taper only

# A region: what was seen, hashable. The grid's kind and size (or the lens), and the packed mask where one was given.
Region = tuple[str, int, int, float, bytes]


def region(grid: Grid, mask: np.ndarray | None) -> Region | None:
    """The seen part of `grid`, None if that is the whole sphere; `mask` ``(H, W)`` is True where it was looked at."""
    packed = b"" if mask is None or mask.all() else np.packbits(mask).tobytes()
    if isinstance(grid, PerspectiveGrid | FisheyeGrid):
        if grid.depth_inside() is None and not packed:
            return None
        return *lens_of(grid), packed
    if not packed:
        return None
    return "pixels" if isinstance(grid, ErpGrid) else "patches", *grid.shape, 0.0, packed


def taper(degree: int, where: Region, like: Array) -> Array:
    """Weights ``(H, W)`` in [0, 1]: zero at the border of the seen region, one from pi / (degree + 1) inside."""
    return constant(_taper, degree, where, like=like)


def confine(degree: int, coefficients: Array, where: Region) -> Array:
    """The nearest field ``(..., size)`` that stays inside the seen region, in the frame of the grid's own lens."""
    if degree > CONFINE_UP_TO:
        return coefficients
    return coefficients @ constant(_confinement, degree, where, like=coefficients)


def _forward_grid(where: Region) -> PerspectiveGrid | FisheyeGrid | ErpGrid | PatchGrid:
    kind, height, width, fov, _ = where
    if kind == "pixels":
        return ErpGrid(height, width)
    if kind == "patches":
        return PatchGrid(height, width)
    lens: Lens = (kind, height, width, fov)
    return forward_view(lens)


@lru_cache(maxsize=32)
def _mask(where: Region) -> np.ndarray:
    """The cells that were looked at ``(H, W)``."""
    _, height, width, _, packed = where
    seen = np.ones((height, width), dtype=bool)
    if packed:
        seen = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=height * width).astype(bool)
        seen = seen.reshape(height, width)
    return seen & (_forward_grid(where).weights > 0)


def _taper(degree: int, where: Region) -> np.ndarray:
    """sin^2 of the depth inside the seen region."""
    grid, seen = _forward_grid(where), _mask(where)
    border = grid.depth_inside()
    depth = np.where(seen, math.pi if border is None else border, 0.0)
    if where[-1]:
        depth = np.minimum(depth, _distance(grid.directions, grid.directions[~seen]))
    return np.sin(np.clip(depth * (degree + 1) / 2, 0, math.pi / 2)) ** 2


def _confinement(degree: int, where: Region) -> np.ndarray:
    """The inverse of (1 + (PENALTY - 1) * Gram matrix of the basis over the far unseen), symmetric."""
    basis = RealHarmonics(degree)
    fine = basis.quadrature()
    far = _distance(fine.directions, _seen_points(where)) > math.pi / (degree + 1)
    values = basis.evaluate(fine.directions[far])
    gram = (values * fine.weights[far][:, None]).T @ values
    return np.linalg.inv(np.eye(basis.size) + (PENALTY - 1) * gram)


def _seen_points(where: Region) -> np.ndarray:
    """Directions ``(n, 3)`` that sample the seen region, its border included."""
    grid, seen = _forward_grid(where), _mask(where)
    if not where[-1] and isinstance(grid, PerspectiveGrid):  # cell centres would miss the outer half cells
        x, y = np.meshgrid(np.linspace(0, grid.width, 100), np.linspace(0, grid.height, 100))
        return grid.unproject(x, y).reshape(-1, 3)
    return grid.directions[seen]


def _distance(points: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Angle (radians) from each of `points` ``(..., 3)`` to the nearest of `targets` ``(n, 3)``."""
    if len(targets) == 0:
        return np.full(points.shape[:-1], math.pi)
    from scipy.spatial import KDTree

    chord = KDTree(targets).query(points.reshape(-1, 3))[0].reshape(points.shape[:-1])
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))
