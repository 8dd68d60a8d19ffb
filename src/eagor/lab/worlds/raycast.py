"""Ray casting with Intel's Embree (the embreex wheel): the triangles of a scene, seen from either side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._extras import how_to_install
from eagor.errors import MissingExtraError, WorldError

_FAR = np.float32(1e37)  # distance that embreex reports for a miss


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit of each of n rays.

    `distance` ``(n,)`` float32, in lengths of the ray's direction (metres for unit directions), inf for a miss;
    `triangle` ``(n,)`` int32, -1 for a miss; `u` and `v` ``(n,)`` float32, the barycentric weights of the triangle's
    corners 1 and 2 (corner 0 has 1 - u - v; 0 for a miss).
    """

    distance: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray


class Raycaster:
    """`triangles` ``(T, 3)`` over `vertices` ``(V, 3)``, metres, to cast rays at, one at a time on one thread.

    Rays are float32 arrays ``(n, 3)``, world frame, metres; their directions need not have unit length. Without
    `watertight`, they are one seventh faster, but a rare ray slips through the edge between two triangles. Raises
    `MissingExtraError` without embreex, `WorldError` for triangles with indices outside the vertices.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, watertight: bool = True) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingExtraError(
                f"a rendered picture needs embreex: {how_to_install('sim')} (for Linux on ARM there is "
                "no wheel of it: use the rooms of eagor.lab.worlds.painted there, or photographs)"
            ) from error
        vertices = np.ascontiguousarray(vertices, dtype=np.float32)
        triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        if vertices.ndim != 2 or triangles.ndim != 2 or vertices.shape[1:] != (3,) or triangles.shape[1:] != (3,):
            raise WorldError(
                f"rays need vertices (V, 3) and triangles (T, 3) to hit; got {vertices.shape} and {triangles.shape}"
            )
        if len(triangles) == 0 or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise WorldError(
                f"{len(triangles)} triangles over {len(vertices)} vertices: wanted at least one, with corners in "
                f"0..{len(vertices) - 1}"
            )
        self._scene = EmbreeScene(robust=watertight)
        self._mesh = TriangleMesh(self._scene, vertices, triangles)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest triangle along each ray."""
        found = self._scene.run(*_checked(origins, directions), output=True)
        missed = found["primID"] < 0
        if missed.any():  # embreex leaves the values of the previous ray in u and v
            for name, value in (("tfar", np.inf), ("u", 0.0), ("v", 0.0)):
                np.copyto(found[name], value, where=missed)
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """Whether anything lies within `reach` (in lengths of the direction, a number or ``(n,)``), bool ``(n,)``."""
        origins, directions = _checked(origins, directions)
        # embreex writes into the array of limits and does not support infinity.
        limits = np.minimum(np.broadcast_to(np.asarray(reach, dtype=np.float32), len(origins)), _FAR)
        return self._scene.run(origins, directions, dists=limits, query="OCCLUDED") >= 0


def _checked(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as float32 ``(n, 3)``. Raises `WorldError` if their shapes differ."""
    origins, directions = np.asarray(origins, dtype=np.float32), np.asarray(directions, dtype=np.float32)
    if origins.shape != directions.shape or origins.ndim != 2 or origins.shape[1] != 3:
        raise WorldError(
            f"rays have origins {origins.shape} and directions {directions.shape}; wanted both (n, 3). One origin for "
            "all rays: np.broadcast_to(origin, directions.shape)"
        )
    return origins, directions
