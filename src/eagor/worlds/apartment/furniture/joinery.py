"""What joiners' furniture has in common: its wood, legs, drawer fronts and handles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from eagor.worlds.apartment.furniture.model import finish
from eagor.worlds.apartment.meshes import Mesh, Part, bevelled, box, lathe, merged, moved, post, tube

WOODS = ("brown", "white", "black", "beige")  # colours that furniture of wood comes in


def timber(colour: str, rng: np.random.Generator) -> Callable[..., Part]:
    """The finish of wooden furniture: visible grain where it is a colour of wood, else mostly paint."""
    grained = colour in ("brown", "beige") or (colour in ("black", "grey") and rng.random() < 0.5)
    return finish("wood" if grained else "paint", colour, rng)


def fittings(rng: np.random.Generator) -> Callable[..., Part]:
    """The finish of handles and metal legs: steel or black."""
    return finish("metal", None if rng.random() < 0.6 else "black", rng)


def legs(
    inset: tuple[float, float, float, float], height: float, size: float, foot: float = 0.0, splay: float = 0.0
) -> Mesh:
    """Four square legs under the rectangle `inset` (x0, y0, x1, y1) that joins the middles of their tops, metres.

    They measure `size` at the top and `foot` at the floor (0: the same), where they stand `splay` further out.
    """
    x0, y0, x1, y1 = inset
    foot = foot or size
    made = []
    for x, out_x in ((x0, -splay), (x1, splay)):
        for y, out_y in ((y0, -splay), (y1, splay)):
            made.append(post((x + out_x, y + out_y, 0), (x, y, height), (foot, foot), (size, size)))
    return merged(*made)


def apron(inset: tuple[float, float, float, float], low: float, high: float, thickness: float = 0.02) -> Mesh:
    """Four boards on edge that join the legs over the rectangle `inset` (x0, y0, x1, y1) from `low` to `high`."""
    x0, y0, x1, y1 = inset
    t = thickness / 2
    return merged(
        *(box((x0, y - t, low), (x1, y + t, high), grain=0) for y in (y0, y1)),
        *(box((x - t, y0, low), (x + t, y1, high), grain=1) for x in (x0, x1)),
    )


def panel(x: float, y0: float, y1: float, z0: float, z1: float, thickness: float = 0.018) -> Mesh:
    """A drawer front or small door: its back at `x`, facing +x, the grain along its longer side."""
    grain = 1 if y1 - y0 > z1 - z0 else 2
    return bevelled((x, y0, z0), (x + thickness, y1, z1), 0.004, grain=grain)


def facing(mesh: Mesh, at: tuple[float, float, float]) -> Mesh:
    """A shape made about the z axis, laid over so that its top faces +x, at a point."""
    return moved(Mesh(mesh.vertices[:, [2, 0, 1]], mesh.triangles, mesh.uv), at)  # a turn, so outside stays outside


def knob(x: float, y: float, z: float, size: float = 0.015) -> Mesh:
    """A turned knob of radius `size`, on a front at `x` that faces +x."""
    ball = lathe(
        [(0.4 * size, 0), (0.45 * size, 0.5 * size), (size, size), (0.8 * size, 1.6 * size), (0, 1.8 * size)], 8
    )
    return facing(ball, (x, y, z))


def pull(x: float, y: float, z: float, length: float, upright: bool = False) -> Mesh:
    """A bar handle of `length`, centred at (y, z) on a front at `x` that faces +x."""
    along = np.array([0, 0, 1.0]) if upright else np.array([0, 1.0, 0])
    start, end = np.array([x, y, z]) - along * length / 2, np.array([x, y, z]) + along * length / 2
    out = np.array([0.028, 0, 0])
    return tube([start, start + out, end + out, end], 0.006, sides=5)
