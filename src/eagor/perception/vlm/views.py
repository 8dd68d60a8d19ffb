"""Tangent views: overlapping pictures that cover the sphere, cut from a panorama, and the way back to one grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from eagor.grids import PatchGrid, PerspectiveGrid

OVERLAP = math.radians(10)


def tangent_views(
    size: int, hfov: float = math.radians(100), overlap: float = OVERLAP, reach: float = math.pi / 2
) -> tuple[PerspectiveGrid, ...]:
    """Square views of `size` pixels and field `hfov` that cover all directions up to elevation +-`reach` (radians)."""
    raise NotImplementedError


def cut(panorama: np.ndarray, grid: PerspectiveGrid) -> np.ndarray:
    """What a camera with `grid` sees of the panorama: uint8 ``(*grid.shape, 3)``."""
    raise NotImplementedError


def lift(
    responses: Sequence[np.ndarray], views: Sequence[PerspectiveGrid], grid: PatchGrid, margin: float = OVERLAP / 2
) -> tuple[np.ndarray, np.ndarray]:
    """(response (Q, h, w), coverage (h, w)) on `grid` of one response ``(Q, rows, cols)`` per view (any cells)."""
    raise NotImplementedError
