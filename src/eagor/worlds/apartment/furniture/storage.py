"""Dressers, wardrobes, bookshelves, piles of books, and kitchen cabinets."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from eagor.worlds.apartment.furniture.model import finish, fittings, knob, legs, panel, pull, timber
from eagor.worlds.apartment.mesh import (
    CORNERS,
    Mesh,
    Part,
    bevelled,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    quad_triangles,
)
from eagor.worlds.apartment.pictures import SPINES
from eagor.worlds.apartment.textures import material


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
