"""Real spherical harmonics: analyse, synthesise, rotate and smooth fields on the sphere.

`RealHarmonics` is the public interface; `legendre` holds the basis, `projection` the grids, `rotation` Wigner's D and
`shells` the warp of a field over direction and distance under a displacement.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._arrays import Array, as_float, constant, namespace
from eagor.errors import GridError
from eagor.grids import ErpGrid, ErpWindow, Grid
from eagor.harmonics import legendre, projection, rotation
from eagor.sphere import check_rotation, check_unit

__all__ = ["RealHarmonics"]


@dataclass(frozen=True)
class RealHarmonics:
    """The real orthonormal basis up to `degree`, without Condon-Shortley phase, index l*l + l + m (m < 0: sine).

    Arrays of coefficients have shape ``(..., size)``; leading dimensions are batches. NumPy arrays in, NumPy out;
    torch tensors in, torch out, on their device and in their precision (any array-API namespace).

        >>> basis, grid = eagor.RealHarmonics(3), eagor.ErpGrid(16, 32)
        >>> coefficients = basis.analyse(grid.directions[..., 2], grid)  # the field z
        >>> round(float(basis.synthesise(coefficients, np.array([0.0, 0.6, 0.8]))), 6)
        0.8
    """

    degree: int

    def __post_init__(self) -> None:
        try:
            fits = operator.index(self.degree) >= 1
        except TypeError:
            fits = False
        if not fits:
            raise GridError(f"degree = {self.degree!r}; wanted a whole number of at least 1 (7, 15 and 31 are usual)")

    @property
    def size(self) -> int:
        """Number of coefficients, (degree + 1)^2."""
        return (self.degree + 1) ** 2

    def evaluate(self, directions: Array) -> Array:
        """Y ``(..., size)`` at unit vectors ``(..., 3)``, body frame.

        Lengths within 1 % of 1 count as rounding. Raises `DirectionError` for other lengths and shapes.
        """
        return legendre.evaluate(self.degree, check_unit(directions))

    def analyse(self, values: Array, grid: Grid) -> Array:
        """Coefficients ``(..., size)`` of `values` ``(..., H, W)`` on `grid`: integral of values times Y_lm.

        On an `ErpGrid` the values are samples; the result is exact for fields band-limited to the degree if the grid
        has more than twice as many rows, and more than twice as many columns. On the other grids each cell is a region
        of constant value: exact for a `PatchGrid`, to about 1e-3 of the field for a view finer than its blocks. Beyond
        a view's border the field counts as zero. Raises `GridError` for another shape.
        """
        values = as_float(values)
        if tuple(values.shape[-2:]) != tuple(grid.shape):
            raise GridError(
                f"values have shape {tuple(values.shape)}; the grid wants (..., {grid.shape[0]}, {grid.shape[1]})"
            )
        return projection.analyse(self.degree, values, grid)

    def synthesise(self, coefficients: Array, where: Grid | ErpWindow | Array) -> Array:
        """Values of the field: ``(..., H, W)`` on a grid, ``(..., n...)`` at an array of unit vectors ``(n..., 3)``.

        Raises `GridError` for coefficients of another shape and `DirectionError` for anything but unit vectors (lengths
        within 1 % of 1 count as rounding).
        """
        if not isinstance(where, Grid | ErpWindow):
            where = check_unit(where)
        return projection.synthesise(self.degree, self._checked(coefficients), where)

    def rotate(self, coefficients: Array, new_R_old: Array) -> Array:
        """The field as seen from the new frame: f_new(new_R_old @ direction_old) = f_old(direction_old).

        `coefficients` ``(..., size)`` and `new_R_old` ``(..., 3, 3)`` broadcast; NumPy rotations may be combined with
        tensors. Raises `RotationError`.
        """
        return rotation.rotate(self.degree, self._checked(coefficients), check_rotation(new_R_old))

    def smooth(self, coefficients: Array, sigma: Any) -> Array:
        """Convolution with the heat kernel of standard deviation `sigma` (radians per axis): exp(-l(l+1) sigma^2 / 2).

        One number, or ``(..., 1)`` for a batch. For a density this is diffusion, for a log-density it is not: see
        `eagor.belief.Belief.diffuse`.
        """
        coefficients = self._checked(coefficients)
        xp = namespace(coefficients)
        return coefficients * xp.exp(-0.5 * sigma**2 * constant(_eigenvalues, self.degree, like=coefficients))

    def quadrature(self, factor: int = 2) -> ErpGrid:
        """The smallest `ErpGrid` on which products of `factor` fields of this degree are integrated exactly."""
        rows = factor * self.degree + 1
        rows += rows % 2
        return ErpGrid(rows, 2 * rows)

    def _checked(self, coefficients: Array) -> Array:
        coefficients = as_float(coefficients)
        if coefficients.shape[-1] != self.size:
            raise GridError(
                f"coefficients have shape {tuple(coefficients.shape)}; degree {self.degree} wants (..., {self.size})"
            )
        return coefficients


@lru_cache(maxsize=64)
def _eigenvalues(degree: int) -> np.ndarray:
    """l (l + 1) of each coefficient."""
    found = legendre.degrees(degree)
    return (found * (found + 1)).astype(np.float64)
