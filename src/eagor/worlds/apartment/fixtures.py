"""Kitchen units and bathrooms: pieces side by side at walls."""

from __future__ import annotations

from functools import partial

import numpy as np

from eagor.worlds.apartment.finishes import Look
from eagor.worlds.apartment.furnisher import Furnisher, Piece
from eagor.worlds.apartment.furniture import Model
from eagor.worlds.apartment.mesh import Part, box, part, placed
from eagor.worlds.apartment.placement import from_rectangle, overlaps
from eagor.worlds.apartment.plans import Plan
from eagor.worlds.apartment.sites import GAP, along_walls, before, on_face
from eagor.worlds.apartment.textures import REPEAT

_ROWS = (
    ("refrigerator", "cabinet", "sink", "cabinet", "stove"),
    ("refrigerator", "cabinet", "sink", "stove"),
    ("cabinet", "sink", "cabinet", "stove"),
    ("cabinet", "sink", "stove"),
    ("sink", "stove"),
    ("sink",),
)


def kitchen(f: Furnisher, room: int) -> bool:
    """A row of units along one wall, as many as fit; the others stand elsewhere if there is room."""
    start = f.mark()

    def width(model: Model) -> float:
        return float(model.size[1])

    sink = min((f.make("sink", "grey") for _ in range(2)), key=width)
    units = {"sink": sink, "stove": f.make("stove"), "refrigerator": f.make("refrigerator")}
    first = f.make("cabinet")
    cabinets = sorted([first, *(f.make("cabinet", first.colour) for _ in range(2))], key=width)
    for row in _ROWS:
        if row.count("cabinet") == 2:
            choices = [[made, made] for made in (cabinets[1], cabinets[0])]  # both with the same worktop
        else:
            choices = [cabinets[i : i + 1] for i in (2, 1, 0)] if "cabinet" in row else [[]]
        for choice in choices:
            bases = iter(choice)
            if not _row(f, room, [units[c] if c in units else next(bases) for c in row]):
                continue
            rest = [units[c] for c in units if c not in row] + ([] if "cabinet" in row else cabinets[:1])
            if all([_at_wall(f, room, made, 0.6) for made in rest]):
                return True
            f.back_to(start)
    return False


def bathroom(f: Furnisher, room: int) -> bool:
    """Toilet, sink and, where it fits, a bathtub."""
    start = f.mark()
    fixtures = [f.make("toilet"), f.make("sink", "white")]
    for bathtub in (True, True, True, False, False):
        bathtub = bathtub and _at_wall(f, room, f.make("bathtub"), 0.45, side=GAP)
        if all(_at_wall(f, room, made, 0.5, side=0.15) for made in fixtures):
            return True
        f.back_to(start)
    return False


def splashback(piece: Piece, plan: Plan, tiles: Look) -> Part | None:
    """Tiles on the wall above a kitchen unit, up to a window if there is one; None if no unit stands at a wall."""
    if piece.category not in ("cabinet", "sink", "stove") or plan.spaces[piece.room].kind != "kitchen":
        return None
    sills = [w.sill for w in plan.windows if overlaps(piece.box, from_rectangle(w.approach(0.4, 0.05)))[0, 0]]
    top = min([1.45, *(sill - 0.02 for sill in sills)])
    depth, width = piece.box[2:4]
    mesh = box((-depth - GAP + 1e-3, -width - 2e-3, 0.86), (-depth - GAP + 0.013, width + 2e-3, top))
    (made,) = placed([part(mesh, tiles[1], REPEAT[tiles[0]])], float(piece.box[4]), (*piece.box[:2], 0.0))
    return made


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
