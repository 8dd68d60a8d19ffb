"""Round and soft shapes: cushions, pillows, turned shapes, tubes, sheets and slabs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.apartment.mesh import (
    Mesh,
    Triple,
    checked_bounds,
    grid_triangles,
    halves,
    loft,
    merged,
    moved,
    planar_uv,
    projected,
    quad_triangles,
    whole,
)


@lru_cache(maxsize=8)
def _soft(thin: int) -> tuple[np.ndarray, np.ndarray]:
    """A cube's surface as welded grids of 4 cells (2 along `thin`): grid steps (K, 3) in -2..2, and triangles."""
    cells = [4, 4, 4]
    cells[thin] = 2
    faces, count, points = [], 0, []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            grid = np.empty((cells[v] + 1, cells[u] + 1, 3), dtype=np.int64)
            grid[..., axis] = side * cells[axis]
            grid[..., u], grid[..., v] = np.arange(cells[u] + 1)[None, :], np.arange(cells[v] + 1)[:, None]
            grid = grid if side else grid[:, ::-1]
            faces.append(grid_triangles(count + np.arange(grid[..., 0].size).reshape(grid.shape[:2])))
            count += grid[..., 0].size
            points.append(grid.reshape(-1, 3))
    unique, inverse = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    steps = unique * (4 // np.array(cells)) - 2
    return steps, inverse.reshape(-1)[np.concatenate(faces)].astype(np.int32)


def cushion(low: Triple, high: Triple, puff: float = 0.03, radius: float = 0.05) -> Mesh:
    """A soft box within `low` and `high` ``(3,)``: rounded edges, faces that swell by `puff` metres; 128 triangles."""
    low, high = checked_bounds(low, high, "a cushion")
    middle, half = (low + high) / 2, (high - low) / 2
    steps, triangles = _soft(int(half.argmin()))
    puff = min(float(puff), 0.4 * float(half.min()))
    core = half - puff
    first, second, _ = np.sort(core).tolist()
    radius = min(float(radius), first, 0.7 * second)  # the longer sides keep something flat
    # Grid lines at the edges, where the rounding begins, and in the middle; the shortest side has no flat part.
    inner = np.where(np.arange(3) == half.argmin(), core, core - radius)
    lines = np.stack([-core, -inner, 0 * core, inner, core])
    place = np.take_along_axis(lines, steps + 2, axis=0)
    anchor = np.clip(place, radius - core, core - radius)
    away = place - anchor
    length = np.linalg.norm(away, axis=1, keepdims=True)
    round_place = anchor + away * (radius / np.maximum(length, 1e-12)) * (length > 0)
    # A face swells like the product of two parabolas, so its edges stay in place.
    bump = 1 - (round_place / core) ** 2
    swell = np.stack([bump[:, 1] * bump[:, 2], bump[:, 2] * bump[:, 0], bump[:, 0] * bump[:, 1]], axis=1)
    swelled = round_place + puff * np.clip(swell, 0, 1) * round_place / core
    return projected(middle + swelled, triangles, None)


def pillow(width: float, height: float, thickness: float, cells: int = 5) -> Mesh:
    """A sewn pillow standing in the plane x = 0 about the origin: width along y, height along z, thin at its seams."""
    line = np.sin(np.linspace(-0.5, 0.5, cells + 1) * math.pi)
    b, a = np.meshgrid(line, line, indexing="ij")
    y, z = a * width / 2 * (1 - 0.09 * (1 - b**2)), b * height / 2 * (1 - 0.09 * (1 - a**2))
    x = thickness / 2 * np.sqrt(np.clip((1 - a**2) * (1 - b**2), 0, None))
    front, back = np.stack([x, y, z], axis=-1), np.stack([-x, y, z], axis=-1)
    index = np.arange(a.size).reshape(a.shape)
    triangles = np.concatenate([grid_triangles(index), grid_triangles(index[:, ::-1] + a.size)])
    return projected(np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3)]), triangles, None)


def lathe(profile: Sequence[Triple] | np.ndarray, sides: int = 20) -> Mesh:
    """A shape turned about the z axis from `profile` ``(n, 2)`` of (r, z), drawn from its bottom upwards.

    A point given twice makes a sharp edge. The shape is closed where the profile starts and ends at r = 0, else open.
    u runs round and v along the profile; flat discs take x and y.
    """
    profile = np.asarray(profile, dtype=np.float64)
    if profile.ndim != 2 or profile.shape[1] != 2 or len(profile) < 2 or not (profile[:, 0] >= 0).all():
        raise WorldError(f"a profile of shape {profile.shape}; wanted (n, 2) of (r >= 0, z) with n >= 2")
    r, z = profile.T
    angle = np.arange(sides + 1) * (2 * math.pi / sides)
    counts = np.where(r > 0, sides, 1)
    start = np.cumsum(counts) - counts
    around = np.arange(sides + 1) % sides
    index = start[:, None] + np.where((r > 0)[:, None], around, 0)
    vertices = np.zeros((int(counts.sum()), 3))
    place = np.stack([r[:, None] * np.cos(angle), r[:, None] * np.sin(angle), z[:, None] + 0 * angle], axis=-1)
    vertices[index] = place
    step = np.hypot(np.diff(r), np.diff(z))
    along = np.concatenate([[0], np.cumsum(step)])
    surface = np.stack(np.broadcast_arrays(angle * r.max(), along[:, None]), axis=-1)
    triangles, uv = halves(index), halves(surface)
    flat = np.broadcast_to((np.abs(np.diff(z)) < 0.3 * np.abs(np.diff(r)))[:, None, None], triangles.shape[:3])
    keep = (step > 0)[:, None, None] & whole(triangles)
    vertices, triangles = vertices.astype(np.float32), triangles[keep].astype(np.int32)
    uv = np.where(flat[keep][:, None, None], planar_uv(vertices, triangles), uv[keep]).astype(np.float32)
    return Mesh(vertices, triangles, uv)


