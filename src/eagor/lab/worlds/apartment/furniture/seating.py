"""Chairs, armchairs, sofas and beds.

Chairs are wooden, upholstered, or moulded shells. Beds have a frame and headboard, a mattress, a duvet with a fold, and
pillows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import WOODS, Rectangle, finish, fittings, legs, timber
from eagor.lab.worlds.apartment.mesh import (
    Mesh,
    Part,
    bevelled,
    box,
    cushion,
    loft,
    mirrored,
    moved,
    pillow,
    post,
    reshaped,
    slab,
    tube,
    turned,
)
from eagor.sphere import rotation

CLOTHS = ("grey", "beige", "blue", "green", "red", "brown", "black", "white", "orange", "yellow", "purple", "pink")
COLOURS = ("white", "grey", "blue", "green", "beige", "red", "purple", "pink", "yellow", "orange", "brown", "black")
_LENGTH = 2.0  # of the mattress, metres


def chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A chair: wooden, upholstered or a moulded shell."""
    design, woody = rng.random(), colour in ("brown", "beige")
    if design < (0.8 if woody else 0.3):
        return _wooden(colour, rng)
    return (_upholstered if design < 0.65 or woody else _shell)(colour, rng)


def _rail(y: float, z: float, height: float, thickness: float, x: float, hollow: float) -> Mesh:
    """A bent rail of a chair's back between -y and +y at height z; its middle lies `hollow` behind its ends."""
    place = np.linspace(-y, y, 6)
    behind = x - hollow * (1 - (place / y) ** 2)
    ring = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * [thickness / 2, height / 2]
    rings = np.empty((6, 4, 3))
    rings[..., 0], rings[..., 1], rings[..., 2] = behind[:, None] + ring[:, 0], place[:, None], z + ring[:, 1]
    return loft(rings)


def _wooden(colour: str, rng: np.random.Generator) -> list[Part]:
    """Four legs, a solid seat, a back of upright slats, of cross rails, or of turned spindles."""
    wood = timber(colour, rng)
    w, d, seat, top = rng.uniform(0.4, 0.46), rng.uniform(0.4, 0.45), rng.uniform(0.44, 0.47), rng.uniform(0.84, 0.98)
    size, lean, hollow = rng.uniform(0.032, 0.042), rng.uniform(0.05, 0.09), rng.uniform(0.01, 0.035)
    x, y = d / 2 - size / 2, w / 2 - size / 2
    foot = size * rng.uniform(0.6, 1.0)
    meshes = [bevelled((-d / 2, -w / 2, seat - 0.03), (d / 2 + 0.02, w / 2, seat), 0.008, grain=0)]
    for side in (-y, y):
        meshes += [
            post((x + 0.01, side, 0), (x, side, seat - 0.03), (foot, foot), (size, size)),
            post((-x - 0.05, side, 0), (-x, side, seat - 0.03), (foot, foot), (size, size)),
            post((-x, side, seat), (-x - lean, side, top), (size, size), (0.7 * size, 0.8 * size)),
            box((-x, side - 0.009, seat - 0.09), (x, side + 0.009, seat - 0.03), grain=0),
        ]
        if foot > 0.8 * size:
            meshes.append(box((-x - 0.03, side - 0.01, 0.16), (x, side + 0.01, 0.185), grain=0))
    meshes += [box((s - 0.009, -y, seat - 0.09), (s + 0.009, y, seat - 0.03), grain=1) for s in (-x, x)]

    def back(z: float) -> float:
        return -x - lean * (z - seat) / (top - seat)

    design = rng.integers(3)
    if design == 1:  # cross rails
        count = int(rng.integers(3, 5)) if top - seat > 0.45 else 3
        levels = np.linspace(seat + 0.14, top - 0.05, count)
        return [wood(*meshes, *(_rail(y, z, 0.055, 0.018, back(z), hollow) for z in levels))]
    head, sill = top - 0.04, seat + rng.uniform(0.08, 0.14)
    meshes += [_rail(y, head, 0.08, 0.024, back(head), hollow), _rail(y, sill, 0.04, 0.02, back(sill), hollow)]
    count = int(rng.integers(4, 6)) if design == 0 else 6
    for place in np.linspace(-y, y, count + 2)[1:-1]:
        bent = hollow * (1 - (place / y) ** 2)
        low, high = (back(sill) - bent, place, sill + 0.01), (back(head) - bent, place, head - 0.03)
        flat = (0.012, 0.38 * w / count)
        meshes.append(post(low, high, flat, flat) if design == 0 else tube([low, high], 0.008, sides=6))
    return [wood(*meshes)]


