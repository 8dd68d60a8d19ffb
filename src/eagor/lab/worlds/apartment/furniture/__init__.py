"""Furniture: a table of all kinds, each with what builds it; one module per family of builders."""

from __future__ import annotations

import numpy as np

from eagor.lab.worlds.apartment.furniture import decor, fixtures, joinery, seating
from eagor.lab.worlds.apartment.furniture.model import WOODS, Kind, Model, assembled
from eagor.lab.worlds.apartment.pictures import PICTURES

__all__ = ["KINDS", "Kind", "Model", "build"]

_CHAIRS = ("brown", "black", "white", "grey", "red", "blue", "green", "beige", "orange", "yellow", "purple", "pink")
_LACQUERED = (*WOODS, "grey", "blue", "green")
_SHADES = ("white", "beige", "yellow", "orange", "red")
_COVERS = ("red", "blue", "green", "brown", "white", "yellow")
_UNITS = ("white", "grey", "beige", "brown", "green", "blue")
_GLAZED = ("white", "blue", "green", "red", "yellow", "purple", "pink", "black")
KINDS: dict[str, Kind] = {
    "chair": Kind(_CHAIRS, seating.chair),
    "armchair": Kind(seating.CLOTHS, seating.armchair),
    "sofa": Kind(seating.CLOTHS, seating.sofa),
    "bed": Kind(seating.COLOURS, seating.bed),
    "table": Kind(WOODS, joinery.table),
    "coffee table": Kind((*WOODS, "grey"), joinery.coffee_table),
    "desk": Kind((*WOODS, "grey"), joinery.desk),
    "nightstand": Kind(_LACQUERED, joinery.nightstand),
    "dresser": Kind(_LACQUERED, joinery.dresser),
    "wardrobe": Kind((*WOODS, "grey"), joinery.wardrobe),
    "bookshelf": Kind(WOODS, joinery.bookshelf),
    "cabinet": Kind(_UNITS, joinery.cabinet),
    "book": Kind(_COVERS, joinery.book, "top"),
    "refrigerator": Kind(("white", "grey", "black"), fixtures.refrigerator),
    "stove": Kind(("white", "black", "grey"), fixtures.stove),
    "sink": Kind(("white", "grey"), fixtures.sink),
    "toilet": Kind(("white",), fixtures.toilet),
    "bathtub": Kind(("white",), fixtures.bathtub),
    "plant": Kind(("green",), decor.plant),
    "lamp": Kind(_SHADES, decor.lamp),
    "rug": Kind(PICTURES["rug"].colours, decor.rug),
    "painting": Kind(PICTURES["art"].colours, decor.painting, "hung"),
    "ceiling lamp": Kind(("white", "beige", "black", "grey"), decor.ceiling_lamp, "ceiling"),
    "vase": Kind(_GLAZED, decor.vase, "top"),
    "tv": Kind((), joinery.tv),
}


def build(category: str, colour: str | None, rng: np.random.Generator) -> Model:
    """A piece of furniture in one of the colours of its kind; `colour` None: `rng` picks one, if there are any."""
    kind = KINDS[category]
    if colour is None and kind.colours:
        colour = str(rng.choice(kind.colours))
    return assembled(category, colour, kind.make(colour, rng), kind.placement)
