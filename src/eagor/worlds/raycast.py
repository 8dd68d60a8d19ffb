"""Ray casting: two engines with the same results.

`make_raycaster` makes a `Raycaster` from triangles. The "embree" engine is Intel's Embree through the embreex wheel;
the "numpy" engine needs only NumPy and is slower by one to two orders of magnitude. "auto" takes the first that is
installed. Both see triangles from either side.

The "numpy" engine is a tree of boxes. A batch of rays goes down it together, as far as its boxes are hit, and the box
that most of them enter first comes first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor._extras import how_to_install
from eagor.errors import WorldError

ENGINES = ("auto", "embree", "numpy")
_FAR = np.float32(1e37)  # distance that embreex reports for a miss
_LEAF = 8  # triangles per leaf, at most
_BATCH = 1 << 16  # rays that walk together
_MARGIN = 1e-7  # barycentric tolerance, so that no ray slips through the edge between two triangles


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
        origins, directions = _checked(origins, directions)
        found = self._scene.run(origins, directions, output=True)
        missed = found["primID"] < 0
        if missed.any():  # embreex leaves the values of the previous ray in u and v
            for name, value in (("tfar", np.inf), ("u", 0.0), ("v", 0.0)):
                np.copyto(found[name], value, where=missed)
        return Hits(found["tfar"], found["primID"], found["u"], found["v"])

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        origins, directions = _checked(origins, directions)
        # embreex writes into the array of limits and does not support infinity.
        limits = np.minimum(np.broadcast_to(np.asarray(reach, dtype=np.float32), len(origins)), _FAR)
        return self._scene.run(origins, directions, dists=limits, query="OCCLUDED") >= 0


@dataclass(frozen=True, eq=False, slots=True)
class _Node:
    """A box ``low``, ``high`` ``(3,)``, and the triangles in it, or two boxes in it."""

    low: np.ndarray
    high: np.ndarray
    triangles: np.ndarray
    inner: tuple[_Node, ...] = ()

    def entry(self, origin: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """The distance at which each ray ``(3, m)`` enters the box, inf for none (slab test)."""
        ends = (self.low[:, None] - origin) * inverse, (self.high[:, None] - origin) * inverse
        near = np.maximum(np.minimum(*ends).max(axis=0), 0)
        return np.where(near <= np.maximum(*ends).min(axis=0), near, np.inf)


class NumpyRaycaster:
    """The same results from a tree of boxes, except for rounding and the choice at a shared edge."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        corners = vertices[triangles].astype(np.float64)
        self._origin = corners.reshape(-1, 3).mean(axis=0)  # near the middle, to balance rounding
        corners -= self._origin
        # (T, 3, 3): corner 0 and the two edges from it.
        self._sides = np.concatenate([corners[:, :1], corners[:, 1:] - corners[:, :1]], axis=1)
        pad = 1e-9 * max(1.0, float(np.abs(corners).max()))
        self._tree = _tree(corners.min(axis=1) - pad, corners.max(axis=1) + pad, np.arange(len(corners)))

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        return self._within(np.inf, origins, directions)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        return self._within(reach, origins, directions).triangle >= 0

    def _within(self, reach: float | np.ndarray, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest hit on each ray that is not farther than `reach`, in lengths of its direction."""
        origins, directions = _checked(origins, directions)
        origin, way = (origins - self._origin).T, directions.T.astype(np.float64)
        inverse = 1 / np.where(np.abs(way) < 1e-20, 1e-20, way)
        best = np.array(np.broadcast_to(np.asarray(reach, dtype=np.float64), len(origins)))
        triangle, u, v = np.full(len(best), -1, dtype=np.int32), np.zeros(len(best)), np.zeros(len(best))
        everyone = np.arange(len(best))
        for first in range(0, len(best), _BATCH):
            rays = everyone[first : first + _BATCH]
            stack = [(self._tree, rays, np.zeros(len(rays)))]
            while stack:
                node, rays, near = stack.pop()
                rays = rays[near < best[rays]]
                if len(rays) and node.inner:
                    start, slope = origin[:, rays], inverse[:, rays]
                    one, two = ((inner, rays, inner.entry(start, slope)) for inner in node.inner)
                    ahead = np.count_nonzero(one[2] < two[2]) > np.count_nonzero(two[2] < one[2])
                    stack += (two, one) if ahead else (one, two)  # the box that most rays enter first, first
                elif len(rays):
                    self._meet(rays, node.triangles, origin[:, rays], way[:, rays], best, triangle, u, v)
        best[triangle < 0] = np.inf
        u, v = (np.clip(weight, 0.0, 1.0).astype(np.float32) for weight in (u, v))
        return Hits(best.astype(np.float32), triangle, u, v)

    def _meet(self, rays, candidates, origin, way, best, triangle, u, v) -> None:
        """Test each ray on all `candidates`, and keep nearer hits (Moeller and Trumbore 1997); the first, if equal."""
        (x0, y0, z0), (ax, ay, az), (bx, by, bz) = self._sides[candidates].transpose(1, 2, 0)[..., None]
        (ox, oy, oz), (dx, dy, dz) = origin, way
        px, py, pz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
        determinant = ax * px + ay * py + az * pz
        flat = determinant == 0
        scale = 1 / np.where(flat, 1.0, determinant)
        tx, ty, tz = ox - x0, oy - y0, oz - z0
        first = (tx * px + ty * py + tz * pz) * scale
        qx, qy, qz = ty * az - tz * ay, tz * ax - tx * az, tx * ay - ty * ax
        second = (dx * qx + dy * qy + dz * qz) * scale
        distance = (bx * qx + by * qy + bz * qz) * scale
        inside = (first >= -_MARGIN) & (second >= -_MARGIN) & (first + second <= 1 + _MARGIN) & ~flat & (distance >= 0)
        distance = np.where(inside, distance, np.inf)
        nearest = distance.argmin(axis=0)
        length = distance.min(axis=0)
        closer = (length < best[rays]) | (length == best[rays]) & (candidates[nearest] < triangle[rays])
        who, at = rays[closer], (nearest[closer], np.flatnonzero(closer))
        best[who], triangle[who], u[who], v[who] = distance[at], candidates[at[0]], first[at], second[at]


def _tree(low: np.ndarray, high: np.ndarray, triangles: np.ndarray) -> _Node:
    """The tree of `triangles`, whose bounds are `low` and `high` ``(T, 3)``: halved by the median, longest side."""
    mine, inner = (low[triangles], high[triangles]), ()
    if len(triangles) > _LEAF:
        middle = mine[0] + mine[1]
        order = triangles[np.argsort(middle[:, np.ptp(middle, axis=0).argmax()], kind="stable")]
        half = len(order) // 2
        inner = _tree(low, high, order[:half]), _tree(low, high, order[half:])
    return _Node(mine[0].min(axis=0), mine[1].max(axis=0), np.sort(triangles), inner)
