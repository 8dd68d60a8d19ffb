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
from eagor.worlds.ground import BESIDE, Ground
from eagor.worlds.habitat.simulator import Frames
from eagor.worlds.habitat.surface import CELL, Storey, Surface, rasterised, stepped, triangles_of
from eagor.worlds.scene import Instance, Room
from eagor.worlds.walkable import Field

__all__ = ["LEVEL", "NavMesh", "NavWay"]


@dataclass(frozen=True, eq=False)
class NavWay:
    """Geodesic distances to the nearest of goals ``(n, 3)``, each starting at its offset ``(n,)``, metres.

    Goals are in Habitat's world, as Habitat is asked for them. `plan`: the same storey in cells, for `over_plan`.
    """

    surface: Surface
    plan: Ground
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
        if not self.surface.is_free(xy):
            return best, which
        feet = self.surface.feet(xy)
        least = np.linalg.norm(self.goals - feet, axis=1) + self.offsets
        for index in np.argsort(least):
            if least[index] >= best:
                break
            metres = self.surface.between(feet, self.goals[index])[0] + float(self.offsets[index])
            if metres < best:
                best, which = metres, int(index)
        return best, which

    def union(self, *others: NavWay) -> NavWay:
        """The distance to the nearest goal of this one and the others."""
        ways = (self, *others)
        goals, offsets = (np.concatenate([getattr(way, name) for way in ways]) for name in ("goals", "offsets"))
        return NavWay(self.surface, self.plan, goals, offsets)

    @lazy
    def over_plan(self) -> Field:
        """The same over the plan, to its accuracy."""
        points, starts = [], []
        for goal, start in zip(self.surface.frames.from_habitat(self.goals)[:, :2], self.offsets, strict=True):
            near = self.plan.snap(goal, within=2 * self.plan.cell)
            if near is not None:
                points.append(near)
                starts.append(start + float(np.hypot(*(near - goal))))
        return self.plan.field(np.array(points).reshape(-1, 2), np.array(starts))


# --- the ground of a scene in Habitat ---------------------------------------------------------------------------------

LEVEL = 0.15  # metres: heights within it are the floor itself (rugs, sills, the steps of the mesh)
BLOCK = 0.25  # metres: of the places beside a thing, one is kept in each square of this size
PLACES = 48  # places beside a thing that are looked at
TRIES = 20  # random points until one is on the mesh

Sees = Callable[[np.ndarray, Instance], bool]  # whether a body that stands at a point (2,) sees an instance


class NavMesh:
    """One storey of a navigation mesh.

    `pathfinder`: Habitat's; `sees`: tells from which points beside it a thing can be seen, None: from all; `level`:
    metres, heights within it are the floor itself. Raises `WorldError` if the storey has no ground.
    """

    def __init__(
        self, pathfinder: Any, storey: Storey, frames: Frames, radius: float, rooms: tuple[Room, ...] = (),
        sees: Sees | None = None, source: str = "the scene", level: float = LEVEL,
    ) -> None:  # fmt: skip
        self.radius, self.rooms, self.sees, self.source, self.level = radius, rooms, sees, source, level
        self._ways: dict[int, tuple[Instance, NavWay]] = {}
        origin, heights = rasterised(triangles_of(pathfinder, storey.island), storey, frames)
        covered = np.isfinite(heights)
        if not covered.any():
            raise WorldError(f"nowhere in {source} can a body of radius {radius:g} m stand on this storey")
        labels, _ = ndimage.label(covered)  # type: ignore[misc]
        largest = labels == np.bincount(labels.ravel())[1:].argmax() + 1
        clearance = np.asarray(ndimage.distance_transform_edt(largest)) * CELL + radius * largest
        self.surface = Surface(pathfinder, storey, frames, origin, np.where(largest, heights, np.nan), source)
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

    @property
    def pathfinder(self) -> Any:
        """Habitat's PathFinder, which holds the mesh."""
        return self.surface.pathfinder

    def feet(self, xy: np.ndarray) -> np.ndarray:
        """The point ``(3,)`` of Habitat's world at which a body stands at a point ``(2,)``, close to the mesh."""
        return self.surface.feet(xy)

    def height(self, xy: np.ndarray) -> float:
        """Height of the ground under a point ``(2,)``: 0 on the floor of the storey, else that of the step or stair."""
        above = self.surface.height(xy) - self.surface.storey.level
        return above if abs(above) > self.level else 0.0

    # --- points ---

    def is_free(self, xy: np.ndarray) -> np.ndarray:
        """Whether the body can stand at points ``(..., 2)``; False off the storey and for NaN."""
        points = np.asarray(xy, dtype=np.float64)
        flat = [self.surface.is_free(point) for point in points.reshape(-1, 2)]
        return np.array(flat, dtype=bool).reshape(points.shape[:-1])

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

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> NavWay:
        """Distances to the nearest of points ``(n, 2)`` or ``(2,)``; those that are not free are ignored."""
        points = np.atleast_2d(np.asarray(points, dtype=np.float64))
        starts = np.zeros(len(points)) if offsets is None else np.array(np.broadcast_to(offsets, len(points)))
        if points.shape != (len(points), 2) or not (np.isfinite(starts) & (starts >= 0)).all():
            raise WorldError(
                f"points have shape {points.shape}, offsets {starts.tolist()}; wanted (n, 2) and finite metres >= 0"
            )
        stand = self.is_free(points)
        goals = np.array([self.feet(point) for point in points[stand]], dtype=np.float64).reshape(-1, 3)
        return NavWay(self.surface, self.plan, goals, starts[stand])

    def field_to_places(self, places: np.ndarray) -> NavWay:
        """Distances to the nearest of places ``(n, 3)``, our world, as habitat-lab measures them (`Surface.between`).

        Places beside the mesh, or on another storey, count as well.
        """
        goals = self.surface.frames.to_habitat(np.asarray(places, dtype=np.float64).reshape(-1, 3))
        return NavWay(self.surface, self.plan, goals, np.zeros(len(goals)))

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
        self.surface.check_free(start)
        if isinstance(goal, NavWay):
            index = goal.nearest(start)[1]
            place = goal.goals[index] if index >= 0 else None
            end = None if place is None else self.surface.frames.from_habitat(place)[:2]
        else:
            end = np.asarray(goal, dtype=np.float64)
            place = self.feet(end)
        metres, points = (math.inf, None) if place is None else self.surface.between(self.feet(start), place)
        if points is None or end is None or not math.isfinite(metres):
            raise WorldError(
                f"there is no path from ({start[0]:.2f}, {start[1]:.2f}) to the goal over the navigation mesh of "
                f"{self.source}; snap() finds free ground"
            )
        return np.concatenate([start[None], points[1:-1], end[None]])

    # --- steps ---

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = True) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided: `steps.stepped`."""
        return stepped(self.surface, xy, step, slide)
