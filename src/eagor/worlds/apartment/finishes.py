"""Paint, tiles and floors of an apartment's rooms, and the power of their ceiling lamps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.worlds.apartment.furnisher import Piece
from eagor.worlds.apartment.plans import Plan
from eagor.worlds.apartment.textures import material
from eagor.worlds.scene import Material, Room
from eagor.worlds.sources import mean_colour

Look = tuple[str, Material]  # kind of material (its repeat), and the material

# sRGB of wall paint: warm whites first, then pastel tints.
_WHITES = ((240, 234, 222), (238, 236, 230), (236, 228, 214))
_TINTS = ((222, 230, 216), (214, 224, 232), (238, 222, 204), (232, 216, 214), (226, 220, 236), (240, 230, 196))


# The reference room, for which one ceiling lamp of default power is right: square metres of floor, walls and ceiling,
# and the share of the light that they absorb.
_SURFACE, _ABSORPTION = 60.0, 0.45
_SHARES = (0.2, 1.7)  # range of that power, as of real lamps
_FURNISHED = 0.15  # share of the surface that furniture and open doors cover
_DARK = 0.75  # absorption of those


@dataclass(frozen=True, eq=False)
class Finish:
    """The surfaces of a room; `tiled`: the range of height in which all of its walls have `tiles`."""

    wall: Look
    tiles: Look | None
    tiled: tuple[float, float]
    floor: Look
    ceiling: Look
    reveal: Look
    facade: Look
    skirting: Look | None


def draw_finishes(plan: Plan, rng: np.random.Generator) -> tuple[Finish, ...]:
    """One finish for each room; rooms that are open to each other share their wall paint and mostly their floor."""
    facade = ("plaster", material("plaster", None, rng))
    white = ("paint", material("paint", "white", rng))
    ceiling = ("paint", _tinted(material("paint", "white", rng), (244, 243, 240), rng))
    parquet = ("parquet", material("parquet", None, rng))
    skirting = white if rng.random() < 0.6 else ("wood", material("wood", None, rng))
    wall_kind = "plaster" if rng.random() < 0.5 else "paint"
    finishes: list[Finish] = []
    for place, space in enumerate(plan.spaces):
        joined = [a for a, b in plan.open_to if b == place] + [b for a, b in plan.open_to if a == place and b < place]
        tone = _WHITES[rng.integers(len(_WHITES))] if rng.random() < 0.5 else _TINTS[rng.integers(len(_TINTS))]
        if joined:
            wall = finishes[joined[0]].wall
        else:
            wall = (wall_kind, _tinted(material(wall_kind, "white", rng), tone, rng))
        tiles, tiled, floor, boards = None, (0.0, 0.0), parquet, skirting
        if space.kind == "bathroom":
            tiles, floor, boards = ("tile", material("tile", None, rng)), ("tile", material("tile", None, rng)), None
            tiled = (0.0, plan.height) if rng.random() < 0.5 else (0.0, float(rng.choice([1.4, 2.0])))
        elif space.kind == "kitchen":
            tiles = ("tile", material("tile", None, rng))  # above the worktop
            if not joined or rng.random() < 0.5:
                floor = ("tile", material("tile", None, rng))
        elif space.kind == "bedroom" and rng.random() < 0.5 and not joined:
            floor = ("carpet", material("carpet", None, rng))
        elif space.kind == "hall" and rng.random() < 0.3:
            floor = ("tile", material("tile", None, rng))
        finishes.append(Finish(wall, tiles, tiled, floor, ceiling, white, facade, boards))
    return tuple(finishes)


def _tinted(look: Material, tone: tuple[int, int, int], rng: np.random.Generator) -> Material:
    """`look` in a slightly varied tone (sRGB, 0 to 255)."""
    linear = to_linear(np.array(tone) / 255 * rng.uniform(0.98, 1.02))
    if look.texture is not None:
        linear = linear / to_linear(look.texture[::4, ::4] / 255).mean(axis=(0, 1))
    r, g, b = to_coded(linear)
    return replace(look, name=f"wall {look.name}", colour=(float(r), float(g), float(b)))


def lit(pieces: Sequence[Piece], rooms: Sequence[Room], finishes: Sequence[Finish], height: float) -> list[Piece]:
    """The same pieces with ceiling lamps of a power that suits their rooms; `height` of the rooms in metres.

    The light between walls is the power of the lamps over the absorption of the surfaces (the integrating sphere).
    """
    count = Counter(piece.room for piece in pieces if piece.category == "ceiling lamp")
    shares = {
        room: float(np.clip(_swallowed(rooms[room], finishes[room], height) / (_SURFACE * _ABSORPTION) / n, *_SHARES))
        for room, n in count.items()
    }
    return [_dimmed(piece, shares[piece.room]) if piece.category == "ceiling lamp" else piece for piece in pieces]


def _swallowed(room: Room, finish: Finish, height: float) -> float:
    """The absorption of a room's floor, walls and ceiling, as square metres of black."""
    x0, y0, x1, y1 = room.rectangles.T
    walls = float((2 * (x1 - x0 + y1 - y0)).sum()) * height
    low, high = (float(np.clip(level, 0, height)) for level in finish.tiled)
    tiled = (high - low) / height if finish.tiles else 0.0
    surfaces = [(room.area, finish.floor[1]), (room.area, finish.ceiling[1]), ((1 - tiled) * walls, finish.wall[1])]
    surfaces.append((tiled * walls, (finish.tiles or finish.wall)[1]))
    bare = sum(area * (1 - float(mean_colour(look).mean())) for area, look in surfaces)
    return (1 - _FURNISHED) * bare + _FURNISHED * _DARK * (walls + 2 * room.area)


def _dimmed(piece: Piece, share: float) -> Piece:
    lights = tuple(replace(light, power=share * light.power) for light in piece.model.lamps)
    return replace(piece, model=replace(piece.model, lamps=lights))
