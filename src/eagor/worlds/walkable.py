"""The ground that tasks walk on, whoever holds it: our own plan of a scene, or another simulator's navigation mesh.

`Walkable` is the part of `eagor.worlds.ground.Ground` that tasks and reports use. Paths over it are polylines, from
which `follow_path` and `stroll` make one pose per step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from eagor.worlds.scene import Instance

__all__ = ["Walkable", "Way", "along", "follow_path", "initial_heading", "length_of", "stroll"]


class Way(Protocol):
    """Shortest distances over a ground to one goal or set of goals."""

    def distance(self, xy: np.ndarray, /) -> np.ndarray:
        """Metres ``(...)`` from points ``(..., 2)``; inf without a path, off the ground and for NaN."""
        ...

    def union(self, *others: Any) -> Way:
        """The distance to the nearest goal of this one and the others, on the same ground."""
        ...


class Walkable(Protocol):
    """Where a round body can stand, path lengths, and steps with collisions; metres, world frame.

    A point is ``(2,)``: x and y. The plan is for maps and for choosing places: square cells of side `cell`, cell (0, 0)
    with its low corner at `origin` ``(2,)``; `free`, `structure` (bool) and `clearance` (metres) are ``(rows, cols)``,
    rows along y.
    """

    @property
    def radius(self) -> float:
        """Of the body."""
        ...

    @property
    def floor(self) -> float:
        """Height of the floor."""
        ...

    @property
    def origin(self) -> np.ndarray: ...
    @property
    def cell(self) -> float: ...
    @property
    def free(self) -> np.ndarray: ...
    @property
    def structure(self) -> np.ndarray: ...
    @property
    def clearance(self) -> np.ndarray: ...

    @property
    def points(self) -> np.ndarray:
        """Places to choose from ``(n, 2)``: the centres of the free cells, in reading order."""
        ...

    def at_points(self, way: Any, /) -> np.ndarray:
        """Metres ``(n,)`` of a way of this ground from all `points`, to the accuracy of the plan."""
        ...

    def height(self, xy: np.ndarray, /) -> float:
        """Height of the ground under a point: `floor`, unless there are steps, ramps or stairs."""
        ...

    def is_free(self, xy: np.ndarray, /) -> np.ndarray:
        """Whether the body can stand at points ``(..., 2)``; False off the ground and for NaN."""
        ...

    def snap(self, xy: np.ndarray, within: float = ...) -> np.ndarray | None:
        """The free point nearest to a point; None if there is none `within` this many metres, and for NaN."""
        ...

    def sample(self, rng: np.random.Generator, clearance: float = ...) -> np.ndarray:
        """A random free point of at least this `clearance` (m). Raises `WorldError` if there is none."""
        ...

    def field(self, points: np.ndarray, offsets: np.ndarray | None = None) -> Way:
        """Distances to the nearest of points ``(n, 2)`` or ``(2,)``; each starts at its offset ``(n,)`` or 0."""
        ...

    def footprint(self, instance: Instance, /) -> Way:
        """Distances to the footprint of an instance, via points `beside` it; inf everywhere without any."""
        ...

    def beside(self, instance: Instance, /) -> tuple[np.ndarray, np.ndarray]:
        """The free points ``(k, 2)`` beside an instance, and their distances ``(k,)`` to its footprint."""
        ...

    def path(self, start: np.ndarray, goal: Any) -> np.ndarray:
        """The shortest path ``(n, 2)`` from a free point to another, or along a way. `WorldError` if there is none."""
        ...

    def move(self, xy: np.ndarray, step: np.ndarray, slide: bool = ...) -> tuple[np.ndarray, bool]:
        """The end of a step ``(2,)`` from a free point, which is free, too, and whether it collided."""
        ...


def initial_heading(path: np.ndarray, ahead: float = 0.5) -> float:
    """The initial heading (yaw, radians) of a path ``(n, 2)``, over its first `ahead` metres."""
    point = along(path, np.array([ahead]))[0]
    return float(np.arctan2(*(point - path[0])[::-1]))


def along(path: np.ndarray, metres: np.ndarray) -> np.ndarray:
    """The points ``(m, 2)`` of a polyline at these lengths from its start (clamped at its end)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))])
    return np.stack([np.interp(metres, lengths, path[:, axis]) for axis in (0, 1)], axis=-1)


def length_of(path: np.ndarray) -> float:
    """Its length in metres."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum())


def follow_path(path: np.ndarray, yaw: float, step: float, turn: float) -> np.ndarray:
    """One row of x, y, yaw per step ``(n, 3)`` along `path`, for a body that faces its walking direction.

    It starts with heading `yaw`, goes `step` metres at a time, and turns by at most `turn` radians per step; where the
    path bends more, it turns on the spot.
    """
    rows = []
    count = max(1, round(length_of(path) / step))
    points = along(path, np.arange(count + 1) * step)
    for here, there in pairwise(points):
        heading = math.atan2(there[1] - here[1], there[0] - here[0])
        while abs(left := math.remainder(heading - yaw, 2 * math.pi)) > turn + 1e-9:
            yaw = math.remainder(yaw + math.copysign(turn, left), 2 * math.pi)
            rows.append((here[0], here[1], yaw))
        yaw = heading
        rows.append((there[0], there[1], yaw))
    return np.array(rows)


def stroll(ground: Walkable, start: np.ndarray, step: float, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Points ``(2,)`` without end, `step` metres apart: along paths from `start` to one random goal after another."""
    last = np.asarray(start, dtype=np.float64)
    yield last
    while True:
        path = ground.path(last, ground.sample(rng))
        points = along(path, np.arange(step, max(length_of(path), step) + 1e-9, step))
        yield from points
        last = points[-1]
