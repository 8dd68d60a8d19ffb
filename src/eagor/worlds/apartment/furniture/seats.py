"""Armchairs and sofas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from eagor.sphere import rotation
from eagor.worlds.apartment.curved import cushion, pillow
from eagor.worlds.apartment.furniture.model import Rectangle, finish, fittings, legs, timber
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, box, loft, mirrored, moved, post, reshaped, turned

CLOTHS = ("grey", "beige", "blue", "green", "red", "brown", "black", "white", "orange", "yellow", "purple", "pink")


def armchair(colour: str, rng: np.random.Generator) -> list[Part]:
    """An armchair: a small sofa for one, a tub, or cushions in a wooden frame."""
    design = rng.integers(3)
    return _seated(colour, 1, rng) if design == 0 else (_tub_chair if design == 1 else _lounge_chair)(colour, rng)


def sofa(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sofa for two or three."""
    return _seated(colour, int(rng.integers(2, 4)), rng)


def throw(at: tuple[float, float, float], tilt: float, turn: float, size: float, thick: float = 0.15) -> Mesh:
    """A throw pillow leaning back by `tilt` and turned by `turn` radians, its lower seam at `at`."""
    leant = turned(moved(pillow(size, size, thick, 4), (0, 0, size / 2)), rotation((0, 1, 0), -tilt))
    return moved(turned(leant, rotation((0, 0, 1), turn)) if turn else leant, at)


def _cloth(colour: str, rng: np.random.Generator):
    leather = colour in ("brown", "black", "white", "red", "beige") and rng.random() < 0.35
    return finish("leather" if leather else "fabric", colour, rng)


def _other(colour: str, rng: np.random.Generator):
    """Cloth of another colour that a throw pillow could have."""
    return finish("fabric", str(rng.choice([c for c in CLOTHS if c not in (colour, "brown", "black")])), rng)


def _feet(under: Rectangle, height: float, rng: np.random.Generator, extra: Sequence[tuple[float, float]] = ()) -> Part:
    """Feet at the corners of `under` and at `extra` (x, y): blocks, or slim where they are high."""
    cover = timber("brown" if rng.random() < 0.6 else "black", rng) if rng.random() < 0.75 else fittings(rng)
    slim = height > 0.1
    foot = 0.028 if slim else 0.045
    more = (post((x, y, 0), (x, y, height), (foot, foot), (0.05, 0.05)) for x, y in extra)
    return cover(legs(under, height, 0.05, foot, 0.03 if slim else 0.0), *more)


def _arm(length: float, width: float, low: float, high: float, design: int) -> Mesh:
    """An armrest from x = -length to 0 and from y = 0, its inner face, to `width`: straight, rolled or sloping."""
    if design == 0:
        return bevelled((-length, 0, low), (0, width, high), 0.025, 2)
    if design == 1:  # a roll on top of an upright panel
        angle = np.linspace(-0.22, 1.22, 9) * math.pi
        roll = np.stack([np.cos(angle), np.sin(angle)], axis=1) * [0.5 * width, 0.42 * width]
        roll += [0.5 * width, high - 0.42 * width]
        outline = np.concatenate([[(0.1 * width, low), (0.85 * width, low)], roll])
        rings = np.empty((2, len(outline), 3))
        rings[0, :, 0], rings[1, :, 0], rings[..., 1:] = -length, 0, outline
        return loft(rings, smooth=True)

    def slope(p: np.ndarray) -> np.ndarray:
        """The top sinks by 8 cm towards the front."""
        return p - [0, 0, 0.08] * np.clip((p[:, 2:] - low) / (high - low), 0, 1) * (p[:, :1] / length + 1)

    return reshaped(bevelled((-length, 0, low), (0, width, high), 0.04, 2), slope)


