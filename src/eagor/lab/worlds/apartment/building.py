"""The building: its cells; paint, tiles and floors of its rooms; walls, floors and ceilings; doors and windows.

Cells are those of a grid whose widths follow the plan's lines: air of a room, air outside, or solid. The surface of the
building is every face between air and solid, so it is always closed. Adjacent faces that look alike are merged into
rectangles. Doors and windows have linings, casings, leaves with handles, frames with muntins, and sill boards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.lab.worlds.apartment import mesh as m
from eagor.lab.worlds.apartment import plans
from eagor.lab.worlds.apartment.plans import HALF_WALL, LINING, OUTER_WALL, OUTSIDE, Opening, Plan, Rectangle
from eagor.lab.worlds.scene import STRUCTURE, Lamp, Room

SOLID = -2
WALL, TILES, FACADE, REVEAL, FLOOR, CEILING = range(6)  # kinds of surface
_LEAF = 0.04  # thickness
# sRGB of wall paint: warm whites first, then pastel tints.
_WHITES = ((240, 234, 222), (238, 236, 230), (236, 228, 214))
_TINTS = ((222, 230, 216), (214, 224, 232), (238, 222, 204), (232, 216, 214), (226, 220, 236), (240, 230, 196))

# --- cells ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cells:
    """The grid, and the rooms between their walls, without the floor in doorways.

    `lines` along x, y, z; `air` ``(nx, ny, nz)``: the room, `OUTSIDE` or `SOLID`; `hole`: whether the cell is in a
    doorway or window; `owner` ``(nx, ny)``: the room that the walls there belong to.
    """

    lines: tuple[np.ndarray, np.ndarray, np.ndarray]
    air: np.ndarray
    hole: np.ndarray
    owner: np.ndarray
    rooms: tuple[Room, ...]


def carve(plan: Plan, levels: tuple[float, ...] = ()) -> Cells:
    """The cells of a plan, split at further `levels` of z where the look of a wall changes."""
    holes = (*plan.doorways, *plan.windows)
    outwards = OUTER_WALL - HALF_WALL
    cuts = []
    for axis, end in enumerate(plan.extent):
        lines = np.concatenate([space.rectangles[:, axis::2].ravel() for space in plan.spaces])
        ends = [hole.hole[k] for hole in holes for k in (axis, axis + 2)]
        rim = (-outwards - 1.0, -outwards, end + outwards, end + outwards + 1.0)
        cuts.append(np.concatenate([lines - HALF_WALL, lines, lines + HALF_WALL, ends, rim]))
    heights = [0.0, plan.height, *levels, *(hole.sill for hole in holes), *(hole.head for hole in holes)]
    xs, ys, zs = (np.unique(np.round(values, 4)) for values in (*cuts, heights))

    def span(lines: np.ndarray, low: float, high: float) -> slice:
        return slice(*np.searchsorted(lines, [low - 1e-6, high - 1e-6]).tolist())

    def window(rectangle: Rectangle) -> tuple[slice, slice]:
        x0, y0, x1, y1 = np.round(rectangle, 4)
        return span(xs, x0, x1), span(ys, y0, y1)

    room = plans.owners(plan.spaces, xs, ys)
    owner = room.copy()
    solid = np.zeros(room.shape, dtype=bool)
    corners: tuple[set[tuple[float, float]], ...] = (set(), set())  # the ends of walls along x, and along y
    for wall in plan.walls:
        low, high = (-outwards if place == OUTSIDE else -HALF_WALL for place in wall.rooms)
        beyond = outwards if OUTSIDE in wall.rooms else 0.0
        solid[window(wall.box(wall.start, wall.end, -HALF_WALL, HALF_WALL))] = True
        wide = window(wall.box(wall.start - beyond, wall.end + beyond, low, -high))
        outer = room[wide] == OUTSIDE
        solid[wide] |= outer
        owner[wide][outer & (owner[wide] == OUTSIDE)] = max(wall.rooms)
        corners[wall.axis].update((wall.point(wall.start), wall.point(wall.end)))
    for x, y in corners[0] & corners[1]:
        solid[window((x - HALF_WALL, y - HALF_WALL, x + HALF_WALL, y + HALF_WALL))] = True
    air = np.where(solid, SOLID, room)[:, :, None].repeat(len(zs) - 1, axis=2)
    carved = np.zeros(air.shape, dtype=bool)
    for hole in holes:
        where, upright = window(hole.hole), span(zs, hole.sill, hole.head)
        air[(*where, upright)] = owner[where][:, :, None]
        carved[(*where, upright)] = True
    ground = np.where(carved[:, :, 0], SOLID, air[:, :, 0])
    covers = [_few_rectangles(ground == place, xs, ys) for place in range(len(plan.spaces))]
    rooms = tuple(Room(space.name, space.kind, cover) for space, cover in zip(plan.spaces, covers, strict=True))
    return Cells((xs, ys, zs), air, carved, owner, rooms)


def wall_faces(cells: Cells) -> list[plans.Boundary]:
    """The stretches of wall that stand on the floor, without those inside doorways: each between a room and `SOLID`."""
    ground = np.where(cells.hole[:, :, 0], OUTSIDE, cells.air[:, :, 0])
    edges = plans.find_boundaries(ground, *cells.lines[:2])
    faces = [edge for edge in edges if min(edge.rooms) == SOLID and max(edge.rooms) >= 0]
    return sorted(faces, key=lambda face: (face.axis, face.line, face.rooms[1] == SOLID))


def _few_rectangles(mask: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Rectangles ``(n, 4)`` x0, y0, x1, y1 that cover the cells in `mask`: few, the first as large as possible."""
    options = []
    for turned, step in product((False, True), (1, -1)):  # from each of two corners, first along x or along y
        view = mask[::step, ::step]
        cells = np.array(plans.rectangles_of(view.T if turned else view))[:, 1:].reshape(-1, 2, 2)
        i, j = np.moveaxis(cells[..., ::-1] if turned else cells, 2, 0)
        ends = np.sort(np.stack([xs[::step][i], ys[::step][j]], axis=2), axis=1)
        area = (ends[:, 1] - ends[:, 0]).prod(axis=1)
        options.append((len(ends), -area.max(), ends.reshape(-1, 4)[np.argsort(-area, kind="stable")]))
    return min(options, key=lambda option: option[:2])[2]


