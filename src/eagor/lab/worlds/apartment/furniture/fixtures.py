"""Kitchens and bathrooms: refrigerators, stoves, sinks, toilets and bathtubs.

A white sink is for a bathroom, on a pedestal or a small cabinet; a grey one is a kitchen unit with a steel top. The
part below the basin belongs to the sink and has its colour.
"""

from __future__ import annotations

import numpy as np

from eagor.lab.worlds.apartment.furniture.joinery import base_units, front
from eagor.lab.worlds.apartment.furniture.model import facing, finish, fittings, pull
from eagor.lab.worlds.apartment.mesh import (
    Mesh,
    Part,
    Triple,
    bevelled,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    tube,
    turned,
)
from eagor.sphere import rotation


def tap(x: float, y: float, z: float, reach: float, height: float) -> Mesh:
    """A tap that stands at (x, y, z) and reaches towards +x, with a lever."""
    bow = [(x, y, z), (x, y, z + height), (x + 0.9 * reach, y, z + height), (x + reach, y, z + 0.72 * height)]
    lever = tube([(x, y + 0.01, z + 0.4 * height), (x, y + 0.06, z + 0.5 * height)], 0.007, 6)
    return merged(tube(bow, 0.012, 8), lever, cylinder((x, y, z), 0.024, 0.02, 10))


def trough(low: Triple, high: Triple, outer: Triple, deep: float) -> Mesh:
    """A basin: the hollow from `low` to `high` (x, y), `deep` below the top of its rim, which reaches to `outer`.

    `outer`: x0, y0, x1, y1 and z of the rim, which is 3 cm thick.
    """
    (a, b), (c, d), (x0, y0, x1, y1, z), t = low, high, outer, 0.015
    rim = [((x0, y0), (x1, b)), ((x0, d), (x1, y1)), ((x0, b), (a, d)), ((c, b), (x1, d))]
    walls = [((a - t, b - t), (c + t, b)), ((a - t, d), (c + t, d + t)), ((a - t, b), (a, d)), ((c, b), (c + t, d))]
    return merged(
        *(box((*p, z - 0.03), (*q, z)) for p, q in rim),
        *(box((*p, z - deep), (*q, z - 0.03)) for p, q in walls),
        box((a - t, b - t, z - deep - t), (c + t, d + t, z - deep)),
    )


