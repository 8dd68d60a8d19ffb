"""The ground of a scene in Habitat: `HabitatNavMesh`, one storey of its navigation mesh.

Meshes have islands on roofs, beds and tables, and islands that run over stairs through several storeys. `main_storey`
tells which is walked on: never a roof. Steps, paths and geodesic distances are those of Habitat's PathFinder. The plan
of square cells, made from the mesh, is for maps and for choosing places; distances over it are a few per cent longer.
Heights are Habitat's y, metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from eagor._values import lazy
from eagor.errors import WorldError
from eagor.lab.worlds.ground import BESIDE, Ground, checked_goals, largest_area
from eagor.lab.worlds.habitat import Frames, import_habitat
from eagor.lab.worlds.navmesh import DistanceField
from eagor.lab.worlds.scene import Instance, Raycaster, Room

BAND = 1.2  # metres above and below its floor that belong to a storey: half a flight of stairs
BIN = 0.1  # metres: heights within it count as one level
SMALLEST = 1.0  # square metres: no smaller island is looked at
SPOTS = 12  # places of an island from which one looks up
CELL = 0.05  # metres: side of a cell, as of our own plans
ON_MESH = 1e-3  # metres in plan within which a place is on the mesh
HELD = 1e-4  # metres by which a step falls short that has collided: the mesh is in single precision
SHORT = 1e-3  # metres off the edge at which a step without sliding ends: no step leads away from the edge itself
FAR = 2.0  # metres within which an edge is looked for
LEVEL = 0.15  # metres: heights within it are the floor itself (rugs, sills, the steps of the mesh)
BLOCK = 0.25  # metres: of the places beside a thing, one is kept in each square of this size
PLACES = 48  # places beside a thing that are looked at
TRIES = 20  # random points until one is on the mesh


def main_storey(
    pathfinder: Any, roofed: Callable[[np.ndarray], float], height: float | None = None, source: str = "the scene"
) -> tuple[int, float]:
    """The island to walk on, and the height of its floor on the mesh (which floats above the true floor).

    The storey nearest to `height`, or the largest under a roof, or, without one, the largest. `roofed` tells the share
    of points ``(n, 3)`` of the mesh with something above them. Raises `WorldError` if there is no island, or none at
    that height.
    """
    levels = [
        (area, island, level)
        for island in range(pathfinder.num_islands)
        if pathfinder.island_area(island) >= SMALLEST
        for area, level in levels_of(triangles_of(pathfinder, island))
    ]
    if not levels:
        raise WorldError(
            f"nowhere in {source} is there a square metre to walk on; is it the right way up (habitat:SCENE?up=y or "
            "?up=z), and is the body small enough for it?"
        )
    levels.sort(reverse=True)
    if height is not None:
        near = [each for each in levels if abs(each[2] - height) <= BAND]
        if not near:
            known = ", ".join(sorted({f"{level:.1f}" for area, _, level in levels if area >= SMALLEST}))
            raise WorldError(f"{source} has no storey at the height {height:g} m; it has some at {known} m")
        large = [each for each in near if each[0] >= SMALLEST] or near
        nearest = min(abs(level - height) for _, _, level in large)
        # Islands of one floor differ by what the mesh is rounded to: among these the largest counts.
        return next(each[1:] for each in large if abs(each[2] - height) <= nearest + BIN)
    for _, island, level in levels:
        triangles = triangles_of(pathfinder, island)
        near = triangles[np.abs(triangles[:, :, 1].mean(axis=1) - level) <= 2 * BIN]
        if roofed(near[np.argsort(-_areas(near))[:SPOTS]].mean(axis=1)) > 0.5:
            return island, level
    return levels[0][1:]


def triangles_of(pathfinder: Any, island: int) -> np.ndarray:
    """The triangles ``(n, 3, 3)`` of an island, in Habitat's world."""
    vertices = np.array(pathfinder.build_navmesh_vertices(island), dtype=np.float64).reshape(-1, 3)
    return vertices[np.array(pathfinder.build_navmesh_vertex_indices(island), dtype=np.int64).reshape(-1, 3)]


