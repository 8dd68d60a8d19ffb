"""The last items: rugs, paintings, small things on tables, ceiling lamps."""

from __future__ import annotations

import math

import numpy as np

from eagor.worlds.apartment.furnisher import Furnisher, NoRoom, Piece
from eagor.worlds.apartment.placement import footprint, from_rectangle, untouched
from eagor.worlds.apartment.sites import Sites, advanced, before, in_room, joined, on_face, relative

_TOPS = {"table": 0.6, "coffee table": 0.6, "desk": 0.6, "dresser": 0.8, "nightstand": 0.5}  # chance of an item on it
_EYE_LEVEL = 1.52


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
