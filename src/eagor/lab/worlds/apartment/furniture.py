"""Furniture: the models of all categories, each with what builds it; tables, chests, shelves, seats and beds.

Fixtures, lamps, plants and decoration are in `eagor.lab.worlds.apartment.decor`. The frame of a builder is that of
`Model` before its origin is moved: fronts face +x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from eagor.lab.worlds.apartment import decor, textures
from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.scene import Lamp

Generator = np.random.Generator


@dataclass(frozen=True, eq=False)
class Model:
    """A piece of furniture: `parts` and `lamps` in the model frame, metres; its front faces +x, z is up.

    The origin is the centre of the footprint on the floor; for things on a wall, the centre of their back face (parts
    at x >= 0, z about 0); for things on the ceiling, the centre of their top (z <= 0). `colour`: its main colour as a
    plain word, or None; `size` ``(3,)``: extents along x, y, z; `seed`: of its generator.
    """

    category: str
    colour: str | None
    parts: tuple[m.Mesh, ...]
    size: np.ndarray
    lamps: tuple[Lamp, ...]
    seed: int


def build(category: str, colour: str | None, seed: int) -> Model:
    """A piece of furniture in one of the colours of its kind; None if it has none."""
    kind, rng = KINDS[category], np.random.default_rng(seed)
    made = kind.make(colour, rng)
    parts = [piece for piece in made if isinstance(piece, m.Mesh)]
    low, high = m.bounds(parts)
    x, y, z = (low + high) / 2
    hung, ceiling = kind.placement == "hung", kind.placement == "ceiling"
    origin = np.array([low[0] if hung else x, y, z if hung else high[2] if ceiling else low[2]])
    lamps = tuple(Lamp(lamp.position - origin, lamp.power) for lamp in made if isinstance(lamp, Lamp))
    return Model(category, colour, tuple(m.moved(part, -origin) for part in parts), high - low, lamps, seed)


# Ranges of a table's height, of the radius of a round one, and of the depth and the width of another; metres.
_HIGH = (0.72, 0.76), (0.45, 0.6), (0.78, 0.95), (1.2, 1.8)
_LOW = (0.36, 0.46), (0.36, 0.46), (0.5, 0.65), (0.9, 1.2)


def table(
    colour: str, rng: Generator, sizes: Sequence[tuple[float, float]] = _HIGH, round_share: float = 0.35
) -> list[m.Mesh]:
    """A disc on a turned column or on legs that lean outwards, or a board on four legs, its length along y."""
    high, radius, deep, wide = sizes
    height = rng.uniform(*high)
    if rng.random() < round_share:
        r, low = rng.uniform(*radius), height - 0.03
        foot, top = 0.62 * r, m.lathe([(0, low), (r, low + 0.008), (r, height), (0, height)], 28)
        if rng.random() < 0.5:
            column = [(0, 0), (foot, 0), (foot, 0.02), (0.3 * foot, 0.06), (0.045, 0.16), (0.045, low - 0.08)]
            return [m.timber(colour, rng)(top, m.lathe([*column, (0.16, low)], 20))]
        ends = [(m.polar(0.86 * r, a, 0), m.polar(0.6 * r, a, low)) for a in np.arange(4) * math.pi / 2]
        stand = [m.tube(leg, 0.022, 8) for leg in ends]
        return [m.timber(colour, rng)(top, *stand, m.cylinder((0, 0, low - 0.05), 0.66 * r, 0.05, 20))]
    x, y = rng.uniform(*deep) / 2, rng.uniform(*wide) / 2
    low, size, inset = height - rng.uniform(0.028, 0.045), rng.uniform(0.05, 0.08), rng.uniform(0.05, 0.1)
    a, b = x - inset, y - inset
    meshes = [m.bevelled((-x, -y, low), (x, y, height), 0.006, grain=1), m.legs(-a, -b, a, b, low, size, 0.7 * size)]
    meshes += [m.box((-a, s - 0.01, low - 0.06), (a, s + 0.01, low)) for s in (-b, b)]
    meshes += [m.box((s - 0.01, -b, low - 0.06), (s + 0.01, b, low)) for s in (-a, a)]
    if height < 0.5:  # a shelf
        meshes.append(m.box((0.04 - x, 0.04 - y, 0.12), (x - 0.04, y - 0.04, 0.14)))
    return [m.timber(colour, rng)(*meshes)]


def _chest(
    colour: str, rng: Generator, depth: float, foot: float, columns: int, wide: float, cuts: np.ndarray
) -> list[m.Mesh]:
    """Columns of drawers, `wide` each, from one of the heights `cuts` to the next, under a top, on feet."""
    x, y, top = depth / 2, columns * wide / 2, cuts[-1] + 0.006
    body = [m.bevelled((-x, -y - 0.01, top), (x + 0.004, y + 0.01, top + 0.025), 0.006, grain=1)]
    body.append(m.box((-x, -y, foot), (x - 0.018, y, top), 1))
    body.append(m.legs(0.05 - x, 0.05 - y, x - 0.06, y - 0.05, foot, 0.045, 0.03))
    fronts, pulls = m.drawers(x - 0.018, np.linspace(-y, y, columns + 1), cuts)
    return [m.timber(colour, rng)(*body, *fronts), m.fittings(rng)(*pulls)]


def nightstand(colour: str, rng: Generator) -> list[m.Mesh]:
    """A bedside table of one to three drawers."""
    foot, height = rng.uniform(0.04, 0.2), rng.uniform(0.46, 0.58)
    cuts = np.linspace(foot, height - 0.031, int(rng.integers(2, 5)))
    return _chest(colour, rng, rng.uniform(0.34, 0.42), foot, 1, rng.uniform(0.4, 0.52), cuts)


def dresser(colour: str, rng: Generator) -> list[m.Mesh]:
    """A chest of drawers in one to three columns."""
    columns, rows, wide = ((1, 4, 0.7), (2, 3, 0.5), (2, 4, 0.5), (3, 3, 0.48))[rng.integers(4)]
    foot = rng.uniform(0.05, 0.16)
    cuts = foot + np.arange(rows + 1) * rng.uniform(0.19, 0.23)
    return _chest(colour, rng, rng.uniform(0.42, 0.5), foot, columns, wide * rng.uniform(0.95, 1.05), cuts)


def desk(colour: str, rng: Generator) -> list[m.Mesh]:
    """A desk with a block of drawers under one end; who works at it sits at +x."""
    depth, width, height = rng.uniform(0.58, 0.7), rng.uniform(1.15, 1.5), rng.uniform(0.72, 0.76)
    x, y, low, block = depth / 2, width / 2, height - 0.03, rng.uniform(0.34, 0.42)
    y0 = 0.02 - y if rng.random() < 0.5 else y - 0.02 - block
    fronts, pulls = m.drawers(x - 0.04, (y0, y0 + block), np.linspace(0.1, low - 0.01, 4))
    body = [
        m.bevelled((-x, -y, low), (x, y, height), 0.006, grain=1),
        m.box((-x + 0.05, -y + 0.05, low - 0.32), (-x + 0.065, y - 0.05, low), grain=1),  # closes the back
        m.box((-x + 0.03, y0, 0.08), (x - 0.04, y0 + block, low), grain=2),
        m.legs(0.06 - x, 0.06 - y, x - 0.08, y - 0.06, low, 0.045, 0.03),
    ]
    return [m.timber(colour, rng)(*body, *fronts), m.fittings(rng)(*pulls)]


def tv(colour: None, rng: Generator) -> list[m.Mesh]:
    """A flat screen on a low stand or hung on the wall above it; off, or showing a dim picture."""
    half, low, foot = rng.uniform(0.475, 0.7), rng.uniform(0.4, 0.52), rng.uniform(0.06, 0.14)
    x, y, hung = 0.21, half + rng.uniform(0.08, 0.25), rng.random() < 0.4
    z, back = low + (0.27 if hung else 0.07), -x + (0.02 if hung else 0.15)
    high, face, a = z + half * 9 / 8, back + 0.0465, half - 0.014
    bracket = ((-x, -0.2, z + 0.2), (back, 0.2, high - 0.2)), ((-x + 0.1, -0.18, low), (0.05, 0.18, z + 0.02))
    case = m.bevelled((back, -half, z), (back + 0.045, half, high), 0.008), m.box(*bracket[not hung])
    screen = m.quad([(face, -a, z + 0.022), (face, a, z + 0.022), (face, a, high - 0.014), (face, -a, high - 0.014)])
    shelf = [m.bevelled((-x, -y, low - 0.022), (x, y, low), 0.005, grain=1)]
    shelf.append(m.box((-x, -y, foot), (x - 0.02, y, low - 0.022), 1))
    shelf.append(m.legs(0.05 - x, 0.08 - y, x - 0.05, y - 0.08, foot, 0.04, 0.028))
    for y0, y1 in pairwise(np.linspace(-y, y, 4)):
        shelf.append(m.front(x - 0.02, y0 + 0.006, y1 - 0.006, foot + 0.004, low - 0.028))
    black, wood = m.finish("plastic", "black", rng), m.timber(str(rng.choice(WOODS)), rng)
    picture = m.Cover(textures.material("screen", None, rng), (2 * a, high - z - 0.036))
    return [black(*case), picture(screen), wood(*shelf)]


def wardrobe(colour: str, rng: Generator) -> list[m.Mesh]:
    """Two to four tall doors; one may be a mirror."""
    wood, metal, doors = m.timber(colour, rng), m.fittings(rng), int(rng.integers(2, 5))
    depth, width, height = rng.uniform(0.56, 0.62), doors * rng.uniform(0.44, 0.52), rng.uniform(1.95, 2.2)
    x, y = depth / 2, width / 2
    body = [m.box((-x, -y, 0), (x - 0.024, y, height - 0.03), 2)]
    body.append(m.bevelled((-x, -y - 0.02, height - 0.03), (x + 0.015, y + 0.02, height), 0.006, grain=1))
    handles, glass, mirror = [], [], 1 if doors > 2 and rng.random() < 0.4 else -1
    for k, (y0, y1) in enumerate(pairwise(np.linspace(-y, y, doors + 1))):
        body.append(m.front(x - 0.024, y0 + 0.003, y1 - 0.003, 0.08, height - 0.036))
        if k == mirror:
            pane = (x - 0.01, y0 + 0.05, 0.14), (x + 0.001, y1 - 0.05, height - 0.1)
            glass = [m.finish("glass", None, rng)(m.box(*pane))]
        handles.append(m.pull(x - 0.006, y1 - 0.045 if k % 2 == 0 else y0 + 0.045, 1.05, 0.24, upright=True))
    return [wood(*body), metal(*handles), *glass]


def bookshelf(colour: str, rng: Generator) -> list[m.Mesh]:
    """Open shelves with rows of books."""
    t, x, y, height = 0.03, rng.uniform(0.135, 0.17), rng.uniform(0.35, 0.6), rng.uniform(1.25, 2.1)
    levels = np.linspace(0.06, height - t, max(3, round(height / 0.34)) + 1)
    body = [m.box((-x, -y, 0), (-x + 0.012, y, height), 2), m.box((-x + 0.02, t - y, 0), (x - 0.02, y - t, 0.06), 1)]
    body += [m.box((-x, s - t / 2, 0), (x, s + t / 2, height), 2) for s in (t / 2 - y, y - t / 2)]
    body += [m.box((-x, t - y, z), (x - 0.004, y - t, z + t), 1) for z in levels]
    blocks, spines, look = [], [], textures.material("books", None, rng)
    for z, ceiling in zip(levels[:-1] + t, levels[1:], strict=True):
        a = t - y
        while a < y - 0.2:  # some books of one height, then a gap
            b, top = min(a + rng.uniform(0.2, 0.4), y - t), z + min(rng.uniform(0.17, 0.25), ceiling - z - 0.03)
            face, shift = x - rng.uniform(0.015, 0.04), rng.random()
            blocks.append(m.box((-x + 0.012, a, z), (face - 0.001, b, top)))
            spine = m.quad([(face, a, z), (face, b, z), (face, b, top), (face, a, top)])
            uv = spine.uv / [0.56, top - z] + [shift, 0.0]
            spines.append(replace(spine, uv=uv.astype(np.float32)))
            a = b + rng.uniform(0.02, 0.16)
    return [m.timber(colour, rng)(*body), m.finish("paint", "beige", rng)(*blocks), m.Cover(look, 1.0)(*spines)]


def book(colour: str, rng: Generator) -> list[m.Mesh]:
    """A pile of one to three books, the uppermost of the colour, round white pages."""
    z, parts = 0.0, []
    for k in reversed(range(int(rng.integers(1, 4)))):
        x, y, top = rng.uniform(0.065, 0.09), rng.uniform(0.095, 0.125), z + rng.uniform(0.02, 0.04)
        cover = m.finish("paint", colour if k == 0 else str(rng.choice(["blue", "grey", "beige", "red", "black"])), rng)
        lids = [m.box((-x, -y, a), (x, y, a + 0.003)) for a in (z, top - 0.003)]
        pages = m.box((0.004 - x, 0.004 - y, z + 0.002), (x - 0.002, y - 0.004, top - 0.002))
        parts += [cover(*lids, m.box((x - 0.003, -y, z), (x, y, top))), m.finish("paint", "white", rng)(pages)]
        z = top
    return parts


def chair(colour: str, rng: Generator) -> list[m.Mesh]:
    """A wooden chair with slats or rails, or an upholstered one; its back leans."""
    x, y, seat, top = rng.uniform(0.21, 0.24), rng.uniform(0.21, 0.25), rng.uniform(0.44, 0.48), rng.uniform(0.82, 0.98)
    u, v = x - 0.018, y - 0.018
    if rng.random() >= (0.75 if colour in ("brown", "beige") else 0.35):
        soft, back = ((-x, -y, seat - 0.08), (x, y, seat)), ((-x - 0.02, -y, seat - 0.03), (0.05 - x, y, top))
        under = m.timber("brown" if colour != "brown" else "black", rng) if rng.random() < 0.7 else m.fittings(rng)
        stand = under(m.legs(-u, -v, u, v, seat - 0.04, 0.036, 0.024))
        back = m.leaning(m.cushion(*back), 0.17, (-x, 0, seat))
        return [_cloth(colour, rng)(m.cushion(*soft), back), stand]
    slats = rng.random() < 0.6
    back = [m.post((-u, s, seat), (-u, s, top), (0.036, 0.036), (0.025, 0.029)) for s in (-v, v)]
    heights = (top - 0.04, seat + 0.11) if slats else np.linspace(seat + 0.14, top - 0.05, 3)
    back += [m.box((-u - 0.011, -v, z - 0.03), (0.011 - u, v, z + 0.03)) for z in heights]
    for s in np.linspace(-v, v, 7) if slats else ():
        back.append(m.box((-u - 0.006, s - 0.016, seat + 0.11), (0.006 - u, s + 0.016, top - 0.04)))
    base = [m.bevelled((-x, -y, seat - 0.03), (x + 0.02, y, seat), 0.008, grain=0)]
    base.append(m.legs(-u, -v, u, v, seat - 0.03, 0.036))
    base += [m.box((-u, s - 0.009, seat - 0.09), (u, s + 0.009, seat - 0.03)) for s in (-v, v)]
    return [m.timber(colour, rng)(*base, m.leaning(m.merged(*back), 0.14, (-u, 0, seat)))]


def _cloth(colour: str, rng: Generator) -> m.Cover:
    leather = colour in ("brown", "black", "white", "red", "beige") and rng.random() < 0.35
    return m.finish("leather" if leather else "fabric", colour, rng)


def _pillow(at: m.Numbers, size: m.Numbers, lean: float) -> m.Mesh:
    """A pillow, thick, wide and tall, that leans back; the middle of its lower edge is `at`."""
    thick, wide, tall = size
    return m.moved(m.leaning(m.cushion((-thick / 2, -wide / 2, 0), (thick / 2, wide / 2, tall), 2.6), lean), at)


def sofa(colour: str, rng: Generator, seats: int | None = None) -> list[m.Mesh]:
    """A frame with armrests and a back, cushions, feet and throw pillows; for two or three, or an armchair for one."""
    seats = seats or int(rng.integers(2, 4))
    cloth, arm = _cloth(colour, rng), rng.uniform(0.1, 0.2)
    x = (rng.uniform(0.82, 0.95) - (0.06 if seats == 1 else 0.0)) / 2
    y = seats * rng.uniform(0.56, 0.66) / 2  # half of the width between the arms
    foot, seat, top = rng.uniform(0.05, 0.16), rng.uniform(0.41, 0.46), rng.uniform(0.76, 0.9)
    rest, back, soft = seat + rng.uniform(0.14, 0.2), 0.14, seats < 3 and rng.random() < 0.5
    body = [m.box((-x + 0.02, -y - 0.01, foot), (x - 0.03, y + 0.01, seat - 0.12))]
    body.append(m.bevelled((-x, -y - 0.01, foot), (back - x, y + 0.01, top - 0.06), 0.03))
    for a, b in ((-y - arm, -y), (y, y + arm)):
        low, high = (-x, a, foot), (x - 0.01, b, rest)
        body.append(m.cushion(low, high, 8.0) if soft else m.bevelled(low, high, 0.03))
    tilt = rng.uniform(0.1, 0.2)
    for a, b in pairwise(np.linspace(-y, y, seats + 1)):
        body.append(m.cushion((back - x, a + 0.004, seat - 0.14), (x, b - 0.004, seat + 0.02), 6.0))
        plump = m.cushion((back - x - 0.03, a + 0.006, seat - 0.02), (back - x + 0.15, b - 0.006, top))
        body.append(m.leaning(plump, tilt, (back - x + 0.06, 0, seat)))
    wood = m.timber("brown" if rng.random() < 0.6 else "black", rng)
    under = m.legs(0.08 - x, 0.03 - y - arm / 2, x - 0.08, y + arm / 2 - 0.03, foot + 0.01, 0.05, 0.035)
    parts = [cloth(*body), wood(under)]
    count = int(rng.integers(0, 3)) if seats > 1 else int(rng.random() < 0.4)
    if count:
        other = m.finish("fabric", str(rng.choice([c for c in CLOTHS if c not in (colour, "brown", "black")])), rng)
        wide, side = rng.uniform(0.36, 0.44), (y - 0.22 if seats > 1 else 0.0)
        at, size = (back - x + 0.24, seat + 0.01), (0.15, wide, 0.9 * wide)
        parts.append(other(*(_pillow((at[0], s, at[1]), size, 0.4) for s in (side, -side)[:count])))
    return parts


def bed(colour: str, rng: Generator) -> list[m.Mesh]:
    """A bed for one or two, 2 m long; `colour` is that of the cover, and of a padded head."""
    width, rail = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8])), rng.uniform(0.2, 0.3)
    height, wood = rng.uniform(0.44, 0.54), colour if colour in WOODS and rng.random() < 0.7 else str(rng.choice(WOODS))
    x, y, top = 1.0, width / 2 + 0.03, height + rng.uniform(0.35, 0.52)
    frame = [m.box((-x, s - 0.015, rail - 0.1), (x + 0.03, s + 0.015, rail + 0.05)) for s in (-y + 0.015, y - 0.015)]
    frame.append(m.box((x, -y, rail - 0.1), (x + 0.03, y, rail + 0.05)))
    frame.append(m.box((-x, -y + 0.02, rail - 0.06), (x, y - 0.02, rail), 0))
    frame.append(m.legs(0.1 - x, 0.04 - y, x - 0.01, y - 0.04, rail - 0.05, 0.06, 0.045))
    head, padded = m.bevelled((-x - 0.06, -y, 0), (-x, y, top), 0.015, grain=1), rng.random() < 0.4
    joiner, cloth = m.timber(wood, rng), m.finish("fabric", colour, rng)
    linen = m.finish("fabric", "beige" if colour == "white" else "white", rng)
    # The sides hang over the rails, so that the cover is most of what is visible.
    start, hang = -x + rng.uniform(0.48, 0.6), min(height - rail + rng.uniform(0.02, 0.1), 0.7 * height)
    mattress = m.bevelled((-x + 0.005, -width / 2, rail), (x - 0.005, width / 2, height), 0.035)
    cover = m.bevelled((start, -y - 0.03, height - hang), (x + 0.05, y + 0.03, height + 0.045), 0.04)
    fold = m.bevelled((start - 0.03, -y - 0.04, height - hang + 0.03), (start + 0.28, y + 0.04, height + 0.07), 0.035)
    size, lean = (0.17, min(0.7, 0.46 * width + 0.2), 0.46), rng.uniform(0.8, 1.15)
    at, sides = (-x + 0.09 + 0.46 * np.sin(lean), height + 0.06), (-width / 4, width / 4) if width > 1.2 else (0.0,)
    pillows = [_pillow((at[0], side, at[1]), size, lean) for side in sides]
    soft = [linen(fold, mattress, *pillows), cloth(cover, head) if padded else cloth(cover)]
    return [*soft, joiner(*frame) if padded else joiner(*frame, head)]


@dataclass(frozen=True)
class Kind:
    """A category: its choice of main `colours`, empty if none dominates, and what builds a piece in one of them.

    `placement`: "floor", "top" (stands on another piece), "hung" (on a wall) or "ceiling".
    """

    colours: tuple[str, ...]
    make: Callable[[Any, Generator], Sequence[m.Mesh | Lamp]]  # the colour is None if there are none
    placement: str = "floor"


WOODS = ("brown", "white", "black", "beige")  # colours of wooden furniture
CLOTHS = ("grey", "beige", "blue", "green", "red", "brown", "black", "white", "orange", "yellow", "purple", "pink")
_LACQUERED = (*WOODS, "grey", "blue", "green")
KINDS: dict[str, Kind] = {
    "chair": Kind(CLOTHS, chair),
    "armchair": Kind(CLOTHS, partial(sofa, seats=1)),
    "sofa": Kind(CLOTHS, sofa),
    "bed": Kind(CLOTHS, bed),
    "table": Kind(WOODS, table),
    "coffee table": Kind((*WOODS, "grey"), partial(table, sizes=_LOW, round_share=0.3)),
    "desk": Kind((*WOODS, "grey"), desk),
    "nightstand": Kind(_LACQUERED, nightstand),
    "dresser": Kind(_LACQUERED, dresser),
    "wardrobe": Kind((*WOODS, "grey"), wardrobe),
    "bookshelf": Kind(WOODS, bookshelf),
    "cabinet": Kind(("white", "grey", "beige", "brown", "green", "blue"), decor.cabinet),
    "book": Kind(("red", "blue", "green", "brown", "white", "yellow"), book, "top"),
    "refrigerator": Kind(("white", "grey", "black"), decor.refrigerator),
    "stove": Kind(("white", "black", "grey"), decor.stove),
    "sink": Kind(("white", "grey"), decor.sink),
    "toilet": Kind(("white",), decor.toilet),
    "bathtub": Kind(("white",), decor.bathtub),
    "plant": Kind(("green",), decor.plant),
    "lamp": Kind(("white", "beige", "yellow", "orange", "red"), decor.lamp),
    "rug": Kind(tuple(map(str, textures.KINDS["rug"].natural)), decor.rug),
    "painting": Kind(tuple(map(str, textures.KINDS["art"].natural)), decor.painting, "hung"),
    "ceiling lamp": Kind(("white", "beige", "black", "grey"), decor.ceiling_lamp, "ceiling"),
    "vase": Kind(("white", "blue", "green", "red", "yellow", "purple", "pink", "black"), decor.vase, "top"),
    "tv": Kind((), tv),  # the set is black, but its stand, which is larger, is not
}
