"""Kitchens and bathrooms: refrigerators, stoves, sinks, toilets and bathtubs; vessels from rings, flat bottoms, taps.

A white sink is for a bathroom, on a pedestal or a small cabinet; a grey one is a kitchen unit with a steel top. The
part below the basin belongs to the sink and has its colour.
"""

from __future__ import annotations

import math

import numpy as np

from eagor.lab.worlds.apartment.furniture.joinery import base_units, front
from eagor.lab.worlds.apartment.furniture.model import facing, finish, fittings, pull
from eagor.lab.worlds.apartment.mesh import (
    Mesh,
    Part,
    bevelled,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    prism,
    rounded_rectangle,
    sheet,
    tube,
    turned,
)
from eagor.sphere import rotation


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


def refrigerator(colour: str, rng: np.random.Generator) -> list[Part]:
    """Freezer above or below, or two doors side by side, with long handles."""
    shell, metal = finish("metal" if colour == "grey" else "plastic", colour, rng), finish("metal", "grey", rng)
    seal = finish("plastic", "black" if colour != "black" else "grey", rng)
    design = rng.integers(3)
    wide = design == 2
    depth, width = rng.uniform(0.62, 0.7), rng.uniform(0.85, 0.92) if wide else rng.uniform(0.56, 0.68)
    height = rng.uniform(1.72, 1.82) if wide else rng.uniform(1.5, 1.95)
    x, y, edge, base = depth / 2, width / 2, depth / 2 - 0.065, 0.06
    dark = [
        box((edge - 0.012, -y + 0.012, base), (edge, y - 0.012, height - 0.008)),
        box((-x + 0.05, -y + 0.03, 0), (edge - 0.03, y - 0.03, 0.06)),
    ]
    if wide:
        split = rng.uniform(-0.12, 0.0)
        doors = [(-y, split - 0.003, base, height), (split + 0.003, y, base, height)]
        handles = [_bow(x, (split + side, 0.62), (split + side, 1.32), 0.012) for side in (-0.035, 0.035)]
        if rng.random() < 0.5:
            middle = (split - y) / 2
            dark.append(box((x - 0.004, middle - 0.1, 1.0), (x + 0.003, middle + 0.1, 1.32)))
    else:
        cut = height * (rng.uniform(0.66, 0.72) if design == 0 else rng.uniform(0.32, 0.4))
        doors = [(-y, y, base, cut - 0.004), (-y, y, cut + 0.004, height)]
        side = (y - 0.05) * (1 if rng.random() < 0.5 else -1)
        a, b, c, d = (0.5, 0.08, 0.06, 0.32) if design == 0 else (0.3, 0.06, 0.08, 0.55)
        spans = ((cut - a, cut - b), (cut + c, cut + d))
        handles = [_bow(x, (side, low), (side, high), 0.012) for low, high in spans]
    fronts = [bevelled((edge, y0, z0), (x, y1, z1), 0.02, 2) for y0, y1, z0, z1 in doors]
    return [shell(box((-x, -y, 0.03), (edge - 0.012, y, height)), *fronts), seal(*dark), metal(*handles)]


def _bow(x: float, start: tuple[float, float], end: tuple[float, float], radius: float) -> Mesh:
    """A bar handle between two points (y, z) of a front at `x`, 4 cm before it, with its ends bent to the front."""
    dy, dz = (0.02 if b > a else 0.0 for a, b in zip(start, end, strict=True))
    far = [(x + 0.04, start[0] + dy, start[1] + dz), (x + 0.04, end[0] - dy, end[1] - dz)]
    return tube([(x - 0.005, *start), *far, (x - 0.005, *end)], radius, 6)


