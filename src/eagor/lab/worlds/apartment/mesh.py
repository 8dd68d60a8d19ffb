"""Meshes: moving and joining them, covering them with a material; solids, most of them by `trimesh.creation`.

Model frame: x forward, y left, z up, right-handed, metres. Triangles run counter-clockwise seen from outside, and
wood grain along u.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from eagor._extras import need
from eagor.lab.worlds.apartment.textures import KINDS, material
from eagor.lab.worlds.scene import Material
from eagor.sphere import rotation

need("an apartment", "sim", "trimesh")
import trimesh  # noqa: E402

Numbers = Sequence[float] | np.ndarray

_BARE = Material("bare")
_BOX = trimesh.creation.box()
_CORNERS = np.asarray(_BOX.vertices) + 0.5  # x slowest
_FINE = _BOX.subdivide().subdivide()  # what cushions are blown up from
# Of a cube with its edges cut off: three points at each corner, their signs, and how far they stand out of its faces.
_SIGNS = np.repeat(2 * _CORNERS - 1, 3, axis=0)
_OUTWARD = _SIGNS * np.tile(np.eye(3), (8, 1))
_HULL = trimesh.convex.convex_hull(2 * _SIGNS + _OUTWARD)  # its vertices are in another order
_CUT = np.linalg.norm(_HULL.vertices[:, None] - (2 * _SIGNS + _OUTWARD), axis=2).argmin(axis=1)[_HULL.faces]
QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)  # the triangles of a face with four corners


@dataclass(frozen=True, eq=False)
class Mesh:
    """`vertices` ``(V, 3)`` float32 metres; `triangles` ``(T, 3)`` int32; `uv` ``(T, 3, 2)`` float32.

    `uv` is in metres until a `Cover` gives the mesh its material; then in repeats of the texture, u to the right, v up.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    material: Material = _BARE


