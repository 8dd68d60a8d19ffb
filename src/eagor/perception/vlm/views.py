"""From the responses of overlapping views back to one grid; pictures framed to the size that a model wants.

Each view counts less and less towards its own border, where things are cut.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from eagor.errors import ResponseError
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.media.cutting import OVERLAP, depth_inside
from eagor.media.panorama import checked_picture, resized

_SAMPLES = 3  # along each side of a cell that responses are lifted to


def framed(
    image: np.ndarray, grid: PerspectiveGrid, size: tuple[int, int]
) -> tuple[np.ndarray, PerspectiveGrid, tuple[int, int]]:
    """A picture of `size` (height, width) with `image` in its middle, its grid, and the rows and columns of `image`.

    The rest has the image's mean colour; stretching to the model's size would distort the view. `grid` describes the
    pixels of `image`. Raises `ImageError`.
    """
    image = checked_picture(image, "the view")
    height, width = size
    scale = min(height / grid.height, width / grid.width)
    # Of the same parity as the whole, so that the middle stays the middle.
    rows, cols = (
        min(whole, max(2 - whole % 2, whole - 2 * round((whole - scale * side) / 2)))
        for whole, side in ((height, grid.height), (width, grid.width))
    )
    picture = np.empty((height, width, 3), dtype=np.uint8)
    picture[:] = np.rint(image.reshape(-1, 3).mean(axis=0)).astype(np.uint8)
    top, left = (height - rows) // 2, (width - cols) // 2
    picture[top : top + rows, left : left + cols] = resized(image, (rows, cols))
    hfov = 2 * math.atan(width / (2 * scale * grid.focal))
    return picture, PerspectiveGrid(height, width, hfov, grid.body_R_view), (rows, cols)


def filled(shape: tuple[int, int], size: tuple[int, int], inner: tuple[int, int]) -> np.ndarray:
    """The fraction of each cell ``(h, w)`` of a picture of `size` that lies in the middle part of `inner` pixels."""
    shares = []
    for count, whole, part in zip(shape, size, inner, strict=True):
        edges = np.clip(np.arange(count + 1) * (whole / count), (whole - part) / 2, (whole + part) / 2)
        shares.append(np.diff(edges) * (count / whole))
    return np.minimum(shares[0][:, None] * shares[1], 1.0)


def lift(
    responses: Sequence[np.ndarray], views: Sequence[PerspectiveGrid], grid: PatchGrid, margin: float = OVERLAP / 2
) -> tuple[np.ndarray, np.ndarray]:
    """One response on the sphere from one ``(Q, rows, cols)`` per view, and its coverage.

    Args:
        responses: per view the values in [0, 1] of its cells, which divide the view evenly; a single cell covers the
            whole view.
        views: their poses.
        grid: the cells of the result.
        margin: radians at each side of a view over which its weight rises from 0 to 1 (as sin^2).

    Returns the response ``(Q, h, w)`` float32, the weighted mean where views overlap, and the coverage ``(h, w)`` in
    [0, 1], the weight of the view that sees the cell best. Where coverage is 0 nothing was seen (response 0): pass it
    to `Evidence.from_response`. Raises `ResponseError` if the responses do not fit the views.
    """
    arrays = [np.asarray(response) for response in responses]
    if len(arrays) != len(views) or not arrays:
        raise ResponseError(f"there are {len(arrays)} responses for {len(views)} views; wanted one each, one at least")
    if any(array.ndim != 3 or array.shape[0] != arrays[0].shape[0] or array.size == 0 for array in arrays):
        shapes = sorted({array.shape for array in arrays})
        raise ResponseError(f"responses of views have shapes {shapes}; wanted (queries, rows, cols), queries alike")
    # Several points per cell: borders of views run through cells, and cells of views may be finer than ours.
    fine = PatchGrid(grid.rows * _SAMPLES, grid.cols * _SAMPLES)
    total = np.zeros((arrays[0].shape[0], *fine.shape))
    weights, coverage = np.zeros(fine.shape), np.zeros(fine.shape)
    for array, view in zip(arrays, views, strict=True):
        half_height = math.atan(math.tan(view.hfov / 2) * view.height / view.width)
        depth = depth_inside(fine.directions @ view.body_R_view, view.hfov / 2, half_height)
        inside = depth > 0
        rise = np.clip(depth[inside] / margin, 0, 1) if margin > 0 else 1.0
        weight = np.sin(rise * (math.pi / 2)) ** 2
        x, y, _ = view.project(fine.directions[inside])
        total[:, inside] += weight * bilinear(array, x / view.width, y / view.height)
        weights[inside] += weight
        coverage[inside] = np.maximum(coverage[inside], weight)
    solid = fine.weights * weights
    shape = (grid.rows, _SAMPLES, grid.cols, _SAMPLES)
    share = solid.reshape(shape).sum(axis=(1, 3))
    summed = (total * fine.weights).reshape(-1, *shape).sum(axis=(2, 4))
    response = np.divide(summed, share, out=np.zeros_like(summed), where=share > 0)
    seen = (coverage * fine.weights).reshape(shape).sum(axis=(1, 3)) / grid.weights
    return np.clip(response, 0, 1).astype(np.float32), np.clip(seen, 0, 1)


def bilinear(layers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`layers` ``(Q, rows, cols)`` of a view at fractions (x, y) of it; constant beyond the outer centres."""
    rows, cols = layers.shape[1:]
    u, v = np.clip(x * cols - 0.5, 0, cols - 1), np.clip(y * rows - 0.5, 0, rows - 1)
    left, top = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    right, below = np.minimum(left + 1, cols - 1), np.minimum(top + 1, rows - 1)
    across, down = u - left, v - top
    upper = layers[:, top, left] * (1 - across) + layers[:, top, right] * across
    lower = layers[:, below, left] * (1 - across) + layers[:, below, right] * across
    return upper * (1 - down) + lower * down
