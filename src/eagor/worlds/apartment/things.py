"""Named things in the world frame, and the scene that they make together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eagor.worlds.apartment.mesh import Part
from eagor.worlds.scene import Instance, Lamp, Material, Room, Scene


@dataclass(frozen=True, eq=False)
class Thing:
    """What becomes one `Instance`: its name, the room it is in, and its parts and lamps in the world frame."""

    category: str
    colour: str | None
    room: str | None
    parts: tuple[Part, ...]
    lamps: tuple[Lamp, ...] = ()


def turned_about_z(angle: float) -> np.ndarray:
    """The matrix ``(3, 3)`` of a turn by `angle` radians, counter-clockwise from above; quarters are exact."""
    cosine, sine = math.cos(angle), math.sin(angle)
    quarters = angle / (math.pi / 2)
    if abs(quarters - round(quarters)) < 1e-9:
        cosine, sine = float(round(cosine)), float(round(sine))
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def placed(parts: Sequence[Part], angle: float, position: Sequence[float] | np.ndarray) -> tuple[Part, ...]:
    """Parts of a model turned by `angle` radians about z, then shifted to `position` ``(3,)``."""
    rotation, offset = turned_about_z(angle), np.asarray(position, dtype=np.float64)
    return tuple(
        Part((part.vertices @ rotation.T + offset).astype(np.float32), part.triangles, part.uv, part.material)
        for part in parts
    )


def make_scene(things: Sequence[Thing], rooms: Sequence[Room], source: str, facts: dict[str, str]) -> Scene:
    """The scene of all the things, in their order; equal materials are shared."""
    materials: dict[tuple[object, ...], int] = {}
    listed: list[Material] = []
    instances: list[Instance] = []
    vertices, triangles, uv, owners, looks = [], [], [], [], []
    start = 0
    for place, thing in enumerate(things):
        low = np.min([part.vertices.min(axis=0) for part in thing.parts], axis=0).astype(np.float64)
        high = np.max([part.vertices.max(axis=0) for part in thing.parts], axis=0).astype(np.float64)
        instances.append(Instance(thing.category, thing.colour, thing.room, low, high))
        for part in thing.parts:
            look = part.material
            key = (look.name, look.colour, look.emission, id(look.texture))
            if key not in materials:
                materials[key] = len(listed)
                listed.append(look)
            vertices.append(part.vertices)
            triangles.append(part.triangles + np.int32(start))
            uv.append(part.uv)
            owners.append(np.full(len(part.triangles), place, dtype=np.int32))
            looks.append(np.full(len(part.triangles), materials[key], dtype=np.int32))
            start += len(part.vertices)
    return Scene(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.concatenate(owners),
        np.concatenate(looks),
        np.concatenate(uv),
        tuple(instances),
        tuple(listed),
        tuple(rooms),
        tuple(lamp for thing in things for lamp in thing.lamps),
        source=source,
        facts=facts,
    )
