"""Toilets and bathtubs, and what they share with sinks: vessels from rings, flat bottoms, taps."""

from __future__ import annotations

import math

import numpy as np

from eagor.sphere import rotation
from eagor.worlds.apartment.curved import cylinder, sheet, tube
from eagor.worlds.apartment.furniture.model import finish
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, merged, moved, prism, rounded_rectangle, turned


def ellipse(x: float, y: float, sides: int = 20, front: float = 0.0) -> np.ndarray:
    """An outline ``(sides, 2)`` with half axes `x`, `y`, counter-clockwise; its half at +x is `front` longer."""
    angle = np.arange(sides) * (2 * math.pi / sides)
    cosine = np.cos(angle)
    return np.stack([np.where(cosine > 0, x + front, x) * cosine, y * np.sin(angle)], axis=-1)


def vessel(rings: list[tuple[np.ndarray, float, float]]) -> Mesh:
    """A surface through rings (outline ``(n, 2)``, shift along x, height); a ring given twice makes a sharp edge."""
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


def toilet(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bowl on its foot, a seat, a lid that is up or down, and a cistern at the wall."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    seat = finish("plastic", colour, rng)
    rim, wide, height = 0.2, rng.uniform(0.175, 0.19), rng.uniform(0.39, 0.42)
    egg = ellipse(rim, wide, 20, 0.06)
    hole = 0.72 * egg
    bowl = vessel(
        [
            (ellipse(0.16, 0.11, 20, 0.03), -0.06, 0.0), (ellipse(0.15, 0.1, 20, 0.02), -0.06, 0.05),
            (ellipse(0.15, 0.095, 20, 0.02), -0.05, 0.17), (ellipse(0.18, 0.15, 20, 0.05), -0.02, 0.3),
            (egg, 0.0, height - 0.03), (egg, 0.0, height), (egg, 0.0, height), (hole, 0.01, height),
            (hole, 0.01, height), (0.8 * hole, 0.0, height - 0.1), (0.35 * hole, -0.02, height - 0.19),
        ]
    )  # fmt: skip
    water = disc(0.45 * hole, -0.015, height - 0.165)
    ring_out, ring_in, top = 1.03 * egg, 0.66 * egg, height + 0.022
    ring = vessel(
        [(ring_out, 0, height + 0.002), (ring_out, 0, top), (ring_out, 0, top), (ring_in, 0.012, top),
         (ring_in, 0.012, top), (ring_in, 0.012, height + 0.002)]
    )  # fmt: skip
    lid = prism(1.03 * egg, 0, 0.016)
    if rng.random() < 0.65:
        lean = rotation([0, 1, 0], -math.radians(88))
        lid = moved(turned(moved(lid, (rim, 0, 0)), lean), (-rim + 0.02, 0, top))
    else:
        lid = moved(lid, (0, 0, top))
    back, tank = -rim - 0.21, rng.uniform(0.17, 0.19)
    tall, half = rng.uniform(0.74, 0.82), rng.uniform(0.185, 0.22)
    cistern = merged(
        bevelled((back, -half, height - 0.02), (back + tank, half, tall - 0.035), 0.03, 2),
        bevelled((back - 0.003, -half - 0.012, tall - 0.035), (back + tank + 0.012, half + 0.012, tall), 0.014, 1),
        bevelled((back + 0.01, -0.1, 0.0), (-0.1, 0.1, height - 0.01), 0.03, 1),
        bevelled((back + 0.01, -0.15, height - 0.1), (-rim + 0.1, 0.15, height), 0.03, 1),
    )
    button = cylinder((back + tank / 2, 0, tall), 0.022, 0.008, 12)
    hinge = tube([(-rim + 0.012, -0.08, top + 0.01), (-rim + 0.012, 0.08, top + 0.01)], 0.011, 6)
    pool = finish("glass", None, rng)
    return [glaze(bowl, cistern), pool(water), seat(ring, lid), metal(button, hinge)]


def bathtub(colour: str, rng: np.random.Generator) -> list[Part]:
    """A tub with panelled sides at the wall, or a free oval one; its length along y, the tap at one end."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    x, y, height = rng.uniform(0.36, 0.41), rng.uniform(0.78, 0.88), rng.uniform(0.54, 0.6)
    oval = rng.random() < 0.35
    if oval:
        outer, inner, foot = ellipse(x, y, 32), ellipse(x - 0.055, y - 0.055, 32), 0.72
    else:
        outer, foot = rounded_rectangle(2 * x, 2 * y, 0.03, 7), 1.0
        inner = rounded_rectangle(2 * x - 0.14, 2 * y - 0.16, 0.2, 7)
    floor = height - 0.42
    tub = vessel(
        [
            (foot * outer, 0, 0), ((0.3 * foot + 0.7) * outer, 0, 0.6 * height), (outer, 0, height - 0.015),
            (outer, 0, height), (outer, 0, height), (inner, 0, height), (inner, 0, height),
            (0.93 * inner, 0, height - 0.25), (0.84 * inner, 0, floor + 0.03), (0.74 * inner, 0, floor),
        ]
    )  # fmt: skip
    parts = [glaze(tub, disc(0.74 * inner, 0, floor))]
    end = y - (0.03 if oval else 0.04)
    spout = turned(tap(0, 0, 0, 0.15, 0.16), rotation([0, 0, 1], -math.pi / 2))
    drain = cylinder((0, 0.74 * (y - 0.08) - 0.12, floor), 0.026, 0.004, 10)
    valves = [cylinder((s, end, height), 0.02, 0.05, 8) for s in (-0.09, 0.09)]
    parts.append(metal(moved(spout, (0, end, height)), drain, *valves))
    return parts
