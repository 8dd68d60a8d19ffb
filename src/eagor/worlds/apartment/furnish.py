"""The choice of furniture for each room; the last items are rugs, paintings, small things on tables, ceiling lamps."""

from __future__ import annotations

import math

import numpy as np

from eagor.worlds.apartment.furniture import KINDS
from eagor.worlds.apartment.groups import (
    dining,
    easy_seat,
    fit_bathroom,
    fit_kitchen,
    lounge,
    second_sofa,
    sleeping,
    workplace,
)
from eagor.worlds.apartment.placement import (
    Floor,
    Furnisher,
    NoRoom,
    Piece,
    Sites,
    advanced,
    along_walls,
    before,
    footprint,
    from_rectangle,
    in_room,
    joined,
    on_face,
    relative,
    tell_apart,
    untouched,
)

REQUIRED = ("chair", "bed", "plant", "toilet", "tv", "sofa", "table", "sink")

# Further furniture per kind of room: category, probability, square metres of the room for each further piece, and free
# floor before it in metres.
_MORE: dict[str, tuple[tuple[str, float, float, float], ...]] = {
    "living room": (
        ("bookshelf", 0.8, 20, 0.6), ("dresser", 0.45, 30, 0.5), ("plant", 1.0, 11, 0.0), ("lamp", 0.8, 16, 0.0),
        ("desk", 0.15, 60, 0.0),
    ),
    "bedroom": (
        ("wardrobe", 0.95, 30, 0.6), ("dresser", 0.55, 30, 0.5), ("desk", 0.35, 60, 0.0), ("plant", 0.7, 12, 0.0),
        ("armchair", 0.25, 40, 0.2), ("lamp", 0.4, 30, 0.0), ("chair", 0.3, 40, 0.2), ("bookshelf", 0.25, 40, 0.5),
    ),
    "study": (
        ("desk", 1.0, 60, 0.0), ("bookshelf", 0.95, 7, 0.5), ("armchair", 0.5, 40, 0.2), ("plant", 0.8, 9, 0.0),
        ("lamp", 0.5, 30, 0.0), ("dresser", 0.2, 30, 0.5),
    ),
    "dining room": (("dresser", 0.7, 30, 0.5), ("plant", 0.9, 9, 0.0), ("bookshelf", 0.2, 40, 0.5)),
    "kitchen": (("plant", 0.5, 12, 0.0), ("chair", 0.1, 40, 0.2)),
    "bathroom": (("plant", 0.35, 12, 0.0), ("dresser", 0.1, 30, 0.5)),
    "hall": (("dresser", 0.5, 30, 0.5), ("plant", 0.6, 6, 0.0), ("chair", 0.3, 30, 0.2), ("lamp", 0.15, 30, 0.0)),
}  # fmt: skip
_PAINTINGS = {
    "living room": (1, 3), "bedroom": (1, 2), "study": (0, 2), "dining room": (1, 2), "kitchen": (0, 1),
    "hall": (0, 2), "bathroom": (0, 0),
}  # fmt: skip
_RUGS = {"living room": 0.85, "bedroom": 0.7, "study": 0.5, "dining room": 0.5, "hall": 0.4, "bathroom": 0.0}
_TOPS = {"table": 0.6, "coffee table": 0.6, "desk": 0.6, "dresser": 0.8, "nightstand": 0.5}  # chance of an item on it
_EYE_LEVEL = 1.52


def furnish(floor: Floor, rng: np.random.Generator) -> list[Piece]:
    """Furniture for all rooms. Raises `NoRoom` if a required piece does not fit."""
    f = Furnisher(floor, rng)
    f.habits["chair"] = str(rng.choice(KINDS["chair"].colours))
    kinds = [space.kind for space in floor.plan.spaces]
    for kind, rule in (
        ("living room", lounge), ("kitchen", fit_kitchen), ("bathroom", fit_bathroom),
        ("bedroom", sleeping),
    ):  # fmt: skip
        for room in _of(kinds, kind):
            if not any(rule(f, room) for _ in range(4)):
                raise NoRoom(f"the {kind} is too small for what belongs there")
    _meals(f, kinds)
    for room in _of(kinds, "kitchen"):  # one more small table, if there is space
        if floor.rooms[room].area > 9.5 and not f.of("table", room) and rng.random() < 0.7:
            dining(f, room, 2, 3)
    for room in _of(kinds, "bedroom"):
        if floor.rooms[room].area > 11 and f.of("bed", room)[0].box[3] < 0.65 and rng.random() < 0.5:
            sleeping(f, room)
    for room in _of(kinds, "living room"):
        if floor.rooms[room].area > 17 and rng.random() < 0.5:
            second_sofa(f, room)
        for _ in range(int(rng.integers(0, 3))):
            easy_seat(f, room)
    for room in rng.permutation(len(kinds)):
        _further(f, int(room), kinds[room])
    _at_least(f, "plant", 2)
    _at_least(f, "chair", int(rng.integers(4, 7)))
    missing = [category for category in REQUIRED if not f.of(category)]
    if missing:
        raise NoRoom(f"no place for {', '.join(missing)}")
    for room, kind in enumerate(kinds):
        ceiling_lamps(f, room)
        if rng.random() < _RUGS.get(kind, 0.0):
            rug(f, room)
        for _ in range(int(rng.integers(_PAINTINGS[kind][0], _PAINTINGS[kind][1] + 1))):
            painting(f, room)
    small_things(f, tuple(sorted(name for name, kind in KINDS.items() if kind.placement == "top")))
    tell_apart(f)
    return f.pieces


