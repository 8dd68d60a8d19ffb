"""Furniture: the models of all categories, each with what builds it; one module per family of builders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor.lab.worlds.apartment.furniture import decor, joinery
from eagor.lab.worlds.apartment.furniture.joinery import CLOTHS, COVERS, WOODS
from eagor.lab.worlds.apartment.mesh import Part, bounds
from eagor.lab.worlds.apartment.textures import PICTURES
from eagor.lab.worlds.scene import Lamp

__all__ = ["KINDS", "Kind", "Model", "build"]


@dataclass(frozen=True, eq=False)
class Model:
    """A piece of furniture: `parts` and `lamps` in the model frame, metres; its front faces +x, z is up.

    The origin is the centre of the footprint on the floor; for things on a wall, the centre of their back face (parts
    at x >= 0, z about 0); for things on the ceiling, the centre of their top (z <= 0). `colour`: its main colour as a
    plain word, or None; `size` ``(3,)``: extents along x, y, z; `seed`: of its generator.
    """

    category: str
    colour: str | None
    parts: tuple[Part, ...]
    size: np.ndarray
    lamps: tuple[Lamp, ...]
    seed: int

    @property
    def height(self) -> float:
        """Metres from its lowest to its highest point."""
        return float(self.size[2])


@dataclass(frozen=True)
class Kind:
    """A category: its choice of main `colours`, empty if none dominates, and what builds a piece in one of them.

    `placement`: "floor", "top" (stands on another piece), "hung" (on a wall) or "ceiling".
    """

    colours: tuple[str, ...]
    make: Callable[[Any, np.random.Generator], Sequence[Part | Lamp]]  # the colour is None if there are none
    placement: str = "floor"


_CHAIRS = ("brown", "black", "white", "grey", "red", "blue", "green", "beige", "orange", "yellow", "purple", "pink")
_LACQUERED = (*WOODS, "grey", "blue", "green")
_SHADES = ("white", "beige", "yellow", "orange", "red")
_BOOKS = ("red", "blue", "green", "brown", "white", "yellow")
_UNITS = ("white", "grey", "beige", "brown", "green", "blue")
_GLAZED = ("white", "blue", "green", "red", "yellow", "purple", "pink", "black")
KINDS: dict[str, Kind] = {
    "chair": Kind(_CHAIRS, joinery.chair),
    "armchair": Kind(CLOTHS, joinery.armchair),
    "sofa": Kind(CLOTHS, joinery.sofa),
    "bed": Kind(COVERS, joinery.bed),
    "table": Kind(WOODS, joinery.table),
    "coffee table": Kind((*WOODS, "grey"), joinery.coffee_table),
    "desk": Kind((*WOODS, "grey"), joinery.desk),
    "nightstand": Kind(_LACQUERED, joinery.nightstand),
    "dresser": Kind(_LACQUERED, joinery.dresser),
    "wardrobe": Kind((*WOODS, "grey"), joinery.wardrobe),
    "bookshelf": Kind(WOODS, joinery.bookshelf),
    "cabinet": Kind(_UNITS, decor.cabinet),
    "book": Kind(_BOOKS, joinery.book, "top"),
    "refrigerator": Kind(("white", "grey", "black"), decor.refrigerator),
    "stove": Kind(("white", "black", "grey"), decor.stove),
    "sink": Kind(("white", "grey"), decor.sink),
    "toilet": Kind(("white",), decor.toilet),
    "bathtub": Kind(("white",), decor.bathtub),
    "plant": Kind(("green",), decor.plant),
    "lamp": Kind(_SHADES, decor.lamp),
    "rug": Kind(PICTURES["rug"].colours, decor.rug),
    "painting": Kind(PICTURES["art"].colours, decor.painting, "hung"),
    "ceiling lamp": Kind(("white", "beige", "black", "grey"), decor.ceiling_lamp, "ceiling"),
    "vase": Kind(_GLAZED, decor.vase, "top"),
    "tv": Kind((), joinery.tv),
}


def build(category: str, colour: str | None, seed: int) -> Model:
    """A piece of furniture in one of the colours of its kind; `colour` None: any of them, if there are any."""
    kind, rng = KINDS[category], np.random.default_rng(seed)
    if colour is None and kind.colours:
        colour = str(rng.choice(kind.colours))
    made = kind.make(colour, rng)
    parts = [piece for piece in made if isinstance(piece, Part)]
    low, high = bounds(parts)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    if kind.placement == "hung":
        origin[0], origin[2] = low[0], (low[2] + high[2]) / 2
    elif kind.placement == "ceiling":
        origin[2] = high[2]
    shift = origin.astype(np.float32)
    shifted = tuple(replace(part, vertices=part.vertices - shift) for part in parts)
    lamps = tuple(Lamp(lamp.position - origin, lamp.power) for lamp in made if isinstance(lamp, Lamp))
    return Model(category, colour, shifted, high - low, lamps, seed)
