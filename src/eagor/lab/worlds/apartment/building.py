"""The building: paint, tiles and floors of its rooms; walls, floors and ceilings; doors and windows.

The surface of the building is every face between air and solid in its grid of cells, so it is always closed. Adjacent
faces that look alike are merged into rectangles. Doors and windows have linings, casings, leaves with handles, frames
with muntins, and sill boards.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.lab.worlds.apartment.mesh import (
    Mesh,
    Part,
    bevelled,
    board,
    box,
    merged,
    moved,
    part,
    placed,
    quad_triangles,
    solid,
    tube,
)
from eagor.lab.worlds.apartment.placement import GAP, Piece, from_rectangle, overlaps
from eagor.lab.worlds.apartment.plans import (
    HALF_WALL,
    LINING,
    NICHE,
    OUTSIDE,
    SOLID,
    Boundary,
    Cells,
    Doorway,
    Opening,
    Plan,
    rectangles_of,
    wall_faces,
)
from eagor.lab.worlds.apartment.textures import REPEAT, material
from eagor.lab.worlds.light import mean_colour
from eagor.lab.worlds.scene import Lamp, Material, Room

SurfaceMaterial = tuple[str, Material]  # kind of material (its repeat), and the material

# sRGB of wall paint: warm whites first, then pastel tints.
_WHITES = ((240, 234, 222), (238, 236, 230), (236, 228, 214))
_TINTS = ((222, 230, 216), (214, 224, 232), (238, 222, 204), (232, 216, 214), (226, 220, 236), (240, 230, 196))

# The reference room, for which one ceiling lamp of default power is right: square metres of floor, walls and ceiling,
# and the share of the light that they absorb.
_SURFACE, _ABSORPTION = 60.0, 0.45
_SHARES = (0.2, 1.7)  # range of that power, as of real lamps
_FURNISHED = 0.15  # share of the surface that furniture and open doors cover
_DARK = 0.75  # absorption of those
WALL, TILES, FACADE, REVEAL, FLOOR, CEILING = range(6)  # kinds of surface
_CASING = (0.06, 0.015)  # width, thickness
_LEAF = 0.04


@dataclass(frozen=True, eq=False)
class Finish:
    """The surfaces of a room; `tiled`: the range of height in which all of its walls have `tiles`."""

    wall: SurfaceMaterial
    tiles: SurfaceMaterial | None
    tiled: tuple[float, float]
    floor: SurfaceMaterial
    ceiling: SurfaceMaterial
    reveal: SurfaceMaterial
    facade: SurfaceMaterial
    skirting: SurfaceMaterial | None


def draw_finishes(plan: Plan, rng: np.random.Generator) -> tuple[Finish, ...]:
    """One finish for each room; rooms that are open to each other share their wall paint and mostly their floor."""
    facade = ("plaster", material("plaster", None, rng))
    white = ("paint", material("paint", "white", rng))
    ceiling = ("paint", _tinted(material("paint", "white", rng), (244, 243, 240), rng))
    parquet = ("parquet", material("parquet", None, rng))
    skirting = white if rng.random() < 0.6 else ("wood", material("wood", None, rng))
    wall_kind = "plaster" if rng.random() < 0.5 else "paint"
    finishes: list[Finish] = []
    for place, space in enumerate(plan.spaces):
        joined = [a for a, b in plan.open_to if b == place] + [b for a, b in plan.open_to if a == place and b < place]
        tone = _WHITES[rng.integers(len(_WHITES))] if rng.random() < 0.5 else _TINTS[rng.integers(len(_TINTS))]
        if joined:
            wall = finishes[joined[0]].wall
        else:
            wall = (wall_kind, _tinted(material(wall_kind, "white", rng), tone, rng))
        tiles, tiled, floor, boards = None, (0.0, 0.0), parquet, skirting
        if space.kind == "bathroom":
            tiles, floor, boards = ("tile", material("tile", None, rng)), ("tile", material("tile", None, rng)), None
            tiled = (0.0, plan.height) if rng.random() < 0.5 else (0.0, float(rng.choice([1.4, 2.0])))
        elif space.kind == "kitchen":
            tiles = ("tile", material("tile", None, rng))  # above the worktop
            if not joined or rng.random() < 0.5:
                floor = ("tile", material("tile", None, rng))
        elif space.kind == "bedroom" and rng.random() < 0.5 and not joined:
            floor = ("carpet", material("carpet", None, rng))
        elif space.kind == "hall" and rng.random() < 0.3:
            floor = ("tile", material("tile", None, rng))
        finishes.append(Finish(wall, tiles, tiled, floor, ceiling, white, facade, boards))
    return tuple(finishes)


def _tinted(look: Material, tone: tuple[int, int, int], rng: np.random.Generator) -> Material:
    """`look` in a slightly varied tone (sRGB, 0 to 255)."""
    linear = to_linear(np.array(tone) / 255 * rng.uniform(0.98, 1.02))
    if look.texture is not None:
        linear = linear / to_linear(look.texture[::4, ::4] / 255).mean(axis=(0, 1))
    r, g, b = to_coded(linear)
    return replace(look, name=f"wall {look.name}", colour=(float(r), float(g), float(b)))


def lit(pieces: Sequence[Piece], rooms: Sequence[Room], finishes: Sequence[Finish], height: float) -> list[Piece]:
    """The same pieces with ceiling lamps of a power that suits their rooms; `height` of the rooms in metres.

    The light between walls is the power of the lamps over the absorption of the surfaces (the integrating sphere).
    """
    count = Counter(piece.room for piece in pieces if piece.category == "ceiling lamp")
    shares = {
        room: float(np.clip(_swallowed(rooms[room], finishes[room], height) / (_SURFACE * _ABSORPTION) / n, *_SHARES))
        for room, n in count.items()
    }
    found = []
    for piece in pieces:
        if piece.category == "ceiling lamp":
            lamps = tuple(replace(lamp, power=shares[piece.room] * lamp.power) for lamp in piece.model.lamps)
            piece = replace(piece, model=replace(piece.model, lamps=lamps))
        found.append(piece)
    return found


def _swallowed(room: Room, finish: Finish, height: float) -> float:
    """The absorption of a room's floor, walls and ceiling, as square metres of black."""
    x0, y0, x1, y1 = room.rectangles.T
    walls = float((2 * (x1 - x0 + y1 - y0)).sum()) * height
    low, high = (float(np.clip(level, 0, height)) for level in finish.tiled)
    tiled = (high - low) / height if finish.tiles else 0.0
    surfaces = [(room.area, finish.floor[1]), (room.area, finish.ceiling[1]), ((1 - tiled) * walls, finish.wall[1])]
    surfaces.append((tiled * walls, (finish.tiles or finish.wall)[1]))
    bare = sum(area * (1 - float(mean_colour(look).mean())) for area, look in surfaces)
    return (1 - _FURNISHED) * bare + _FURNISHED * _DARK * (walls + 2 * room.area)


