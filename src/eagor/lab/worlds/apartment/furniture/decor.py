"""Lamps, rugs, paintings and vases; potted plants: broad leaves, palms, sword leaves, small trees, and rosettes.

Point lights are placed a little outside their shades (above that of a floor lamp, below that of a ceiling lamp).
Inside, the shade would block their light; close to it, half of the room would lie in its shadow.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import finish, fittings, polar
from eagor.lab.worlds.apartment.mesh import Mesh, Part, box, cylinder, lathe, merged, moved, part, quad, reshaped, tube
from eagor.lab.worlds.apartment.textures import material
from eagor.lab.worlds.scene import Lamp

Grown = tuple[list[Mesh], list[Mesh]]  # stems and leaves

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
    design, r, h = rng.integers(4), radius, height
    if design == 0:  # tapered, with a rim
        rim = [(0.92 * r, 0.82 * h), (r, 0.82 * h), (r, 0.82 * h), (r, h), (r, h)]
        profile = [(0, 0), (0.68 * r, 0), (0.68 * r, 0), *rim]
    elif design == 1:  # a cylinder
        profile = [(0, 0), (0.9 * r, 0), (0.92 * r, 0.02), (0.92 * r, h), (0.92 * r, h)]
    elif design == 2:  # round
        belly = [(0.85 * r, 0.2 * h), (r, 0.5 * h), (0.92 * r, 0.82 * h)]
        profile = [(0, 0), (0.55 * r, 0), *belly, (0.8 * r, h), (0.8 * r, h)]
    else:  # a basket
        profile = [(0, 0), (0.78 * r, 0), (0.82 * r, 0.02), (r, 0.5 * h), (0.88 * r, h), (0.88 * r, h)]
    mouth = profile[-1][0]
    profile += [(mouth - 0.015, h), (mouth - 0.015, h), (mouth - 0.02, 0.85 * h)]
    cover = finish("wicker", None, rng) if design == 3 else finish("ceramic", str(rng.choice(_POTS)), rng)
    pot = lathe(profile, 14)
    earth = moved(lathe([(mouth - 0.012, 0), (0, 0.01)], 12), (0, 0, 0.88 * h))
    return [cover(pot), finish("earth", None, rng)(earth)], 0.88 * h


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
    ends = [(polar(0.02, a, top - 0.02), tip) for a, tip in zip(azimuth, tips, strict=True)]
    length, pitch = rng.uniform(0.2, 0.3, n) * (0.7 + 0.3 * tall), rng.uniform(-0.1, 0.5, n)
    leaves = foliage(tips, azimuth, pitch, length, 0.62 * length, 0.9, steps=5, fold=0.15, blunt=0.75)
    return [tube([foot, tip], [0.008, 0.005], 3) for foot, tip in ends], [leaves]


def _rubber(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Upright stems set with glossy oval leaves from the ground up."""
    stems, bases, azimuths = [], [], []
    for k in range(int(rng.integers(2, 4))):
        a, high = rng.uniform(0, 6.3), (tall - 0.12) * (1 - 0.17 * k)
        foot, head = np.array(polar(0.03, a, top - 0.02)), np.array(polar(0.14, a, high))
        stems.append(tube([foot, head], [0.011, 0.006], 5))
        count = int(12 * (high - top) / 0.9) + 4
        at = np.linspace(0.22, 1, count)[:, None]
        bases.append(foot + at * (head - foot))
        azimuths.append(_around(count, rng))
    base, azimuth = np.concatenate(bases), np.concatenate(azimuths)
    length, pitch = rng.uniform(0.17, 0.26, len(base)), rng.uniform(0.3, 0.9, len(base))
    return stems, [foliage(base, azimuth, pitch, length, 0.45 * length, 0.8, steps=4, fold=0.25)]


