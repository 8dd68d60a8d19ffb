"""Refrigerators, stoves and sinks.

A white sink is for a bathroom, on a pedestal or a small cabinet; a grey one is a kitchen unit with a steel top. The
part below the basin belongs to the sink and has its colour.
"""

from __future__ import annotations

import numpy as np

from eagor.worlds.apartment.curved import cylinder, lathe, tube
from eagor.worlds.apartment.furniture.bathroom import disc, ellipse, tap, vessel
from eagor.worlds.apartment.furniture.model import facing, finish, fittings, pull
from eagor.worlds.apartment.furniture.storage import base_units, front
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, box, merged, moved, rounded_rectangle


def refrigerator(colour: str, rng: np.random.Generator) -> list[Part]:
    """Freezer above or below, or two doors side by side, with long handles."""
    shell, metal = finish("metal" if colour == "grey" else "plastic", colour, rng), finish("metal", "grey", rng)
    seal = finish("plastic", "black" if colour != "black" else "grey", rng)
    design = rng.integers(3)
    wide = design == 2
    depth, width = rng.uniform(0.62, 0.7), rng.uniform(0.85, 0.92) if wide else rng.uniform(0.56, 0.68)
    height = rng.uniform(1.72, 1.82) if wide else rng.uniform(1.5, 1.95)
    x, y, edge, base = depth / 2, width / 2, depth / 2 - 0.065, 0.06
    dark = [
        box((edge - 0.012, -y + 0.012, base), (edge, y - 0.012, height - 0.008)),
        box((-x + 0.05, -y + 0.03, 0), (edge - 0.03, y - 0.03, 0.06)),
    ]
    if wide:
        split = rng.uniform(-0.12, 0.0)
        doors = [(-y, split - 0.003, base, height), (split + 0.003, y, base, height)]
        handles = [_bow(x, (split + side, 0.62), (split + side, 1.32), 0.012) for side in (-0.035, 0.035)]
        if rng.random() < 0.5:
            middle = (split - y) / 2
            dark.append(box((x - 0.004, middle - 0.1, 1.0), (x + 0.003, middle + 0.1, 1.32)))
    else:
        cut = height * (rng.uniform(0.66, 0.72) if design == 0 else rng.uniform(0.32, 0.4))
        doors = [(-y, y, base, cut - 0.004), (-y, y, cut + 0.004, height)]
        side = (y - 0.05) * (1 if rng.random() < 0.5 else -1)
        a, b, c, d = (0.5, 0.08, 0.06, 0.32) if design == 0 else (0.3, 0.06, 0.08, 0.55)
        spans = ((cut - a, cut - b), (cut + c, cut + d))
        handles = [_bow(x, (side, low), (side, high), 0.012) for low, high in spans]
    fronts = [bevelled((edge, y0, z0), (x, y1, z1), 0.02, 2) for y0, y1, z0, z1 in doors]
    return [shell(box((-x, -y, 0.03), (edge - 0.012, y, height)), *fronts), seal(*dark), metal(*handles)]


def _bow(x: float, start: tuple[float, float], end: tuple[float, float], radius: float) -> Mesh:
    """A bar handle between two points (y, z) of a front at `x`, 4 cm before it, with its ends bent to the front."""
    dy, dz = (0.02 if b > a else 0.0 for a, b in zip(start, end, strict=True))
    far = [(x + 0.04, start[0] + dy, start[1] + dz), (x + 0.04, end[0] - dy, end[1] - dz)]
    return tube([(x - 0.005, *start), *far, (x - 0.005, *end)], radius, 6)