# --- paint, tiles and floors ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Style:
    """The surfaces of the rooms, and what all doors and windows have in common.

    `covers`: of each room, one for each kind of surface by its number; `tiled` ``(rooms, 2)``: the range of height in
    which its walls have tiles; `skirting`: None where there is none; `panels`: how many the leaf of a door has.
    """

    covers: tuple[tuple[m.Cover, ...], ...]
    tiled: np.ndarray
    skirting: tuple[m.Cover | None, ...]
    colour: str
    door: m.Cover
    frame: m.Cover
    window: m.Cover
    metal: m.Cover
    panels: int


def draw_style(plan: Plan, rng: np.random.Generator) -> Style:
    """White or wooden doors; rooms that are open to each other share their wall paint and mostly their floor."""
    facade, white = m.finish("plaster", None, rng), m.finish("paint", "white", rng)
    ceiling = _tinted(m.finish("paint", "white", rng), (244, 243, 240), rng)
    parquet = m.finish("parquet", None, rng)
    skirting = white if rng.random() < 0.6 else m.finish("wood", None, rng)
    wall_kind = "plaster" if rng.random() < 0.5 else "paint"
    rooms: list[tuple[tuple[m.Cover, ...], tuple[float, float], m.Cover | None]] = []
    for place, space in enumerate(plan.spaces):
        joined = [a for a, b in plan.open_to if b == place]  # the smaller number stands first
        tone = _WHITES[rng.integers(len(_WHITES))] if rng.random() < 0.5 else _TINTS[rng.integers(len(_TINTS))]
        wall = rooms[joined[0]][0][WALL] if joined else _tinted(m.finish(wall_kind, "white", rng), tone, rng)
        tiles, tiled, floor, boards = wall, (0.0, 0.0), parquet, skirting
        if space.kind == "bathroom":
            tiles, floor, boards = m.finish("tile", None, rng), m.finish("tile", None, rng), None
            tiled = (0.0, plan.height) if rng.random() < 0.5 else (0.0, float(rng.choice([1.4, 2.0])))
        elif space.kind == "kitchen" and (not joined or rng.random() < 0.5):
            floor = m.finish("tile", None, rng)
        elif space.kind == "bedroom" and rng.random() < 0.5 and not joined:
            floor = m.finish("carpet", None, rng)
        elif space.kind == "hall" and rng.random() < 0.3:
            floor = m.finish("tile", None, rng)
        rooms.append(((wall, tiles, facade, white, floor, ceiling), tiled, boards))
    kind, colour = (("paint", "white"), ("wood", "brown"), ("paint", "white"), ("paint", "grey"))[rng.integers(4)]
    door = m.finish(kind, colour, rng)
    frame = door if rng.random() < 0.6 or kind == "wood" else m.finish("paint", "white", rng)
    window = m.finish("paint", str(rng.choice(["white", "white", "grey", "brown"])), rng)
    metal = m.finish("metal", None, rng)
    covers, tiled, boards = zip(*rooms, strict=True)
    return Style(covers, np.array(tiled), boards, colour, door, frame, window, metal, int(rng.choice([0, 2, 3])))