def _palm(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Arching fronds with two rows of narrow leaflets."""
    fronds, ribs, leaflets = int(rng.integers(9, 13)), [], []
    for k, a in enumerate(_around(fronds, rng)):
        length = (tall - top) * (1.1 - 0.45 * k / fronds) * rng.uniform(0.9, 1.05)
        pitch = 1.5 - 0.5 * (k / fronds) + rng.normal(0, 0.04)
        bend = rng.uniform(0.75, 1.1)
        t = np.linspace(0, 1, 9)
        slope = pitch - bend * (t[:-1] + t[1:]) / 2
        out, up = (np.append(0, np.cumsum(along(slope))) * length / 8 for along in (np.cos, np.sin))
        rib = np.stack(polar(out, a, top + up), axis=-1)
        ribs.append(tube(rib[::2], np.linspace(0.007, 0.003, 5), 3))
        at = np.repeat(np.linspace(0.24, 1.0, 10), 2)
        base = np.stack([np.interp(at, t, rib[:, i]) for i in range(3)], axis=-1)
        turn = np.tile([1, -1], 10) * (1.0 - 0.6 * at)
        size = length * (0.32 - 0.2 * np.abs(at - 0.45))
        rise = pitch - bend * at - 0.1
        leaflets.append(foliage(base, a + turn, rise, size, 0.13 * size + 0.01, 0.6, steps=2, fold=0.1))
    return ribs, leaflets


def _swords(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Stiff upright leaves in a cluster."""
    n = int(rng.integers(16, 24))
    azimuth, away = _around(n, rng), 0.09 * np.sqrt(np.arange(n) / n)
    base = polars(away, azimuth, top - 0.02)
    length = (tall - top) * rng.uniform(0.6, 1.0, n)
    pitch = 1.5 - 3.2 * away + rng.normal(0, 0.04, n)
    return [], [foliage(base, azimuth, pitch, length, rng.uniform(0.055, 0.08, n), 0.08, steps=5, fold=0.5, blunt=0.6)]


def _tree(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """A slim trunk that forks, under a round crown of small leaves."""
    crown, centre = rng.uniform(0.24, 0.34), np.array([rng.normal(0, 0.03), rng.normal(0, 0.03), tall])
    centre[2] = tall - crown
    fork = np.array([centre[0] * 0.5, centre[1] * 0.5, top + 0.55 * (centre[2] - crown * 0.3 - top)])
    limbs = [tube([(0, 0, top - 0.02), fork], [0.02, 0.015], 6)]
    for a in _around(4, rng):
        end = centre + 0.55 * crown * np.array(polar(1.0, a, 0.2))
        limbs.append(tube([fork, end], [0.011, 0.005], 4))
    n = 110
    height = rng.uniform(-0.85, 1, n)
    azimuth, ring = _around(n, rng), np.sqrt(1 - height**2)
    radius = crown * rng.uniform(0.55, 0.95, n)
    base = centre + radius[:, None] * polars(ring, azimuth, 0.95 * height)
    length = rng.uniform(0.12, 0.19, n)
    return limbs, [foliage(base, azimuth + rng.normal(0, 0.5, n), 0.9 * height, length, 0.55 * length, 0.8, steps=3)]


def _rosette(top: float, tall: float, rng: np.random.Generator) -> Grown:
    """Thick pointed leaves from one place, as of an agave."""
    n = int(rng.integers(26, 36))
    share = np.arange(n) / n
    azimuth, pitch = _around(n, rng), 1.45 - 1.3 * share[::-1]
    base = polars(0.02, azimuth, top + 0.03 * (1 - share))
    length = (tall - top) * rng.uniform(0.7, 1.0, n)
    return [], [foliage(base, azimuth, pitch[::-1], length, 0.2 * length + 0.012, 0.25, steps=4, fold=0.6, blunt=0.65)]


# What grows; its range of height in metres; the radius of its pot.
_GROWTHS = (
    (_broad, 0.7, 1.25, 0.16), (_rubber, 0.9, 1.6, 0.16), (_palm, 1.1, 1.8, 0.17), (_swords, 0.65, 1.1, 0.14),
    (_tree, 1.2, 1.8, 0.16), (_rosette, 0.5, 0.75, 0.15),
)  # fmt: skip


def plant(colour: str, rng: np.random.Generator) -> list[Part]:
    """A potted plant; `colour` is that of its leaves."""
    grow, least, most, radius = _GROWTHS[rng.integers(len(_GROWTHS))]
    tall, radius = rng.uniform(least, most), radius * rng.uniform(0.9, 1.2)
    parts, top = _pot(radius, radius * rng.uniform(1.15, 1.6), rng)
    stems, leaves = grow(top, tall, rng)
    spread = max(float(np.abs(mesh.vertices[:, :2]).max()) for mesh in leaves)
    if spread > _SPREAD:  # it stands in a corner: pulled in, as if pruned
        narrow = np.array([_SPREAD / spread, _SPREAD / spread, 1.0])
        stems, leaves = ([reshaped(mesh, lambda at: at * narrow) for mesh in group] for group in (stems, leaves))
    shades = finish("leaf", colour, rng), finish("leaf", colour, rng)
    parts += [shade(*leaves[k::2]) for k, shade in enumerate(shades) if leaves[k::2]]
    if stems:
        woody = grow in (_tree, _rubber)
        parts.append(finish("wood" if woody else "paint", "brown" if woody else colour, rng)(*stems))
    if rng.random() < 0.2:  # a low stool under the pot
        ends = [(polar(1.1 * radius, a, -0.22), polar(0.8 * radius, a, -0.03)) for a in (0.5, 2.6, 4.7)]
        seat = cylinder((0, 0, -0.03), radius * 1.05, 0.03, 16)
        parts.append(finish("wood", None, rng)(merged(seat, *(tube(pair, 0.012, 5) for pair in ends))))
    return parts


def _shade(
    profile: list[tuple[float, float]], colour: str, rng: np.random.Generator, lift: float, x: float = 0.0
) -> Part:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    radius, length = max(r for r, _ in profile), sum(math.dist(a, b) for a, b in pairwise(profile))
    look = material("lampshade", colour, rng)
    return part(moved(lathe(profile, 18), (x, 0, lift)), look, (2 * math.pi * radius, length))


def lamp(colour: str, rng: np.random.Generator) -> list[Part | Lamp]:
    """A floor lamp: a shade on a pole, on a tripod, or on an arc; `colour` is that of the shade."""
    metal = fittings(rng)
    height, radius, tall = rng.uniform(1.45, 1.7), rng.uniform(0.18, 0.24), rng.uniform(0.22, 0.32)
    taper = rng.uniform(0.6, 1.0)
    low, x = height - tall, 0.0
    design = rng.integers(3)
    if design == 0:
        foot = [(0, 0), (0.15, 0), (0.15, 0), (0.14, 0.02), (0.03, 0.03), (0.012, 0.06)]
        stand = [metal(lathe(foot, 18), tube([(0, 0, 0.03), (0, 0, low + 0.1)], 0.012, 8))]
    elif design == 1:
        wood = finish("wood", None, rng)
        angles = rng.uniform(0, 2) + np.arange(3) * 2 * math.pi / 3
        legs = [tube([polar(0.26, a, 0.0), polar(0.02, a, low)], [0.011, 0.016], 6) for a in angles]
        stand = [wood(*legs), metal(cylinder((0, 0, low - 0.03), 0.04, 0.05, 10))]
    else:
        x, t = 0.42, np.linspace(0, 1, 9)
        rise = 0.03 + (height + 0.12 - 0.03) * np.sin(t * math.pi / 2)
        bow = np.stack([x * (1 - np.cos(t * math.pi / 2)), 0 * t, rise], -1)
        low -= 0.12
        base = lathe([(0, 0), (0.15, 0), (0.15, 0), (0.15, 0.03), (0.15, 0.03), (0, 0.03)], 18)
        stand = [metal(base, tube(bow, 0.011, 6), tube([bow[-1], (x, 0, low + 0.6 * tall)], 0.007, 5))]
    shade = _shade([(radius, 0), (taper * radius, tall)], colour, rng, low, x)
    return [*stand, shade, Lamp(np.array([x, 0.0, low + tall + 0.25]), 0.35 * _WARM)]


def ceiling_lamp(colour: str, rng: np.random.Generator) -> list[Part | Lamp]:
    """A pendant with a shade or a paper globe, or a flat dome; white light over a room."""
    metal = finish("metal", "black" if colour == "black" else None, rng)
    power = float(rng.uniform(1.5, 1.7)) * _WARM

    def light(z: float) -> Lamp:
        return Lamp(np.array([0.0, 0.0, z]), power)

    if colour == "white" and rng.random() < 0.5:  # a dome
        radius, deep = rng.uniform(0.17, 0.24), rng.uniform(0.07, 0.1)
        bow = [(radius * math.sin(t), -0.02 - deep * math.cos(t)) for t in np.linspace(0, math.pi / 2, 6)]
        dome, rim = _shade(bow, "white", rng, 0.0), cylinder((0, 0, -0.025), radius + 0.012, 0.025, 20)
        return [metal(rim), dome, light(-deep - 0.25)]
    drop = rng.uniform(0.3, 0.5)
    rose = lathe([(0, -0.03), (0.05, -0.03), (0.05, -0.03), (0.05, 0), (0.05, 0), (0, 0)], 12)
    cord = metal(tube([(0, 0, -drop), (0, 0, -0.03)], 0.004, 4), rose)
    if colour in ("black", "grey"):  # a metal bell, its bulb seen from below
        radius, tall = rng.uniform(0.16, 0.22), rng.uniform(0.14, 0.2)
        flare = [(radius, -drop - tall), (0.9 * radius, -drop - 0.6 * tall), (0.45 * radius, -drop - 0.1 * tall)]
        shell = finish("metal" if colour == "grey" else "paint", colour, rng)
        ball = [(0, -0.05), (0.035, -0.035), (0.05, 0), (0.035, 0.035), (0, 0.05)]
        bulb = _shade(ball, "white", rng, -drop - 0.75 * tall)
        inside = [(0.97 * radius, -drop - tall * 0.93), (0.2 * radius, -drop - tall * 0.2)]
        bell = shell(lathe([*flare, (0.03, -drop), (0, -drop)], 18))
        return [cord, bell, bulb, _shade(inside, "white", rng, 0.0), light(-drop - tall - 0.25)]
    radius = rng.uniform(0.17, 0.24)
    if rng.random() < 0.5:  # a globe
        profile = [(radius * math.sin(t), -radius * math.cos(t)) for t in np.linspace(0, math.pi, 11)]
        profile[0], profile[-1], low = (0.0, -radius), (0.0, radius), -drop - 2 * radius
        shade = _shade(profile, colour, rng, -drop - radius)
    else:  # a drum, closed below
        tall = rng.uniform(0.16, 0.24)
        profile, low = [(0, 0.01), (radius, 0.01), (radius, 0.01), (radius, tall)], -drop - 0.6 * tall
        shade = _shade(profile, colour, rng, low)
    return [cord, shade, light(low - 0.2)]


def rug(colour: str, rng: np.random.Generator) -> list[Part]:
    """A flat rug, rectangular with a pattern, its length along y, or round with a border."""
    thick = 0.008
    if rng.random() < 0.2:
        radius = rng.uniform(0.65, 1.0)
        pile, border = finish("carpet", colour, rng), finish("carpet", "white" if colour == "beige" else "beige", rng)
        middle = lathe([(0.86 * radius, thick), (0, thick)], 32)
        ring = lathe([(radius, 0), (radius, thick), (radius, thick), (0.86 * radius, thick)], 32)
        return [pile(middle), border(ring)]
    long = rng.uniform(1.4, 2.4)
    short = long * rng.uniform(0.62, 0.75)
    x, y = short / 2, long / 2
    ends = [(x, -y), (x, y), (-x, y), (-x, -y), (x, -y)]
    rim = [quad([(*a, 0), (*b, 0), (*b, thick), (*a, thick)]) for a, b in pairwise(ends)]
    pattern = part(quad([(*end, thick) for end in ends[:4]]), material("rug", colour, rng), (long, short))
    return [pattern, finish("carpet", colour, rng)(*rim)]


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
    """A glazed vase, empty, with flowers or with green twigs."""
    tall, r = rng.uniform(0.16, 0.3), rng.uniform(0.05, 0.085)
    profile = [(a * r, b * tall) for a, b in _VASES[rng.integers(3)]]
    mouth = profile[-1][0]
    inside = [(mouth, tall), (mouth - 0.006, tall), (0.7 * mouth, 0.75 * tall), (0, 0.7 * tall)]
    parts = [finish("ceramic", colour, rng)(lathe([*profile, *inside], 16))]
    if rng.random() >= 0.65:
        return parts
    n = int(rng.integers(7, 12))
    azimuth, lean = rng.uniform(0, 6.3) + np.arange(n) * 2.4, rng.uniform(0.05, 0.5, n)
    foot, reach = np.array([0, 0, 0.75 * tall]), rng.uniform(0.2, 0.32, n)
    heads = foot + polars(reach * np.sin(lean), azimuth, reach * np.cos(lean))
    green = finish("leaf", "green", rng)
    stalks = [tube([foot, head], 0.0025, 3) for head in heads]
    size = rng.uniform(0.07, 0.11, n)
    leaves = foliage(foot + 0.65 * (heads - foot), azimuth + 0.8, 1.2 - lean, size, 0.35 * size, 0.9, steps=3)
    parts += [finish("paint", "green", rng)(*stalks), green(leaves)]
    if rng.random() < 0.7:
        petals = 6
        at, turn = np.repeat(heads, petals, axis=0), np.tile(np.arange(petals) * 2 * math.pi / petals, n)
        length, turn = np.full(len(at), rng.uniform(0.028, 0.04)), turn + np.repeat(azimuth, petals)
        bloom = foliage(at, turn, np.full(len(at), 0.7), length, 0.7 * length, 0.8, steps=2, fold=0.1)
        parts.append(finish("paint", str(rng.choice(_BLOOMS)), rng)(bloom))
        eye = lathe([(0.009, 0), (0.008, 0.006), (0, 0.008)], 6)
        parts.append(finish("paint", "yellow", rng)(*(moved(eye, head) for head in heads)))
    return parts
