"""Floor plans: a layout of one of the families, turned and mirrored, with doors and windows cut.

A layout is drawn on the centre lines of the walls, from (0, 0), and is rejected if a room becomes too small or too
large. An outer wall grows outwards from where an inner one would have its face. Frame: x, y of the world, metres.
"""

from __future__ import annotations

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
DOOR_HEAD, WINDOW_HEAD = 2.08, 2.15
OUTSIDE = -1
SNAP = 20  # walls stand on twentieths of a metre
# Windows: chance of one in the first outer wall and in each other; range of width, heights of sills to choose from (m).
_WINDOWS: dict[str, tuple[float, float, float, float, list[float]]] = {
    "bathroom": (0.6, 0.0, 0.5, 0.7, [1.45]), "hall": (0.3, 0.0, 0.9, 1.5, [0.95]),
    "living room": (1.0, 0.65, 1.2, 2.0, [0.45, 0.95]), "kitchen": (1.0, 0.65, 0.9, 1.5, [1.2]),  # above the worktop
}  # fmt: skip
_OTHER_WINDOWS = (1.0, 0.65, 0.9, 1.5, [0.85, 0.95, 1.1])
_NET_AREA = (45.0, 110.0)
# Of each kind of room, between centre lines: its shortest side, its range of area, and that of its width in a row (m).
_SIZES = {
    "living room": (3.2, (13.0, 42.0), (4.0, 5.6)), "bedroom": (2.6, (8.6, 20.0), (3.0, 4.3)),
    "kitchen": (2.1, (5.6, 17.0), (2.6, 3.8)), "bathroom": (1.7, (3.9, 9.5), (1.75, 2.5)),
    "hall": (1.2, (2.2, 18.0), (1.8, 2.4)), "study": (2.1, (5.5, 15.0), (2.3, 3.2)),
    "dining room": (2.4, (7.0, 17.0), (2.8, 3.6)),
}  # fmt: skip

# --- the families of floor plans --------------------------------------------------------------------------------------

# Rooms, each of a kind and its rectangles; doors and openings as pairs of rooms, first the front door (to `OUTSIDE`).
Rooms = list[tuple[str, list[Rectangle]]]
Pairs = list[tuple[int, int]]
Layout = tuple[Rooms, Pairs, Pairs]
Spaces = tuple[Room, ...]  # by their centre lines
Generator = np.random.Generator


def corridor(rng: Generator) -> Layout:
    """Rooms on both sides of a corridor; often the living room closes its end over the full depth."""
    front, passage, back = rng.uniform(3.2, 4.3), rng.uniform(1.2, 1.5), rng.uniform(2.6, 3.7)
    depth, closed = front + passage + back, rng.random() < 0.55
    near, far = ["bedroom", "bedroom" if rng.random() < 0.6 else "study"], ["kitchen", "bathroom"]
    if not closed:
        near = ["living room", *near[: int(rng.integers(1, 3))]]
    if rng.random() < 0.5:
        far.append("study" if "study" not in near else "bedroom")
    rng.shuffle(near)
    rng.shuffle(far)
    widths, others = _widths(rng, near), _widths(rng, far)
    length = (sum(widths) + sum(others)) / 2
    rooms: Rooms = [("hall", [(0.0, front, length, front + passage)])]
    rooms += _row(near, widths * length / sum(widths), 0.0, front)
    rooms += _row(far, others * length / sum(others), front + passage, depth)
    if closed:
        rooms.append(("living room", [(length, 0.0, length + rng.uniform(3.4, 4.4), depth)]))
    doors, openings = [(0, OUTSIDE), *((0, i) for i in range(1, len(rooms)))], []
    if closed and far[-1] == "kitchen":  # a kitchen next to the living room opens into it
        kitchen, living = len(rooms) - 2, len(rooms) - 1
        (openings if rng.random() < 0.5 else doors).append((kitchen, living))
        doors.remove((0, kitchen))
    return rooms, doors, openings


def open_plan(rng: Generator) -> Layout:
    """Living, kitchen and dining in one L-shaped space; the other rooms stand in its inner corner."""
    private = ["bedroom", "bathroom"]
    if rng.random() < 0.75:
        private.append("bedroom" if rng.random() < 0.6 else "study")
    rng.shuffle(private)
    widths, arm, strip = _widths(rng, private), rng.uniform(2.4, 3.3), rng.uniform(3.3, 4.4)
    length, depth = arm + sum(widths), strip + rng.uniform(2.7, 3.9)
    dining = rng.random() < 0.5
    split = length - rng.uniform(2.4, 3.2) if dining else length
    rooms: Rooms = [("living room", [(0.0, 0.0, split, strip)]), ("kitchen", [(0.0, strip, arm, depth)])]
    doors, openings = [(0, OUTSIDE)], [(0, 1)]
    if dining:
        rooms.append(("dining room", [(split, 0.0, length, strip)]))
        openings.append((0, 2))
    for kind, ((x0, y0, x1, y1),) in _row(private, widths, strip, depth, arm):
        doors.append((2 if dining and (x0 + x1) / 2 > split + 0.6 else 0, len(rooms)))
        rooms.append((kind, [(x0, y0, x1, y1)]))
    return rooms, doors, openings


