"""Exact sizes: pictures whose sides are whole numbers of a model's cells, so that no server or processor resizes."""

from __future__ import annotations

import numpy as np


def exact_size(cell: int, pixels: int, aspect: float = 2.0) -> tuple[int, int]:
    """(height, width), both multiples of `cell`, of the largest picture of at most `pixels` pixels."""
    raise NotImplementedError


def resized(image: np.ndarray, size: tuple[int, int], wrap: bool = False) -> np.ndarray:
    """`image` ``(H, W, 3)`` uint8 at `size` (height, width); `wrap` where it is a panorama."""
    raise NotImplementedError
