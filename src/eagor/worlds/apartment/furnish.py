"""The choice of furniture for each room."""

from __future__ import annotations

import numpy as np

from eagor.worlds.apartment import dressing, fixtures, groups
from eagor.worlds.apartment.furnisher import Furnisher, NoRoom, Piece, tell_apart
from eagor.worlds.apartment.furniture import KINDS
from eagor.worlds.apartment.placement import Floor
from eagor.worlds.apartment.sites import along_walls

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


def furnish(floor: Floor, rng: np.random.Generator) -> list[Piece]:
    """Furniture for all rooms. Raises `NoRoom` if a required piece does not fit."""
    f = Furnisher(floor, rng)
    f.habits["chair"] = str(rng.choice(KINDS["chair"].colours))
    kinds = [space.kind for space in floor.plan.spaces]
    for kind, rule in (
        ("living room", groups.lounge), ("kitchen", fixtures.kitchen), ("bathroom", fixtures.bathroom),
        ("bedroom", groups.sleeping),
    ):  # fmt: skip
        for room in _of(kinds, kind):
            if not any(rule(f, room) for _ in range(4)):
                raise NoRoom(f"the {kind} is too small for what belongs there")
    _meals(f, kinds)
    for room in _of(kinds, "kitchen"):  # one more small table, if there is space
        if floor.rooms[room].area > 9.5 and not f.of("table", room) and rng.random() < 0.7:
            groups.dining(f, room, 2, 3)
    for room in _of(kinds, "bedroom"):
        if floor.rooms[room].area > 11 and f.of("bed", room)[0].box[3] < 0.65 and rng.random() < 0.5:
            groups.sleeping(f, room)
    for room in _of(kinds, "living room"):
        if floor.rooms[room].area > 17 and rng.random() < 0.5:
            groups.second_sofa(f, room)
        for _ in range(int(rng.integers(0, 3))):
            groups.easy_seat(f, room)
    for room in rng.permutation(len(kinds)):
        _further(f, int(room), kinds[room])
    _at_least(f, "plant", 2)
    _at_least(f, "chair", int(rng.integers(4, 7)))
    missing = [category for category in REQUIRED if not f.of(category)]
    if missing:
        raise NoRoom(f"no place for {', '.join(missing)}")
    for room, kind in enumerate(kinds):
        dressing.ceiling_lamps(f, room)
        if rng.random() < _RUGS.get(kind, 0.0):
            dressing.rug(f, room)
        for _ in range(int(rng.integers(_PAINTINGS[kind][0], _PAINTINGS[kind][1] + 1))):
            dressing.painting(f, room)
    dressing.small_things(f, tuple(sorted(name for name, kind in KINDS.items() if kind.placement == "top")))
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
            if groups.dining(f, room, least, most):
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
        return groups.workplace(f, room)
    if category == "armchair":
        return groups.easy_seat(f, room) is not None
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
