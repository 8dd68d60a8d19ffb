"""What a piece of furniture is: parts in a frame of its own, and what the generator knows about its category."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.apartment.meshes import Mesh, Part, merged, part
from eagor.worlds.apartment.textures import REPEAT, material
from eagor.worlds.scene import Lamp

PLACEMENTS = ("wall", "corner", "free", "hung", "flat", "top", "ceiling")


@dataclass(frozen=True, eq=False)
class Model:
    """A piece of furniture: `parts` and `lamps` in the model frame, metres; its front faces +x, z is up.

    The origin is the centre of the footprint on the floor; for things that are hung on a wall the centre of their back
    face (parts at x >= 0, z about 0), for those that hang from the ceiling the centre of their top (z <= 0).
    `colour`, its main colour as a plain word, or None; `size` ``(3,)``, extents along x, y, z.
    """

    category: str
    colour: str | None
    parts: tuple[Part, ...]
    size: np.ndarray
    lamps: tuple[Lamp, ...] = ()


@dataclass(frozen=True)
class Kind:
    """What is known about a category before a piece is built.

    `placement`: "wall" (back to a wall), "corner", "free" (anywhere), "hung" (on a wall), "flat" (on the floor, no
    obstacle), "top" (stands on a surface) or "ceiling". `rooms`: the room kinds where it is at home. `colours`: those
    that it comes in, none where no one colour is what one sees of it.
    """

    category: str
    placement: str
    rooms: tuple[str, ...]
    colours: tuple[str, ...]


Builder = Callable[[Any, np.random.Generator], Model]  # from one of its kind's colours (str), or None if there are none


def finish(kind: str, colour: str | None, rng: np.random.Generator) -> Callable[..., Part]:
    """A function from meshes to one `Part` covered with a material of `kind`; its pieces share the material."""
    cover = material(kind, colour, rng)

    def covered(*meshes: Mesh) -> Part:
        return part(merged(*meshes), cover, REPEAT[kind])

    return covered


def assembled(
    category: str, colour: str | None, parts: Iterable[Part], lamps: Iterable[Lamp] = (), placement: str = "free"
) -> Model:
    """The model of these parts, shifted as a whole to where `placement` wants its origin."""
    if placement not in PLACEMENTS:
        raise WorldError(f"placement {placement!r}; wanted one of {', '.join(PLACEMENTS)}")
    parts = tuple(parts)
    low = np.min([piece.vertices.min(axis=0) for piece in parts], axis=0).astype(np.float64)
    high = np.max([piece.vertices.max(axis=0) for piece in parts], axis=0).astype(np.float64)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    if placement == "hung":
        origin[0], origin[2] = low[0], (low[2] + high[2]) / 2
    elif placement == "ceiling":
        origin[2] = high[2]
    shift = origin.astype(np.float32)
    return Model(
        category,
        colour,
        tuple(Part(piece.vertices - shift, piece.triangles, piece.uv, piece.material) for piece in parts),
        high - low,
        tuple(Lamp(np.asarray(lamp.position, dtype=np.float64) - origin, lamp.power) for lamp in lamps),
    )
