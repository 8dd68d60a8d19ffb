"""Lamps, rugs, paintings and vases; potted plants: broad leaves, palms, sword leaves, and small trees.

Point lights are placed a little outside their shades (above that of a floor lamp, below that of a ceiling lamp).
Inside, the shade would block their light; close to it, half of the room would lie in its shadow.
"""

from __future__ import annotations

import math

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import finish, fittings, polar
from eagor.lab.worlds.apartment.mesh import Mesh, Part, box, cushion, cylinder, lathe, moved, part, quad, tube
from eagor.lab.worlds.apartment.textures import material
from eagor.lab.worlds.scene import Lamp

Grown = tuple[list[Mesh], Mesh]  # stems and leaves
Profile = list[tuple[float, float]]  # radius and height

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


def polars(radius: np.ndarray | float, azimuth: np.ndarray, z: np.ndarray | float) -> np.ndarray:
    """Points ``(n, 3)`` at these distances from the z axis, azimuths and heights."""
    return np.stack(np.broadcast_arrays(radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=-1)


def foliage(
    base: np.ndarray, azimuth: np.ndarray, pitch: np.ndarray, length: np.ndarray, width: np.ndarray,
    bend: float | np.ndarray, *, steps: int = 4, fold: float = 0.2, blunt: float = 0.8,
) -> Mesh:  # fmt: skip
    """Leaves as bent strips, all at once; 4 * steps - 4 triangles each. Metres and radians, ``(n,)`` each.

    `base` ``(n, 3)``: points of attachment; `azimuth`: direction; `pitch`: slope at the base, which falls by `bend`
    towards the tip; `width` at the widest place, which is nearer to the base for `blunt` below 1; `steps`: pieces along
    the midrib; `fold`: height of the edges above it, in half widths.
    """
    n = len(base)
    t = np.linspace(0, 1, steps + 1)
    middle = (t[:-1] + t[1:]) / 2
    slope = pitch[:, None] - np.broadcast_to(bend, (n,))[:, None] * middle
    piece = length[:, None] / steps
    out = np.concatenate([np.zeros((n, 1)), np.cumsum(np.cos(slope) * piece, axis=1)], axis=1)
    up = np.concatenate([np.zeros((n, 1)), np.cumsum(np.sin(slope) * piece, axis=1)], axis=1)
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    rib = base[:, None] + np.stack([c * out, s * out, up], axis=-1)
    half = 0.5 * width[:, None] * np.sin(np.pi * np.clip(t, 0.02, 0.985) ** blunt)
    tilt = pitch[:, None] - np.broadcast_to(bend, (n,))[:, None] * t
    lift = np.stack([-c * np.sin(tilt), -s * np.sin(tilt), np.cos(tilt)], axis=-1) * fold
    side = np.stack([-s, c, 0 * s], axis=-1)
    left, right = rib + half[..., None] * (side + lift), rib + half[..., None] * (lift - side)
    points = np.stack([right, rib, left], axis=2)  # (n, steps + 1, 3, 3)
    # The ends are points: the strip's first and last vertices across coincide with the rib.
    points[:, 0], points[:, -1] = rib[:, :1], rib[:, -1:]
    index = np.arange(3 * (steps + 1)).reshape(steps + 1, 3)
    a, b, d, e = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([np.stack([a, d, e], -1), np.stack([a, e, b], -1)], axis=2).reshape(-1, 3)
    keep = ~((triangles < 3).sum(axis=1) > 1) & ~((triangles >= 3 * steps).sum(axis=1) > 1)
    triangles = triangles[keep]
    across = np.array([0.0, 0.5, 1.0])
    uv = np.stack(np.broadcast_arrays(t[:, None], across), axis=-1).reshape(-1, 2)[triangles]
    uv[..., 1] = np.where((triangles < 3) | (triangles >= 3 * steps), 0.5, uv[..., 1])
    places = (np.arange(n) * 3 * (steps + 1))[:, None, None] + triangles
    return Mesh(
        points.reshape(-1, 3).astype(np.float32),
        places.reshape(-1, 3).astype(np.int32),
        np.broadcast_to(uv, (n, *uv.shape)).reshape(-1, 3, 2).astype(np.float32),
    )


def _pot(radius: float, height: float, rng: np.random.Generator) -> tuple[list[Part], float]:
    """A pot with earth in it, and the height of the earth."""
    outlines = ((0.68, 0.8, 1.0, 1.0), (0.9, 0.92, 0.92, 0.92), (0.55, 1.0, 0.92, 0.8), (0.78, 1.0, 0.95, 0.88))
    design, r, h = int(rng.integers(4)), radius, height
    profile = [(0.0, 0.0), *((share * r, z * h) for share, z in zip(outlines[design], (0, 0.5, 0.82, 1), strict=True))]
    mouth = profile[-1][0]
    profile += [(mouth - 0.015, h), (mouth - 0.02, 0.85 * h)]
    cover = finish("wicker", None, rng) if design == 3 else finish("ceramic", str(rng.choice(_POTS)), rng)
    earth = lathe([(mouth - 0.012, 0.88 * h), (0, 0.88 * h + 0.01)], 12)
    return [cover(lathe(profile, 14)), finish("earth", None, rng)(earth)], 0.88 * h


def _around(n: int, rng: np.random.Generator) -> np.ndarray:
    """Directions at multiples of the golden angle, as leaves grow, with some disorder."""
    return rng.uniform(0, 6.3) + np.arange(n) * 2.39996 + rng.normal(0, 0.2, n)


def _broad(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Stalks that rise from the earth, each with one large leaf."""
    n = int(rng.integers(15, 22))
    azimuth, share = _around(n, rng), np.linspace(0.35, 1, n) ** 0.8
    lean = 0.75 - 0.55 * share + rng.normal(0, 0.06, n)
    reach = share * (tall - top) * 0.78
    tips = polars(reach * np.sin(lean), azimuth, top + reach * np.cos(lean))
    stalks = [tube([polar(0.02, a, top - 0.02), tip], [0.008, 0.005], 3) for a, tip in zip(azimuth, tips, strict=True)]
    length, pitch = rng.uniform(0.2, 0.3, n) * (0.7 + 0.3 * tall), rng.uniform(-0.1, 0.5, n)
    return stalks, foliage(tips, azimuth, pitch, length, 0.62 * length, 0.9, steps=5, fold=0.15, blunt=0.75)


def _swords(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Stiff upright leaves in a cluster."""
    n = int(rng.integers(16, 24))
    azimuth, away = _around(n, rng), 0.09 * np.sqrt(np.arange(n) / n)
    base = polars(away, azimuth, top - 0.02)
    length, pitch = (tall - top) * rng.uniform(0.6, 1.0, n), 1.5 - 3.2 * away + rng.normal(0, 0.04, n)
    return [], foliage(base, azimuth, pitch, length, rng.uniform(0.055, 0.08, n), 0.08, steps=5, fold=0.5, blunt=0.6)


def _palm(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Long leaves that rise from a short trunk and arch outwards."""
    n = int(rng.integers(22, 30))
    azimuth, share = _around(n, rng), np.arange(n) / n
    base = polars(0.02, azimuth, top + 0.25 * (tall - top) * share)
    length, width = (tall - top) * rng.uniform(0.75, 1.0, n), rng.uniform(0.06, 0.09, n)
    leaves = foliage(base, azimuth, 1.45 - 0.6 * (1 - share), length, width, 1.3, steps=6, fold=0.3, blunt=0.6)
    return [tube([(0, 0, top - 0.02), (0, 0, top + 0.27 * (tall - top))], [0.03, 0.02], 6)], leaves


def _tree(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """A slim trunk that forks, under a round crown of small leaves."""
    crown = rng.uniform(0.24, 0.34)
    centre = np.array([rng.normal(0, 0.03), rng.normal(0, 0.03), tall - crown])
    fork = np.array([centre[0] * 0.5, centre[1] * 0.5, top + 0.55 * (centre[2] - crown * 0.3 - top)])
    limbs = [tube([(0, 0, top - 0.02), fork], [0.02, 0.015], 6)]
    ends = (centre + 0.55 * crown * np.array(polar(1.0, a, 0.2)) for a in _around(4, rng))
    limbs += [tube([fork, end], [0.011, 0.005], 4) for end in ends]
    n = 110
    height, azimuth = rng.uniform(-0.85, 1, n), _around(n, rng)
    radius = crown * rng.uniform(0.55, 0.95, n)
    base = centre + radius[:, None] * polars(np.sqrt(1 - height**2), azimuth, 0.95 * height)
    length = rng.uniform(0.12, 0.19, n)
    return limbs, foliage(base, azimuth + rng.normal(0, 0.5, n), 0.9 * height, length, 0.55 * length, 0.8, steps=3)


# What grows; its range of height in metres; the radius of its pot; the material of its stems.
_GROWTHS = (
    (_broad, 0.7, 1.25, 0.16, "paint"), (_palm, 1.1, 1.7, 0.17, "wood"), (_swords, 0.65, 1.1, 0.14, "paint"),
    (_tree, 1.2, 1.8, 0.16, "wood"),
)  # fmt: skip


def plant(colour: str, rng: np.random.Generator) -> list[Part]:
    """A potted plant; `colour` is that of its leaves."""
    grow, least, most, radius, woody = _GROWTHS[rng.integers(len(_GROWTHS))]
    tall, radius = rng.uniform(least, most), radius * rng.uniform(0.9, 1.2)
    parts, top = _pot(radius, radius * rng.uniform(1.15, 1.6), rng)
    stems, leaves = grow(top, tall, rng)
    # It stands in a corner: pulled in, as if pruned.
    shrink = min(1.0, _SPREAD / float(np.abs(leaves.vertices[:, :2]).max()))
    leaves = Mesh(leaves.vertices * np.array([shrink, shrink, 1], np.float32), leaves.triangles, leaves.uv)
    parts.append(finish("leaf", colour, rng)(leaves))
    if stems:
        parts.append(finish(woody, "brown" if woody == "wood" else colour, rng)(*stems))
    return parts


def _shade(profile: Profile, colour: str, rng: np.random.Generator, lift: float, x: float = 0.0) -> Part:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    mesh = lathe(profile, 18)
    place = mesh.vertices[mesh.triangles]
    u = np.arctan2(place[..., 1], place[..., 0]) / (2 * np.pi)
    u = np.where(np.ptp(u, axis=1, keepdims=True) > 0.5, u % 1, u)  # triangles across the seam
    v = (place[..., 2] - mesh.low[2]) / np.ptp(mesh.vertices[:, 2])
    mesh = Mesh(mesh.vertices, mesh.triangles, np.stack([u, v], axis=-1).astype(np.float32))
    return part(moved(mesh, (x, 0, lift)), material("lampshade", colour, rng))


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
    arc = np.linspace(0, math.pi, 11)
    globe: Profile = [(radius * math.sin(t), -radius * math.cos(t)) for t in arc]
    globe[0], globe[-1] = (0.0, -radius), (0.0, radius)

    def light(z: float) -> Lamp:
        return Lamp(np.array([0.0, 0.0, z]), power)

    if colour == "white" and rng.random() < 0.5:  # a dome
        dome = _shade([(r, 0.4 * z) for r, z in globe[:6]], "white", rng, -0.02)
        return [metal(cylinder((0, 0, -0.025), radius + 0.012, 0.025, 20)), dome, light(-0.4 * radius - 0.27)]
    cord = metal(tube([(0, 0, -drop), (0, 0, -0.03)], 0.004, 4), cylinder((0, 0, -0.03), 0.05, 0.03, 12))
    if colour in ("black", "grey"):  # a metal bell, its bulb seen from below
        tall = rng.uniform(0.14, 0.2)
        flare = [(radius, -tall), (0.9 * radius, -0.6 * tall), (0.45 * radius, -0.1 * tall), (0.03, 0), (0, 0)]
        shell = finish("metal" if colour == "grey" else "paint", colour, rng)
        bulb = _shade([(0.22 * r, 0.22 * z) for r, z in globe], "white", rng, -drop - 0.75 * tall)
        inside = _shade([(0.97 * radius, -0.93 * tall), (0.2 * radius, -0.2 * tall)], "white", rng, -drop)
        return [cord, shell(moved(lathe(flare, 18), (0, 0, -drop))), bulb, inside, light(-drop - tall - 0.25)]
    if rng.random() < 0.5:
        return [cord, _shade(globe, colour, rng, -drop - radius), light(-drop - 2 * radius - 0.2)]
    tall = rng.uniform(0.16, 0.24)  # a drum, closed below
    low = -drop - 0.6 * tall
    return [cord, _shade([(0, 0), (radius, 0.01), (radius, tall)], colour, rng, low), light(low - 0.2)]


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
    ends = [(x, -y), (x, y), (-x, y), (-x, -y)]
    pattern = part(quad([(*end, thick) for end in ends]), material("rug", colour, rng), (long, short))
    return [pattern, finish("carpet", colour, rng)(box((-x, -y, 0), (x, y, thick - 0.001)))]


def painting(colour: str, rng: np.random.Generator) -> list[Part]:
    """A picture in a frame, with or without a mount, or on bare canvas; `colour` dominates in it."""
    look, face = material("art", colour, rng), 0.022
    rows, columns = look.texture.shape[:2] if look.texture is not None else (1, 1)
    scale = math.sqrt(rng.uniform(0.16, 0.7) / (rows * columns))
    y, z = columns * scale / 2, rows * scale / 2
    parts = [part(quad([(face, -y, -z), (face, y, -z), (face, y, z), (face, -y, z)]), look, (2 * y, 2 * z))]
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
    heads = foot + polars(reach * np.sin(lean), azimuth, reach * np.cos(lean))
    size = rng.uniform(0.07, 0.11, n)
    leaves = foliage(foot + 0.65 * (heads - foot), azimuth + 0.8, 1.2 - lean, size, 0.35 * size, 0.9, steps=3)
    stalks = [tube([foot, head], 0.0025, 3) for head in heads]
    parts += [finish("paint", "green", rng)(*stalks), finish("leaf", "green", rng)(leaves)]
    if rng.random() < 0.7:
        blooms = [cushion(head - 0.022, head + 0.022, 2.0) for head in heads[:6]]
        parts.append(finish("paint", str(rng.choice(_BLOOMS)), rng)(*blooms))
    return parts
