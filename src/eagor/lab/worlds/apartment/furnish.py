"""The choice of furniture for each room, and the groups that belong together.

Groups are sofa and television, table and chairs, bed and nightstands, desk and chair; fixtures, which are kitchen units
and bathrooms: pieces side by side at walls. The last items are rugs, paintings, small things on tables, ceiling lamps.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from eagor.lab.worlds.apartment.furniture import KINDS, Model
from eagor.lab.worlds.apartment.placement import (
    GAP,
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
    reversed_,
    tell_apart,
    untouched,
)
from eagor.lab.worlds.apartment.plans import WallFace

_ROWS = (
    "refrigerator cabinet sink cabinet stove", "refrigerator cabinet sink stove", "cabinet sink cabinet stove",
    "cabinet sink stove", "sink stove", "sink",
)  # fmt: skip


def lounge(f: Furnisher, room: int) -> bool:
    """A television at a wall, a sofa that faces it, and mostly a coffee table between."""
    television, sofa, low_table = f.make("tv"), f.make("sofa"), f.make("coffee table")
    sites, screen, gap = _facing_pairs(f, room, television.size, sofa.size)
    if not len(gap):
        return False
    seat = sites.boxes
    between = before(seat, 0.5)
    between[:, :2] = (screen[:, :2] + seat[:, :2]) / 2
    between[:, 2], between[:, 3] = gap / 2 - 0.01, 0.55
    good = f.fits(room, screen, television) & f.fits(room, seat, sofa) & f.open_before(room, between)
    # A sofa stands at a wall, or far enough from it to walk behind.
    behind = reversed_(seat)
    good &= ~f.floor.open_inside(room, before(behind, 0.12)) | f.floor.open_inside(room, before(behind, 0.65))
    deep = float(low_table.size[0])
    for place in sites.best(good, 12):
        group = [(television, screen[place]), (sofa, seat[place])]
        reach = float(f.rng.uniform(0.36, 0.44))
        if gap[place] > reach + deep + 0.5:
            forward = float(sofa.size[0] + deep) / 2 + reach
            group.append((low_table, relative(seat[place], forward, 0.0, low_table.size)))
        if f.set_down(group, room):
            f.floor.kept.append(between[place])
            return True
    return False


def easy_seat(f: Furnisher, room: int) -> bool:
    """An armchair beside the coffee table, turned to it, or one at a wall."""
    chair = f.make("armchair")
    sites = along_walls(f.floor, room, chair.size, f.rng, corner=0.4, side=0.1, gap=0.08)
    for low_table in f.of("coffee table", room):
        turns = f.rng.uniform(0.9, 2.2, 20) * f.rng.choice([-1, 1], 20)
        away = f.rng.uniform(0.25, 0.6, 20) + chair.size[0] / 2 + low_table.box[2:4].max()
        boxes = advanced(np.array([relative(low_table.box, 0, 0, chair.size, turn) for turn in turns]), away)
        boxes = reversed_(boxes)
        sites = joined(sites, Sites(boxes, 1.0 + f.rng.uniform(0, 0.5, 20)))
    return f.settle(chair, room, sites, front=0.2, reserve=False) is not None


def dining(f: Furnisher, room: int, least: int, most: int) -> bool:
    """A table with `least` to `most` equal chairs round it that face it."""
    table, chair = f.make("table"), f.make("chair", f.habits["chair"])
    flat = along_walls(f.floor, room, table.size, f.rng, middle=0.3, gap=0.06)
    sites = joined(in_room(f.floor, room, table.size, f.rng), Sites(flat.boxes, flat.scores - 1.6))
    good = f.floor.fits(room, sites.boxes, (0.0, table.height))
    wanted = int(f.rng.integers(least, most + 1))
    for place in sites.best(good, 14):
        seats = _round_table(f, sites.boxes[place], chair.size, wanted)
        seats = seats[f.floor.fits(room, seats, (0.0, chair.height))][:wanted]
        group = [(table, sites.boxes[place]), *((chair, seat) for seat in seats)]
        if len(seats) >= least and f.set_down(group, room):
            return True
    return False


def workplace(f: Furnisher, room: int) -> bool:
    """A desk at a wall or window with a chair that faces it."""
    desk, chair = f.make("desk"), f.make("chair", f.habits["chair"])
    sites = along_walls(f.floor, room, desk.size, f.rng, corner=0.3, gap=0.05)
    good = f.fits(room, sites.boxes, desk) & f.open_before(room, before(sites.boxes, float(chair.size[0]) + 0.35))
    forward = float(desk.size[0] + chair.size[0]) / 2 + 0.04
    for box in sites.boxes[sites.best(good, 8)]:
        seat = relative(box, forward, 0.0, chair.size, math.pi + float(f.rng.uniform(-0.1, 0.1)))
        fits = f.floor.fits(room, seat[None], (0.0, chair.height))[0]
        if fits and f.set_down([(desk, box), (chair, seat)], room):
            return True
    return False


def sleeping(f: Furnisher, room: int) -> bool:
    """A bed with its head to a wall, and nightstands beside it if they fit."""
    for _ in range(3):  # beds vary a lot in width
        made = f.make("bed")
        double = made.size[1] > 1.3
        corner, middle = (0.0, 0.4) if double else (0.5, 0.0)
        sites = along_walls(f.floor, room, made.size, f.rng, corner=corner, middle=middle, side=0.06)
        wide = sites.boxes.copy()
        wide[:, 3] += 0.45
        sites = Sites(sites.boxes, sites.scores + 0.6 * f.floor.open_inside(room, wide) * double)
        bed = f.settle(made, room, sites, front=0.35, reserve=False)
        if bed:
            break
    else:
        return False
    stand = f.make("nightstand")
    depth, width, _ = stand.size
    for side in (1, -1) if f.rng.random() < 0.8 else (1,):
        left = side * (float(bed.box[3]) + width / 2 + 0.04)
        box = relative(bed.box, float(depth) / 2 - float(bed.box[2]), left, stand.size)
        f.settle(stand, room, Sites(box[None], np.zeros(1)), front=0.3, reserve=False)
    return True


def _round_table(f: Furnisher, table: np.ndarray, chair: np.ndarray, wanted: int) -> np.ndarray:
    """Places ``(n, 5)`` for chairs of one size round a table, the most natural first."""
    depth, width = float(chair[0]), float(chair[1])
    hx, hy = float(table[2]), float(table[3])
    count = 1 if abs(hx - hy) < 0.1 else max(1, int(2 * hy / (width + 0.12)))
    sides = [(sign, (i + 0.5) * 2 * hy / count - hy, True) for i in range(count) for sign in (1, -1)]
    places = []
    for sign, left, long_side in [*sides, (1, 0.0, False), (-1, 0.0, False)]:
        out, turn = float(f.rng.uniform(0.05, 0.12)) + depth / 2, float(f.rng.uniform(-0.07, 0.07))
        if long_side:
            places.append(relative(table, sign * (hx + out), left, chair, (math.pi if sign > 0 else 0.0) + turn))
        else:
            places.append(relative(table, 0.0, sign * (hy + out), chair, turn - sign * math.pi / 2))
    return np.array(places)


def _facing_pairs(f: Furnisher, room: int, tv: np.ndarray, sofa: np.ndarray) -> tuple[Sites, np.ndarray, np.ndarray]:
    """Candidates: the sofa's places, the television's ``(n, 5)``, and the metres between them ``(n,)``."""
    depth, tv_depth, tv_width = float(sofa[0]), float(tv[0]), float(tv[1])
    screens, seats, gaps = [np.zeros((0, 5))], [joined()], [np.zeros(0)]
    for face in f.floor.faces:
        free = face.end - face.start - tv_width - 0.12
        if face.room != room or free < 0:
            continue
        along = face.start + tv_width / 2 + 0.06 + free * np.concatenate([[0.5], f.rng.random(11)])
        options = [(float(f.rng.uniform(1.9, 2.9)), 0.2) for _ in range(3)]
        for other in f.floor.faces:
            if _opposite(face, other) and other.end - other.start > float(sofa[1]):
                apart = abs(other.line - face.line) - tv_depth - depth - 2 * GAP - 0.02
                if 1.6 <= apart <= 4.0:
                    options.append((apart, 1.2 - 0.15 * abs(apart - 2.6)))
        for distance, score in options:
            screen = on_face(face, along, GAP, tv)
            seat = reversed_(advanced(screen, tv_depth / 2 + distance + depth / 2))
            seat[:, 2:4] = sofa[:2] / 2
            screens.append(screen)
            seats.append(Sites(seat, score + f.rng.uniform(0, 0.5, len(along)) + 0.3 * (np.arange(len(along)) == 0)))
            gaps.append(np.full(len(along), distance))
    return joined(*seats), np.concatenate(screens), np.concatenate(gaps)


def _opposite(face: WallFace, other: WallFace) -> bool:
    """Whether two walls of a room face each other."""
    facing = face.room == other.room and face.axis == other.axis and face.side == -other.side
    apart, shared = (other.line - face.line) * face.side, min(face.end, other.end) - max(face.start, other.start)
    return facing and apart > 0 and shared > 0


def fit_kitchen(f: Furnisher, room: int) -> bool:
    """A row of units along one wall, as many as fit; the others stand elsewhere if there is room."""
    start, first = f.mark(), f.make("cabinet")
    units = {"sink": f.make("sink", "grey"), "stove": f.make("stove"), "refrigerator": f.make("refrigerator")}
    cabinets = [first, *(f.make("cabinet", first.colour) for _ in range(2))]
    for row in map(str.split, _ROWS):
        for cabinet in sorted(cabinets, key=lambda made: -made.size[1])[0 if "cabinet" in row else 2 :]:
            every = units | {"cabinet": cabinet}
            if _row(f, room, [every[name] for name in row]):
                if all([_at_wall(f, room, made, 0.6) for name, made in every.items() if name not in row]):
                    return True
                f.back_to(start)
    return False


def fit_bathroom(f: Furnisher, room: int) -> bool:
    """Toilet, sink and, where it fits, a bathtub."""
    start = f.mark()
    fixtures = [f.make("toilet"), f.make("sink", "white")]
    for bathtub in (True, True, True, False, False):
        bathtub = bathtub and _at_wall(f, room, f.make("bathtub"), 0.45, side=GAP)
        if all(_at_wall(f, room, made, 0.5, side=0.15) for made in fixtures):
            return True
        f.back_to(start)
    return False


def _at_wall(f: Furnisher, room: int, made: Model, front: float, side: float = 0.03) -> bool:
    sites = along_walls(f.floor, room, made.size, f.rng, corner=0.6, side=side)
    return f.settle(made, room, sites, front=front) is not None


def _row(f: Furnisher, room: int, units: list[Model]) -> bool:
    """Place units side by side, flush with each other, at the longest wall that is long enough."""
    widths = np.array([float(model.size[1]) for model in units]) + 0.004
    starts = np.cumsum([0.0, *widths])
    faces = [face for face in f.floor.faces if face.room == room]
    for face in sorted(faces, key=lambda face: face.start - face.end):
        free = face.end - face.start - 2 * GAP - starts[-1]
        if free < 0:
            continue
        for turned in f.rng.permutation(2):
            for offset in (0.0, free, float(f.rng.uniform(0, free))):
                middle = face.start + GAP + offset + starts[:-1] + widths / 2
                if turned:  # the row in reverse order
                    middle = face.start + face.end - middle
                boxes = [on_face(face, middle[[i]], GAP, model.size) for i, model in enumerate(units)]
                zone = before(np.concatenate(boxes), 0.7)
                if not all(map(partial(_unit_fits, f, room), units, boxes)) or not f.open_before(room, zone).all():
                    continue
                if f.set_down([(model, box[0]) for model, box in zip(units, boxes, strict=True)], room):
                    f.floor.kept.extend(zone)
                    return True
    return False


def _unit_fits(f: Furnisher, room: int, model: Model, box: np.ndarray) -> bool:
    """Whether a unit fits into its place ``(1, 5)`` in a row; only a sink, with its tap, may stand before a window."""
    sill = 1.0 if model.category == "sink" else model.height
    return bool(f.floor.fits(room, box, (0.0, model.height), 0.004)[0] and f.floor.beside_windows(box, sill)[0])


# --- the choice of furniture for each room ----------------------------------------------------------------------------

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
    rules = {"living room": lounge, "kitchen": fit_kitchen, "bathroom": fit_bathroom, "bedroom": sleeping}
    for kind, rule in rules.items():
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
        if floor.rooms[room].area > 17 and rng.random() < 0.5:  # a second sofa
            sofa = f.make("sofa")
            f.settle(sofa, room, along_walls(floor, room, sofa.size, rng, middle=0.3), front=0.3, reserve=False)
        for _ in range(int(rng.integers(0, 3))):
            easy_seat(f, room)
    for room in rng.permutation(len(kinds)).tolist():
        for category, chance, each, front in _MORE[kinds[room]]:
            for _ in range(max(1, int(floor.rooms[room].area / each))):
                if rng.random() < chance:
                    _one_more(f, room, category, front)
    _at_least(f, "plant", 2)
    _at_least(f, "chair", int(rng.integers(4, 7)), front=0.2, nowhere=("hall", "bathroom"))
    missing = [category for category in REQUIRED if not f.of(category)]
    if missing:
        raise NoRoom(f"no place for {', '.join(missing)}")
    for room, kind in enumerate(kinds):
        ceiling_lamps(f, room)
        if rng.random() < _RUGS.get(kind, 0.0):
            rug(f, room)
        for _ in range(int(rng.integers(_PAINTINGS[kind][0], _PAINTINGS[kind][1] + 1))):
            painting(f, room)
    small_things(f)
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


def _one_more(f: Furnisher, room: int, category: str, front: float) -> bool:
    if category == "desk":
        return workplace(f, room)
    if category == "armchair":
        return easy_seat(f, room)
    made = f.make(category, f.habits["chair"] if category == "chair" else None)
    corner = {"plant": 0.8, "lamp": 0.8, "wardrobe": 0.5, "bookshelf": 0.3}.get(category, 0.0)
    gap = 0.06 if category in ("plant", "lamp") else 0.02
    sites = along_walls(f.floor, room, made.size, f.rng, corner=corner, middle=0.2, gap=gap, side=gap)
    return f.settle(made, room, sites, front=front) is not None


def _at_least(f: Furnisher, category: str, count: int, front: float = 0.0, nowhere: tuple[str, ...] = ()) -> None:
    """Add pieces of a category until there are `count`, as far as they fit; none to `nowhere`, kinds of rooms."""
    rooms = [i for i, space in enumerate(f.floor.plan.spaces) if space.kind not in nowhere]
    for _ in range(3):
        for room in f.rng.permutation(rooms).tolist():
            if len(f.of(category)) >= count:
                return
            _one_more(f, room, category, front)


def rug(f: Furnisher, room: int) -> None:
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
        f.record(made, room, sites.boxes[place], 0.0, solid=False)


def painting(f: Furnisher, room: int) -> None:
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


def small_things(f: Furnisher) -> None:
    """Vases, books and the like on tables and chests."""
    categories = sorted(name for name, kind in KINDS.items() if kind.placement == "top")
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
