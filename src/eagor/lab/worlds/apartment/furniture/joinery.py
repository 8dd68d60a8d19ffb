"""Wooden furniture: tables, desks, nightstands, stands of televisions; dressers, wardrobes, bookshelves, cabinets."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import apron, finish, fittings, knob, legs, panel, polar, pull, timber
from eagor.lab.worlds.apartment.mesh import (
    CORNERS,
    Mesh,
    Part,
    bevelled,
    board,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    part,
    post,
    prism,
    quad,
    quad_triangles,
    tube,
)
from eagor.lab.worlds.apartment.mesh import rounded_rectangle as rounded
from eagor.lab.worlds.apartment.pictures import SPINES
from eagor.lab.worlds.apartment.textures import material


def table(colour: str, rng: np.random.Generator) -> list[Part]:
    """A table to eat at: round for up to four, or rectangular, its length along y."""
    height = rng.uniform(0.72, 0.76)
    if rng.random() < 0.35:
        return _round_table(height, rng.uniform(0.45, 0.6), colour, rng)
    return _long_table(rng.uniform(0.78, 0.95), rng.uniform(1.2, 1.8), height, colour, rng)


def _round_table(height: float, radius: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A disc on a turned column with a foot, or on three or four legs that lean outwards."""
    wood, thick = timber(colour, rng), rng.uniform(0.025, 0.04)
    edge, under = 0.35 * thick, height - thick
    inner = radius - edge
    rim = [(inner, under), (inner, under), (radius, under + edge), (radius, height - edge), (inner, height)]
    top = lathe([(0, under), *rim, (inner, height), (0, height)], 28)
    design, low = rng.integers(3), height - 0.03
    if design == 0:  # a column on a disc
        foot = 0.62 * radius
        column = [
            (0, 0), (foot, 0), (foot, 0), (foot, 0.02), (0.3 * foot, 0.06), (0.045, 0.16), (0.05, 0.5 * low),
            (0.045, low - 0.08), (0.16, low - 0.005), (0.16, low),
        ]  # fmt: skip
        return [wood(top, lathe(column, 20))]
    count = 4 if design == 1 or radius > 0.5 else 3
    turn, made = rng.uniform(0, math.pi), []
    for angle in (turn + 2 * math.pi * k / count for k in range(count)):
        if design == 1:
            ends = [polar(0.86 * radius, angle, 0), polar(0.6 * radius, angle, low)]
            made.append(tube(ends, [0.015, 0.027], 8))
        else:  # feet that meet in a column
            path = [polar(0.8 * radius, angle, 0.02), polar(0.5 * radius, angle, 0.06), polar(0.05, angle, 0.2)]
            made.append(tube(path, [0.025, 0.03, 0.035], 6))
    if design == 1:
        made.append(cylinder((0, 0, low - 0.05), 0.66 * radius, 0.05, 20))
    else:
        made += [cylinder((0, 0, 0.14), 0.055, low - 0.14, 12), cylinder((0, 0, low - 0.02), 0.3 * radius, 0.02, 16)]
    return [wood(top, *made)]