@dataclass(frozen=True, eq=False)
class Thing:
    """One future `Instance`: its name, the room it is in, and its parts and lamps in the world frame."""

    category: str
    colour: str | None
    room: str | None
    parts: tuple[Part, ...]
    lamps: tuple[Lamp, ...] = ()


def shell(plan: Plan, cells: Cells, finishes: tuple[Finish, ...]) -> tuple[dict[str, list[Part]], ...]:
    """For each room the parts of its "wall", "floor" and "ceiling"."""
    meshes: dict[tuple[int, int], list[Mesh]] = {}
    zs = cells.lines[2]
    tiled = np.zeros((len(plan.spaces), len(zs) - 1), dtype=bool)
    for place, finish in enumerate(finishes):
        low, high = finish.tiled
        tiled[place] = (zs[:-1] >= low - 1e-6) & (zs[1:] <= high + 1e-6)
    for axis in range(3):
        for sign in (1, -1):
            key = _faces(cells, axis, sign, tiled)
            for k in np.flatnonzero(key.any(axis=(1, 2))):
                for value, *rectangle in rectangles_of(key[k]):
                    corners = _corners(cells, axis, sign, int(k), rectangle)
                    meshes.setdefault(divmod(value - 1, 8), []).append(corners)
    rooms = tuple({"wall": [], "floor": [], "ceiling": []} for _ in plan.spaces)
    for (place, surface), pieces in sorted(meshes.items()):
        finish = finishes[place]
        tiles = finish.tiles or finish.wall
        looks = (finish.wall, tiles, finish.facade, finish.reveal, finish.floor, finish.ceiling)
        kind, look = looks[surface]
        name = {FLOOR: "floor", CEILING: "ceiling"}.get(surface, "wall")
        rooms[place][name].append(part(merged(*pieces), look, REPEAT[kind]))
    for face in wall_faces(cells):
        finish = finishes[face.room]
        if finish.skirting is not None and face.end - face.start > 0.02:
            low, high = sorted((face.line, face.line + face.side * 0.012))
            order = [0, 1, 2] if face.axis == 0 else [1, 0, 2]
            bounds = np.array([[face.start, low, 0.0], [face.end, high, 0.08]])[:, order]
            board, (kind, look) = box(*bounds, grain=face.axis), finish.skirting
            rooms[face.room]["wall"].append(part(board, look, REPEAT[kind]))
    return rooms