def central_hall(rng: Generator) -> Layout:
    """Four wings turn like a pinwheel round a hall; the first of them is divided."""
    x1, right, y1, high = rng.uniform(2.6, 3.8, 4).tolist()
    x2, y2 = x1 + rng.uniform(1.8, 3.4), y1 + rng.uniform(1.5, 2.6)
    width, depth = x2 + right, y2 + high
    wings = [(x2, 0.0, width, y2), (x1, y2, width, depth), (0.0, y1, x1, depth)]
    living = max(range(3), key=lambda i: (wings[i][2] - wings[i][0]) * (wings[i][3] - wings[i][1]))
    order = [living, *rng.permutation([i for i in range(3) if i != living]).tolist()]
    rooms: Rooms = [("hall", [(x1, y1, x2, y2)])]
    rooms += [(kind, [wings[i]]) for kind, i in zip(("living room", "kitchen", "bedroom"), order, strict=True)]
    cut, beside = rng.uniform(max(1.7, x1 - 0.9), x2 - 1.7), 1 + order.index(2)  # the room next to the outer part
    # A room reached from the wing beside it lies behind the bathroom, or the bathroom behind the room.
    kinds = rng.permutation(["bathroom", "bedroom" if rng.random() < 0.5 else "study"]).tolist()
    rooms += [(kinds[0], [(cut, 0.0, x2, y1)]), (kinds[1], [(0.0, 0.0, cut, y1)])]
    behind = beside if kinds[0] == "bathroom" or rng.random() < 0.5 else 4
    return rooms, [(1, OUTSIDE), (0, 1), (0, 2), (0, 3), (0, 4), (behind, 5)], []


def railroad(rng: Generator) -> Layout:
    """Rooms in a row, one through another; the bathroom stands beside a short passage."""
    depth, passage = rng.uniform(3.8, 5.0), rng.uniform(1.2, 1.5)
    day, night = ["living room", "kitchen"], ["bedroom"]
    if rng.random() < 0.4:
        day.insert(1, "dining room")
    elif rng.random() < 0.4:
        day.reverse()
    if rng.random() < 0.7:
        night.append("bedroom" if rng.random() < 0.4 else "study")
    kinds, hall = [*day, "hall", *night], len(day)
    rooms = _row(kinds, 0.93 * _widths(rng, kinds), 0.0, depth)
    doors, openings = [], []
    for place in range(1, len(kinds)):
        (openings if place < hall and rng.random() < 0.3 else doors).append((place - 1, place))
    x0, _, x1, _ = rooms[hall][1][0]
    cut = passage if rng.random() < 0.5 else depth - passage
    strips = [(x0, 0.0, x1, cut), (x0, cut, x1, depth)]
    rooms[hall] = ("hall", [strips.pop(0 if cut == passage else 1)])
    doors.append((hall, len(rooms)))
    rooms.append(("bathroom", strips))
    return rooms, [(hall if rng.random() < 0.5 else 0, OUTSIDE), *doors], openings


def studio(rng: Generator) -> Layout:
    """One large space with a kitchen and a sleeping alcove open to it; only the bathroom is closed."""
    x1, entry, bath = rng.uniform(1.9, 2.5), rng.uniform(1.6, 3.2), rng.uniform(2.4, 3.2)
    strip, alcove = rng.uniform(3.4, 4.4), rng.uniform(2.8, 3.4)
    depth, x2 = max(strip + alcove, entry + bath), x1 + rng.uniform(2.1, 2.9)
    width = x2 + rng.uniform(3.0, 3.8)
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


FAMILIES = {draw.__name__.replace("_", " "): draw for draw in (corridor, open_plan, central_hall, railroad, studio)}


def _widths(rng: Generator, kinds: list[str]) -> np.ndarray:
    return np.array([rng.uniform(*_SIZES[kind][2]) for kind in kinds])