def levels_of(triangles: np.ndarray) -> list[tuple[float, float]]:
    """The levels of an island: area (square metres) and height of each, which is the commonest within `BAND` of it."""
    heights, areas = triangles[:, :, 1].mean(axis=1), _areas(triangles)
    bins = np.round(heights / BIN).astype(int)
    total = np.bincount(bins - bins.min(), areas)
    most = ndimage.maximum_filter1d(total, 2 * round(BAND / BIN) + 1, mode="constant")
    found = []
    for centre in BIN * (np.flatnonzero((total == most) & (total > 0)) + bins.min()):
        level = float(np.average(heights, weights=areas * (np.abs(heights - centre) <= BIN)))
        found.append((float(areas[np.abs(heights - level) <= BAND].sum()), level))
    return found


def _areas(triangles: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


@dataclass(frozen=True, eq=False)
class NavMeshDistance(DistanceField):
    """Geodesic distances to the nearest of `goals` ``(n, 3)``, Habitat's world, each from its offset ``(n,)``, metres.

    `metres` are those over the plan, `distance` is what Habitat says.
    """

    ground: HabitatNavMesh
    goals: np.ndarray
    offsets: np.ndarray

    def distance(self, xy: np.ndarray) -> np.ndarray:
        points = np.asarray(xy, dtype=np.float64)
        return np.array([self.path(point)[0] for point in points.reshape(-1, 2)]).reshape(points.shape[:-1])

    def path(self, xy: np.ndarray) -> tuple[float, np.ndarray]:
        """The distance from a point ``(2,)``, inf without a path, and the path ``(n, 2)`` to the goal at it."""
        best, way = math.inf, np.zeros((0, 2))
        if self.ground.is_free(xy):
            feet = self.ground.feet(xy)
            least = np.linalg.norm(self.goals - feet, axis=1) + self.offsets
            for index in np.argsort(least):
                if least[index] >= best:
                    break
                found = import_habitat().ShortestPath()
                found.requested_start, found.requested_end = feet, self.goals[index].astype(np.float32)
                if self.ground.pathfinder.find_path(found):
                    metres = float(found.geodesic_distance) + float(self.offsets[index])
                    if metres < best:
                        best, way = metres, np.array([*found.points[:-1], self.goals[index]], dtype=np.float64)
        return best, self.ground.frames.from_habitat(way.reshape(-1, 3))[:, :2]

    def union(self, *others: DistanceField) -> NavMeshDistance:
        goals, offsets = (
            np.concatenate([getattr(way, name) for way in (self, *others)]) for name in ("goals", "offsets")
        )
        return NavMeshDistance(**vars(super().union(*others)), ground=self.ground, goals=goals, offsets=offsets)


@dataclass(frozen=True, eq=False, kw_only=True)
class HabitatNavMesh(Ground):
    """One storey of a navigation mesh.

    `pathfinder`: Habitat's; `island` and `level`: as of `main_storey`; `heights` ``(rows, cols)``: of the mesh in each
    cell (beside the storey, those of its nearest cells); `sees`: whether a thing is seen from a point ``(2,)`` above
    which a camera stands at a height (metres); `source`: for errors.
    """

    pathfinder: Any
    island: int
    level: float
    heights: np.ndarray
    frames: Frames
    source: str
    sees: Callable[[np.ndarray, float, Instance], bool]

    @classmethod
    def of(
        cls, pathfinder: Any, storey: tuple[int, float], frames: Frames, radius: float, rooms: tuple[Room, ...] = (),
        source: str = "the scene", sees: Callable[[np.ndarray, float, Instance], bool] = lambda *_: True,
    ) -> HabitatNavMesh:  # fmt: skip
        """A storey, as of `main_storey`, for a body of this `radius`.

        Where two levels of it lie over each other, the one nearer to its floor counts. Raises `WorldError` without any
        ground.
        """
        island, level = storey
        corners = frames.from_habitat(triangles_of(pathfinder, island))
        low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
        origin = np.floor(low / CELL) * CELL - 2 * CELL  # aligned with our own plans
        cols, rows = (int(n) for n in np.ceil((high - origin) / CELL) + 2)
        y, x = origin[::-1, None] + (np.indices((rows, cols)).reshape(2, -1) + 0.5) * CELL
        base = level + ON_MESH  # what lies on the floor is below
        start = np.stack([x, y, np.full(len(x), base - frames.floor)], axis=1)
        mesh = Raycaster(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        up, down = (mesh.cast(start, np.broadcast_to([0.0, 0.0, way], start.shape)).distance for way in (1.0, -1.0))
        off = np.where(down <= up, -down, up).reshape(rows, cols)
        free = largest_area(np.abs(off) <= BAND)
        if not free.any():
            raise WorldError(f"nowhere in {source} can a body of radius {radius:g} m stand on this storey")
        clearance = np.asarray(ndimage.distance_transform_edt(free)) * CELL + radius * free
        nearest = np.asarray(ndimage.distance_transform_edt(~free, return_distances=False, return_indices=True))
        return cls(
            origin, CELL, radius, 0.0, free, clearance, np.zeros_like(free), rooms, pathfinder=pathfinder,
            island=island, level=level, heights=(base + off.astype(np.float64))[tuple(nearest)], frames=frames,
            source=source, sees=sees,
        )  # fmt: skip

    @lazy
    def plan(self) -> Ground:
        """The plan alone, without Habitat."""
        return Ground(
            self.origin, self.cell, self.radius, self.floor, self.free, self.clearance, self.structure, self.rooms
        )

    # --- points ---

    def feet(self, xy: np.ndarray) -> np.ndarray:
        """The point ``(3,)`` of Habitat's world at which a body stands at a point ``(2,)``, close to the mesh."""
        col, row = np.clip((xy - self.origin) // CELL, 0, np.array(self.free.shape[::-1]) - 1).astype(int)
        found = self.frames.to_habitat(np.array([xy[0], xy[1], 0.0]))
        found[1] = self.heights[row, col]
        found = found.astype(np.float32)
        snapped = np.array(self.pathfinder.snap_point(found), dtype=np.float32)  # NaN with no mesh around
        if np.abs(snapped - found)[[0, 2]].max() < ON_MESH:
            found[1] = snapped[1]
        return found

    def height(self, xy: np.ndarray) -> float:
        above = float(self.feet(xy)[1]) - self.level
        return above if abs(above) > LEVEL else 0.0

    def is_free(self, xy: np.ndarray) -> np.ndarray:
        points = np.asarray(xy, dtype=np.float64)
        flat = [np.isfinite(point).all() and self._stands(self.feet(point)) for point in points.reshape(-1, 2)]
        return np.array(flat, dtype=bool).reshape(points.shape[:-1])

    def _stands(self, feet: np.ndarray) -> bool:
        on_storey = abs(float(feet[1]) - self.level) <= BAND and self.pathfinder.is_navigable(feet, 0.5)
        return on_storey and self.pathfinder.get_island(feet) == self.island

    def snap(self, xy: np.ndarray, within: float = math.inf) -> np.ndarray | None:
        xy = np.asarray(xy, dtype=np.float64)
        if self.is_free(xy):
            return xy.copy()
        away = np.hypot(*(self.points - xy).T)  # the middles of free cells are on the mesh
        best = int(away.argmin())
        return self.points[best] if away[best] <= within else None

    def sample(self, rng: np.random.Generator, clearance: float = 0.0) -> np.ndarray:
        for _ in range(TRIES):
            if self.is_free(point := super().sample(rng, clearance)):
                return point
        return self.points[rng.integers(len(self.points))]

    # --- distances ---

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> NavMeshDistance:
        points, starts = checked_goals(points, offsets)
        stand = self.is_free(points)
        goals = np.array([self.feet(point) for point in points[stand]], dtype=np.float64).reshape(-1, 3)
        # A goal at the edge may lie beside the cells of the plan.
        near, offs = [], []
        for goal, start in zip(self.frames.from_habitat(goals)[:, :2], starts[stand], strict=True):
            if (cell := self.plan.snap(goal, 2 * CELL)) is not None:
                near.append(cell)
                offs.append(start + float(np.hypot(*(cell - goal))))
        metres = self.plan.field(np.array(near).reshape(-1, 2), np.array(offs)).metres
        return NavMeshDistance(self.origin, CELL, metres, self, goals, starts[stand])

    def footprint(self, instance: Instance) -> NavMeshDistance:
        return self.field(*self.beside(instance))

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
        close = away[chosen] <= BESIDE
        for group in (chosen[close][:PLACES], chosen[~close][:PLACES]):
            seen = np.array([k for k in group if self.sees(points[k], self.height(points[k]), instance)], dtype=int)
            if len(seen):
                kept = seen[away[seen] <= away[seen].min() + BESIDE]
                return points[kept], away[kept]
        return points[chosen[:1]], away[chosen[:1]]

    def path(self, start: np.ndarray, goal: np.ndarray | DistanceField) -> np.ndarray:
        start = self._checked(start)
        way = goal if isinstance(goal, NavMeshDistance) else self.field(np.asarray(goal))
        metres, path = way.path(start)
        if not math.isfinite(metres):
            raise WorldError(
                f"there is no path from ({start[0]:.2f}, {start[1]:.2f}) to the goal over the navigation mesh of "
                f"{self.source}; snap() finds free ground"
            )
        path[0] = start
        if not isinstance(goal, NavMeshDistance):
            path[-1] = goal
        return path

    # --- steps ---

    def _checked(self, point: np.ndarray) -> np.ndarray:
        """A point ``(2,)`` on which the body can stand, float64. Raises `WorldError`."""
        found = np.asarray(point, dtype=np.float64)
        if not self.is_free(found):
            raise WorldError(
                f"({found[0]:.3f}, {found[1]:.3f}) is not on the navigation mesh of this storey of {self.source}; "
                "start from a free point, such as snap() gives"
            )
        return found

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = True) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point ``(2,)``, and whether it collided: Habitat's ``try_step``.

        A blocked step slides along the edge of the mesh (`slide`), or the body stops a millimetre off every edge: for
        Habitat-Sim 0.3.4 every step of a body that stands on the edge crosses it. It never leaves the storey. Raises
        `WorldError` if the start is not free or the step not finite.
        """
        way = np.asarray(step, dtype=np.float64)
        if not np.isfinite(way).all():
            raise WorldError(f"step = ({way[0]}, {way[1]}); wanted two finite numbers, metres")
        start = self._checked(xy)
        if not way.any():
            return start.copy(), False
        feet, ahead = self.feet(start), self.frames.to_habitat(np.array([*(start + way), 0.0]))
        ahead[1] = feet[1]
        tried = self.pathfinder.try_step if slide else self.pathfinder.try_step_no_sliding
        end = self.frames.from_habitat(np.array(tried(feet, ahead.astype(np.float32)), dtype=np.float64))[:2]
        moved = end - start
        if not np.isfinite(end).all() or np.hypot(*moved) > np.hypot(*way) + HELD or not self.is_free(end):
            return start.copy(), True
        # Freely moved, the body is where the step led, not where single precision has put it.
        if np.hypot(*(moved - way)) <= HELD:
            return start + way, False
        if slide:
            return end, True
        # Habitat's own step can cross a notch of the mesh and end behind it, so the way is followed from its start:
        # each time as far as nothing can be met, to the first place that comes within about `SHORT` of an edge.
        length, gone, clear = float(np.hypot(*moved)), 0.0, math.inf
        while gone < length and clear > SHORT + HELD:
            here = self.feet(start + moved * (gone / length))
            clear = float(self.pathfinder.distance_to_closest_obstacle(here, FAR))
            gone += max(0.0, clear - SHORT)
        return start + moved * min(1.0, gone / max(length, gone, 1e-12)), True