def _long_table(depth: float, width: float, height: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A rectangular top on four legs with an apron, on crossed trestles, on slabs, or on a metal frame."""
    wood, thick = timber(colour, rng), rng.uniform(0.028, 0.045)
    x, y, low = depth / 2, width / 2, height - thick
    if rng.random() < 0.4:
        top = prism(rounded(depth, width, rng.uniform(0.05, 0.16)), low, height, grain=1)
    else:
        top = bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)
    design = rng.integers(5)
    if design <= 1:
        size, inset = rng.uniform(0.05, 0.08), rng.uniform(0.05, 0.1)
        under = (-x + inset, -y + inset, x - inset, y - inset)
        taper, splay = (0.6, rng.uniform(0, 0.04)) if design else (1.0, 0.0)
        return [wood(top, legs(under, low, size, taper * size, splay), apron(under, low - 0.08, low))]
    if design == 2:  # crossed trestles
        bars, thin = [], (0.09, 0.05)
        for s in (-y + 0.22, y - 0.22):
            bars += [post((-t * (x - 0.1), s, 0), (t * (x - 0.12), s, low), thin, thin) for t in (-1, 1)]
        return [wood(top, *bars, box((-0.025, -y + 0.2, low / 2 - 0.04), (0.025, y - 0.2, low / 2 + 0.04), grain=1))]
    if design == 3:  # slabs joined by a stretcher
        ends = (-y + 0.25, y - 0.25)
        slabs = [board((-x + 0.12, s - 0.03, 0.05), (x - 0.12, s + 0.03, low)) for s in ends]
        feet = [bevelled((-x + 0.06, s - 0.045, 0), (x - 0.06, s + 0.045, 0.06), 0.012, grain=0) for s in ends]
        return [wood(top, *slabs, *feet, box((-0.05, -y + 0.25, 0.3), (0.05, y - 0.25, 0.34), grain=1))]
    metal = finish("metal", "black" if colour != "black" else None, rng)
    bar, frames = 0.05, []
    for s in (-y + 0.14, y - 0.14):
        a, b = s - bar / 2, s + bar / 2
        for u in (-1 * (x - 0.1), x - 0.1):
            frames.append(box((u - bar / 2, a, bar), (u + bar / 2, b, low - bar), 2))
        frames += [box((-x + 0.1 - bar / 2, a, z), (x - 0.1 + bar / 2, b, z + bar), 0) for z in (0.0, low - bar)]
    return [wood(top), metal(*frames)]


def coffee_table(colour: str, rng: np.random.Generator) -> list[Part]:
    """A low table: a board with a shelf below, a round one, slabs, or a rounded top on leaning legs; length along y."""
    wood, height = timber(colour, rng), rng.uniform(0.36, 0.46)
    depth, width = rng.uniform(0.5, 0.65), rng.uniform(0.9, 1.2)
    x, y, design = depth / 2, width / 2, rng.integers(4)
    if design == 0:
        under = (-x + 0.05, -y + 0.05, x - 0.05, y - 0.05)
        shelf = box((-x + 0.04, -y + 0.04, 0.12), (x - 0.04, y - 0.04, 0.14), grain=1)
        top = bevelled((-x, -y, height - 0.03), (x, y, height), 0.006, grain=1)
        return [wood(top, legs(under, height - 0.03, 0.05), apron(under, height - 0.08, height - 0.03), shelf)]
    if design == 1:
        return _round_table(height, rng.uniform(0.36, 0.46), colour, rng)
    if design == 2:
        ends = (-y + 0.025, y - 0.025)
        sides = [bevelled((-x, s - 0.025, 0), (x, s + 0.025, height - 0.02), 0.006, grain=0) for s in ends]
        top = bevelled((-x, -y, height - 0.05), (x, y, height), 0.006, grain=1)
        return [wood(top, *sides, box((-x + 0.02, -y + 0.03, 0.14), (x - 0.02, y - 0.03, 0.17), grain=1))]
    outline = rounded(depth, width, 0.5 * depth * rng.uniform(0.4, 1.0), 5)
    top = prism(outline, height - 0.028, height, grain=1)
    under = (-0.5 * x, -0.62 * y, 0.5 * x, 0.62 * y)
    feet = [(u, v) for u in under[::2] for v in under[1::2]]
    made = [tube([(1.5 * u, 1.2 * v, 0), (u, v, height - 0.028)], [0.012, 0.021], 8) for u, v in feet]
    limbs = wood if rng.random() < 0.6 else fittings(rng)
    return [wood(top), limbs(*made, apron(under, height - 0.06, height - 0.028, 0.025))]


def desk(colour: str, rng: np.random.Generator) -> list[Part]:
    """A desk with a block of drawers under one end or both; who works at it sits at +x."""
    wood, handle = timber(colour, rng), fittings(rng)
    depth, width, height = rng.uniform(0.58, 0.7), rng.uniform(1.15, 1.5), rng.uniform(0.72, 0.76)
    x, y, low, block = depth / 2, width / 2, height - 0.03, rng.uniform(0.34, 0.42)
    meshes: list[Mesh] = [bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)]
    pulls: list[Mesh] = []
    raised = rng.random() < 0.4
    floor = 0.14 if raised else 0.0
    both, knobs = width > 1.4 and rng.random() < 0.5, rng.random() < 0.4
    sign = -1 if rng.random() < 0.5 else 1
    for side in (sign, -sign) if both else (sign,):
        a, b = sorted((side * (y - 0.02), side * (y - 0.02 - block)))
        meshes.append(box((-x + 0.03, a, floor), (x - 0.04, b, low), grain=2))
        for z0, z1 in pairwise(np.linspace(floor + 0.015, low - 0.01, int(rng.integers(3, 5)))):
            meshes.append(panel(x - 0.04, a + 0.008, b - 0.008, z0 + 0.004, z1 - 0.004))
            middle = ((a + b) / 2, (z0 + z1) / 2)
            pulls.append(knob(x - 0.022, *middle) if knobs else pull(x - 0.022, *middle, 0.14))
        if raised:
            under = (-x + 0.08, -block / 2 + 0.05, x - 0.09, block / 2 - 0.05)
            meshes.append(moved(legs(under, 0.14, 0.04, 0.025), (0, (a + b) / 2, 0)))
    end = -sign * (y - 0.05)
    if not both and raised:
        meshes += [post((s, end, 0), (s, end, low), (0.026, 0.026), (0.045, 0.045)) for s in (-x + 0.06, x - 0.08)]
    elif not both:
        meshes.append(box((-x + 0.03, end - 0.0125, 0), (x - 0.04, end + 0.0125, low), grain=2))
    meshes.append(box((-x + 0.05, -y + 0.05, low - 0.32), (-x + 0.065, y - 0.05, low), grain=1))  # closes the back
    return [wood(*meshes), handle(*pulls)]


def nightstand(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bedside table: drawers from top to bottom, or a drawer over an open shelf, on legs or on a plinth."""
    wood, handle = timber(colour, rng), fittings(rng)
    depth, width, height = rng.uniform(0.34, 0.42), rng.uniform(0.4, 0.52), rng.uniform(0.46, 0.58)
    x, y, t = depth / 2, width / 2, 0.02
    floor = rng.uniform(0.1, 0.2) if rng.random() < 0.6 else 0.04
    meshes = [bevelled((-x, -y, height - 0.025), (x + 0.01, y, height), 0.006, grain=1)]
    if floor > 0.05:
        meshes.append(legs((-x + 0.05, -y + 0.05, x - 0.05, y - 0.05), floor, 0.038, 0.022, 0.025))
    else:
        meshes.append(box((-x + 0.02, -y + 0.02, 0), (x - 0.04, y - 0.02, floor), grain=1))
    meshes += [box((-x, s - t / 2, floor), (x, s + t / 2, height - 0.025), grain=2) for s in (-y + t, y - t)]
    meshes.append(box((-x, -y + t, floor), (x, y - t, floor + t), grain=1))
    meshes.append(box((-x, -y + t, floor + t), (-x + 0.01, y - t, height - 0.025), grain=1))
    knobs, inner, top, pulls = rng.random() < 0.5, y - 1.5 * t, height - 0.03, []
    drawers = int(rng.integers(1, 4))
    for z1, z0 in pairwise(np.linspace(top, floor + t, drawers + 1) if drawers > 1 else np.array([top, top - 0.15])):
        meshes.append(panel(x - 0.014, -inner + 0.003, inner - 0.003, z0 + 0.004, z1 - 0.004))
        meshes.append(box((-x + 0.01, -inner, z0), (x - 0.014, inner, z0 + 0.012), grain=1))
        at = (x + 0.004, 0.0, (z0 + z1) / 2)
        pulls.append(knob(*at) if knobs else pull(*at, 0.12))
    return [wood(merged(*meshes)), handle(*pulls)]


def tv(colour: None, rng: np.random.Generator) -> list[Part]:
    """A flat screen on a low stand, on its foot or hung on the wall above it; off, or showing a dim picture.

    It has no colour: the set is black, but its stand, which is larger, is not.
    """
    case, stand = finish("plastic", "black", rng), timber(str(rng.choice(["brown", "white", "black", "beige"])), rng)
    metal, wide = finish("metal", None, rng), rng.uniform(0.95, 1.4)
    tall, hung = wide * 9 / 16, rng.random() < 0.4
    depth, width, low = rng.uniform(0.38, 0.44), wide + rng.uniform(0.15, 0.5), rng.uniform(0.4, 0.52)
    x, y = depth / 2, width / 2
    z = low + (rng.uniform(0.22, 0.32) if hung else 0.07)
    at = -x + (0.02 if hung else 0.15)  # the back of the set
    front = at + 0.045
    body = [bevelled((at, -wide / 2, z), (front, wide / 2, z + tall), 0.008)]
    if hung:
        body.append(box((-x, -0.2, z + 0.3 * tall), (at, 0.2, z + 0.7 * tall)))
    elif rng.random() < 0.5:
        feet = [((at + 0.02, s, low), (at + 0.02, s, z + 0.02)) for s in (-0.3 * wide, 0.3 * wide)]
        body += [post(foot, top, (0.2, 0.03), (0.03, 0.03)) for foot, top in feet]
    else:
        body.append(bevelled((at - 0.09, -0.18, low), (at + 0.14, 0.18, low + 0.015), 0.006))
        body.append(box((at + 0.005, -0.05, low), (at + 0.03, 0.05, z + 0.02)))
    rim, face = 0.014, front + 0.0015
    a, b, c, d = -wide / 2 + rim, wide / 2 - rim, z + rim + 0.008, z + tall - rim
    screen = quad([(face, a, c), (face, b, c), (face, b, d), (face, a, d)])
    parts = [case(*body), part(screen, material("screen", None, rng), (b - a, d - c))]
    foot, handles = rng.uniform(0.06, 0.14), []
    shelf = [bevelled((-x, -y, low - 0.022), (x, y, low), 0.005, grain=1)]
    shelf.append(legs((-x + 0.05, -y + 0.08, x - 0.05, y - 0.08), foot, 0.04, 0.028, 0.01))
    if rng.random() < 0.5:  # an open middle for the player, doors at both ends
        third = width / 3
        shelf.append(box((-x, -y, foot), (x, y, foot + 0.02), 1))
        shelf.append(box((-x, -third / 2, foot), (-x + 0.01, third / 2, low - 0.02), 1))
        for y0, y1 in ((-y, -third / 2), (third / 2, y)):
            shelf.append(box((-x, y0, foot), (x - 0.02, y1, low - 0.022), 1))
            shelf.append(panel(x - 0.02, y0 + 0.003, y1 - 0.003, foot + 0.004, low - 0.026))
        parts.append(case(box((-x + 0.08, -0.3 * third, foot + 0.02), (x - 0.08, 0.3 * third, foot + 0.075))))
    else:
        shelf.append(box((-x, -y, foot), (x - 0.02, y, low - 0.022), 1))
        for y0, y1 in pairwise(np.linspace(-y, y, 4)):
            shelf.append(panel(x - 0.02, y0 + 0.003, y1 - 0.003, foot + 0.004, low - 0.026))
            handles.append(pull(x - 0.002, (y0 + y1) / 2, low - 0.07, 0.14))
    parts += [stand(*shelf), *([metal(*handles)] if handles else [])]
    if not hung and rng.random() < 0.5:  # a loudspeaker
        parts.append(case(cylinder((0.05, y - 0.08, low), 0.045, 0.16, 12)))
    return parts


# --- dressers, wardrobes, bookshelves, piles of books, and kitchen cabinets -------------------------------------------


def front(x: float, y0: float, y1: float, z0: float, z1: float, framed: bool) -> Mesh:
    """A door's face at `x` towards +x, its grain upright: flat, or a frame round a sunk field."""
    if not framed:
        return bevelled((x, y0, z0), (x + 0.018, y1, z1), 0.004, grain=2)
    rail = min(0.07, 0.25 * (y1 - y0), 0.25 * (z1 - z0))
    a, b, c, d = y0 + rail, y1 - rail, z0 + rail, z1 - rail
    frame = ((y0, a, z0, z1, 2), (b, y1, z0, z1, 2), (a, b, z0, c, 1), (a, b, d, z1, 1))
    sunk = box((x, a, c), (x + 0.009, b, d), 2)
    return merged(
        *(box((x, left, low), (x + 0.02, right, high), grain) for left, right, low, high, grain in frame), sunk
    )


def dresser(colour: str, rng: np.random.Generator) -> list[Part]:
    """A chest of drawers in one to three columns, on feet or a plinth."""
    wood, metal = timber(colour, rng), fittings(rng)
    columns, rows = ((1, 4), (2, 3), (2, 4), (3, 3))[rng.integers(4)]
    depth, width = rng.uniform(0.42, 0.5), columns * rng.uniform(0.46, 0.52) + (0.22 if columns == 1 else 0)
    foot = rng.uniform(0.08, 0.16) if rng.random() < 0.6 else 0.0
    height = foot + rows * rng.uniform(0.19, 0.23) + 0.06
    x, y, bottom, top = depth / 2, width / 2, foot or 0.06, height - 0.025
    body = [
        box((-x, -y, 0 if not foot else bottom), (x - 0.03, y, top), 1),
        bevelled((-x, -y - 0.012, top), (x, y + 0.012, height), 0.006, grain=1),
    ]
    if foot:
        body.append(legs((-x + 0.05, -y + 0.05, x - 0.08, y - 0.05), bottom, 0.05, 0.032, rng.uniform(0, 0.03)))
    handles, round_knobs, gap = [], rng.random() < 0.4, 0.006
    across, up = np.linspace(-y + 0.012, y - 0.012, columns + 1), np.linspace(bottom + 0.012, top - 0.008, rows + 1)
    for y0, y1 in pairwise(across):
        for z0, z1 in pairwise(up):
            body.append(panel(x - 0.03, y0 + gap, y1 - gap, z0 + gap, z1 - gap))
            middle = (z0 + z1) / 2
            if round_knobs:
                places = (-0.25, 0.25) if columns == 1 else (0.0,)
                handles += [knob(x - 0.012, (y0 + y1) / 2 + s * (y1 - y0), middle) for s in places]
            else:
                handles.append(pull(x - 0.012, (y0 + y1) / 2, middle, 0.32 * (y1 - y0)))
    return [wood(*body), metal(*handles)]


def wardrobe(colour: str, rng: np.random.Generator) -> list[Part]:
    """Two to four tall doors, flat or framed, some with drawers below; one may be a mirror."""
    wood, metal = timber(colour, rng), fittings(rng)
    doors = int(rng.integers(2, 5))
    depth, width, height = rng.uniform(0.56, 0.62), doors * rng.uniform(0.44, 0.52), rng.uniform(1.95, 2.2)
    x, y, framed, mirror = depth / 2, width / 2, rng.random() < 0.5, -1
    drawers = rng.uniform(0.26, 0.36) if rng.random() < 0.35 else 0.0
    if doors > 2 and rng.random() < 0.4:
        mirror = 1
    low = 0.08 + drawers
    body = [box((-x, -y, 0), (x - 0.024, y, height - 0.03), 2)]
    cornice = 0.025 if framed else 0.0
    body.append(bevelled((-x, -y - cornice, height - 0.03), (x + cornice - 0.002, y + cornice, height), 0.006, grain=1))
    edges, handles, parts = np.linspace(-y + 0.004, y - 0.004, doors + 1), [], []
    for k, (y0, y1) in enumerate(pairwise(edges)):
        body.append(front(x - 0.024, y0 + 0.003, y1 - 0.003, low, height - 0.036, framed))
        if k == mirror:
            pane = box((x - 0.01, y0 + 0.05, low + 0.06), (x + 0.001, y1 - 0.05, height - 0.1))
            parts.append(finish("glass", None, rng)(pane))
        hinge_left = k % 2 == 0 and not (doors == 3 and k == 2)
        handles.append(pull(x - 0.006, y1 - 0.045 if hinge_left else y0 + 0.045, 1.05, 0.24, upright=True))
    if drawers:
        for y0, y1 in ((-y + 0.004, 0), (0, y - 0.004)):
            body.append(panel(x - 0.024, y0 + 0.003, y1 - 0.003, 0.08, low - 0.006))
            handles.append(pull(x - 0.006, (y0 + y1) / 2, (0.08 + low) / 2, 0.2))
    return [wood(*body), metal(*handles), *parts]


def bookshelf(colour: str, rng: np.random.Generator) -> list[Part]:
    """Open shelves with books, upright and in piles, gaps, and a vase or a box here and there."""
    wood, t = timber(colour, rng), 0.022
    columns = 1 if rng.random() < 0.7 else 2
    depth, height = rng.uniform(0.27, 0.34), rng.uniform(1.25, 2.1)
    width = columns * (rng.uniform(0.7, 0.95) if columns == 1 else rng.uniform(0.5, 0.65))
    rows, x, y = max(3, round(height / 0.34)), depth / 2, width / 2
    levels = np.linspace(0.06, height - t, rows + 1)
    body, sides = [box((-x, -y, 0), (-x + 0.012, y, height), 2)], np.linspace(-y + t / 2, y - t / 2, columns + 1)
    body += [box((-x, s - t / 2, 0), (x, s + t / 2, height), 2) for s in sides]
    body += [box((-x, -y + t / 2, z), (x - 0.004, y - t / 2, z + t), 1) for z in levels]
    body.append(box((-x + 0.02, -y + t / 2, 0), (x - 0.02, y - t / 2, 0.06), 1))
    low, high, things = [], [], []
    bay = (width - t) / columns
    for left in np.arange(columns) * bay - y + t:
        for z, ceiling in zip(levels[:-1] + t, levels[1:], strict=True):
            _fill_shelf(rng, left, left + bay - t, -x + 0.014, x, z, ceiling, low, high, things)
    parts = [wood(*body), _bound(np.array(low), np.array(high), rng)]
    if things:
        parts.append(finish("ceramic", str(rng.choice(["white", "blue", "green", "orange"])), rng)(*things))
    return parts


def _fill_shelf(
    rng: np.random.Generator, y: float, end: float, back: float, edge: float, z: float, ceiling: float,
    low: list[list[float]], high: list[list[float]], things: list[Mesh],
) -> None:  # fmt: skip
    """One shelf from `y` to `end` and from `back` to `edge`: corners of books in `low` and `high`, other `things`."""
    room = ceiling - z
    while y < end - 0.05:
        choice = rng.random()
        if choice < 0.1:
            y += rng.uniform(0.05, 0.16)
        elif choice < 0.2 and end - y > 0.24:
            level = z
            for _ in range(int(rng.integers(2, 5))):
                thick, deep, wide = rng.uniform(0.02, 0.04), rng.uniform(0.13, 0.17), rng.uniform(0.19, 0.23)
                if level + thick > ceiling - 0.02:
                    break
                front_x = edge - rng.uniform(0.02, 0.05)
                low.append([front_x - deep, y + 0.005, level])
                high.append([front_x, y + wide, level + thick])
                level += thick
            y += 0.25
        elif choice < 0.26 and end - y > 0.2 and room > 0.22:
            tall, wide = room * rng.uniform(0.5, 0.75), rng.uniform(0.05, 0.07)
            profile = [(0, 0), (0.6 * wide, 0), (wide, 0.4 * tall), (0.4 * wide, 0.8 * tall), (0.55 * wide, tall)]
            things.append(moved(lathe(profile, 10), ((back + edge) / 2, y + 0.09, z)))
            y += 0.19
        else:
            tall, deep = min(rng.uniform(0.2, 0.3), room - 0.02), rng.uniform(0.16, 0.22)
            for _ in range(int(rng.integers(4, 11))):
                thick = rng.uniform(0.022, 0.05)
                if y + thick > end:
                    break
                depth = min(deep * rng.uniform(0.9, 1.08), edge - back - 0.03)
                front_x = edge - rng.uniform(0.015, 0.035)
                low.append([front_x - depth, y + 0.001, z])
                high.append([front_x, y + thick - 0.001, z + min(tall * rng.uniform(0.86, 1.06), room - 0.012)])
                y += thick


def _bound(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> Part:
    """Books between corners ``(n, 3)``: a spine each, the cloth at both sides, cut pages on top; no back, no bottom."""
    faces = CORNERS[[[1, 3, 7, 5], [3, 2, 6, 7], [0, 1, 5, 4], [5, 7, 6, 4]]].astype(int)  # front, right, left, top
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
    return Part(
        place.astype(np.float32), quad_triangles(4 * len(low)), uv.astype(np.float32), material("books", None, rng)
    )


def book(colour: str, rng: np.random.Generator) -> list[Part]:
    """A pile of one to four books, the uppermost of the colour, covers of cloth round white pages."""
    z, parts = 0.0, []
    for k in reversed(range(int(rng.integers(1, 5)))):
        thick, deep, wide = rng.uniform(0.02, 0.04), rng.uniform(0.13, 0.18), rng.uniform(0.19, 0.25)
        dx, dy = rng.uniform(-0.012, 0.012, 2)
        x0, x1, y0, y1 = dx - deep / 2, dx + deep / 2, dy - wide / 2, dy + wide / 2
        cover = finish("paint", colour if k == 0 else str(rng.choice(["blue", "grey", "beige", "red", "black"])), rng)
        top = z + thick
        lids = [box((x0, y0, z), (x1, y1, z + 0.003)), box((x0, y0, top - 0.003), (x1, y1, top))]
        pages = box((x0 + 0.004, y0 + 0.004, z + 0.002), (x1 - 0.002, y1 - 0.004, top - 0.002))
        parts += [cover(*lids, box((x1 - 0.003, y0, z), (x1, y1, top))), finish("paint", "white", rng)(pages)]
        z = top
    return parts


def _worktop(x: float, y: float, low: float, rng: np.random.Generator) -> Part:
    """A kitchen worktop over [-x, x + 0.02] x [-y, y] from `low` up by 4 cm: stone, wood, or dark laminate."""
    kind, tone = (("marble", None), ("wood", None), ("marble", "grey"), ("paint", "black"))[rng.integers(4)]
    return finish(kind, tone, rng)(bevelled((-x, -y, low), (x + 0.02, y, low + 0.04), 0.006, grain=1))


def base_units(
    x: float, y: float, top: float, rng: np.random.Generator, framed: bool, drawers: bool = True
) -> tuple[Mesh, Mesh]:
    """Kitchen base units over [-x, x] x [-y, y] up to `top`, and their handles; doors and blocks of drawers."""
    count = max(1, round(2 * y / 0.52))
    edges = np.linspace(-y, y, count + 1)
    body = [box((-x, -y, 0.1), (x - 0.02, y, top), 2), box((-x, -y, 0), (x - 0.08, y, 0.1), 1)]
    handles, z0 = [], 0.105
    for k, (y0, y1) in enumerate(pairwise(edges)):
        middle, gap = (y0 + y1) / 2, 0.003
        if drawers and rng.random() < 0.4:
            cuts = np.array([z0, 0.4 * top, 0.72 * top, top - 0.005])
            for low, high in pairwise(cuts):
                body.append(front(x - 0.02, y0 + gap, y1 - gap, low + gap, high - gap, framed and high - low > 0.24))
                handles.append(pull(x, middle, high - 0.05, 0.16))
        else:
            body.append(front(x - 0.02, y0 + gap, y1 - gap, z0 + gap, top - 0.008, framed))
            handles.append(pull(x, y1 - 0.05 if k % 2 == 0 else y0 + 0.05, top - 0.16, 0.16, upright=True))
    return merged(*body), merged(*handles)


def cabinet(colour: str, rng: np.random.Generator) -> list[Part]:
    """Kitchen base units under one worktop, with a few things on it."""
    depth, width, top = 0.58, rng.uniform(1.0, 2.2), rng.uniform(0.84, 0.88)
    x, y = depth / 2, width / 2
    body, handles = base_units(x, y, top, rng, framed=rng.random() < 0.4)
    cover, surface = finish("wood" if colour == "brown" else "paint", colour, rng), top + 0.04
    parts = [cover(body), fittings(rng)(handles), _worktop(x, y, top, rng)]
    if rng.random() < 0.7:  # jars
        at, count = rng.uniform(-y + 0.1, y - 0.5), int(rng.integers(2, 4))
        jars = [cylinder((-x + 0.12, at + 0.13 * k, surface), 0.05, 0.18 - 0.03 * k, 12) for k in range(count)]
        parts.append(finish("ceramic", str(rng.choice(["white", "red", "beige", "green"])), rng)(*jars))
    if width > 1.4 and rng.random() < 0.6:  # a kettle
        kettle = lathe([(0, 0), (0.085, 0), (0.085, 0), (0.06, 0.18), (0.06, 0.18), (0.02, 0.21), (0, 0.22)], 14)
        parts.append(finish("metal", None, rng)(moved(kettle, (-0.03, y - 0.2, surface))))
    return parts
