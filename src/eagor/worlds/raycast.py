"""Ray casting: two engines with the same results.

`make_raycaster` makes a `Raycaster` from triangles. The "embree" engine is Intel's Embree through the embreex wheel;
the "numpy" engine needs only NumPy and is slower by one to two orders of magnitude. "auto" takes the first that is
installed. Both see triangles from either side.

The "numpy" engine is a flat tree of boxes, for batches of rays at once. Each inner node has four children, so the tree
needs no pointers: node k of level l has the children 4k .. 4k + 3 of level l + 1. All rays of a batch walk it in
lockstep, each with its own stack, near children first; a ray is done when its stack is empty. The last axis of arrays
is the ray, which keeps inner loops long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor._extras import how_to_install
from eagor.errors import WorldError

ENGINES = ("auto", "embree", "numpy")
_FAR = np.float32(1e37)  # distance that embreex reports for a miss
_LEAF = 4  # triangles per leaf, at most
_BATCH = 1 << 13  # rays that walk together, so that their data fits in the cache
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


class NumpyRaycaster:
    """The same results from a tree of boxes, except for rounding and the choice at a shared edge."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        corners = vertices[triangles].astype(np.float64)
        self._origin = corners.reshape(-1, 3).mean(axis=0)  # near the middle, to balance rounding
        corners -= self._origin
        # (9, T): corner 0 and the two edges from it; one more column, which no ray can hit, fills up the leaves.
        sides = np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
        self._sides = np.ascontiguousarray(np.concatenate([sides, np.zeros((1, 9))]).T)
        pieces, source = _split_large(corners)
        order, self._levels = _ordered(pieces.mean(axis=1))
        starts = (np.arange(4**self._levels + 1) * len(order)) // 4**self._levels
        slots = starts[:-1, None] + np.arange(_LEAF)
        full = slots < starts[1:, None]
        owner = np.append(source[order], len(triangles))
        self._leaves = np.ascontiguousarray(owner[np.where(full, slots, len(order))].T)  # (_LEAF, leaves)
        self._boxes = _boxes(pieces[order], starts, self._levels)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        return self._within(np.inf, origins, directions)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        return self._within(reach, origins, directions).triangle >= 0

    def _within(self, reach: float | np.ndarray, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The nearest hit on each ray that is not farther than `reach`, in lengths of its direction."""
        origins, directions = _checked(origins, directions)
        limits = np.broadcast_to(np.asarray(reach, dtype=np.float64), len(origins))
        starts = range(0, max(len(origins), 1), _BATCH)
        found = [self._walk(*(a[k : k + _BATCH] for a in (origins, directions, limits))) for k in starts]
        distance, triangle, u, v = (np.concatenate(parts) for parts in zip(*found, strict=True))
        distance = np.where(triangle >= 0, distance, np.inf)
        u, v = (np.clip(weight, 0.0, 1.0).astype(np.float32) for weight in (u, v))
        return Hits(distance.astype(np.float32), triangle.astype(np.int32), u, v)

    def _walk(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, ...]:
        """Distance, triangle (-1: none), u and v of one batch."""
        count = len(origins)
        origin = np.ascontiguousarray((origins - self._origin).T)
        way = np.ascontiguousarray(directions.T, dtype=np.float64)
        inverse = (1 / np.where(np.abs(way) < 1e-20, 1e-20, way)).astype(np.float32)
        start = origin.astype(np.float32)  # boxes are tested in single precision, with padding for it
        best, u, v = np.array(limits, dtype=np.float64), np.zeros(count), np.zeros(count)
        triangle = np.full(count, -1)
        # Node numbers run through the levels: level l begins at (4^l - 1) / 3.
        first_leaf = (4**self._levels - 1) // 3
        stack = np.zeros((3 * self._levels + 2, count), dtype=np.int64)
        entry = np.zeros(stack.shape, dtype=np.float32)
        height = np.ones(count, dtype=np.int64)  # of each ray's stack, which starts with the root
        rays = np.arange(count)
        while len(rays):
            height[rays] -= 1
            node, near = stack[height[rays], rays], entry[height[rays], rays]
            open_ = near < best[rays]
            leaf = node >= first_leaf
            at = np.flatnonzero(open_ & leaf)
            if len(at):
                self._meet(rays[at], node[at] - first_leaf, origin, way, best, triangle, u, v)
            at = np.flatnonzero(open_ & ~leaf)
            if len(at):
                here = rays[at]
                reach = self._enter(node[at], start[:, here], inverse[:, here], best[here].astype(np.float32))
                nearest_last = np.argsort(-reach, axis=0)
                for place in nearest_last:
                    distance = np.take_along_axis(reach, place[None], axis=0)[0]
                    hit = np.isfinite(distance)
                    who = here[hit]
                    stack[height[who], who] = 4 * node[at][hit] + 1 + place[hit]
                    entry[height[who], who] = distance[hit]
                    height[who] += 1
            rays = rays[height[rays] > 0]
        return best, triangle, u, v

    def _enter(self, node: np.ndarray, origin: np.ndarray, inverse: np.ndarray, best: np.ndarray) -> np.ndarray:
        """The distance at which each ray enters the four children of its node ``(4, m)``, inf for none (slab test)."""
        boxes = self._boxes.take(node, axis=-1)  # (2, 3, 4, m)
        boxes -= origin[:, None]
        boxes *= inverse[:, None]
        low, high = np.minimum(boxes[0], boxes[1]), np.maximum(boxes[0], boxes[1])
        near = np.maximum(np.maximum(low[0], low[1]), np.maximum(low[2], np.float32(0)))
        far = np.minimum(np.minimum(high[0], high[1]), np.minimum(high[2], best))
        near[near > far] = np.inf
        return near

    def _meet(self, rays, leaf, origin, way, best, triangle, u, v) -> None:
        """Test the triangles of each ray's leaf, and keep nearer hits (Moeller and Trumbore 1997)."""
        candidates = self._leaves[:, leaf]  # (_LEAF, m)
        x0, y0, z0, ax, ay, az, bx, by, bz = self._sides[:, candidates]
        ox, oy, oz = origin[:, rays]
        dx, dy, dz = way[:, rays]
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
        nearest = distance.argmin(axis=0)[None]
        length = np.take_along_axis(distance, nearest, axis=0)[0]
        closer = length < best[rays]
        who = rays[closer]
        best[who] = length[closer]
        for target, values in ((triangle, candidates), (u, first), (v, second)):
            target[who] = np.take_along_axis(values, nearest, axis=0)[0][closer]


def _split_large(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles ``(T, 3, 3)`` halved until none spans a sixteenth of the scene, and the triangle of each piece."""
    source = np.arange(len(corners))
    limit = np.ptp(corners.reshape(-1, 3), axis=0).max() / 16
    done: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(16):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = edges.max(axis=1) > limit
        done.append((corners[~large], source[~large]))
        corners, source, longest = corners[large], source[large], edges[large].argmax(axis=1)
        if len(corners) == 0:
            break
        turned = np.take_along_axis(corners, ((longest[:, None] + np.arange(3)) % 3)[..., None], axis=1)
        middle = (turned[:, 0] + turned[:, 1]) / 2
        halves = (turned[:, 0], middle, turned[:, 2]), (middle, turned[:, 1], turned[:, 2])
        corners = np.concatenate([np.stack(half, axis=1) for half in halves])
        source = np.concatenate([source, source])
    done.append((corners, source))
    return np.concatenate([c for c, _ in done]), np.concatenate([s for _, s in done])


def _ordered(centres: np.ndarray) -> tuple[np.ndarray, int]:
    """The order of the triangles in the leaves (halved by medians along the longest side), and the number of levels."""
    count, levels = len(centres), 0
    while -(-count // 4**levels) > _LEAF:
        levels += 1
    order = np.arange(count)
    for level in range(2 * levels):
        starts = (np.arange(2**level + 1) * count) // 2**level
        filled = np.flatnonzero(np.diff(starts))
        part = np.repeat(np.arange(2**level), np.diff(starts))
        here = centres[order]
        low, high = (f.reduceat(here, starts[filled], axis=0) for f in (np.minimum, np.maximum))
        axis = np.zeros(2**level, dtype=int)
        axis[filled] = (high - low).argmax(axis=1)
        key = np.take_along_axis(here, axis[part][:, None], axis=1)[:, 0]
        order = order[np.lexsort((key, part))]
    return order, levels


def _boxes(pieces: np.ndarray, starts: np.ndarray, levels: int) -> np.ndarray:
    """Bounds of the children of all inner nodes, ``(2, 3, 4, nodes)``, slightly padded; low > high for empty leaves."""
    sizes = np.diff(starts)
    filled = np.flatnonzero(sizes)
    low, high = np.full((len(sizes), 3), np.inf), np.full((len(sizes), 3), -np.inf)
    low[filled] = np.minimum.reduceat(pieces.min(axis=1), starts[filled], axis=0)
    high[filled] = np.maximum.reduceat(pieces.max(axis=1), starts[filled], axis=0)
    pad = 1e-5 * max(1.0, float(np.abs(pieces).max()))
    low, high = (low - pad).astype(np.float32), (high + pad).astype(np.float32)
    found = []
    for _ in range(levels):
        low, high = low.reshape(-1, 4, 3), high.reshape(-1, 4, 3)
        found.append(np.stack([low, high]).transpose(0, 3, 2, 1))
        low, high = low.min(axis=1), high.max(axis=1)
    found.append(np.zeros((2, 3, 4, 0), dtype=np.float32))  # for a tree of one leaf
    return np.ascontiguousarray(np.concatenate(found[::-1], axis=-1))
