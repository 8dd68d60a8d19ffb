"""Walking along paths on the floor: from a polyline to one pose per step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from eagor.worlds.walkable import Walkable

__all__ = ["along", "follow_path", "initial_heading", "length_of", "stroll"]


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
