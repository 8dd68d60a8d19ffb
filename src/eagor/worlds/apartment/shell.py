"""Walls, floors and ceilings of a plan.

The surface of the building is every face between air and solid in its grid of cells, so it is always closed. Adjacent
faces that look alike are merged into rectangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.cells import SOLID, Cells, rectangles_of, wall_faces
from eagor.worlds.apartment.finishes import Finish
from eagor.worlds.apartment.mesh import Mesh, Part, box, merged, part, projected, quad_triangles
from eagor.worlds.apartment.openings import OUTSIDE
from eagor.worlds.apartment.plans import Plan
from eagor.worlds.apartment.textures import REPEAT
from eagor.worlds.scene import Lamp


@dataclass(frozen=True, eq=False)
class Thing:
    """One future `Instance`: its name, the room it is in, and its parts and lamps in the world frame."""

    category: str
    colour: str | None
    room: str | None
    parts: tuple[Part, ...]
    lamps: tuple[Lamp, ...] = ()


WALL, TILES, FACADE, REVEAL, FLOOR, CEILING = range(6)  # kinds of surface


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


def structure(plan: Plan, rooms: tuple[dict[str, list[Part]], ...]) -> list[Thing]:
    """The walls, floors and ceilings as things."""
    return [
        Thing(category, None, space.name, tuple(parts))
        for space, room in zip(plan.spaces, rooms, strict=True)
        for category, parts in room.items()
    ]


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
        surface[~inside] = FACADE
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
    return projected(corners, quad_triangles(1), None)
