"""Furniture: one module per family, each with its `KINDS` and `BUILDERS`; this one knows them all."""

from __future__ import annotations

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.apartment.furniture import (
    bathroom,
    beds,
    chairs,
    decor,
    electronics,
    kitchen,
    seats,
    storage,
    tables,
)
from eagor.worlds.apartment.furniture.model import Builder, Kind, Model, assembled, finish
from eagor.worlds.apartment.meshes import Part

__all__ = ["KINDS", "Kind", "Model", "Part", "assembled", "build", "finish"]

_FAMILIES = (chairs, seats, beds, tables, storage, kitchen, bathroom, decor, electronics)
KINDS: dict[str, Kind] = {kind.category: kind for family in _FAMILIES for kind in family.KINDS}
_BUILDERS: dict[str, Builder] = {name: builder for family in _FAMILIES for name, builder in family.BUILDERS.items()}


def build(category: str, colour: str | None, rng: np.random.Generator) -> Model:
    """A piece of furniture; `colour` None: `rng` picks one, if its kind has any. Equal generators give equal pieces.

    Raises `WorldError` for a category or a colour that there is not.
    """
    if category not in KINDS:
        raise WorldError(f"no furniture is called {category!r}; wanted one of {', '.join(sorted(KINDS))}")
    colours = KINDS[category].colours
    if colour is None and colours:
        colour = str(rng.choice(colours))
    if colour is not None and colour not in colours:
        wanted = f"one of {', '.join(colours)}, or None" if colours else "None"
        raise WorldError(f"a {category} does not come in {colour!r}; wanted {wanted}")
    return _BUILDERS[category](colour, rng)