def _seated(colour: str, seats: int, rng: np.random.Generator) -> list[Part]:
    """A frame with armrests and a back, seat cushions, back cushions, feet and throw pillows."""
    cloth = _cloth(colour, rng)
    place = rng.uniform(0.56, 0.68) if seats > 1 else rng.uniform(0.56, 0.64)
    arm, depth = rng.uniform(0.1, 0.2), rng.uniform(0.82, 0.95) - (0.06 if seats == 1 else 0.0)
    foot = rng.uniform(0.12, 0.17) if rng.random() < 0.5 else rng.uniform(0.04, 0.07)
    seat, top = rng.uniform(0.41, 0.46), rng.uniform(0.76, 0.9)
    chaise = seats > 2 and rng.random() < 0.25
    inside, rest = seats * place, seat + rng.uniform(0.14, 0.2)
    front, rear, y, back = depth / 2, -depth / 2, inside / 2, 0.14
    design = int(rng.integers(3))
    left = moved(_arm(depth - 0.01, arm, foot, rest, design), (front - 0.01, y, 0))
    body = [
        bevelled((rear + 0.02, -y - 0.01, foot), (front - 0.03, y + 0.01, seat - 0.12), 0.015),
        bevelled((rear, -y - 0.01, foot + 0.01), (rear + back, y + 0.01, top - 0.06), 0.03, 2),
        left,
        mirrored(left, 1),
    ]
    bench = seats > 1 and not chaise and rng.random() < 0.25
    reach = rng.uniform(0.5, 0.65) if chaise else 0.0
    end = int(rng.integers(2)) * (seats - 1)  # the seat that is long enough to lie on, if one is
    edges = np.linspace(-y, y, (1 if bench else seats) + 1)
    for k, (a, b) in enumerate(pairwise(edges)):
        tip = front + (reach if chaise and k == end else 0.0)
        body.append(cushion((rear + back, a + 0.004, seat - 0.14), (tip, b - 0.004, seat + 0.015), 0.025, 0.045))
    if chaise:
        a, b = edges[end], edges[end + 1]
        body.append(bevelled((front - 0.1, a, foot), (front + reach - 0.03, b, seat - 0.12), 0.015))
    tilt = rotation((0, 1, 0), -rng.uniform(0.1, 0.2))
    edges = np.linspace(-y, y, seats + 1)
    for a, b in pairwise(edges):
        plump = cushion((rear + back - 0.02, a + 0.006, seat - 0.02), (rear + back + 0.15, b - 0.006, top), 0.035, 0.05)
        body.append(turned(plump, tilt, (rear + back + 0.06, 0, seat)))
    under = (rear + 0.08, -y - arm / 2 + 0.03, front - 0.08, y + arm / 2 - 0.03)
    extra = [(front + reach - 0.1, edges[end] + 0.06), (front + reach - 0.1, edges[end + 1] - 0.06)] if chaise else []
    parts = [cloth(*body), _feet(under, foot + 0.01, rng, extra)]
    return parts + _throws(colour, seats, y, (rear + back + 0.26, seat + 0.01), rng)


def _throws(colour: str, seats: int, y: float, at: tuple[float, float], rng: np.random.Generator) -> list[Part]:
    """Up to three pillows of another colour on the seats between -y and y; x and z of their lower seams are `at`."""
    count = int(rng.integers(1, 4)) if seats > 1 else int(rng.random() < 0.4)
    if not count:
        return []
    x, z = at
    spots = [(-y + 0.2, -0.35), (y - 0.2, 0.35), (y - 0.48, 0.15)][:count] if seats > 1 else [(0.0, 0.0)]
    sign = -1 if rng.random() < 0.5 else 1
    size = rng.uniform(0.38, 0.46) if seats > 1 else 0.36
    meshes = [throw((x, sign * s, z), rng.uniform(0.3, 0.5), -sign * turn, size) for s, turn in spots]
    return [_other(colour, rng)(*meshes)]


