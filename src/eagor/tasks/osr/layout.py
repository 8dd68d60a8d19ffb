"""OSR-Bench's maps, and the answers that follow from them by the benchmark's own rules.

A layout lists the cells of each category on a grid of 10 x 10: ``{name: [[row, column], ...]}``; row 0 is at the top.
All answers of the benchmark derive from such a layout (Dongfang et al., arXiv 2505.11907, and the code published with
it), so labels depend on cells, not on metres.

The published layouts are mirrored against the pictures: what lies to the left in the room is drawn to the right. The
published answers follow the layouts, so left and right are exchanged in them. `swapped` gives the answer that is right
in the room.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from eagor._json import shown
from eagor.errors import FormatError

SIZE = 10  # rows and columns of a layout
Cell = tuple[int, int]
Layout = Mapping[str, Sequence[Sequence[int]]]
Grid = list[list[list[str]]]

NO_POSITION = "The positioning object is not found in the picture."
NOT_UNIQUE = "The positioning object is not unique in the picture."
NO_OBJECT = "The orienting object or querying object is not found in the picture."
NO_CANDIDATE = "None of the candidates were found in the picture."
ERRORS = (NO_POSITION, NOT_UNIQUE, NO_OBJECT, NO_CANDIDATE)
DIRECTIONS = ("Front", "Back", "Left", "Right", "Front Left", "Front Right", "Back Left", "Back Right")
_SIDES = {"Left": "Right", "Right": "Left"}


def direction_label(map: Layout, P: str, O: str, Q: str) -> str:
    """The published answer to "standing by P and facing the closest O, where is the closest Q?".

    With v1 and v2 the steps (rows, columns) from P to the nearest O and Q: "Front" if v1 . v2 > 0, "Back" if it is
    negative, "Left" if r1 c2 - c1 r2 > 0, "Right" if it is negative; both words, or the one that is not zero. Empty if
    both are zero (an object in the cell of P); the benchmark leaves such questions out. "Unique" counts cells, not
    things. If there is no answer, one of `ERRORS`. Raises `FormatError` for an invalid layout.
    """
    found = steps(map, P, O, Q)
    return found if isinstance(found, str) else named(*products(*found))


def steps(layout: Layout, P: str, O: str, Q: str) -> tuple[Cell, Cell] | str:
    """The steps (rows, columns) from P to the nearest O and to the nearest Q, or the error that is the answer."""
    start = _position(layout, P)
    if isinstance(start, str):
        return start
    facing, asked = _ranked(start, cells(layout, O)), _ranked(start, cells(layout, Q))
    return (facing[0], asked[0]) if facing and asked else NO_OBJECT


def products(v1: Any, v2: Any) -> tuple[Any, Any]:
    """Dot product and cross product r1 c2 - c1 r2 of two steps (rows, columns), numbers or arrays."""
    return v1[0] * v2[0] + v1[1] * v2[1], v1[0] * v2[1] - v1[1] * v2[0]


def named(dot: float, cross: float) -> str:
    """The words for a dot product and a cross product (positive to the left)."""
    along = "Front" if dot > 0 else "Back" if dot < 0 else ""
    aside = "Left" if cross > 0 else "Right" if cross < 0 else ""
    return f"{along} {aside}".strip()


def distance_label(layout: Layout, category: str, choices: Iterable[str]) -> str:
    """The published answer to "which of the choices is the closest to the category?": the first of the nearest."""
    start = _position(layout, category)
    if isinstance(start, str):
        return start
    away = {choice: _square(_ranked(start, where)[0]) for choice in choices if (where := cells(layout, choice))}
    return min(away, key=lambda choice: away[choice], default=NO_CANDIDATE)


def count_label(counts: Mapping[str, int], category: str) -> str:
    """The published answer to "how many ... are in this room?", from the number of things of each category."""
    return str(counts.get(category, 0))


def is_tied(layout: Layout, P: str, name: str) -> bool:
    """Whether several cells of `name` are equally near to P, so that the smallest angle decides."""
    start = _position(layout, P)
    near = [] if isinstance(start, str) else _ranked(start, cells(layout, name))[:2]
    return len(near) == 2 and _square(near[0]) == _square(near[1])


def cells(layout: Layout, name: str) -> list[Cell]:
    """The cells of `name`, row by row, each once."""
    found: set[Cell] = set()
    for cell in layout.get(name, ()):
        if len(cell) != 2 or not all(isinstance(k, int) and not isinstance(k, bool) for k in cell):
            raise FormatError(f"the layout has {name!r} at {cell!r}; wanted [row, column], whole numbers")
        found.add((int(cell[0]), int(cell[1])))
    return sorted(found)


def _position(layout: Layout, name: str) -> Cell | str:
    """The only cell of `name`, or the error that is the answer if there is none or more than one."""
    found = cells(layout, name)
    if len(found) == 1:
        return found[0]
    return NOT_UNIQUE if found else NO_POSITION


def _ranked(start: Cell, where: Iterable[Cell]) -> list[Cell]:
    """The steps from `start` to each of `where`, nearest first; equally near ones by angle.

    Angles go from the direction of growing columns to that of growing rows, from 0 up to a full turn.
    """
    ways = [(row - start[0], column - start[1]) for row, column in where]
    return sorted(ways, key=lambda way: (_square(way), math.atan2(*way) % (2 * math.pi)))


def _square(way: Cell) -> int:
    return way[0] ** 2 + way[1] ** 2


def swapped(answer: str) -> str:
    """`answer` with left and right exchanged; any other answer as it is."""
    return " ".join(_SIDES.get(word, word) for word in answer.split(" ")) if answer in DIRECTIONS else answer


def mirrored(grid: Grid) -> Grid:
    """The grid with left and right exchanged: the real room, from a published grid."""
    return [row[::-1] for row in grid]


def layout_of(grid: Any) -> dict[str, list[list[int]]]:
    """The layout of a published grid: rows of cells, each a list of names. Raises `FormatError` for anything else."""
    if not isinstance(grid, list) or not all(isinstance(row, list) for row in grid):
        raise FormatError(f"a map is {type(grid).__name__}; wanted rows of cells, each a list of names")
    found: dict[str, list[list[int]]] = {}
    for i, row in enumerate(grid):
        for j, cell in enumerate(row):
            if not isinstance(cell, list) or not all(isinstance(name, str) for name in cell):
                raise FormatError(f"the map's cell in row {i}, column {j} is {shown(cell)}; wanted a list of names")
            for name in cell:
                found.setdefault(name, []).append([i, j])
    return found


def grid_of(layout: Layout, size: int = SIZE) -> Grid:
    """The grid of a layout, without what lies outside it."""
    grid: Grid = [[[] for _ in range(size)] for _ in range(size)]
    for name, where in layout.items():
        for row, column in where:
            if 0 <= row < size and 0 <= column < size:
                grid[row][column].append(name)
    return grid
