"""Meshes: moving and joining them, covering them with a material; solids with flat faces, round and soft shapes.

Model frame: x forward, y left, z up, right-handed, metres. Triangles run counter-clockwise seen from outside. Corners
that share a vertex are shaded smoothly; hard edges have separate vertices. Texture coordinates are metres along the
surface until `part` divides them by the size of one repeat; textures with a direction (wood grain) run along u.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eagor.lab.worlds.scene import Material

Triple = Sequence[float] | np.ndarray

# Corners of a box: bit 0 of the number is x, bit 1 y, bit 2 z. Faces counter-clockwise from outside.
CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=np.float64)
_FACES = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])


@dataclass(frozen=True, eq=False)
class Mesh:
    """`vertices` ``(V, 3)`` float32 metres; `triangles` ``(T, 3)`` int32; `uv` ``(T, 3, 2)`` float32 metres."""

    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray

    @property
    def low(self) -> np.ndarray:
        """Lowest corner ``(3,)`` of the bounds."""
        return self.vertices.min(axis=0)

    @property
    def high(self) -> np.ndarray:
        """Highest corner ``(3,)`` of the bounds."""
        return self.vertices.max(axis=0)


@dataclass(frozen=True, eq=False)
class Part(Mesh):
    """A mesh with one material; `uv` ``(T, 3, 2)`` in repeats of the material's texture, u to the right, v up."""

    material: Material


def part(mesh: Mesh, material: Material, repeat: float | tuple[float, float] = 1.0) -> Part:
    """`mesh` covered with `material`; one repeat of its texture measures `repeat` metres (or (u, v) metres)."""
    uv = mesh.uv / np.broadcast_to(np.asarray(repeat, dtype=np.float32), (2,))
    return Part(mesh.vertices, mesh.triangles, uv.astype(np.float32), material)


def moved(mesh: Mesh, offset: Triple) -> Mesh:
    """`mesh` shifted by `offset` ``(3,)`` metres."""
    return Mesh(mesh.vertices + np.asarray(offset, dtype=np.float32), mesh.triangles, mesh.uv)


def turned(mesh: Mesh, rotation: np.ndarray, about: Triple = (0.0, 0.0, 0.0)) -> Mesh:
    """`mesh` turned by a rotation matrix ``(3, 3)`` about a point; see `eagor.sphere.rotation`."""
    centre = np.asarray(about, dtype=np.float64)
    vertices = (mesh.vertices - centre) @ np.asarray(rotation, dtype=np.float64).T + centre
    return Mesh(vertices.astype(np.float32), mesh.triangles, mesh.uv)


def mirrored(mesh: Mesh) -> Mesh:
    """`mesh` with left and right exchanged; its outside stays the outside."""
    return Mesh(
        mesh.vertices * np.array([1, -1, 1], dtype=np.float32), mesh.triangles[:, ::-1].copy(), mesh.uv[:, ::-1].copy()
    )


def merged(*meshes: Mesh) -> Mesh:
    """All meshes as one; no vertices are merged."""
    if len(meshes) == 1:
        return meshes[0]
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + np.int32(start) for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh.uv for mesh in meshes]),
    )


def turned_about_z(angle: float) -> np.ndarray:
    """The matrix ``(3, 3)`` of a turn by `angle` radians, counter-clockwise from above; quarters are exact."""
    cosine, sine = math.cos(angle), math.sin(angle)
    quarters = angle / (math.pi / 2)
    if abs(quarters - round(quarters)) < 1e-9:
        cosine, sine = float(round(cosine)), float(round(sine))
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def placed(parts: Sequence[Part], angle: float, position: Sequence[float] | np.ndarray) -> tuple[Part, ...]:
    """Parts of a model turned by `angle` radians about z, then shifted to `position` ``(3,)``."""
    rotation, offset = turned_about_z(angle), np.asarray(position, dtype=np.float64)
    return tuple(
        Part((part.vertices @ rotation.T + offset).astype(np.float32), part.triangles, part.uv, part.material)
        for part in parts
    )


def planar_uv(vertices: np.ndarray, triangles: np.ndarray, grain: int | None = None) -> np.ndarray:
    """Texture coordinates ``(T, 3, 2)`` by projection along the axis that each triangle faces most, metres.

    Without `grain`, u runs to the right and v up for someone who looks at the triangle (x and y on horizontal ones).
    With it, u runs along that axis wherever the triangle contains it.
    """
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    sign = np.sign(np.take_along_axis(normal, axis[:, None], axis=1)[:, 0])
    u_axis, v_axis = np.array([1, 0, 0])[axis], np.array([2, 2, 1])[axis]
    sign = sign * np.array([1, -1, 1])[axis]
    if grain is not None:
        along = axis != grain
        u_axis, v_axis = np.where(along, grain, u_axis), np.where(along, 3 - axis - grain, v_axis)
        sign = np.where(along, 1, sign)
    rows, points = np.arange(len(triangles))[:, None], np.arange(3)
    u = corners[rows, points, u_axis[:, None]] * sign[:, None]
    v = corners[rows, points, v_axis[:, None]]
    return np.stack([u, v], axis=-1).astype(np.float32)


