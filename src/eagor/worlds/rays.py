"""What can be asked of a ray caster, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor.errors import WorldError


@dataclass(frozen=True, eq=False)
class Hits:
    """The first thing on each of n rays.

    `distance` ``(n,)`` float32, in lengths of the ray's direction (metres for unit directions), inf where nothing is
    hit; `triangle` ``(n,)`` int32, -1 where nothing is hit; `u` and `v` ``(n,)`` float32, the barycentric weights of
    the triangle's corners 1 and 2 (corner 0 has 1 - u - v; 0 where nothing is hit).
    """

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray


class Raycaster(Protocol):
    """Triangles that rays can be sent at. Rays are float32 arrays ``(n, 3)``, world frame, metres."""

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest triangle along each ray. Directions need not have unit length."""
        ...

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """Whether anything lies within `reach` (in lengths of the direction, a number or ``(n,)``), bool ``(n,)``."""
        ...


def checked_rays(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as float32 ``(n, 3)``. Raises `WorldError` where their shapes differ."""
    origins, directions = np.asarray(origins, dtype=np.float32), np.asarray(directions, dtype=np.float32)
    if origins.shape != directions.shape or origins.ndim != 2 or origins.shape[1] != 3:
        raise WorldError(
            f"rays have origins {origins.shape} and directions {directions.shape}; wanted both (n, 3). One origin for "
            "all rays: np.broadcast_to(origin, directions.shape)"
        )
    return origins, directions