def stove(colour: str, rng: np.random.Generator) -> list[Part]:
    """Four plates over an oven with a window, a handle and a row of knobs; some with a panel at the back."""
    shell, metal = finish("metal" if colour == "grey" else "plastic", colour, rng), finish("metal", None, rng)
    glass, plates = finish("plastic", "black", rng), finish("metal", "black" if rng.random() < 0.5 else "grey", rng)
    width, depth, height = rng.uniform(0.58, 0.66), 0.6, rng.uniform(0.86, 0.92)
    x, y, door_top, door_low = depth / 2, width / 2, height - 0.16, 0.24
    body = [
        box((-x, -y, 0.08), (x - 0.03, y, height - 0.012)),
        box((-x + 0.02, -y + 0.02, 0), (x - 0.08, y - 0.02, 0.08)),
        bevelled((x - 0.03, -y + 0.004, door_low), (x, y - 0.004, door_top), 0.008),
        bevelled((x - 0.03, -y + 0.004, 0.085), (x, y - 0.004, door_low - 0.008), 0.008),
        box((x - 0.03, -y, door_top + 0.008), (x - 0.006, y, height - 0.012)),
    ]
    dark = [box((x - 0.01, -y + 0.09, door_low + 0.1), (x + 0.002, y - 0.09, door_top - 0.12))]
    bright = [_bow(x, (-half, z), (half, z), 0.01) for half, z in ((y - 0.05, door_top - 0.055), (y - 0.14, 0.2))]
    knob = facing(cylinder((0, 0, 0), 0.021, 0.03, 10), (x - 0.006, 0.0, height - 0.075))
    bright += [moved(knob, (0, at, 0)) for at in np.linspace(-y + 0.09, y - 0.09, 5)]
    gas, rings = rng.random() < 0.4, []
    (body if gas else dark).append(bevelled((-x, -y, height - 0.012), (x, y, height), 0.004))
    for px, py, r in ((-0.13, -0.14, 0.085), (-0.13, 0.14, 0.1), (0.13, -0.14, 0.1), (0.13, 0.14, 0.085)):
        if gas:
            arm = 1.15 * r
            rings.append(cylinder((px, py, height), 0.5 * r, 0.022, 10))
            for dx, dy in ((arm, 0.006), (0.006, arm)):
                rings.append(box((px - dx, py - dy, height + 0.022), (px + dx, py + dy, height + 0.034)))
        else:
            rim = [(r, 0), (r, 0.006), (r, 0.006), (0.86 * r, 0.006), (0.84 * r, 0.003)]
            rings.append(moved(lathe([(0, 0), *rim, (0, 0.003)], 14), (px, py, height)))
    if rng.random() < 0.5:
        body.append(bevelled((-x, -y, height - 0.01), (-x + 0.05, y, height + rng.uniform(0.08, 0.16)), 0.008))
    return [shell(*body), glass(*dark), plates(*rings), metal(*bright)]


def sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sink: white for the bathroom, grey for the kitchen."""
    if colour == "grey":
        return _kitchen_sink(rng)
    return (_pedestal_sink if rng.random() < 0.6 else _cabinet_sink)(colour, rng)


def _basin(x: float, y: float, shift: float, z: float, deep: float, rounded: bool) -> tuple[np.ndarray, Mesh]:
    """The outline of a basin's opening ``(24, 2)`` and the hollow under it."""
    outline = ellipse(x, y, 24) if rounded else rounded_rectangle(2 * x, 2 * y, 0.06, 5)
    hollow = vessel([(outline, shift, z), (0.94 * outline, shift, z - 0.6 * deep), (0.6 * outline, shift, z - deep)])
    return outline, merged(hollow, disc(0.6 * outline, shift, z - deep))


def _plate(x: float, y: float, outline: np.ndarray, shift: float, z: float) -> Mesh:
    """The flat rim at height `z` between an opening and the rectangle with half sides `x`, `y` round it."""
    inner = outline + np.array([shift, 0])
    reach = np.minimum(x / np.maximum(np.abs(inner[:, 0]), 1e-9), y / np.maximum(np.abs(inner[:, 1]), 1e-9))
    outer = inner * reach[:, None]
    for at in np.array([[x, y], [-x, y], [-x, -y], [x, -y]]):  # the ray nearest to each corner goes into it
        outer[np.argmax(inner @ at / np.linalg.norm(inner, axis=1))] = at
    return vessel([(outer, 0.0, z), (inner, 0.0, z)])


def _edge(x: float, y: float, low: float, high: float) -> Mesh:
    """The upright rim round a rectangular top with half sides `x`, `y`."""
    outline = np.array([[x, -y], [x, y], [-x, y], [-x, -y]])
    return vessel([(outline, 0.0, low), (outline, 0.0, high)])


