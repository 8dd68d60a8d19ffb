"""Plants, lamps, rugs, paintings and vases.

Point lights stand a little outside their shades (above that of a floor lamp, below that of a ceiling lamp): inside,
the shade would keep their light from the room, and close to it half of the room would lie in its shadow.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.worlds.apartment.furniture.joinery import fittings
from eagor.worlds.apartment.furniture.model import Builder, Kind, Model, assembled, finish
from eagor.worlds.apartment.furniture.plants import foliage, plant
from eagor.worlds.apartment.meshes import Mesh, Part, box, cylinder, lathe, moved, part, quad, tube
from eagor.worlds.apartment.pictures import PICTURES
from eagor.worlds.apartment.textures import material
from eagor.worlds.scene import Lamp

_ROOMS = ("living room", "bedroom", "study", "dining room", "hall")
KINDS = (
    Kind("plant", "corner", (*_ROOMS, "kitchen", "bathroom"), ("green",)),
    Kind("lamp", "corner", ("living room", "bedroom", "study"), ("white", "beige", "yellow", "orange", "red")),
    Kind("rug", "flat", (*_ROOMS, "bathroom"), PICTURES["rug"].colours),
    Kind("painting", "hung", (*_ROOMS, "kitchen"), PICTURES["art"].colours),
    Kind("ceiling lamp", "ceiling", (*_ROOMS, "kitchen", "bathroom"), ("white", "beige", "black", "grey")),
    Kind("vase", "top", _ROOMS, ("white", "blue", "green", "red", "yellow", "purple", "pink", "black")),
)
_WARM = np.array([1.0, 0.9, 0.76])  # linear light of a lamp of about 3500 K, its red at 1


def _shade(profile: list[tuple[float, float]], colour: str, rng: np.random.Generator, lift: float) -> Part:
    """A lampshade from its profile, glowing; one repeat of its texture goes round it and from bottom to top."""
    shape = lathe(profile, 18)
    radius, length = (
        max(r for r, _ in profile),
        sum(math.dist(a, b) for a, b in pairwise(profile)),
    )
    return part(moved(shape, (0, 0, lift)), material("lampshade", colour, rng), (2 * math.pi * radius, length))


def lamp(colour: str, rng: np.random.Generator) -> Model:
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
        legs = [
            tube(
                [(0.26 * math.cos(a), 0.26 * math.sin(a), 0.0), (0.02 * math.cos(a), 0.02 * math.sin(a), low)],
                [0.011, 0.016],
                6,
            )
            for a in angles
        ]
        stand = [wood(*legs), metal(cylinder((0, 0, low - 0.03), 0.04, 0.05, 10))]
    else:
        x, t = 0.42, np.linspace(0, 1, 9)
        bow = np.stack(
            [x * (1 - np.cos(t * math.pi / 2)), 0 * t, 0.03 + (height + 0.12 - 0.03) * np.sin(t * math.pi / 2)],
            -1,
        )
        low -= 0.12
        base = lathe([(0, 0), (0.15, 0), (0.15, 0), (0.15, 0.03), (0.15, 0.03), (0, 0.03)], 18)
        stand = [metal(base, tube(bow, 0.011, 6), tube([bow[-1], (x, 0, low + 0.6 * tall)], 0.007, 5))]
    shade = _shade([(radius, 0), (taper * radius, tall)], colour, rng, low)
    shade = Part(shade.vertices + np.array([x, 0, 0], dtype=np.float32), shade.triangles, shade.uv, shade.material)
    light = Lamp(np.array([x, 0.0, low + tall + 0.25]), 0.35 * _WARM)
    return assembled("lamp", colour, [*stand, shade], [light])


def ceiling_lamp(colour: str, rng: np.random.Generator) -> Model:
    """A pendant with a shade or a paper globe, or a flat dome; white light over a room."""
    metal = finish("metal", "black" if colour == "black" else None, rng)
    light = Lamp(np.zeros(3), float(rng.uniform(1.5, 1.7)) * _WARM)
    if colour == "white" and rng.random() < 0.5:  # a dome
        radius, deep = rng.uniform(0.17, 0.24), rng.uniform(0.07, 0.1)
        bow = [(radius * math.sin(t), -0.02 - deep * math.cos(t)) for t in np.linspace(0, math.pi / 2, 6)]
        dome = _shade(bow, "white", rng, 0.0)
        rim = cylinder((0, 0, -0.025), radius + 0.012, 0.025, 20)
        return assembled("ceiling lamp", colour, [metal(rim), dome], [_at(light, -deep - 0.25)], "ceiling")
    drop = rng.uniform(0.3, 0.5)
    cord = [
        tube([(0, 0, -drop), (0, 0, -0.03)], 0.004, 4),
        lathe([(0, -0.03), (0.05, -0.03), (0.05, -0.03), (0.05, 0), (0.05, 0), (0, 0)], 12),
    ]
    if colour in ("black", "grey"):  # a metal bell, its bulb seen from below
        radius, tall = rng.uniform(0.16, 0.22), rng.uniform(0.14, 0.2)
        bell = [
            (radius, -drop - tall),
            (0.9 * radius, -drop - 0.6 * tall),
            (0.45 * radius, -drop - 0.1 * tall),
            (0.03, -drop),
            (0, -drop),
        ]
        inside = [(0.2 * radius, -drop - tall * 0.2), (0.97 * radius, -drop - tall * 0.93)]
        shell = finish("metal" if colour == "grey" else "paint", colour, rng)
        bulb = _shade(
            [(0, -0.05), (0.035, -0.035), (0.05, 0), (0.035, 0.035), (0, 0.05)], "white", rng, -drop - 0.75 * tall
        )
        glow = _shade(inside[::-1], "white", rng, 0.0)
        return assembled(
            "ceiling lamp",
            colour,
            [metal(*cord), shell(lathe(bell, 18)), bulb, glow],
            [_at(light, -drop - tall - 0.25)],
            "ceiling",
        )
    radius = rng.uniform(0.17, 0.24)
    if rng.random() < 0.5:  # a globe
        profile = [(radius * math.sin(t), -radius * math.cos(t)) for t in np.linspace(0, math.pi, 11)]
        profile[0], profile[-1], low = (0.0, -radius), (0.0, radius), -drop - 2 * radius
        shade = _shade(profile, colour, rng, -drop - radius)
    else:  # a drum, closed below
        tall = rng.uniform(0.16, 0.24)
        profile, low = [(0, 0.01), (radius, 0.01), (radius, 0.01), (radius, tall)], -drop - 0.6 * tall
        shade = _shade(profile, colour, rng, low)
    return assembled("ceiling lamp", colour, [metal(*cord), shade], [_at(light, low - 0.2)], "ceiling")


def _at(light: Lamp, z: float) -> Lamp:
    return Lamp(np.array([0.0, 0.0, z]), light.power)


def rug(colour: str, rng: np.random.Generator) -> Model:
    """A flat rug, rectangular with a pattern, its length along y, or round with a border."""
    thick = 0.008
    if rng.random() < 0.2:
        radius = rng.uniform(0.65, 1.0)
        pile, border = finish("carpet", colour, rng), finish("carpet", "white" if colour == "beige" else "beige", rng)
        middle = lathe([(0.86 * radius, thick), (0, thick)], 32)
        ring = lathe([(radius, 0), (radius, thick), (radius, thick), (0.86 * radius, thick)], 32)
        return assembled("rug", colour, [pile(middle), border(ring)], placement="flat")
    long = rng.uniform(1.4, 2.4)
    short = long * rng.uniform(0.62, 0.75)
    x, y = short / 2, long / 2
    top = quad([(x, -y, thick), (x, y, thick), (-x, y, thick), (-x, -y, thick)])
    ends = [(x, -y), (x, y), (-x, y), (-x, -y), (x, -y)]
    rim = [quad([(*a, 0), (*b, 0), (*b, thick), (*a, thick)]) for a, b in pairwise(ends)]
    pattern = part(top, material("rug", colour, rng), (long, short))
    return assembled("rug", colour, [pattern, finish("carpet", colour, rng)(*rim)], placement="flat")


def painting(colour: str, rng: np.random.Generator) -> Model:
    """A picture in a frame, with or without a mount, or on bare canvas; `colour` leads in it."""
    look = material("art", colour, rng)
    rows, columns = look.texture.shape[:2] if look.texture is not None else (1, 1)
    scale = math.sqrt(rng.uniform(0.16, 0.7) / (rows * columns))
    y, z, parts = columns * scale / 2, rows * scale / 2, []
    face = 0.022
    picture = quad([(face, -y, -z), (face, y, -z), (face, y, z), (face, -y, z)])
    parts.append(part(picture, look, (2 * y, 2 * z)))
    design = rng.integers(5)
    if design == 0:  # canvas over its stretcher
        edge = box((0, -y, -z), (face - 0.0015, y, z))
        return assembled("painting", colour, [*parts, finish("fabric", "beige", rng)(edge)], placement="hung")
    if design < 3:  # a mount of white card
        mount = rng.uniform(0.05, 0.09)
        parts.append(finish("paint", "white", rng)(*_border(y, z, mount, 0.0, face)))
        y, z = y + mount, z + mount
    bar, deep = rng.uniform(0.018, 0.045), rng.uniform(0.024, 0.04)
    kind, tone = (("wood", None), ("paint", "black"), ("paint", "white"), ("wood", "brown"), ("metal", "yellow"))[
        rng.integers(5)
    ]
    parts.append(finish(kind, tone, rng)(*_border(y, z, bar, 0.0, face + 0.3 * deep)))
    return assembled("painting", colour, parts, placement="hung")


def _border(y: float, z: float, width: float, low: float, high: float) -> list[Mesh]:
    """Four bars round the rectangle with half sides `y`, `z` in the wall's plane, from `low` to `high` along x."""
    return [
        box((low, -y - width, z), (high, y + width, z + width), 1),
        box((low, -y - width, -z - width), (high, y + width, -z), 1),
        box((low, -y - width, -z), (high, -y, z), 2),
        box((low, y, -z), (high, y + width, z), 2),
    ]


