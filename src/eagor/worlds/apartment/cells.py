"""A plan on a grid of cells whose widths follow its lines.

Each cell is air of a room, air outside, or solid. The rooms' rectangles and the free stretches of wall are read from
it here, the surfaces of the building in `eagor.worlds.apartment.building`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.plans import HALF_WALL, OUTER_WALL, OUTSIDE, Opening, Plan
from eagor.worlds.scene import Room

SOLID = -2
_OUTWARDS = OUTER_WALL - HALF_WALL
NICHE = 0.06  # depth of the closed front door in its wall


@dataclass(frozen=True, eq=False)
class Cells:
    """The grid.

    `lines` along x, y, z; `air` ``(nx, ny, nz)``: the room, `OUTSIDE` or `SOLID`; `hole`: whether the cell is in a
    doorway or window; `owner` ``(nx, ny)``: the room that the walls there belong to.
    """

    lines: tuple[np.ndarray, np.ndarray, np.ndarray]
    air: np.ndarray
    hole: np.ndarray
    owner: np.ndarray


@dataclass(frozen=True, eq=False)
class WallFace:
    """A free stretch of wall from the floor up, seen from its room: at `line`, from `start` to `end` along `axis`.

    `side` is 1 if the room lies on the high side, -1 if it lies on the low side.
    """

    room: int
    axis: int
    line: float
    start: float
    end: float
    side: int


def carve(plan: Plan, levels: tuple[float, ...] = ()) -> Cells:
    """The cells of a plan, split at further `levels` of z where the look of a wall changes."""
    width, depth = plan.extent
    holes: tuple[Opening, ...] = (*plan.doorways, *plan.windows)
    cuts: tuple[set[float], set[float]] = (set(), set())
    for axis, end in ((0, width), (1, depth)):
        cuts[axis].update((-_OUTWARDS - 1.0, -_OUTWARDS, end + _OUTWARDS, end + _OUTWARDS + 1.0))
        for space in plan.spaces:
            for line in np.array(space.rectangles)[:, [axis, axis + 2]].ravel().tolist():
                cuts[axis].update((line - HALF_WALL, line, line + HALF_WALL))
    for hole in holes:
        x0, y0, x1, y1 = _reach(hole)
        cuts[0].update((x0, x1))
        cuts[1].update((y0, y1))
    heights = {0.0, plan.height, *levels, *(h.sill for h in holes), *(h.head for h in holes)}
    lines = tuple(np.unique(np.round(sorted(values), 4)) for values in (*cuts, heights))
    xs, ys, zs = lines

    def window(rectangle: tuple[float, ...]) -> tuple[slice, slice]:
        x0, y0, x1, y1 = np.round(rectangle, 4)
        return (
            slice(int(np.searchsorted(xs, x0 - 1e-6)), int(np.searchsorted(xs, x1 - 1e-6))),
            slice(int(np.searchsorted(ys, y0 - 1e-6)), int(np.searchsorted(ys, y1 - 1e-6))),
        )

    room = np.full((len(xs) - 1, len(ys) - 1), OUTSIDE)
    for place, space in enumerate(plan.spaces):
        for rectangle in space.rectangles:
            room[window(rectangle)] = place
    owner = room.copy()
    solid = np.zeros(room.shape, dtype=bool)
    for boundary in plan.boundaries:
        if tuple(sorted(boundary.rooms)) in plan.open_to:
            continue
        low, high = (-_OUTWARDS if place == OUTSIDE else -HALF_WALL for place in boundary.rooms)
        beyond = _OUTWARDS if OUTSIDE in boundary.rooms else 0.0
        solid[window(boundary.box(boundary.start, boundary.end, -HALF_WALL, HALF_WALL))] = True
        wide = window(boundary.box(boundary.start - beyond, boundary.end + beyond, low, -high))
        outer = room[wide] == OUTSIDE
        solid[wide] |= outer
        owner[wide][outer & (owner[wide] == OUTSIDE)] = max(boundary.rooms)
    for x, y in _corners_of_walls(plan):
        solid[window((x - HALF_WALL, y - HALF_WALL, x + HALF_WALL, y + HALF_WALL))] = True
    air = np.where(solid, SOLID, room)[:, :, None].repeat(len(zs) - 1, axis=2)
    carved = np.zeros(air.shape, dtype=bool)
    for hole in holes:
        where = window(_reach(hole))
        levels_of = slice(int(np.searchsorted(zs, hole.sill - 1e-6)), int(np.searchsorted(zs, hole.head - 1e-6)))
        air[(*where, levels_of)] = owner[where][:, :, None]
        carved[(*where, levels_of)] = True
    return Cells((xs, ys, zs), air, carved, owner)


def rooms_of(plan: Plan, cells: Cells) -> tuple[Room, ...]:
    """The rooms between their walls, without the floor in doorways."""
    xs, ys, _ = cells.lines
    ground = np.where(cells.hole[:, :, 0], SOLID, cells.air[:, :, 0])
    found = (_few_rectangles(ground == place, xs, ys) for place in range(len(plan.spaces)))
    return tuple(Room(space.name, space.kind, few) for space, few in zip(plan.spaces, found, strict=True))


def wall_faces(cells: Cells) -> tuple[WallFace, ...]:
    """The stretches of wall that stand on the floor, without those inside doorways."""
    found = []
    ground, solid = np.where(cells.hole[:, :, 0], OUTSIDE, cells.air[:, :, 0]).T, cells.air[:, :, 0].T == SOLID
    for axis in (0, 1):  # of both, the first axis runs across the wall
        lines, along = cells.lines[1 - axis], cells.lines[axis]
        for k in range(1, len(lines) - 1):
            for side, inner, outer in ((1, k, k - 1), (-1, k - 1, k)):
                key = np.where(solid[outer] & (ground[inner] >= 0), ground[inner] + 1, 0)[None]
                for value, _, start, _, end in rectangles_of(key):
                    ends = float(along[start]), float(along[end])
                    found.append(WallFace(value - 1, axis, float(lines[k]), *ends, side))
        ground, solid = ground.T, solid.T
    return tuple(found)


def _corners_of_walls(plan: Plan) -> set[tuple[float, float]]:
    """The points where a wall along x and one along y both end."""
    ends: tuple[set[tuple[float, float]], set[tuple[float, float]]] = (set(), set())
    for boundary in plan.boundaries:
        if tuple(sorted(boundary.rooms)) not in plan.open_to:
            for along in (boundary.start, boundary.end):
                x, y = (along, boundary.line) if boundary.axis == 0 else (boundary.line, along)
                ends[boundary.axis].add((x, y))
    return ends[0] & ends[1]


def _reach(hole: Opening) -> tuple[float, float, float, float]:
    """The rectangle that is cut out: the front door is a niche, all others go through the wall."""
    boundary = hole.boundary
    if OUTSIDE in boundary.rooms and hole.sill == 0.0:
        inner = HALF_WALL if boundary.rooms[0] == OUTSIDE else -HALF_WALL
        low, high = sorted((inner, inner - np.sign(inner) * NICHE))
        return boundary.box(hole.start, hole.end, low, high)
    return hole.hole


def rectangles_of(key: np.ndarray) -> list[tuple[int, int, int, int, int]]:
    """Rectangles `(value, a0, b0, a1, b1)` of equal values that cover all of `key` ``(A, B)`` that is not zero."""
    left = key.astype(np.int64)
    found = []
    for a, b in np.argwhere(left):
        value = left[a, b]
        if value == 0:
            continue
        row = left[a, b:] == value
        b1 = b + (len(row) if row.all() else int(row.argmin()))
        rows = (left[a:, b:b1] == value).all(axis=1)
        a1 = a + (len(rows) if rows.all() else int(rows.argmin()))
        left[a:a1, b:b1] = 0
        found.append((int(value), int(a), int(b), int(a1), int(b1)))
    return found


def _few_rectangles(mask: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Rectangles ``(n, 4)`` x0, y0, x1, y1 that cover the cells in `mask`: few, the first as large as possible."""
    options = []
    for turned in (False, True):
        for step in (1, -1):
            view = mask[::step, ::step]
            found = np.array(rectangles_of(view.T if turned else view))[:, 1:]
            cells = found[:, [1, 0, 3, 2]] if turned else found
            if step < 0:
                cells = np.array([*mask.shape, *mask.shape]) - cells[:, [2, 3, 0, 1]]
            found = np.stack([xs[cells[:, 0]], ys[cells[:, 1]], xs[cells[:, 2]], ys[cells[:, 3]]], axis=1)
            area = (found[:, 2] - found[:, 0]) * (found[:, 3] - found[:, 1])
            options.append((len(found), -float(area.max()), found[np.argsort(-area, kind="stable")]))
    return min(options, key=lambda option: option[:2])[2]
