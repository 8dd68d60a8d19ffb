"""The storey of a navigation mesh that is walked on: which one, its plan, its surface, and steps over it.

Meshes have islands on roofs, beds and tables, and islands that run over stairs through several storeys. Heights are
Habitat's y, metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.ground import STOREY
from eagor.worlds.habitat.simulator import Frames, import_habitat

__all__ = ["BAND", "CELL", "Storey", "Surface", "main_storey", "rasterised", "stepped", "triangles_of"]

BAND = STOREY  # metres above and below its floor that belong to a storey
BIN = 0.1  # metres: heights within it count as one level
SMALLEST = 1.0  # square metres: no smaller island is looked at
SPOTS = 12  # places of an island from which one looks up


@dataclass(frozen=True)
class Storey:
    """An island of the mesh, and the height of the storey's floor on the mesh (which floats above the true floor)."""

    island: int
    level: float


def triangles_of(pathfinder: Any, island: int) -> np.ndarray:
    """The triangles ``(n, 3, 3)`` of an island, in Habitat's world."""
    vertices = np.array(pathfinder.build_navmesh_vertices(island), dtype=np.float64).reshape(-1, 3)
    indices = np.array(pathfinder.build_navmesh_vertex_indices(island), dtype=np.int64).reshape(-1, 3)
    return vertices[indices]


def main_storey(
    pathfinder: Any, roofed: Callable[[np.ndarray], float], height: float | None = None, source: str = "the scene"
) -> Storey:
    """The storey to walk on: the one nearest to `height`, or the largest level of the largest island under a roof.

    `roofed` tells the share of points ``(n, 3)`` of the mesh with something above them. Raises `WorldError` if there is
    no island, or none at that height.
    """
    islands = [island for island in range(pathfinder.num_islands) if pathfinder.island_area(island) >= SMALLEST]
    if not islands:
        raise WorldError(
            f"nowhere in {source} is there a square metre to walk on; is it the right way up (habitat:SCENE?up=y or "
            "?up=z), and is the body small enough for it?"
        )
    levels = [
        (area, island, level) for island in islands for area, level in levels_of(triangles_of(pathfinder, island))
    ]
    if height is not None:
        near = [(area, island, level) for area, island, level in levels if abs(level - height) <= BAND]
        if not near:
            known = ", ".join(sorted({f"{level:.1f}" for area, _, level in levels if area >= SMALLEST}))
            raise WorldError(f"{source} has no storey at the height {height:g} m; it has some at {known} m")
        large = [each for each in near if each[0] >= SMALLEST] or near
        nearest = min(abs(level - height) for _, _, level in large)
        # Islands of one floor differ by what the mesh is rounded to: among these the largest counts.
        _, island, level = max(each for each in large if abs(each[2] - height) <= nearest + BIN)
        return Storey(island, level)
    ranked = sorted(levels, reverse=True)
    for _, island, level in ranked:
        if roofed(_spots(triangles_of(pathfinder, island), level)) > 0.5:
            return Storey(island, level)
    _, island, level = min((each for each in ranked if each[0] >= 0.25 * ranked[0][0]), key=lambda each: each[2])
    return Storey(island, level)  # without any roof: the lowest of the large ones


def levels_of(triangles: np.ndarray) -> list[tuple[float, float]]:
    """The levels of an island, largest first: area (square metres) and height of each."""
    heights, areas = triangles[:, :, 1].mean(axis=1), _areas(triangles)
    found, left = [], areas > 0
    while left.any():
        here, size = heights[left], areas[left]
        bins = np.round(here / BIN).astype(int)
        centre = (int(np.bincount(bins - bins.min(), size).argmax()) + bins.min()) * BIN
        level = float(np.average(here, weights=size * (np.abs(here - centre) <= BIN)))
        mine = left & (np.abs(heights - level) <= BAND)
        if not mine.any():
            break
        found.append((float(areas[mine].sum()), level))
        left &= ~mine
    return sorted(found, reverse=True)


def _areas(triangles: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


def _spots(triangles: np.ndarray, level: float) -> np.ndarray:
    """Middles of the largest triangles near a level ``(n, 3)``."""
    near = triangles[np.abs(triangles[:, :, 1].mean(axis=1) - level) <= 2 * BIN]
    return near[np.argsort(-_areas(near))[:SPOTS]].mean(axis=1)


# --- the plan of a storey ---------------------------------------------------------------------------------------------

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


# --- the surface of one storey of a navigation mesh -------------------------------------------------------------------

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


# --- steps of a body over a navigation mesh ---------------------------------------------------------------------------

HELD = 1e-4  # metres by which a step falls short that has collided: the mesh is in single precision
SHORT = 1e-3  # metres off the edge at which a step without sliding ends: no step leads away from the edge itself
FAR = 2.0  # metres within which an edge is looked for


def stepped(surface: Surface, xy: np.ndarray, step: np.ndarray, slide: bool) -> tuple[np.ndarray, bool]:
    """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided: Habitat's ``try_step``.

    A blocked step slides along the edge of the mesh (`slide`), or the body stops a millimetre off every edge: for
    Habitat-Sim 0.3.4 every step of a body that stands on the edge crosses it. It never leaves the storey. Raises
    `WorldError` if the start is not free or the step not finite.
    """
    start, way = np.asarray(xy, dtype=np.float64), np.asarray(step, dtype=np.float64)
    if not np.isfinite(way).all():
        raise WorldError(f"step = ({way[0]}, {way[1]}); wanted two finite numbers, metres")
    surface.check_free(start)
    if not way.any():
        return start.copy(), False
    feet, ahead = surface.feet(start), surface.frames.to_habitat(np.array([*(start + way), 0.0]))
    ahead[1] = feet[1]
    tried = surface.pathfinder.try_step if slide else surface.pathfinder.try_step_no_sliding
    end = surface.frames.from_habitat(np.array(tried(feet, ahead.astype(np.float32)), dtype=np.float64))[:2]
    moved = end - start
    if not np.isfinite(end).all() or np.hypot(*moved) > np.hypot(*way) + HELD or not surface.is_free(end):
        return start.copy(), True
    # Freely moved, the body is where the step led, not where single precision has put it.
    if np.hypot(*(moved - way)) <= HELD:
        return start + way, False
    return (end if slide else _off_the_edge(surface, start, moved)), True


def _off_the_edge(surface: Surface, start: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The first place ``(2,)`` on the way that comes within about `SHORT` of an edge.

    Habitat's own step can cross a notch of the mesh and end behind it, so the way is followed from its start: each time
    as far as nothing can be met.
    """
    length, gone, clear = float(np.hypot(*moved)), 0.0, math.inf
    if length == 0:
        return start.copy()
    while gone < length and clear > SHORT + HELD:
        here = surface.feet(start + moved * (gone / length))
        clear = float(surface.pathfinder.distance_to_closest_obstacle(here, FAR))
        gone += max(0.0, clear - SHORT)
    return start + moved * min(1.0, gone / length)
