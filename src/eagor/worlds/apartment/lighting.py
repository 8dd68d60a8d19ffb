"""How strong the ceiling lamps of each room are, so that all rooms are lit alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eagor.worlds.apartment.finishes import Finish
from eagor.worlds.apartment.furnisher import Piece
from eagor.worlds.scene import Material, Room
from eagor.worlds.sources import mean_colour

# A room in which one ceiling lamp of the power that it is built with is right: square metres of floor, walls and
# ceiling, and the share of the light that they swallow.
_SURFACE, _ABSORPTION = 60.0, 0.45
_SHARES = (0.2, 1.7)  # of that power: no lamp is much weaker or stronger than those on sale
_FURNISHED = 0.15  # share of the surface that furniture and open doors hide
_DARK = 0.75  # what those swallow


def lit(pieces: Sequence[Piece], rooms: Sequence[Room], finishes: Sequence[Finish], height: float) -> list[Piece]:
    """The same pieces, the ceiling lamps as strong as their rooms want it; `height` of the rooms in metres.

    Between walls, the light that goes round is the power of the lamps over the light that the surfaces swallow (the
    integrating sphere): the larger a room and the darker its walls and floor, the stronger its lamps. One lamp for two
    parts of a room has to do for both.
    """
    count = Counter(piece.room for piece in pieces if piece.category == "ceiling lamp")
    shares = {
        room: float(np.clip(_swallowed(rooms[room], finishes[room], height) / (_SURFACE * _ABSORPTION) / n, *_SHARES))
        for room, n in count.items()
    }
    return [_dimmed(piece, shares[piece.room]) if piece.category == "ceiling lamp" else piece for piece in pieces]


def _swallowed(room: Room, finish: Finish, height: float) -> float:
    """Square metres of black that would swallow as much light as floor, walls and ceiling of a room do."""
    x0, y0, x1, y1 = room.rectangles.T
    walls = float((2 * (x1 - x0 + y1 - y0)).sum()) * height
    low, high = (float(np.clip(level, 0, height)) for level in finish.tiled)
    tiled = (high - low) / height if finish.tiles else 0.0
    surfaces = [
        (room.area, finish.floor[1]),
        (room.area, finish.ceiling[1]),
        ((1 - tiled) * walls, finish.wall[1]),
        (tiled * walls, finish.tiles[1] if finish.tiles else finish.wall[1]),
    ]
    bare = sum(area * _absorbed(look) for area, look in surfaces)
    return (1 - _FURNISHED) * bare + _FURNISHED * _DARK * (walls + 2 * room.area)


def _absorbed(look: Material) -> float:
    """The share of white light that a surface swallows."""
    return 1 - float(mean_colour(look).mean())


def _dimmed(piece: Piece, share: float) -> Piece:
    """A lamp with so much of its power."""
    lights = tuple(replace(light, power=share * light.power) for light in piece.model.lamps)
    return replace(piece, model=replace(piece.model, lamps=lights))