def _faces(cells: Cells, axis: int, sign: int, tiled: np.ndarray) -> np.ndarray:
    """Room and surface, coded in one number (0: no face), of each face that points along `sign` times `axis`."""
    air = np.moveaxis(cells.air, axis, 0)
    hole = np.moveaxis(cells.hole, axis, 0)
    owner = np.moveaxis(np.broadcast_to(cells.owner[:, :, None], cells.air.shape), axis, 0)
    if axis == 2:  # solid above the ceiling and below the floor
        pad = np.full((1, *air.shape[1:]), SOLID)
        air = np.concatenate([pad, air, np.where(air[-1:] == SOLID, OUTSIDE, pad)])
        hole = np.concatenate([hole[:1], hole, hole[-1:]])
        owner = np.concatenate([owner[:1], owner, owner[-1:]])
    behind, before = slice(None, -1), slice(1, None)
    if sign < 0:
        behind, before = before, behind
    shows = (air[behind] == SOLID) & (air[before] != SOLID)
    inside = air[before] >= 0
    room = np.where(inside, air[before], owner[behind])
    if axis == 2:
        surface = np.full(shows.shape, REVEAL)
        surface[0 if sign > 0 else -1] = FLOOR if sign > 0 else CEILING
    else:
        level = np.broadcast_to(np.arange(tiled.shape[1]), shows.shape)
        surface = np.where(tiled[np.maximum(room, 0), level], TILES, WALL)
        surface[hole[before]] = REVEAL
    surface[~inside] = FACADE
    return np.where(shows & (room >= 0), room * 8 + surface + 1, 0)


def _corners(cells: Cells, axis: int, sign: int, k: int, rectangle: list[int]) -> Mesh:
    """The rectangle of cells in plane `k` as two triangles that point along `sign` times `axis`."""
    first, second = (other for other in range(3) if other != axis)
    lines = cells.lines
    a0, b0, a1, b1 = rectangle
    a, b = lines[first][[a0, a1]], lines[second][[b0, b1]]
    corners = np.empty((4, 3))
    corners[:, axis] = lines[axis][k + 1] if axis < 2 else lines[2][k]
    corners[:, first], corners[:, second] = a[[0, 1, 1, 0]], b[[0, 0, 1, 1]]
    if (sign < 0) != (axis == 1):  # x, z runs clockwise seen from +y
        corners = corners[::-1]
    return solid(corners, quad_triangles(1))


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


def doors_and_windows(plan: Plan, style: Style, rooms: Sequence[dict[str, list[Part]]]) -> list[Thing]:
    """Doors and windows as things; where a doorway has no leaf, its casings go to the walls of `rooms` (`shell`)."""
    things: list[Thing] = []
    for doorway in plan.doorways:
        home = max(doorway.side > 0, doorway.boundary.rooms[0] == OUTSIDE)
        room = doorway.boundary.rooms[int(home)]
        lining, casings = _frame(doorway, style)
        if doorway.leaf is None:
            rooms[room]["wall"].append(lining)
            for place, casing in casings.items():
                rooms[place]["wall"].append(casing)
        else:
            parts = (lining, *casings.values(), *_leaf(doorway, style))
            things.append(Thing("door", style.colour, plan.spaces[room].name, parts))
    for window in plan.windows:
        room = max(window.boundary.rooms)
        things.append(Thing("window", None, plan.spaces[room].name, _window(window, style)))
    return things


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


def splashback(piece: Piece, plan: Plan, tiles: SurfaceMaterial) -> Part | None:
    """Tiles on the wall above a kitchen unit, up to a window if there is one; None if no unit stands at a wall."""
    if piece.category not in ("cabinet", "sink", "stove") or plan.spaces[piece.room].kind != "kitchen":
        return None
    sills = [w.sill for w in plan.windows if overlaps(piece.box, from_rectangle(w.approach(0.4, 0.05)))[0, 0]]
    top = min([1.45, *(sill - 0.02 for sill in sills)])
    depth, width = piece.box[2:4]
    mesh = box((-depth - GAP + 1e-3, -width - 2e-3, 0.86), (-depth - GAP + 0.013, width + 2e-3, top))
    (made,) = placed([part(mesh, tiles[1], REPEAT[tiles[0]])], float(piece.box[4]), (*piece.box[:2], 0.0))
    return made
