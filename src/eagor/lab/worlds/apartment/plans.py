"""Floor plans: a layout of one of the families, turned and mirrored, with doors and windows cut.

A layout is drawn on the centre lines of the walls, in the rectangle from (0, 0), and is rejected if a room becomes too
small or too large. An outer wall has its inner face at the same distance from the line as an inner wall, and grows
outwards. Frame: x, y of the world, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eagor._values import lazy
from eagor.errors import WorldError
from eagor.lab.worlds.scene import Room

Rectangle = tuple[float, float, float, float]  # x0, y0, x1, y1
HALF_WALL = 0.055  # half the thickness of an inner wall
OUTER_WALL = 0.25
LINING = 0.03  # thickness of a door's lining, within the hole
NICHE = 0.06  # depth of the closed front door in its wall
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
# Range of a room's width in a row.
_WIDTHS = {
    "living room": (4.0, 5.6), "bedroom": (3.0, 4.3), "kitchen": (2.6, 3.8), "bathroom": (1.75, 2.5),
    "study": (2.3, 3.2), "dining room": (2.8, 3.6),
}  # fmt: skip

# --- the families of floor plans --------------------------------------------------------------------------------------


# Rooms, each of a kind and consisting of rectangles; doors and openings, both as pairs of indices of rooms. The front
# door, which leads to `OUTSIDE`, comes first.
Rooms = list[tuple[str, list[Rectangle]]]
Pairs = list[tuple[int, int]]
Layout = tuple[Rooms, Pairs, Pairs]


def corridor(rng: np.random.Generator) -> Layout:
    """Rooms on both sides of a corridor; often the living room closes its end over the full depth."""
    front, passage, back = _draw(rng, 3.2, 4.3), _draw(rng, 1.2, 1.5), _draw(rng, 2.6, 3.7)
    depth = front + passage + back
    end = _draw(rng, 3.4, 4.4) if rng.random() < 0.55 else 0.0  # width of a living room over the full depth
    near = ["bedroom", "bedroom"] if rng.random() < 0.6 else ["bedroom", "study"]
    if not end:
        near = ["living room", *near[: int(rng.integers(1, 3))]]
    far = ["kitchen", "bathroom"]
    if rng.random() < 0.5:
        far.append("study" if "study" not in near else "bedroom")
    rng.shuffle(near)
    rng.shuffle(far)
    widths, others = _widths(rng, near), _widths(rng, far)
    length = _snap((sum(widths) + sum(others)) / 2)
    rooms: Rooms = [("hall", [(0.0, front, length, front + passage)])]
    for kinds, sizes, y0, y1 in ((near, widths, 0.0, front), (far, others, front + passage, depth)):
        rooms += _row(kinds, [width * length / sum(sizes) for width in sizes], y0, y1)
    if end:
        rooms.append(("living room", [(length, 0.0, length + end, depth)]))
    doors, openings = [(0, OUTSIDE), *((0, i) for i in range(1, len(rooms)))], []
    if end and far[-1] == "kitchen":  # a kitchen next to the living room opens into it
        kitchen, living = len(rooms) - 2, len(rooms) - 1
        (openings if rng.random() < 0.5 else doors).append((kitchen, living))
        doors.remove((0, kitchen))
    return rooms, doors, openings


def open_plan(rng: np.random.Generator) -> Layout:
    """Living, kitchen and dining in one L-shaped space; the other rooms stand in its inner corner."""
    private = ["bedroom", "bathroom"]
    if rng.random() < 0.75:
        private.append("bedroom" if rng.random() < 0.6 else "study")
    rng.shuffle(private)
    widths = _widths(rng, private)
    arm, block, strip = _draw(rng, 2.4, 3.3), _draw(rng, 2.7, 3.9), _draw(rng, 3.3, 4.4)
    length, depth = _snap(arm + sum(widths)), strip + block
    dining = rng.random() < 0.5
    split = _snap(length - _draw(rng, 2.4, 3.2)) if dining else length
    kitchen = strip + (_draw(rng, 0.0, 1.0) if rng.random() < 0.5 else 0.0)
    living = [(0.0, 0.0, split, strip)]
    if kitchen > strip + 0.3:
        living.append((0.0, strip, arm, kitchen))
    else:
        kitchen = strip
    rooms: Rooms = [("living room", living), ("kitchen", [(0.0, kitchen, arm, depth)])]
    doors, openings = [(0, OUTSIDE)], [(0, 1)]
    if dining:
        rooms.append(("dining room", [(split, 0.0, length, strip)]))
        openings.append((0, 2))
    for kind, ((x0, y0, x1, y1),) in _row(private, widths, strip, depth):
        doors.append((2 if dining and arm + (x0 + x1) / 2 > split + 0.6 else 0, len(rooms)))
        rooms.append((kind, [(_snap(x0 + arm), y0, _snap(x1 + arm), y1)]))
    return rooms, doors, openings


def central_hall(rng: np.random.Generator) -> Layout:
    """Four wings turn like a pinwheel round a hall; one or two of them are divided."""
    x1, right, y1, high = (_draw(rng, 2.6, 3.8) for _ in range(4))
    across, along = _draw(rng, 1.8, 3.4), _draw(rng, 1.5, 2.6)
    x2, y2 = _snap(x1 + across), _snap(y1 + along)
    width, depth = _snap(x2 + right), _snap(y2 + high)
    wings = [(0.0, 0.0, x2, y1), (x2, 0.0, width, y2), (x1, y2, width, depth), (0.0, y1, x1, depth)]
    living = max(range(4), key=lambda i: (wings[i][2] - wings[i][0]) * (wings[i][3] - wings[i][1]))
    rest = [i for i in range(4) if i != living]
    rng.shuffle(rest)
    divided, kitchen, bedroom = rest
    rooms: Rooms = [("hall", [(x1, y1, x2, y2)]), ("living room", [wings[living]])]
    rooms += [("kitchen", [wings[kitchen]]), ("bedroom", [wings[bedroom]])]
    beside = {living: 1, kitchen: 2, bedroom: 3}[(divided - 1) % 4]  # the room in the wing before the divided one
    inner, outer = _divided(rng, divided, wings[divided], (x1, y1, x2, y2))
    second = "bedroom" if rng.random() < 0.5 else "study"
    if rng.random() < 0.5:  # the bathroom at the hall, the other room reached from the next wing ...
        rooms += [("bathroom", [inner]), (second, [outer])]
        behind = beside
    else:  # ... or a room at the hall, and a bathroom off that room
        rooms += [(second, [inner]), ("bathroom", [outer])]
        behind = 4 if rng.random() < 0.5 else beside
    return rooms, [(1, OUTSIDE), (0, 1), (0, 2), (0, 3), (0, 4), (behind, 5)], []


def _divided(rng: np.random.Generator, wing: int, rectangle: Rectangle, hall: Rectangle) -> tuple[Rectangle, Rectangle]:
    """A wing of the pinwheel cut in two: the part at the hall, and the part at the corner of the building."""
    axis = wing % 2  # the axis along which it is cut
    low, high, start, end = rectangle[axis], rectangle[axis + 2], hall[axis], hall[axis + 2]
    least = 1.2 if axis else 1.7  # of the part at the hall, along that axis
    if wing < 2:
        cut = _draw(rng, max(low + 1.7, start - 0.9), end - least)
    else:
        cut = _draw(rng, start + least, min(high - 1.7, end + 0.9))
    x0, y0, x1, y1 = rectangle
    first, last = ((x0, y0, x1, cut), (x0, cut, x1, y1)) if axis else ((x0, y0, cut, y1), (cut, y0, x1, y1))
    return (last, first) if wing < 2 else (first, last)


def railroad(rng: np.random.Generator) -> Layout:
    """Rooms in a row, one through another; the bathroom stands beside a short passage."""
    depth = _draw(rng, 3.8, 5.0)
    day = ["living room", "kitchen"]
    if rng.random() < 0.4:
        day.insert(1, "dining room")
    elif rng.random() < 0.4:
        day.reverse()
    night = ["bedroom"]
    if rng.random() < 0.7:
        night.append("bedroom" if rng.random() < 0.4 else "study")
    passage, slot = _draw(rng, 1.2, 1.5), _draw(rng, 1.8, 2.4)
    at_low = rng.random() < 0.5
    rooms, doors, openings, x0 = [], [], [], 0.0
    for place, kind in enumerate([*day, "hall", *night]):
        wide = slot if kind == "hall" else _draw(rng, *_WIDTHS[kind])
        if kind not in ("hall", "living room"):
            wide = _snap(wide * 0.9)
        x1, y0, y1 = _snap(x0 + wide), 0.0, depth
        if kind == "hall":
            y0, y1 = (0.0, passage) if at_low else (depth - passage, depth)
        if place:
            together = place < len(day)
            (openings if together and rng.random() < 0.3 else doors).append((place - 1, place))
        rooms.append((kind, [(x0, y0, x1, y1)]))
        x0 = x1
    hall = len(day)
    ((x0, _, x1, _),) = rooms[hall][1]
    doors.append((hall, len(rooms)))
    rooms.append(("bathroom", [(x0, passage, x1, depth) if at_low else (x0, 0.0, x1, _snap(depth - passage))]))
    return rooms, [(hall if rng.random() < 0.5 else 0, OUTSIDE), *doors], openings


def studio(rng: np.random.Generator) -> Layout:
    """One large space with a kitchen and a sleeping alcove open to it; only the bathroom is closed."""
    x1, entry, bath = _draw(rng, 1.9, 2.5), _draw(rng, 1.6, 3.2), _draw(rng, 2.4, 3.2)
    strip, alcove = _draw(rng, 3.4, 4.4), _draw(rng, 2.8, 3.4)
    depth = _snap(max(strip + alcove, entry + bath))
    kitchen, bed = _draw(rng, 2.1, 2.9), _draw(rng, 3.0, 3.8)
    x2 = _snap(x1 + kitchen)
    width = _snap(x2 + bed)
    rooms: Rooms = [
        ("living room", [(x1, 0.0, width, strip)]),
        ("bedroom", [(x2, strip, width, depth)]),
        ("kitchen", [(x1, strip, x2, depth)]),
        ("bathroom", [(0.0, entry, x1, depth)]),
        ("hall", [(0.0, 0.0, x1, entry)]),
    ]
    doors, openings = [(4, OUTSIDE), (3, 4)], [(0, 1), (0, 2)]
    (openings if rng.random() < 0.4 else doors).append((0, 4))
    return rooms, doors, openings


FAMILIES: dict[str, Callable[[np.random.Generator], Layout]] = {
    "corridor": corridor, "open plan": open_plan, "central hall": central_hall, "railroad": railroad, "studio": studio,
}  # fmt: skip


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    return _snap(rng.uniform(min(low, high), high))  # if nothing fits, the plan is rejected for its room sizes


def _snap(metres: float) -> float:
    return round(metres * 20) / 20


def _widths(rng: np.random.Generator, kinds: list[str]) -> list[float]:
    return [_draw(rng, *_WIDTHS[kind]) for kind in kinds]


def _row(kinds: list[str], widths: list[float], y0: float, y1: float) -> Rooms:
    """Rooms side by side along x from 0."""
    ends = [_snap(x) for x in np.cumsum([0.0, *widths])]
    return [(kind, [(ends[i], y0, ends[i + 1], y1)]) for i, kind in enumerate(kinds)]


# --- walls, doors and windows -----------------------------------------------------------------------------------------


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

    def point(self, along: float, across: float = 0.0) -> tuple[float, float]:
        """x and y at the coordinate `along` the axis, `across` metres from the line."""
        return (along, self.line + across) if self.axis == 0 else (self.line + across, along)

    def box(self, start: float, end: float, low: float, high: float) -> Rectangle:
        """The rectangle from `start` to `end` along the line and from `low` to `high` across, relative to the line."""
        return (*self.point(start, low), *self.point(end, high))


@dataclass(frozen=True)
class Opening:
    """A hole in a wall from `start` to `end` along its boundary and from `sill` to `head` in height."""

    boundary: Boundary
    start: float
    end: float
    sill: float
    head: float

    @property
    def reach(self) -> tuple[float, float]:
        """Its two ends across, from the line: as deep as the wall, but the front door is a niche."""
        outer = (NICHE if self.sill == 0.0 else OUTER_WALL) - HALF_WALL
        low, high = (outer if room == OUTSIDE else HALF_WALL for room in self.boundary.rooms)
        return -low, high

    @property
    def hole(self) -> Rectangle:
        """Its rectangle on the floor."""
        return self.boundary.box(self.start, self.end, *self.reach)

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
        return np.array(self.boundary.point(u, v))


@dataclass(frozen=True)
class Plan:
    """A floor plan. `spaces`: its rooms between the centre lines of their walls; `walls`: all of them.

    `open_to` holds the pairs of rooms without a wall between, the smaller index first.
    """

    family: str
    spaces: tuple[Room, ...]
    walls: tuple[Boundary, ...]
    open_to: frozenset[tuple[int, int]]
    doorways: tuple[Doorway, ...]
    windows: tuple[Opening, ...]
    height: float

    @property
    def extent(self) -> tuple[float, float]:
        """Length along x and y between the outer lines; the corner is at (0, 0)."""
        width, depth = np.concatenate([space.rectangles for space in self.spaces])[:, 2:].max(axis=0).tolist()
        return width, depth


def draw_plan(rng: np.random.Generator) -> Plan:
    """A floor plan of one of `FAMILIES`, mirrored and turned at random. Raises `WorldError` if none can be drawn."""
    family = list(FAMILIES)[rng.integers(len(FAMILIES))]
    for _ in range(400):
        rooms, doors, openings = FAMILIES[family](rng)
        spaces = _spaces(rooms, rng)
        if not _sizes_fit(spaces):
            continue
        boundaries = find_boundaries(spaces)
        doorways = cut_doorways(doors, spaces, boundaries, rng)
        if doorways is None:
            continue
        windows = cut_windows(spaces, boundaries, doorways, rng)
        lit = {room for window in windows for room in window.boundary.rooms}
        if any(s.kind in ("living room", "bedroom") and i not in lit for i, s in enumerate(spaces)):
            continue
        open_to = frozenset((min(pair), max(pair)) for pair in openings)
        walls = tuple(wall for wall in boundaries if tuple(sorted(wall.rooms)) not in open_to)
        height = round(float(rng.uniform(2.5, 2.8)), 2)
        return Plan(family, spaces, walls, open_to, tuple(doorways), tuple(windows), height)
    raise WorldError(f"no floor plan of the family {family!r} came out in 400 tries; use another seed")


def _spaces(layout: Rooms, rng: np.random.Generator) -> tuple[Room, ...]:
    """The rooms of a layout, mirrored and with its axes exchanged at random; several of one kind are numbered."""
    mirrored, exchanged = rng.random(2) < 0.5, rng.random() < 0.5
    ends = np.concatenate([rectangles for _, rectangles in layout])[:, 2:].max(axis=0)
    kinds = [kind for kind, _ in layout]
    spaces = []
    for place, (kind, rectangles) in enumerate(layout):
        number = f" {kinds[: place + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        corners = np.reshape(rectangles, (-1, 2, 2))
        corners = np.sort(np.where(mirrored, ends - corners, corners), axis=1)
        turned = corners[..., ::-1] if exchanged else corners
        spaces.append(Room(kind + number, kind, np.round(turned.reshape(-1, 4), 4)))
    return tuple(spaces)


def _sizes_fit(spaces: tuple[Room, ...]) -> bool:
    net = 0.0
    for space in spaces:
        shortest, least, most = _SIZES[space.kind]
        sides = space.rectangles[:, 2:] - space.rectangles[:, :2]
        net += (sides - 2 * HALF_WALL).prod(axis=1).sum()
        if not least <= space.area <= most or sides[0].min() < shortest - 1e-6:
            return False
        if space.kind != "hall" and sides[0].max() > 3.2 * sides[0].min():
            return False
    return bool(_NET_AREA[0] <= net <= _NET_AREA[1])


def find_boundaries(spaces: tuple[Room, ...]) -> list[Boundary]:
    """Every maximal straight piece of line with one room (or none) on each side."""
    ends = np.concatenate([space.rectangles for space in spaces])
    lines = [np.unique(ends[:, [0, 2]]), np.unique(ends[:, [1, 3]])]
    owner = np.pad(owners(spaces, *lines), 1, constant_values=OUTSIDE)
    found = []
    for axis in (0, 1):
        along, across = lines[axis].tolist(), lines[1 - axis].tolist()
        cells = (owner if axis == 1 else owner.T)[:, 1:-1] + 1  # the first axis runs across the lines; 0: outside
        for line, low, high in zip(across, cells, cells[1:], strict=False):
            key = np.where(low != high, low * 16 + high, 0)[None]  # both rooms in one number
            for value, _, start, _, end in rectangles_of(key):
                rooms = value // 16 - 1, value % 16 - 1
                found.append(Boundary(axis, line, along[start], along[end], rooms))
    return found


def cut_doorways(
    doors: Pairs, spaces: tuple[Room, ...], boundaries: list[Boundary], rng: np.random.Generator
) -> list[Doorway] | None:
    """A doorway for every pair of rooms in `doors`; None if one does not fit."""
    doorways: list[Doorway] = []
    for pair in doors:
        between = [b for b in boundaries if set(b.rooms) == set(pair)]
        if not between:
            return None
        for _ in range(60):
            doorway = _doorway(between[rng.integers(len(between))], spaces, rng)
            if doorway is not None and all(_apart(doorway, other) for other in doorways):
                doorways.append(doorway)
                break
        else:
            return None
    return doorways


def _doorway(boundary: Boundary, spaces: tuple[Room, ...], rng: np.random.Generator) -> Doorway | None:
    """One attempt at a doorway in a boundary."""
    entrance = OUTSIDE in boundary.rooms
    width = round(float(rng.uniform(0.92, 1.0) if entrance else rng.uniform(0.8, 0.95)), 2) + 2 * LINING
    corner = HALF_WALL + 0.09
    room = boundary.end - boundary.start - 2 * corner - width
    if room < 0:
        return None
    shift = float(rng.choice([0.0, room, rng.uniform(0.0, room)], p=[0.35, 0.35, 0.3]))
    start = round(boundary.start + corner + shift, 3)
    end = round(start + width, 3)
    hole = boundary, start, end, 0.0, DOOR_HEAD
    if entrance:
        inner = -1 if boundary.rooms[0] != OUTSIDE else 1
        return Doorway(*hole, 0.0, bool(rng.random() < 0.5), inner)
    bare = Doorway(*hole, None, True, 1)
    if rng.random() < 0.2:
        return bare
    ways = [(hinge, side) for hinge in (True, False) for side in (-1, 1)]
    rng.shuffle(ways)
    # A leaf opens into the room rather than into the hall, and leans against a wall.
    for hinge, side in sorted(ways, key=lambda way: spaces[boundary.rooms[max(way[1], 0)]].kind == "hall"):
        angle = _leaning(boundary, spaces[boundary.rooms[max(side, 0)]], start if hinge else end, width, hinge, side)
        if angle is not None:
            turned = round(angle + float(rng.uniform(-3, 1)), 1)
            return Doorway(*hole, turned, bool(hinge), int(side))
    return bare


def _leaning(boundary: Boundary, space: Room, at: float, width: float, hinge: bool, side: int) -> float | None:
    """The angle at which a leaf, hung `at` this end of the hole, leans against a wall of `space`; None if it cannot."""
    away = -1.0 if hinge else 1.0

    def inside(along: float, across: float) -> bool:
        return bool(space.contains(*boundary.point(at + away * along, side * across)))

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


def cut_windows(
    spaces: tuple[Room, ...], boundaries: list[Boundary], doorways: list[Doorway], rng: np.random.Generator
) -> list[Opening]:
    """Windows in the outer walls: wide ones in living rooms, small high ones in bathrooms."""
    windows: list[Opening] = []
    kept = [d.approach(0.3, 0.15) for d in doorways] + [d.leaf_box for d in doorways if d.leaf_box]
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
            sill = float(rng.choice(sills))
            count = 2 if space.kind == "living room" and free >= 2 * width + 0.8 else 1
            if space.kind == "kitchen":
                sill = 1.2  # above the worktop and the things on it
            if boundary is not outer[0] and rng.random() < 0.35:
                continue
            width = round(min(width, free), 2)
            if width < 0.5:
                continue
            part = free / count
            for i in range(count):
                shift = float(rng.uniform(0.2, 0.8)) if count == 1 else 0.5
                start = round(boundary.start + HALF_WALL + 0.35 + i * part + shift * max(part - width, 0.0), 3)
                window = Opening(boundary, start, round(start + width, 3), sill, 2.15)
                if not any(_overlap(window.approach(0.3, 0.1), other) for other in kept):
                    windows.append(window)
    return windows


def span(lines: np.ndarray, low: float, high: float) -> slice:
    """The cells between two of the lines."""
    return slice(*np.searchsorted(lines, [low - 1e-6, high - 1e-6]).tolist())


def owners(spaces: tuple[Room, ...], xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """The room of each cell between lines along y at `xs` and along x at `ys`, `OUTSIDE` where there is none."""
    owner = np.full((len(xs) - 1, len(ys) - 1), OUTSIDE)
    for place, space in enumerate(spaces):
        for x0, y0, x1, y1 in space.rectangles:
            owner[span(xs, x0, x1), span(ys, y0, y1)] = place
    return owner


def rectangles_of(key: np.ndarray) -> list[tuple[int, int, int, int, int]]:
    """Rectangles `(value, a0, b0, a1, b1)` of equal values that cover all of `key` ``(A, B)`` that is not zero."""
    left = key.astype(np.int64)
    found = []
    for a, b in np.argwhere(left).tolist():
        value = int(left[a, b])
        if value == 0:
            continue
        row = left[a, b:] == value
        b1 = b + (len(row) if row.all() else int(row.argmin()))
        rows = (left[a:, b:b1] == value).all(axis=1)
        a1 = a + (len(rows) if rows.all() else int(rows.argmin()))
        left[a:a1, b:b1] = 0
        found.append((value, a, b, a1, b1))
    return found
