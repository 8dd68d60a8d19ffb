"""Kitchens and bathrooms; lamps, rugs, paintings, vases and potted plants.

A white sink is for a bathroom, on a pedestal or a small cabinet; a grey one is a kitchen unit with a steel top. The
part below the basin belongs to the sink and has its colour.

Point lights are placed a little outside their shades (above that of a floor lamp, below that of a ceiling lamp).
Inside, the shade would block their light; close to it, half of the room would lie in its shadow.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.apartment.furniture.joinery import add_drawers, facing, fittings, front, leaning, polar, pull
from eagor.lab.worlds.apartment.mesh import Mesh, Part, Triple, bevelled, box, cylinder, finish, lathe, moved, tube
from eagor.lab.worlds.apartment.textures import material
from eagor.lab.worlds.scene import Lamp
from eagor.sphere import rotation

Grown = tuple[list[Mesh], Mesh]  # stems and leaves

_POTS = ("white", "grey", "black", "orange", "brown", "beige", "blue", "red", "yellow")
_SPREAD = 0.48  # metres from the middle that leaves may reach
_WARM = np.array([1.0, 0.9, 0.76])  # linear light of a lamp of about 3500 K, its red at 1
# Outlines of vases: shares of their radius and of their height.
_VASES = (
    ((0, 0), (0.6, 0), (1, 0.3), (0.9, 0.55), (0.4, 0.85), (0.5, 1)),
    ((0, 0), (0.5, 0), (0.6, 0.1), (1, 0.65), (0.8, 0.85), (0.55, 0.92), (0.6, 1)),
    ((0, 0), (0.75, 0), (0.8, 0.5), (1, 1)),
)
_BLOOMS = ("red", "pink", "yellow", "white", "purple", "orange")

# --- kitchens and bathrooms -------------------------------------------------------------------------------------------


def base_units(x: float, y: float, top: float, rng: np.random.Generator, framed: bool) -> tuple[list[Mesh], list[Mesh]]:
    """Kitchen base units over [-x, x] x [-y, y] up to `top`, and their handles; doors and blocks of drawers."""
    body = [box((-x, -y, 0.1), (x - 0.02, y, top), 2), box((-x, -y, 0), (x - 0.08, y, 0.1), 1)]
    handles: list[Mesh] = []
    for k, (y0, y1) in enumerate(pairwise(np.linspace(-y, y, max(1, round(2 * y / 0.52)) + 1))):
        if rng.random() < 0.3:
            add_drawers(body, handles, x - 0.02, y0, y1, [0.105, 0.4 * top, 0.72 * top, top - 0.005])
        else:
            body.append(front(x - 0.02, y0 + 0.003, y1 - 0.003, 0.108, top - 0.008, framed))
            handles.append(pull(x, y1 - 0.05 if k % 2 == 0 else y0 + 0.05, top - 0.16, 0.16, upright=True))
    return body, handles


def cabinet(colour: str, rng: np.random.Generator) -> list[Part]:
    """Kitchen base units under one worktop of stone, wood or dark laminate, with a few jars on it."""
    width, top = rng.uniform(1.0, 2.2), rng.uniform(0.84, 0.88)
    x, y = 0.29, width / 2
    body, handles = base_units(x, y, top, rng, framed=rng.random() < 0.4)
    kind, tone = (("marble", None), ("wood", None), ("marble", "grey"), ("paint", "black"))[rng.integers(4)]
    worktop = bevelled((-x, -y, top), (x + 0.02, y, top + 0.04), 0.006, grain=1)
    cover = finish("wood" if colour == "brown" else "paint", colour, rng)
    parts = [cover(*body), fittings(rng)(*handles), finish(kind, tone, rng)(worktop)]
    if rng.random() < 0.7:
        at, count = rng.uniform(-y + 0.1, y - 0.5), int(rng.integers(2, 4))
        jars = [cylinder((-x + 0.12, at + 0.13 * k, top + 0.04), 0.05, 0.18 - 0.03 * k, 12) for k in range(count)]
        parts.append(finish("ceramic", str(rng.choice(["white", "red", "beige", "green"])), rng)(*jars))
    return parts


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


def tap(x: float, y: float, z: float, reach: float, height: float) -> list[Mesh]:
    """A tap that stands at (x, y, z) and reaches towards +x, with a lever."""
    bow = [(x, y, z), (x, y, z + height), (x + 0.9 * reach, y, z + height), (x + reach, y, z + 0.72 * height)]
    lever = tube([(x, y + 0.01, z + 0.4 * height), (x, y + 0.06, z + 0.5 * height)], 0.007, 6)
    return [tube(bow, 0.012, 8), lever, cylinder((x, y, z), 0.024, 0.02, 10)]


def trough(low: Triple, high: Triple, outer: Triple, deep: float) -> list[Mesh]:
    """A basin: the hollow from `low` to `high` (x, y), `deep` below the top of its rim, which reaches to `outer`.

    `outer`: x0, y0, x1, y1 and z of the rim, which is 3 cm thick.
    """
    (a, b), (c, d), (x0, y0, x1, y1, z), t = low, high, outer, 0.015
    rim = [((x0, y0), (x1, b)), ((x0, d), (x1, y1)), ((x0, b), (a, d)), ((c, b), (x1, d))]
    walls = [((a - t, b - t), (c + t, b)), ((a - t, d), (c + t, d + t)), ((a - t, b), (a, d)), ((c, b), (c + t, d))]
    return [
        *(box((*p, z - 0.03), (*q, z)) for p, q in rim),
        *(box((*p, z - deep), (*q, z - 0.03)) for p, q in walls),
        box((a - t, b - t, z - deep - t), (c + t, d + t, z - deep)),
    ]


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
        return [glaze(bowl, column, ledge), metal(*tap(-0.9 * r, 0, height, 0.13, 0.11))]
    wood, x, y = finish("paint", colour, rng), 0.235, rng.uniform(0.3, 0.45)
    low, half = height - 0.05, min(0.24, y - 0.06)
    body = [
        box((-x + 0.01, -y + 0.01, 0.12), (x - 0.03, y - 0.01, low - 0.1), 2),
        box((-x + 0.03, -y + 0.03, 0), (x - 0.09, y - 0.03, 0.12), 1),
        *(box((-x + 0.01, s - 0.008, low - 0.1), (x - 0.03, s + 0.008, low), 2) for s in (-y + 0.018, y - 0.018)),
        *(front(x - 0.03, a, b, 0.125, low - 0.003) for a, b in ((-y + 0.012, -0.002), (0.002, y - 0.012))),
    ]
    basin = trough((-0.11, -half), (0.17, half), (-x, -y, x, y, height), 0.11)
    handles = [pull(x - 0.012, s, low - 0.14, 0.12, upright=True) for s in (-0.04, 0.04)]
    return [wood(*body), glaze(*basin), metal(*tap(-x + 0.06, 0, height, 0.14, 0.14), *handles)]


def _kitchen_sink(rng: np.random.Generator) -> list[Part]:
    """Base units under a steel top with a basin, a drainer and a tall tap."""
    steel, bright = finish("metal", "grey", rng), finish("metal", None, rng)
    x, y, height = 0.29, rng.uniform(0.5, 0.8), rng.uniform(0.88, 0.92)
    top = height - 0.03
    body, handles = base_units(x, y, top - 0.17, rng, framed=False)
    body += [box((-x, s - 0.009, top - 0.17), (x - 0.02, s + 0.009, top), 2) for s in (-y + 0.009, y - 0.009)]
    body.append(box((x - 0.04, -y, top - 0.175), (x, y, top), 1))
    basin = trough((-0.17, -y + 0.1), (0.21, -y + 0.6), (-x - 0.02, -y, x + 0.02, y, height), 0.16)
    ridges = [box((-0.18, g, height), (0.2, g + 0.012, height + 0.005)) for g in np.arange(-y + 0.68, y - 0.05, 0.045)]
    fronts = finish("metal" if rng.random() < 0.4 else "paint", "grey", rng)
    fixture = tap(-x + 0.06, -y + 0.35, height, 0.2, 0.3)
    return [fronts(*body), fittings(rng)(*handles), steel(*basin, *ridges), bright(*fixture)]


def toilet(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bowl on its foot, a seat, a lid that is up or down, and a cistern at the wall."""
    glaze, seat, metal = finish("ceramic", colour, rng), finish("plastic", colour, rng), finish("metal", None, rng)
    r, height = rng.uniform(0.175, 0.19), rng.uniform(0.39, 0.42)
    oval, top, rear = (1.25, 1.0), height + 0.022, -1.25 * r
    bowl = lathe(
        [(0, 0), (0.11, 0), (0.095, 0.17), (0.15, 0.3), (r, height - 0.03), (r, height), (0.72 * r, height),
         (0.55 * r, height - 0.1), (0.2 * r, height - 0.19), (0, height - 0.19)], 20, oval,
    )  # fmt: skip
    ring = lathe([(1.03 * r, height), (1.03 * r, top), (0.66 * r, top), (0.66 * r, height)], 20, oval)
    water = lathe([(0.36 * r, height - 0.16), (0, height - 0.16)], 16, oval)
    lid = lathe([(0, 0), (1.03 * r, 0), (1.03 * r, 0.016), (0, 0.016)], 20, oval)
    if rng.random() < 0.65:
        lid = moved(leaning(moved(lid, (-rear, 0, 0)), math.radians(88)), (rear + 0.02, 0, top))
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
        tub = [lathe([(x * r, z) for r, z in profile], 32, (1.0, y / x))]
    else:
        tub = trough((-x + 0.07, -y + 0.08), (x - 0.07, y - 0.08), (-x, -y, x, y, height), 0.42)
        sides = (-x, -y, x, 0.02 - y), (-x, y - 0.02, x, y), (-x, -y, 0.02 - x, y), (x - 0.02, -y, x, y)
        tub += [box((x0, y0, 0), (x1, y1, height - 0.03)) for x0, y0, x1, y1 in sides]
    spout = m.turned(m.merged(*tap(0, 0, 0, 0.15, 0.16)), rotation([0, 0, 1], -np.pi / 2))
    drain = cylinder((0, 0.6 * y, floor), 0.026, 0.004, 10)
    valves = [cylinder((s, end, height), 0.02, 0.05, 8) for s in (-0.09, 0.09)]
    return [glaze(*tub), metal(moved(spout, (0, end, height)), drain, *valves)]