def _row(kinds: list[str], widths: np.ndarray, y0: float, y1: float, x0: float = 0.0) -> Rooms:
    """Rooms side by side along x from `x0`."""
    ends = [x0, *(x0 + np.cumsum(widths)).tolist()]
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
    """A window or a doorway: a hole from `start` to `end` along its boundary and from `sill` to `head` in height.

    `leaf`: the opening angle of a door's leaf in degrees, 0 for closed, or None without one. It hangs at the `start` or
    the end of the hole (`hinge`), and opens to the low (-1) or high (1) `side`.
    """

    boundary: Boundary
    start: float
    end: float
    sill: float
    head: float
    leaf: float | None = None
    hinge: bool = True
    side: int = 1

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

    @lazy
    def leaf_box(self) -> Rectangle | None:
        """Bounds of the open leaf on the floor; None without one, or if it is closed."""
        corners = np.array([self.at(along, across) for along in (0.0, self.end - self.start) for across in (0.0, 0.07)])
        return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()) if self.leaf else None

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

    `open_to`: pairs of rooms without a wall between, the smaller index first; `extent`: length along x and y between
    the outer lines, from (0, 0).
    """

    family: str
    spaces: Spaces
    walls: tuple[Boundary, ...]
    open_to: frozenset[tuple[int, int]]
    doorways: tuple[Opening, ...]
    windows: tuple[Opening, ...]
    extent: tuple[float, float]
    height: float


def draw_plan(rng: Generator) -> Plan:
    """A floor plan of one of `FAMILIES`, mirrored and turned at random. Raises `WorldError` if none can be drawn."""
    family = list(FAMILIES)[rng.integers(len(FAMILIES))]
    for _ in range(400):
        rooms, doors, openings = FAMILIES[family](rng)
        spaces = _spaces(rooms, rng)
        if spaces is None:
            continue
        ends = np.concatenate([space.rectangles for space in spaces])
        lines = np.unique(ends[:, ::2]), np.unique(ends[:, 1::2])
        boundaries = find_boundaries(owners(spaces, *lines), *lines)
        doorways = cut_doorways(doors, spaces, boundaries, rng)
        if doorways is None:
            continue
        windows = cut_windows(spaces, boundaries, doorways, rng)
        lit = {room for window in windows for room in window.boundary.rooms}
        if any(s.kind in ("living room", "bedroom") and i not in lit for i, s in enumerate(spaces)):
            continue
        open_to = frozenset((min(pair), max(pair)) for pair in openings)
        walls = tuple(wall for wall in boundaries if tuple(sorted(wall.rooms)) not in open_to)
        extent, height = (float(lines[0][-1]), float(lines[1][-1])), round(float(rng.uniform(2.5, 2.8)), 2)
        return Plan(family, spaces, walls, open_to, tuple(doorways), tuple(windows), extent, height)
    raise WorldError(f"no floor plan of the family {family!r} came out in 400 tries; use another seed")


def _spaces(layout: Rooms, rng: Generator) -> Spaces | None:
    """The numbered rooms of a layout, mirrored and with exchanged axes at random; None if their sizes do not fit."""
    mirrored, exchanged = rng.random(2) < 0.5, rng.random() < 0.5
    snapped = [np.round(np.multiply(rectangles, SNAP)) / SNAP for _, rectangles in layout]
    ends, kinds = np.concatenate(snapped)[:, 2:].max(axis=0), [kind for kind, _ in layout]
    spaces, net = [], 0.0
    for place, (kind, rectangles) in enumerate(zip(kinds, snapped, strict=True)):
        number = f" {kinds[: place + 1].count(kind)}" if kinds.count(kind) > 1 else ""
        corners = rectangles.reshape(-1, 2, 2)
        corners = np.sort(np.where(mirrored, ends - corners, corners), axis=1)
        turned = corners[..., ::-1] if exchanged else corners
        spaces.append(Room(kind + number, kind, np.round(turned.reshape(-1, 4), 4)))
        shortest, (least, most), _ = _SIZES[kind]
        sides = spaces[-1].rectangles[:, 2:] - spaces[-1].rectangles[:, :2]
        net += (sides - 2 * HALF_WALL).prod(axis=1).sum()
        long = kind != "hall" and sides[0].max() > 3.2 * sides[0].min()
        if long or not least <= spaces[-1].area <= most or sides[0].min() < shortest - 1e-6:
            return None
    return tuple(spaces) if _NET_AREA[0] <= net <= _NET_AREA[1] else None


def find_boundaries(owner: np.ndarray, *lines: np.ndarray) -> list[Boundary]:
    """Every maximal straight piece of the grid's lines in x and y with one room on each side.

    `owner` ``(nx, ny)``: the room of each cell, or a negative number down to -2.
    """
    owner = np.pad(owner, 1, constant_values=OUTSIDE)
    found = []
    for axis in (0, 1):
        along, across = lines[axis].tolist(), lines[1 - axis].tolist()
        cells = (owner if axis == 1 else owner.T)[:, 1:-1] + 2  # the first axis runs across the lines
        for line, low, high in zip(across, cells, cells[1:], strict=False):
            key = np.where(low != high, low * 16 + high, 0)[None]  # both rooms in one number
            for value, _, start, _, end in rectangles_of(key):
                found.append(Boundary(axis, line, along[start], along[end], (value // 16 - 2, value % 16 - 2)))
    return found


def cut_doorways(doors: Pairs, spaces: Spaces, boundaries: list[Boundary], rng: Generator) -> list[Opening] | None:
    """A doorway for every pair of rooms in `doors`; None if one does not fit."""
    doorways: list[Opening] = []
    for pair in doors:
        between = [b for b in boundaries if set(b.rooms) == set(pair)]
        tries = (_doorway(between[rng.integers(len(between))], spaces, rng) for _ in range(60 if between else 0))
        fits = (door for door in tries if door is not None and all(_apart(door, other) for other in doorways))
        doorway = next(fits, None)
        if doorway is None:
            return None
        doorways.append(doorway)
    return doorways


def _doorway(boundary: Boundary, spaces: Spaces, rng: Generator) -> Opening | None:
    """One attempt at a doorway in a boundary."""
    entrance, corner = OUTSIDE in boundary.rooms, HALF_WALL + 0.09
    width = round(float(rng.uniform(0.92, 1.0) if entrance else rng.uniform(0.8, 0.95)), 2) + 2 * LINING
    room = boundary.end - boundary.start - 2 * corner - width
    if room < 0:
        return None
    shift = float(rng.choice([0.0, room, rng.uniform(0.0, room)], p=[0.35, 0.35, 0.3]))
    start = round(boundary.start + corner + shift, 3)
    end = round(start + width, 3)
    hole = boundary, start, end, 0.0, DOOR_HEAD
    if entrance:
        return Opening(*hole, 0.0, bool(rng.random() < 0.5), -1 if boundary.rooms[0] != OUTSIDE else 1)
    ways = [(hinge, side) for hinge in (True, False) for side in (-1, 1)] if rng.random() < 0.8 else []
    rng.shuffle(ways)
    # A leaf opens into the room rather than into the hall, and leans against a wall.
    for hinge, side in sorted(ways, key=lambda way: spaces[boundary.rooms[max(way[1], 0)]].kind == "hall"):
        angle = _leaning(boundary, spaces[boundary.rooms[max(side, 0)]], start if hinge else end, width, hinge, side)
        if angle is not None:
            return Opening(*hole, round(angle + float(rng.uniform(-3, 1)), 1), bool(hinge), int(side))
    return Opening(*hole)


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


def _apart(a: Opening, b: Opening) -> bool:
    """Whether two doorways, the floor before them and their leaves keep clear of each other."""
    pairs = [(a.approach(0.1, 0.2), b.approach(0.1, 0.2)), (a.leaf_box, b.leaf_box)]
    pairs += [(one.leaf_box, other.approach(0.75, 0.02)) for one, other in ((a, b), (b, a))]
    return not any(_overlap(one, other) for one, other in pairs if one and other)


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def cut_windows(spaces: Spaces, boundaries: list[Boundary], doorways: list[Opening], rng: Generator) -> list[Opening]:
    """Windows in the outer walls: wide ones in living rooms, small high ones in bathrooms."""
    windows: list[Opening] = []
    kept = [d.approach(0.3, 0.15) for d in doorways] + [d.leaf_box for d in doorways if d.leaf_box]
    for place, space in enumerate(spaces):
        outer = [b for b in boundaries if set(b.rooms) == {place, OUTSIDE}]
        if space.kind == "living room" and len(outer) > 1:  # one long wall without windows, for the television
            outer.remove(max(outer, key=lambda b: min(b.end - b.start, 2.5) + rng.random()))
        first, others, narrow, wide, sills = _WINDOWS.get(space.kind, _OTHER_WINDOWS)
        for boundary in outer:
            free = boundary.end - boundary.start - 2 * HALF_WALL - 0.7
            width, sill = round(min(float(rng.uniform(narrow, wide)), free), 2), float(rng.choice(sills))
            if width < 0.5 or rng.random() >= (first if boundary is outer[0] else others):
                continue
            count = 2 if space.kind == "living room" and free >= 2 * width + 0.8 else 1
            for i in range(count):
                shift = i * free / count + rng.uniform(0.3, 0.7) * (free / count - width)
                start = round(boundary.start + HALF_WALL + 0.35 + float(shift), 3)
                window = Opening(boundary, start, round(start + width, 3), sill, WINDOW_HEAD)
                if not any(_overlap(window.approach(0.3, 0.1), other) for other in kept):
                    windows.append(window)
    return windows


def owners(spaces: Spaces, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """The room of each cell between lines along y at `xs` and along x at `ys`, `OUTSIDE` where there is none."""
    middles = np.meshgrid((xs[1:] + xs[:-1]) / 2, (ys[1:] + ys[:-1]) / 2, indexing="ij")
    owner = np.full(middles[0].shape, OUTSIDE)
    for place, space in enumerate(spaces):
        owner[space.contains(*middles)] = place
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
