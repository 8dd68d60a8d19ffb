"""The choice of furniture for each room, and the groups that belong together.

First come sofa and television, kitchen units, bathrooms, beds, table and chairs; then single pieces; last what is no
obstacle: ceiling lamps, rugs, paintings, small things on tables.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from eagor.errors import WorldError
from eagor.lab.worlds.apartment import placement as p
from eagor.lab.worlds.apartment.furniture import KINDS, Model, build
from eagor.lab.worlds.apartment.placement import Furnisher, Piece

REQUIRED = ("chair", "bed", "plant", "toilet", "tv", "sofa", "table", "sink")

_ROWS = (
    "refrigerator cabinet sink cabinet stove", "refrigerator cabinet sink stove", "cabinet sink cabinet stove",
    "cabinet sink stove", "sink stove", "sink",
)  # fmt: skip
# Further furniture per kind of room: category, probability, square metres of the room for each further piece, and free
# floor before it in metres.
_MORE: dict[str, tuple[tuple[str, float, float, float], ...]] = {
    "living room": (
        ("sofa", 0.4, 25, 0.3), ("armchair", 0.6, 13, 0.2), ("bookshelf", 0.8, 20, 0.6), ("dresser", 0.45, 30, 0.5),
        ("plant", 1.0, 11, 0.0), ("lamp", 0.8, 16, 0.0), ("desk", 0.15, 60, 0.0),
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
_DECORATED = {  # the fewest and the most paintings, and the chance of a rug
    "living room": (1, 3, 0.85), "bedroom": (1, 2, 0.7), "study": (0, 2, 0.5), "dining room": (1, 2, 0.5),
    "kitchen": (0, 1, 0.0), "hall": (0, 2, 0.4), "bathroom": (0, 0, 0.0),
}  # fmt: skip
_CORNERS = {"plant": 0.8, "lamp": 0.8, "wardrobe": 0.5, "bookshelf": 0.3, "armchair": 0.4}  # how much it likes them
_TOPS = {"table": 0.6, "coffee table": 0.6, "desk": 0.6, "dresser": 0.8, "nightstand": 0.5}  # chance of an item on it
_EYE_LEVEL = 1.6  # of the middle of a picture
_LEAST_UNIQUE = 3
_LIT = 75.0  # square metres of floor, walls and ceiling of a room for which one ceiling lamp is right
_SHARES = (0.2, 1.7)  # range of that power, as of real lamps
# Without a colour of their own: fixtures take the colour of their room, and all units of a kitchen share one.
_FIXED = ("sink", "toilet", "bathtub", "cabinet", "refrigerator", "stove")


def furnish(f: Furnisher) -> list[Piece]:
    """Furniture for all rooms. Raises `WorldError` if a required piece does not fit."""
    rng, kinds, area = f.rng, [room.kind for room in f.rooms], [room.area for room in f.rooms]
    places = {kind: [room for room, other in enumerate(kinds) if other == kind] for kind in _MORE}
    f.habits["chair"] = str(rng.choice(KINDS["chair"].colours))
    rules = {"living room": lounge, "kitchen": fit_kitchen, "bathroom": fit_bathroom, "bedroom": sleeping}
    for kind, rule in rules.items():
        for room in places[kind]:
            if not any(rule(f, room) for _ in range(4)):
                raise WorldError(f"the {kind} is too small for what belongs there")
    # The dining table stands in the dining room, else in the kitchen or the living room, wherever it fits.
    spacious = area[places["kitchen"][0]] > 10 and rng.random() < 0.8
    order = ("dining room", "kitchen", "living room") if spacious else ("dining room", "living room", "kitchen")
    sizes = [(room, least, most) for least, most in ((4, 6), (2, 4)) for kind in order for room in places[kind]]
    if not any(dining(f, *size) for size in sizes):
        raise WorldError("no place for a table with chairs")
    for room in rng.permutation(len(kinds)).tolist():
        for category, chance, each, front in _MORE[kinds[room]]:
            for _ in range(max(1, int(area[room] / each))):
                if rng.random() < chance:
                    _one_more(f, room, category, front)
    _at_least(f, "plant", 2, list(range(len(kinds))), front=0.0)
    dry = [room for room, kind in enumerate(kinds) if kind not in ("hall", "bathroom")]
    _at_least(f, "chair", int(rng.integers(4, 7)), dry, front=0.2)
    if not f.of("plant"):
        raise WorldError("no place for a plant")
    for room, kind in enumerate(kinds):
        ceiling_lamps(f, room)
        fewest, most, covered = _DECORATED[kind]
        if rng.random() < covered:
            rug(f, room)
        for _ in range(int(rng.integers(fewest, most + 1))):
            painting(f, room)
    small_things(f)
    tell_apart(f)
    return f.pieces


def _one_more(f: Furnisher, room: int, category: str, front: float) -> None:
    """A further piece with `front` metres of free floor before it, if it fits."""
    if category == "desk":
        workplace(f, room)
        return
    made = f.make(category, f.habits["chair"] if category == "chair" else None)
    gap, soft = 0.06 if category in ("plant", "lamp") else 0.02, category in ("sofa", "armchair")
    sites = f.along_walls(room, made.size, corner=_CORNERS.get(category, 0.0), middle=0.2, gap=gap, side=gap)
    f.place_best(made, room, sites, front, reserve=not soft)


def _at_least(f: Furnisher, category: str, count: int, rooms: list[int], front: float) -> None:
    """Add pieces of a category to these rooms until there are `count`, as far as they fit."""
    for _ in range(3):
        for room in f.rng.permutation(rooms).tolist():
            if len(f.of(category)) >= count:
                return
            _one_more(f, room, category, front)


def lounge(f: Furnisher, room: int) -> bool:
    """A television at a wall, a sofa that faces it, and mostly a coffee table between."""
    television, sofa, low_table = f.make("tv"), f.make("sofa"), f.make("coffee table")
    walls = f.along_walls(room, television.size, middle=0.3, side=0.06)
    walls = walls[f.stands(room, walls, television)]
    gap = np.tile(np.linspace(1.6, 4.0, 49), len(walls))
    screen = walls.repeat(49, axis=0)
    seat = p.advanced(screen, (television.size[0] + sofa.size[0]) / 2 + gap)
    seat[:, 4] = np.remainder(seat[:, 4] + 2 * math.pi, 2 * math.pi) - math.pi  # it looks back
    seat[:, 2:4] = sofa.size[:2] / 2
    between = p.before(seat, 0.5)
    between[:, :2] = (screen[:, :2] + seat[:, :2]) / 2
    between[:, 2], between[:, 3] = gap / 2 - 0.01, 0.55
    # A sofa stands at a wall, which is best, or far enough from it to walk behind.
    at_wall = ~f.inside(f.space[room], p.before(seat, -0.06))
    seat[:, 5] += f.rng.uniform(0, 0.5, len(seat)) + at_wall * (1.0 - 0.15 * np.abs(gap - 2.6))
    good = f.stands(room, seat, sofa) & f.open_before(f.space[room], between)
    good &= at_wall | f.inside(f.space[room], p.before(seat, -0.65))
    for place in p.best(seat, good, 12):
        group, deep = [(television, screen[place]), (sofa, seat[place])], low_table.size[0]
        reach = f.rng.uniform(0.36, 0.44)
        if gap[place] > reach + deep + 0.5:
            group.append((low_table, p.relative(seat[place], (sofa.size[0] + deep) / 2 + reach, 0.0, low_table.size)))
        if f.set_down(group, room, between[[place], :5]):
            return True
    return False


def dining(f: Furnisher, room: int, least: int, most: int) -> bool:
    """A table with `least` to `most` equal chairs round it that face it."""
    table, chair = f.make("table"), f.make("chair", f.habits["chair"])
    flat = f.along_walls(room, table.size, middle=0.3, gap=0.06) - np.array([0, 0, 0, 0, 0, 1.6])  # rather not
    sites = np.concatenate([f.in_room(room, table.size, 60), flat])
    good = f.fits(room, sites, table)
    wanted = int(f.rng.integers(least, most + 1))
    for box in sites[p.best(sites, good, 14)]:
        seats = _round_table(f, box, chair.size)
        seats = seats[f.fits(room, seats, chair)][:wanted]
        if len(seats) >= least and f.set_down([(table, box), *((chair, seat) for seat in seats)], room):
            return True
    return False


def _round_table(f: Furnisher, table: np.ndarray, chair: np.ndarray) -> np.ndarray:
    """Places ``(n, 5)`` for chairs of one size round a table, the most natural first."""
    (depth, width, _), (hx, hy) = chair, table[2:4]
    count = 1 if abs(hx - hy) < 0.1 else max(1, int(2 * hy / (width + 0.12)))
    sides = [(sign, (i + 0.5) * 2 * hy / count - hy, 0) for i in range(count) for sign in (1, -1)]
    places = []
    for front, left, end in [*sides, (0, 0.0, 1), (0, 0.0, -1)]:
        out, turn = f.rng.uniform(0.05, 0.12) + depth / 2, f.rng.uniform(-0.07, 0.07)
        turn += math.pi if front > 0 else -end * math.pi / 2
        places.append(p.relative(table, front * (hx + out), left + end * (hy + out), chair, turn))
    return np.array(places)


def workplace(f: Furnisher, room: int) -> None:
    """A desk at a wall or window with a chair that faces it."""
    desk, chair = f.make("desk"), f.make("chair", f.habits["chair"])
    sites = f.along_walls(room, desk.size, corner=0.3, gap=0.05)
    good = f.stands(room, sites, desk) & f.open_before(f.space[room], p.before(sites, chair.size[0] + 0.35))
    for box in sites[p.best(sites, good, 8)]:
        turn = math.pi + f.rng.uniform(-0.1, 0.1)
        seat = p.relative(box, (desk.size[0] + chair.size[0]) / 2 + 0.04, 0.0, chair.size, turn)
        if f.fits(room, seat[None], chair)[0] and f.set_down([(desk, box), (chair, seat)], room):
            return


def sleeping(f: Furnisher, room: int) -> bool:
    """A bed with its head to a wall, and nightstands beside it if they fit."""
    for _ in range(3):  # beds vary a lot in width
        made = f.make("bed")
        double = made.size[1] > 1.3
        sites = f.along_walls(room, made.size, corner=0.5 * (not double), middle=0.4 * double, side=0.06)
        sites[:, 5] += 0.6 * f.inside(f.space[room], sites + np.array([0, 0, 0, 0.45, 0, 0])) * double
        if f.place_best(made, room, sites, 0.35, reserve=False):
            break
    else:
        return False
    bed, stand = f.pieces[-1].box, f.make("nightstand")
    for side in (1, -1) if f.rng.random() < 0.8 else (1,):
        left = side * (bed[3] + stand.size[1] / 2 + 0.04)
        box = p.relative(bed, stand.size[0] / 2 - bed[2], left, stand.size)
        f.place_best(stand, room, np.append(box, 0.0)[None], 0.3, reserve=False)
    return True


def fit_kitchen(f: Furnisher, room: int) -> bool:
    """A row of units along one wall, as many as fit; the others stand elsewhere if there is room."""
    start = len(f.pieces)
    units = {
        name: f.make(name, "grey" if name == "sink" else None) for name in ("cabinet", "sink", "stove", "refrigerator")
    }
    for row in map(str.split, _ROWS):
        rest = [made for name, made in units.items() if name not in row]
        if _row(f, room, [units[name] for name in row]) and all([_at_wall(f, room, made, 0.6) for made in rest]):
            return True
        del f.pieces[start:]
    return False


def _row(f: Furnisher, room: int, units: list[Model]) -> bool:
    """Place units side by side, flush with the wall, where there is room for all of them."""
    widths, deepest = np.array([model.size[1] for model in units]) + 0.004, max(model.size[0] for model in units)
    left = np.cumsum(widths) - widths / 2 - widths.sum() / 2
    sites = f.along_walls(room, np.array([deepest, widths.sum()]), corner=0.5, side=p.GAP)
    for site in sites[p.best(sites, np.ones(len(sites), dtype=bool), 30)]:
        spots = zip(units, left, strict=True)
        boxes = np.array([p.relative(site, (unit.size[0] - deepest) / 2, at, unit.size) for unit, at in spots])
        zones, group = p.before(boxes, 0.7), list(zip(units, boxes, strict=True))
        fit = all(f.stands(room, box[None], unit, 0.004)[0] for unit, box in group)
        if fit and f.open_before(f.space[room], zones).all() and f.set_down(group, room, zones):
            return True
    return False


def fit_bathroom(f: Furnisher, room: int) -> bool:
    """Toilet, sink and, where it fits, a bathtub."""
    start = len(f.pieces)
    fixtures = [f.make("toilet"), f.make("sink", "white")]
    for bathtub in (True, True, True, False, False):
        if bathtub:
            _at_wall(f, room, f.make("bathtub"), 0.45, side=p.GAP)
        if all(_at_wall(f, room, made, 0.5, side=0.15) for made in fixtures):
            return True
        del f.pieces[start:]
    return False


def _at_wall(f: Furnisher, room: int, made: Model, front: float, side: float = 0.03) -> bool:
    return f.place_best(made, room, f.along_walls(room, made.size, corner=0.6, side=side), front)


def rug(f: Furnisher, room: int) -> None:
    """A rug: under the coffee table or the dining table, beside the bed, or where the floor is free."""
    made = f.make("rug")
    sites, size = f.in_room(room, made.size, 30), made.size
    more: list[tuple[np.ndarray, float]] = []
    for category, bonus in (("coffee table", 3.0), ("table", 2.0)):
        for table in f.of(category, room):
            more.append((p.relative(table.box, 0, 0, size), bonus + 0.1))
            more.append((p.relative(table.box, 0, 0, size, math.pi / 2), bonus))
    for bed in f.of("bed", room):
        out = bed.box[3] + size[0] / 2 - 0.1
        more.append((p.relative(p.before(bed.box, 1.0)[0], 0, 0, size), 1.0))
        more += [(p.relative(bed.box, 0.2, side * out, size, math.pi / 2), 1.0) for side in (-1, 1)]
    free = sites[f.open_before([room], sites)]
    sites = np.reshape([*free, *((*box, score) for box, score in more)], (-1, 6))
    taken = [p.from_rectangle(door.leaf_box) for door in f.plan.doorways if door.leaf_box]
    good = f.inside([room], sites) & p.untouched(sites, taken + [piece.box for piece in f.of("rug")])
    for box in sites[p.best(sites, good, 1), :5]:
        f.pieces.append(Piece(room, made, box))


def painting(f: Furnisher, room: int) -> None:
    """A picture on a free patch of wall, best over the middle of a sofa, a bed or a low piece."""
    made = f.make("painting")
    depth, _, height = made.size
    z = min(_EYE_LEVEL, f.plan.height - height / 2 - 0.25)
    sites = f.along_walls(room, made.size, gap=0.0, side=0.15)
    for piece in (piece for category in ("sofa", "bed", "dresser", "desk") for piece in f.of(category, room)):
        over = sites[~p.untouched(p.before(sites, 0.3), [piece.box])]
        left = np.stack([-np.sin(over[:, 4]), np.cos(over[:, 4])], axis=1)
        over[:, :2] += ((piece.box[:2] - over[:, :2]) * left).sum(axis=1, keepdims=True) * left
        over[:, 5] += 1.0
        sites = np.concatenate([sites, over])
    wide = p.advanced(sites, 0.18 - depth / 2)  # free air around and before it
    wide[:, 2], wide[:, 3] = 0.18, wide[:, 3] + 0.1
    good = f.in_air(room, wide, z - height / 2 - 0.04, z + height / 2 + 0.04, 0.0)
    good &= f.beside_windows(wide, z + height / 2)
    good &= p.untouched(wide, [p.from_rectangle(door.approach(0.4, 0.1)) for door in f.plan.doorways])
    for box in sites[p.best(sites, good, 1), :5]:
        f.pieces.append(Piece(room, made, box, z, (z - height / 2, z + height / 2)))


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
            room = room * (0.6 if "table" in piece.category else 1.0)  # tops may be round
            if (room < 0).any():
                continue
            forward, left = f.rng.uniform(-room, room)
            box = p.relative(piece.box, forward, left, made.size, f.rng.uniform(-0.6, 0.6))
            if p.untouched(box[None], taken)[0]:
                taken.append(box)
                f.pieces.append(Piece(piece.room, made, box, piece.model.size[2]))


def ceiling_lamps(f: Furnisher, room: int) -> None:
    """One lamp in each part of a room, two in a large or long one, as bright as suits it; `WorldError` if none fits."""
    made, height = f.make("ceiling lamp"), f.plan.height
    for part, (x0, y0, x1, y1) in enumerate(f.rooms[room].rectangles):
        sides = np.array([x1 - x0, y1 - y0])
        if part > 0 and sides.prod() < 2.0:
            continue
        count = 2 if sides.prod() > 18 or sides.max() > max(4.5, 2.2 * sides.min()) else 1
        for i in range(count):
            boxes = np.tile([(x0 + x1) / 2, (y0 + y1) / 2, made.size[0] / 2, made.size[1] / 2, 0.0], (91, 1))
            boxes[:, sides.argmax()] += ((i + 0.5) / count - 0.5) * sides.max()
            boxes[1:, :2] += f.rng.normal(0, 0.4, (90, 2))
            for box in boxes[f.in_air(room, boxes, height - made.size[2], height, 0.05)][:1]:
                f.pieces.append(Piece(room, made, box, height, (height - made.size[2], height)))
    count = len(f.of("ceiling lamp", room))
    if not count:
        raise WorldError(f"no place for a lamp in the {f.rooms[room].name}")
    x0, y0, x1, y1 = f.rooms[room].rectangles.T
    surface = 2 * f.rooms[room].area + float((2 * (x1 - x0 + y1 - y0)).sum()) * height
    share = float(np.clip(surface / _LIT / count, *_SHARES))
    made = replace(made, lamps=tuple(replace(lamp, power=share * lamp.power) for lamp in made.lamps))
    f.pieces[-count:] = [replace(piece, model=made) for piece in f.pieces[-count:]]


def tell_apart(f: Furnisher) -> None:
    """Recolour single pieces, mostly a chair, so that "the red chair" is one of several chairs.

    Raises `WorldError` unless three solid pieces get a unique name within a category, and one name occurs repeatedly.
    """
    chairs = f.of("chair")
    odd = int(f.rng.choice([0, 1, 2], p=[0.12, 0.7, 0.18])) if len(chairs) > 3 else 0
    for i in f.rng.permutation(len(chairs))[:odd]:
        _recolour(f, chairs[i])
    for _ in range(40):
        solid = [piece for piece in f.pieces if piece.solid]
        names, categories = Counter(piece.name for piece in solid), Counter(piece.category for piece in solid)
        unique = [piece for piece in solid if names[piece.name] == 1 and categories[piece.category] > 1]
        repeated = [piece for piece in solid if names[piece.name] > 1]
        if len(unique) >= _LEAST_UNIQUE and repeated:
            return
        free = [piece for piece in repeated if piece.category not in _FIXED]
        pool = [piece for piece in free if piece.category != "chair" or names[piece.name] > 2]  # two chairs stay alike
        if not pool:
            break
        _recolour(f, pool[f.rng.integers(len(pool))])
    raise WorldError("too few pieces to tell apart by colour")


def _recolour(f: Furnisher, piece: Piece) -> None:
    """Build `piece` again in a colour that no other of its category has, if its size stays the same."""
    taken = {other.model.colour for other in f.of(piece.category)}
    colours = [colour for colour in KINDS[piece.category].colours if colour not in taken]
    for colour in f.rng.permutation(colours).tolist():
        model = build(piece.category, colour, piece.model.seed)
        if np.allclose(model.size, piece.model.size, atol=2e-3):
            f.pieces[f.pieces.index(piece)] = replace(piece, model=model)
            return
