"""Apartments from a seed: floor plans of several families, furnished, painted and lit.

The entry point is `generate`. The same seed and `VERSION` give the same scene, byte for byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor.errors import WorldError
from eagor.lab.worlds.apartment.building import (
    Finish,
    Style,
    Thing,
    doors_and_windows,
    draw_finishes,
    draw_style,
    lit,
    shell,
    splashback,
)
from eagor.lab.worlds.apartment.furnish import REQUIRED, furnish
from eagor.lab.worlds.apartment.furniture import KINDS
from eagor.lab.worlds.apartment.mesh import merged, placed, turned_about_z
from eagor.lab.worlds.apartment.placement import NoRoom, Piece, empty_floor
from eagor.lab.worlds.apartment.plans import Cells, Plan, carve, draw_plan, rooms_of
from eagor.lab.worlds.ground import BESIDE, Ground
from eagor.lab.worlds.scene import STRUCTURE, Instance, Lamp, Material, Room, Scene

__all__ = ["CATEGORIES", "REQUIRED", "VERSION", "generate"]

_ATTEMPTS = 40
VERSION = "2"
CATEGORIES = (*STRUCTURE, *sorted(KINDS))  # all that an apartment can have; it always has those in REQUIRED


@dataclass(frozen=True, eq=False)
class Apartment:
    """An apartment before it becomes triangles; `rooms` and `finishes` are in the order of `plan.spaces`."""

    plan: Plan
    cells: Cells
    rooms: tuple[Room, ...]
    finishes: tuple[Finish, ...]
    style: Style
    pieces: tuple[Piece, ...]


def build(seed: int, source: str) -> tuple[Apartment, Scene]:
    """The apartment of a seed and its scene: new plans are drawn until one fits everything that is required.

    A person (the body of `Ground`) can walk up to all of its furniture. Raises `WorldError` for a negative seed, or if
    nothing can be built from it.
    """
    if seed < 0:
        raise WorldError(f"seed = {seed}; wanted 0 or a positive whole number")
    reason = ""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        plan = draw_plan(rng)
        finishes, style = draw_finishes(plan, rng), draw_style(rng)
        cells = carve(plan, tuple(level for finish in finishes for level in finish.tiled))
        rooms = rooms_of(plan, cells)
        try:
            pieces = furnish(empty_floor(plan, cells, rooms), rng)
        except NoRoom as failure:
            reason = str(failure)
            continue
        pieces = lit(pieces, rooms, finishes, plan.height)
        apartment = Apartment(plan, cells, rooms, finishes, style, tuple(pieces))
        scene = scene_of(apartment, source)
        far = _out_of_reach(apartment, scene)
        if not far:
            return apartment, scene
        reason = f"nobody can walk up to the {far[0].category}"
    raise WorldError(f"seed {seed} gave no apartment in {_ATTEMPTS} attempts, at last: {reason}; use another seed")


def _out_of_reach(apartment: Apartment, scene: Scene) -> list[Piece]:
    """The solid pieces without free ground beside them."""
    ground = Ground.from_scene(scene)
    things = scene.instances[len(scene.instances) - len(apartment.pieces) :]
    return [
        piece
        for piece, thing in zip(apartment.pieces, things, strict=True)
        if piece.solid and ground.beside(thing)[1].min(initial=np.inf) > BESIDE
    ]


def scene_of(apartment: Apartment, source: str) -> Scene:
    """The triangles of an apartment: walls, floors and ceilings first, then doors and windows, then the furniture."""
    plan = apartment.plan
    parts = shell(plan, apartment.cells, apartment.finishes)
    doors = doors_and_windows(plan, apartment.style, parts)
    for piece in apartment.pieces:
        tiles = apartment.finishes[piece.room].tiles
        back = splashback(piece, plan, tiles) if tiles else None
        if back is not None:
            parts[piece.room]["wall"].append(back)
    things = [
        Thing(category, None, space.name, tuple(surfaces))
        for space, room in zip(plan.spaces, parts, strict=True)
        for category, surfaces in room.items()
    ]
    things += [*doors, *(_thing(piece, plan) for piece in apartment.pieces)]
    return _made_of(things, apartment.rooms, source, {"family": plan.family})


def _thing(piece: Piece, plan: Plan) -> Thing:
    """A piece in the world frame."""
    angle, model = float(piece.box[4]), piece.model
    lamps = tuple(
        Lamp(turned_about_z(angle) @ np.asarray(lamp.position, dtype=np.float64) + piece.position, lamp.power)
        for lamp in model.lamps
    )
    parts = placed(model.parts, angle, piece.position)
    return Thing(piece.category, model.colour, plan.spaces[piece.room].name, parts, lamps)


def _made_of(things: Sequence[Thing], rooms: Sequence[Room], source: str, facts: dict[str, str]) -> Scene:
    """The scene of all the things, in their order; equal materials are shared."""
    numbers: dict[tuple[object, ...], int] = {}
    materials: list[Material] = []
    looks, instances = [], []
    for thing in things:
        low = np.min([part.low for part in thing.parts], axis=0).astype(np.float64)
        high = np.max([part.high for part in thing.parts], axis=0).astype(np.float64)
        instances.append(Instance(thing.category, thing.colour, thing.room, low, high))
        for look in (part.material for part in thing.parts):
            looks.append(numbers.setdefault((look.name, look.colour, look.emission, id(look.texture)), len(materials)))
            materials += [look] * (looks[-1] == len(materials))
    whole = merged(*(part for thing in things for part in thing.parts))
    counts = [len(part.triangles) for thing in things for part in thing.parts]
    owners = np.repeat(np.arange(len(things)), [len(thing.parts) for thing in things])
    return Scene(
        whole.vertices, whole.triangles, np.repeat(owners, counts).astype(np.int32),
        np.repeat(looks, counts).astype(np.int32), whole.uv, tuple(instances), tuple(materials), tuple(rooms),
        tuple(lamp for thing in things for lamp in thing.lamps), source=source, facts=facts,
    )  # fmt: skip


def generate(seed: int) -> Scene:
    """A furnished apartment of 45 to 110 square metres with three to seven rooms, metres, z = 0 the floor.

    The outer walls are along x and y. Everything in `REQUIRED` is there. Everything on the floor can be approached:
    passages are at least 0.5 m wide, and the `Ground` has free cells within 0.75 m of it. At least three solid pieces
    have a unique name (colour and category) although there are others of their category, and at least one name belongs
    to several pieces. `facts["family"]` names the kind of floor plan.
    Raises `WorldError` for a negative seed, or if nothing can be built from it.
    """
    return build(seed, f"apartment {VERSION} seed {seed}")[1]
