"""Ordinary pictures cut from a panorama: where they look so that they cover the sphere, and what they show.

Detectors and models know such pictures better than panoramas, and none of them has a seam.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from eagor._extras import need
from eagor.errors import GridError
from eagor.grids import PerspectiveGrid, ViewKey, forward_view, view_key
from eagor.media.panorama import checked_picture
from eagor.sphere import direction, world_R_body

OVERLAP = math.radians(10)
_ROUNDING = 1e-6  # radians, or views: what neighbours that touch exactly may miss by


def tangent_views(
    size: int, hfov: float = math.radians(100), overlap: float = OVERLAP, reach: float = math.pi / 2
) -> tuple[PerspectiveGrid, ...]:
    """Square views of `size` pixels and field `hfov` that cover all directions up to elevation +-`reach` (radians).

    Views narrower by `overlap` would still cover them, so that `lift` with half of it as margin covers each direction
    fully. The views stand in rings at even elevations (one view at each pole), the first of each ring
    towards azimuth 0; of such layouts the one with the fewest views is taken: 6, as a cube, for 100 degrees with
    10 of overlap. Raises `GridError` if the views are too narrow for the overlap, or wider than a plane can show.
    """
    check_fields(hfov, overlap, reach)
    poses = _poses(round((hfov - overlap) / 2, 9), round(reach, 9))
    return tuple(PerspectiveGrid(size, size, hfov, world_R_body(yaw, -pitch)) for yaw, pitch in poses)


def check_fields(hfov: float, overlap: float, reach: float) -> None:
    """Raise `GridError` where `tangent_views` would, for these angles (radians)."""
    least = math.radians(30) - 1e-9  # 40 degrees less 10 are 30, whatever is rounded on the way to radians
    if not (0 <= overlap < hfov <= math.radians(150) and hfov - overlap >= least and 0 < reach <= math.pi / 2):
        raise GridError(
            f"views of {math.degrees(hfov):g} degrees with {math.degrees(overlap):g} of overlap up to elevation "
            f"{math.degrees(reach):g}; wanted fields up to 150, at least 30 wider than the overlap, and 0 < reach <= 90"
        )


@lru_cache(maxsize=16)
def _poses(inner: float, reach: float) -> tuple[tuple[float, float], ...]:
    """(yaw left, pitch up) of the fewest views of half-angle `inner` that cover the sphere up to `reach`."""
    # Rings at the poles only where they are to be seen; a single ring may do for a narrow band.
    fewest = math.ceil(math.pi / (2 * inner) - _ROUNDING) + 1
    layouts = [np.linspace(-math.pi / 2, math.pi / 2, rings) for rings in range(max(fewest, 3), fewest + 4)]
    fewest = math.ceil(reach / inner - _ROUNDING)
    layouts += [np.linspace(-1, 1, rings) * max(reach - inner, 0.0) for rings in range(max(fewest, 2), fewest + 4)]
    layouts += [np.zeros(1)]
    tests = [_points(reach, inner / per) for per in (4, 12, 40)]  # most layouts fail a coarse one already
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
    """Whether each of `points` ``(n, 3)`` lies at least within the inner field of one view."""
    left = points
    for yaw, pitch in poses:
        left = left[depth_inside(left @ world_R_body(yaw, -pitch), inner, inner) < -_ROUNDING]
        if len(left) == 0:
            return True
    return False


def depth_inside(rays: np.ndarray, half_width: float, half_height: float) -> np.ndarray:
    """How much narrower (radians, on each side) a view could be and still show directions ``(..., 3)``.

    They are in the view's own frame; negative outside.
    """
    x, y, z = rays[..., 0], np.abs(rays[..., 1]), np.abs(rays[..., 2])
    return np.minimum(half_width - np.arctan2(y, x), half_height - np.arctan2(z, x))


def cut(panorama: np.ndarray, *views: PerspectiveGrid) -> list[np.ndarray]:
    """What cameras with these grids see of the panorama ``(H, W, 3)`` uint8: one uint8 ``(*grid.shape, 3)`` for each.

    Bilinear, around the seam and over the poles. A panorama that is finer than the views is shrunk first, so that
    nothing is left out between the pixels. Raises `ImageError`, and `MissingExtraError` without OpenCV.
    """
    need("cutting views from a panorama", "photos", "cv2")
    import cv2

    image = checked_picture(panorama)
    # A pixel of a view spans fewest degrees at its border; half way between that and the middle blurs least.
    rows = max((math.ceil(math.pi * view.focal / math.cos(view.hfov / 2)) for view in views), default=2)
    image = _shrunk(np.ascontiguousarray(image), max(2, rows))
    height, width = image.shape[:2]
    # Beyond a pole the picture goes on half a turn away: one such row above and one below.
    canvas = np.concatenate([np.roll(image[:1], width // 2, axis=1), image, np.roll(image[-1:], width // 2, axis=1)])
    pictures = []
    for view in views:
        x, y, z = np.tensordot(view.body_R_view.astype(np.float32), _rays(view_key(view)), axes=1)
        column = (0.5 - np.arctan2(y, x) / np.float32(2 * math.pi)) * np.float32(width) - np.float32(0.5)
        row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.float32(math.pi)) * np.float32(height) + np.float32(0.5)
        pictures.append(cv2.remap(canvas, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
    return pictures


@lru_cache(maxsize=4)
def _rays(lens: ViewKey) -> np.ndarray:
    """Directions ``(3, h, w)`` of a view that looks forward."""
    return np.ascontiguousarray(np.moveaxis(forward_view(lens).directions, -1, 0).astype(np.float32))


def _shrunk(image: np.ndarray, rows: int) -> np.ndarray:
    """A panorama with about so many `rows`, by areas, around the seam; one that has no more is returned as it is."""
    import cv2

    while image.shape[0] >= 2 * rows and not (image.shape[0] % 2 or image.shape[1] % 2):  # fast, and exact
        image = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    height, width = image.shape[:2]
    if height <= rows:
        return image
    return cv2.resize(image, (max(2, round(rows * width / height)), rows), interpolation=cv2.INTER_AREA)
