"""Floor plans: a layout of one of the families, turned and mirrored, with doors and windows cut; and its cells.

Wall lines are the centre lines of the inner walls. An outer wall has its inner face at the same distance from the line
as an inner wall, and grows outwards. Frame: x, y of the world, metres. Cells are those of a grid whose widths follow
the plan's lines: air of a room, air outside, or solid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._values import lazy
from eagor.errors import WorldError
from eagor.lab.worlds.apartment.families import FAMILIES, Layout, Rectangle
from eagor.lab.worlds.scene import Room

HALF_WALL = 0.055  # half the thickness of an inner wall
OUTER_WALL = 0.25
LINING = 0.03  # thickness of a door's lining, within the hole
DOOR_HEAD = 2.08
OUTSIDE = -1
# Windows, metres: range of width, and the heights of sills to choose from.
_WINDOWS: dict[str, tuple[float, float, list[float]]] = {
    "bathroom": (0.5, 0.7, [1.45]), "living room": (1.2, 2.0, [0.45, 0.95]), "bedroom": (0.9, 1.5, [0.85, 0.95, 1.1]),
}  # fmt: skip
# Shortest side, and range of area in square metres, between centre lines.
_SIZES = {
    "living room": (3.2, 13.0, 42.0), "bedroom": (2.6, 8.6, 20.0), "kitchen": (2.1, 5.6, 17.0),
    "bathroom": (1.7, 3.9, 9.5), "hall": (1.2, 2.2, 18.0), "study": (2.1, 5.5, 15.0), "dining room": (2.4, 7.0, 17.0),
}  # fmt: skip
_NET_AREA = (45.0, 110.0)


@dataclass(frozen=True)
class Space:
    """A room between the centre lines of its walls."""

    name: str
    kind: str
    rectangles: tuple[Rectangle, ...]


@dataclass(frozen=True)
class Boundary:
    """A straight piece of wall line between two rooms.

    `axis` 0: along x at y = `line`; 1: along y at x = `line`; from `start` to `end`; `rooms`: the indices of the rooms
    on its low and on its high side, `OUTSIDE` if there is none.
    """

    axis: int
    line: float
    start: float
    end: float
    rooms: tuple[int, int]

    def box(self, start: float, end: float, low: float, high: float) -> Rectangle:
        """The rectangle from `start` to `end` along the line and from `low` to `high` across, relative to the line."""
        if self.axis == 0:
            return (start, self.line + low, end, self.line + high)
        return (self.line + low, start, self.line + high, end)


@dataclass(frozen=True)
class Opening:
    """A hole in a wall from `start` to `end` along its boundary and from `sill` to `head` in height."""

    boundary: Boundary
    start: float
    end: float
    sill: float
    head: float

    @property
    def hole(self) -> Rectangle:
        """Its rectangle on the floor, as deep as the wall."""
        low, high = (-(OUTER_WALL - HALF_WALL) if room == OUTSIDE else -HALF_WALL for room in self.boundary.rooms)
        return self.boundary.box(self.start, self.end, low, -high)

    def approach(self, depth: float, margin: float = 0.0) -> Rectangle:
        """The floor on both sides: `depth` metres from the line, `margin` wider at either end."""
        low, high = (0.0 if room == OUTSIDE else depth for room in self.boundary.rooms)
        return self.boundary.box(self.start - margin, self.end + margin, -low, high)


@dataclass(frozen=True)
class Doorway(Opening):
    """A doorway. `leaf`: the opening angle of its leaf in degrees, 0 for closed, or None without a leaf.

    The leaf hangs at the `start` or the end of the hole (`hinge`), and opens to the low (-1) or high (1) side.
    """

    leaf: float | None
    hinge: bool
    side: int

    @lazy
    def leaf_box(self) -> Rectangle | None:
        """Bounds of the open leaf on the floor; None without one, or if it is closed."""
        if not self.leaf:
            return None
        corners = np.array([self.at(along, across) for along in (0.0, self.end - self.start) for across in (0.0, 0.07)])
        return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())

    def at(self, along: float, across: float) -> np.ndarray:
        """The point ``(2,)`` `along` the open leaf from its hinge, and `across` it towards the wall behind it."""
        angle = np.radians(self.leaf or 0.0)
        outwards = self.side * (HALF_WALL + (0.05 if self.leaf and self.leaf > 120 else 0.0))
        direction = 1.0 if self.hinge else -1.0
        hinge = self.start + LINING if self.hinge else self.end - LINING
        u = hinge + direction * (along * np.cos(angle) - across * np.sin(angle))
        v = outwards + self.side * (along * np.sin(angle) + across * np.cos(angle))
        return np.array([u, self.boundary.line + v] if self.boundary.axis == 0 else [self.boundary.line + v, u])


def find_boundaries(spaces: tuple[Space, ...]) -> tuple[Boundary, ...]:
    """Every maximal straight piece of line with one room (or none) on each side."""
    ends = np.array([rectangle for space in spaces for rectangle in space.rectangles])
    lines = [np.unique(ends[:, [0, 2]]), np.unique(ends[:, [1, 3]])]
    owner = np.full((len(lines[0]) + 1, len(lines[1]) + 1), OUTSIDE)
    for place, space in enumerate(spaces):
        for x0, y0, x1, y1 in space.rectangles:
            i0, i1 = np.searchsorted(lines[0], [x0, x1])
            j0, j1 = np.searchsorted(lines[1], [y0, y1])
            owner[i0 + 1 : i1 + 1, j0 + 1 : j1 + 1] = place
    found = []
    for axis in (0, 1):
        along, across = lines[axis], lines[1 - axis]
        cells = owner if axis == 1 else owner.T  # cells[k, m]: k counts across the line, m along it
        for k, line in enumerate(across):
            run: tuple[int, int] | None = None
            start = 0.0
            for m in range(1, len(along) + 1):
                low, high = int(cells[k, m]), int(cells[k + 1, m])
                pair = (low, high) if m < len(along) and low != high else None
                if pair != run:
                    if run is not None:
                        found.append(Boundary(axis, float(line), start, float(along[m - 1]), run))
                    run, start = pair, float(along[m - 1])
    return tuple(found)


def cut_doorways(
    layout: Layout, spaces: tuple[Space, ...], boundaries: tuple[Boundary, ...], rng: np.random.Generator
) -> tuple[Doorway, ...] | None:
    """A doorway for every pair of rooms in `layout.doors`, and the front door; None if one does not fit."""
    doorways: list[Doorway] = []
    for low, high in [(layout.entrance, OUTSIDE), *layout.doors]:
        between = [b for b in boundaries if set(b.rooms) == {low, high}]
        for _ in range(60):
            doorway = _doorway(between, spaces, rng)
            if doorway is not None and all(_apart(doorway, other) for other in doorways):
                doorways.append(doorway)
                break
        else:
            return None
    return tuple(doorways)


def cut_windows(
    spaces: tuple[Space, ...], boundaries: tuple[Boundary, ...], doorways: tuple[Doorway, ...], rng: np.random.Generator
) -> tuple[Opening, ...]:
    """Windows in the outer walls: wide ones in living rooms, small high ones in bathrooms."""
    windows: list[Opening] = []
    for place, space in enumerate(spaces):
        outer = [b for b in boundaries if set(b.rooms) == {place, OUTSIDE}]
        if space.kind in ("bathroom", "hall"):
            outer = [b for b in outer if rng.random() < (0.6 if space.kind == "bathroom" else 0.3)][:1]
        elif space.kind == "living room" and len(outer) > 1:  # one wall without windows, for the television
            long = [b for b in outer if b.end - b.start > 2.4]
            if long:
                outer.remove(long[rng.integers(len(long))])
        narrow, wide, sills = _WINDOWS.get(space.kind, _WINDOWS["bedroom"])
        for boundary in outer:
            free = boundary.end - boundary.start - 2 * HALF_WALL - 0.7
            width = float(rng.uniform(narrow, wide))
            sill = float(rng.choice(sills)) if len(sills) > 1 else sills[0]
            count = 2 if space.kind == "living room" and free >= 2 * width + 0.8 else 1
            if space.kind == "kitchen":
                sill = 1.2  # above the worktop and the things on it
            if boundary is not outer[0] and rng.random() < 0.35:
                continue
            width = round(min(width, free), 2)
            if width < 0.5:
                continue
            for i in range(count):
                part = free / count
                shift = float(rng.uniform(0.2, 0.8)) if count == 1 else 0.5
                start = round(boundary.start + HALF_WALL + 0.35 + i * part + shift * max(part - width, 0.0), 3)
                window = Opening(boundary, start, round(start + width, 3), round(sill, 2), 2.15)
                inside, kept = window.approach(0.3, 0.1), [d.approach(0.3, 0.15) for d in doorways]
                kept += [d.leaf_box for d in doorways if d.leaf_box]
                if not any(_overlap(inside, other) for other in kept):
                    windows.append(window)
    return tuple(windows)


def _doorway(between: list[Boundary], spaces: tuple[Space, ...], rng: np.random.Generator) -> Doorway | None:
    """One attempt at a doorway in one of the boundaries."""
    if not between:
        return None
    boundary = between[rng.integers(len(between))]
    entrance = OUTSIDE in boundary.rooms
    width = round(float(rng.uniform(0.92, 1.0) if entrance else rng.uniform(0.8, 0.95)), 2) + 2 * LINING
    corner = HALF_WALL + 0.09
    room = boundary.end - boundary.start - 2 * corner - width
    if room < 0:
        return None
    shift = float(rng.choice([0.0, room, rng.uniform(0.0, room)], p=[0.35, 0.35, 0.3]))
    start = round(boundary.start + corner + shift, 3)
    end = round(start + width, 3)
    inner = -1 if boundary.rooms[0] != OUTSIDE else 1
    if entrance:
        return Doorway(boundary, start, end, 0.0, DOOR_HEAD, 0.0, bool(rng.random() < 0.5), inner)
    bare = Doorway(boundary, start, end, 0.0, DOOR_HEAD, None, True, 1)
    if rng.random() < 0.2:
        return bare
    ways = [(hinge, side) for hinge in (True, False) for side in (-1, 1)]
    rng.shuffle(ways)
    # A leaf opens into the room rather than into the hall, and leans against a wall.
    for hinge, side in sorted(ways, key=lambda way: spaces[boundary.rooms[max(way[1], 0)]].kind == "hall"):
        angle = _leaning(boundary, spaces[boundary.rooms[max(side, 0)]], start if hinge else end, width, hinge, side)
        if angle is not None:
            turned = round(angle + float(rng.uniform(-3, 1)), 1)
            return Doorway(boundary, start, end, 0.0, DOOR_HEAD, turned, bool(hinge), int(side))
    return bare


def _leaning(boundary: Boundary, space: Space, at: float, width: float, hinge: bool, side: int) -> float | None:
    """The angle at which a leaf, hung `at` this end of the hole, leans against a wall of `space`; None if it cannot."""
    away = -1.0 if hinge else 1.0

    def inside(along: float, across: float) -> bool:
        u, v = at + away * along, boundary.line + side * across
        x, y = (u, v) if boundary.axis == 0 else (v, u)
        return any(x0 <= x <= x1 and y0 <= y <= y1 for x0, y0, x1, y1 in space.rectangles)

    if not inside(0.35, 0.1):  # a corner next to the hinge: the leaf leans against the other wall
        return 92.0 if inside(-0.1, width + 0.15) else None
    if all(inside(x, 0.1) and not inside(x, -0.1) for x in np.linspace(0.0, width + 0.12, 8)):
        return 171.0
    return None


def _apart(a: Doorway, b: Doorway) -> bool:
    """Whether two doorways, the floor before them and their leaves keep clear of each other."""
    pairs = [(a.approach(0.1, 0.2), b.approach(0.1, 0.2)), (a.leaf_box, b.leaf_box)]
    pairs += [(one.leaf_box, other.approach(0.75, 0.02)) for one, other in ((a, b), (b, a))]
    return not any(_overlap(one, other) for one, other in pairs if one and other)


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


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
        layout = FAMILIES[family](rng)
        spaces = _spaces(layout, rng)
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


def _spaces(layout: Layout, rng: np.random.Generator) -> tuple[Space, ...]:
    """The rooms of a layout, mirrored and with its axes exchanged at random; several of one kind are numbered."""
    mirrored, exchanged = rng.random(2) < 0.5, rng.random() < 0.5
    ends = np.array([rectangle for _, rectangles in layout.rooms for rectangle in rectangles])[:, 2:].max(axis=0)

    def turn(rectangle: Rectangle) -> Rectangle:
        corners = np.array(rectangle).reshape(2, 2)
        corners = np.sort(np.where(mirrored, ends - corners, corners), axis=0)
        x0, y0, x1, y1 = np.round((corners[:, ::-1] if exchanged else corners).reshape(4), 4).tolist()
        return x0, y0, x1, y1

    kinds = [kind for kind, _ in layout.rooms]
    spaces = []
    for place, (kind, rectangles) in enumerate(layout.rooms):
        number = f" {kinds[: place + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        spaces.append(Space(kind + number, kind, tuple(turn(rectangle) for rectangle in rectangles)))
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


# --- the cells of a plan ----------------------------------------------------------------------------------------------

SOLID = -2
_OUTWARDS = OUTER_WALL - HALF_WALL
NICHE = 0.06  # depth of the closed front door in its wall


@dataclass(frozen=True, eq=False)
class Cells:
    """The grid.

    `lines` along x, y, z; `air` ``(nx, ny, nz)``: the room, `OUTSIDE` or `SOLID`; `hole`: whether the cell is in a
    doorway or window; `owner` ``(nx, ny)``: the room that the walls there belong to.
    """

    lines: tuple[np.ndarray, np.ndarray, np.ndarray]
    air: np.ndarray
    hole: np.ndarray
    owner: np.ndarray


@dataclass(frozen=True, eq=False)
class WallFace:
    """A free stretch of wall from the floor up, seen from its room: at `line`, from `start` to `end` along `axis`.

    `side` is 1 if the room lies on the high side, -1 if it lies on the low side.
    """

    room: int
    axis: int
    line: float
    start: float
    end: float
    side: int


def carve(plan: Plan, levels: tuple[float, ...] = ()) -> Cells:
    """The cells of a plan, split at further `levels` of z where the look of a wall changes."""
    holes: tuple[Opening, ...] = (*plan.doorways, *plan.windows)
    cuts: tuple[set[float], set[float]] = (set(), set())
    for axis, end in enumerate(plan.extent):
        cuts[axis].update((-_OUTWARDS - 1.0, -_OUTWARDS, end + _OUTWARDS, end + _OUTWARDS + 1.0))
        for space in plan.spaces:
            for line in np.array(space.rectangles)[:, [axis, axis + 2]].ravel().tolist():
                cuts[axis].update((line - HALF_WALL, line, line + HALF_WALL))
    for hole in holes:
        x0, y0, x1, y1 = _reach(hole)
        cuts[0].update((x0, x1))
        cuts[1].update((y0, y1))
    heights = {0.0, plan.height, *levels, *(h.sill for h in holes), *(h.head for h in holes)}
    xs, ys, zs = (np.unique(np.round(sorted(values), 4)) for values in (*cuts, heights))

    def window(rectangle: tuple[float, ...]) -> tuple[slice, slice]:
        x0, y0, x1, y1 = np.round(rectangle, 4)
        return _span(xs, x0, x1), _span(ys, y0, y1)

    room = np.full((len(xs) - 1, len(ys) - 1), OUTSIDE)
    for place, space in enumerate(plan.spaces):
        for rectangle in space.rectangles:
            room[window(rectangle)] = place
    owner = room.copy()
    solid = np.zeros(room.shape, dtype=bool)
    for boundary in plan.boundaries:
        if tuple(sorted(boundary.rooms)) in plan.open_to:
            continue
        low, high = (-_OUTWARDS if place == OUTSIDE else -HALF_WALL for place in boundary.rooms)
        beyond = _OUTWARDS if OUTSIDE in boundary.rooms else 0.0
        solid[window(boundary.box(boundary.start, boundary.end, -HALF_WALL, HALF_WALL))] = True
        wide = window(boundary.box(boundary.start - beyond, boundary.end + beyond, low, -high))
        outer = room[wide] == OUTSIDE
        solid[wide] |= outer
        owner[wide][outer & (owner[wide] == OUTSIDE)] = max(boundary.rooms)
    for x, y in _corners_of_walls(plan):
        solid[window((x - HALF_WALL, y - HALF_WALL, x + HALF_WALL, y + HALF_WALL))] = True
    air = np.where(solid, SOLID, room)[:, :, None].repeat(len(zs) - 1, axis=2)
    carved = np.zeros(air.shape, dtype=bool)
    for hole in holes:
        where, upright = window(_reach(hole)), _span(zs, hole.sill, hole.head)
        air[(*where, upright)] = owner[where][:, :, None]
        carved[(*where, upright)] = True
    return Cells((xs, ys, zs), air, carved, owner)


def _span(lines: np.ndarray, low: float, high: float) -> slice:
    """The cells between two of the lines."""
    return slice(*np.searchsorted(lines, [low - 1e-6, high - 1e-6]).tolist())


def rooms_of(plan: Plan, cells: Cells) -> tuple[Room, ...]:
    """The rooms between their walls, without the floor in doorways."""
    xs, ys, _ = cells.lines
    ground = np.where(cells.hole[:, :, 0], SOLID, cells.air[:, :, 0])
    found = (_few_rectangles(ground == place, xs, ys) for place in range(len(plan.spaces)))
    return tuple(Room(space.name, space.kind, few) for space, few in zip(plan.spaces, found, strict=True))


def wall_faces(cells: Cells) -> tuple[WallFace, ...]:
    """The stretches of wall that stand on the floor, without those inside doorways."""
    found = []
    ground, solid = np.where(cells.hole[:, :, 0], OUTSIDE, cells.air[:, :, 0]).T, cells.air[:, :, 0].T == SOLID
    for axis in (0, 1):  # of both, the first axis runs across the wall
        lines, along = cells.lines[1 - axis], cells.lines[axis]
        for k in range(1, len(lines) - 1):
            for side, inner, outer in ((1, k, k - 1), (-1, k - 1, k)):
                key = np.where(solid[outer] & (ground[inner] >= 0), ground[inner] + 1, 0)[None]
                for value, _, start, _, end in rectangles_of(key):
                    ends = float(along[start]), float(along[end])
                    found.append(WallFace(value - 1, axis, float(lines[k]), *ends, side))
        ground, solid = ground.T, solid.T
    return tuple(found)


def _corners_of_walls(plan: Plan) -> set[tuple[float, float]]:
    """The points where a wall along x and one along y both end."""
    ends: tuple[set[tuple[float, float]], set[tuple[float, float]]] = (set(), set())
    for boundary in plan.boundaries:
        if tuple(sorted(boundary.rooms)) not in plan.open_to:
            for along in (boundary.start, boundary.end):
                x, y = (along, boundary.line) if boundary.axis == 0 else (boundary.line, along)
                ends[boundary.axis].add((x, y))
    return ends[0] & ends[1]


def _reach(hole: Opening) -> tuple[float, float, float, float]:
    """The rectangle that is cut out: the front door is a niche, all others go through the wall."""
    boundary = hole.boundary
    if OUTSIDE in boundary.rooms and hole.sill == 0.0:
        inner = HALF_WALL if boundary.rooms[0] == OUTSIDE else -HALF_WALL
        low, high = sorted((inner, inner - np.sign(inner) * NICHE))
        return boundary.box(hole.start, hole.end, low, high)
    return hole.hole


def rectangles_of(key: np.ndarray) -> list[tuple[int, int, int, int, int]]:
    """Rectangles `(value, a0, b0, a1, b1)` of equal values that cover all of `key` ``(A, B)`` that is not zero."""
    left = key.astype(np.int64)
    found = []
    for a, b in np.argwhere(left):
        value = left[a, b]
        if value == 0:
            continue
        row = left[a, b:] == value
        b1 = b + (len(row) if row.all() else int(row.argmin()))
        rows = (left[a:, b:b1] == value).all(axis=1)
        a1 = a + (len(rows) if rows.all() else int(rows.argmin()))
        left[a:a1, b:b1] = 0
        found.append((int(value), int(a), int(b), int(a1), int(b1)))
    return found


def _few_rectangles(mask: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Rectangles ``(n, 4)`` x0, y0, x1, y1 that cover the cells in `mask`: few, the first as large as possible."""
    options = []
    for turned in (False, True):
        for step in (1, -1):
            view = mask[::step, ::step]
            found = np.array(rectangles_of(view.T if turned else view))[:, 1:]
            cells = found[:, [1, 0, 3, 2]] if turned else found
            if step < 0:
                cells = np.array([*mask.shape, *mask.shape]) - cells[:, [2, 3, 0, 1]]
            found = np.stack([xs[cells[:, 0]], ys[cells[:, 1]], xs[cells[:, 2]], ys[cells[:, 3]]], axis=1)
            area = (found[:, 2] - found[:, 0]) * (found[:, 3] - found[:, 1])
            options.append((len(found), -float(area.max()), found[np.argsort(-area, kind="stable")]))
    return min(options, key=lambda option: option[:2])[2]
