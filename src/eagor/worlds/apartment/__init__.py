"""Apartments from a seed: floor plans of several families, furnished, painted and lit.

The entry point is `generate`. The same seed and `VERSION` give the same scene, byte for byte.
"""

from __future__ import annotations

from eagor.worlds.apartment.designing import build
from eagor.worlds.apartment.furnish import REQUIRED
from eagor.worlds.apartment.furniture import KINDS
from eagor.worlds.scene import STRUCTURE, Scene

__all__ = ["CATEGORIES", "REQUIRED", "VERSION", "generate"]

VERSION = "1"
CATEGORIES = (*STRUCTURE, *sorted(KINDS))  # all that an apartment can have; it always has those in REQUIRED


def generate(seed: int) -> Scene:
    """A furnished apartment of 45 to 110 square metres with three to seven rooms, metres, z = 0 the floor.

    The outer walls are along x and y. Everything in `REQUIRED` is there. Everything on the floor can be approached:
    passages are at least 0.5 m wide, and the `Ground` has free cells within 0.75 m of it. At least three solid pieces
    have a unique name (colour and category) although there are others of their category, and at least one name belongs
    to several pieces. `facts["family"]` names the kind of floor plan.
    Raises `WorldError` for a negative seed, or if nothing can be built from it.
    """
    return build(seed, f"apartment {VERSION} seed {seed}")[1]
