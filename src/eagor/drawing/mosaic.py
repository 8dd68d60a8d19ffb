"""What an ordinary camera has shown so far, pasted together where it looked: a panorama with holes."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from eagor.grids import ErpGrid, PerspectiveGrid

__all__ = ["Mosaic"]

ROWS = 240
FINE = 1.5  # pixels of a picture per cell: a finer one is shrunk first, by areas


class Mosaic:
    """The pictures of a camera that turns, in the axes of the world; a newer picture covers older ones.

    `colours` ``(rows, 2 rows, 3)`` uint8; `seen` ``(rows, 2 rows)``: which of its cells any picture has shown.
    """

    def __init__(self, rows: int = ROWS) -> None:
        self._grid = ErpGrid(rows, 2 * rows)
        self.colours = np.zeros((*self._grid.shape, 3), dtype=np.uint8)
        self.seen = np.zeros(self._grid.shape, dtype=bool)

    @property
    def share(self) -> float:
        """The share of the sphere that was shown, 0 to 1."""
        return float(np.sum(self.seen * self._grid.weights)) / (4 * math.pi)

    def add(self, picture: np.ndarray, grid: PerspectiveGrid, world_R_body: np.ndarray) -> None:
        """Paste a picture ``(h, w, 3)`` uint8, whose pixels `grid` describes, taken with this orientation."""
        from PIL import Image

        height = min(grid.height, math.ceil(FINE * self._grid.height / math.pi * grid.height / grid.focal))
        width = max(1, round(grid.width * height / grid.height))
        if (height, width) != picture.shape[:2]:
            small = Image.fromarray(np.ascontiguousarray(picture)).resize((width, height), Image.Resampling.BOX)
            picture = np.asarray(small)
        # Only what is nearer to the axis than the farthest corner can be in the picture.
        corners = grid.unproject(np.array([0.0, grid.width] * 2), np.array([0.0, 0.0, grid.height, grid.height]))
        axis = grid.body_R_view[:, 0]
        near = self._grid.directions @ (world_R_body @ axis) >= min(float((corners @ axis).min()) - 0.02, 1.0)
        x, y, inside = grid.project(self._grid.directions[near] @ world_R_body)
        column = (x[inside] * (width / grid.width)).astype(int).clip(0, width - 1)
        row = (y[inside] * (height / grid.height)).astype(int).clip(0, height - 1)
        rows, columns = (index[inside] for index in np.nonzero(near))
        self.colours[rows, columns] = picture[row, column]
        self.seen[rows, columns] = True

    def seen_from(self, world_R_body: np.ndarray, unseen: tuple[int, int, int]) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 in the axes of a body with this orientation, with holes `unseen`."""
        x, y, _ = self._grid.project(_directions(self._grid) @ world_R_body.T.astype(np.float32))
        row = y.astype(int).clip(0, self._grid.height - 1)
        column = x.astype(int) % self._grid.width
        found = self.colours[row, column]
        found[~self.seen[row, column]] = unseen
        return found


@lru_cache(maxsize=2)
def _directions(grid: ErpGrid) -> np.ndarray:
    return grid.directions.astype(np.float32)
