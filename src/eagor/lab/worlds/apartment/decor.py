"""Kitchens and bathrooms; lamps, rugs, paintings, vases and potted plants.

Point lights are placed a little outside their shades (above that of a floor lamp, below that of a ceiling lamp).
Inside, the shade would block their light; close to it, half of the room would lie in its shadow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.apartment.textures import material
from eagor.lab.worlds.scene import Lamp

_POTS = ("white", "grey", "black", "orange", "brown", "beige", "blue", "red", "yellow")
_SPREAD = 0.48  # metres from the middle that leaves may reach
_WARM = np.array([1.0, 0.9, 0.76])  # linear light of a lamp of about 3500 K, its red at 1
# Outlines of vases and pots: shares of their radius and of their height.
_VASES = (
    ((0, 0), (0.6, 0), (1, 0.3), (0.9, 0.55), (0.4, 0.85), (0.5, 1)),
    ((0, 0), (0.5, 0), (0.6, 0.1), (1, 0.65), (0.8, 0.85), (0.55, 0.92), (0.6, 1)),
    ((0, 0), (0.75, 0), (0.8, 0.5), (1, 1)),
)
_OUTLINES = (
    ((0, 0), (0.68, 0), (0.8, 0.5), (1, 0.82), (1, 1)), ((0, 0), (0.9, 0), (0.92, 0.5), (0.92, 1)),
    ((0, 0), (0.55, 0), (1, 0.5), (0.92, 0.82), (0.85, 1)),
)  # fmt: skip

# --- kitchens and bathrooms -------------------------------------------------------------------------------------------


def base_units(x: float, y: float, top: float, rng: np.random.Generator) -> tuple[list[m.Mesh], list[m.Mesh]]:
    """Kitchen base units over [-x, x] x [-y, y] up to `top`, and their handles; doors and blocks of drawers."""
    body = [m.box((-x, -y, 0.1), (x - 0.02, y, top), 2), m.box((-x, -y, 0), (x - 0.08, y, 0.1), 1)]
    handles: list[m.Mesh] = []
    for k, (y0, y1) in enumerate(pairwise(np.linspace(-y, y, max(1, round(2 * y / 0.52)) + 1))):
        if rng.random() < 0.3:
            fronts, pulls = m.drawers(x - 0.02, (y0, y1), [0.105, 0.4 * top, 0.72 * top, top - 0.005])
            body, handles = body + fronts, handles + pulls
        else:
            body.append(m.front(x - 0.02, y0 + 0.003, y1 - 0.003, 0.108, top - 0.008))
            handles.append(m.pull(x, y1 - 0.05 if k % 2 == 0 else y0 + 0.05, top - 0.16, 0.16, upright=True))
    return body, handles


def cabinet(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """Kitchen base units under one worktop of stone, wood or dark laminate, with a few jars on it."""
    x, y, top = 0.29, rng.uniform(0.5, 1.1), rng.uniform(0.84, 0.88)
    body, handles = base_units(x, y, top, rng)
    kind, tone = (("marble", None), ("wood", None), ("marble", "grey"), ("paint", "black"))[rng.integers(4)]
    worktop = m.bevelled((-x, -y, top), (x + 0.02, y, top + 0.04), 0.006, grain=1)
    cover = m.finish("wood" if colour == "brown" else "paint", colour, rng)
    at, count = rng.uniform(-y + 0.1, y - 0.4), int(rng.integers(1, 4))
    jars = [m.cylinder((-x + 0.12, at + 0.13 * k, top + 0.04), 0.05, 0.18 - 0.03 * k, 12) for k in range(count)]
    glaze = m.finish("ceramic", str(rng.choice(["white", "red", "beige", "green"])), rng)
    return [cover(*body), m.fittings(rng)(*handles), m.finish(kind, tone, rng)(worktop), glaze(*jars)]


def refrigerator(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """Freezer above or below, with long handles."""
    shell, metal = m.finish("metal" if colour == "grey" else "plastic", colour, rng), m.finish("metal", "grey", rng)
    x, y, height = rng.uniform(0.31, 0.35), rng.uniform(0.28, 0.4), rng.uniform(1.5, 1.9)
    cut, side = height * rng.choice([0.35, 0.7]), (y - 0.05) * rng.choice([-1, 1])
    doors = [m.bevelled((x - 0.065, -y, a), (x, y, b), 0.02) for a, b in ((0.06, cut - 0.004), (cut + 0.004, height))]
    bars = [m.pull(x, side, cut + z, 0.3, upright=True) for z in (-0.24, 0.24)]
    seal = m.finish("plastic", "black" if colour != "black" else "grey", rng)
    dark = m.box((x - 0.08, -y + 0.012, 0.02), (x - 0.065, y - 0.012, height - 0.008))
    return [shell(m.box((-x, -y, 0), (x - 0.08, y, height)), *doors), seal(dark), metal(*bars)]


def stove(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """Four plates over an oven with a window, a handle and a row of knobs."""
    shell, metal = m.finish("metal" if colour == "grey" else "plastic", colour, rng), m.finish("metal", None, rng)
    x, y, height = 0.3, rng.uniform(0.29, 0.33), rng.uniform(0.86, 0.92)
    top = height - 0.16
    body = [m.box((-x, -y, 0), (x - 0.03, y, height - 0.012))]
    for low, high in ((0.24, top), (0.085, 0.232)):  # the doors of the oven and of a drawer below it
        body.append(m.bevelled((x - 0.03, -y + 0.004, low), (x, y - 0.004, high), 0.008))
    body.append(m.box((x - 0.03, -y, top + 0.008), (x - 0.006, y, height - 0.012)))
    window = m.box((x - 0.01, -y + 0.09, 0.34), (x + 0.002, y - 0.09, top - 0.12))
    dark = window, m.box((-x, -y, height - 0.012), (x, y, height))
    knobs = [m.tube([(x - 0.006, at, height - 0.075), (x + 0.024, at, height - 0.075)], 0.021, 10)
             for at in np.linspace(-y + 0.09, y - 0.09, 5)]  # fmt: skip
    rings = [m.cylinder((px, py, height), 0.09, 0.006) for px in (-0.13, 0.13) for py in (-0.14, 0.14)]
    plates = m.finish("metal", "grey", rng)
    handle = m.pull(x, 0, top - 0.055, 2 * y - 0.1)
    return [shell(*body), m.finish("plastic", "black", rng)(*dark), plates(*rings), metal(*knobs, handle)]


def tap(x: float, y: float, z: float, reach: float, height: float) -> list[m.Mesh]:
    """A tap that stands at (x, y, z) and reaches towards +x."""
    bow = [(x, y, z), (x, y, z + height), (x + reach, y, z + height), (x + reach, y, z + 0.75 * height)]
    return [m.tube(bow, 0.012, 8), m.cylinder((x, y, z), 0.024, 0.02, 10)]


def trough(low: m.Numbers, high: m.Numbers, outer: m.Numbers, deep: float) -> list[m.Mesh]:
    """A basin: the hollow from `low` to `high` (x, y), `deep` below its rim, which is `outer` (x0, y0, x1, y1, z)."""
    (a, b), (c, d), (*rim, z), t = low, high, outer, 0.015
    walls, basin = (a - t, b - t, c + t, d + t), []
    for (x0, y0, x1, y1), bottom, top in ((rim, z - 0.03, z), (walls, z - deep, z - 0.03)):
        sides = ((x0, y0), (x1, b)), ((x0, d), (x1, y1)), ((x0, b), (a, d)), ((c, b), (x1, d))
        basin += [m.box((*p, bottom), (*q, top)) for p, q in sides]
    return [*basin, m.box((*walls[:2], z - deep - t), (*walls[2:], z - deep))]


def sink(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A sink: white for the bathroom, on a pedestal; grey for the kitchen, with a steel top on units of its own."""
    metal, z = m.finish("metal", None, rng), rng.uniform(0.84, 0.9)
    if colour == "grey":
        x, y = 0.29, rng.uniform(0.5, 0.8)
        body, handles = base_units(x, y, z - 0.2, rng)
        body += [m.box((-x, s - 0.009, z - 0.2), (x - 0.02, s + 0.009, z - 0.03), 2) for s in (-y + 0.009, y - 0.009)]
        body.append(m.box((x - 0.04, -y, z - 0.205), (x, y, z - 0.03), 1))
        basin = trough((-0.17, -y + 0.1), (0.21, -y + 0.6), (-x - 0.02, -y, x + 0.02, y, z), 0.16)
        steel, cover = m.finish("metal", "grey", rng), m.finish("metal" if rng.random() < 0.4 else "paint", "grey", rng)
        return [cover(*body), m.fittings(rng)(*handles), steel(*basin), metal(*tap(-x + 0.06, 0.35 - y, z, 0.2, 0.3))]
    r = rng.uniform(0.21, 0.24)
    bowl = m.lathe(
        [(0.3 * r, z - 0.2), (0.8 * r, z - 0.14), (r, z - 0.06), (r, z), (0.85 * r, z), (0.7 * r, z - 0.08),
         (0.3 * r, z - 0.13), (0, z - 0.13)], 24, (1.0, 1.3),
    )  # fmt: skip
    column = m.lathe([(0.1, 0), (0.1, 0.02), (0.07, 0.12), (0.065, 0.5), (0.1, z - 0.17)], 16)
    ledge = m.bevelled((-1.1 * r, -0.6 * r, z - 0.06), (-0.75 * r, 0.6 * r, z + 0.005), 0.01)
    return [m.finish("ceramic", colour, rng)(bowl, column, ledge), metal(*tap(-0.9 * r, 0, z, 0.13, 0.11))]


