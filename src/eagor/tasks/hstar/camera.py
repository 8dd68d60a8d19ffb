"""H*Bench's camera: 100 degrees wide, rendered pixel for pixel like the published environment.

In two places it is half a pixel off our conventions: the ray of column j is (j - w / 2) / f, and a panorama's column
centres lie at whole numbers. `render_view` keeps both, since models are shown exactly this; `View.grid` describes the
same pixels in our terms. Degrees in this module; yaw positive right, pitch positive up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor._lazy import lazy
from eagor.conventions import direction_from_hstar, hstar_from_direction
from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.sphere import azimuth_elevation, direction, world_R_body
from eagor.tasks.hstar.rules import Action, turned

HFOV_DEG = 100.0
RESOLUTION = 1080  # rows; columns are rows // 9 * 16
CROSS = (0, 255, 0)
ARM = 10  # pixels of the cross to each side of the centre
_BLOCK = 1 << 16  # pixels at a time, so that intermediate values fit in the processor's cache


def size_of(resolution: int = RESOLUTION) -> tuple[int, int]:
    """(rows, columns) of a view of this resolution."""
    return resolution, resolution // 9 * 16


@dataclass(frozen=True)
class View:
    """The camera's direction, degrees."""

    yaw: float
    pitch: float

    @lazy
    def world_R_view(self) -> np.ndarray:
        """The pose ``(3, 3)`` in our world frame: x at yaw 0, y to the left, z up."""
        return world_R_body(-math.radians(self.yaw), -math.radians(self.pitch))

    @classmethod
    def facing(cls, heading: np.ndarray) -> View:
        """The view at a `heading` ``(2,)``: azimuth and elevation, radians, world frame."""
        yaw, pitch = hstar_from_direction(direction(heading[0], heading[1]))
        return cls(round(float(yaw), 6) % 360, round(float(pitch), 6))

    @lazy
    def heading(self) -> np.ndarray:
        """Where the camera looks ``(2,)``: azimuth and elevation, radians, world frame."""
        return headings_of(np.array(self.yaw), np.array(self.pitch))

    def grid(self, rows: int, columns: int) -> PerspectiveGrid:
        """The view's cells in the world frame."""
        return PerspectiveGrid(rows, columns, math.radians(HFOV_DEG), self.world_R_view)

    def after(self, action: Action | None) -> View:
        """The view after `action`; only ``rotate`` changes it."""
        if action is None or action.kind != "rotate":
            return self
        yaw, pitch = turned(self.yaw, self.pitch, action)
        return View(float(yaw), float(pitch))


def headings_of(yaws: np.ndarray, pitches: np.ndarray) -> np.ndarray:
    """Azimuth and elevation ``(..., 2)``, radians, world frame, of views' yaws and pitches ``(...)``, degrees."""
    return np.stack(azimuth_elevation(direction_from_hstar(yaws, pitches)), axis=-1)


def render_view(
    panorama: np.ndarray, yaw: float, pitch: float, resolution: int = RESOLUTION, cross: bool = True
) -> np.ndarray:
    """The camera's view ``(rows, columns, 3)`` uint8 of a panorama ``(H, W, 3)`` uint8 of any proportions.

    Bilinear, wrapped around both axes as published, and rounded, with the green cross at the middle. The published
    environment interpolates with weights in steps of 1/32, so single pixels differ from its own by a few levels.
    Raises `ImageError` for any other array.
    """
    panorama = np.asarray(panorama)
    if panorama.ndim != 3 or panorama.shape[2] != 3 or panorama.dtype != np.uint8 or panorama.size == 0:
        raise ImageError(f"a panorama is (H, W, 3) uint8; got shape {panorama.shape}, {panorama.dtype}")
    rows, columns = size_of(resolution)
    height, width = panorama.shape[:2]
    longitude, latitude = _rays(rows, columns, float(pitch))
    x = longitude.reshape(-1) * np.float32(width / 360.0) + np.float32((0.5 + (yaw % 360.0) / 360.0) * width)
    y = latitude.reshape(-1) * np.float32(height / 180.0) + np.float32(height / 2)
    out = np.empty((rows * columns, 3), dtype=np.uint8)
    for start in range(0, rows * columns, _BLOCK):
        part = slice(start, start + _BLOCK)
        out[part] = _sampled(panorama, x[part], y[part])
    out = out.reshape(rows, columns, 3)
    if cross:
        row, column = _arms(rows, columns)
        out[row] = out[column] = CROSS
    return out


