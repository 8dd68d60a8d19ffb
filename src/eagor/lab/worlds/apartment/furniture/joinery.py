"""Furniture to put things on or into, to sit and to lie on: wood and upholstery; and common joinery.

The model frame is that of `eagor.lab.worlds.apartment.furniture.Model`, before its origin is moved: fronts face +x.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.apartment.mesh import Cover, Mesh, Part, bevelled, board, box, cushion, finish, post, tube
from eagor.lab.worlds.apartment.textures import SPINES, material
from eagor.sphere import rotation

Rectangle = tuple[float, float, float, float]  # x0, y0, x1, y1

WOODS = ("brown", "white", "black", "beige")  # colours of wooden furniture
CLOTHS = ("grey", "beige", "blue", "green", "red", "brown", "black", "white", "orange", "yellow", "purple", "pink")
COVERS = ("white", "grey", "blue", "green", "beige", "red", "purple", "pink", "yellow", "orange", "brown", "black")
_MATTRESS = 2.0  # metres long

# --- common joinery ---------------------------------------------------------------------------------------------------


def timber(colour: str, rng: np.random.Generator) -> Cover:
    """The finish of wooden furniture: visible grain where it is a colour of wood, else mostly paint."""
    grained = colour in ("brown", "beige") or (colour in ("black", "grey") and rng.random() < 0.5)
    return finish("wood" if grained else "paint", colour, rng)


def fittings(rng: np.random.Generator) -> Cover:
    """The finish of handles and metal legs: steel or black."""
    return finish("metal", None if rng.random() < 0.6 else "black", rng)


def polar(radius: np.ndarray | float, azimuth: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Points ``(..., 3)`` at these distances from the z axis, azimuths (radians from +x) and heights."""
    return np.stack(np.broadcast_arrays(radius * np.cos(azimuth), radius * np.sin(azimuth), z), axis=-1)


def leaning(mesh: Mesh, angle: float, about: m.Triple = (0.0, 0.0, 0.0)) -> Mesh:
    """`mesh` turned by `angle` radians about an axis along y through a point; its top goes towards -x."""
    return m.turned(mesh, rotation((0.0, 1.0, 0.0), -angle), about)


def facing(mesh: Mesh, at: tuple[float, float, float]) -> Mesh:
    """A shape made about the z axis, laid over so that its top faces +x, at a point."""
    return m.moved(replace(mesh, vertices=mesh.vertices[:, [2, 0, 1]]), at)  # a rotation keeps the outside


def legs(inset: Rectangle, height: float, size: float, foot: float = 0.0, splay: float = 0.0) -> Mesh:
    """Four square legs under the rectangle `inset` that joins the middles of their tops, metres.

    They measure `size` at the top and `foot` at the floor (0: the same), where they stand `splay` further out.
    """
    x0, y0, x1, y1 = inset
    feet = [(x, y, dx, dy) for x, dx in ((x0, -splay), (x1, splay)) for y, dy in ((y0, -splay), (y1, splay))]
    below = (foot or size, foot or size)
    return m.merged(*(post((x + dx, y + dy, 0), (x, y, height), below, (size, size)) for x, y, dx, dy in feet))


def apron(inset: Rectangle, low: float, high: float, thickness: float = 0.02) -> Mesh:
    """Four boards on edge that join the legs over the rectangle `inset` from `low` to `high`."""
    x0, y0, x1, y1 = inset
    t = thickness / 2
    return m.merged(
        *(box((x0, y - t, low), (x1, y + t, high), grain=0) for y in (y0, y1)),
        *(box((x - t, y0, low), (x + t, y1, high), grain=1) for x in (x0, x1)),
    )


def front(x: float, y0: float, y1: float, z0: float, z1: float, framed: bool = False, grain: int = 2) -> Mesh:
    """A door or the front of a drawer, its back at `x`, facing +x: flat, or a frame round a sunk field."""
    if not framed:
        return bevelled((x, y0, z0), (x + 0.018, y1, z1), 0.004, grain)
    rail = min(0.07, 0.25 * (y1 - y0), 0.25 * (z1 - z0))
    a, b, c, d = y0 + rail, y1 - rail, z0 + rail, z1 - rail
    frame = ((y0, a, z0, z1, 2), (b, y1, z0, z1, 2), (a, b, z0, c, 1), (a, b, d, z1, 1))
    bars = (box((x, left, low), (x + 0.02, right, high), grain) for left, right, low, high, grain in frame)
    return m.merged(*bars, box((x, a, c), (x + 0.009, b, d), 2))