def reshaped(mesh: Mesh, change: Callable[[np.ndarray], np.ndarray]) -> Mesh:
    """`mesh` with its vertices ``(V, 3)`` mapped by `change` (float64); each corner keeps its texture coordinates."""
    return Mesh(np.asarray(change(mesh.vertices.astype(np.float64)), dtype=np.float32), mesh.triangles, mesh.uv)


def quad_triangles(count: int) -> np.ndarray:
    """Two triangles for each of `count` faces with four corners of their own ``(2 count, 3)``."""
    return (np.arange(count)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.int32)


def projected(vertices: np.ndarray, triangles: np.ndarray, grain: int | None) -> Mesh:
    """The mesh of these vertices and triangles with a texture by `planar_uv`."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float32)
    return Mesh(vertices, triangles, planar_uv(vertices, triangles, grain))


def halves(grid: np.ndarray) -> np.ndarray:
    """The corners of two triangles for each cell of a grid ``(rows, columns, ...)``: ``(n, m, 2, 3, ...)``."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    return np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)


def whole(triangles: np.ndarray) -> np.ndarray:
    """Which triangles ``(..., 3)`` have three different corners."""
    p, q, r = np.moveaxis(triangles, -1, 0)
    return (p != q) & (q != r) & (r != p)


def grid_triangles(index: np.ndarray) -> np.ndarray:
    """Two triangles for each cell of a grid of vertex numbers (rows, columns), without those with a repeated corner."""
    triangles = halves(index).reshape(-1, 3)
    return triangles[whole(triangles)].astype(np.int32)


def hexahedron(corners: Triple | np.ndarray, grain: int | None = None) -> Mesh:
    """A box with its eight corners ``(8, 3)`` anywhere: corner i has high x, y, z where bits 0, 1, 2 of i are set."""
    return projected(np.asarray(corners, dtype=np.float64)[_FACES.ravel()], quad_triangles(6), grain)


def box(low: Triple, high: Triple, grain: int | None = None) -> Mesh:
    """A box between two corners ``(3,)``, 12 triangles; `grain` as in `planar_uv`."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return hexahedron(low + CORNERS * (high - low), grain)


def board(low: Triple, high: Triple) -> Mesh:
    """A box with the grain along its longest side."""
    return box(low, high, int(np.argmax(np.subtract(high, low))))


def post(foot: Triple, top: Triple, foot_size: Triple, top_size: Triple) -> Mesh:
    """A leg, perhaps leaning and tapered, from `foot` ``(3,)`` to `top`, with sizes (x, y) there; grain along z."""
    sides = (CORNERS - 0.5) * [1, 1, 0]
    down, up = np.append(np.asarray(foot_size, float), 0), np.append(np.asarray(top_size, float), 0)
    high = CORNERS[:, 2:]
    corners = (1 - high) * (np.asarray(foot) + sides * down) + high * (np.asarray(top) + sides * up)
    return hexahedron(corners, grain=2)


@lru_cache(maxsize=8)
def _rounded(segments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ball cut into eight octants: outward directions (K, 3), the octant's signs (K, 3), and triangles."""
    quarter = np.arange(segments + 1) * (math.pi / 2 / segments)
    polar = np.concatenate([math.pi - quarter, quarter[::-1]])  # from -z to +z, the equator twice
    azimuth = np.concatenate([quarter + k * math.pi / 2 for k in range(4)])
    sign_xy = np.repeat([[1, 1], [-1, 1], [-1, -1], [1, -1]], segments + 1, axis=0)
    rows, columns = len(polar), len(azimuth)
    t, a = np.meshgrid(polar, azimuth, indexing="ij")
    outward = np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)], axis=-1)
    signs = np.empty((rows, columns, 3))
    signs[..., :2] = sign_xy
    signs[..., 2] = np.where(np.arange(rows) > segments, 1, -1)[:, None]
    index = np.arange(rows * columns).reshape(rows, columns)
    for pole in (0, -1):  # one vertex per octant there
        index[pole] = index[pole].reshape(4, -1)[:, :1].repeat(segments + 1, axis=1).ravel()
    triangles = grid_triangles(np.concatenate([index, index[:, :1]], axis=1))
    caps = []
    for pole, order in ((0, (0, 3, 2, 1)), (-1, (0, 1, 2, 3))):
        a, b, c, d = index[pole].reshape(4, -1)[list(order), 0]
        caps += [[a, b, c], [a, c, d]]
    triangles = np.concatenate([triangles, caps])
    used, inverse = np.unique(triangles, return_inverse=True)
    triangles = inverse.reshape(-1, 3).astype(np.int32)
    return outward.reshape(-1, 3)[used], signs.reshape(-1, 3)[used], triangles