def _of(kinds: list[str], kind: str) -> list[int]:
    return [place for place, other in enumerate(kinds) if other == kind]


def _meals(f: Furnisher, kinds: list[str]) -> None:
    """The dining table: in the dining room, else in the kitchen or the living room, wherever it fits."""
    rooms = _of(kinds, "dining room")
    kitchen, living = _of(kinds, "kitchen"), _of(kinds, "living room")
    spacious = f.floor.rooms[kitchen[0]].area > 10 and f.rng.random() < 0.8
    rooms += kitchen + living if spacious else living + kitchen
    for least, most in ((4, 6), (2, 4)):
        for room in rooms:
            if dining(f, room, least, most):
                return
    raise NoRoom("no place for a table with chairs")


def _further(f: Furnisher, room: int, kind: str) -> None:
    """The pieces of `_MORE`."""
    area = f.floor.rooms[room].area
    for category, chance, each, front in _MORE[kind]:
        for _ in range(max(1, int(area / each))):
            if f.rng.random() < chance:
                _one_more(f, room, category, front)


def _one_more(f: Furnisher, room: int, category: str, front: float) -> bool:
    if category == "desk":
        return workplace(f, room)
    if category == "armchair":
        return easy_seat(f, room) is not None
    made = f.make(category, f.habits["chair"] if category == "chair" else None)
    corner = {"plant": 0.8, "lamp": 0.8, "wardrobe": 0.5, "bookshelf": 0.3}.get(category, 0.0)
    gap = 0.06 if category in ("plant", "lamp") else 0.02
    sites = along_walls(f.floor, room, made.size, f.rng, corner=corner, middle=0.2, gap=gap, side=gap)
    return f.settle(made, room, sites, front=front) is not None


def _at_least(f: Furnisher, category: str, count: int) -> None:
    """Add pieces of a category to its usual rooms until there are `count`, as far as they fit."""
    rooms = [i for i, space in enumerate(f.floor.plan.spaces) if space.kind in KINDS[category].rooms]
    for _ in range(3):
        for room in f.rng.permutation(rooms).tolist():
            if len(f.of(category)) >= count:
                return
            _one_more(f, room, category, 0.2 if category == "chair" else 0.0)


def rug(f: Furnisher, room: int) -> Piece | None:
    """A rug: under the coffee table or the dining table, beside the bed, or where the floor is free."""
    made = f.make("rug")
    size = made.size
    sites = in_room(f.floor, room, size, f.rng, 30)
    sites = Sites(sites.boxes, np.where(f.floor.clear(sites.boxes), sites.scores, -np.inf))
    for category, bonus in (("coffee table", 3.0), ("table", 2.0)):
        for table in f.of(category, room):
            boxes = np.array([relative(table.box, 0, 0, size, turn) for turn in (0.0, math.pi / 2)])
            sites = joined(sites, Sites(boxes, np.array([bonus + 0.1, bonus])))
    for bed in f.of("bed", room):
        boxes = [relative(before(bed.box, 1.0)[0], 0, 0, size)]
        for side in (-1, 1):
            out = side * float(bed.box[3] + size[0] / 2 - 0.1)
            boxes.append(relative(bed.box, 0.2, out, size, math.pi / 2))
        sites = joined(sites, Sites(np.array(boxes), np.full(3, 1.0)))
    doors = [from_rectangle(d.leaf_box) for d in f.floor.plan.doorways if d.leaf_box is not None]
    others = [piece.box for piece in f.of("rug")]
    good = np.isfinite(sites.scores) & f.floor.inside(room, sites.boxes) & untouched(sites.boxes, doors + others)
    for place in sites.best(good, 1):
        return f.record(made, room, sites.boxes[place], 0.0, solid=False)
    return None


