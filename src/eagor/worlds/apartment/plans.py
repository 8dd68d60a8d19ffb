"""Floor plans: a layout of one of the families, turned and mirrored, with doors and windows cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor.errors import WorldError
from eagor.worlds.apartment.families import FAMILIES, Layout, Rectangle
from eagor.worlds.apartment.openings import (
    HALF_WALL,
    Boundary,
    Doorway,
    Opening,
    Space,
    cut_doorways,
    cut_windows,
    find_boundaries,
)  # fmt: skip

# Shortest side, and range of area in square metres, between centre lines.
_SIZES = {
    "living room": (3.2, 13.0, 42.0), "bedroom": (2.6, 8.6, 20.0), "kitchen": (2.1, 5.6, 17.0),
    "bathroom": (1.7, 3.9, 9.5), "hall": (1.2, 2.2, 18.0), "study": (2.1, 5.5, 15.0), "dining room": (2.4, 7.0, 17.0),
}  # fmt: skip
_NET_AREA = (45.0, 110.0)


@dataclass(frozen=True)
class Plan:
    """A floor plan; `open_to` holds the pairs of rooms without a wall between, the smaller index first."""

    family: str
    spaces: tuple[Space, ...]
    boundaries: tuple[Boundary, ...]
    open_to: frozenset[tuple[int, int]]
    doorways: tuple[Doorway, ...]
    windows: tuple[Opening, ...]
    height: float

    @property
    def extent(self) -> tuple[float, float]:
        """Length along x and y between the outer lines; the corner is at (0, 0)."""
        ends = np.array([rectangle for space in self.spaces for rectangle in space.rectangles])
        return float(ends[:, 2].max()), float(ends[:, 3].max())


def draw_plan(rng: np.random.Generator) -> Plan:
    """A floor plan of one of `FAMILIES`, mirrored and turned at random. Raises `WorldError` if none can be drawn."""
    family = list(FAMILIES)[rng.integers(len(FAMILIES))]
    for _ in range(400):
        layout = _turned(FAMILIES[family](rng), rng)
        spaces = _named(layout)
        if not _sizes_fit(spaces):
            continue
        open_to = frozenset((min(pair), max(pair)) for pair in layout.openings)
        boundaries = find_boundaries(spaces)
        doorways = cut_doorways(layout, spaces, boundaries, rng)
        if doorways is None:
            continue
        windows = cut_windows(spaces, boundaries, doorways, rng)
        lit = {room for window in windows for room in window.boundary.rooms}
        if any(s.kind in ("living room", "bedroom") and i not in lit for i, s in enumerate(spaces)):
            continue
        height = round(float(rng.uniform(2.5, 2.8)), 2)
        return Plan(family, spaces, boundaries, open_to, doorways, windows, height)
    raise WorldError(f"no floor plan of the family {family!r} came out in 400 tries; use another seed")


def _turned(layout: Layout, rng: np.random.Generator) -> Layout:
    """`layout` mirrored and with its axes exchanged at random."""
    mirrored, exchanged = rng.random(2) < 0.5, rng.random() < 0.5
    every = np.array([rectangle for _, rectangles in layout.rooms for rectangle in rectangles])
    ends = np.stack([every[:, 2].max(), every[:, 3].max()])

    def turn(rectangle: Rectangle) -> Rectangle:
        corners = np.array(rectangle).reshape(2, 2)
        corners = np.sort(np.where(mirrored, ends - corners, corners), axis=0)
        x0, y0, x1, y1 = np.round((corners[:, ::-1] if exchanged else corners).reshape(4), 4).tolist()
        return x0, y0, x1, y1

    rooms = tuple((kind, tuple(turn(rectangle) for rectangle in rectangles)) for kind, rectangles in layout.rooms)
    return Layout(rooms, layout.doors, layout.openings, layout.entrance)


def _named(layout: Layout) -> tuple[Space, ...]:
    kinds = [kind for kind, _ in layout.rooms]
    spaces = []
    for place, (kind, rectangles) in enumerate(layout.rooms):
        number = f" {kinds[: place + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        spaces.append(Space(kind + number, kind, rectangles))
    return tuple(spaces)


def _sizes_fit(spaces: tuple[Space, ...]) -> bool:
    net = 0.0
    for space in spaces:
        side, least, most = _SIZES[space.kind]
        sides = [(x1 - x0, y1 - y0) for x0, y0, x1, y1 in space.rectangles]
        area = sum(a * b for a, b in sides)
        net += sum((a - 2 * HALF_WALL) * (b - 2 * HALF_WALL) for a, b in sides)
        if not least <= area <= most or min(sides[0]) < side - 1e-6:
            return False
        if space.kind != "hall" and max(sides[0]) > 3.2 * min(sides[0]):
            return False
    return _NET_AREA[0] <= net <= _NET_AREA[1]