def _tinted(cover: m.Cover, tone: tuple[int, int, int], rng: np.random.Generator) -> m.Cover:
    """`cover` in a slightly varied tone (sRGB, 0 to 255)."""
    look = cover.material
    linear = to_linear(np.array(tone) / 255 * rng.uniform(0.98, 1.02))
    if look.texture is not None:
        linear = linear / to_linear(look.texture[::4, ::4] / 255).mean(axis=(0, 1))
    return m.Cover(replace(look, name=f"wall {look.name}", colour=tuple(to_coded(linear).tolist())), cover.repeat)


# --- walls, floors and ceilings ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Thing:
    """One future `Instance`: its name, the room it is in, and its parts and lamps in the world frame."""

    category: str
    colour: str | None
    room: str | None
    parts: tuple[m.Mesh, ...]
    lamps: tuple[Lamp, ...] = ()


def _shell(plan: Plan, cells: Cells, style: Style) -> dict[tuple[int, str], list[m.Mesh]]:
    """The parts of the "wall", "floor" and "ceiling" of each room."""
    meshes: dict[tuple[int, int], list[m.Mesh]] = {}
    zs = cells.lines[2]
    low, high = style.tiled.T[..., None]
    tiled = (zs[:-1] >= low - 1e-6) & (zs[1:] <= high + 1e-6)
    for axis in range(3):
        for sign in (1, -1):
            key = _faces(cells, axis, sign, tiled)
            for k in np.flatnonzero(key.any(axis=(1, 2))):
                for value, *rectangle in plans.rectangles_of(key[k]):
                    corners = _corners(cells, axis, sign, int(k), rectangle)
                    meshes.setdefault(divmod(value - 1, 8), []).append(corners)
    parts: dict[tuple[int, str], list[m.Mesh]] = {key: [] for key in product(range(len(plan.spaces)), STRUCTURE[:3])}
    for (place, surface), pieces in sorted(meshes.items()):
        name = {FLOOR: "floor", CEILING: "ceiling"}.get(surface, "wall")
        parts[place, name].append(style.covers[place][surface](*pieces))
    for face in wall_faces(cells):
        room, skirting = max(face.rooms), style.skirting[max(face.rooms)]
        if skirting is not None and face.end - face.start > 0.02:
            low = 0.0 if face.rooms[1] == room else -0.012
            x0, y0, x1, y1 = face.box(face.start, face.end, low, low + 0.012)
            parts[room, "wall"].append(skirting(m.box((x0, y0, 0.0), (x1, y1, 0.08), grain=face.axis)))
    return parts


def _faces(cells: Cells, axis: int, sign: int, tiled: np.ndarray) -> np.ndarray:
    """Room and surface, coded in one number (0: no face), of each face that points along `sign` times `axis`."""
    air = np.moveaxis(cells.air, axis, 0)
    hole = np.moveaxis(cells.hole, axis, 0)
    owner = np.moveaxis(np.broadcast_to(cells.owner[:, :, None], cells.air.shape), axis, 0)
    if axis == 2:  # solid above the ceiling and below the floor
        pad = np.full((1, *air.shape[1:]), SOLID)
        air = np.concatenate([pad, air, np.where(air[-1:] == SOLID, OUTSIDE, pad)])
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


def _corners(cells: Cells, axis: int, sign: int, k: int, rectangle: list[int]) -> m.Mesh:
    """The rectangle of cells in plane `k` as two triangles that point along `sign` times `axis`."""
    first, second = (other for other in range(3) if other != axis)
    a0, b0, a1, b1 = rectangle
    corners = np.empty((4, 3))
    corners[:, axis] = cells.lines[axis][k + 1] if axis < 2 else cells.lines[2][k]
    corners[:, first] = cells.lines[first][[a0, a1, a1, a0]]
    corners[:, second] = cells.lines[second][[b0, b0, b1, b1]]
    if (sign < 0) != (axis == 1):  # x, z runs clockwise seen from +y
        corners = corners[::-1]
    return m.solid(corners, m.QUAD)


# --- doors and windows ------------------------------------------------------------------------------------------------


