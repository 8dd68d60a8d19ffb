"""Meshes: what one is, moving and joining them, covering them with a material.

Model frame: x forward, y left, z up, right-handed, metres. Triangles run counter-clockwise seen from outside. Corners
that share a vertex are meant to be shaded smoothly, hard edges have vertices of their own. Texture coordinates are
metres along the surface until `part` divides them by the size of one repeat; textures with a direction (the grain of
wood) run along u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.scene import Material

Triple = Sequence[float] | np.ndarray


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
class Part:
    """A mesh with one material; `uv` ``(T, 3, 2)`` in repeats of the material's texture, u to the right, v up."""

    vertices: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    material: Material


def part(mesh: Mesh, material: Material, repeat: float | tuple[float, float] = 1.0) -> Part:
    """`mesh` covered with `material`, of whose texture one repeat measures `repeat` metres (or (u, v) metres)."""
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


def mirrored(mesh: Mesh, axis: int) -> Mesh:
    """`mesh` flipped through the plane where coordinate `axis` is zero; outside stays outside."""
    sign = np.ones(3, dtype=np.float32)
    sign[axis] = -1
    return Mesh(mesh.vertices * sign, mesh.triangles[:, ::-1].copy(), mesh.uv[:, ::-1].copy())


def merged(*meshes: Mesh) -> Mesh:
    """All the meshes as one; they stay as they are, nothing is welded."""
    if len(meshes) == 1:
        return meshes[0]
    if not meshes:
        raise WorldError("merged() of no mesh; give at least one")
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + np.int32(start) for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh.uv for mesh in meshes]),
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
    """`mesh` with its vertices ``(V, 3)`` put where `change` sends them (float64); the texture stays on its corners."""
    return Mesh(np.asarray(change(mesh.vertices.astype(np.float64)), dtype=np.float32), mesh.triangles, mesh.uv)


def checked_bounds(low: Triple, high: Triple, what: str) -> tuple[np.ndarray, np.ndarray]:
    """`low` and `high` as float64 ``(3,)``. Raises `WorldError` unless low lies below high on every axis."""
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    if low.shape != (3,) or high.shape != (3,) or not (high > low).all():
        raise WorldError(
            f"{what} from {low.tolist()} to {high.tolist()}; wanted low (3,) below high (3,) on every axis"
        )
    return low, high


def projected(vertices: np.ndarray, triangles: np.ndarray, grain: int | None) -> Mesh:
    """The mesh of these vertices and triangles with a texture by `planar_uv`."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float32)
    return Mesh(vertices, triangles, planar_uv(vertices, triangles, grain))


def grid_triangles(index: np.ndarray) -> np.ndarray:
    """Two triangles for each cell of a grid of vertex numbers (rows, columns), less those with a repeated corner."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=-2).reshape(-1, 3)
    p, q, r = triangles.T
    return triangles[(p != q) & (q != r) & (r != p)].astype(np.int32)
