"""Apartments from a seed: floor plans of several families, furnished, painted and lit.

The entry point is `generate`. The same seed and `VERSION` give the same scene, byte for byte.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import WorldError
from eagor.lab.worlds.apartment import building
from eagor.lab.worlds.apartment.building import Cells, Finish, Style, Thing
from eagor.lab.worlds.apartment.furnish import REQUIRED, furnish
from eagor.lab.worlds.apartment.furniture import KINDS
from eagor.lab.worlds.apartment.mesh import bounds, merged, placed, turned_about_z
from eagor.lab.worlds.apartment.placement import Furnisher, NoRoom, Piece
from eagor.lab.worlds.apartment.plans import Plan, draw_plan
from eagor.lab.worlds.ground import BESIDE, Ground
from eagor.lab.worlds.scene import STRUCTURE, Instance, Lamp, Material, Room, Scene

__all__ = ["CATEGORIES", "REQUIRED", "VERSION", "generate"]

_ATTEMPTS = 40
VERSION = "3"
CATEGORIES = (*STRUCTURE, *sorted(KINDS))  # all that an apartment can have; it always has those in REQUIRED
_SURFACE = 75.0  # square metres of floor, walls and ceiling of a room for which one ceiling lamp is right
_SHARES = (0.2, 1.7)  # range of that power, as of real lamps


@dataclass(frozen=True, eq=False)
class Apartment:
    """An apartment before it becomes triangles; `rooms` and `finishes` are in the order of `plan.spaces`."""

    plan: Plan
    cells: Cells
    rooms: tuple[Room, ...]
    finishes: tuple[Finish, ...]
    style: Style
    pieces: list[Piece]


def generate(seed: int) -> Scene:
    """A furnished apartment of 45 to 110 square metres with four to seven rooms, metres, z = 0 the floor.

    The outer walls are along x and y. Everything in `REQUIRED` is there. Everything on the floor can be approached:
    passages are at least 0.5 m wide, and the `Ground` has free cells within 0.75 m of it. At least three solid pieces
    have a unique name (colour and category) although there are others of their category, and at least one name belongs
    to several pieces. `facts["family"]` names the kind of floor plan.
    Raises `WorldError` for a negative seed, or if nothing can be built from it.
    """
    return build(seed, f"apartment {VERSION} seed {seed}")[1]


def build(seed: int, source: str) -> tuple[Apartment, Scene]:
    """The apartment of a seed and its scene: new plans are drawn until one fits everything that is required.

    A person (the body of `Ground`) can walk up to all of its furniture. Raises `WorldError` as `generate` does.
    """
    if seed < 0:
        raise WorldError(f"seed = {seed}; wanted 0 or a positive whole number")
    reason = ""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        plan = draw_plan(rng)
        finishes, style = building.draw_finishes(plan, rng), building.draw_style(rng)
        cells = building.carve(plan, tuple(level for finish in finishes for level in finish.tiled))
        rooms = building.rooms_of(plan, cells)
        try:
            pieces = furnish(Furnisher(plan, cells, rooms, rng))
        except NoRoom as failure:
            reason = str(failure)
            continue
        apartment = Apartment(plan, cells, rooms, finishes, style, _lit(pieces, rooms, plan.height))
        scene = scene_of(apartment, source)
        far = _out_of_reach(apartment, scene)
        if not far:
            return apartment, scene
        reason = f"nobody can walk up to the {far[0].category}"
    raise WorldError(f"seed {seed} gave no apartment in {_ATTEMPTS} attempts, at last: {reason}; use another seed")


def _lit(pieces: Sequence[Piece], rooms: Sequence[Room], height: float) -> list[Piece]:
    """The same pieces with ceiling lamps of a power that suits the surface of their rooms of this `height` (m)."""
    shares, found = {}, []
    for room, count in Counter(piece.room for piece in pieces if piece.category == "ceiling lamp").items():
        x0, y0, x1, y1 = rooms[room].rectangles.T
        surface = 2 * rooms[room].area + float((2 * (x1 - x0 + y1 - y0)).sum()) * height
        shares[room] = float(np.clip(surface / _SURFACE / count, *_SHARES))
    for piece in pieces:
        if piece.category == "ceiling lamp":
            lamps = tuple(replace(lamp, power=shares[piece.room] * lamp.power) for lamp in piece.model.lamps)
            piece = replace(piece, model=replace(piece.model, lamps=lamps))
        found.append(piece)
    return found


def _out_of_reach(apartment: Apartment, scene: Scene) -> list[Piece]:
    """The solid pieces without free ground beside them."""
    ground = Ground.from_scene(scene)
    things = scene.instances[-len(apartment.pieces) :]
    return [
        piece
        for piece, thing in zip(apartment.pieces, things, strict=True)
        if piece.solid and ground.beside(thing)[1].min(initial=np.inf) > BESIDE
    ]


def scene_of(apartment: Apartment, source: str) -> Scene:
    """The triangles of an apartment: walls, floors and ceilings first, then doors and windows, then the furniture."""
    plan = apartment.plan
    shell = building.shell(plan, apartment.cells, apartment.finishes)
    doors = building.doors_and_windows(plan, apartment.style, shell)
    things = [
        Thing(category, None, space.name, tuple(surfaces))
        for space, room in zip(plan.spaces, shell, strict=True)
        for category, surfaces in room.items()
    ]
    things += [*doors, *(_thing(piece, plan) for piece in apartment.pieces)]
    parts = [part for thing in things for part in thing.parts]
    # Equal materials are shared.
    numbers: dict[tuple[object, ...], int] = {}
    materials: list[Material] = []
    looks = []
    for look in (part.material for part in parts):
        looks.append(numbers.setdefault((look.name, look.colour, look.emission, id(look.texture)), len(materials)))
        materials += [look] * (looks[-1] == len(materials))
    whole = merged(*parts)
    counts = [len(part.triangles) for part in parts]
    owners = np.repeat(np.arange(len(things)), [len(thing.parts) for thing in things])
    return Scene(
        whole.vertices, whole.triangles, np.repeat(owners, counts).astype(np.int32),
        np.repeat(looks, counts).astype(np.int32), whole.uv, tuple(map(_instance, things)), tuple(materials),
        apartment.rooms, tuple(lamp for thing in things for lamp in thing.lamps), source=source,
        facts={"family": plan.family},
    )  # fmt: skip


def _thing(piece: Piece, plan: Plan) -> Thing:
    """A piece in the world frame."""
    angle, model = float(piece.box[4]), piece.model
    lamps = tuple(Lamp(turned_about_z(angle) @ lamp.position + piece.position, lamp.power) for lamp in model.lamps)
    parts = placed(model.parts, angle, piece.position)
    return Thing(piece.category, model.colour, plan.spaces[piece.room].name, parts, lamps)


def _instance(thing: Thing) -> Instance:
    return Instance(thing.category, thing.colour, thing.room, *bounds(thing.parts))
