"""Apartments from a seed: floor plans of several families, furnished, painted and lit.

The entry point is `generate`. The same seed and `VERSION` give the same scene, byte for byte.
"""

from __future__ import annotations

import numpy as np

from eagor.errors import WorldError
from eagor.lab.worlds.apartment import building
from eagor.lab.worlds.apartment.building import Thing
from eagor.lab.worlds.apartment.furnish import REQUIRED, furnish
from eagor.lab.worlds.apartment.furniture import KINDS
from eagor.lab.worlds.apartment.mesh import bounds, merged, placed, turned_about_z
from eagor.lab.worlds.apartment.placement import Furnisher, Piece, advanced
from eagor.lab.worlds.apartment.plans import Plan, draw_plan
from eagor.lab.worlds.ground import BESIDE, Ground
from eagor.lab.worlds.scene import STRUCTURE, Instance, Lamp, Room, Scene

__all__ = ["CATEGORIES", "REQUIRED", "VERSION", "generate"]

_ATTEMPTS = 40
VERSION = "3"
CATEGORIES = (*STRUCTURE, *sorted(KINDS))  # all that an apartment can have; it always has those in REQUIRED


def generate(seed: int) -> Scene:
    """A furnished apartment of 45 to 110 square metres with four to seven rooms, metres, z = 0 the floor.

    The outer walls are along x and y. Everything in `REQUIRED` is there. Everything on the floor can be approached:
    passages are at least 0.5 m wide, and the `Ground` has free cells within 0.75 m of it. At least three solid pieces
    have a unique name (colour and category) although there are others of their category, and at least one name belongs
    to several pieces. `facts["family"]` names the kind of floor plan.
    Raises `WorldError` for a negative seed, or if nothing can be built from it.
    """
    return build(seed)[2]


def build(seed: int) -> tuple[Plan, list[Piece], Scene]:
    """The apartment of a seed and its scene: new plans are drawn until one fits everything that is required.

    The pieces are the last instances of the scene; a person (the body of `Ground`) can walk up to all that are solid.
    Raises `WorldError` as `generate` does.
    """
    if seed < 0:
        raise WorldError(f"seed = {seed}; wanted 0 or a positive whole number")
    reason = ""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        plan = draw_plan(rng)
        style = building.draw_style(plan, rng)
        cells = building.carve(plan, tuple(style.tiled.ravel()))
        try:
            pieces = furnish(Furnisher(plan, cells, rng))
        except WorldError as failure:
            reason = str(failure)
            continue
        things = [*building.things(plan, cells, style), *(_thing(piece, plan) for piece in pieces)]
        scene = _scene(things, cells.rooms, f"apartment {VERSION} seed {seed}", plan.family)
        ground = Ground.from_scene(scene)
        solid = [thing for piece, thing in zip(pieces, scene.instances[-len(pieces) :], strict=True) if piece.solid]
        far = [thing.category for thing in solid if ground.beside(thing)[1].min(initial=np.inf) > BESIDE]
        if not far:
            return plan, pieces, scene
        reason = f"nobody can walk up to the {far[0]}"
    raise WorldError(f"seed {seed} gave no apartment in {_ATTEMPTS} attempts, at last: {reason}; use another seed")


def _thing(piece: Piece, plan: Plan) -> Thing:
    """A piece in the world frame."""
    angle, model, hung = float(piece.box[4]), piece.model, KINDS[piece.category].placement == "hung"
    origin = np.append(advanced(piece.box, -model.size[0] / 2 if hung else 0.0)[0, :2], piece.z)
    lamps = tuple(Lamp(turned_about_z(angle) @ lamp.position + origin, lamp.power) for lamp in model.lamps)
    parts = placed(model.parts, angle, origin)
    return Thing(piece.category, model.colour, plan.spaces[piece.room].name, parts, lamps)


def _scene(things: list[Thing], rooms: tuple[Room, ...], source: str, family: str) -> Scene:
    """The triangles of all things; equal materials are shared."""
    parts = [part for thing in things for part in thing.parts]
    looks = [(look.name, look.colour, look.emission, id(look.texture)) for look in (part.material for part in parts)]
    materials = dict(zip(looks, (part.material for part in parts), strict=True))
    numbers = {look: number for number, look in enumerate(materials)}
    counts = [len(part.triangles) for part in parts]
    owners = np.repeat(np.arange(len(things)), [len(thing.parts) for thing in things])
    whole = merged(*parts)
    return Scene(
        whole.vertices, whole.triangles, np.repeat(owners, counts).astype(np.int32),
        np.repeat([numbers[look] for look in looks], counts).astype(np.int32), whole.uv,
        tuple(Instance(thing.category, thing.colour, thing.room, *bounds(thing.parts)) for thing in things),
        tuple(materials.values()), rooms, tuple(lamp for thing in things for lamp in thing.lamps), source=source,
        facts={"family": family},
    )  # fmt: skip
