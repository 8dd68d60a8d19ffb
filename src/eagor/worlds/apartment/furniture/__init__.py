"""Furniture: a table of all kinds, each with what builds it; one module per family of builders."""

from __future__ import annotations

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.apartment.furniture import decor, fixtures, joinery, seating
from eagor.worlds.apartment.furniture.model import WOODS, Kind, Model, assembled
from eagor.worlds.apartment.pictures import PICTURES

__all__ = ["KINDS", "Kind", "Model", "build"]

_ROOMS = ("living room", "bedroom", "study", "dining room", "hall")
_ALL = (*_ROOMS, "kitchen", "bathroom")
_COSY = ("living room", "bedroom", "study")
_STORING = ("bedroom", "hall")
_CHAIRS = ("brown", "black", "white", "grey", "red", "blue", "green", "beige", "orange", "yellow", "purple", "pink")
_LACQUERED = (*WOODS, "grey", "blue", "green")
_SHADES = ("white", "beige", "yellow", "orange", "red")
_COVERS = ("red", "blue", "green", "brown", "white", "yellow")
_UNITS = ("white", "grey", "beige", "brown", "green", "blue")
_GLAZED = ("white", "blue", "green", "red", "yellow", "purple", "pink", "black")
KINDS: dict[str, Kind] = {
    "chair": Kind("free", ("dining room", "kitchen", "study", "bedroom", "living room"), _CHAIRS, seating.chair),
    "armchair": Kind("corner", _COSY, seating.CLOTHS, seating.armchair),
    "sofa": Kind("wall", ("living room",), seating.CLOTHS, seating.sofa),
    "bed": Kind("wall", ("bedroom",), seating.COLOURS, seating.bed),
    "table": Kind("free", ("dining room", "kitchen", "living room"), WOODS, joinery.table),
    "coffee table": Kind("free", ("living room",), (*WOODS, "grey"), joinery.coffee_table),
    "desk": Kind("wall", ("study", "bedroom"), (*WOODS, "grey"), joinery.desk),
    "nightstand": Kind("wall", ("bedroom",), _LACQUERED, joinery.nightstand),
    "dresser": Kind("wall", _STORING, _LACQUERED, joinery.dresser),
    "wardrobe": Kind("wall", _STORING, (*WOODS, "grey"), joinery.wardrobe),
    "bookshelf": Kind("wall", ("living room", "study", *_STORING), WOODS, joinery.bookshelf),
    "cabinet": Kind("wall", ("kitchen",), _UNITS, joinery.cabinet),
    "book": Kind("top", ("living room", "study", "bedroom"), _COVERS, joinery.book),
    "refrigerator": Kind("wall", ("kitchen",), ("white", "grey", "black"), fixtures.refrigerator),
    "stove": Kind("wall", ("kitchen",), ("white", "black", "grey"), fixtures.stove),
    "sink": Kind("wall", ("bathroom", "kitchen"), ("white", "grey"), fixtures.sink),
    "toilet": Kind("wall", ("bathroom",), ("white",), fixtures.toilet),
    "bathtub": Kind("wall", ("bathroom",), ("white",), fixtures.bathtub),
    "plant": Kind("corner", _ALL, ("green",), decor.plant),
    "lamp": Kind("corner", _COSY, _SHADES, decor.lamp),
    "rug": Kind("flat", (*_ROOMS, "bathroom"), PICTURES["rug"].colours, decor.rug),
    "painting": Kind("hung", (*_ROOMS, "kitchen"), PICTURES["art"].colours, decor.painting),
    "ceiling lamp": Kind("ceiling", _ALL, ("white", "beige", "black", "grey"), decor.ceiling_lamp),
    "vase": Kind("top", _ROOMS, _GLAZED, decor.vase),
    "tv": Kind("wall", ("living room", "bedroom"), (), joinery.tv),
}


def build(category: str, colour: str | None, rng: np.random.Generator) -> Model:
    """A piece of furniture; `colour` None: `rng` picks one. Raises `WorldError` for an unknown kind or colour."""
    if category not in KINDS:
        raise WorldError(f"no furniture is called {category!r}; wanted one of {', '.join(sorted(KINDS))}")
    kind = KINDS[category]
    if colour is None and kind.colours:
        colour = str(rng.choice(kind.colours))
    if colour is not None and colour not in kind.colours:
        wanted = f"one of {', '.join(kind.colours)}, or None" if kind.colours else "None"
        raise WorldError(f"a {category} does not come in {colour!r}; wanted {wanted}")
    return assembled(category, colour, kind.make(colour, rng), kind.placement)