def painting(f: Furnisher, room: int) -> Piece | None:
    """A picture on a free patch of wall, best over a sofa, a bed or a low piece."""
    made = f.make("painting")
    depth, width, height = (float(length) for length in made.size)
    z = min(_EYE_LEVEL + 0.08, f.floor.plan.height - height / 2 - 0.25)
    low = [p for p in f.pieces if p.room == room and p.category in ("sofa", "bed", "dresser", "desk")]
    found = []
    for face in f.floor.faces:
        free = face.end - face.start - width - 0.3
        if face.room != room or free < 0:
            continue
        along = face.start + 0.15 + width / 2 + free * np.concatenate([[0.5], f.rng.random(6)])
        over = [  # above the middle of a low piece is best
            piece.box[face.axis] for piece in low
            if face.start + width / 2 < piece.box[face.axis] < face.end - width / 2
            and abs(piece.box[1 - face.axis] - face.line) < piece.box[2] + 0.15
        ]  # fmt: skip
        scores = f.rng.uniform(0, 1, len(along) + len(over)) + np.repeat([0.0, 1.0], [len(along), len(over)])
        found.append(Sites(on_face(face, np.append(along, over), 0.0, made.size), scores))
    sites = joined(*found)
    wide = advanced(sites.boxes, 0.18 - depth / 2)  # free air around and before it
    wide[:, 2], wide[:, 3] = 0.18, wide[:, 3] + 0.1
    good = f.floor.fits(room, wide, (z - height / 2 - 0.04, z + height / 2 + 0.04), 0.0, kept=False)
    good &= f.floor.beside_windows(wide, z + height / 2)
    good &= untouched(wide, [from_rectangle(d.approach(0.4, 0.1)) for d in f.floor.plan.doorways])
    for place in sites.best(good, 1):
        box = sites.boxes[place]
        f.floor.solid.append(np.concatenate([box, (z - height / 2, z + height / 2)]))
        back = box[:2] - depth / 2 * np.array([math.cos(box[4]), math.sin(box[4])])
        f.pieces.append(Piece(room, made, box, np.array([*back, z]), solid=False))
        return f.pieces[-1]
    return None


def small_things(f: Furnisher, categories: tuple[str, ...]) -> None:
    """Vases, books and the like on tables and chests."""
    for piece in list(f.pieces):
        if f.rng.random() >= _TOPS.get(piece.category, 0.0):
            continue
        taken: list[np.ndarray] = []
        for _ in range(int(f.rng.integers(1, 3))):
            made = f.make(str(f.rng.choice(categories)))
            room = piece.box[2:4] - np.hypot(made.size[0], made.size[1]) / 2 - 0.05
            if piece.category in ("table", "coffee table"):
                room = room * 0.6  # tops may be round
            if (room < 0).any():
                continue
            forward, left = f.rng.uniform(-room, room)
            box = relative(piece.box, forward, left, made.size, float(f.rng.uniform(-0.6, 0.6)))
            if untouched(box[None], taken)[0]:
                taken.append(box)
                f.record(made, piece.room, box, piece.top, solid=False)


def ceiling_lamps(f: Furnisher, room: int) -> None:
    """One lamp in the middle of each part of a room, two in a large or long one; `NoRoom` if none fits."""
    made = f.make("ceiling lamp")
    depth, width, height = (float(length) for length in made.size)
    ceiling = f.floor.plan.height
    for part, (x0, y0, x1, y1) in enumerate(f.floor.rooms[room].rectangles):
        sides = np.array([x1 - x0, y1 - y0])
        if part > 0 and sides.prod() < 2.0:
            continue
        count = 2 if sides.prod() > 18 or sides.max() > max(4.5, 2.2 * sides.min()) else 1
        for i in range(count):
            middle = np.array([x0 + x1, y0 + y1]) / 2
            middle[sides.argmax()] += ((i + 0.5) / count - 0.5) * sides.max()
            shifts = np.concatenate([[[0.0, 0.0]], f.rng.normal(0, 0.25, (30, 2)), f.rng.normal(0, 0.6, (60, 2))])
            boxes = np.array([footprint(x, y, depth, width, 0.0) for x, y in (middle + shifts).tolist()])
            good = f.floor.fits(room, boxes, (ceiling - height, ceiling), 0.05, kept=False)
            if good.any():
                box = boxes[int(good.argmax())]
                f.floor.solid.append(np.concatenate([box, (ceiling - height, ceiling)]))
                f.record(made, room, box, ceiling, solid=False)
    if not f.of("ceiling lamp", room):
        raise NoRoom(f"no place for a lamp in the {f.floor.rooms[room].name}")