def knob(x: float, y: float, z: float) -> Mesh:
    """A turned knob on a front at `x` that faces +x."""
    r = 0.015
    return facing(m.lathe([(0.45 * r, 0), (r, r), (0.8 * r, 1.6 * r), (0, 1.8 * r)], 8), (x, y, z))


def pull(x: float, y: float, z: float, length: float, upright: bool = False) -> Mesh:
    """A bar handle of `length`, centred at (y, z) on a front at `x` that faces +x."""
    half = np.array([0.0, 0.0, length / 2] if upright else [0.0, length / 2, 0.0])
    middle, out = np.array([x, y, z]), np.array([0.028, 0, 0])
    return tube([middle - half, middle - half + out, middle + half + out, middle + half], 0.006, sides=5)


def add_drawers(
    body: list[Mesh], handles: list[Mesh], x: float, y0: float, y1: float, cuts: np.ndarray | list[float],
    knobs: bool = False,
) -> None:  # fmt: skip
    """Add drawers with the backs of their fronts at `x`, one from each of the heights `cuts` to the next."""
    for z0, z1 in pairwise(cuts):
        grain = 1 if y1 - y0 - 0.012 > z1 - z0 - 0.008 else 2  # along the longer side
        body.append(front(x, y0 + 0.006, y1 - 0.006, z0 + 0.004, z1 - 0.004, grain=grain))
        at = x + 0.018, (y0 + y1) / 2, (z0 + z1) / 2
        handles.append(knob(*at) if knobs else pull(*at, min(0.3 * (y1 - y0), 0.18) + 0.04))


# --- tables, chests and shelves ---------------------------------------------------------------------------------------


def table(colour: str, rng: np.random.Generator) -> list[Part]:
    """A table to eat at: round for up to four, or rectangular, its length along y."""
    height = rng.uniform(0.72, 0.76)
    if rng.random() < 0.35:
        return _round_table(height, rng.uniform(0.45, 0.6), colour, rng)
    return _long_table(rng.uniform(0.78, 0.95), rng.uniform(1.2, 1.8), height, colour, rng)


def coffee_table(colour: str, rng: np.random.Generator) -> list[Part]:
    """A low table, round, or a board with a shelf below; length along y."""
    height = rng.uniform(0.36, 0.46)
    if rng.random() < 0.3:
        return _round_table(height, rng.uniform(0.36, 0.46), colour, rng)
    return _long_table(rng.uniform(0.5, 0.65), rng.uniform(0.9, 1.2), height, colour, rng)


def _round_table(height: float, radius: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A disc on a turned column with a foot, or on three or four legs that lean outwards."""
    wood, low = timber(colour, rng), height - 0.03
    top = m.lathe([(0, low), (radius - 0.01, low), (radius, low + 0.01), (radius, height), (0, height)], 28)
    if rng.random() < 0.4:
        foot = 0.62 * radius
        column = [(0, 0), (foot, 0), (foot, 0.02), (0.3 * foot, 0.06), (0.045, 0.16), (0.045, low - 0.08), (0.16, low)]
        return [wood(top, m.lathe(column, 20))]
    angles = rng.uniform(0, math.pi) + np.linspace(0, 2 * math.pi, 4 if radius < 0.5 else 5)[:-1]
    made = [tube([polar(0.86 * radius, a, 0), polar(0.6 * radius, a, low)], [0.015, 0.027], 8) for a in angles]
    return [wood(top, *made, m.cylinder((0, 0, low - 0.05), 0.66 * radius, 0.05, 20))]


def _long_table(depth: float, width: float, height: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A rectangular top on four legs with an apron, or on a metal frame; low ones have a shelf."""
    wood, thick, inset = timber(colour, rng), rng.uniform(0.028, 0.045), rng.uniform(0.05, 0.1)
    x, y, low = depth / 2, width / 2, height - thick
    if rng.random() < 0.4:
        top = m.prism(m.rounded_rectangle(depth, width, rng.uniform(0.05, 0.16)), low, height, grain=1)
    else:
        top = bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)
    under = (-x + inset, -y + inset, x - inset, y - inset)
    tops = [top] if height > 0.5 else [top, box((0.04 - x, 0.04 - y, 0.12), (x - 0.04, y - 0.04, 0.14), grain=1)]
    if rng.random() < 0.75:
        size, taper = rng.uniform(0.05, 0.08), 1.0 if rng.random() < 0.5 else 0.6
        return [wood(*tops, legs(under, low, size, taper * size), apron(under, low - 0.06, low))]
    metal = finish("metal", "black" if colour != "black" else None, rng)
    frame = legs(under, low, 0.05), apron(under, low - 0.05, low, 0.05), apron(under, 0, 0.05, 0.05)
    return [wood(*tops), metal(*frame)]


