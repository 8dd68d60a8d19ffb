"""The families of floor plans: the arrangement of the rooms, and the connections between them.

A layout is drawn on the centre lines of the walls, in metres, in the rectangle from (0, 0).
`eagor.lab.worlds.apartment. plans` mirrors and turns it, cuts doors and windows, and rejects layouts with rooms that
are too small or too large.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Rectangle = tuple[float, float, float, float]  # x0, y0, x1, y1
Rooms = list[tuple[str, tuple[Rectangle, ...]]]  # kinds, and what they consist of


@dataclass(frozen=True)
class Layout:
    """Rooms as `(kind, rectangles)`; `doors`, `openings` as pairs of room indices; `entrance`: the front door's."""

    rooms: tuple[tuple[str, tuple[Rectangle, ...]], ...]
    doors: tuple[tuple[int, int], ...]
    openings: tuple[tuple[int, int], ...]
    entrance: int


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
    rooms: Rooms = [("hall", ((0.0, front, length, front + passage),))]
    for kinds, sizes, y0, y1 in ((near, widths, 0.0, front), (far, others, front + passage, depth)):
        rooms += _row(kinds, [width * length / sum(sizes) for width in sizes], y0, y1)
    if end:
        rooms.append(("living room", ((length, 0.0, length + end, depth),)))
    doors = [(0, i) for i in range(1, len(rooms))]
    openings = []
    for i, (kind, _) in enumerate(rooms):  # a kitchen next to the living room opens into it
        if kind == "kitchen" and end and i == len(rooms) - 2:
            (openings if rng.random() < 0.5 else doors).append((i, len(rooms) - 1))
            doors.remove((0, i))
    return Layout(tuple(rooms), tuple(doors), tuple(openings), 0)


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
    living: tuple[Rectangle, ...] = ((0.0, 0.0, split, strip),)
    if kitchen > strip + 0.3:
        living += ((0.0, strip, arm, kitchen),)
    else:
        kitchen = strip
    rooms: Rooms = [("living room", living), ("kitchen", ((0.0, kitchen, arm, depth),))]
    openings, doors = [(0, 1)], []
    if dining:
        rooms.append(("dining room", ((split, 0.0, length, strip),)))
        openings.append((0, 2))
    for kind, ((x0, y0, x1, y1),) in _row(private, widths, strip, depth):
        host = 2 if dining and arm + (x0 + x1) / 2 > split + 0.6 else 0
        doors.append((host, len(rooms)))
        rooms.append((kind, ((_snap(x0 + arm), y0, _snap(x1 + arm), y1),)))
    return Layout(tuple(rooms), tuple(doors), tuple(openings), 0)


def central_hall(rng: np.random.Generator) -> Layout:
    """Four wings turn like a pinwheel round a hall; one or two of them are divided."""
    left, right, low, high = (_draw(rng, 2.6, 3.8) for _ in range(4))
    across, along = _draw(rng, 1.8, 3.4), _draw(rng, 1.5, 2.6)
    x1, y1 = left, low
    x2, y2 = _snap(x1 + across), _snap(y1 + along)
    width, depth = _snap(x2 + right), _snap(y2 + high)
    wings: list[Rectangle] = [(0.0, 0.0, x2, y1), (x2, 0.0, width, y2), (x1, y2, width, depth), (0.0, y1, x1, depth)]
    living = max(range(4), key=lambda i: (wings[i][2] - wings[i][0]) * (wings[i][3] - wings[i][1]))
    rest = [i for i in range(4) if i != living]
    rng.shuffle(rest)
    divided, kitchen, bedroom = rest
    rooms: Rooms = [("hall", ((x1, y1, x2, y2),)), ("living room", (wings[living],))]
    rooms += [("kitchen", (wings[kitchen],)), ("bedroom", (wings[bedroom],))]
    doors, behind = [(0, 1), (0, 2), (0, 3)], {living: 1, kitchen: 2, bedroom: 3}
    inner, outer = _divided(rng, divided, wings[divided], (x1, y1, x2, y2))
    second = "bedroom" if rng.random() < 0.5 else "study"
    if rng.random() < 0.5:  # the bathroom at the hall, the other room reached from the next wing ...
        rooms += [("bathroom", (inner,)), (second, (outer,))]
        doors += [(0, 4), (behind.get((divided - 1) % 4, 0), 5)]
    else:  # ... or a room at the hall, and a bathroom off that room
        rooms += [(second, (inner,)), ("bathroom", (outer,))]
        doors += [(0, 4), (4 if rng.random() < 0.5 else behind[(divided - 1) % 4], 5)]
    return Layout(tuple(rooms), tuple(doors), (), 1)


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
    rooms: Rooms = []
    doors, openings, x, hall = [], [], 0.0, 0
    for kind in [*day, "hall", *night]:
        (wide,) = [slot] if kind == "hall" else _widths(rng, [kind])
        if kind not in ("hall", "living room"):
            wide = _snap(wide * 0.9)
        rectangle: Rectangle = (x, 0.0, _snap(x + wide), depth)
        if kind == "hall":
            hall = len(rooms)
            rectangle = (x, 0.0, _snap(x + wide), passage) if at_low else (x, depth - passage, _snap(x + wide), depth)
        if rooms:
            pair = (len(rooms) - 1, len(rooms))
            together = {rooms[-1][0], kind} <= {"living room", "dining room", "kitchen"}
            (openings if together and rng.random() < 0.3 else doors).append(pair)
        rooms.append((kind, (rectangle,)))
        x = _snap(x + wide)
    x0, _, x1, _ = rooms[hall][1][0]
    rooms.append(("bathroom", ((x0, passage, x1, depth) if at_low else (x0, 0.0, x1, _snap(depth - passage)),)))
    doors.append((hall, len(rooms) - 1))
    return Layout(tuple(rooms), tuple(doors), tuple(openings), hall if rng.random() < 0.5 else 0)


