"""What bathrooms and kitchens share: vessels from rings, basins, taps."""

from __future__ import annotations

import math

import numpy as np

from eagor.worlds.apartment.meshes import Mesh, cylinder, merged, sheet, tube


def ellipse(x: float, y: float, sides: int = 20, front: float = 0.0) -> np.ndarray:
    """An outline ``(sides, 2)`` with half axes `x`, `y`, counter-clockwise; its half at +x is `front` longer."""
    angle = np.arange(sides) * (2 * math.pi / sides)
    cosine = np.cos(angle)
    return np.stack([np.where(cosine > 0, x + front, x) * cosine, y * np.sin(angle)], axis=-1)


def vessel(rings: list[tuple[np.ndarray, float, float]]) -> Mesh:
    """A surface through rings (outline ``(n, 2)``, shift along x, height z), first up outside, then down inside.

    A ring given twice makes a sharp edge.
    """
    points = np.stack([np.column_stack([r[:, 0] + shift, r[:, 1], np.full(len(r), z)]) for r, shift, z in rings])
    points = np.concatenate([points, points[:, :1]], axis=1)
    same = [k for k in range(1, len(points)) if np.allclose(points[k], points[k - 1])]
    pieces = np.split(points, same)
    return merged(*(sheet(piece) for piece in pieces if len(piece) > 1))


def disc(outline: np.ndarray, shift: float, z: float) -> Mesh:
    """The flat inside of an outline ``(n, 2)`` at height `z`, seen from above: a bottom or a lid."""
    ring = np.column_stack([outline[:, 0] + shift, outline[:, 1], np.full(len(outline), z)])
    vertices = np.concatenate([ring, ring.mean(axis=0, keepdims=True)]).astype(np.float32)
    k = np.arange(len(ring))
    triangles = np.stack([k, (k + 1) % len(ring), np.full(len(ring), len(ring))], axis=-1).astype(np.int32)
    return Mesh(vertices, triangles, vertices[triangles][..., :2].astype(np.float32))


def tap(x: float, y: float, z: float, reach: float, height: float) -> Mesh:
    """A tap that stands at (x, y, z) and reaches towards +x, with a lever."""
    bow = [(x, y, z), (x, y, z + 0.75 * height), (x + 0.25 * reach, y, z + height), (x + 0.8 * reach, y, z + height)]
    spout = tube([*bow, (x + reach, y, z + 0.72 * height)], 0.012, 8)
    lever = tube([(x, y + 0.01, z + 0.4 * height), (x, y + 0.06, z + 0.5 * height)], 0.007, 6)
    return merged(spout, lever, cylinder((x, y, z), 0.024, 0.02, 10))
