"""Chairs (wooden, upholstered, or moulded shells), armchairs, sofas, and beds with a cover and pillows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from eagor.lab.worlds.apartment.furniture.model import WOODS, finish, fittings, legs, timber
from eagor.lab.worlds.apartment.mesh import Mesh, Part, bevelled, board, box, cushion, moved, post, tube, turned
from eagor.sphere import rotation

CLOTHS = ("grey", "beige", "blue", "green", "red", "brown", "black", "white", "orange", "yellow", "purple", "pink")
COLOURS = ("white", "grey", "blue", "green", "beige", "red", "purple", "pink", "yellow", "orange", "brown", "black")
_LENGTH = 2.0  # of the mattress, metres
_Y, _Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A chair: wooden, upholstered or a moulded shell."""
    design, woody = rng.random(), colour in ("brown", "beige")
    w, d, seat, top = rng.uniform(0.42, 0.5), rng.uniform(0.42, 0.48), rng.uniform(0.44, 0.48), rng.uniform(0.82, 0.98)
    x, y, lean = d / 2, w / 2, rng.uniform(0.05, 0.1)
    if design < (0.8 if woody else 0.3):
        return _wooden(colour, rng, x, y, seat, top, lean)
    if design < 0.65 or woody:
        cover, round_, thick = _cloth(colour, rng), 5.0, rng.uniform(0.08, 0.11)
    else:
        cover, round_, thick, top = finish("plastic", colour, rng), 6.0, 0.05, min(top, 0.86)
    back = turned(
        cushion((-x - 0.02, -y, seat - 0.03), (-x + thick - 0.03, y, top), round_),
        rotation(_Y, -lean - 0.1), (-x, 0, seat),
    )  # fmt: skip
    limbs = timber("brown" if colour != "brown" else "black", rng) if rng.random() < 0.7 else fittings(rng)
    under = legs((0.06 - x, 0.06 - y, x - 0.06, y - 0.06), seat - 0.6 * thick, 0.036, 0.024, rng.uniform(0.0, 0.05))
    return [cover(cushion((-x, -y, seat - thick), (x, y, seat), round_), back), limbs(under)]


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
    places = np.linspace(-v, v, 7 if design == 0 else 8)[1:-1]
    for s in places:
        low, high = back(s, sill), back(s, head - 0.02)
        meshes.append(post(low, high, (0.012, 0.032), (0.012, 0.032)) if design == 0 else tube([low, high], 0.008, 6))
    return [timber(colour, rng)(*meshes, rail(head, 0.08), rail(sill, 0.04))]


def armchair(colour: str, rng: np.random.Generator) -> list[Part]:
    """An armchair: a small sofa for one, or cushions in a wooden frame."""
    return _seated(colour, 1, rng) if rng.random() < 0.6 else _lounge_chair(colour, rng)


