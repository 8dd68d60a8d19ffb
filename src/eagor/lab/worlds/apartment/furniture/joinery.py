"""Wooden furniture: tables, desks, nightstands, dresser, wardrobes, bookshelves, cabinets, stands of televisions."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import apron, finish, fittings, knob, legs, panel, polar, pull, timber
from eagor.lab.worlds.apartment.mesh import (
    Mesh,
    Part,
    bevelled,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    part,
    prism,
    quad,
    quad_triangles,
    rounded_rectangle,
    tube,
)
from eagor.lab.worlds.apartment.pictures import SPINES
from eagor.lab.worlds.apartment.textures import material


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
    top = lathe([(0, low), (radius - 0.01, low), (radius, low + 0.01), (radius, height), (0, height)], 28)
    if rng.random() < 0.4:
        foot = 0.62 * radius
        column = [(0, 0), (foot, 0), (foot, 0.02), (0.3 * foot, 0.06), (0.045, 0.16), (0.045, low - 0.08), (0.16, low)]
        return [wood(top, lathe(column, 20))]
    angles = rng.uniform(0, math.pi) + np.linspace(0, 2 * math.pi, 4 if radius < 0.5 else 5)[:-1]
    made = [tube([polar(0.86 * radius, a, 0), polar(0.6 * radius, a, low)], [0.015, 0.027], 8) for a in angles]
    return [wood(top, *made, cylinder((0, 0, low - 0.05), 0.66 * radius, 0.05, 20))]


def _long_table(depth: float, width: float, height: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A rectangular top on four legs with an apron, or on a metal frame; low ones have a shelf."""
    wood, thick, inset = timber(colour, rng), rng.uniform(0.028, 0.045), rng.uniform(0.05, 0.1)
    x, y, low = depth / 2, width / 2, height - thick
    if rng.random() < 0.4:
        top = prism(rounded_rectangle(depth, width, rng.uniform(0.05, 0.16)), low, height, grain=1)
    else:
        top = bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)
    under = (-x + inset, -y + inset, x - inset, y - inset)
    tops = [top] if height > 0.5 else [top, box((0.04 - x, 0.04 - y, 0.12), (x - 0.04, y - 0.04, 0.14), grain=1)]
    if rng.random() < 0.75:
        size, taper = rng.uniform(0.05, 0.08), 1.0 if rng.random() < 0.5 else 0.6
        return [wood(*tops, legs(under, low, size, taper * size), apron(under, low - 0.06, low))]
    metal = finish("metal", "black" if colour != "black" else None, rng)
    return [
        wood(*tops),
        metal(legs(under, low, 0.05), apron(under, low - 0.05, low, 0.05), apron(under, 0, 0.05, 0.05)),
    ]


def front(x: float, y0: float, y1: float, z0: float, z1: float, framed: bool) -> Mesh:
    """A door's face at `x` towards +x, its grain upright: flat, or a frame round a sunk field."""
    if not framed:
        return bevelled((x, y0, z0), (x + 0.018, y1, z1), 0.004, grain=2)
    rail = min(0.07, 0.25 * (y1 - y0), 0.25 * (z1 - z0))
    a, b, c, d = y0 + rail, y1 - rail, z0 + rail, z1 - rail
    frame = ((y0, a, z0, z1, 2), (b, y1, z0, z1, 2), (a, b, z0, c, 1), (a, b, d, z1, 1))
    bars = (box((x, left, low), (x + 0.02, right, high), grain) for left, right, low, high, grain in frame)
    return merged(*bars, box((x, a, c), (x + 0.009, b, d), 2))


