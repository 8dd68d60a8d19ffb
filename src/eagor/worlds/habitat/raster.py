"""The plan of a storey: its navigation mesh over square cells."""

from __future__ import annotations

import numpy as np

from eagor.worlds.habitat.frames import Frames
from eagor.worlds.habitat.storeys import BAND, Storey

__all__ = ["CELL", "rasterised"]

CELL = 0.05  # metres: side of a cell, as of our own plans


def rasterised(triangles: np.ndarray, storey: Storey, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Habitat's y of the mesh at the middle of each cell ``(rows, cols)``, NaN off the storey, and the plan's origin.

    Where two levels of the storey lie over each other, the one nearer to its floor counts.
    """
    ours = frames.from_habitat(triangles)
    low, high = ours[..., :2].min(axis=(0, 1)), ours[..., :2].max(axis=(0, 1))
    origin = np.floor(low / CELL) * CELL - 2 * CELL  # aligned with our own plans
    cols, rows = (int(n) for n in np.ceil((high - origin) / CELL) + 2)
    heights = np.full((rows, cols), np.nan)
    for corners, ys in zip((ours[..., :2] - origin) / CELL, triangles[..., 1], strict=True):
        first = np.floor(corners.min(axis=0) - 0.5).astype(int)
        last = np.ceil(corners.max(axis=0) - 0.5).astype(int) + 1
        x, y = np.meshgrid(np.arange(first[0], last[0]) + 0.5, np.arange(first[1], last[1]) + 0.5)
        a, b, c = corners
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1e-12:
            continue
        u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        height = ys[0] + u * (ys[1] - ys[0]) + v * (ys[2] - ys[0])
        inside &= np.abs(height - storey.level) <= BAND
        part = heights[first[1] : last[1], first[0] : last[0]]
        better = inside & ~(np.abs(part - storey.level) <= np.abs(height - storey.level))
        part[better] = height[better]
    return origin, heights
