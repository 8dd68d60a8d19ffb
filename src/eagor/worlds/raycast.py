"""Ray casting: two engines with the same results.

`make_raycaster` makes a `Raycaster` from triangles. The "embree" engine is Intel's Embree through the embreex wheel;
the "numpy" engine (`eagor.worlds.bvh`) needs only NumPy and is slower by one to two orders of magnitude. "auto" takes
the first that is installed. Both see triangles from either side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor._extras import how_to_install
from eagor.errors import WorldError
from eagor.worlds.bvh import Tree

ENGINES = ("auto", "embree", "numpy")
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


class Raycaster(Protocol):
    """Triangles to cast rays at. Rays are float32 arrays ``(n, 3)``, world frame, metres."""

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest triangle along each ray. Directions need not have unit length."""
        ...

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """Whether anything lies within `reach` (in lengths of the direction, a number or ``(n,)``), bool ``(n,)``."""
        ...


def make_raycaster(
    vertices: np.ndarray, triangles: np.ndarray, engine: str = "auto", watertight: bool = True
) -> Raycaster:
    """A raycaster for `triangles` ``(T, 3)`` over `vertices` ``(V, 3)``, metres.

    `engine` is "embree", "numpy" or "auto" (embree if its wheel is installed). Without `watertight`, embree is one
    seventh faster, but a rare ray slips through the edge between two triangles. Raises `WorldError` for another name, a
    missing wheel, or triangles with indices outside the vertices.
    """
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
    if engine not in ENGINES:
        raise WorldError(f"no ray engine {engine!r}; choose one of {', '.join(ENGINES)}")
    if engine == "numpy" or (engine == "auto" and not has_embree()):
        return NumpyRaycaster(vertices, triangles)
    if not has_embree():
        raise WorldError(
            "the ray engine 'embree' needs the package embreex, which is not installed here (there is no wheel for "
            f"Linux on ARM). Ask for engine='numpy', which is slower, or: {how_to_install('sim')}"
        )
    return EmbreeRaycaster(vertices, triangles, watertight)


def has_embree() -> bool:
    """Whether the embreex wheel can be imported."""
    try:
        from embreex import mesh_construction, rtcore_scene  # noqa: F401
    except ImportError:
        return False
    return True


def _checked(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as float32 ``(n, 3)``. Raises `WorldError` if their shapes differ."""
    origins, directions = np.asarray(origins, dtype=np.float32), np.asarray(directions, dtype=np.float32)
    if origins.shape != directions.shape or origins.ndim != 2 or origins.shape[1] != 3:
        raise WorldError(
            f"rays have origins {origins.shape} and directions {directions.shape}; wanted both (n, 3). One origin for "
            "all rays: np.broadcast_to(origin, directions.shape)"
        )
    return origins, directions


class EmbreeRaycaster:
    """Embree 4, one ray at a time on one thread; `watertight` is its robust intersection."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, watertight: bool = True) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=watertight)
        self._mesh = TriangleMesh(self._scene, vertices, triangles)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """See `Raycaster.cast`."""
        origins, directions = _checked(origins, directions)
        found = self._scene.run(origins, directions, output=True)
        missed = found["primID"] < 0
        if missed.any():  # embreex leaves the values of the previous ray in u and v
            for name, value in (("tfar", np.inf), ("u", 0.0), ("v", 0.0)):
                np.copyto(found[name], value, where=missed)
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """See `Raycaster.occluded`."""
        origins, directions = _checked(origins, directions)
        # embreex writes into the array of limits and does not support infinity.
        limits = np.minimum(np.broadcast_to(np.asarray(reach, dtype=np.float32), len(origins)), _FAR)
        return self._scene.run(origins, directions, dists=limits, query="OCCLUDED") >= 0


class NumpyRaycaster:
    """The same results from `eagor.worlds.bvh`, except for rounding and the choice at a shared edge."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._tree = Tree(vertices, triangles)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """See `Raycaster.cast`."""
        origins, directions = _checked(origins, directions)
        return Hits(*self._tree.trace(origins, directions, np.full(len(origins), np.inf)))

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """See `Raycaster.occluded`."""
        origins, directions = _checked(origins, directions)
        limits = np.broadcast_to(np.asarray(reach, dtype=np.float64), len(origins))
        return self._tree.trace(origins, directions, limits)[1] >= 0