def drawers(x: float, y0: float, y1: float, cuts: np.ndarray, knobs: bool) -> tuple[list[Mesh], list[Mesh]]:
    """Fronts of drawers with their backs at `x`, one from each of the heights `cuts` to the next; and their handles."""
    fronts, handles = [], []
    for z0, z1 in pairwise(cuts):
        fronts.append(panel(x, y0 + 0.006, y1 - 0.006, z0 + 0.004, z1 - 0.004))
        at = x + 0.018, (y0 + y1) / 2, (z0 + z1) / 2
        handles.append(knob(*at) if knobs else pull(*at, min(0.3 * (y1 - y0), 0.18) + 0.04))
    return fronts, handles


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
    handles = []
    for y0, y1 in pairwise(np.linspace(-y, y, grid[0] + 1)):
        made = drawers(x - 0.018, y0, y1, np.linspace(foot or 0.06, top - 0.006, grid[1] + 1), knobs)
        body += made[0]
        handles += made[1]
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
    wood, handle, knobs = timber(colour, rng), fittings(rng), rng.random() < 0.4
    depth, width, height = rng.uniform(0.58, 0.7), rng.uniform(1.15, 1.5), rng.uniform(0.72, 0.76)
    x, y, low, block = depth / 2, width / 2, height - 0.03, rng.uniform(0.34, 0.42)
    floor, side = 0.14 if rng.random() < 0.4 else 0.0, -1 if rng.random() < 0.5 else 1
    body = [bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)]
    body.append(box((-x + 0.05, -y + 0.05, low - 0.32), (-x + 0.065, y - 0.05, low), grain=1))  # closes the back
    pulls: list[Mesh] = []
    for sign in (side, -side) if width > 1.4 and rng.random() < 0.5 else (side,):
        a, b = sorted((sign * (y - 0.02), sign * (y - 0.02 - block)))
        body.append(box((-x + 0.03, a, floor), (x - 0.04, b, low), grain=2))
        made = drawers(x - 0.04, a, b, np.linspace(floor + 0.015, low - 0.01, int(rng.integers(3, 5))), knobs)
        body, pulls = body + made[0], pulls + made[1]
    under = (-x + 0.06, -y + 0.06, x - 0.08, y - 0.06)
    return [wood(*body, legs(under, low, 0.045, 0.03)), handle(*pulls)]


def tv(colour: None, rng: np.random.Generator) -> list[Part]:
    """A flat screen on a low stand, on its foot or hung on the wall above it; off, or showing a dim picture.

    It has no colour: the set is black, but its stand, which is larger, is not.
    """
    case, stand = finish("plastic", "black", rng), timber(str(rng.choice(["brown", "white", "black", "beige"])), rng)
    wide, hung = rng.uniform(0.95, 1.4), rng.random() < 0.4
    tall, depth, width, low = (
        wide * 9 / 16,
        rng.uniform(0.38, 0.44),
        wide + rng.uniform(0.15, 0.5),
        rng.uniform(0.4, 0.52),
    )
    x, y = depth / 2, width / 2
    z = low + (rng.uniform(0.22, 0.32) if hung else 0.07)
    at = -x + (0.02 if hung else 0.15)  # the back of the set
    front_x = at + 0.045
    body = [bevelled((at, -wide / 2, z), (front_x, wide / 2, z + tall), 0.008)]
    if hung:
        body.append(box((-x, -0.2, z + 0.3 * tall), (at, 0.2, z + 0.7 * tall)))
    else:
        body.append(bevelled((at - 0.09, -0.18, low), (at + 0.14, 0.18, low + 0.015), 0.006))
        body.append(box((at + 0.005, -0.05, low), (at + 0.03, 0.05, z + 0.02)))
    rim, face, foot = 0.014, front_x + 0.0015, rng.uniform(0.06, 0.14)
    a, b, c, d = -wide / 2 + rim, wide / 2 - rim, z + rim + 0.008, z + tall - rim
    screen = quad([(face, a, c), (face, b, c), (face, b, d), (face, a, d)])
    shelf = [
        bevelled((-x, -y, low - 0.022), (x, y, low), 0.005, grain=1),
        legs((-x + 0.05, -y + 0.08, x - 0.05, y - 0.08), foot, 0.04, 0.028, 0.01),
        box((-x, -y, foot), (x - 0.02, y, low - 0.022), 1),
    ]
    handles = []
    for y0, y1 in pairwise(np.linspace(-y, y, 4)):
        made = drawers(x - 0.02, y0, y1, np.array([foot, low - 0.024]), False)
        shelf, handles = shelf + made[0], handles + made[1]
    look = material("screen", None, rng)
    return [case(*body), part(screen, look, (b - a, d - c)), stand(*shelf), finish("metal", None, rng)(*handles)]


def wardrobe(colour: str, rng: np.random.Generator) -> list[Part]:
    """Two to four tall doors, flat or framed, some with drawers below; one may be a mirror."""
    wood, metal, doors = timber(colour, rng), fittings(rng), int(rng.integers(2, 5))
    depth, width, height = rng.uniform(0.56, 0.62), doors * rng.uniform(0.44, 0.52), rng.uniform(1.95, 2.2)
    x, y, framed, low = depth / 2, width / 2, rng.random() < 0.5, 0.08
    body = [box((-x, -y, 0), (x - 0.024, y, height - 0.03), 2)]
    body.append(bevelled((-x, -y - 0.02, height - 0.03), (x + 0.015, y + 0.02, height), 0.006, grain=1))
    handles, glass = [], []
    if rng.random() < 0.35:
        low += rng.uniform(0.26, 0.36)
        for y0, y1 in ((-y + 0.004, 0), (0, y - 0.004)):
            made = drawers(x - 0.024, y0, y1, np.array([0.08, low - 0.004]), False)
            body, handles = body + made[0], handles + made[1]
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
                    vases.append(moved(lathe(profile, 10), (0, at + 0.09, z)))
                    at += 0.19
                else:
                    for thick in rng.uniform(0.022, 0.05, int(rng.integers(4, 11))):
                        if at + thick < end:
                            high = z + tall * rng.uniform(0.86, 1.0)
                            books.append(((edge - 0.18, at + 0.001, z), (edge, at + thick - 0.001, high)))
                            at += thick
                    at += 0.01
    corners = np.array(books)
    parts = [wood(*body), _bound(corners[:, 0], corners[:, 1], rng)]
    if vases:
        parts.append(finish("ceramic", str(rng.choice(["white", "blue", "green", "orange"])), rng)(*vases))
    return parts