def cylinder(centre: Triple, radius: float, height: float, sides: int = 16, top_radius: float | None = None) -> Mesh:
    """An upright cylinder or cone frustum with sharp rims on `centre` ``(3,)``, the middle of its base."""
    top = radius if top_radius is None else top_radius
    profile = [(0, 0), (radius, 0), (radius, 0), (top, height), (top, height), (0, height)]
    return moved(lathe(profile, sides), centre)


def tube(path: Sequence[Triple] | np.ndarray, radius: float | Sequence[float] | np.ndarray, sides: int = 8) -> Mesh:
    """A round bar along `path` ``(n, 3)`` with flat ends and mitred bends; u along it, v round it.

    `radius`, one or one per point. Raises `WorldError` where the path stands still or doubles back on itself.
    """
    path = np.asarray(path, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 2:
        raise WorldError(f"a path of shape {path.shape}; wanted (n, 3) with n >= 2")
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), (len(path),))
    legs = np.diff(path, axis=0)
    length = np.linalg.norm(legs, axis=1, keepdims=True)
    if not (length > 0).all():
        raise WorldError("a path with a point given twice in a row; drop one of them")
    legs = legs / length
    if (np.einsum("ij,ij->i", legs[:-1], legs[1:]) < -0.9).any():
        raise WorldError("a path that doubles back on itself; give its turn one more point")
    angle = (np.arange(sides) + 0.5) * (2 * math.pi / sides)
    side = np.cross(legs[0], np.eye(3)[np.abs(legs[0]).argmin()])
    rings = np.empty((len(path), sides, 3))
    for i, leg in enumerate(legs):
        if i > 0:  # the smallest rotation from leg to leg, as otherwise the bar would twist
            both = legs[i - 1] + leg
            side = side - both * (2 * (side @ both) / (both @ both))  # applied to a direction normal to the legs
            side = side - leg * (side @ leg)
        side = side / np.linalg.norm(side)
        around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(leg, side)
        if i == 0:
            rings[0] = path[0] + radii[0] * around
        # At a bend the ring lies in the plane that halves it: its corners slide along the leg until they meet that.
        mitre = leg if i == len(legs) - 1 else leg + legs[i + 1]
        slide = -(around @ mitre) / (leg @ mitre)
        rings[i + 1] = path[i + 1] + radii[i + 1] * (around + slide[:, None] * leg)
    return loft(rings, smooth=True)


def quad(corners: Sequence[Triple] | np.ndarray) -> Mesh:
    """A flat four-sided face ``(4, 3)``, counter-clockwise; uv is (0, 0) at corner 0, u towards 1, v towards 3."""
    corners = np.asarray(corners, dtype=np.float64)
    u, v = np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[3] - corners[0])
    triangles, uv = quad_triangles(1), np.array([[0, 0], [u, 0], [u, v], [0, v]], dtype=np.float32)
    return Mesh(corners.astype(np.float32), triangles, uv[triangles])


def sheet(points: np.ndarray) -> Mesh:
    """A smooth open surface through points ``(rows, columns, 3)``; its outside is where columns x rows points."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2:
        raise WorldError(f"a sheet of points of shape {points.shape}; wanted (rows, columns, 3), two of each at least")
    u = np.zeros(points.shape[:2])
    v = np.zeros(points.shape[:2])
    u[:, 1:] = np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=-1), axis=1)
    v[1:] = np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1), axis=0)
    triangles = grid_triangles(np.arange(u.size).reshape(u.shape))
    uv = np.stack([u.ravel(), v.ravel()], axis=-1)[triangles]
    return Mesh(points.reshape(-1, 3).astype(np.float32), triangles, uv.astype(np.float32))


def slab(points: np.ndarray, thickness: float) -> Mesh:
    """A bent plate of even thickness under the sheet through `points` ``(rows, columns, 3)``, with sharp rims."""
    front = sheet(points)
    points = np.asarray(points, dtype=np.float64)
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    behind = points - thickness * normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    # The same cells and diagonals as in front, seen from the other side; otherwise uneven faces would cross.
    back = Mesh(behind.reshape(-1, 3).astype(np.float32), front.triangles[:, ::-1].copy(), front.uv[:, ::-1].copy())

    def rim(grid: np.ndarray) -> np.ndarray:
        return np.concatenate([grid[0], grid[1:, -1], grid[-1, -2::-1], grid[-2::-1, 0]])

    return merged(front, back, sheet(np.stack([rim(behind), rim(points)])))
