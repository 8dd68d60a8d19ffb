"""Which pieces are the odd ones out, so that "the red chair" among chairs of other colours is a question."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from eagor.worlds.apartment.furnisher import Furnisher, NoRoom, Piece
from eagor.worlds.apartment.furniture import KINDS, build

_LEAST_UNIQUE = 3
# Never in a colour of their own: fixtures come in the colour of their room, the units of a kitchen in one.
_FIXED = ("sink", "toilet", "bathtub", "cabinet", "refrigerator", "stove")


def name(piece: Piece) -> str:
    """Colour and category, as in `Instance.name`."""
    return f"{piece.model.colour} {piece.category}" if piece.model.colour else piece.category


def tell_apart(f: Furnisher) -> None:
    """Give single pieces another colour, until enough of them are one of a kind among several of their category.

    Mostly one chair differs from the others. Afterwards at least three solid pieces have a name of their own although
    their category occurs more than once, and at least one name occurs several times. Raises `NoRoom` if that fails.
    """
    chairs = f.of("chair")
    odd = int(f.rng.choice([0, 1, 2], p=[0.12, 0.7, 0.18])) if len(chairs) > 3 else 0
    for i in f.rng.permutation(len(chairs))[:odd]:
        _recolour(f, chairs[i])
    for _ in range(40):
        solid = [piece for piece in f.pieces if piece.solid]
        names, categories = Counter(map(name, solid)), Counter(piece.category for piece in solid)
        unique = [p for p in solid if names[name(p)] == 1 and categories[p.category] > 1]
        repeated = [p for p in solid if names[name(p)] > 1]
        if len(unique) >= _LEAST_UNIQUE and repeated:
            return
        # Of chairs at least two stay alike.
        pool = [p for p in repeated if p.category not in _FIXED and (p.category != "chair" or names[name(p)] > 2)]
        if not pool:
            break
        _recolour(f, pool[f.rng.integers(len(pool))])
    raise NoRoom("too few pieces to tell apart by colour")


def _recolour(f: Furnisher, piece: Piece) -> None:
    """Build `piece` again in a colour that no other of its category has; its size has to stay."""
    taken = {other.model.colour for other in f.of(piece.category)}
    colours = [colour for colour in KINDS[piece.category].colours if colour not in taken]
    for colour in f.rng.permutation(colours).tolist():
        model = build(piece.category, colour, np.random.default_rng(piece.seed))
        if np.allclose(model.size, piece.model.size, atol=2e-3):
            place = next(i for i, other in enumerate(f.pieces) if other is piece)
            f.pieces[place] = replace(piece, model=model)
            return