def _bound(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Part:
    """Books between corners ``(n, 3)``: a spine each, the cloth at both sides, cut pages on top; no back, no bottom."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    faces = corners[[[1, 3, 7, 5], [3, 2, 6, 7], [0, 1, 5, 4], [5, 7, 6, 4]]]  # front, right, left, top
    place = np.take_along_axis(np.stack([low, high], axis=1), faces.reshape(1, 16, 3), axis=1).reshape(-1, 3)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    size = high - low
    flat = size[:, 2] < size[:, 1]
    uv = np.broadcast_to(unit, (len(low), 4, 4, 2)).copy()
    uv[flat, 0] = unit[[1, 2, 3, 0]]  # the title runs along a lying book
    uv[:, 1:3] = uv[:, 1:3] * [0.1, 0.2] + [0.04, 0.3]  # the covers: a plain piece of the cloth
    slices = np.where(np.arange(4) == 3, SPINES, rng.integers(0, SPINES, (len(low), 1)))
    slices[flat, 3] = slices[flat, 0]  # a lying book shows its cover on top
    uv[flat, 3] = unit * [0.1, 0.2] + [0.04, 0.3]
    uv[..., 0] = (slices[..., None] + 0.04 + 0.92 * uv[..., 0]) / (SPINES + 1)
    uv = uv.reshape(-1, 4, 2)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)
    look = material("books", None, rng)
    return Part(place.astype(np.float32), quad_triangles(4 * len(low)), uv.astype(np.float32), look)


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


def base_units(x: float, y: float, top: float, rng: np.random.Generator, framed: bool) -> tuple[Mesh, Mesh]:
    """Kitchen base units over [-x, x] x [-y, y] up to `top`, and their handles; doors and blocks of drawers."""
    body = [box((-x, -y, 0.1), (x - 0.02, y, top), 2), box((-x, -y, 0), (x - 0.08, y, 0.1), 1)]
    handles = []
    for k, (y0, y1) in enumerate(pairwise(np.linspace(-y, y, max(1, round(2 * y / 0.52)) + 1))):
        if rng.random() < 0.3:
            made = drawers(x - 0.02, y0, y1, np.array([0.105, 0.4 * top, 0.72 * top, top - 0.005]), False)
            body, handles = body + made[0], handles + made[1]
        else:
            body.append(front(x - 0.02, y0 + 0.003, y1 - 0.003, 0.108, top - 0.008, framed))
            handles.append(pull(x, y1 - 0.05 if k % 2 == 0 else y0 + 0.05, top - 0.16, 0.16, upright=True))
    return merged(*body), merged(*handles)


def cabinet(colour: str, rng: np.random.Generator) -> list[Part]:
    """Kitchen base units under one worktop of stone, wood or dark laminate, with a few jars on it."""
    width, top = rng.uniform(1.0, 2.2), rng.uniform(0.84, 0.88)
    x, y = 0.29, width / 2
    body, handles = base_units(x, y, top, rng, framed=rng.random() < 0.4)
    kind, tone = (("marble", None), ("wood", None), ("marble", "grey"), ("paint", "black"))[rng.integers(4)]
    worktop = bevelled((-x, -y, top), (x + 0.02, y, top + 0.04), 0.006, grain=1)
    cover = finish("wood" if colour == "brown" else "paint", colour, rng)
    parts = [cover(body), fittings(rng)(handles), finish(kind, tone, rng)(worktop)]
    if rng.random() < 0.7:
        at, count = rng.uniform(-y + 0.1, y - 0.5), int(rng.integers(2, 4))
        jars = [cylinder((-x + 0.12, at + 0.13 * k, top + 0.04), 0.05, 0.18 - 0.03 * k, 12) for k in range(count)]
        parts.append(finish("ceramic", str(rng.choice(["white", "red", "beige", "green"])), rng)(*jars))
    return parts