def toilet(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bowl on its foot, a seat, a lid that is up or down, and a cistern at the wall."""
    glaze, seat, metal = finish("ceramic", colour, rng), finish("plastic", colour, rng), finish("metal", None, rng)
    r, height = rng.uniform(0.175, 0.19), rng.uniform(0.39, 0.42)
    oval, top = (1.25, 1.0), height + 0.022
    bowl = lathe(
        [(0, 0), (0.11, 0), (0.095, 0.17), (0.15, 0.3), (r, height - 0.03), (r, height), (0.72 * r, height),
         (0.55 * r, height - 0.1), (0.2 * r, height - 0.19), (0, height - 0.19)], 20, oval,
    )  # fmt: skip
    ring = lathe([(1.03 * r, height), (1.03 * r, top), (0.66 * r, top), (0.66 * r, height)], 20, oval)
    water = lathe([(0.36 * r, height - 0.16), (0, height - 0.16)], 16, oval)
    lid = lathe([(0, 0), (1.03 * r, 0), (1.03 * r, 0.016), (0, 0.016)], 20, oval)
    rear = -1.25 * r
    if rng.random() < 0.65:
        lid = moved(turned(moved(lid, (-rear, 0, 0)), rotation([0, 1, 0], -np.radians(88))), (rear + 0.02, 0, top))
    else:
        lid = moved(lid, (0, 0, top))
    back, tank = rear - 0.21, rng.uniform(0.17, 0.19)
    tall, half = rng.uniform(0.74, 0.82), rng.uniform(0.185, 0.22)
    cistern = [
        bevelled((back, -half, height - 0.02), (back + tank, half, tall - 0.035), 0.03),
        bevelled((back - 0.003, -half - 0.012, tall - 0.035), (back + tank + 0.012, half + 0.012, tall), 0.014),
        bevelled((back + 0.01, -0.1, 0.0), (-0.1, 0.1, height - 0.01), 0.03),
        bevelled((back + 0.01, -0.15, height - 0.1), (rear + 0.1, 0.15, height), 0.03),
    ]
    button = cylinder((back + tank / 2, 0, tall), 0.022, 0.008, 12)
    return [glaze(bowl, *cistern), finish("glass", None, rng)(water), seat(ring, lid), metal(button)]


def bathtub(colour: str, rng: np.random.Generator) -> list[Part]:
    """A tub with panelled sides at the wall, or a free oval one; its length along y, the tap at one end."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    x, y, height = rng.uniform(0.36, 0.41), rng.uniform(0.78, 0.88), rng.uniform(0.54, 0.6)
    floor, end = height - 0.42, y - 0.04
    if rng.random() < 0.35:
        profile = [(0.72, 0), (1, height - 0.015), (1, height), (0.88, height), (0.75, floor), (0, floor)]
        tub = lathe([(x * r, z) for r, z in profile], 32, (1.0, y / x))
    else:
        rim = trough((-x + 0.07, -y + 0.08), (x - 0.07, y - 0.08), (-x, -y, x, y, height), 0.42)
        sides = [
            ((-x, -y), (x, 0.02 - y)),
            ((-x, y - 0.02), (x, y)),
            ((-x, -y), (0.02 - x, y)),
            ((x - 0.02, -y), (x, y)),
        ]
        tub = merged(rim, *(box((*a, 0), (*b, height - 0.03)) for a, b in sides))
    spout = turned(tap(0, 0, 0, 0.15, 0.16), rotation([0, 0, 1], -np.pi / 2))
    drain = cylinder((0, 0.6 * y, floor), 0.026, 0.004, 10)
    valves = [cylinder((s, end, height), 0.02, 0.05, 8) for s in (-0.09, 0.09)]
    return [glaze(tub), metal(moved(spout, (0, end, height)), drain, *valves)]


def refrigerator(colour: str, rng: np.random.Generator) -> list[Part]:
    """Freezer above or below, or two doors side by side, with long handles."""
    shell, metal = finish("metal" if colour == "grey" else "plastic", colour, rng), finish("metal", "grey", rng)
    seal = finish("plastic", "black" if colour != "black" else "grey", rng)
    design = rng.integers(3)
    depth, width = rng.uniform(0.62, 0.7), rng.uniform(0.85, 0.92) if design == 2 else rng.uniform(0.56, 0.68)
    height = rng.uniform(1.5, 1.9)
    x, y, edge, base = depth / 2, width / 2, depth / 2 - 0.065, 0.06
    dark = [
        box((edge - 0.012, -y + 0.012, base), (edge, y - 0.012, height - 0.008)),
        box((-x + 0.05, -y + 0.03, 0), (edge - 0.03, y - 0.03, 0.06)),
    ]
    if design == 2:
        split = rng.uniform(-0.12, 0.0)
        doors = [(-y, split - 0.003, base, height), (split + 0.003, y, base, height)]
        bars = [pull(x, split + side, 0.97, 0.7, upright=True) for side in (-0.035, 0.035)]
    else:
        cut = height * (rng.uniform(0.66, 0.72) if design == 0 else rng.uniform(0.32, 0.4))
        doors = [(-y, y, base, cut - 0.004), (-y, y, cut + 0.004, height)]
        side = (y - 0.05) * (1 if rng.random() < 0.5 else -1)
        bars = [pull(x, side, cut + z, 0.3, upright=True) for z in (-0.24, 0.24)]
    fronts = [bevelled((edge, y0, z0), (x, y1, z1), 0.02) for y0, y1, z0, z1 in doors]
    return [shell(box((-x, -y, 0.03), (edge - 0.012, y, height)), *fronts), seal(*dark), metal(*bars)]


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
    dark = [
        box((x - 0.01, -y + 0.09, door_low + 0.1), (x + 0.002, y - 0.09, door_top - 0.12)),
        bevelled((-x, -y, height - 0.012), (x, y, height), 0.004),
    ]
    knob = facing(cylinder((0, 0, 0), 0.021, 0.03, 10), (x - 0.006, 0.0, height - 0.075))
    bright = [moved(knob, (0, at, 0)) for at in np.linspace(-y + 0.09, y - 0.09, 5)]
    bright += [pull(x, 0, door_top - 0.055, 2 * y - 0.1), pull(x, 0, 0.2, 2 * y - 0.28)]
    spots = ((-0.13, -0.14, 0.085), (-0.13, 0.14, 0.1), (0.13, -0.14, 0.1), (0.13, 0.14, 0.085))
    rings = [cylinder((px, py, height), r, 0.006, 14) for px, py, r in spots]
    if rng.random() < 0.5:
        body.append(bevelled((-x, -y, height - 0.01), (-x + 0.05, y, height + rng.uniform(0.08, 0.16)), 0.008))
    return [shell(*body), glass(*dark), plates(*rings), metal(*bright)]


def sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sink: white for the bathroom, on a pedestal or a small cabinet; grey for the kitchen."""
    if colour == "grey":
        return _kitchen_sink(rng)
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    height = rng.uniform(0.82, 0.88)
    if rng.random() < 0.6:
        r = rng.uniform(0.21, 0.24)
        bowl = lathe(
            [(0.3 * r, height - 0.2), (0.8 * r, height - 0.14), (r, height - 0.06), (r, height), (0.85 * r, height),
             (0.7 * r, height - 0.08), (0.3 * r, height - 0.13), (0, height - 0.13)], 24, (1.0, 1.3),
        )  # fmt: skip
        column = lathe([(0.1, 0), (0.1, 0.02), (0.07, 0.12), (0.065, 0.5), (0.1, height - 0.17)], 16)
        ledge = bevelled((-1.1 * r, -0.6 * r, height - 0.06), (-0.75 * r, 0.6 * r, height + 0.005), 0.01)
        return [glaze(bowl, column, ledge), metal(tap(-0.9 * r, 0, height, 0.13, 0.11))]
    wood, x, y = finish("paint", colour, rng), 0.235, rng.uniform(0.3, 0.45)
    low, half = height - 0.05, min(0.24, y - 0.06)
    body = [
        box((-x + 0.01, -y + 0.01, 0.12), (x - 0.03, y - 0.01, low - 0.1), 2),
        box((-x + 0.03, -y + 0.03, 0), (x - 0.09, y - 0.03, 0.12), 1),
        *(box((-x + 0.01, s - 0.008, low - 0.1), (x - 0.03, s + 0.008, low), 2) for s in (-y + 0.018, y - 0.018)),
        *(front(x - 0.03, a, b, 0.125, low - 0.003, False) for a, b in ((-y + 0.012, -0.002), (0.002, y - 0.012))),
    ]
    top = [trough((-0.11, -half), (0.17, half), (-x, -y, x, y, height), 0.11)]
    handles = [pull(x - 0.012, s, low - 0.14, 0.12, upright=True) for s in (-0.04, 0.04)]
    return [wood(*body), glaze(*top), metal(tap(-x + 0.06, 0, height, 0.14, 0.14), *handles)]


def _kitchen_sink(rng: np.random.Generator) -> list[Part]:
    """Base units under a steel top with a basin, a drainer and a tall tap."""
    steel, bright = finish("metal", "grey", rng), finish("metal", None, rng)
    x, y, height = 0.29, rng.uniform(0.5, 0.8), rng.uniform(0.88, 0.92)
    top = height - 0.03
    body, handles = base_units(x, y, top - 0.17, rng, framed=False)
    walls = [box((-x, s - 0.009, top - 0.17), (x - 0.02, s + 0.009, top), 2) for s in (-y + 0.009, y - 0.009)]
    walls.append(box((x - 0.04, -y, top - 0.175), (x, y, top), 1))
    basin = trough((-0.17, -y + 0.1), (0.21, -y + 0.6), (-x - 0.02, -y, x + 0.02, y, height), 0.16)
    ridges = [box((-0.18, g, height), (0.2, g + 0.012, height + 0.005)) for g in np.arange(-y + 0.68, y - 0.05, 0.045)]
    fronts = finish("metal" if rng.random() < 0.4 else "paint", "grey", rng)
    fixture = tap(-x + 0.06, -y + 0.35, height, 0.2, 0.3)
    return [fronts(body, *walls), fittings(rng)(handles), steel(basin, *ridges), bright(fixture)]