def stove(colour: str, rng: np.random.Generator) -> list[Part]:
    """Four plates over an oven with a window, a handle and a row of knobs; some with a panel at the back."""
    shell, metal = finish("metal" if colour == "grey" else "plastic", colour, rng), finish("metal", None, rng)
    glass, plates = finish("plastic", "black", rng), finish("metal", "black" if rng.random() < 0.5 else "grey", rng)
    width, depth, height = rng.uniform(0.58, 0.66), 0.6, rng.uniform(0.86, 0.92)
    x, y, door_top, door_low = depth / 2, width / 2, height - 0.16, 0.24
    body = [
        box((-x, -y, 0.08), (x - 0.03, y, height - 0.012)),
        box((-x + 0.02, -y + 0.02, 0), (x - 0.08, y - 0.02, 0.08)),
        bevelled((x - 0.03, -y + 0.004, door_low), (x, y - 0.004, door_top), 0.008),
        bevelled((x - 0.03, -y + 0.004, 0.085), (x, y - 0.004, door_low - 0.008), 0.008),
        box((x - 0.03, -y, door_top + 0.008), (x - 0.006, y, height - 0.012)),
    ]
    dark = [box((x - 0.01, -y + 0.09, door_low + 0.1), (x + 0.002, y - 0.09, door_top - 0.12))]
    bright = [_bow(x, (-half, z), (half, z), 0.01) for half, z in ((y - 0.05, door_top - 0.055), (y - 0.14, 0.2))]
    knob = facing(cylinder((0, 0, 0), 0.021, 0.03, 10), (x - 0.006, 0.0, height - 0.075))
    bright += [moved(knob, (0, at, 0)) for at in np.linspace(-y + 0.09, y - 0.09, 5)]
    gas, rings = rng.random() < 0.4, []
    (body if gas else dark).append(bevelled((-x, -y, height - 0.012), (x, y, height), 0.004))
    for px, py, r in ((-0.13, -0.14, 0.085), (-0.13, 0.14, 0.1), (0.13, -0.14, 0.1), (0.13, 0.14, 0.085)):
        if gas:
            arm = 1.15 * r
            rings.append(cylinder((px, py, height), 0.5 * r, 0.022, 10))
            for dx, dy in ((arm, 0.006), (0.006, arm)):
                rings.append(box((px - dx, py - dy, height + 0.022), (px + dx, py + dy, height + 0.034)))
        else:
            rim = [(r, 0), (r, 0.006), (r, 0.006), (0.86 * r, 0.006), (0.84 * r, 0.003)]
            rings.append(moved(lathe([(0, 0), *rim, (0, 0.003)], 14), (px, py, height)))
    if rng.random() < 0.5:
        body.append(bevelled((-x, -y, height - 0.01), (-x + 0.05, y, height + rng.uniform(0.08, 0.16)), 0.008))
    return [shell(*body), glass(*dark), plates(*rings), metal(*bright)]


def sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A sink: white for the bathroom, grey for the kitchen."""
    if colour == "grey":
        return _kitchen_sink(rng)
    return (_pedestal_sink if rng.random() < 0.6 else _cabinet_sink)(colour, rng)


def _basin(x: float, y: float, shift: float, z: float, deep: float, rounded: bool) -> tuple[np.ndarray, Mesh]:
    """The outline of a basin's opening ``(24, 2)`` and the hollow under it."""
    outline = ellipse(x, y, 24) if rounded else rounded_rectangle(2 * x, 2 * y, 0.06, 5)
    hollow = vessel([(outline, shift, z), (0.94 * outline, shift, z - 0.6 * deep), (0.6 * outline, shift, z - deep)])
    return outline, merged(hollow, disc(0.6 * outline, shift, z - deep))


def _plate(x: float, y: float, outline: np.ndarray, shift: float, z: float) -> Mesh:
    """The flat rim at height `z` between an opening and the rectangle with half sides `x`, `y` round it."""
    inner = outline + np.array([shift, 0])
    reach = np.minimum(x / np.maximum(np.abs(inner[:, 0]), 1e-9), y / np.maximum(np.abs(inner[:, 1]), 1e-9))
    outer = inner * reach[:, None]
    for at in np.array([[x, y], [-x, y], [-x, -y], [x, -y]]):  # the ray nearest to each corner goes into it
        outer[np.argmax(inner @ at / np.linalg.norm(inner, axis=1))] = at
    return vessel([(outer, 0.0, z), (inner, 0.0, z)])


def _edge(x: float, y: float, low: float, high: float) -> Mesh:
    """The upright rim round a rectangular top with half sides `x`, `y`."""
    outline = np.array([[x, -y], [x, y], [-x, y], [-x, -y]])
    return vessel([(outline, 0.0, low), (outline, 0.0, high)])