def bevelled(low: Triple, high: Triple, radius: float, segments: int = 1, grain: int | None = None) -> Mesh:
    """A box with edges rounded by `radius` (or half of the shortest side) in `segments` steps: 44 triangles for 1."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    half = (high - low) / 2
    radius = min(float(radius), 0.499 * 2 * float(half.min()))
    outward, signs, triangles = _rounded(segments)
    return projected((low + high) / 2 + signs * (half - radius) + outward * radius, triangles, grain)


def prism(outline: np.ndarray, low: float, high: float, grain: int | None = None) -> Mesh:
    """A convex outline ``(n, 2)`` of x and y, counter-clockwise, from z = `low` to `high`."""
    outline = np.asarray(outline, dtype=np.float64)
    n = len(outline)
    ends = np.stack([np.column_stack([outline, np.full(n, z)]) for z in (low, high)])
    fan = np.array([[0, k, k + 1] for k in range(1, n - 1)])
    step = (np.arange(n) + 1) % n
    walls = np.stack([ends[0], ends[0][step], ends[1][step], ends[1]], axis=1).reshape(-1, 3)
    triangles = np.concatenate([fan[:, ::-1], fan + n, quad_triangles(n) + 2 * n]).astype(np.int32)
    return projected(np.concatenate([ends[0], ends[1], walls]), triangles, grain)


def rounded_rectangle(width: float, depth: float, radius: float, segments: int = 4) -> np.ndarray:
    """A counter-clockwise outline ``(4 * (segments + 1), 2)`` about the origin, `width` along its first coordinate."""
    radius = min(radius, 0.499 * width, 0.499 * depth)
    angle = np.concatenate([np.linspace(k, k + 1, segments + 1) for k in range(4)]) * (math.pi / 2)
    sign = np.repeat([[1, 1], [-1, 1], [-1, -1], [1, -1]], segments + 1, axis=0)
    middle = sign * [width / 2 - radius, depth / 2 - radius]
    return middle + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def loft(rings: np.ndarray, smooth: bool = False) -> Mesh:
    """A bar through rings of corners ``(n, k, 3)``, counter-clockwise seen from its far end.

    Its ends are flat and must be visible as a whole from the mean of their corners. u runs along the bar. `smooth`
    shades the edges along it smoothly; otherwise only its bends are.
    """
    rings = np.asarray(rings, dtype=np.float64)
    n, k, _ = rings.shape
    around = np.concatenate([rings, rings[:, :1]], axis=1)
    u = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(rings.mean(axis=1), axis=0), axis=1))])
    v = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(around, axis=1), axis=2).mean(axis=0))])
    if smooth:
        index = np.concatenate([np.arange(n * k).reshape(n, k), np.arange(n)[:, None] * k], axis=1)
        vertices, sides = rings.reshape(-1, 3), grid_triangles(index)
    else:
        strips = np.stack([around[:, :-1], around[:, 1:]], axis=2)  # (n, k, 2, 3)
        index = np.arange(n * k * 2).reshape(n, k, 2)
        vertices = strips.reshape(-1, 3)
        sides = np.concatenate([grid_triangles(index[:, j]) for j in range(k)])
    a, b = np.meshgrid(np.arange(n - 1), np.arange(k), indexing="ij")
    if not smooth:
        a, b = a.T, b.T
    corners = np.stack([[a, b], [a, b + 1], [a + 1, b + 1], [a + 1, b]]).transpose(2, 3, 0, 1).reshape(-1, 4, 2)
    corners = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)
    uv = np.stack([u[corners[..., 0]], v[corners[..., 1]]], axis=-1)
    start = len(vertices)
    hub = np.arange(k)
    fan = np.stack([np.full(k, k), hub, (hub + 1) % k], axis=1)  # about the middle of each end
    caps = np.concatenate([fan[:, ::-1], fan + k + 1]) + start
    ends = np.concatenate([rings[[0, -1]], rings[[0, -1]].mean(axis=1, keepdims=True)], axis=1)
    vertices = np.concatenate([vertices, ends.reshape(-1, 3)]).astype(np.float32)
    uv = np.concatenate([uv, planar_uv(vertices, caps)]).astype(np.float32)
    return Mesh(vertices, np.concatenate([sides, caps]).astype(np.int32), uv)


# --- round and soft shapes --------------------------------------------------------------------------------------------


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
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
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


def cylinder(centre: Triple, radius: float, height: float, sides: int) -> Mesh:
    """An upright cylinder with sharp rims on `centre` ``(3,)``, the middle of its base."""
    profile = [(0, 0), (radius, 0), (radius, 0), (radius, height), (radius, height), (0, height)]
    return moved(lathe(profile, sides), centre)


def tube(path: Sequence[Triple] | np.ndarray, radius: float | Sequence[float] | np.ndarray, sides: int = 8) -> Mesh:
    """A round bar along `path` ``(n, 3)`` with flat ends and mitred bends; u along it, v round it.

    `radius`, one or one per point. The path may not stand still or double back on itself.
    """
    path = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), (len(path),))
    legs = np.diff(path, axis=0)
    legs = legs / np.linalg.norm(legs, axis=1, keepdims=True)
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