def _upholstered(colour: str, rng: np.random.Generator) -> list[Part]:
    """A padded seat and a padded, leaning back on slim legs."""
    cloth = finish("leather" if colour in ("brown", "black", "white") and rng.random() < 0.5 else "fabric", colour, rng)
    w, d, seat, top = rng.uniform(0.44, 0.5), rng.uniform(0.44, 0.5), rng.uniform(0.46, 0.49), rng.uniform(0.82, 1.0)
    deep, wings, lean = rng.uniform(0.08, 0.12), rng.uniform(0.0, 0.08), rng.uniform(0.06, 0.1)
    base = seat - 0.12 if rng.random() < 0.6 else seat + 0.08
    plump = cushion((-d / 2, -w / 2, seat - deep), (d / 2, w / 2, seat), 0.02, 0.04)

    def bend(p: np.ndarray) -> np.ndarray:
        x, y, z = p.T
        rise = np.clip((z - base) / (top - base), 0, 1)
        wide = 1 - 0.08 * rise if wings < 0.04 else 1 + 0.04 * rise
        return np.stack([x - lean * rise + wings * (2 * y / w) ** 2 * np.sqrt(rise), y * wide, z], axis=1)

    back = reshaped(cushion((-d / 2 - 0.04, -w / 2, base), (-d / 2 + 0.045, w / 2, top), 0.015, 0.035), bend)
    shade = "brown" if colour != "brown" and rng.random() < 0.6 else "black"
    wood = timber(shade, rng) if rng.random() < 0.7 else fittings(rng)
    x, y = d / 2 - 0.04, w / 2 - 0.04
    frame = [legs((-x, -y, x, y), seat - deep + 0.02, 0.036, 0.022, rng.uniform(0.0, 0.03))]
    if base > seat:  # the back stands clear of the seat, on two posts
        foot, head = (-d / 2 + 0.03, seat - deep), (-d / 2 - 0.4 * lean, (base + top) / 2)
        frame += [post((foot[0], s, foot[1]), (head[0], s, head[1]), (0.03, 0.04), (0.02, 0.035)) for s in (-y, y)]
    return [cloth(plump, back), wood(*frame)]


def _shell(colour: str, rng: np.random.Generator) -> list[Part]:
    """A moulded shell of plastic on wooden pegs, on metal legs or on runners."""
    plastic, w, seat = finish("plastic", colour, rng), rng.uniform(0.45, 0.5), rng.uniform(0.43, 0.46)
    top, curl = rng.uniform(0.8, 0.86), rng.uniform(0.03, 0.09)
    # From the front lip over the seat and up the back: x, height, share of the width, how much the sides curl up.
    side = np.array(
        [
            (0.24, seat - 0.03, 0.82, 0.2), (0.21, seat + 0.005, 0.92, 0.4), (0.1, seat - 0.005, 1.0, 0.9),
            (-0.06, seat - 0.015, 1.0, 1.2), (-0.16, seat + 0.015, 0.98, 1.5), (-0.2, seat + 0.09, 0.97, 1.3),
            (-0.225, seat + 0.22, 0.95, 0.8), (-0.25, (seat + top) / 2 + 0.13, 0.88, 0.5),
            (-0.265, top - 0.02, 0.74, 0.4), (-0.27, top, 0.56, 0.3),
        ]
    )  # fmt: skip
    across = np.array([-1, -0.82, -0.4, 0, 0.4, 0.82, 1])
    tangent = np.gradient(side[:, :2], axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    up = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)  # the side that is sat on; the tangent runs to the rear
    raised = curl * side[:, 3:] * np.abs(across) ** 2.5
    points = np.empty((len(side), len(across), 3))
    points[..., 0] = side[:, :1] + up[:, :1] * raised
    points[..., 1] = across * side[:, 2:3] * w / 2
    points[..., 2] = side[:, 1:2] + up[:, 1:] * raised
    shell = slab(points[:, ::-1], 0.012)
    under, x, y = seat - 0.02, 0.15, 0.15
    feet = [(s * (x + 0.06), t * (y + 0.06)) for s in (-1, 1) for t in (-1, 1)]
    design = rng.integers(3)
    if design == 0:
        wood = finish("wood", "beige" if rng.random() < 0.6 else "brown", rng)
        pegs = [tube([(u, v, 0), (0.62 * u, 0.62 * v, under)], [0.012, 0.019], 7) for u, v in feet]
        metal = finish("metal", "black", rng)
        ties = [tube([(0.17, s * 0.17, 0.17), (-0.17, -s * 0.17, 0.17)], 0.005, 5) for s in (-1, 1)]
        return [plastic(shell), wood(*pegs), metal(*ties)]
    metal = fittings(rng)
    if design == 1:
        bars = [tube([(u, v, 0), (0.7 * u, 0.7 * v, under - 0.01)], 0.011, 7) for u, v in feet]
        bars += [tube([(0.7 * u, -0.7 * 0.21, under), (0.7 * u, 0.7 * 0.21, under)], 0.011, 6) for u in (-0.21, 0.21)]
    else:
        corners = ((-0.22, 0.012), (0.22, 0.012), (0.17, under - 0.03), (-0.17, under - 0.03), (-0.22, 0.013))
        loop = tube([(u, 0, z) for u, z in corners], 0.011, 7)
        bars = [moved(loop, (0, s * 0.17, 0)) for s in (-1, 1)]
        bars += [tube([(u, -0.17, under - 0.02), (u, 0.17, under - 0.02)], 0.01, 6) for u in (-0.14, 0.14)]
    return [plastic(shell), metal(*bars)]


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
        mirrored(left),
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