def bounds(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner ``(3,)``, float64, of several together."""
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float64)
    return vertices.min(axis=0), vertices.max(axis=0)


@dataclass(frozen=True, eq=False)
class Cover:
    """A material and the metres, or (u, v) metres, of one repeat of its texture; it covers meshes, as one."""

    material: Material
    repeat: float | tuple[float, float]

    def __call__(self, *meshes: Mesh) -> Mesh:
        mesh = merged(*meshes)
        return replace(mesh, uv=mesh.uv / np.asarray(self.repeat, np.float32), material=self.material)


def finish(kind: str, colour: str | None, rng: np.random.Generator) -> Cover:
    """What covers meshes with a material of a kind of `KINDS`, in a tone of a named colour; None for its default."""
    return Cover(material(kind, colour, rng), KINDS[kind].repeat)


def moved(mesh: Mesh, offset: Numbers) -> Mesh:
    """`mesh` shifted by `offset` ``(3,)`` metres."""
    return replace(mesh, vertices=mesh.vertices + np.asarray(offset, dtype=np.float32))


def leaning(mesh: Mesh, angle: float, about: Numbers = (0.0, 0.0, 0.0)) -> Mesh:
    """`mesh` turned by `angle` radians about an axis along y through a point; its top goes towards -x."""
    centre = np.asarray(about, dtype=np.float64)
    vertices = (mesh.vertices - centre) @ rotation((0.0, 1.0, 0.0), -angle).T + centre
    return replace(mesh, vertices=vertices.astype(np.float32))


def merged(*meshes: Mesh) -> Mesh:
    """All meshes as one; no vertices are merged."""
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


def placed(parts: Sequence[Mesh], angle: float, position: Numbers) -> tuple[Mesh, ...]:
    """The parts of a model turned by `angle` radians about z, then shifted to `position` ``(3,)``."""
    rotation, offset = turned_about_z(angle), np.asarray(position, dtype=np.float64)
    return tuple(replace(part, vertices=(part.vertices @ rotation.T + offset).astype(np.float32)) for part in parts)


def solid(vertices: np.ndarray, triangles: np.ndarray, grain: int | None = None) -> Mesh:
    """The mesh of these vertices ``(V, 3)`` and triangles ``(T, 3)``, its texture projected along the nearest axis.

    Without `grain`, u runs to the right and v up for someone who looks at the triangle (x and y on horizontal ones).
    With it, u runs along that axis wherever the triangle contains it.
    """
    vertices, triangles = np.asarray(vertices, dtype=np.float32), np.asarray(triangles, dtype=np.int32)
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    sign = np.sign(np.take_along_axis(normal, axis[:, None], axis=1)[:, 0]) * np.array([1, -1, 1])[axis]
    u_axis, v_axis = np.array([1, 0, 0])[axis], np.array([2, 2, 1])[axis]
    if grain is not None:
        along = axis != grain
        u_axis, v_axis = np.where(along, grain, u_axis), np.where(along, 3 - axis - grain, v_axis)
        sign = np.where(along, 1, sign)
    uv = np.take_along_axis(corners, np.stack([u_axis, v_axis], axis=1)[:, None], axis=2)
    uv[..., 0] *= sign[:, None]
    return Mesh(vertices, triangles, uv)


def quad(corners: Sequence[Numbers] | np.ndarray) -> Mesh:
    """A flat four-sided face ``(4, 3)``, counter-clockwise; uv is (0, 0) at corner 0, u towards 1, v towards 3."""
    corners = np.asarray(corners, dtype=np.float64)
    u, v = np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[3] - corners[0])
    uv = np.array([[0, 0], [u, 0], [u, v], [0, v]], dtype=np.float32)
    return Mesh(corners.astype(np.float32), QUAD, uv[QUAD])


def box(low: Numbers, high: Numbers, grain: int | None = None) -> Mesh:
    """A box between two corners ``(3,)``, 12 triangles; the grain along the axis `grain`, or its longest side."""
    size = np.subtract(high, low)
    return solid(np.asarray(low) + _CORNERS * size, _BOX.faces, int(size.argmax()) if grain is None else grain)


def post(foot: Numbers, top: Numbers, foot_size: Numbers, top_size: Numbers) -> Mesh:
    """A leg, perhaps leaning and tapered, from `foot` ``(3,)`` to `top`, with sizes (x, y) there; grain along z."""
    share = _CORNERS[:, 2:]
    size = (1 - share) * [*foot_size, 0] + share * [*top_size, 0]
    return solid((1 - share) * foot + share * np.asarray(top) + (_CORNERS - 0.5) * size, _BOX.faces, grain=2)


def bevelled(low: Numbers, high: Numbers, radius: float, grain: int | None = None) -> Mesh:
    """A box with edges cut off by `radius` (or half of the shortest side): 44 triangles; `grain` as in `solid`."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    half = (high - low) / 2
    radius = min(float(radius), 0.998 * float(half.min()))
    return solid((low + high) / 2 + _SIGNS * (half - radius) + _OUTWARD * radius, _CUT, grain)


def cushion(low: Numbers, high: Numbers, power: float = 5.0) -> Mesh:
    """A soft box that fills `low` to `high` ``(3,)``: a superellipsoid, rounder for less `power`; 192 triangles."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    cube = 2 * np.asarray(_FINE.vertices)
    place = cube / (np.abs(cube) ** power).sum(axis=1, keepdims=True) ** (1 / power)
    return solid((low + high) / 2 + place * (high - low) / 2, _FINE.faces)


def lathe(profile: Sequence[Numbers] | np.ndarray, sides: int = 20, stretch: Numbers = (1.0, 1.0)) -> Mesh:
    """A shape turned about the z axis from `profile` ``(n, 2)`` of (r, z), drawn from its bottom upwards.

    It is closed where the profile starts and ends at r = 0, else open; `stretch` makes it oval along x and y.
    """
    made = trimesh.creation.revolve(np.asarray(profile, dtype=np.float64), sections=sides)
    return solid(np.asarray(made.vertices) * [*stretch, 1.0], made.faces)


def cylinder(centre: Numbers, radius: float, height: float, sides: int = 16) -> Mesh:
    """An upright cylinder on `centre` ``(3,)``, the middle of its base."""
    return moved(lathe([(0, 0), (radius, 0), (radius, height), (0, height)], sides), centre)


def tube(path: Sequence[Numbers] | np.ndarray, radius: float, sides: int = 6) -> Mesh:
    """Round bars from point to point of `path` ``(n, 3)``."""
    bars = [trimesh.creation.cylinder(radius, sections=sides, segment=np.array(ends)) for ends in pairwise(path)]
    return merged(*(solid(bar.vertices, bar.faces) for bar in bars))


def polar(radius: np.ndarray | float, azimuth: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Points ``(..., 3)`` at these distances from the z axis, azimuths (radians from +x) and heights."""
    return np.stack(np.broadcast_arrays(radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=-1)


def timber(colour: str, rng: np.random.Generator) -> Cover:
    """The finish of wooden furniture: visible grain where it is a colour of wood, else mostly paint."""
    grained = colour in ("brown", "beige") or (colour in ("black", "grey") and rng.random() < 0.5)
    return finish("wood" if grained else "paint", colour, rng)


def fittings(rng: np.random.Generator) -> Cover:
    """The finish of handles and metal legs: steel or black."""
    return finish("metal", None if rng.random() < 0.6 else "black", rng)


def legs(x0: float, y0: float, x1: float, y1: float, height: float, size: float, foot: float | None = None) -> Mesh:
    """Four square legs whose middles are the corners of a rectangle, metres; `size` at the top, `foot` at the floor."""
    below, above = (foot or size,) * 2, (size, size)
    return merged(*(post((x, y, 0), (x, y, height), below, above) for x in (x0, x1) for y in (y0, y1)))


def front(x: float, y0: float, y1: float, z0: float, z1: float) -> Mesh:
    """A door or the front of a drawer, its back at `x`, facing +x; the grain along its longer side."""
    return bevelled((x, y0, z0), (x + 0.018, y1, z1), 0.004, 1 if y1 - y0 > z1 - z0 else 2)


def pull(x: float, y: float, z: float, length: float, upright: bool = False) -> Mesh:
    """A bar handle of `length`, centred at (y, z) on a front at `x` that faces +x."""
    half = np.array([0.0, 0.0, length / 2] if upright else [0.0, length / 2, 0.0])
    middle, out = np.array([x, y, z]), np.array([0.028, 0, 0])
    return tube([middle - half, middle - half + out, middle + half + out, middle + half], 0.006, sides=5)


def drawers(x: float, ends: Numbers, cuts: Numbers) -> tuple[list[Mesh], list[Mesh]]:
    """Fronts and handles between neighbours of `ends` (along y) and of the heights `cuts`, their backs at `x`."""
    fronts, handles = [], []
    for (y0, y1), (z0, z1) in product(pairwise(ends), pairwise(cuts)):
        fronts.append(front(x, y0 + 0.006, y1 - 0.006, z0 + 0.004, z1 - 0.004))
        handles.append(pull(x + 0.018, (y0 + y1) / 2, (z0 + z1) / 2, min(0.3 * (y1 - y0), 0.18) + 0.04))
    return fronts, handles
