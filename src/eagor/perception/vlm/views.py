"""Tangent views: overlapping pictures that cover the sphere, cut from a panorama, and the way back to one grid.

Models know such pictures better than panoramas, and no view has a seam. The weight of each view falls towards its
border, where things are cut off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from eagor.errors import GridError, ResponseError
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.perception.vlm.sizes import checked_picture, resized
from eagor.sphere import direction, world_R_body

OVERLAP = math.radians(10)
_ROUNDING = 1e-6  # tolerance, in radians or views, for neighbours that touch exactly
_SAMPLES = 3  # sample points along each side of a cell in `lift`


def tangent_views(
    size: int, hfov: float = math.radians(100), overlap: float = OVERLAP, reach: float = math.pi / 2
) -> tuple[PerspectiveGrid, ...]:
    """Square views of `size` pixels and field of view `hfov` that cover all directions up to elevation +-`reach`.

    Angles are in radians. Views narrower by `overlap` would still cover them, so that `lift` with a margin of half of
    it covers each direction fully. The views form rings at evenly spaced elevations (one view at each pole), the first
    of each ring at azimuth 0. The layout with the fewest views is taken: 6, as a cube, for 100 degrees with 10 of
    overlap. Raises `GridError` if the views are too narrow for the overlap, or too wide for a plane.
    """
    check_fields(hfov, overlap, reach)
    poses = _poses(round((hfov - overlap) / 2, 9), round(reach, 9))
    return tuple(PerspectiveGrid(size, size, hfov, world_R_body(yaw, -pitch)) for yaw, pitch in poses)


def check_fields(hfov: float, overlap: float, reach: float) -> None:
    """Raise `GridError` where `tangent_views` would, for these angles (radians)."""
    least = math.radians(30) - 1e-9  # tolerance: 40 degrees less 10 are 30, despite rounding in radians
    if not (0 <= overlap < hfov <= math.radians(150) and hfov - overlap >= least and 0 < reach <= math.pi / 2):
        raise GridError(
            f"views of {math.degrees(hfov):g} degrees with {math.degrees(overlap):g} of overlap up to elevation "
            f"{math.degrees(reach):g}; wanted fields up to 150, at least 30 wider than the overlap, and 0 < reach <= 90"
        )


@lru_cache(maxsize=16)
def _poses(inner: float, reach: float) -> tuple[tuple[float, float], ...]:
    """(yaw left, pitch up) of the fewest views of half-angle `inner` that cover the sphere up to `reach`."""
    # Rings at the poles only if they are in reach; a single ring may suffice for a narrow band.
    fewest = math.ceil(math.pi / (2 * inner) - _ROUNDING) + 1
    layouts = [np.linspace(-math.pi / 2, math.pi / 2, rings) for rings in range(max(fewest, 3), fewest + 4)]
    fewest = math.ceil(reach / inner - _ROUNDING)
    layouts += [np.linspace(-1, 1, rings) * max(reach - inner, 0.0) for rings in range(max(fewest, 2), fewest + 4)]
    layouts += [np.zeros(1)]
    tests = [_points(reach, inner / per) for per in (4, 12, 40)]  # most layouts fail a coarse test already
    best: tuple[tuple[float, float], ...] = ()
    for rings in layouts:
        for around in range(math.ceil(math.pi / inner - _ROUNDING), 4 * math.ceil(math.pi / inner)):
            poses = _ring_poses(rings, around)
            if best and len(poses) >= len(best):
                break
            if all(_covered(points, poses, inner) for points in tests):
                best = poses
                break
    return best


def _points(reach: float, spacing: float) -> np.ndarray:
    """Directions ``(n, 3)`` every `spacing` radians from the equator up to `reach`: the layouts are symmetric."""
    elevations = np.linspace(0, reach, math.ceil(reach / spacing) + 1)
    azimuths = np.arange(math.ceil(2 * math.pi / spacing)) * (2 * math.pi / math.ceil(2 * math.pi / spacing))
    return direction(*np.meshgrid(azimuths, elevations)).reshape(-1, 3)


def _ring_poses(rings: np.ndarray, around: int) -> tuple[tuple[float, float], ...]:
    poses = []
    for pitch in sorted(rings.tolist(), key=abs):
        count = 1 if math.cos(pitch) < 1e-9 else max(3, math.ceil(around * math.cos(pitch) - 1e-9))
        poses += [(2 * math.pi * index / count, pitch) for index in range(count)]
    return tuple(poses)


def _covered(points: np.ndarray, poses: Sequence[tuple[float, float]], inner: float) -> bool:
    """Whether each of `points` ``(n, 3)`` lies within the inner field of at least one view."""
    left = points
    for yaw, pitch in poses:
        left = left[_depth(left @ world_R_body(yaw, -pitch), inner, inner) < -_ROUNDING]
        if len(left) == 0:
            return True
    return False


def _depth(rays: np.ndarray, half_width: float, half_height: float) -> np.ndarray:
    """How much narrower (radians, on each side) a view could be and still show rays ``(..., 3)`` of its own frame."""
    x, y, z = rays[..., 0], np.abs(rays[..., 1]), np.abs(rays[..., 2])
    return np.minimum(half_width - np.arctan2(y, x), half_height - np.arctan2(z, x))


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


def cut(panorama: np.ndarray, grid: PerspectiveGrid) -> np.ndarray:
    """The view ``(*grid.shape, 3)`` uint8 that a camera with `grid` has of the panorama ``(H, W, 3)`` uint8.

    Bilinear, across the seam and over the poles. A panorama finer than the view is shrunk first, to avoid aliasing.
    Raises `ImageError`.
    """
    image = checked_picture(panorama)
    # A pixel of a view spans the smallest angle at the border; the scale half way to the middle blurs least.
    rows = max(2, math.ceil(math.pi * grid.focal / math.cos(grid.hfov / 2)))
    if image.shape[0] > rows:
        image = resized(image, (rows, max(2, round(rows * image.shape[1] / image.shape[0]))), wrap=True)
    height, width = image.shape[:2]
    x, y, _ = ErpGrid(height, width).project(grid.directions)
    # Beyond a pole the picture continues half a turn away: one such row above and one below.
    beyond = [np.roll(image[edge], width // 2, axis=0)[None] for edge in (0, -1)]
    canvas = np.concatenate([beyond[0], image, beyond[1]]).astype(np.float32)
    u, v = x - 0.5, np.clip(y, 0, height) + 0.5
    left, top = np.floor(u).astype(np.intp), np.clip(np.floor(v).astype(np.intp), 0, height)
    across, down = ((part[..., None]).astype(np.float32) for part in (u - left, v - top))
    left, right = left % width, (left + 1) % width
    upper = canvas[top, left] * (1 - across) + canvas[top, right] * across
    lower = canvas[top + 1, left] * (1 - across) + canvas[top + 1, right] * across
    return np.rint(upper * (1 - down) + lower * down).astype(np.uint8)


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
        depth = _depth(fine.directions @ view.body_R_view, view.hfov / 2, half_height)
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
