"""The surface of one storey of a navigation mesh: heights, free points, and Habitat's shortest paths over it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.habitat.frames import Frames
from eagor.worlds.habitat.probe import import_habitat
from eagor.worlds.habitat.raster import CELL
from eagor.worlds.habitat.storeys import BAND, Storey

__all__ = ["Surface"]

ON_MESH = 1e-3  # metres in plan within which a place is on the mesh


@dataclass(frozen=True, eq=False)
class Surface:
    """What Habitat's PathFinder says about one storey of one island.

    `heights` ``(rows, cols)``: Habitat's y of the mesh in the cells of the plan, which begin at `origin` ``(2,)``, NaN
    off the storey. `source`: the scene, for errors.
    """

    pathfinder: Any
    storey: Storey
    frames: Frames
    origin: np.ndarray
    heights: np.ndarray
    source: str

    def feet(self, xy: np.ndarray) -> np.ndarray:
        """The point ``(3,)`` of Habitat's world at which a body stands at a point ``(2,)``, close to the mesh."""
        x, y = float(xy[0]), float(xy[1])
        found = self.frames.to_habitat(np.array([x, y, 0.0]))
        found[1] = self._near_height(x, y)
        found = found.astype(np.float32)
        snapped = np.array(self.pathfinder.snap_point(found), dtype=np.float32)  # NaN with no mesh around
        if np.abs(snapped - found)[[0, 2]].max() < ON_MESH:
            found[1] = snapped[1]
        return found

    def height(self, xy: np.ndarray) -> float:
        """Habitat's y of the mesh at a point ``(2,)``; beside the mesh that of the cells around."""
        return float(self.feet(xy)[1])

    def _near_height(self, x: float, y: float) -> float:
        """Habitat's y of the cell at a point, of the nearest cells around, or of the storey's floor."""
        rows, cols = self.heights.shape
        col, row = int((x - self.origin[0]) // CELL), int((y - self.origin[1]) // CELL)
        if 0 <= row < rows and 0 <= col < cols and np.isfinite(self.heights[row, col]):
            return float(self.heights[row, col])
        part = self.heights[max(0, row - 2) : max(0, row + 3), max(0, col - 2) : max(0, col + 3)]
        near = part[np.isfinite(part)]
        return float(near.mean()) if len(near) else self.storey.level

    def is_free(self, point: np.ndarray) -> bool:
        """Whether the body can stand at a point ``(2,)``; False off the storey and for NaN."""
        if not np.isfinite(point).all():
            return False
        feet = self.feet(point)
        if abs(float(feet[1]) - self.storey.level) > BAND or not self.pathfinder.is_navigable(feet, 0.5):
            return False
        return self.pathfinder.get_island(feet) == self.storey.island

    def check_free(self, point: np.ndarray) -> None:
        """Raise `WorldError` unless the body can stand at a point ``(2,)``."""
        if not self.is_free(point):
            raise WorldError(
                f"({point[0]:.3f}, {point[1]:.3f}) is not on the navigation mesh of this storey of {self.source}; "
                "start from a free point, such as snap() gives"
            )

    def between(self, start: np.ndarray, goal: np.ndarray) -> tuple[float, np.ndarray]:
        """Geodesic metres between two places ``(3,)`` of Habitat's world, inf without a path, and the path ``(n, 2)``.

        Habitat moves places beside the mesh onto it, and counts the height of a goal above the mesh.
        """
        path = import_habitat().ShortestPath()
        path.requested_start, path.requested_end = start.astype(np.float32), goal.astype(np.float32)
        if not self.pathfinder.find_path(path):
            return math.inf, np.zeros((0, 2))
        return float(path.geodesic_distance), self.frames.from_habitat(np.array(path.points))[:, :2]
