"""Chairs: wooden ones, upholstered ones, and moulded shells."""

from __future__ import annotations

import numpy as np

from eagor.worlds.apartment.curved import cushion, slab, tube
from eagor.worlds.apartment.furniture.model import finish, fittings, legs, timber
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, box, loft, moved, post, reshaped


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