def vase(colour: str, rng: np.random.Generator) -> Model:
    """A glazed vase, empty, with flowers or with green twigs."""
    tall, r = rng.uniform(0.16, 0.3), rng.uniform(0.05, 0.085)
    profile = (
        [(0, 0), (0.6 * r, 0), (r, 0.3 * tall), (0.9 * r, 0.55 * tall), (0.4 * r, 0.85 * tall), (0.5 * r, tall)],
        [
            (0, 0),
            (0.5 * r, 0),
            (0.6 * r, 0.1 * tall),
            (r, 0.65 * tall),
            (0.8 * r, 0.85 * tall),
            (0.55 * r, 0.92 * tall),
            (0.6 * r, tall),
        ],
        [(0, 0), (0.75 * r, 0), (0.8 * r, 0.5 * tall), (r, tall)],
    )[rng.integers(3)]
    mouth = profile[-1][0]
    inside = [(mouth, tall), (mouth - 0.006, tall), (0.7 * mouth, 0.75 * tall), (0, 0.7 * tall)]
    parts = [finish("ceramic", colour, rng)(lathe([*profile, *inside], 16))]
    if rng.random() < 0.65:
        n = int(rng.integers(7, 12))
        azimuth, lean = rng.uniform(0, 6.3) + np.arange(n) * 2.4, rng.uniform(0.05, 0.5, n)
        foot = np.array([0, 0, 0.75 * tall])
        reach = rng.uniform(0.2, 0.32, n)
        heads = foot + np.stack(
            [reach * np.sin(lean) * np.cos(azimuth), reach * np.sin(lean) * np.sin(azimuth), reach * np.cos(lean)], -1
        )
        green = finish("leaf", "green", rng)
        stalks = [tube([foot, head], 0.0025, 3) for head in heads]
        size = rng.uniform(0.07, 0.11, n)
        leaves = foliage(foot + 0.65 * (heads - foot), azimuth + 0.8, 1.2 - lean, size, 0.35 * size, 0.9, steps=3)
        parts += [finish("paint", "green", rng)(*stalks), green(leaves)]
        if rng.random() < 0.7:
            petals = 6
            at, turn = np.repeat(heads, petals, axis=0), np.tile(np.arange(petals) * 2 * math.pi / petals, n)
            length = np.full(len(at), rng.uniform(0.028, 0.04))
            bloom = foliage(
                at,
                turn + np.repeat(azimuth, petals),
                np.full(len(at), 0.7),
                length,
                0.7 * length,
                0.8,
                steps=2,
                fold=0.1,
            )
            parts.append(
                finish("paint", str(rng.choice(["red", "pink", "yellow", "white", "purple", "orange"])), rng)(bloom)
            )
            eye = lathe([(0.009, 0), (0.008, 0.006), (0, 0.008)], 6)
            parts.append(finish("paint", "yellow", rng)(*(moved(eye, head) for head in heads)))
    return assembled("vase", colour, parts, placement="top")


BUILDERS: dict[str, Builder] = {
    "plant": plant, "lamp": lamp, "rug": rug, "painting": painting, "ceiling lamp": ceiling_lamp, "vase": vase,
}  # fmt: skip
