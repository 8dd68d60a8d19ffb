"""Lamps, rugs, paintings and vases.

Point lights are placed a little outside their shades (above that of a floor lamp, below that of a ceiling lamp).
Inside, the shade would block their light; close to it, half of the room would lie in its shadow.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.worlds.apartment.curved import cylinder, lathe, quad, tube
from eagor.worlds.apartment.furniture.model import finish, fittings, polar
from eagor.worlds.apartment.furniture.plants import foliage, polars
from eagor.worlds.apartment.mesh import Mesh, Part, box, moved, part
from eagor.worlds.apartment.textures import material
from eagor.worlds.scene import Lamp

_WARM = np.array([1.0, 0.9, 0.76])  # linear light of a lamp of about 3500 K, its red at 1


def _shade(
    profile: list[tuple[float, float]], colour: str, rng: np.random.Generator, lift: float, x: float = 0.0
) -> Part:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    radius, length = max(r for r, _ in profile), sum(math.dist(a, b) for a, b in pairwise(profile))
    look = material("lampshade", colour, rng)
    made = part(moved(lathe(profile, 18), (0, 0, lift)), look, (2 * math.pi * radius, length))
    return Part(made.vertices + np.array([x, 0, 0], dtype=np.float32), made.triangles, made.uv, look)


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


# Outlines of vases: shares of their radius and of their height.
_VASES = (
    ((0, 0), (0.6, 0), (1, 0.3), (0.9, 0.55), (0.4, 0.85), (0.5, 1)),
    ((0, 0), (0.5, 0), (0.6, 0.1), (1, 0.65), (0.8, 0.85), (0.55, 0.92), (0.6, 1)),
    ((0, 0), (0.75, 0), (0.8, 0.5), (1, 1)),
)
_BLOOMS = ("red", "pink", "yellow", "white", "purple", "orange")


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