def _tub_chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """An armchair whose back bends round the seat and slopes down to the armrests."""
    cloth = _cloth(colour, rng)
    r, seat, top, thick = rng.uniform(0.34, 0.38), rng.uniform(0.42, 0.46), rng.uniform(0.72, 0.84), 0.1
    foot, arms = rng.uniform(0.1, 0.16), rng.uniform(0.58, 0.64)
    angle = np.linspace(-0.62, 0.62, 11) * math.pi + math.pi
    reach = np.abs(angle - math.pi) / (0.62 * math.pi)
    crest = arms + (top - arms) * np.cos(np.clip(reach * 1.25, 0, 1) * math.pi / 2) ** 1.2
    # Cross-section from the inner foot over the crest to the outer foot: (radius outwards, share of the height).
    section = np.array([(0, 0), (0.85, 0), (1, 0.06), (1, 0.9), (0.75, 1), (0.25, 1), (0, 0.9)])[::-1]
    radius = r + section[:, 0] * thick
    height = foot + section[:, 1] * (crest[:, None] - foot)
    rings = np.stack([radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None], height], axis=-1)
    rings[..., 0] *= np.where(rings[..., 0] > 0, 1.25, 1.0)  # its arms reach further forward than a circle would

    def inside(p: np.ndarray) -> np.ndarray:
        """The seat cushion follows the back where it would stick into it."""
        out = np.hypot(p[:, 0], p[:, 1]) / r
        shrink = np.where(p[:, 0] < 0, np.minimum(1, 1 / np.maximum(out, 1e-9)), 1)
        return p * np.stack([shrink, shrink, np.ones_like(shrink)], axis=1)

    plump = reshaped(cushion((-r, -r + 0.005, seat - 0.15), (r + 0.06, r - 0.005, seat + 0.02), 0.03, 0.07), inside)
    base = bevelled((-0.72 * r, -r - 0.005, foot), (r + 0.02, r + 0.005, seat - 0.12), 0.03)
    under = (0.08 - r, 0.05 - r, r - 0.08, r - 0.05)
    parts = [cloth(loft(rings, smooth=True), plump, base), _feet(under, foot + 0.01, rng)]
    if rng.random() < 0.4:
        parts.append(_other(colour, rng)(throw((-r + 0.2, 0, seat + 0.01), 0.35, 0.0, 0.36)))
    return parts


def _lounge_chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A wooden frame with armrests that carries a seat cushion and a high, leaning back cushion."""
    cloth, wood = _cloth(colour, rng), timber("brown" if colour != "brown" else "beige", rng)
    w, d, seat, top = rng.uniform(0.58, 0.64), rng.uniform(0.62, 0.7), rng.uniform(0.42, 0.46), rng.uniform(0.84, 0.98)
    recline = rng.uniform(0.3, 0.42)
    x, y, rest, frame = d / 2, w / 2, seat + 0.16, []
    for side in (-y - 0.03, y + 0.03):
        foot, head = (-x + 0.03, 0.93 * side, seat - 0.16), (-x - 0.22, 0.93 * side, top - 0.1)
        frame += [
            post((x + 0.02, side, 0), (x - 0.03, side, rest), (0.025, 0.03), (0.04, 0.03)),
            post((-x - 0.08, side, 0), (-x + 0.04, side, rest), (0.025, 0.03), (0.04, 0.03)),
            bevelled((-x - 0.04, side - 0.03, rest), (x, side + 0.03, rest + 0.025), 0.01, grain=0),
            post(foot, head, (0.04, 0.025), (0.03, 0.025)),
        ]
    for a, z in ((x - 0.06, seat - 0.16), (-x + 0.02, seat - 0.18)):
        frame.append(box((a - 0.02, -y - 0.03, z), (a + 0.02, y + 0.03, z + 0.05), grain=1))
    tip = rotation((0, 1, 0), -0.08)
    plump = turned(cushion((-x + 0.02, -y, seat - 0.12), (x, y, seat + 0.03), 0.03, 0.05), tip)
    back = cushion((-x - 0.08, -y + 0.005, seat - 0.02), (-x + 0.06, y - 0.005, top + 0.03), 0.03, 0.05)
    back = turned(back, rotation((0, 1, 0), -recline), (-x + 0.06, 0, seat))
    return [cloth(plump, back), wood(*frame)]