def _chest(
    colour: str, rng: np.random.Generator, depth: float, width: float, foot: float, height: float, grid: tuple[int, int]
) -> list[Part]:
    """Drawers in columns and rows between a top and feet, or a plinth where `foot` is 0."""
    wood, metal, knobs = timber(colour, rng), fittings(rng), rng.random() < 0.4
    x, y, top = depth / 2, width / 2, height - 0.025
    body = [bevelled((-x, -y - 0.01, top), (x + 0.004, y + 0.01, height), 0.006, grain=1)]
    body.append(box((-x, -y, foot), (x - 0.018, y, top), 1))
    if foot:
        body.append(legs((-x + 0.05, -y + 0.05, x - 0.06, y - 0.05), foot, 0.045, 0.03, rng.uniform(0, 0.025)))
    handles: list[Mesh] = []
    for y0, y1 in pairwise(np.linspace(-y, y, grid[0] + 1)):
        cuts = np.linspace(foot or 0.06, top - 0.006, grid[1] + 1)
        add_drawers(body, handles, x - 0.018, y0, y1, cuts, knobs)
    return [wood(*body), metal(*handles)]


def nightstand(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bedside table of one to three drawers, on legs or on a plinth."""
    foot, height = rng.uniform(0.1, 0.2) if rng.random() < 0.6 else 0.0, rng.uniform(0.46, 0.58)
    grid = 1, int(rng.integers(1, 4))
    return _chest(colour, rng, rng.uniform(0.34, 0.42), rng.uniform(0.4, 0.52), foot, height, grid)


def dresser(colour: str, rng: np.random.Generator) -> list[Part]:
    """A chest of drawers in one to three columns, on feet or a plinth."""
    columns, rows = ((1, 4), (2, 3), (2, 4), (3, 3))[rng.integers(4)]
    foot = rng.uniform(0.08, 0.16) if rng.random() < 0.6 else 0.0
    width = columns * rng.uniform(0.46, 0.52) + (0.22 if columns == 1 else 0)
    height = foot + rows * rng.uniform(0.19, 0.23) + 0.06
    return _chest(colour, rng, rng.uniform(0.42, 0.5), width, foot, height, (columns, rows))


def desk(colour: str, rng: np.random.Generator) -> list[Part]:
    """A desk with a block of drawers under one end or both; who works at it sits at +x."""
    wood, metal, knobs = timber(colour, rng), fittings(rng), rng.random() < 0.4
    depth, width, height = rng.uniform(0.58, 0.7), rng.uniform(1.15, 1.5), rng.uniform(0.72, 0.76)
    x, y, low, block = depth / 2, width / 2, height - 0.03, rng.uniform(0.34, 0.42)
    floor, side = 0.14 if rng.random() < 0.4 else 0.0, -1 if rng.random() < 0.5 else 1
    body = [bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)]
    body.append(box((-x + 0.05, -y + 0.05, low - 0.32), (-x + 0.065, y - 0.05, low), grain=1))  # closes the back
    handles: list[Mesh] = []
    for sign in (side, -side) if width > 1.4 and rng.random() < 0.5 else (side,):
        a, b = sorted((sign * (y - 0.02), sign * (y - 0.02 - block)))
        body.append(box((-x + 0.03, a, floor), (x - 0.04, b, low), grain=2))
        cuts = np.linspace(floor + 0.015, low - 0.01, int(rng.integers(3, 5)))
        add_drawers(body, handles, x - 0.04, a, b, cuts, knobs)
    return [wood(*body, legs((-x + 0.06, -y + 0.06, x - 0.08, y - 0.06), low, 0.045, 0.03)), metal(*handles)]


def tv(colour: None, rng: np.random.Generator) -> list[Part]:
    """A flat screen on a low stand, on its foot or hung on the wall above it; off, or showing a dim picture.

    It has no colour: the set is black, but its stand, which is larger, is not.
    """
    case, wood = finish("plastic", "black", rng), timber(str(rng.choice(WOODS)), rng)
    wide, hung = rng.uniform(0.95, 1.4), rng.random() < 0.4
    x, y, low = rng.uniform(0.38, 0.44) / 2, (wide + rng.uniform(0.15, 0.5)) / 2, rng.uniform(0.4, 0.52)
    z = low + (rng.uniform(0.22, 0.32) if hung else 0.07)
    half, high = wide / 2, z + wide * 9 / 16
    back = -x + (0.02 if hung else 0.15)
    body = [bevelled((back, -half, z), (back + 0.045, half, high), 0.008)]
    if hung:
        tall = wide * 9 / 16
        body.append(box((-x, -0.2, z + 0.3 * tall), (back, 0.2, z + 0.7 * tall)))
    else:
        body.append(bevelled((back - 0.09, -0.18, low), (back + 0.14, 0.18, low + 0.015), 0.006))
        body.append(box((back + 0.005, -0.05, low), (back + 0.03, 0.05, z + 0.02)))
    rim, face, foot = 0.014, back + 0.045 + 0.0015, rng.uniform(0.06, 0.14)
    a, b, c, d = -half + rim, half - rim, z + rim + 0.008, high - rim
    screen = m.quad([(face, a, c), (face, b, c), (face, b, d), (face, a, d)])
    shelf = [
        bevelled((-x, -y, low - 0.022), (x, y, low), 0.005, grain=1),
        legs((-x + 0.05, -y + 0.08, x - 0.05, y - 0.08), foot, 0.04, 0.028, 0.01),
        box((-x, -y, foot), (x - 0.02, y, low - 0.022), 1),
    ]
    handles: list[Mesh] = []
    for y0, y1 in pairwise(np.linspace(-y, y, 4)):
        add_drawers(shelf, handles, x - 0.02, y0, y1, [foot, low - 0.024])
    look = material("screen", None, rng)
    return [case(*body), m.part(screen, look, (b - a, d - c)), wood(*shelf), finish("metal", None, rng)(*handles)]


def wardrobe(colour: str, rng: np.random.Generator) -> list[Part]:
    """Two to four tall doors, flat or framed, some with drawers below; one may be a mirror."""
    wood, metal, doors = timber(colour, rng), fittings(rng), int(rng.integers(2, 5))
    depth, width, height = rng.uniform(0.56, 0.62), doors * rng.uniform(0.44, 0.52), rng.uniform(1.95, 2.2)
    x, y, framed, low = depth / 2, width / 2, rng.random() < 0.5, 0.08
    body = [box((-x, -y, 0), (x - 0.024, y, height - 0.03), 2)]
    body.append(bevelled((-x, -y - 0.02, height - 0.03), (x + 0.015, y + 0.02, height), 0.006, grain=1))
    handles: list[Mesh] = []
    glass: list[Part] = []
    if rng.random() < 0.35:
        low += rng.uniform(0.26, 0.36)
        for y0, y1 in ((-y + 0.004, 0), (0, y - 0.004)):
            add_drawers(body, handles, x - 0.024, y0, y1, [0.08, low - 0.004])
    mirror = 1 if doors > 2 and rng.random() < 0.4 else -1
    for k, (y0, y1) in enumerate(pairwise(np.linspace(-y + 0.004, y - 0.004, doors + 1))):
        body.append(front(x - 0.024, y0 + 0.003, y1 - 0.003, low, height - 0.036, framed))
        if k == mirror:
            pane = box((x - 0.01, y0 + 0.05, low + 0.06), (x + 0.001, y1 - 0.05, height - 0.1))
            glass = [finish("glass", None, rng)(pane)]
        handles.append(pull(x - 0.006, y1 - 0.045 if k % 2 == 0 else y0 + 0.045, 1.05, 0.24, upright=True))
    return [wood(*body), metal(*handles), *glass]


def bookshelf(colour: str, rng: np.random.Generator) -> list[Part]:
    """Open shelves with books, upright and in piles, gaps, and a vase here and there."""
    wood, t, columns = timber(colour, rng), 0.022, 1 if rng.random() < 0.7 else 2
    depth, height = rng.uniform(0.27, 0.34), rng.uniform(1.25, 2.1)
    width = columns * (rng.uniform(0.7, 0.95) if columns == 1 else rng.uniform(0.5, 0.65))
    rows, x, y = max(3, round(height / 0.34)), depth / 2, width / 2
    levels = np.linspace(0.06, height - t, rows + 1)
    body, sides = [box((-x, -y, 0), (-x + 0.012, y, height), 2)], np.linspace(-y + t / 2, y - t / 2, columns + 1)
    body += [box((-x, s - t / 2, 0), (x, s + t / 2, height), 2) for s in sides]
    body += [box((-x, -y + t / 2, z), (x - 0.004, y - t / 2, z + t), 1) for z in levels]
    body.append(box((-x + 0.02, -y + t / 2, 0), (x - 0.02, y - t / 2, 0.06), 1))
    books, vases = [], []
    for left, right in pairwise(sides):
        for z, ceiling in zip(levels[:-1] + t, levels[1:], strict=True):
            at, end, edge = left + t / 2, right - t / 2, x - rng.uniform(0.015, 0.035)
            while at < end - 0.06:
                choice, tall = rng.random(), min(rng.uniform(0.2, 0.3), ceiling - z - 0.02)
                if choice < 0.1:
                    at += rng.uniform(0.05, 0.16)
                elif choice < 0.2 and end - at > 0.24:  # a pile
                    for k in range(int(rng.integers(2, 5))):
                        books.append(((edge - 0.15, at, z + 0.03 * k), (edge, at + 0.21, z + 0.03 * k + 0.029)))
                    at += 0.25
                elif choice < 0.26 and end - at > 0.2:
                    profile = [(0, 0), (0.04, 0), (0.06, 0.08), (0.025, 0.16), (0.033, 0.2)]
                    vases.append(m.moved(m.lathe(profile, 10), (0, at + 0.09, z)))
                    at += 0.19
                else:
                    for thick in rng.uniform(0.022, 0.05, int(rng.integers(4, 11))):
                        if at + thick < end:
                            high = z + tall * rng.uniform(0.86, 1.0)
                            books.append(((edge - 0.18, at + 0.001, z), (edge, at + thick - 0.001, high)))
                            at += thick
                    at += 0.01
    low, high = np.moveaxis(np.array(books), 1, 0)
    parts = [wood(*body), _bound(low, high, rng)]
    if vases:
        parts.append(finish("ceramic", str(rng.choice(["white", "blue", "green", "orange"])), rng)(*vases))
    return parts


def _bound(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Part:
    """Books between corners ``(n, 3)``: a spine each, the cloth at both sides, cut pages on top; no back, no bottom."""
    faces = m.CORNERS[:, ::-1][[[1, 3, 7, 5], [3, 2, 6, 7], [0, 1, 5, 4], [5, 7, 6, 4]]]  # front, right, left, top
    place = np.where(faces.reshape(16, 3), high[:, None], low[:, None]).reshape(-1, 3)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    plain = unit * [0.1, 0.2] + [0.04, 0.3]  # a piece of the cloth
    size = high - low
    flat = size[:, 2] < size[:, 1]
    uv = np.tile(np.stack([unit, plain, plain, unit]), (len(low), 1, 1, 1))
    slices = np.where(np.arange(4) == 3, SPINES, rng.integers(0, SPINES, (len(low), 1)))
    uv[flat, 0] = unit[[1, 2, 3, 0]]  # the title runs along a lying book, which shows its cover on top
    uv[flat, 3], slices[flat, 3] = plain, slices[flat, 0]
    uv[..., 0] = (slices[..., None] + 0.04 + 0.92 * uv[..., 0]) / (SPINES + 1)
    triangles, look = m.quad_triangles(4 * len(low)), material("books", None, rng)
    return Part(place.astype(np.float32), triangles, uv.reshape(-1, 2)[triangles].astype(np.float32), look)


def book(colour: str, rng: np.random.Generator) -> list[Part]:
    """A pile of one to four books, the uppermost of the colour, covers of cloth round white pages."""
    z, parts = 0.0, []
    for k in reversed(range(int(rng.integers(1, 5)))):
        thick, deep, wide = rng.uniform(0.02, 0.04), rng.uniform(0.13, 0.18), rng.uniform(0.19, 0.25)
        cover = finish("paint", colour if k == 0 else str(rng.choice(["blue", "grey", "beige", "red", "black"])), rng)
        x, y, top = deep / 2, wide / 2, z + thick
        lids = [box((-x, -y, a), (x, y, a + 0.003)) for a in (z, top - 0.003)]
        pages = box((-x + 0.004, -y + 0.004, z + 0.002), (x - 0.002, y - 0.004, top - 0.002))
        parts += [cover(*lids, box((x - 0.003, -y, z), (x, y, top))), finish("paint", "white", rng)(pages)]
        z = top
    return parts


# --- seats and beds ---------------------------------------------------------------------------------------------------


def chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A chair: wooden, upholstered or a moulded shell."""
    design, woody = rng.random(), colour in ("brown", "beige")
    w, d, seat, top = rng.uniform(0.42, 0.5), rng.uniform(0.42, 0.48), rng.uniform(0.44, 0.48), rng.uniform(0.82, 0.98)
    x, y, lean = d / 2, w / 2, rng.uniform(0.05, 0.1)
    if design < (0.8 if woody else 0.3):
        return _wooden(colour, rng, x, y, seat, top, lean)
    if design < 0.65 or woody:
        cover, power, thick = _cloth(colour, rng), 5.0, rng.uniform(0.08, 0.11)
    else:
        cover, power, thick, top = finish("plastic", colour, rng), 6.0, 0.05, min(top, 0.86)
    back = cushion((-x - 0.02, -y, seat - 0.03), (-x + thick - 0.03, y, top), power)
    wood = timber("brown" if colour != "brown" else "black", rng) if rng.random() < 0.7 else fittings(rng)
    under = legs((0.06 - x, 0.06 - y, x - 0.06, y - 0.06), seat - 0.6 * thick, 0.036, 0.024, rng.uniform(0.0, 0.05))
    cushions = cushion((-x, -y, seat - thick), (x, y, seat), power), leaning(back, lean + 0.1, (-x, 0, seat))
    return [cover(*cushions), wood(under)]


def _wooden(
    colour: str, rng: np.random.Generator, x: float, y: float, seat: float, top: float, lean: float
) -> list[Part]:
    """Four legs, a solid seat, and a back of upright slats, of cross rails, or of spindles."""
    size, foot = rng.uniform(0.032, 0.042), rng.uniform(0.024, 0.04)
    u, v = x - size / 2, y - size / 2

    def back(side: float, z: float) -> tuple[float, float, float]:
        return -u - lean * (z - seat) / (top - seat), side, z

    def rail(z: float, height: float) -> Mesh:
        behind, _, _ = back(0, z)
        return board((behind - 0.011, -v, z - height / 2), (behind + 0.011, v, z + height / 2))

    meshes = [bevelled((-x, -y, seat - 0.03), (x + 0.02, y, seat), 0.008, grain=0)]
    for side in (-v, v):
        meshes += [
            post((u + 0.01, side, 0), (u, side, seat - 0.03), (foot, foot), (size, size)),
            post((-u - 0.05, side, 0), (-u, side, seat - 0.03), (foot, foot), (size, size)),
            post(back(side, seat), back(side, top), (size, size), (0.7 * size, 0.8 * size)),
            box((-u, side - 0.009, seat - 0.09), (u, side + 0.009, seat - 0.03), grain=0),
        ]
    meshes += [box((s - 0.009, -v, seat - 0.09), (s + 0.009, v, seat - 0.03), grain=1) for s in (-u, u)]
    design, head, sill = rng.integers(3), top - 0.04, seat + rng.uniform(0.08, 0.14)
    if design == 1:
        return [timber(colour, rng)(*meshes, *(rail(z, 0.055) for z in np.linspace(seat + 0.14, head - 0.01, 3)))]
    for s in np.linspace(-v, v, 7 if design == 0 else 8)[1:-1]:
        low, high = back(s, sill), back(s, head - 0.02)
        meshes.append(post(low, high, (0.012, 0.032), (0.012, 0.032)) if design == 0 else tube([low, high], 0.008, 6))
    return [timber(colour, rng)(*meshes, rail(head, 0.08), rail(sill, 0.04))]


def armchair(colour: str, rng: np.random.Generator) -> list[Part]:
    """An armchair: a small sofa for one, or cushions in a wooden frame."""
    return _seated(colour, 1, rng) if rng.random() < 0.6 else _lounge_chair(colour, rng)


def sofa(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sofa for two or three."""
    return _seated(colour, int(rng.integers(2, 4)), rng)


def _cloth(colour: str, rng: np.random.Generator) -> Cover:
    leather = colour in ("brown", "black", "white", "red", "beige") and rng.random() < 0.35
    return finish("leather" if leather else "fabric", colour, rng)


def _pillow(at: m.Triple, size: m.Triple, lean: float, turn: float = 0.0) -> Mesh:
    """A pillow, thick, wide and tall, that leans back and is turned (radians); the middle of its lower edge is `at`."""
    thick, wide, tall = size
    soft = leaning(cushion((-thick / 2, -wide / 2, 0), (thick / 2, wide / 2, tall), 2.6), lean)
    return m.moved(m.turned(soft, rotation((0.0, 0.0, 1.0), turn)), at)


def _seated(colour: str, seats: int, rng: np.random.Generator) -> list[Part]:
    """A frame with armrests and a back, seat cushions, back cushions, feet and throw pillows."""
    cloth, arm = _cloth(colour, rng), rng.uniform(0.1, 0.2)
    x = (rng.uniform(0.82, 0.95) - (0.06 if seats == 1 else 0.0)) / 2
    y = seats * rng.uniform(0.56, 0.66) / 2  # half of the width between the arms
    foot = rng.uniform(0.12, 0.17) if rng.random() < 0.5 else rng.uniform(0.04, 0.07)
    seat, top = rng.uniform(0.41, 0.46), rng.uniform(0.76, 0.9)
    rest, back = seat + rng.uniform(0.14, 0.2), 0.14
    body = [
        box((-x + 0.02, -y - 0.01, foot), (x - 0.03, y + 0.01, seat - 0.12)),
        bevelled((-x, -y - 0.01, foot), (back - x, y + 0.01, top - 0.06), 0.03),
    ]
    soft = seats < 3 and rng.random() < 0.5
    for a, b in ((-y - arm, -y), (y, y + arm)):
        low, high = (-x, a, foot), (x - 0.01, b, rest)
        body.append(cushion(low, high, 8.0) if soft else bevelled(low, high, 0.03))
    tilt = rng.uniform(0.1, 0.2)
    for a, b in pairwise(np.linspace(-y, y, seats + 1)):
        body.append(cushion((back - x, a + 0.004, seat - 0.14), (x, b - 0.004, seat + 0.02), 6.0))
        plump = cushion((back - x - 0.03, a + 0.006, seat - 0.02), (back - x + 0.15, b - 0.006, top))
        body.append(leaning(plump, tilt, (back - x + 0.06, 0, seat)))
    wood = timber("brown" if rng.random() < 0.6 else "black", rng) if rng.random() < 0.75 else fittings(rng)
    under = (0.08 - x, 0.03 - y - arm / 2, x - 0.08, y + arm / 2 - 0.03)
    parts = [cloth(*body), wood(legs(under, foot + 0.01, 0.05, 0.03 if foot > 0.1 else 0.045))]
    count = int(rng.integers(0, 3)) if seats > 1 else int(rng.random() < 0.4)
    if count:
        other = finish("fabric", str(rng.choice([c for c in CLOTHS if c not in (colour, "brown", "black")])), rng)
        wide, side = rng.uniform(0.36, 0.44), (y - 0.22 if seats > 1 else 0.0)
        size = 0.15, wide, 0.9 * wide
        spots = ((side, -0.35), (-side, 0.35))[:count]
        at = back - x + 0.24, seat + 0.01
        parts.append(other(*(_pillow((at[0], s, at[1]), size, rng.uniform(0.3, 0.5), turn) for s, turn in spots)))
    return parts


def _lounge_chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A wooden frame with armrests that carries a seat cushion and a high, leaning back cushion."""
    cloth, wood = _cloth(colour, rng), timber("brown" if colour != "brown" else "beige", rng)
    w, d, seat, top = rng.uniform(0.58, 0.64), rng.uniform(0.62, 0.7), rng.uniform(0.42, 0.46), rng.uniform(0.84, 0.98)
    x, y, rest, frame = d / 2, w / 2, seat + 0.16, []
    for side in (-y - 0.03, y + 0.03):
        foot, behind = (-x + 0.03, 0.93 * side, seat - 0.16), (-x - 0.22, 0.93 * side, top - 0.1)
        frame += [
            post((x + 0.02, side, 0), (x - 0.03, side, rest), (0.025, 0.03), (0.04, 0.03)),
            post((-x - 0.08, side, 0), (-x + 0.04, side, rest), (0.025, 0.03), (0.04, 0.03)),
            bevelled((-x - 0.04, side - 0.03, rest), (x, side + 0.03, rest + 0.025), 0.01, grain=0),
            post(foot, behind, (0.04, 0.025), (0.03, 0.025)),
        ]
    for a, z in ((x - 0.06, seat - 0.16), (-x + 0.02, seat - 0.18)):
        frame.append(box((a - 0.02, -y - 0.03, z), (a + 0.02, y + 0.03, z + 0.05), grain=1))
    plump = leaning(cushion((-x + 0.02, -y, seat - 0.12), (x, y, seat + 0.03)), 0.08)
    back = cushion((-x - 0.08, -y + 0.005, seat - 0.02), (-x + 0.06, y - 0.005, top + 0.03))
    back = leaning(back, rng.uniform(0.3, 0.42), (-x + 0.06, 0, seat))
    return [cloth(plump, back), wood(*frame)]


def bed(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bed for one or two; `colour` is that of the cover."""
    width = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8]))
    rail, height = rng.uniform(0.2, 0.3), rng.uniform(0.44, 0.54)
    wood = colour if colour in WOODS and rng.random() < 0.7 else str(rng.choice(WOODS))
    x, y, joiner = _MATTRESS / 2, width / 2 + 0.03, timber(wood, rng)
    frame = [
        *(board((-x, s - 0.015, rail - 0.1), (x + 0.03, s + 0.015, rail + 0.05)) for s in (-y + 0.015, y - 0.015)),
        board((x, -y, rail - 0.1), (x + 0.03, y, rail + 0.05)),
        box((-x, -y + 0.02, rail - 0.06), (x, y - 0.02, rail), grain=0),
        legs((-x + 0.1, -y + 0.04, x - 0.01, y - 0.04), rail - 0.05, 0.06, 0.045),
    ]
    top = height + rng.uniform(0.35, 0.52)
    if rng.random() < 0.4:  # a padded headboard
        cloth = finish("fabric", colour if rng.random() < 0.8 else "grey", rng)
        pads = pairwise(np.linspace(-y, y, 3 if width < 1.2 else 5))
        soft = (bevelled((-x - 0.04, a, 0.3), (-x + 0.04, b, top), 0.025) for a, b in pads)
        head = cloth(box((-x - 0.06, -y, 0), (-x - 0.02, y, top - 0.02)), *soft)
    else:
        head = joiner(bevelled((-x - 0.05, -y, 0), (-x, y, top), 0.015, grain=1))
    white, cloth = finish("fabric", "white", rng), finish("fabric", colour, rng)
    # The sides hang over the rails, so that the cover is most of what is visible.
    start, hang = -x + rng.uniform(0.48, 0.6), min(height - rail + rng.uniform(0.02, 0.1), 0.7 * height)
    mattress = bevelled((-x + 0.005, -width / 2, rail), (x - 0.005, width / 2, height), 0.035)
    cover = bevelled((start, -y - 0.03, height - hang), (x + 0.05, y + 0.03, height + 0.045), 0.04)
    fold = bevelled((start - 0.03, -y - 0.04, height - hang + 0.03), (start + 0.28, y + 0.04, height + 0.07), 0.035)
    linen = white if (rng.random() < 0.4 and wood != "white") or colour == "white" else cloth
    reverse = finish("fabric", "beige", rng) if colour == "white" else white
    size, lean = (0.17, min(0.7, 0.46 * width + 0.2), 0.46), rng.uniform(0.8, 1.15)
    at = -x + 0.09 + 0.46 * np.sin(lean), height + 0.06
    pillows = [_pillow((at[0], s, at[1]), size, lean) for s in ((-width / 4, width / 4) if width > 1.2 else (0.0,))]
    parts = [head, joiner(*frame), cloth(cover), reverse(fold), white(mattress), linen(*pillows)]
    if rng.random() < 0.4:
        other = str(rng.choice([name for name in COVERS if name not in (colour, "white", "black")]))
        at, wide = (start + 0.1, rng.uniform(-0.1, 0.1) * width, height + 0.07), rng.uniform(0.34, 0.4)
        parts.append(finish("fabric", other, rng)(_pillow(at, (0.13, wide, 0.9 * wide), 0.7)))
    return parts
