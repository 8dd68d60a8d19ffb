"""Which part of a navigation mesh is walked on: the largest island under a roof, and one storey of it.

Meshes have islands on roofs, beds and tables, and islands that run over stairs through several storeys. Heights are
Habitat's y, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.ground import STOREY

__all__ = ["BAND", "Storey", "main_storey", "triangles_of"]

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