def _pedestal_sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bowl with a ledge for the tap at the wall, on a column."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    x, y, height = rng.uniform(0.2, 0.24), rng.uniform(0.26, 0.32), rng.uniform(0.82, 0.88)
    rim, hole = rounded_rectangle(2 * x, 2 * y, 0.6 * x, 5), ellipse(0.72 * x, 0.78 * y, 24)
    outer = rim[np.argsort(np.arctan2(rim[:, 1], rim[:, 0]) % (2 * np.pi), kind="stable")]
    bowl = vessel(
        [
            (0.45 * outer, -0.02, height - 0.2), (0.8 * outer, -0.01, height - 0.14), (outer, 0, height - 0.06),
            (outer, 0, height), (outer, 0, height), (hole, 0.2 * x, height), (hole, 0.2 * x, height),
            (0.85 * hole, 0.2 * x, height - 0.08), (0.4 * hole, 0.2 * x, height - 0.13),
        ]
    )  # fmt: skip
    bottom = disc(0.4 * hole, 0.2 * x, height - 0.13)
    column = lathe([(0.1, 0), (0.1, 0.02), (0.07, 0.12), (0.065, 0.5), (0.1, height - 0.17)], 16)
    drain = cylinder((0.2 * x, 0, height - 0.13), 0.022, 0.004, 10)
    return [glaze(bowl, bottom, moved(column, (-0.04, 0, 0))), metal(tap(-0.78 * x, 0, height, 0.13, 0.11), drain)]


def _cabinet_sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A basin let into the top of a small cabinet."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    wood = finish("paint", colour, rng)
    x, y, height = 0.235, rng.uniform(0.3, 0.45), rng.uniform(0.8, 0.86)
    low = height - 0.05
    body = [
        box((-x + 0.01, -y + 0.01, 0.12), (x - 0.03, y - 0.01, low - 0.1), 2),
        box((-x + 0.03, -y + 0.03, 0), (x - 0.09, y - 0.03, 0.12), 1),
    ]
    # Round the hollow of the basin there are only the cabinet's walls.
    body += [box((-x + 0.01, s - 0.008, low - 0.1), (x - 0.03, s + 0.008, low), 2) for s in (-y + 0.018, y - 0.018)]
    body += [front(x - 0.03, a, b, 0.125, low - 0.003, False) for a, b in ((-y + 0.012, -0.002), (0.002, y - 0.012))]
    outline, hollow = _basin(0.15, min(0.24, y - 0.06), 0.03, height, 0.11, rng.random() < 0.5)
    handles = [pull(x - 0.012, s, low - 0.14, 0.12, upright=True) for s in (-0.04, 0.04)]
    drain = cylinder((0.03, 0, height - 0.11), 0.022, 0.004, 10)
    top = glaze(_plate(x, y, outline, 0.03, height), hollow, _edge(x, y, low, height))
    return [wood(*body), top, metal(tap(-x + 0.06, 0, height, 0.14, 0.14), drain, *handles)]


def _kitchen_sink(rng: np.random.Generator) -> list[Part]:
    """Base units under a steel top with one or two basins, a drainer and a tall tap."""
    steel, bright = finish("metal", "grey", rng), finish("metal", None, rng)
    x, y, height = 0.29, rng.uniform(0.5, 0.8), rng.uniform(0.88, 0.92)
    top = height - 0.03
    body, handles = base_units(x, y, top - 0.17, rng, framed=False, drawers=False)
    walls = [box((-x, s - 0.009, top - 0.17), (x - 0.02, s + 0.009, top), 2) for s in (-y + 0.009, y - 0.009)]
    walls.append(box((x - 0.04, -y, top - 0.175), (x, y, top), 1))
    wide, roomy = x + 0.02, y > 0.6
    outline, hollow = _basin(0.19, 0.24 if roomy else 0.26, 0.02, height, 0.16, False)
    centre = -y + 0.36
    left, right = (centre - 0.3, centre + 0.3) if roomy else (-y, y)
    middle = (left + right) / 2
    plates = [moved(merged(_plate(wide, (right - left) / 2, outline, 0.02, height), hollow), (0, middle, 0))]
    for y0, y1 in ((-y, left), (right, y)):
        if y1 - y0 > 0.02:
            ridges = np.arange(y0 + 0.06, y1 - 0.05, 0.045)
            plates.append(box((-wide, y0, top), (wide, y1, height)))
            plates += [box((-0.18, g, height), (0.2, g + 0.012, height + 0.005)) for g in ridges]
    drain = cylinder((0.02, middle, height - 0.16), 0.03, 0.004, 10)
    fixture = tap(-x + 0.06, middle, height, 0.2, 0.3)
    fronts = finish("metal" if rng.random() < 0.4 else "paint", "grey", rng)
    steel_top = steel(*plates, _edge(wide, y, top, height))
    return [fronts(body, *walls), fittings(rng)(handles), steel_top, bright(fixture, drain)]
