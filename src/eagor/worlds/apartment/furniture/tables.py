"""Tables, coffee tables, desks and nightstands."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eagor.worlds.apartment.furniture.joinery import WOODS, apron, fittings, knob, legs, panel, pull, timber
from eagor.worlds.apartment.furniture.model import Builder, Kind, Model, assembled, finish
from eagor.worlds.apartment.meshes import (
    Mesh,
    Part,
    bevelled,
    board,
    box,
    cylinder,
    lathe,
    merged,
    moved,
    post,
    prism,
    rounded_rectangle,
    tube,
)

KINDS = (
    Kind("table", "free", ("dining room", "kitchen", "living room"), WOODS),
    Kind("coffee table", "free", ("living room",), (*WOODS, "grey")),
    Kind("desk", "wall", ("study", "bedroom"), (*WOODS, "grey")),
    Kind("nightstand", "wall", ("bedroom",), (*WOODS, "grey", "blue", "green")),
)


def _round_top(radius: float, height: float, thickness: float) -> Mesh:
    edge = 0.35 * thickness
    return lathe(
        [
            (0, height - thickness),
            (radius - edge, height - thickness),
            (radius - edge, height - thickness),
            (radius, height - thickness + edge),
            (radius, height - edge),
            (radius - edge, height),
            (radius - edge, height),
            (0, height),
        ],
        28,
    )


def _round_table(height: float, radius: float, colour: str, rng: np.random.Generator) -> list[Part]:
    """A disc on a turned column with a foot, or on three or four legs that lean outwards."""
    wood, top = timber(colour, rng), _round_top(radius, height, rng.uniform(0.025, 0.04))
    design, low = rng.integers(3), height - 0.03
    if design == 0:  # a column on a disc
        foot = 0.62 * radius
        column = [
            (0, 0), (foot, 0), (foot, 0), (foot, 0.02), (0.3 * foot, 0.06), (0.045, 0.16), (0.05, 0.5 * low),
            (0.045, low - 0.08), (0.16, low - 0.005), (0.16, low),
        ]  # fmt: skip
        return [wood(top, lathe(column, 20))]
    count = 4 if design == 1 or radius > 0.5 else 3
    turn = rng.uniform(0, math.pi)
    made = []
    for k in range(count):
        c, s = math.cos(turn + 2 * math.pi * k / count), math.sin(turn + 2 * math.pi * k / count)
        if design == 1:
            made.append(
                tube(
                    [(0.86 * radius * c, 0.86 * radius * s, 0), (0.6 * radius * c, 0.6 * radius * s, low)],
                    [0.015, 0.027],
                    8,
                )
            )
        else:  # feet that meet in a column
            at = np.array([c, s, 0])
            path = [0.8 * radius * at + [0, 0, 0.02], 0.5 * radius * at + [0, 0, 0.06], 0.05 * at + [0, 0, 0.2]]
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
        outline = rounded_rectangle(depth, width, rng.uniform(0.05, 0.16))
        top = prism(outline, low, height, grain=1)
    else:
        top = bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)
    design = rng.integers(5)
    if design <= 1:
        size, inset = rng.uniform(0.05, 0.08), rng.uniform(0.05, 0.1)
        under = (-x + inset, -y + inset, x - inset, y - inset)
        taper, splay = (0.6, rng.uniform(0, 0.04)) if design else (1.0, 0.0)
        return [wood(top, legs(under, low, size, taper * size, splay), apron(under, low - 0.08, low))]
    if design == 2:  # crossed trestles
        bars = []
        for s in (-y + 0.22, y - 0.22):
            for sign in (-1, 1):
                foot, head = (-sign * (x - 0.1), s, 0), (sign * (x - 0.12), s, low)
                bars.append(post(foot, head, (0.09, 0.05), (0.09, 0.05)))
        bars.append(box((-0.025, -y + 0.2, low / 2 - 0.04), (0.025, y - 0.2, low / 2 + 0.04), grain=1))
        return [wood(top, *bars)]
    if design == 3:  # slabs joined by a stretcher
        slabs = [board((-x + 0.12, s - 0.03, 0.05), (x - 0.12, s + 0.03, low)) for s in (-y + 0.25, y - 0.25)]
        feet = [
            bevelled((-x + 0.06, s - 0.045, 0), (x - 0.06, s + 0.045, 0.06), 0.012, grain=0)
            for s in (-y + 0.25, y - 0.25)
        ]
        return [wood(top, *slabs, *feet, box((-0.05, -y + 0.25, 0.3), (0.05, y - 0.25, 0.34), grain=1))]
    metal = finish("metal", "black" if colour != "black" else None, rng)
    bar, frames = 0.05, []
    for s in (-y + 0.14, y - 0.14):
        a, b = s - bar / 2, s + bar / 2
        frames += [
            box((sign * (x - 0.1) - bar / 2, a, bar), (sign * (x - 0.1) + bar / 2, b, low - bar), 2) for sign in (-1, 1)
        ]
        frames += [box((-x + 0.1 - bar / 2, a, z), (x - 0.1 + bar / 2, b, z + bar), 0) for z in (0.0, low - bar)]
    return [wood(top), metal(*frames)]


def table(colour: str, rng: np.random.Generator) -> Model:
    """A table to eat at: round for up to four, or rectangular, its length along y."""
    height = rng.uniform(0.72, 0.76)
    if rng.random() < 0.35:
        return assembled("table", colour, _round_table(height, rng.uniform(0.45, 0.6), colour, rng))
    return assembled("table", colour, _long_table(rng.uniform(0.78, 0.95), rng.uniform(1.2, 1.8), height, colour, rng))


def coffee_table(colour: str, rng: np.random.Generator) -> Model:
    """A low table: a board with a shelf below, a round one, slabs, or a rounded top on leaning legs; length along y."""
    wood, height = timber(colour, rng), rng.uniform(0.36, 0.46)
    depth, width = rng.uniform(0.5, 0.65), rng.uniform(0.9, 1.2)
    x, y, design = depth / 2, width / 2, rng.integers(4)
    if design == 0:
        under = (-x + 0.05, -y + 0.05, x - 0.05, y - 0.05)
        shelf = box((-x + 0.04, -y + 0.04, 0.12), (x - 0.04, y - 0.04, 0.14), grain=1)
        top = bevelled((-x, -y, height - 0.03), (x, y, height), 0.006, grain=1)
        parts = [wood(top, legs(under, height - 0.03, 0.05), apron(under, height - 0.08, height - 0.03), shelf)]
    elif design == 1:
        parts = _round_table(height, rng.uniform(0.36, 0.46), colour, rng)
    elif design == 2:
        sides = [
            bevelled((-x, s - 0.025, 0), (x, s + 0.025, height - 0.02), 0.006, grain=0) for s in (-y + 0.025, y - 0.025)
        ]
        top = bevelled((-x, -y, height - 0.05), (x, y, height), 0.006, grain=1)
        middle = box((-x + 0.02, -y + 0.03, 0.14), (x - 0.02, y - 0.03, 0.17), grain=1)
        parts = [wood(top, *sides, middle)]
    else:
        top = prism(
            rounded_rectangle(depth, width, 0.5 * depth * rng.uniform(0.4, 1.0), 5), height - 0.028, height, grain=1
        )
        under = (-0.5 * x, -0.62 * y, 0.5 * x, 0.62 * y)
        made = [
            tube([(1.5 * u, 1.2 * v, 0), (u, v, height - 0.028)], [0.012, 0.021], 8)
            for u in under[::2]
            for v in under[1::2]
        ]
        limbs = wood if rng.random() < 0.6 else fittings(rng)
        parts = [wood(top), limbs(*made, apron(under, height - 0.06, height - 0.028, 0.025))]
    return assembled("coffee table", colour, parts)


def desk(colour: str, rng: np.random.Generator) -> Model:
    """A desk with a block of drawers under one end or both; who works at it sits at +x."""
    wood, handle = timber(colour, rng), fittings(rng)
    depth, width, height = rng.uniform(0.58, 0.7), rng.uniform(1.15, 1.5), rng.uniform(0.72, 0.76)
    x, y, low, block = depth / 2, width / 2, height - 0.03, rng.uniform(0.34, 0.42)
    meshes: list[Mesh] = [bevelled((-x, -y, low), (x, y, height), 0.006, grain=1)]
    pulls: list[Mesh] = []
    raised = rng.random() < 0.4
    floor = 0.14 if raised else 0.0
    both = width > 1.4 and rng.random() < 0.5
    knobs = rng.random() < 0.4
    sign = -1 if rng.random() < 0.5 else 1
    for side in (sign, -sign) if both else (sign,):
        a, b = sorted((side * (y - 0.02), side * (y - 0.02 - block)))
        meshes.append(box((-x + 0.03, a, floor), (x - 0.04, b, low), grain=2))
        heights = np.linspace(floor + 0.015, low - 0.01, int(rng.integers(3, 5)))
        for z0, z1 in pairwise(heights):
            meshes.append(panel(x - 0.04, a + 0.008, b - 0.008, z0 + 0.004, z1 - 0.004))
            middle = ((a + b) / 2, (z0 + z1) / 2)
            pulls.append(knob(x - 0.022, *middle) if knobs else pull(x - 0.022, *middle, 0.14))
        if raised:
            meshes.append(
                moved(
                    legs((-x + 0.08, -block / 2 + 0.05, x - 0.09, block / 2 - 0.05), 0.14, 0.04, 0.025),
                    (0, (a + b) / 2, 0),
                )
            )
    if not both:
        end = -sign * (y - 0.05)
        if raised:
            meshes += [post((s, end, 0), (s, end, low), (0.026, 0.026), (0.045, 0.045)) for s in (-x + 0.06, x - 0.08)]
        else:
            meshes.append(box((-x + 0.03, end - 0.0125, 0), (x - 0.04, end + 0.0125, low), grain=2))
    meshes.append(box((-x + 0.05, -y + 0.05, low - 0.32), (-x + 0.065, y - 0.05, low), grain=1))  # closes the back
    return assembled("desk", colour, [wood(*meshes), handle(*pulls)])


def nightstand(colour: str, rng: np.random.Generator) -> Model:
    """A bedside table: drawers from top to bottom, or a drawer over an open shelf, on legs or on a plinth."""
    wood, handle = timber(colour, rng), fittings(rng)
    depth, width, height = rng.uniform(0.34, 0.42), rng.uniform(0.4, 0.52), rng.uniform(0.46, 0.58)
    x, y, t = depth / 2, width / 2, 0.02
    floor = rng.uniform(0.1, 0.2) if rng.random() < 0.6 else 0.04
    meshes = [bevelled((-x, -y, height - 0.025), (x + 0.01, y, height), 0.006, grain=1)]
    pulls: list[Mesh] = []
    if floor > 0.05:
        meshes.append(legs((-x + 0.05, -y + 0.05, x - 0.05, y - 0.05), floor, 0.038, 0.022, 0.025))
    else:
        meshes.append(box((-x + 0.02, -y + 0.02, 0), (x - 0.04, y - 0.02, floor), grain=1))
    meshes += [box((-x, s - t / 2, floor), (x, s + t / 2, height - 0.025), grain=2) for s in (-y + t, y - t)]
    meshes += [
        box((-x, -y + t, floor), (x, y - t, floor + t), grain=1),
        box((-x, -y + t, floor + t), (-x + 0.01, y - t, height - 0.025), grain=1),
    ]
    knobs = rng.random() < 0.5
    inner, top = y - 1.5 * t, height - 0.03
    drawers = int(rng.integers(1, 4))
    edges = np.linspace(top, floor + t, drawers + 1) if drawers > 1 else np.array([top, top - 0.15])
    for z1, z0 in pairwise(edges):
        meshes += [
            panel(x - 0.014, -inner + 0.003, inner - 0.003, z0 + 0.004, z1 - 0.004),
            box((-x + 0.01, -inner, z0), (x - 0.014, inner, z0 + 0.012), grain=1),
        ]
        at = (0.0, (z0 + z1) / 2)
        pulls.append(knob(x + 0.004, *at) if knobs else pull(x + 0.004, *at, 0.12))
    return assembled("nightstand", colour, [wood(merged(*meshes)), handle(*pulls)])


BUILDERS: dict[str, Builder] = {"table": table, "coffee table": coffee_table, "desk": desk, "nightstand": nightstand}