def _pedestal_sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A bowl with a ledge for the tap at the wall, on a column."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    x, y, height = rng.uniform(0.2, 0.24), rng.uniform(0.26, 0.32), rng.uniform(0.82, 0.88)
    rim, hole = rounded_rectangle(2 * x, 2 * y, 0.6 * x, 5), ellipse(0.72 * x, 0.78 * y, 24)
    outer = rim[np.argsort(np.arctan2(rim[:, 1], rim[:, 0]) % (2 * np.pi), kind="stable")]
    bowl = vessel(
        [
            (0.45 * outer, -0.02, height - 0.2), (0.8 * outer, -0.01, height - 0.14), (outer, 0, height - 0.06),
            (outer, 0, height), (outer, 0, height), (hole, 0.2 * x, height), (hole, 0.2 * x, height),
            (0.85 * hole, 0.2 * x, height - 0.08), (0.4 * hole, 0.2 * x, height - 0.13),
        ]
    )  # fmt: skip
    bottom = disc(0.4 * hole, 0.2 * x, height - 0.13)
    column = lathe([(0.1, 0), (0.1, 0.02), (0.07, 0.12), (0.065, 0.5), (0.1, height - 0.17)], 16)
    drain = cylinder((0.2 * x, 0, height - 0.13), 0.022, 0.004, 10)
    return [glaze(bowl, bottom, moved(column, (-0.04, 0, 0))), metal(tap(-0.78 * x, 0, height, 0.13, 0.11), drain)]


def _cabinet_sink(colour: str, rng: np.random.Generator) -> list[Part]:
    """A basin let into the top of a small cabinet."""
    glaze, metal = finish("ceramic", colour, rng), finish("metal", None, rng)
    wood = finish("paint", colour, rng)
    x, y, height = 0.235, rng.uniform(0.3, 0.45), rng.uniform(0.8, 0.86)
    low = height - 0.05
    body = [
        box((-x + 0.01, -y + 0.01, 0.12), (x - 0.03, y - 0.01, low - 0.1), 2),
        box((-x + 0.03, -y + 0.03, 0), (x - 0.09, y - 0.03, 0.12), 1),
    ]
    # Round the hollow of the basin there are only the cabinet's walls.
    body += [box((-x + 0.01, s - 0.008, low - 0.1), (x - 0.03, s + 0.008, low), 2) for s in (-y + 0.018, y - 0.018)]
    body += [front(x - 0.03, a, b, 0.125, low - 0.003, False) for a, b in ((-y + 0.012, -0.002), (0.002, y - 0.012))]
    outline, hollow = _basin(0.15, min(0.24, y - 0.06), 0.03, height, 0.11, rng.random() < 0.5)
    handles = [pull(x - 0.012, s, low - 0.14, 0.12, upright=True) for s in (-0.04, 0.04)]
    drain = cylinder((0.03, 0, height - 0.11), 0.022, 0.004, 10)
    top = glaze(_plate(x, y, outline, 0.03, height), hollow, _edge(x, y, low, height))
    return [wood(*body), top, metal(tap(-x + 0.06, 0, height, 0.14, 0.14), drain, *handles)]


def _kitchen_sink(rng: np.random.Generator) -> list[Part]:
    """Base units under a steel top with one or two basins, a drainer and a tall tap."""
    steel, bright = finish("metal", "grey", rng), finish("metal", None, rng)
    x, y, height = 0.29, rng.uniform(0.5, 0.8), rng.uniform(0.88, 0.92)
    top = height - 0.03
    body, handles = base_units(x, y, top - 0.17, rng, framed=False, drawers=False)
    walls = [box((-x, s - 0.009, top - 0.17), (x - 0.02, s + 0.009, top), 2) for s in (-y + 0.009, y - 0.009)]
    walls.append(box((x - 0.04, -y, top - 0.175), (x, y, top), 1))
    wide, roomy = x + 0.02, y > 0.6
    outline, hollow = _basin(0.19, 0.24 if roomy else 0.26, 0.02, height, 0.16, False)
    centre = -y + 0.36
    left, right = (centre - 0.3, centre + 0.3) if roomy else (-y, y)
    middle = (left + right) / 2
    plates = [moved(merged(_plate(wide, (right - left) / 2, outline, 0.02, height), hollow), (0, middle, 0))]
    for y0, y1 in ((-y, left), (right, y)):
        if y1 - y0 > 0.02:
            ridges = np.arange(y0 + 0.06, y1 - 0.05, 0.045)
            plates.append(box((-wide, y0, top), (wide, y1, height)))
            plates += [box((-0.18, g, height), (0.2, g + 0.012, height + 0.005)) for g in ridges]
    drain = cylinder((0.02, middle, height - 0.16), 0.03, 0.004, 10)
    fixture = tap(-x + 0.06, middle, height, 0.2, 0.3)
    fronts = finish("metal" if rng.random() < 0.4 else "paint", "grey", rng)
    steel_top = steel(*plates, _edge(wide, y, top, height))
    return [fronts(body, *walls), fittings(rng)(handles), steel_top, bright(fixture, drain)]
