"""H*Bench's camera: 100 degrees wide, drawn pixel for pixel like the published environment draws it.

Its conventions differ from ours by half a pixel, twice: the ray of column j is (j - w / 2) / f, and a panorama's column
centres lie at whole numbers. `render_view` keeps both, because models are shown exactly this; `View.grid` describes
the same pixels in our terms. Degrees in this module; yaw positive right, pitch positive up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor._lazy import lazy
from eagor.grids import PerspectiveGrid
from eagor.sphere import world_R_body

HFOV_DEG = 100.0
RESOLUTION = 1080  # rows; columns are rows // 9 * 16
CROSS = (0, 255, 0)
ARM = 10  # pixels of the cross to each side of the centre
_BLOCK = 1 << 16  # pixels at a time: what is computed for them stays in the cache


def size_of(resolution: int = RESOLUTION) -> tuple[int, int]:
    """(rows, columns) of a view of this resolution."""
    return resolution, resolution // 9 * 16


@dataclass(frozen=True)
class View:
    """Where the camera looks, degrees."""

    yaw: float
    pitch: float

    @lazy
    def world_R_view(self) -> np.ndarray:
        """The pose ``(3, 3)``: our frame of the world has x at yaw 0, y to the left, z up."""
        return world_R_body(-math.radians(self.yaw), -math.radians(self.pitch))

    def grid(self, rows: int, columns: int) -> PerspectiveGrid:
        """The view's cells in the world's frame."""
        return PerspectiveGrid(rows, columns, math.radians(HFOV_DEG), self.world_R_view)


def render_view(
    panorama: np.ndarray, yaw: float, pitch: float, resolution: int = RESOLUTION, cross: bool = True
) -> np.ndarray:
    """What the camera sees of a panorama ``(H, W, 3)`` uint8 of any proportions: ``(rows, columns, 3)`` uint8.

    Bilinear, wrapped around both axes as published, and rounded; the published environment interpolates with weights in
    steps of 1/32, so single pixels differ by a few levels from its own. With the green cross at the middle.
    """
    rows, columns = size_of(resolution)
    packed = _packed(panorama)
    height, width = packed.shape
    flat = packed.reshape(-1)
    longitude, latitude = _rays(rows, columns, float(pitch))
    x = longitude.reshape(-1) * np.float32(width / 360.0) + np.float32((0.5 + (yaw % 360.0) / 360.0) * width)
    y = latitude.reshape(-1) * np.float32(height / 180.0) + np.float32(height / 2)
    out = np.empty((rows * columns, 3), dtype=np.uint8)
    for start in range(0, rows * columns, _BLOCK):
        part = slice(start, start + _BLOCK)
        out[part] = _sampled(flat, height, width, x[part], y[part])
    out = out.reshape(rows, columns, 3)
    if cross:
        draw_cross(out)
    return out


def draw_cross(image: np.ndarray) -> None:
    """Draw the green cross at the middle of `image` ``(rows, columns, 3)``, in place."""
    rows, columns = image.shape[:2]
    middle, centre = rows // 2, columns // 2
    image[middle, max(0, centre - ARM) : centre + ARM + 1] = CROSS
    image[max(0, middle - ARM) : middle + ARM + 1, centre] = CROSS


def visible_share(view: View, yaw: tuple[float, float], pitch: tuple[float, float] | None) -> float:
    """How much of a box (degrees; without pitch a window of 10 degrees at the horizon) is in the view, 0 to 1."""
    directions = box_points(yaw, pitch)
    return float(inside(view, directions).mean())


def inside(view: View, directions: np.ndarray) -> np.ndarray:
    """Which directions ``(n, 3)`` of the world the view shows, bool ``(n,)``."""
    rays = directions @ view.world_R_view
    rows, columns = size_of()
    half = math.tan(math.radians(HFOV_DEG) / 2)
    ahead = rays[:, 0] > 1e-9
    across = np.abs(rays[:, 1]) <= half * rays[:, 0]
    return ahead & across & (np.abs(rays[:, 2]) <= half * rows / columns * rays[:, 0])


def box_points(yaw: tuple[float, float], pitch: tuple[float, float] | None, steps: int = 24) -> np.ndarray:
    """Directions ``(n, 3)`` that sample a box evenly by solid angle."""
    from eagor.conventions import direction_from_hstar

    width = (yaw[1] - yaw[0]) % 360.0
    low, high = pitch if pitch is not None else (-10.0, 10.0)
    parts = (np.arange(steps) + 0.5) / steps
    sines = np.sin(np.radians(low)) + parts * (np.sin(np.radians(high)) - np.sin(np.radians(low)))
    yaws, pitches = np.meshgrid(yaw[0] + parts * width, np.degrees(np.arcsin(np.clip(sines, -1, 1))))
    return direction_from_hstar(yaws, pitches).reshape(-1, 3)


@lru_cache(maxsize=8)
def _rays(rows: int, columns: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Longitude (right of the view's yaw) and latitude (DOWN) of each pixel's ray ``(rows, columns)``, degrees."""
    focal = columns / (2 * math.tan(math.radians(HFOV_DEG) / 2))
    x = (np.arange(columns) - columns / 2) / focal
    y = ((np.arange(rows) - rows / 2) / focal)[:, None]
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    down, ahead = c * y - s, s * y + c
    longitude = np.degrees(np.arctan2(x, ahead)).astype(np.float32)
    latitude = np.degrees(np.arcsin(np.clip(down / np.sqrt(1 + x * x + y * y), -1, 1))).astype(np.float32)
    return longitude, latitude


@lru_cache(maxsize=1)
def _packed_kept(holder: _Held) -> np.ndarray:
    image = holder.image
    packed = np.zeros((*image.shape[:2], 4), dtype=np.uint8)
    packed[..., :3] = image
    return packed.view(np.uint32)[..., 0]


class _Held:
    """An array that may be the key of a cache: it is equal to itself alone."""

    __slots__ = ("image",)

    def __init__(self, image: np.ndarray) -> None:
        self.image = image

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held) and other.image is self.image

    def __hash__(self) -> int:
        return id(self.image)


def _packed(panorama: np.ndarray) -> np.ndarray:
    """The panorama with one uint32 per pixel ``(H, W)``: one look-up fetches all its channels."""
    image = np.asarray(panorama)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        from eagor.errors import ImageError

        raise ImageError(f"a panorama is (H, W, 3) uint8; got shape {image.shape}, {image.dtype}")
    if image.flags.writeable:  # it may change: nothing is kept
        return _packed_kept.__wrapped__(_Held(image))
    return _packed_kept(_Held(image))


def _sampled(flat: np.ndarray, height: int, width: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear values ``(n, 3)`` at pixel coordinates whose whole numbers are pixel centres, wrapped both ways."""
    left, top = np.floor(x), np.floor(y)
    right_share, lower_share = (x - left)[:, None], (y - top)[:, None]
    column = left.astype(np.int64) % width
    row = top.astype(np.int64) % height
    beside = np.where(column + 1 == width, 0, column + 1)
    below = np.where(row + 1 == height, 0, row + 1) * width
    row = row * width

    def read(places: np.ndarray) -> np.ndarray:
        return flat[places].view(np.uint8).reshape(-1, 4)[:, :3].astype(np.float32)

    upper = read(row + column)
    upper += (read(row + beside) - upper) * right_share
    lower = read(below + column)
    lower += (read(below + beside) - lower) * right_share
    upper += (lower - upper) * lower_share
    return (upper + 0.5).astype(np.uint8)