def studio(rng: np.random.Generator) -> Layout:
    """One large space with a kitchen and a sleeping alcove open to it; only the bathroom is closed."""
    column, entry, bath = _draw(rng, 1.9, 2.5), _draw(rng, 1.6, 3.2), _draw(rng, 2.4, 3.2)
    strip, alcove = _draw(rng, 3.4, 4.4), _draw(rng, 2.8, 3.4)
    depth = _snap(max(strip + alcove, entry + bath))
    kitchen, bed = _draw(rng, 2.1, 2.9), _draw(rng, 3.0, 3.8)
    x1, x2 = column, _snap(column + kitchen)
    width = _snap(x2 + bed)
    rooms: Rooms = [
        ("living room", ((x1, 0.0, width, strip),)),
        ("bedroom", ((x2, strip, width, depth),)),
        ("kitchen", ((x1, strip, x2, depth),)),
        ("bathroom", ((0.0, entry, x1, depth),)),
        ("hall", ((0.0, 0.0, x1, entry),)),
    ]
    doors, openings = [(3, 4)], [(0, 1), (0, 2)]
    (openings if rng.random() < 0.4 else doors).append((0, 4))
    return Layout(tuple(rooms), tuple(doors), tuple(openings), 4)


FAMILIES: dict[str, Callable[[np.random.Generator], Layout]] = {
    "corridor": corridor, "open plan": open_plan, "central hall": central_hall, "railroad": railroad, "studio": studio,
}  # fmt: skip
_WIDTHS = {
    "living room": (4.0, 5.6), "bedroom": (3.0, 4.3), "kitchen": (2.6, 3.8), "bathroom": (1.75, 2.5),
    "study": (2.3, 3.2), "dining room": (2.8, 3.6),
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
    return [(kind, ((ends[i], y0, ends[i + 1], y1),)) for i, kind in enumerate(kinds)]


def _divided(rng: np.random.Generator, wing: int, rectangle: Rectangle, hall: Rectangle) -> tuple[Rectangle, Rectangle]:
    """A wing of the pinwheel cut in two: the part at the hall, and the part at the corner of the building."""
    axis = wing % 2  # the axis along which it is cut
    low, high, start, end = rectangle[axis], rectangle[axis + 2], hall[axis], hall[axis + 2]
    first, last = list(rectangle), list(rectangle)
    if wing < 2:
        cut = _draw(rng, max(low + 1.7, start - 0.9), end - (1.2 if axis else 1.7))
    else:
        cut = _draw(rng, start + (1.2 if axis else 1.7), min(high - 1.7, end + 0.9))
    first[axis + 2] = last[axis] = cut
    parts: list[Rectangle] = [(a, b, c, d) for a, b, c, d in (first, last)]
    return (parts[1], parts[0]) if wing < 2 else (parts[0], parts[1])
