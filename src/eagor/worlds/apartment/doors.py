"""Doors and windows: linings, casings, leaves with handles, frames with muntins, sill boards."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.cells import NICHE
from eagor.worlds.apartment.curved import tube
from eagor.worlds.apartment.mesh import Mesh, Part, bevelled, board, box, merged, moved, part, placed
from eagor.worlds.apartment.openings import HALF_WALL, LINING, OUTSIDE, Boundary, Doorway, Opening
from eagor.worlds.apartment.plans import Plan
from eagor.worlds.apartment.shell import Thing
from eagor.worlds.apartment.textures import REPEAT, material
from eagor.worlds.scene import Material

_CASING = (0.06, 0.015)  # width, thickness
_LEAF = 0.04


@dataclass(frozen=True, eq=False)
class Style:
    """What all doors and windows of an apartment have in common; `panels`: how many a leaf has, or none."""

    kind: str
    colour: str
    door: Material
    frame: Material
    window: Material
    metal: Material
    panels: int


def draw_style(rng: np.random.Generator) -> Style:
    """White or wooden doors, white or dark windows."""
    kind, colour = (("paint", "white"), ("wood", "brown"), ("paint", "white"), ("paint", "grey"))[rng.integers(4)]
    door = material(kind, colour, rng)
    frame = door if rng.random() < 0.6 or kind == "wood" else material("paint", "white", rng)
    window = material("paint", str(rng.choice(["white", "white", "grey", "brown"])), rng)
    return Style(kind, colour, door, frame, window, material("metal", None, rng), int(rng.choice([0, 2, 3])))


def doors_and_windows(plan: Plan, style: Style) -> tuple[list[Thing], dict[int, list[Part]]]:
    """Doors and windows as things; for each room the casings of its wall, where a doorway has no leaf."""
    things: list[Thing] = []
    trim: dict[int, list[Part]] = {place: [] for place in range(len(plan.spaces))}
    for doorway in plan.doorways:
        home = max(doorway.side > 0, doorway.boundary.rooms[0] == OUTSIDE)
        room = doorway.boundary.rooms[int(home)]
        lining, casings = _frame(doorway, style)
        if doorway.leaf is None:
            trim[room].append(lining)
            for place, casing in casings.items():
                trim[place].append(casing)
        else:
            parts = (lining, *casings.values(), *_leaf(doorway, style))
            things.append(Thing("door", style.colour, plan.spaces[room].name, parts))
    for window in plan.windows:
        room = max(window.boundary.rooms)
        things.append(Thing("window", None, plan.spaces[room].name, _window(window, style)))
    return things, trim


def _bars(boundary: Boundary, *bars: tuple[float, ...]) -> Mesh:
    """Boards from and to, along and across a boundary, and in height: six numbers each."""
    made = []
    for start, end, low, high, bottom, top in bars:
        x0, y0, x1, y1 = boundary.box(start, end, low, high)
        made.append(board((x0, y0, bottom), (x1, y1, top)))
    return merged(*made)


def _frame(doorway: Doorway, style: Style) -> tuple[Part, dict[int, Part]]:
    """The lining of the hole, and the casing on the side of each room."""
    boundary, start, end, head = doorway.boundary, doorway.start, doorway.end, doorway.head
    repeat = REPEAT[style.kind]
    low, high = -HALF_WALL, HALF_WALL
    if boundary.rooms[0] == OUTSIDE:
        low = HALF_WALL - NICHE
    elif boundary.rooms[1] == OUTSIDE:
        high = NICHE - HALF_WALL
    jambs = _bars(
        boundary,
        (start, start + LINING, low, high, 0.0, head),
        (end - LINING, end, low, high, 0.0, head),
        (start, end, low, high, head - LINING, head),
    )
    width, thickness = _CASING
    casings = {}
    for room, face, sign in ((boundary.rooms[0], -HALF_WALL, -1), (boundary.rooms[1], HALF_WALL, 1)):
        if room == OUTSIDE:
            continue
        across, top = sorted((face, face + sign * thickness)), head + width
        casing = _bars(
            boundary,
            (start - width, start + 0.01, *across, 0.0, top),
            (end - 0.01, end + width, *across, 0.0, top),
            (start, end, *across, head - 0.01, top),
        )
        casings[room] = part(casing, style.frame, repeat)
    return part(jambs, style.frame, repeat), casings


def _leaf(doorway: Doorway, style: Style) -> tuple[Part, ...]:
    """The leaf in its place: open, or closed in the niche of the front door."""
    width = doorway.end - doorway.start - 2 * LINING - 0.006
    origin, far, beside = doorway.at(0.0, 0.0), doorway.at(1.0, 0.0), doorway.at(0.0, 1.0)
    along, across = far - origin, beside - origin
    left = along[0] * across[1] - along[1] * across[0] > 0  # the thickness lies to the left of the leaf's direction
    shift = 0.0 if left else -_LEAF
    top = doorway.head - LINING - 0.005
    slab = [moved(bevelled((0.003, 0.0, 0.008), (width, _LEAF, top), 0.003, grain=2), (0.0, shift, 0.0))]
    for i in range(style.panels):
        low = 0.14 + i * (top - 0.28) / style.panels + 0.04
        high = 0.14 + (i + 1) * (top - 0.28) / style.panels - 0.04
        for y in (shift - 0.007, shift + _LEAF - 0.003):
            slab.append(bevelled((0.12, y, low), (width - 0.12, y + 0.01, high), 0.004, grain=2))
    handles = []
    for sign, face in ((-1, shift), (1, shift + _LEAF)):
        x = width - 0.06
        near, far = sorted((face, face + sign * 0.006))
        handles.append(box((x - 0.018, near, 0.92), (x + 0.018, far, 1.12)))
        reach = face + sign * 0.045
        handles.append(tube([(x, face, 1.03), (x, reach, 1.03), (x - 0.11, reach, 1.03)], 0.009, 6))
    parts = [part(merged(*slab), style.door, REPEAT[style.kind]), part(merged(*handles), style.metal, REPEAT["metal"])]
    return placed(parts, math.atan2(along[1], along[0]), (*origin, 0.0))


def _window(window: Opening, style: Style) -> tuple[Part, ...]:
    """Frame with muntins in the outer half of the wall, and a sill board; there is no glass."""
    boundary, start, end = window.boundary, window.start, window.end
    outwards = -1 if boundary.rooms[0] == OUTSIDE else 1
    face = -outwards * HALF_WALL
    near, far = sorted((face + outwards * 0.11, face + outwards * 0.17))
    low, high, thick = window.sill, window.head, 0.05
    bars: list[tuple[float, ...]] = [
        (start, start + thick, near, far, low, high),
        (end - thick, end, near, far, low, high),
        (start + thick, end - thick, near, far, low, low + thick),
        (start + thick, end - thick, near, far, high - thick, high),
    ]
    count = 0 if end - start < 0.75 else 1 if end - start < 1.7 else 2
    middle = (near + far) / 2
    for i in range(count):
        at = start + (i + 1) * (end - start) / (count + 1)
        bars.append((at - 0.035, at + 0.035, near + 0.005, far - 0.005, low + thick, high - thick))
    if high - low > 1.1:
        at = high - 0.42
        bars.append((start + thick, end - thick, middle - 0.015, middle + 0.015, at - 0.02, at + 0.02))
    bars.append((start, end, *sorted((face, face + outwards * 0.11)), low, low + 0.022))  # the sill board
    bars.append((start - 0.04, end + 0.04, *sorted((face - outwards * 0.035, face)), low - 0.01, low + 0.022))
    return (part(_bars(boundary, *bars), style.window, REPEAT["paint"]),)