def without_cross(picture: np.ndarray, around: int = 0) -> np.ndarray:
    """A view ``(rows, columns, 3)`` uint8 of the environment with its cross filled in from the pixels beside it.

    For perceptions: a query for something green would find the cross. Each pixel becomes the mean of the nearest pixels
    to both sides of the line. `around`: pixels to both sides of the lines that are filled in, too, for pictures that
    were compressed after the cross was drawn. Raises `ImageError` for anything but a picture.
    """
    picture = np.asarray(picture)
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or picture.size == 0:
        raise ImageError(f"a view is (rows, columns, 3) uint8; got shape {picture.shape}, {picture.dtype}")
    rows, columns = picture.shape[:2]
    out = picture.copy()
    for axis, (size, part) in enumerate(zip((rows, columns), _arms(rows, columns, around), strict=True)):
        # The row's pixels are taken from above and below, the column's from left and right, outside of the cross.
        first, last = part[axis].start, part[axis].stop
        sides = [place for place in (first - 1, last) if 0 <= place < size]
        if not sides:
            continue
        beside = [np.take(picture, [place], axis=axis).astype(np.float64) for place in sides]
        along = (slice(None), part[1]) if axis == 0 else (part[0], slice(None))
        out[part] = np.rint(np.mean(beside, axis=0))[along].astype(np.uint8)
    # Where the lines cross, what lies beside them is the other line: the corners of the crossing are clear.
    (high, wide) = _arms(rows, columns, around)
    top, bottom, left, right = high[0].start - 1, high[0].stop, wide[1].start - 1, wide[1].stop
    corners = [picture[i, j] for i in (top, bottom) for j in (left, right) if 0 <= i < rows and 0 <= j < columns]
    if corners:
        out[high[0], wide[1]] = np.rint(np.mean(corners, axis=0)).astype(np.uint8)
    return out


def _arms(rows: int, columns: int, around: int = 0) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The pixels of the cross: of its row, and of its column; `around` pixels wider to all sides."""
    middle, centre = rows // 2, columns // 2

    def stretch(place: int, reach: int) -> slice:
        return slice(max(0, place - reach - around), place + reach + around + 1)

    return (stretch(middle, 0), stretch(centre, ARM)), (stretch(middle, ARM), stretch(centre, 0))


def visible_share(view: View, yaw: tuple[float, float], pitch: tuple[float, float] | None) -> float:
    """The visible fraction of a box (degrees; without pitch, of a window of 10 degrees at the horizon)."""
    return float(inside(view, box_points(yaw, pitch)).mean())


def level_of(view: View, yaw: tuple[float, float], pitch: tuple[float, float]) -> int:
    """0 if at least half of the box is in the view, 1 if some of it is, 2 if none."""
    share = visible_share(view, yaw, pitch)
    return 0 if share >= 0.5 else 1 if share > 0 else 2


def inside(view: View, directions: np.ndarray) -> np.ndarray:
    """Which directions ``(n, 3)`` of the world the view shows, bool ``(n,)``."""
    return view.grid(*size_of()).project(directions)[2]


def box_points(yaw: tuple[float, float], pitch: tuple[float, float] | None, steps: int = 24) -> np.ndarray:
    """Directions ``(n, 3)`` that sample a box evenly by solid angle."""
    width = (yaw[1] - yaw[0]) % 360.0
    low, high = pitch if pitch is not None else (-10.0, 10.0)
    parts = (np.arange(steps) + 0.5) / steps
    sines = np.sin(np.radians(low)) + parts * (np.sin(np.radians(high)) - np.sin(np.radians(low)))
    yaws, pitches = np.meshgrid(yaw[0] + parts * width, np.degrees(np.arcsin(np.clip(sines, -1, 1))))
    return direction_from_hstar(yaws, pitches).reshape(-1, 3)


@lru_cache(maxsize=8)
def _rays(rows: int, columns: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Longitude (right of the view's yaw) and latitude (DOWN) of each pixel's ray ``(rows, columns)``, degrees."""
    rays = View(0.0, pitch).grid(rows, columns).unproject(np.arange(columns), np.arange(rows)[:, None])
    longitude, latitude = (-np.degrees(angle).astype(np.float32) for angle in azimuth_elevation(rays))
    return longitude, latitude


def _sampled(panorama: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear values ``(n, 3)`` at pixel coordinates whose whole numbers are pixel centres, wrapped both ways."""
    height, width = panorama.shape[:2]
    pixels = panorama.reshape(-1, 3)
    left, top = np.floor(x), np.floor(y)
    right_share, lower_share = (x - left)[:, None], (y - top)[:, None]
    column, row = left.astype(np.int64), top.astype(np.int64)

    def across(row: np.ndarray) -> np.ndarray:
        here, beside = (
            np.take(pixels, row % height * width + each % width, axis=0).astype(np.float32)
            for each in (column, column + 1)
        )
        return here + (beside - here) * right_share

    upper, lower = across(row), across(row + 1)
    return (upper + (lower - upper) * lower_share + 0.5).astype(np.uint8)
