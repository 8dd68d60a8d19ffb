"""Televisions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from eagor.worlds.apartment.furniture.joinery import legs, panel, pull, timber
from eagor.worlds.apartment.furniture.model import Builder, Kind, Model, assembled, finish
from eagor.worlds.apartment.meshes import bevelled, box, cylinder, part, post, quad
from eagor.worlds.apartment.textures import material

KINDS = (Kind("tv", "wall", ("living room", "bedroom"), ()),)


def tv(colour: None, rng: np.random.Generator) -> Model:
    """A flat screen on a low stand, on its foot or hung on the wall above it; off, or showing a dim picture.

    It has no colour: the set is black, and its stand, which shows more of itself, is not.
    """
    case, stand = finish("plastic", "black", rng), timber(str(rng.choice(["brown", "white", "black", "beige"])), rng)
    metal = finish("metal", None, rng)
    wide = rng.uniform(0.95, 1.4)
    tall, hung = wide * 9 / 16, rng.random() < 0.4
    depth, width, low = rng.uniform(0.38, 0.44), wide + rng.uniform(0.15, 0.5), rng.uniform(0.4, 0.52)
    x, y = depth / 2, width / 2
    bottom = low + (rng.uniform(0.22, 0.32) if hung else 0.07)
    at = -x + (0.02 if hung else 0.15)  # the back of the set
    front, z = at + 0.045, bottom
    body = [bevelled((at, -wide / 2, z), (front, wide / 2, z + tall), 0.008)]
    if hung:
        body.append(box((-x, -0.2, z + 0.3 * tall), (at, 0.2, z + 0.7 * tall)))
    elif rng.random() < 0.5:
        body += [
            post((at + 0.02, s, low), (at + 0.02, s, z + 0.02), (0.2, 0.03), (0.03, 0.03))
            for s in (-0.3 * wide, 0.3 * wide)
        ]
    else:
        body += [
            bevelled((at - 0.09, -0.18, low), (at + 0.14, 0.18, low + 0.015), 0.006),
            box((at + 0.005, -0.05, low), (at + 0.03, 0.05, z + 0.02)),
        ]
    rim, face = 0.014, front + 0.0015
    a, b, c, d = -wide / 2 + rim, wide / 2 - rim, z + rim + 0.008, z + tall - rim
    screen = quad([(face, a, c), (face, b, c), (face, b, d), (face, a, d)])
    parts = [case(*body), part(screen, material("screen", None, rng), (b - a, d - c))]
    foot = rng.uniform(0.06, 0.14)
    shelf = [bevelled((-x, -y, low - 0.022), (x, y, low), 0.005, grain=1)]
    shelf.append(legs((-x + 0.05, -y + 0.08, x - 0.05, y - 0.08), foot, 0.04, 0.028, 0.01))
    handles = []
    if rng.random() < 0.5:  # an open middle for the player, doors at both ends
        third = width / 3
        shelf.append(box((-x, -y, foot), (x, y, foot + 0.02), 1))
        shelf.append(box((-x, -third / 2, foot), (-x + 0.01, third / 2, low - 0.02), 1))
        for s in (-1, 1):
            inner, outer = s * third / 2, s * y
            y0, y1 = min(inner, outer), max(inner, outer)
            shelf.append(box((-x, y0, foot), (x - 0.02, y1, low - 0.022), 1))
            shelf.append(panel(x - 0.02, y0 + 0.003, y1 - 0.003, foot + 0.004, low - 0.026))
        player = box((-x + 0.08, -0.3 * third, foot + 0.02), (x - 0.08, 0.3 * third, foot + 0.075))
        parts.append(case(player))
    else:
        shelf.append(box((-x, -y, foot), (x - 0.02, y, low - 0.022), 1))
        edges = np.linspace(-y, y, 4)
        for y0, y1 in pairwise(edges):
            shelf.append(panel(x - 0.02, y0 + 0.003, y1 - 0.003, foot + 0.004, low - 0.026))
            handles.append(pull(x - 0.002, (y0 + y1) / 2, low - 0.07, 0.14))
    parts.append(stand(*shelf))
    if handles:
        parts.append(metal(*handles))
    if not hung and rng.random() < 0.5:  # a loudspeaker
        parts.append(case(cylinder((0.05, y - 0.08, low), 0.045, 0.16, 12)))
    return assembled("tv", colour, parts)


BUILDERS: dict[str, Builder] = {"tv": tv}