def things(plan: Plan, cells: Cells, style: Style) -> list[Thing]:
    """Walls, floors and ceilings, then doors and windows; the frame of a doorway without a leaf belongs to the wall."""
    shell, movable = _shell(plan, cells, style), list[Thing]()
    for doorway in plan.doorways:
        below, above = doorway.boundary.rooms
        home = above if doorway.side > 0 or below == OUTSIDE else below
        casings = ((below, -HALF_WALL, -0.015), (above, HALF_WALL, 0.015))
        frame = style.frame(
            _arch(doorway, *doorway.reach, LINING, 0.0),
            *(_arch(doorway, face, face + thick, 0.01, 0.06) for room, face, thick in casings if room != OUTSIDE),
        )
        if doorway.leaf is None:
            shell[home, "wall"].append(frame)
        else:
            movable.append(Thing("door", style.colour, plan.spaces[home].name, (frame, *_leaf(doorway, style))))
    for window in plan.windows:
        room = plan.spaces[max(window.boundary.rooms)]
        movable.append(Thing("window", None, room.name, (style.window(_window(window)),)))
    still = [Thing(name, None, plan.spaces[room].name, tuple(parts)) for (room, name), parts in shell.items()]
    return [*still, *movable]


def _bars(boundary: plans.Boundary, *bars: tuple[float, ...]) -> m.Mesh:
    """Boards from and to, along and across a boundary, and in height: six numbers each."""
    made = []
    for start, end, near, far, bottom, top in bars:
        x0, y0, x1, y1 = boundary.box(start, end, min(near, far), max(near, far))
        made.append(m.box((x0, y0, bottom), (x1, y1, top)))
    return m.merged(*made)


def _arch(doorway: Opening, near: float, far: float, inwards: float, outwards: float) -> m.Mesh:
    """Two posts and a lintel round a doorway, from `near` to `far` across; how far they reach into it and beyond it."""
    start, end, head = doorway.start, doorway.end, doorway.head
    return _bars(
        doorway.boundary,
        (start - outwards, start + inwards, near, far, 0.0, head + outwards),
        (end - inwards, end + outwards, near, far, 0.0, head + outwards),
        (start, end, near, far, head - inwards, head + outwards),
    )


def _leaf(doorway: Opening, style: Style) -> tuple[m.Mesh, ...]:
    """The leaf in its place: open, or closed in the niche of the front door."""
    width, top = doorway.end - doorway.start - 2 * LINING - 0.006, doorway.head - LINING - 0.005
    origin = doorway.at(0.0, 0.0)
    along, across = doorway.at(1.0, 0.0) - origin, doorway.at(0.0, 1.0) - origin
    near = 0.0 if along[0] * across[1] - along[1] * across[0] > 0 else -_LEAF  # its thickness lies towards the wall
    far, tall, x = near + _LEAF, (top - 0.28) / max(style.panels, 1), width - 0.06
    slab = [m.bevelled((0.003, near, 0.008), (width, far, top), 0.003, grain=2)]
    for low in 0.18 + tall * np.arange(style.panels):
        slab.append(
            m.bevelled((0.12, near - 0.007, low), (width - 0.12, far + 0.007, low + tall - 0.08), 0.004, grain=2)
        )
    plate = m.box((x - 0.018, near - 0.006, 0.92), (x + 0.018, far + 0.006, 1.12))
    ends = near - 0.045, far + 0.045  # one bar through the leaf, bent on both sides
    bar = m.tube([(x - 0.11, ends[0], 1.03), (x, ends[0], 1.03), (x, ends[1], 1.03), (x - 0.11, ends[1], 1.03)], 0.009)
    return m.placed([style.door(*slab), style.metal(plate, bar)], math.atan2(along[1], along[0]), (*origin, 0.0))


def _window(window: Opening) -> m.Mesh:
    """Frame with muntins in the outer half of the wall, and a sill board; there is no glass."""
    start, end, low, high, thick = window.start, window.end, window.sill, window.head, 0.05
    outwards = -1 if window.boundary.rooms[0] == OUTSIDE else 1
    face = -outwards * HALF_WALL
    near, far = face + outwards * 0.11, face + outwards * 0.17
    uprights = np.linspace(start + thick / 2, end - thick / 2, 2 + round((end - start) / 0.85))
    bars = [(at - thick / 2, at + thick / 2, near, far, low, high) for at in uprights]
    bars += [(start, end, near, far, z, z + thick) for z in (low, high - thick)]
    if high - low > 1.1:
        bars.append((start, end, near + outwards * 0.015, far - outwards * 0.015, high - 0.44, high - 0.4))
    bars.append((start, end, face, near, low, low + 0.022))  # the sill board
    bars.append((start - 0.04, end + 0.04, face - outwards * 0.035, face, low - 0.01, low + 0.022))
    return _bars(window.boundary, *bars)
