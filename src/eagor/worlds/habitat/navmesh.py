"""The ground of a scene in Habitat: `Walkable` over its navigation mesh.

Steps, paths and geodesic distances are those of Habitat's PathFinder, on one storey of one island: never on a roof. A
plan of square cells, made from the mesh, is for maps and for choosing places; distances over it are those of the plan,
a few per cent longer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from eagor._lazy import lazy
from eagor.errors import WorldError
from eagor.worlds.geodesics import Field
from eagor.worlds.ground import BESIDE, Ground
from eagor.worlds.habitat.frames import Frames
from eagor.worlds.habitat.probe import import_habitat
from eagor.worlds.habitat.raster import CELL, rasterised
from eagor.worlds.habitat.storeys import BAND, Storey, triangles_of
from eagor.worlds.scene import Instance, Room

__all__ = ["NavMesh", "NavWay"]

LEVEL = 0.15  # metres: heights within it are the floor itself (rugs, sills, the steps of the mesh)
BLOCK = 0.25  # metres: of the places beside a thing, one is kept in each square of this size
PLACES = 48  # places beside a thing that are looked at
HELD = 1e-4  # metres by which a step falls short that has collided: the mesh is in single precision
SHORT = 1e-3  # metres before the edge at which a step without sliding ends: no step leads away from the edge itself
TRIES = 20  # random points until one is on the mesh

Sees = Callable[[np.ndarray, Instance], bool]  # whether a body that stands at a point (2,) sees an instance


@dataclass(frozen=True, eq=False)
class NavWay:
    """Geodesic distances to the nearest of goals ``(n, 2)``, each starting at its offset ``(n,)``, metres."""

    ground: NavMesh
    goals: np.ndarray
    offsets: np.ndarray

    def distance(self, xy: np.ndarray) -> np.ndarray:
        """Metres ``(...)`` from points ``(..., 2)``; inf without a path, off the ground and for NaN."""
        points = np.asarray(xy, dtype=np.float64)
        flat = [self.nearest(point)[0] for point in points.reshape(-1, 2)]
        return np.array(flat).reshape(points.shape[:-1])

    def nearest(self, xy: np.ndarray) -> tuple[float, int]:
        """The distance from a point ``(2,)``, and the index of the goal at that distance (-1: none)."""
        best, which = math.inf, -1
        if not bool(self.ground.is_free(xy)):
            return best, which
        least = np.hypot(*(self.goals - xy).T) + self.offsets
        for index in np.argsort(least):
            if least[index] >= best:
                break
            metres = self.ground.between(xy, self.goals[index])[0] + float(self.offsets[index])
            if metres < best:
                best, which = metres, int(index)
        return best, which

    def union(self, *others: NavWay) -> NavWay:
        """The distance to the nearest goal of this one and the others."""
        ways = (self, *others)
        return NavWay(
            self.ground, np.concatenate([way.goals for way in ways]), np.concatenate([way.offsets for way in ways])
        )

    @lazy
    def over_plan(self) -> Field:
        """The same over the plan, to its accuracy."""
        plan = self.ground.plan
        points, starts = [], []
        for goal, start in zip(self.goals, self.offsets, strict=True):
            near = plan.snap(goal, within=2 * plan.cell)
            if near is not None:
                points.append(near)
                starts.append(start + float(np.hypot(*(near - goal))))
        return plan.field(np.array(points).reshape(-1, 2), np.array(starts))


class NavMesh:
    """One storey of a navigation mesh.

    `pathfinder`: Habitat's; `sees`: tells from which points beside it a thing can be seen, None: from all. Raises
    `WorldError` if the storey has no ground.
    """

    def __init__(
        self, pathfinder: Any, storey: Storey, frames: Frames, radius: float, rooms: tuple[Room, ...] = (),
        sees: Sees | None = None, source: str = "the scene",
    ) -> None:  # fmt: skip
        self.pathfinder, self.storey, self.frames, self.radius = pathfinder, storey, frames, radius
        self.rooms, self.sees, self.source = rooms, sees, source
        self._ways: dict[int, tuple[Instance, NavWay]] = {}
        origin, heights = rasterised(triangles_of(pathfinder, storey.island), storey, frames)
        covered = np.isfinite(heights)
        if not covered.any():
            raise WorldError(f"nowhere in {source} can a body of radius {radius:g} m stand on this storey")
        labels, _ = ndimage.label(covered)  # type: ignore[misc]
        largest = labels == np.bincount(labels.ravel())[1:].argmax() + 1
        clearance = np.asarray(ndimage.distance_transform_edt(largest)) * CELL + radius * largest
        self.heights = np.where(largest, heights, np.nan)  # Habitat's y in each cell of the plan
        structure = np.zeros_like(largest)
        self.plan = Ground(origin, CELL, radius, 0.0, largest, clearance, structure, rooms)

    # The plan, as in `eagor.worlds.walkable`.
    floor = 0.0

    @property
    def origin(self) -> np.ndarray:
        return self.plan.origin

    @property
    def cell(self) -> float:
        return self.plan.cell

    @property
    def free(self) -> np.ndarray:
        return self.plan.free

    @property
    def structure(self) -> np.ndarray:
        return self.plan.structure

    @property
    def clearance(self) -> np.ndarray:
        return self.plan.clearance

    @property
    def points(self) -> np.ndarray:
        """The centres ``(n, 2)`` of the free cells, in reading order."""
        return self.plan.points

    # --- between the plane and the mesh ---

    def feet(self, xy: np.ndarray) -> np.ndarray:
        """The point ``(3,)`` of Habitat's world at which a body stands at a point ``(2,)``, close to the mesh."""
        x, y = float(xy[0]), float(xy[1])
        found = self.frames.to_habitat(np.array([x, y, 0.0]))
        found[1] = self._mesh_height(x, y)
        return found.astype(np.float32)

    def _mesh_height(self, x: float, y: float) -> float:
        """Habitat's y of the mesh at a point: of its cell, of the nearest cell around, or of the storey's floor."""
        rows, cols = self.heights.shape
        col, row = int((x - self.origin[0]) // CELL), int((y - self.origin[1]) // CELL)
        if 0 <= row < rows and 0 <= col < cols and np.isfinite(self.heights[row, col]):
            return float(self.heights[row, col])
        part = self.heights[max(0, row - 2) : max(0, row + 3), max(0, col - 2) : max(0, col + 3)]
        near = part[np.isfinite(part)]
        return float(near.mean()) if len(near) else self.storey.level

    def height(self, xy: np.ndarray) -> float:
        """Height of the ground under a point ``(2,)``: 0 on the floor of the storey, else that of the step or stair."""
        above = self._mesh_height(float(xy[0]), float(xy[1])) - self.storey.level
        return above if abs(above) > LEVEL else 0.0

    # --- points ---

    def is_free(self, xy: np.ndarray) -> np.ndarray:
        """Whether the body can stand at points ``(..., 2)``; False off the storey and for NaN."""
        points = np.asarray(xy, dtype=np.float64)
        flat = [self._is_free(point) for point in points.reshape(-1, 2)]
        return np.array(flat, dtype=bool).reshape(points.shape[:-1])

    def _is_free(self, point: np.ndarray) -> bool:
        if not np.isfinite(point).all():
            return False
        feet = self.feet(point)
        if abs(float(feet[1]) - self.storey.level) > BAND or not self.pathfinder.is_navigable(feet, 0.5):
            return False
        return self.pathfinder.get_island(feet) == self.storey.island

    def snap(self, xy: np.ndarray, within: float = math.inf) -> np.ndarray | None:
        """The free point ``(2,)`` nearest to a point, to a cell of the plan; None if none is `within`, and for NaN."""
        xy = np.asarray(xy, dtype=np.float64)
        if bool(self.is_free(xy)):
            return xy.copy()
        found = self.plan.snap(xy, within)
        if found is None or bool(self.is_free(found)):
            return found
        centre = self.points[np.hypot(*(self.points - found).T).argmin()]
        return centre.copy() if np.hypot(*(centre - xy)) <= within else None

    def sample(self, rng: np.random.Generator, clearance: float = 0.0) -> np.ndarray:
        """A free point ``(2,)``, uniform over the cells of at least this `clearance` (m). `WorldError` if none."""
        point = self.plan.sample(rng, clearance)
        for _ in range(TRIES):
            if bool(self.is_free(point)):
                return point
            point = self.plan.sample(rng, clearance)
        return self.points[np.hypot(*(self.points - point).T).argmin()].copy()

    # --- distances ---

    def between(self, start: np.ndarray, goal: np.ndarray) -> tuple[float, np.ndarray]:
        """Geodesic metres between two free points ``(2,)``, inf without a path, and the path ``(n, 2)``."""
        path = import_habitat().ShortestPath()
        path.requested_start, path.requested_end = self.feet(start), self.feet(goal)
        if not self.pathfinder.find_path(path):
            return math.inf, np.zeros((0, 2))
        return float(path.geodesic_distance), self.frames.from_habitat(np.array(path.points))[:, :2]

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> NavWay:
        """Distances to the nearest of points ``(n, 2)`` or ``(2,)``; those that are not free are ignored."""
        points = np.atleast_2d(np.asarray(points, dtype=np.float64))
        starts = np.zeros(len(points)) if offsets is None else np.array(np.broadcast_to(offsets, len(points)))
        if points.shape != (len(points), 2) or not (np.isfinite(starts) & (starts >= 0)).all():
            raise WorldError(
                f"points have shape {points.shape}, offsets {starts.tolist()}; wanted (n, 2) and finite metres >= 0"
            )
        stand = self.is_free(points)
        return NavWay(self, points[stand], starts[stand])

    def at_points(self, way: NavWay) -> np.ndarray:
        """Metres ``(n,)`` of a way from all `points`, over the plan."""
        return self.plan.at_points(way.over_plan)

    def footprint(self, instance: Instance) -> NavWay:
        """Distances to the footprint of an instance, via points `beside` it; inf everywhere without any."""
        if id(instance) not in self._ways:
            self._ways[id(instance)] = instance, self.field(*self.beside(instance))
        return self._ways[id(instance)][1]

    def beside(self, instance: Instance) -> tuple[np.ndarray, np.ndarray]:
        """The free points ``(k, 2)`` beside an instance, and their distances ``(k,)`` to its footprint, metres.

        As Habitat's view points: within 0.75 m of the thing, and the thing is in sight. If there are none, the nearest
        from which it is in sight; if there are none either, the nearest. One point for each square of 0.25 m.
        """
        points = self.points
        away = np.hypot(*(np.clip(points, instance.low[:2], instance.high[:2]) - points).T)
        order = np.argsort(away, kind="stable")
        _, first = np.unique(np.floor(points[order] / BLOCK), axis=0, return_index=True)
        chosen = order[np.sort(first)]  # the nearest of each square, nearest first
        close = chosen[away[chosen] <= BESIDE]
        for group in (close[:PLACES], chosen[len(close) :][:PLACES]):
            seen = np.array([k for k in group if self.sees is None or self.sees(points[k], instance)], dtype=np.intp)
            if len(seen):
                kept = seen[away[seen] <= away[seen].min() + BESIDE]
                return points[kept], away[kept]
        return points[chosen[:1]], away[chosen[:1]]

    def path(self, start: np.ndarray, goal: np.ndarray | NavWay) -> np.ndarray:
        """The shortest path ``(n, 2)`` from a free point to another, or along a way to its goal.

        Raises `WorldError` if the start is not free or there is no path.
        """
        start = np.asarray(start, dtype=np.float64)
        self._check_free(start)
        if isinstance(goal, NavWay):
            index = goal.nearest(start)[1]
            end = goal.goals[index] if index >= 0 else None
        else:
            end = np.asarray(goal, dtype=np.float64)
        metres, points = (math.inf, None) if end is None else self.between(start, end)
        if points is None or end is None or not math.isfinite(metres):
            raise WorldError(
                f"there is no path from ({start[0]:.2f}, {start[1]:.2f}) to the goal over the navigation mesh of "
                f"{self.source}; snap() finds free ground"
            )
        return np.concatenate([start[None], points[1:-1], end[None]])

    # --- steps ---

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = True) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided: Habitat's ``try_step``.

        A blocked step slides along the edge of the mesh (`slide`), or the body stops there, a millimetre short of it:
        for Habitat-Sim 0.3.4 every step of a body that stands on the edge crosses it. It never leaves the storey.
        Raises `WorldError` if the start is not free or the step not finite.
        """
        start, way = np.asarray(xy, dtype=np.float64), np.asarray(step, dtype=np.float64)
        if not np.isfinite(way).all():
            raise WorldError(f"step = ({way[0]}, {way[1]}); wanted two finite numbers, metres")
        self._check_free(start)
        if not way.any():
            return start.copy(), False
        feet, ahead = self.feet(start), self.frames.to_habitat(np.array([*(start + way), 0.0]))
        ahead[1] = feet[1]
        tried = self.pathfinder.try_step if slide else self.pathfinder.try_step_no_sliding
        end = self.frames.from_habitat(np.array(tried(feet, ahead.astype(np.float32)), dtype=np.float64))[:2]
        moved = end - start
        if not np.isfinite(end).all() or np.hypot(*moved) > np.hypot(*way) + HELD or not bool(self.is_free(end)):
            return start.copy(), True
        # Freely moved, the body is where the step led, not where single precision has put it.
        if np.hypot(*(moved - way)) <= HELD:
            return start + way, False
        if not slide:
            length = float(np.hypot(*moved))
            end = start + moved * max(0.0, 1 - SHORT / max(length, SHORT))
        return end, True

    def _check_free(self, point: np.ndarray) -> None:
        if not bool(self.is_free(point)):
            raise WorldError(
                f"({point[0]:.3f}, {point[1]:.3f}) is not on the navigation mesh of this storey of {self.source}; "
                "start from a free point, such as snap() gives"
            )
