"""Where the circles of fisheye lenses are in pictures, as their black surroundings tell: a start for calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from eagor.errors import ImageError
from eagor.lenses import FisheyeLens
from eagor.media.cameras.rig import Rig
from eagor.media.images import checked_picture
from eagor.media.suspect import BLACK
from eagor.sphere import world_R_body

__all__ = ["first_rig"]

RAYS = 256  # directions from the middle in which the rim is looked for
FEWEST = 24  # of them that have to meet a rim within the picture; with fewer, the circle is taken to fill the picture
AWAY = 2.0  # pixels from the picture's border at which a rim counts
OFF = 0.02  # share of the radius by which a point of the rim may be off the circle: dark places touch the rim


def first_rig(moments: Sequence[Sequence[np.ndarray]], fov: float) -> Rig:
    """An ideal rig of two lenses back to back whose circles are where these pictures show them.

    `moments`: for each moment its picture ``(H, W, 3)`` with both circles side by side, or two pictures, one per lens.
    `fov`: the angle across a circle, radians. Raises `ImageError` unless all have the same size, and one or two
    pictures each.
    """
    sizes = {tuple(checked_picture(p, "a picture").shape[1::-1] for p in pictures) for pictures in moments}
    if len(sizes) != 1:
        raise ImageError(
            f"the pictures have {len(sizes)} different sizes; wanted those of one camera in one mode, all alike"
        )
    (size,) = sizes
    brightest = [np.max([pictures[k] for pictures in moments], axis=(0, 3)) for k in range(len(size))]
    if len(size) == 1:
        width, height = size[0]
        if not 1.8 <= width / height <= 2.2:
            raise ImageError(
                f"the pictures are {width} x {height}; wanted two circles side by side (twice as wide as high), or two "
                "pictures per moment, one for each lens. For another layout, begin with a rig: --rig FILE.yaml"
            )
        half = width // 2
        found = [_circle(brightest[0][:, :half]), _circle(brightest[0][:, half:])]
        places = [(0, 0.0), (0, float(half))]
    elif len(size) == 2:
        found = [_circle(each) for each in brightest]
        places = [(0, 0.0), (1, 0.0)]
    else:
        raise ImageError(
            f"a moment has {len(size)} pictures; wanted one with both circles, or one for each of 2 lenses"
        )
    lenses = []
    for name, yaw, (picture, left), (x, y, radius) in zip(
        ("front", "back"), (0.0, math.pi), places, found, strict=True
    ):
        lens = FisheyeLens.of_field(name, (x + left, y), radius, fov, body_R_lens=world_R_body(yaw), picture=picture)
        lenses.append(lens)
    return Rig(tuple(size), tuple(lenses))


def _circle(brightest: np.ndarray) -> tuple[float, float, float]:
    """Centre x, y and radius (pixels) of the bright circle in ``(H, W)``: the brightest that each pixel ever was."""
    height, width = brightest.shape
    lit = brightest > BLACK
    default = (width / 2, height / 2, min(width, height) / 2)
    if not lit.any():
        return default
    y, x = np.nonzero(lit)
    middle = np.array([np.median(x) + 0.5, np.median(y) + 0.5])
    points = []
    steps = np.arange(0.0, math.hypot(width, height), 0.5)
    for angle in np.linspace(0, 2 * math.pi, RAYS, endpoint=False):
        along = middle + steps[:, None] * (math.cos(angle), math.sin(angle))
        inside = (along >= AWAY).all(axis=1) & (along[:, 0] <= width - AWAY) & (along[:, 1] <= height - AWAY)
        along = along[: int(inside.argmin())] if not inside.all() else along
        bright = lit[along[:, 1].astype(int), along[:, 0].astype(int)]
        last = int(np.flatnonzero(bright)[-1]) if bright.any() else 0
        if 0 < last < len(along) - 2:
            points.append(along[last])
    return _fitted(np.array(points), default) if len(points) >= FEWEST else default


def _fitted(points: np.ndarray, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """The circle through most of `points` ``(n, 2)``: least squares (I. Kasa, 1976), without those that are off."""
    kept = points
    centre, radius = np.array(default[:2]), default[2]
    for _ in range(8):
        if len(kept) < FEWEST:
            return default
        matrix = np.column_stack([2 * kept, np.ones(len(kept))])
        solution = np.linalg.lstsq(matrix, (kept**2).sum(axis=1), rcond=None)[0]
        centre, radius = solution[:2], math.sqrt(max(float(solution[2] + solution[:2] @ solution[:2]), 1.0))
        off = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        # What is dark at the rim lies inside: a limit that shrinks leaves those out.
        kept = points[off <= max(OFF * radius, float(np.quantile(off, 0.8)))]
    return float(centre[0]), float(centre[1]), radius
