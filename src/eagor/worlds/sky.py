"""The outdoors for rays that leave the building: a bright sky, a hazy horizon with houses and trees, and lawn below.

Everything outdoors is infinitely far away, so it depends on the direction alone, world frame.
"""

from __future__ import annotations

import numpy as np

ROWS, COLUMNS = 512, 1024
_HORIZON = np.array([0.93, 0.95, 0.97])
_ZENITH = np.array([0.38, 0.57, 0.88])
_LAWN = np.array([0.20, 0.26, 0.12])
_CLOUD = np.array([0.97, 0.97, 0.98])
_HAZE = np.array([0.50, 0.57, 0.47])
_GROUND = np.array([0.24, 0.25, 0.21])


def radiance(directions: np.ndarray) -> np.ndarray:
    """Light ``(n, 3)``, linear RGB, from the directions ``(n, 3)``: about 1 near the horizon, a quarter below it."""
    height = directions[:, 2:3] / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    sky = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(np.clip(height, 0, 1))
    blend = np.clip(height / 0.1 + 0.5, 0, 1)
    return blend * sky + (1 - blend) * _GROUND


def painted(seed: int) -> np.ndarray:
    """The view outdoors, ``(ROWS, COLUMNS, 3)`` linear RGB, equirectangular in the layout of `eagor.sphere`."""
    rng = np.random.default_rng(seed)
    azimuth = (0.5 - (np.arange(COLUMNS) + 0.5) / COLUMNS) * 2 * np.pi
    elevation = np.degrees((0.5 - (np.arange(ROWS) + 0.5) / ROWS) * np.pi)[:, None]
    above, below = elevation[: ROWS // 2], elevation[ROWS // 2 :]
    up = np.sin(np.radians(above))[..., None]
    cloud = sum(_waves(rng, azimuth + s * np.radians(above), (3, 9)) for s in (-2.0, 1.0, 3.5)) / 3
    cover = np.clip(cloud * 0.9 + 0.15, 0, 1)[..., None] * (1 - up)
    clear = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(up)
    air = clear + (_CLOUD - clear) * 0.7 * cover
    # Lawn that fades to haze at the horizon.
    away = 5 / np.tan(np.radians(np.clip(-below, 0.5, 89.5)))  # metres, seen from one storey's height
    x, y = away * np.cos(azimuth), away * np.sin(azimuth)
    patches = sum(_waves(rng, 0.11 * (x * np.cos(a) + y * np.sin(a)), (1, 9)) for a in (0.2, 1.3, 2.4)) / 3
    grass = _LAWN * (1 + 0.35 * patches / (1 + away / 20))[..., None]
    haze = 1 - np.exp(-away / 60)[..., None]
    image = np.concatenate([air, grass + (_HAZE - grass) * haze])
    band = np.abs(elevation[:, 0]) < 14  # everything that stands on the ground
    image[band] = _skyline(image[band], rng, azimuth, elevation[band])
    return np.clip(image, 0, 1)


def _skyline(image: np.ndarray, rng: np.random.Generator, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Hills, houses before them and trees before these; elevations in degrees."""
    hills = 1.6 + 1.2 * _waves(rng, azimuth, (2, 6))
    image = _put(image, (elevation < hills) & (elevation > -1.0), np.array([0.50, 0.60, 0.68]))
    for _ in range(int(rng.integers(7, 13))):
        image = _house(image, rng, azimuth, elevation)
    crowns = 1.2 + 3.2 * np.maximum(_waves(rng, azimuth, (4, 12)), 0) + 0.8 * _waves(rng, azimuth, (30, 80))
    shade = 1 + 0.3 * _waves(rng, azimuth * 1.7 + np.radians(elevation) * 9, (15, 60))
    trees = np.array([0.17, 0.25, 0.13]) * shade[..., None]
    return _put(image, (elevation < crowns) & (elevation > -1.8 - 0.6 * shade), trees)


def look_up(image: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The colours ``(n, 3)`` of an equirectangular `image` ``(ROWS, COLUMNS, 3)`` in these directions ``(n, 3)``."""
    x, y, z = directions.astype(np.float64).T
    column = (0.5 - np.arctan2(y, x) / (2 * np.pi)) * COLUMNS - 0.5
    row = np.clip((0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * ROWS - 0.5, 0, ROWS - 1)
    left, top = np.floor(column), np.minimum(np.floor(row), ROWS - 2)
    right_share, lower_share = (column - left)[:, None], (row - top)[:, None]
    left, top = left.astype(np.intp) % COLUMNS, top.astype(np.intp)
    right = (left + 1) % COLUMNS
    upper = image[top, left] * (1 - right_share) + image[top, right] * right_share
    lower = image[top + 1, left] * (1 - right_share) + image[top + 1, right] * right_share
    return upper * (1 - lower_share) + lower * lower_share


def _house(image: np.ndarray, rng: np.random.Generator, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """A house with a pitched roof and rows of windows."""
    middle, half, top = rng.uniform(-np.pi, np.pi), rng.uniform(0.04, 0.11), rng.uniform(3.5, 8.0)
    across = ((azimuth - middle + np.pi) % (2 * np.pi) - np.pi) / half
    wall = np.array([0.72, 0.64, 0.54]) * rng.uniform(0.7, 1.1) * rng.uniform(0.9, 1.1, 3)
    roof = np.array([0.42, 0.24, 0.18]) if rng.random() < 0.6 else np.array([0.30, 0.31, 0.34])
    inside = np.abs(across) < 1
    image = _put(image, inside & (elevation < top) & (elevation > -1.5), wall)
    panes = (np.abs((across * 3.5) % 1 - 0.5) < 0.22) & (np.abs((elevation / 1.7) % 1 - 0.5) < 0.27)
    image = _put(image, inside & panes & (elevation < top - 0.4) & (elevation > -1), np.array([0.25, 0.30, 0.36]))
    return _put(
        image, (np.abs(across) < 1.08) & (elevation >= top) & (elevation < top + 2 * (1.08 - np.abs(across))), roof
    )


def _put(image: np.ndarray, where: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """`colour`, faded by the air between, where `where` is true."""
    pale = 0.86 * colour + 0.14 * np.array([0.78, 0.84, 0.90])
    return np.where(np.broadcast_to(where, image.shape[:2])[..., None], pale, image)


def _waves(rng: np.random.Generator, phase: np.ndarray, band: tuple[int, int]) -> np.ndarray:
    """Periodic noise of unit size: a few whole-number frequencies within `band`, with random phases."""
    total = np.zeros(np.shape(phase))
    for _ in range(7):
        total += np.sin(rng.integers(band[0], band[1]) * phase + rng.uniform(0, 2 * np.pi))
    return total / 3