def bed(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bed for one or two; `colour` is that of the duvet."""
    width = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8]))
    rail, height = rng.uniform(0.2, 0.3), rng.uniform(0.44, 0.54)
    wood = colour if colour in WOODS and rng.random() < 0.7 else str(rng.choice(WOODS))
    frame_width, x = width + 0.06, _LENGTH / 2
    y, joiner = frame_width / 2, timber(wood, rng)
    parts = [_headboard(frame_width, height + rng.uniform(0.35, 0.52), colour, joiner, rng)]
    frame = [
        bevelled((-x, -y, rail - 0.1), (x + 0.03, -y + 0.03, rail + 0.05), 0.008, grain=0),
        bevelled((-x, y - 0.03, rail - 0.1), (x + 0.03, y, rail + 0.05), 0.008, grain=0),
        box((-x, -y + 0.02, rail - 0.06), (x, y - 0.02, rail), grain=0),
        legs((-x + 0.1, -y + 0.04, x - 0.01, y - 0.04), rail - 0.05, 0.06, 0.045),
    ]
    board = wood == colour and rng.random() < 0.5  # in another colour it would dominate the cover
    if board:
        frame.append(bevelled((x, -y, rail - 0.1), (x + 0.04, y, height + rng.uniform(0.05, 0.16)), 0.012, 2, grain=1))
    else:
        frame.append(bevelled((x, -y, rail - 0.1), (x + 0.03, y, rail + 0.05), 0.008, grain=1))
    parts.append(joiner(*frame))
    white = finish("fabric", "white", rng)
    mattress = bevelled((-x + 0.005, -width / 2, rail), (x - 0.005, width / 2, height), 0.035, 2)
    # The sides hang over the rails, so that the cover is most of what is visible.
    start, overhang = -x + rng.uniform(0.48, 0.6), min(height - rail + rng.uniform(0.02, 0.1), 0.7 * height)
    cloth = finish("fabric", colour, rng)
    parts.append(cloth(_cover(width, height, start, x, overhang, not board, rng.uniform(-1, 1, (10, 9)))))
    linen = white if (rng.random() < 0.4 and wood != "white") or colour == "white" else cloth
    reverse = finish("fabric", "beige", rng) if colour == "white" else white
    pillows = _pillows(width, height, rng, min(0.7, 0.46 * width + 0.2), rng.uniform(0.8, 1.15))
    parts += [reverse(_fold(width, height, start, overhang)), white(mattress), linen(*pillows)]
    if rng.random() < 0.4:
        other = str(rng.choice([name for name in COLOURS if name not in (colour, "white", "black")]))
        size = rng.uniform(0.34, 0.4)
        soft = throw((start + 0.1, rng.uniform(-0.1, 0.1) * width, height + 0.07), 0.7, 0.0, size, 0.13)
        parts.append(finish("fabric", other, rng)(soft))
    return parts


def _headboard(width: float, top: float, colour: str, wood: Callable[..., Part], rng: np.random.Generator) -> Part:
    """A board, a row of padded fields or slats between posts, its front face at x = -1 and its middle at y = 0."""
    x, y = -_LENGTH / 2, width / 2
    design = rng.integers(3)
    if design == 0:
        return wood(bevelled((x - 0.05, -y, 0), (x, y, top), 0.015, 2, grain=1))
    if design == 1:
        cloth = finish("fabric", colour if rng.random() < 0.8 else "grey", rng)
        count = 2 if width < 1.2 else int(rng.integers(3, 5))
        spans, steps = pairwise(np.linspace(-y, y, count + 1)), 1 if count > 3 else 2
        fields = [bevelled((x - 0.04, a, 0.3), (x + 0.04, b, top), 0.025, steps) for a, b in spans]
        return cloth(box((x - 0.06, -y, 0), (x - 0.02, y, top - 0.02)), *fields)
    rails = [bevelled((x - 0.05, -y, z - h), (x - 0.01, y, z), 0.01, grain=1) for z, h in ((top, 0.09), (0.5, 0.06))]
    posts = [bevelled((x - 0.06, s - 0.03, 0), (x, s + 0.03, top + 0.02), 0.01, grain=2) for s in (-y + 0.03, y - 0.03)]
    places = np.linspace(-y, y, int(width / 0.13) + 2)[1:-1]
    slats = [box((x - 0.035, s - 0.02, 0.47), (x - 0.02, s + 0.02, top - 0.07), grain=2) for s in places]
    return wood(*rails, *posts, *slats)


def _across(width: float, overhang: float) -> tuple[np.ndarray, np.ndarray]:
    """Stations of a cover across the bed: y, and how far below the top of the mattress it hangs there."""
    y = width / 2
    place, drop = np.array([y + 0.05, y + 0.03, y - 0.03, 0.55 * y, 0.2 * y]), np.array([overhang, 0.08, 0.0, 0.0, 0.0])
    return np.concatenate([-place, place[::-1]]), np.concatenate([drop, drop[::-1]])


def _cover(
    width: float, height: float, start: float, end: float, overhang: float, hangs: bool, wave: np.ndarray
) -> Mesh:
    """A duvet from x = `start` to `end`, where it hangs down or is tucked in; `wave` ``(10, 9)`` makes it uneven."""
    y, drop = _across(width, overhang)
    x = np.concatenate([np.linspace(start, end - 0.15, 6), [end - 0.03, end + 0.03, end + 0.05]])
    along = np.zeros(9)
    along[-2:] = (0.08, overhang) if hangs else (0.06, 0.1)
    if not hangs:
        x[-3:] = end - 0.06, end - 0.02, end - 0.005
    points = np.empty((10, 9, 3))
    points[..., 0], points[..., 1] = x, y[:, None]
    # At the corners of the foot, where both sides hang, cloth hangs lower than either.
    both = np.minimum(drop[:, None], along) * (0.35 if hangs else 0.0)
    points[..., 2] = height + 0.045 - np.maximum(drop[:, None], along) - both
    flat = (drop[:, None] == 0) & (along == 0)
    points[..., 2] += np.where(flat, 0.012 * wave, 0.0)
    # One wave for both rows of a hanging side, as otherwise they would cross at the corners.
    points[..., 1] += np.where(drop[:, None] > 0, 0.008 * (1 + wave[3]) * np.sign(y)[:, None], 0.0)
    points[..., 0] += np.where((along > 0) & hangs, 0.012 * (1 + wave[:, 3:4]), 0.0)
    points[..., 2] += np.where((drop[:, None] == overhang) & (along == 0), 0.015 * wave, 0.0)
    return slab(points, 0.012)


def _fold(width: float, height: float, start: float, overhang: float) -> Mesh:
    """The strip at the head of the duvet that is turned back and shows its other side."""
    y, drop = _across(width + 0.045, overhang - 0.03)
    x = np.array([start - 0.03, start - 0.015, start + 0.1, start + 0.26, start + 0.28])
    points = np.empty((len(y), len(x), 3))
    points[..., 0], points[..., 1] = x, y[:, None]
    points[..., 2] = height + 0.08 - drop[:, None] - np.array([0.05, 0.005, 0.0, 0.005, 0.02])
    return slab(points, 0.025)


def _pillows(width: float, height: float, rng: np.random.Generator, size: float, lean: float) -> list[Mesh]:
    """One pillow on a narrow bed, two on a wide one, against the headboard."""
    y, made = width / 4 if width > 1.2 else 0.0, []
    for place in (-y, y) if y else (0.0,):
        soft = turned(moved(pillow(size, 0.46, 0.17), (0, 0, 0.23)), rotation((0, 1, 0), -lean))
        soft = turned(soft, rotation((0, 0, 1), rng.uniform(-0.06, 0.06)))
        made.append(moved(soft, (-_LENGTH / 2 + 0.09 + 0.46 * np.sin(lean), place, height + 0.02)))
    return made