def toilet(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A bowl on its foot, a seat, a lid that is up or down, and a cistern at the wall."""
    r, z = rng.uniform(0.175, 0.19), rng.uniform(0.39, 0.42)
    tall, half = rng.uniform(0.74, 0.82), rng.uniform(0.18, 0.22)
    oval, top, rear = (1.25, 1.0), z + 0.022, -1.25 * r
    bowl = m.lathe(
        [(0, 0), (0.11, 0), (0.095, 0.17), (0.15, 0.3), (r, z - 0.03), (r, z), (0.72 * r, z), (0.55 * r, z - 0.1),
         (0.2 * r, z - 0.19), (0, z - 0.19)], 20, oval,
    )  # fmt: skip
    ring = m.lathe([(1.03 * r, z), (1.03 * r, top), (0.66 * r, top), (0.66 * r, z)], 20, oval)
    lid = m.lathe([(0, 0), (1.03 * r, 0), (1.03 * r, 0.016), (0, 0.016)], 20, oval)
    up = rng.random() < 0.65
    lid = m.leaning(m.moved(lid, (-rear, 0, 0)), math.radians(88)) if up else lid
    lid, back = m.moved(lid, (rear + 0.02 if up else 0, 0, top)), rear - 0.21
    boxes = (
        ((back, -half, z - 0.02), (back + 0.18, half, tall)), ((back + 0.01, -0.1, 0.0), (-0.1, 0.1, z - 0.01)),
        ((back + 0.01, -0.15, z - 0.1), (rear + 0.1, 0.15, z)),
    )  # fmt: skip
    cistern = [m.bevelled(*box, 0.03) for box in boxes]
    button = m.finish("metal", None, rng)(m.cylinder((back + 0.09, 0, tall), 0.022, 0.008, 12))
    return [m.finish("ceramic", colour, rng)(bowl, *cistern), m.finish("plastic", colour, rng)(ring, lid), button]


def bathtub(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A tub with panelled sides; its length along y, the tap at one end."""
    x, y, height = rng.uniform(0.36, 0.41), rng.uniform(0.78, 0.88), rng.uniform(0.54, 0.6)
    tub = trough((-x + 0.07, -y + 0.08), (x - 0.07, y - 0.08), (-x, -y, x, y, height), 0.42)
    sides = (-x, -y, x, 0.02 - y), (-x, y - 0.02, x, y), (-x, -y, 0.02 - x, y), (x - 0.02, -y, x, y)
    tub += [m.box((x0, y0, 0), (x1, y1, height - 0.03)) for x0, y0, x1, y1 in sides]
    spout = m.merged(*m.placed(tap(0, 0, 0, 0.15, 0.16), -math.pi / 2, (0, 0, 0)))
    return [m.finish("ceramic", colour, rng)(*tub), m.finish("metal", None, rng)(m.moved(spout, (0, y - 0.04, height)))]


# --- plants and vases -------------------------------------------------------------------------------------------------


def foliage(
    base: np.ndarray, azimuth: np.ndarray, pitch: np.ndarray, length: np.ndarray, width: np.ndarray, bend: float,
    blunt: float = 0.8,
) -> m.Mesh:  # fmt: skip
    """Leaves as bent, folded strips of 16 triangles, from `base` ``(n, 3)`` in directions ``(n,)``: metres, radians.

    The `pitch` falls by `bend` towards the tip; the widest place is nearer to the base for `blunt` below 1.
    """
    t = np.linspace(0, 1, 5)
    slope = pitch[:, None] - bend * t
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    along = np.stack([c * np.cos(slope), s * np.cos(slope), np.sin(slope)], axis=-1)
    steps = (along[:, :-1] + along[:, 1:]) / 2 * (length[:, None, None] / 4)
    rib = base[:, None] + np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0), (0, 0)))
    half = 0.5 * width[:, None] * np.sin(np.pi * np.clip(t, 0.03, 0.97) ** blunt)
    lift = 0.25 * np.stack([-c * np.sin(slope), -s * np.sin(slope), np.cos(slope)], axis=-1)
    side = np.stack([-s, c, 0 * s], axis=-1)
    points = rib[:, :, None] + half[..., None, None] * np.stack([lift - side, 0 * lift, lift + side], axis=2)
    first = 3 * np.arange(4)[:, None] + np.arange(2)  # the points are right, rib, left
    strip = (first.reshape(-1, 1, 1) + np.array([[0, 3, 4], [0, 4, 1]])).reshape(-1, 3)
    uv = np.stack(np.broadcast_arrays(t[:, None], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)[strip]
    triangles = (np.arange(len(base)) * 15)[:, None, None] + strip
    return m.Mesh(
        points.reshape(-1, 3).astype(np.float32), triangles.reshape(-1, 3).astype(np.int32),
        np.tile(uv, (len(base), 1, 1)).astype(np.float32),
    )  # fmt: skip


def _broad(top: float, tall: float, azimuth: np.ndarray, rng: np.random.Generator) -> tuple[list[m.Mesh], m.Mesh]:
    """Stalks that rise from the earth, each with one large leaf."""
    n = len(azimuth)
    share = np.linspace(0.35, 1, n) ** 0.8
    lean, reach = 0.75 - 0.55 * share + rng.normal(0, 0.06, n), share * (tall - top) * 0.78
    tips = m.polar(reach * np.sin(lean), azimuth, top + reach * np.cos(lean))
    stalks = [m.tube([m.polar(0.02, a, top - 0.02), tip], 0.006, 3) for a, tip in zip(azimuth, tips, strict=True)]
    length = rng.uniform(0.2, 0.3, n) * (0.7 + 0.3 * tall)
    return stalks, foliage(tips, azimuth, rng.uniform(-0.1, 0.5, n), length, 0.62 * length, 0.9)


def _swords(top: float, tall: float, azimuth: np.ndarray, rng: np.random.Generator) -> tuple[list[m.Mesh], m.Mesh]:
    """Stiff upright leaves in a cluster."""
    n = len(azimuth)
    away = 0.09 * np.sqrt(np.arange(n) / n)
    length, pitch = (tall - top) * rng.uniform(0.6, 1.0, n), 1.5 - 3.2 * away + rng.normal(0, 0.04, n)
    base, width = m.polar(away, azimuth, top - 0.02), rng.uniform(0.055, 0.08, n)
    return [], foliage(base, azimuth, pitch, length, width, 0.08, 0.6)


def _palm(top: float, tall: float, azimuth: np.ndarray, rng: np.random.Generator) -> tuple[list[m.Mesh], m.Mesh]:
    """Long leaves that rise from a short trunk and arch outwards."""
    n = len(azimuth)
    share, length = np.arange(n) / n, (tall - top) * rng.uniform(0.75, 1.0, n)
    base = m.polar(0.02, azimuth, top + 0.25 * (tall - top) * share)
    leaves = foliage(base, azimuth, 0.85 + 0.6 * share, length, rng.uniform(0.06, 0.09, n), 1.3, 0.6)
    return [m.tube([(0, 0, top - 0.02), (0, 0, top + 0.27 * (tall - top))], 0.025)], leaves


# What grows; its range of height in metres; the radius of its pot.
_GROWTHS = ((_broad, 0.7, 1.25, 0.16), (_palm, 1.1, 1.7, 0.17), (_swords, 0.65, 1.1, 0.14))


def _turned_pot(outline: Sequence[m.Numbers], radius: float, height: float, sides: int) -> tuple[m.Mesh, float]:
    """A vessel from its outline, with its wall turned inwards at the top, and the radius of its mouth."""
    profile = [(a * radius, b * height) for a, b in outline]
    mouth = profile[-1][0]
    return m.lathe([*profile, (0.9 * mouth, height), (0.85 * mouth, 0.8 * height)], sides), mouth


def plant(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A plant in a pot with earth in it; `colour` is that of its leaves."""
    grow, least, most, radius = _GROWTHS[rng.integers(len(_GROWTHS))]
    tall, r = rng.uniform(least, most), radius * rng.uniform(0.9, 1.2)
    h = r * rng.uniform(1.15, 1.6)
    pot, mouth = _turned_pot(_OUTLINES[rng.integers(3)], r, h, 14)
    earth = m.lathe([(0.92 * mouth, 0.88 * h), (0, 0.88 * h + 0.01)], 12)
    # Multiples of the golden angle, as leaves grow, with some disorder.
    count = int(rng.integers(18, 28))
    stems, leaves = grow(0.88 * h, tall, np.arange(count) * 2.39996 + rng.normal(0, 0.2, count), rng)
    # It stands in a corner: pulled in, as if pruned.
    shrink = min(1.0, _SPREAD / float(np.abs(leaves.vertices[:, :2]).max()))
    leaves = replace(leaves, vertices=leaves.vertices * np.array([shrink, shrink, 1], np.float32))
    glaze = m.finish("ceramic", str(rng.choice(_POTS)), rng)
    parts = [glaze(pot), m.finish("earth", None, rng)(earth), m.finish("leaf", colour, rng)(leaves)]
    return [*parts, m.finish("wood", "brown", rng)(*stems)] if stems else parts


def vase(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A glazed vase."""
    pot, _ = _turned_pot(_VASES[rng.integers(3)], rng.uniform(0.05, 0.085), rng.uniform(0.16, 0.3), 16)
    return [m.finish("ceramic", colour, rng)(pot)]


# --- lamps, rugs and paintings ----------------------------------------------------------------------------------------


def _shade(profile: list[tuple[float, float]], colour: str, rng: np.random.Generator, lift: float) -> m.Mesh:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    mesh = m.lathe(profile, 18)
    place = mesh.vertices[mesh.triangles]
    u = np.arctan2(place[..., 1], place[..., 0]) / (2 * np.pi)
    u = np.where(np.ptp(u, axis=1, keepdims=True) > 0.5, u % 1, u)  # triangles across the seam
    v = (place[..., 2] - mesh.vertices[:, 2].min()) / np.ptp(mesh.vertices[:, 2])
    mesh = replace(mesh, uv=np.stack([u, v], axis=-1).astype(np.float32))
    return m.finish("lampshade", colour, rng)(m.moved(mesh, (0, 0, lift)))


def lamp(colour: str, rng: np.random.Generator) -> list[m.Mesh | Lamp]:
    """A floor lamp: a shade on a pole or on a tripod; `colour` is that of the shade."""
    height, radius = rng.uniform(1.45, 1.7), rng.uniform(0.18, 0.24)
    tall, taper = rng.uniform(0.25, 0.33), rng.uniform(0.6, 1.0)
    low = height - tall
    if rng.random() < 0.6:
        foot = m.lathe([(0, 0), (0.15, 0), (0.14, 0.02), (0.03, 0.03), (0.012, 0.06)], 18)
        stand = m.fittings(rng)(foot, m.tube([(0, 0, 0.03), (0, 0, low + 0.1)], 0.012, 8))
    else:
        feet = (m.tube([m.polar(0.26, a, 0.0), m.polar(0.02, a, low)], 0.011) for a in np.arange(3) * 2 * math.pi / 3)
        stand = m.finish("wood", None, rng)(*feet, m.cylinder((0, 0, low - 0.03), 0.04, 0.05, 10))
    shade = _shade([(radius, 0), (taper * radius, tall)], colour, rng, low)
    return [stand, shade, Lamp(np.array([0.0, 0.0, low + tall + 0.25]), 0.35 * _WARM)]


def ceiling_lamp(colour: str, rng: np.random.Generator) -> list[m.Mesh | Lamp]:
    """A pendant with a paper globe or a metal bell, or a flat dome; white light over a room."""
    metal, drop = m.finish("metal", "black" if colour == "black" else None, rng), rng.uniform(0.3, 0.5)
    power, radius = float(rng.uniform(1.5, 1.7)) * _WARM, rng.uniform(0.17, 0.24)
    globe = [(radius * math.sin(t), -radius * math.cos(t)) for t in np.linspace(0, math.pi, 11)]
    globe[0], globe[-1] = (0.0, -radius), (0.0, radius)
    if colour == "white" and rng.random() < 0.5:  # a dome
        made = [metal(m.cylinder((0, 0, -0.025), radius + 0.012, 0.025, 20))]
        made.append(_shade([(r, 0.4 * z) for r, z in globe[:6]], "white", rng, -0.02))
        return [*made, Lamp(np.array([0.0, 0.0, -0.4 * radius - 0.27]), power)]
    made = [metal(m.tube([(0, 0, -drop), (0, 0, -0.03)], 0.004, 4), m.cylinder((0, 0, -0.03), 0.05, 0.03, 12))]
    if colour in ("white", "beige"):
        made.append(_shade(globe, colour, rng, -drop - radius))
        return [*made, Lamp(np.array([0.0, 0.0, -drop - 2 * radius - 0.2]), power)]
    tall = rng.uniform(0.14, 0.2)  # a metal bell, its bulb seen from below
    flare = [(radius, -tall), (0.9 * radius, -0.6 * tall), (0.45 * radius, -0.1 * tall), (0.03, 0), (0, 0)]
    cover = m.finish("metal" if colour == "grey" else "paint", colour, rng)
    made.append(cover(m.moved(m.lathe(flare, 18), (0, 0, -drop))))
    made.append(_shade([(0.22 * r, 0.22 * z) for r, z in globe], "white", rng, -drop - 0.75 * tall))
    made.append(_shade([(0.97 * radius, -0.93 * tall), (0.2 * radius, -0.2 * tall)], "white", rng, -drop))
    return [*made, Lamp(np.array([0.0, 0.0, -drop - tall - 0.25]), power)]


def rug(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A flat rug with a pattern, its length along y."""
    thick, y = 0.008, rng.uniform(0.7, 1.2)
    x = y * rng.uniform(0.62, 0.75)
    top = m.quad([(x, -y, thick), (x, y, thick), (-x, y, thick), (-x, -y, thick)])
    pattern = m.Cover(material("rug", colour, rng), (2 * y, 2 * x))
    return [pattern(top), m.finish("carpet", colour, rng)(m.box((-x, -y, 0), (x, y, thick - 0.001)))]


def painting(colour: str, rng: np.random.Generator) -> list[m.Mesh]:
    """A picture in a frame, with or without a mount; `colour` dominates in it."""
    look, face = material("art", colour, rng), 0.022
    assert look.texture is not None
    rows, columns = look.texture.shape[:2]
    scale = math.sqrt(rng.uniform(0.16, 0.7) / (rows * columns))
    y, z = columns * scale / 2, rows * scale / 2
    picture = m.quad([(face, -y, -z), (face, y, -z), (face, y, z), (face, -y, z)])
    parts = [m.Cover(look, (2 * y, 2 * z))(picture)]
    if rng.random() < 0.5:  # a mount of white card
        mount = rng.uniform(0.05, 0.09)
        parts.append(m.finish("paint", "white", rng)(*_border(y, z, mount, face)))
        y, z = y + mount, z + mount
    frames = (("wood", None), ("paint", "black"), ("paint", "white"), ("wood", "brown"), ("metal", "yellow"))
    return [*parts, m.finish(*frames[rng.integers(5)], rng)(*_border(y, z, rng.uniform(0.018, 0.045), face + 0.01))]


def _border(y: float, z: float, width: float, depth: float) -> list[m.Mesh]:
    """Four bars, `depth` deep, round the rectangle with half sides `y`, `z` in the wall's plane."""
    a, b = y + width, z + width
    bars = ((-a, z, a, b), (-a, -b, a, -z), (-a, -z, -y, z), (y, -z, a, z))
    return [m.box((0.0, y0, z0), (depth, y1, z1)) for y0, z0, y1, z1 in bars]