def sofa(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sofa for two or three."""
    return _seated(colour, int(rng.integers(2, 4)), rng)


def _cloth(colour: str, rng: np.random.Generator) -> Callable[..., Part]:
    leather = colour in ("brown", "black", "white", "red", "beige") and rng.random() < 0.35
    return finish("leather" if leather else "fabric", colour, rng)


def _pillow(at: tuple[float, float, float], size: float, thick: float, lean: float, turn: float) -> Mesh:
    """A pillow that leans back by `lean` and is turned by `turn` radians; the middle of its lower edge is `at`."""
    soft = turned(cushion((-thick / 2, -size / 2, 0), (thick / 2, size / 2, 0.9 * size), 2.6), rotation(_Y, -lean))
    return moved(turned(soft, rotation(_Z, turn)), at)


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
    tilt = rotation(_Y, -rng.uniform(0.1, 0.2))
    for a, b in pairwise(np.linspace(-y, y, seats + 1)):
        body.append(cushion((back - x, a + 0.004, seat - 0.14), (x, b - 0.004, seat + 0.02), 6.0))
        plump = cushion((back - x - 0.03, a + 0.006, seat - 0.02), (back - x + 0.15, b - 0.006, top))
        body.append(turned(plump, tilt, (back - x + 0.06, 0, seat)))
    wood = timber("brown" if rng.random() < 0.6 else "black", rng) if rng.random() < 0.75 else fittings(rng)
    under = (0.08 - x, 0.03 - y - arm / 2, x - 0.08, y + arm / 2 - 0.03)
    parts = [cloth(*body), wood(legs(under, foot + 0.01, 0.05, 0.03 if foot > 0.1 else 0.045))]
    count = int(rng.integers(0, 3)) if seats > 1 else int(rng.random() < 0.4)
    if count:
        other = finish("fabric", str(rng.choice([c for c in CLOTHS if c not in (colour, "brown", "black")])), rng)
        size, side = rng.uniform(0.36, 0.44), (y - 0.22 if seats > 1 else 0.0)
        spots = [(side, 0.35), (-side, -0.35)][:count]
        at = back - x + 0.24, seat + 0.01
        parts.append(other(*(_pillow((at[0], s, at[1]), size, 0.15, rng.uniform(0.3, 0.5), -t) for s, t in spots)))
    return parts


def _lounge_chair(colour: str, rng: np.random.Generator) -> list[Part]:
    """A wooden frame with armrests that carries a seat cushion and a high, leaning back cushion."""
    cloth, wood = _cloth(colour, rng), timber("brown" if colour != "brown" else "beige", rng)
    w, d, seat, top = rng.uniform(0.58, 0.64), rng.uniform(0.62, 0.7), rng.uniform(0.42, 0.46), rng.uniform(0.84, 0.98)
    x, y, rest, frame = d / 2, w / 2, seat + 0.16, []
    for side in (-y - 0.03, y + 0.03):
        frame += [
            post((x + 0.02, side, 0), (x - 0.03, side, rest), (0.025, 0.03), (0.04, 0.03)),
            post((-x - 0.08, side, 0), (-x + 0.04, side, rest), (0.025, 0.03), (0.04, 0.03)),
            bevelled((-x - 0.04, side - 0.03, rest), (x, side + 0.03, rest + 0.025), 0.01, grain=0),
            post(
                (-x + 0.03, 0.93 * side, seat - 0.16), (-x - 0.22, 0.93 * side, top - 0.1), (0.04, 0.025), (0.03, 0.025)
            ),
        ]
    for a, z in ((x - 0.06, seat - 0.16), (-x + 0.02, seat - 0.18)):
        frame.append(box((a - 0.02, -y - 0.03, z), (a + 0.02, y + 0.03, z + 0.05), grain=1))
    plump = turned(cushion((-x + 0.02, -y, seat - 0.12), (x, y, seat + 0.03)), rotation(_Y, -0.08))
    back = cushion((-x - 0.08, -y + 0.005, seat - 0.02), (-x + 0.06, y - 0.005, top + 0.03))
    back = turned(back, rotation(_Y, -rng.uniform(0.3, 0.42)), (-x + 0.06, 0, seat))
    return [cloth(plump, back), wood(*frame)]


def bed(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bed for one or two; `colour` is that of the cover."""
    width = float(rng.choice([0.9, 1.0, 1.4, 1.6, 1.8]))
    rail, height = rng.uniform(0.2, 0.3), rng.uniform(0.44, 0.54)
    wood = colour if colour in WOODS and rng.random() < 0.7 else str(rng.choice(WOODS))
    x, y, joiner = _LENGTH / 2, width / 2 + 0.03, timber(wood, rng)
    frame = [
        *(board((-x, s - 0.015, rail - 0.1), (x + 0.03, s + 0.015, rail + 0.05)) for s in (-y + 0.015, y - 0.015)),
        board((x, -y, rail - 0.1), (x + 0.03, y, rail + 0.05)),
        box((-x, -y + 0.02, rail - 0.06), (x, y - 0.02, rail), grain=0),
        legs((-x + 0.1, -y + 0.04, x - 0.01, y - 0.04), rail - 0.05, 0.06, 0.045),
    ]
    top = height + rng.uniform(0.35, 0.52)
    if rng.random() < 0.4:  # a padded headboard
        cloth = finish("fabric", colour if rng.random() < 0.8 else "grey", rng)
        spans = pairwise(np.linspace(-y, y, 3 if width < 1.2 else 5))
        head = cloth(box((-x - 0.06, -y, 0), (-x - 0.02, y, top - 0.02)),
                     *(bevelled((-x - 0.04, a, 0.3), (-x + 0.04, b, top), 0.025) for a, b in spans))  # fmt: skip
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
    size, lean = min(0.7, 0.46 * width + 0.2), rng.uniform(0.8, 1.15)
    places = (-width / 4, width / 4) if width > 1.2 else (0.0,)
    pillows = [
        turned(cushion((-0.085, -size / 2, 0), (0.085, size / 2, 0.46), 2.6), rotation(_Y, -lean)) for _ in places
    ]
    at = -x + 0.09 + 0.46 * float(np.sin(lean)), height + 0.06
    pillows = [moved(soft, (at[0], s, at[1])) for soft, s in zip(pillows, places, strict=True)]
    parts = [head, joiner(*frame), cloth(cover), reverse(fold), white(mattress), linen(*pillows)]
    if rng.random() < 0.4:
        other = str(rng.choice([name for name in COLOURS if name not in (colour, "white", "black")]))
        soft = _pillow(
            (start + 0.1, rng.uniform(-0.1, 0.1) * width, height + 0.07), rng.uniform(0.34, 0.4), 0.13, 0.7, 0
        )
        parts.append(finish("fabric", other, rng)(soft))
    return parts