# --- plants and vases -------------------------------------------------------------------------------------------------


def foliage(
    base: np.ndarray, azimuth: np.ndarray, pitch: np.ndarray, length: np.ndarray, width: np.ndarray, bend: float, *,
    steps: int = 4, fold: float = 0.2, blunt: float = 0.8,
) -> Mesh:  # fmt: skip
    """Leaves as bent strips, all at once; 4 * steps - 4 triangles each. Metres and radians, ``(n,)`` each.

    `base` ``(n, 3)``: points of attachment; `azimuth`: direction; `pitch`: slope at the base, which falls by `bend`
    towards the tip; `width` at the widest place, which is nearer to the base for `blunt` below 1; `steps`: pieces along
    the midrib; `fold`: height of the edges above it, in half widths.
    """
    t = np.linspace(0, 1, steps + 1)
    slope = pitch[:, None] - bend * (t[:-1] + t[1:]) / 2
    out, up = (
        np.pad(np.cumsum(share * (length[:, None] / steps), axis=1), ((0, 0), (1, 0)))
        for share in (np.cos(slope), np.sin(slope))
    )
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    rib = base[:, None] + np.stack([c * out, s * out, up], axis=-1)
    half = 0.5 * width[:, None] * np.sin(np.pi * np.clip(t, 0.02, 0.985) ** blunt)
    half[:, [0, -1]] = 0.0  # the ends are points
    tilt = pitch[:, None] - bend * t
    lift = np.stack([-c * np.sin(tilt), -s * np.sin(tilt), np.cos(tilt)], axis=-1) * fold
    side = np.stack([-s, c, 0 * s], axis=-1)
    points = rib[:, :, None] + half[..., None, None] * np.stack([lift - side, 0 * lift, lift + side], axis=2)
    index = np.arange(3 * (steps + 1)).reshape(steps + 1, 3)  # right, rib, left
    a, b, d, e = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([np.stack([a, d, e], -1), np.stack([a, e, b], -1)], axis=2).reshape(-1, 3)
    first, last = triangles < 3, triangles >= 3 * steps  # corners at the ends
    flat = (first.sum(axis=1) > 1) | (last.sum(axis=1) > 1)
    uv = np.stack(np.broadcast_arrays(t[:, None], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)[triangles]
    uv[..., 1] = np.where(first | last, 0.5, uv[..., 1])
    places = (np.arange(len(base)) * index.size)[:, None, None] + triangles[~flat]
    return Mesh(
        points.reshape(-1, 3).astype(np.float32),
        places.reshape(-1, 3).astype(np.int32),
        np.tile(uv[~flat], (len(base), 1, 1)).astype(np.float32),
    )


def _around(n: int, rng: np.random.Generator) -> np.ndarray:
    """Directions at multiples of the golden angle, as leaves grow, with some disorder."""
    return rng.uniform(0, 6.3) + np.arange(n) * 2.39996 + rng.normal(0, 0.2, n)


def _broad(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Stalks that rise from the earth, each with one large leaf."""
    n = int(rng.integers(15, 22))
    azimuth, share = _around(n, rng), np.linspace(0.35, 1, n) ** 0.8
    lean = 0.75 - 0.55 * share + rng.normal(0, 0.06, n)
    reach = share * (tall - top) * 0.78
    tips = polar(reach * np.sin(lean), azimuth, top + reach * np.cos(lean))
    stalks = [tube([polar(0.02, a, top - 0.02), tip], [0.008, 0.005], 3) for a, tip in zip(azimuth, tips, strict=True)]
    length, pitch = rng.uniform(0.2, 0.3, n) * (0.7 + 0.3 * tall), rng.uniform(-0.1, 0.5, n)
    return stalks, foliage(tips, azimuth, pitch, length, 0.62 * length, 0.9, steps=5, fold=0.15, blunt=0.75)


def _swords(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Stiff upright leaves in a cluster."""
    n = int(rng.integers(16, 24))
    azimuth, away = _around(n, rng), 0.09 * np.sqrt(np.arange(n) / n)
    base = polar(away, azimuth, top - 0.02)
    length, pitch = (tall - top) * rng.uniform(0.6, 1.0, n), 1.5 - 3.2 * away + rng.normal(0, 0.04, n)
    return [], foliage(base, azimuth, pitch, length, rng.uniform(0.055, 0.08, n), 0.08, steps=5, fold=0.5, blunt=0.6)


def _palm(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Long leaves that rise from a short trunk and arch outwards."""
    n = int(rng.integers(22, 30))
    azimuth, share = _around(n, rng), np.arange(n) / n
    base = polar(0.02, azimuth, top + 0.25 * (tall - top) * share)
    length, width = (tall - top) * rng.uniform(0.75, 1.0, n), rng.uniform(0.06, 0.09, n)
    leaves = foliage(base, azimuth, 1.45 - 0.6 * (1 - share), length, width, 1.3, steps=6, fold=0.3, blunt=0.6)
    return [tube([(0, 0, top - 0.02), (0, 0, top + 0.27 * (tall - top))], [0.03, 0.02], 6)], leaves


def _tree(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """A slim trunk that forks, under a round crown of small leaves."""
    crown = rng.uniform(0.24, 0.34)
    centre = np.array([rng.normal(0, 0.03), rng.normal(0, 0.03), tall - crown])
    fork = np.array([centre[0] * 0.5, centre[1] * 0.5, top + 0.55 * (centre[2] - crown * 0.3 - top)])
    limbs = [tube([(0, 0, top - 0.02), fork], [0.02, 0.015], 6)]
    limbs += [tube([fork, end], [0.011, 0.005], 4) for end in centre + 0.55 * crown * polar(1.0, _around(4, rng), 0.2)]
    n = 110
    height, azimuth = rng.uniform(-0.85, 1, n), _around(n, rng)
    radius = crown * rng.uniform(0.55, 0.95, n)
    base = centre + radius[:, None] * polar(np.sqrt(1 - height**2), azimuth, 0.95 * height)
    length = rng.uniform(0.12, 0.19, n)
    return limbs, foliage(base, azimuth + rng.normal(0, 0.5, n), 0.9 * height, length, 0.55 * length, 0.8, steps=3)


# What grows; its range of height in metres; the radius of its pot; the material of its stems.
_GROWTHS = (
    (_broad, 0.7, 1.25, 0.16, "paint"), (_palm, 1.1, 1.7, 0.17, "wood"), (_swords, 0.65, 1.1, 0.14, "paint"),
    (_tree, 1.2, 1.8, 0.16, "wood"),
)  # fmt: skip
# Outlines of pots: shares of the radius at the foot, the middle, four fifths of the height, and the top.
_OUTLINES = ((0.68, 0.8, 1.0, 1.0), (0.9, 0.92, 0.92, 0.92), (0.55, 1.0, 0.92, 0.8), (0.78, 1.0, 0.95, 0.88))


def plant(colour: str, rng: np.random.Generator) -> list[Part]:
    """A plant in a pot with earth in it; `colour` is that of its leaves."""
    grow, least, most, radius, woody = _GROWTHS[rng.integers(len(_GROWTHS))]
    tall, r = rng.uniform(least, most), radius * rng.uniform(0.9, 1.2)
    h, design = r * rng.uniform(1.15, 1.6), int(rng.integers(4))
    outline = [(share * r, z * h) for share, z in zip(_OUTLINES[design], (0, 0.5, 0.82, 1), strict=True)]
    mouth, top = outline[-1][0], 0.88 * h
    pot = lathe([(0.0, 0.0), *outline, (mouth - 0.015, h), (mouth - 0.02, 0.85 * h)], 14)
    cover = finish("wicker", None, rng) if design == 3 else finish("ceramic", str(rng.choice(_POTS)), rng)
    earth = lathe([(mouth - 0.012, top), (0, top + 0.01)], 12)
    parts = [cover(pot), finish("earth", None, rng)(earth)]
    stems, leaves = grow(top, tall, rng)
    # It stands in a corner: pulled in, as if pruned.
    shrink = min(1.0, _SPREAD / float(np.abs(leaves.vertices[:, :2]).max()))
    leaves = replace(leaves, vertices=leaves.vertices * np.array([shrink, shrink, 1], np.float32))
    parts.append(finish("leaf", colour, rng)(leaves))
    if stems:
        parts.append(finish(woody, "brown" if woody == "wood" else colour, rng)(*stems))
    return parts


def vase(colour: str, rng: np.random.Generator) -> list[Part]:
    """A glazed vase, empty or with flowers."""
    tall, r = rng.uniform(0.16, 0.3), rng.uniform(0.05, 0.085)
    profile = [(a * r, b * tall) for a, b in _VASES[rng.integers(3)]]
    mouth = profile[-1][0]
    parts = [finish("ceramic", colour, rng)(lathe([*profile, (0.9 * mouth, tall), (0.7 * mouth, 0.75 * tall)], 16))]
    if rng.random() >= 0.65:
        return parts
    n = int(rng.integers(7, 12))
    azimuth, lean = rng.uniform(0, 6.3) + np.arange(n) * 2.4, rng.uniform(0.05, 0.5, n)
    foot, reach = np.array([0, 0, 0.75 * tall]), rng.uniform(0.2, 0.32, n)
    heads = foot + polar(reach * np.sin(lean), azimuth, reach * np.cos(lean))
    size = rng.uniform(0.07, 0.11, n)
    leaves = foliage(foot + 0.65 * (heads - foot), azimuth + 0.8, 1.2 - lean, size, 0.35 * size, 0.9, steps=3)
    stalks = [tube([foot, head], 0.0025, 3) for head in heads]
    parts += [finish("paint", "green", rng)(*stalks), finish("leaf", "green", rng)(leaves)]
    if rng.random() < 0.7:
        blooms = [m.cushion(head - 0.022, head + 0.022, 2.0) for head in heads[:6]]
        parts.append(finish("paint", str(rng.choice(_BLOOMS)), rng)(*blooms))
    return parts


# --- lamps, rugs and paintings ----------------------------------------------------------------------------------------


def _shade(profile: list[tuple[float, float]], colour: str, rng: np.random.Generator, lift: float) -> Part:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    mesh = lathe(profile, 18)
    place = mesh.vertices[mesh.triangles]
    u = np.arctan2(place[..., 1], place[..., 0]) / (2 * np.pi)
    u = np.where(np.ptp(u, axis=1, keepdims=True) > 0.5, u % 1, u)  # triangles across the seam
    v = (place[..., 2] - mesh.low[2]) / np.ptp(mesh.vertices[:, 2])
    mesh = replace(mesh, uv=np.stack([u, v], axis=-1).astype(np.float32))
    return m.part(moved(mesh, (0, 0, lift)), material("lampshade", colour, rng))


def lamp(colour: str, rng: np.random.Generator) -> list[Part | Lamp]:
    """A floor lamp: a shade on a pole or on a tripod; `colour` is that of the shade."""
    metal, height, radius = fittings(rng), rng.uniform(1.45, 1.7), rng.uniform(0.18, 0.24)
    tall, taper = rng.uniform(0.22, 0.32), rng.uniform(0.6, 1.0)
    low = height - tall
    if rng.random() < 0.6:
        foot = lathe([(0, 0), (0.15, 0), (0.14, 0.02), (0.03, 0.03), (0.012, 0.06)], 18)
        stand = [metal(foot, tube([(0, 0, 0.03), (0, 0, low + 0.1)], 0.012, 8))]
    else:
        angles = rng.uniform(0, 2) + np.arange(3) * 2 * math.pi / 3
        legs = [tube([polar(0.26, a, 0.0), polar(0.02, a, low)], [0.011, 0.016], 6) for a in angles]
        stand = [finish("wood", None, rng)(*legs), metal(cylinder((0, 0, low - 0.03), 0.04, 0.05, 10))]
    shade = _shade([(radius, 0), (taper * radius, tall)], colour, rng, low)
    return [*stand, shade, Lamp(np.array([0.0, 0.0, low + tall + 0.25]), 0.35 * _WARM)]


def ceiling_lamp(colour: str, rng: np.random.Generator) -> list[Part | Lamp]:
    """A pendant with a paper globe, a drum or a metal bell, or a flat dome; white light over a room."""
    metal, drop = finish("metal", "black" if colour == "black" else None, rng), rng.uniform(0.3, 0.5)
    power, radius = float(rng.uniform(1.5, 1.7)) * _WARM, rng.uniform(0.17, 0.24)
    globe = [(radius * math.sin(t), -radius * math.cos(t)) for t in np.linspace(0, math.pi, 11)]
    globe[0], globe[-1] = (0.0, -radius), (0.0, radius)
    if colour == "white" and rng.random() < 0.5:  # a dome
        body = metal(cylinder((0, 0, -0.025), radius + 0.012, 0.025, 20))
        made = [body, _shade([(r, 0.4 * z) for r, z in globe[:6]], "white", rng, -0.02)]
        z = -0.4 * radius - 0.27
        return [*made, Lamp(np.array([0.0, 0.0, z]), power)]
    cord = metal(tube([(0, 0, -drop), (0, 0, -0.03)], 0.004, 4), cylinder((0, 0, -0.03), 0.05, 0.03, 12))
    if colour in ("black", "grey"):  # a metal bell, its bulb seen from below
        tall = rng.uniform(0.14, 0.2)
        flare = [(radius, -tall), (0.9 * radius, -0.6 * tall), (0.45 * radius, -0.1 * tall), (0.03, 0), (0, 0)]
        shell = finish("metal" if colour == "grey" else "paint", colour, rng)
        bulb = _shade([(0.22 * r, 0.22 * z) for r, z in globe], "white", rng, -drop - 0.75 * tall)
        inside = _shade([(0.97 * radius, -0.93 * tall), (0.2 * radius, -0.2 * tall)], "white", rng, -drop)
        made, z = [shell(moved(lathe(flare, 18), (0, 0, -drop))), bulb, inside], -drop - tall - 0.25
    elif rng.random() < 0.5:
        made, z = [_shade(globe, colour, rng, -drop - radius)], -drop - 2 * radius - 0.2
    else:
        tall = rng.uniform(0.16, 0.24)  # a drum, closed below
        low = -drop - 0.6 * tall
        made, z = [_shade([(0, 0), (radius, 0.01), (radius, tall)], colour, rng, low)], low - 0.2
    return [cord, *made, Lamp(np.array([0.0, 0.0, z]), power)]


def rug(colour: str, rng: np.random.Generator) -> list[Part]:
    """A flat rug, rectangular with a pattern, its length along y, or round with a border."""
    thick = 0.008
    if rng.random() < 0.2:
        r = rng.uniform(0.65, 1.0)
        pile, border = finish("carpet", colour, rng), finish("carpet", "white" if colour == "beige" else "beige", rng)
        ring = lathe([(r, 0), (r, thick), (0.86 * r, thick)], 32)
        return [pile(lathe([(0.86 * r, thick), (0, thick)], 32)), border(ring)]
    long = rng.uniform(1.4, 2.4)
    short = long * rng.uniform(0.62, 0.75)
    x, y = short / 2, long / 2
    top = m.quad([(x, -y, thick), (x, y, thick), (-x, y, thick), (-x, -y, thick)])
    pattern = m.part(top, material("rug", colour, rng), (long, short))
    return [pattern, finish("carpet", colour, rng)(box((-x, -y, 0), (x, y, thick - 0.001)))]


def painting(colour: str, rng: np.random.Generator) -> list[Part]:
    """A picture in a frame, with or without a mount, or on bare canvas; `colour` dominates in it."""
    look, face = material("art", colour, rng), 0.022
    assert look.texture is not None
    rows, columns = look.texture.shape[:2]
    scale = math.sqrt(rng.uniform(0.16, 0.7) / (rows * columns))
    y, z = columns * scale / 2, rows * scale / 2
    picture = m.quad([(face, -y, -z), (face, y, -z), (face, y, z), (face, -y, z)])
    parts = [m.part(picture, look, (2 * y, 2 * z))]
    design = rng.integers(5)
    if design == 0:  # canvas over its stretcher
        return [*parts, finish("fabric", "beige", rng)(box((0, -y, -z), (face - 0.0015, y, z)))]
    if design < 3:  # a mount of white card
        mount = rng.uniform(0.05, 0.09)
        parts.append(finish("paint", "white", rng)(*_border(y, z, mount, face)))
        y, z = y + mount, z + mount
    bar, deep = rng.uniform(0.018, 0.045), rng.uniform(0.024, 0.04)
    frames = (("wood", None), ("paint", "black"), ("paint", "white"), ("wood", "brown"), ("metal", "yellow"))
    return [*parts, finish(*frames[rng.integers(5)], rng)(*_border(y, z, bar, face + 0.3 * deep))]


def _border(y: float, z: float, width: float, depth: float) -> list[Mesh]:
    """Four bars, `depth` deep, round the rectangle with half sides `y`, `z` in the wall's plane."""
    return [
        box((0.0, -y - width, z), (depth, y + width, z + width), 1),
        box((0.0, -y - width, -z - width), (depth, y + width, -z), 1),
        box((0.0, -y - width, -z), (depth, -y, z), 2),
        box((0.0, y, -z), (depth, y + width, z), 2),
    ]
