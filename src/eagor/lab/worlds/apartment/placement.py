"""Where furniture can stand: footprints, candidates for them, and the `Furnisher` that places pieces in an apartment.

It knows overlaps, floor to keep clear, and whether one can still walk. A footprint is a rotated rectangle ``(5,)``:
centre x, y, half depth, half width, and the angle of its front (radians, counter-clockwise from +x); metres; further
numbers may follow it. Candidates ``(n, 6)`` are footprints with a score, more is better, before any check.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from eagor.lab.worlds.apartment.building import Cells, wall_faces
from eagor.lab.worlds.apartment.furniture import KINDS, Model, build
from eagor.lab.worlds.apartment.plans import OUTSIDE, Opening, Plan
from eagor.queries import Query

CELL = 0.05
BODY = 0.25  # half of the width of passages
REACH = 0.55  # largest distance from the middle of a body to every piece
GAP = 0.02  # between the back of a piece and the wall: more than a skirting board
NOWHERE = np.zeros((0, 5))


def from_rectangle(rectangle: tuple[float, float, float, float]) -> np.ndarray:
    """The footprint of an axis-aligned rectangle x0, y0, x1, y1."""
    x0, y0, x1, y1 = rectangle
    return np.array([(x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2, 0.0])


def overlaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether footprints `a` ``(n, 5)`` and `b` ``(m, 5)`` overlap: ``(n, m)`` bool, by separating axes."""
    a, b = np.atleast_2d(a), np.atleast_2d(b)
    between = b[None, :, :2] - a[:, None, :2]
    turn = b[None, :, 4] - a[:, None, 4]
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    apart = np.zeros(turn.shape, dtype=bool)
    for own, other, angle in ((a[:, None], b[None], a[:, None, 4]), (b[None], a[:, None], b[None, :, 4])):
        forward = between[..., 0] * np.cos(angle) + between[..., 1] * np.sin(angle)
        sideways = between[..., 1] * np.cos(angle) - between[..., 0] * np.sin(angle)
        apart |= np.abs(forward) >= own[..., 2] + other[..., 2] * c + other[..., 3] * s
        apart |= np.abs(sideways) >= own[..., 3] + other[..., 2] * s + other[..., 3] * c
    return ~apart


def untouched(boxes: np.ndarray, others: Sequence[np.ndarray]) -> np.ndarray:
    """Which footprints ``(n, 5)`` overlap none of the others ``(5,)``: ``(n,)`` bool."""
    if not others:
        return np.ones(len(boxes), dtype=bool)
    return ~np.asarray(overlaps(boxes, np.array(others)).any(axis=1))


def corners(boxes: np.ndarray, steps: int = 1) -> np.ndarray:
    """Points ``(n, 4 * steps, 2)`` round the edge of footprints ``(n, 5)``; the corners are among them."""
    boxes = np.atleast_2d(boxes)
    along = np.linspace(-1, 1, steps, endpoint=False)
    one = np.ones(steps)
    unit = np.concatenate([np.stack(p, -1) for p in ((along, -one), (one, along), (-along, one), (-one, -along))])
    local = unit[None] * boxes[:, None, 2:4]
    c, s = np.cos(boxes[:, 4])[:, None], np.sin(boxes[:, 4])[:, None]
    x, y = local[..., 0] * c - local[..., 1] * s, local[..., 0] * s + local[..., 1] * c
    return np.stack([x + boxes[:, None, 0], y + boxes[:, None, 1]], axis=-1)


def distances(box: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance in metres from points ``(..., 2)`` to a footprint ``(5,)``, 0 inside."""
    offset = points - box[:2]
    c, s = math.cos(box[4]), math.sin(box[4])
    forward = np.abs(offset[..., 0] * c + offset[..., 1] * s) - box[2]
    sideways = np.abs(offset[..., 1] * c - offset[..., 0] * s) - box[3]
    return np.hypot(np.maximum(forward, 0), np.maximum(sideways, 0))


def relative(box: np.ndarray, forward: float, left: float, size: np.ndarray, turn: float = 0.0) -> np.ndarray:
    """The footprint of something `forward` and to the `left` of another's middle, turned relative to it (radians)."""
    c, s = math.cos(box[4]), math.sin(box[4])
    x, y = box[0] + forward * c - left * s, box[1] + forward * s + left * c
    return np.array([x, y, size[0] / 2, size[1] / 2, math.remainder(box[4] + turn, 2 * math.pi)])


def advanced(boxes: np.ndarray, reach: np.ndarray | float) -> np.ndarray:
    """Footprints ``(n, 5)`` moved `reach` metres forward."""
    boxes = np.atleast_2d(boxes).copy()
    boxes[:, 0] += reach * np.cos(boxes[:, 4])
    boxes[:, 1] += reach * np.sin(boxes[:, 4])
    return boxes


def before(boxes: np.ndarray, depth: float) -> np.ndarray:
    """The floor ``(n, 5)`` in front of footprints, `depth` metres deep; behind them if it is negative."""
    zone = advanced(boxes, np.copysign(np.atleast_2d(boxes)[:, 2], depth) + depth / 2)
    zone[:, 2] = abs(depth) / 2 - 1e-3
    return zone


def leaf_footprint(doorway: Opening) -> np.ndarray:
    """The open leaf with its handles."""
    length = doorway.end - doorway.start
    along = doorway.at(1.0, 0.0) - doorway.at(0.0, 0.0)
    return np.array([*doorway.at(length / 2, 0.02), length / 2, 0.14 / 2, math.atan2(along[1], along[0])])


def best(sites: np.ndarray, good: np.ndarray, most: int) -> np.ndarray:
    """Indices of the `most` best candidates ``(n, 6)`` among those that are `good` ``(n,)``, best first."""
    places = np.flatnonzero(good)
    return places[np.argsort(-sites[places, 5], kind="stable")][:most]


@dataclass(frozen=True, eq=False)
class Piece:
    """A placed model.

    `room`: its index in the plan; `box`: its footprint ``(5,)``; `z`: the height of the model's origin, metres; `air`:
    from where to where it takes up space, None if others may overlap it; `zones` ``(k, 5)`` stay free for it. If
    it stands in the way, `near`: the cells where the middle of a body cannot be; `ring`: those from which it can be
    reached, as flat indices.
    """

    room: int
    model: Model
    box: np.ndarray
    z: float = 0.0
    air: tuple[float, float] | None = None
    zones: np.ndarray = field(default_factory=lambda: NOWHERE)
    near: np.ndarray | None = None
    ring: np.ndarray | None = None

    @property
    def solid(self) -> bool:
        """Whether it is an obstacle."""
        return self.near is not None

    @property
    def category(self) -> str:
        """What it is."""
        return self.model.category

    @property
    def name(self) -> str:
        """Colour and category, as in `Instance.name`."""
        return str(Query(self.category, self.model.colour))


class Furnisher:
    """An apartment while it is being furnished (mutable): it builds pieces and finds places for them.

    `pieces`: the placed ones; `habits`: the usual colour of each category in this home; `space`: for each room those
    that are open to it, including itself. `_leaves`: open doors, as footprints with lowest and highest z ``(7,)``.
    In cells ``(rows, columns)``, `_centres`: their middles; `_owner`: their rooms; `_walls`: those too near to walls.
    """

    def __init__(self, plan: Plan, cells: Cells, rng: np.random.Generator) -> None:
        """The empty floor, with walls and open doors in place and passages through the doors kept clear."""
        self.plan, self.rooms, self.faces, self.rng = plan, cells.rooms, wall_faces(cells), rng
        self.habits: dict[str, str] = {}
        self.pieces: list[Piece] = []
        group = list(range(len(plan.spaces)))
        for a, b in sorted(plan.open_to):
            group = [group[a] if g == group[b] else g for g in group]
        self.space = [np.flatnonzero(np.equal(group, own)) for own in group]
        x, y = (-0.3 + (np.arange(math.ceil((end + 0.6) / CELL)) + 0.5) * CELL for end in plan.extent)
        self._centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        xs, ys, _ = cells.lines
        i = np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2)
        j = np.clip(np.searchsorted(ys, y) - 1, 0, len(ys) - 2)
        self._owner = np.maximum(cells.air[:, :, 0], OUTSIDE)[np.ix_(i, j)]
        self._walls = np.asarray(ndimage.distance_transform_edt(self._owner >= 0, sampling=CELL)) < BODY
        anchors = []  # a cell on either side of each doorway
        for doorway in plan.doorways:
            for room, side in zip(doorway.boundary.rooms, (-0.45, 0.45), strict=True):
                if room != OUTSIDE:
                    middle = np.array(doorway.boundary.point((doorway.start + doorway.end) / 2, side))
                    anchors.append(np.floor((middle + 0.3) / CELL).astype(int))
        self._anchors = tuple(np.transpose(anchors))
        self._leaves = [np.array([*leaf_footprint(door), 0.0, door.head]) for door in plan.doorways if door.leaf]
        for leaf in self._leaves:
            self._walls |= distances(leaf, self._centres) < BODY
        self._least = np.minimum(0.8, 0.3 * self._areas(~self._walls))  # square metres to walk on, for each room

    def inside(self, rooms: Iterable[int], boxes: np.ndarray) -> np.ndarray:
        """Whether footprints ``(n, 5)`` lie in the union of some rooms: ``(n,)`` bool."""
        rectangles = np.concatenate([self.rooms[room].rectangles for room in rooms])
        points = corners(boxes, 6)
        x0, y0, x1, y1 = (rectangles.T + np.array([[-1e-3], [-1e-3], [1e-3], [1e-3]]))[..., None, None]
        hit = (points[..., 0] >= x0) & (points[..., 0] <= x1) & (points[..., 1] >= y0) & (points[..., 1] <= y1)
        return np.asarray(hit.any(axis=0).all(axis=-1))

    def beside_windows(self, boxes: np.ndarray, height: float) -> np.ndarray:
        """The footprints ``(n, 5)`` that do not stand before a window whose sill is lower than `height`."""
        return untouched(boxes, [from_rectangle(w.approach(0.4)) for w in self.plan.windows if w.sill < height + 0.03])

    def in_air(self, room: int, boxes: np.ndarray, low: float, high: float, margin: float) -> np.ndarray:
        """The footprints ``(n, 5)`` in the room that hit nothing from `low` to `high`, `margin` metres round them."""
        grown = boxes[:, :5] + np.array([0.0, 0.0, margin, margin, 0.0])
        return self.inside([room], boxes) & untouched(grown, self._solids(low, high))

    def fits(self, room: int, boxes: np.ndarray, model: Model, margin: float = 0.02) -> np.ndarray:
        """The footprints ``(n, 5)`` with room for a model on the floor, clear of doorways and of zones."""
        zones = [from_rectangle(doorway.approach(0.8, 0.06)) for doorway in self.plan.doorways]
        zones += [zone for piece in self.pieces for zone in piece.zones]
        return self.in_air(room, boxes, 0.0, model.size[2], margin) & untouched(boxes, zones)

    def stands(self, room: int, boxes: np.ndarray, model: Model, margin: float = 0.02) -> np.ndarray:
        """Those of `fits` that are not before a window which the model would cover; the tap of a sink may."""
        height = 1.0 if model.category == "sink" else model.size[2]
        return self.fits(room, boxes, model, margin) & self.beside_windows(boxes, height)

    def open_before(self, rooms: Iterable[int], zone: np.ndarray) -> np.ndarray:
        """The pieces of floor ``(n, 5)`` that are free of solids and lie in the union of some rooms."""
        return untouched(zone, self._solids(-1.0, 1.0)) & self.inside(rooms, zone)

    def _solids(self, low: float, high: float) -> list[np.ndarray]:
        """What takes up space between two heights: footprints, each with its own lowest and highest z ``(7,)``."""
        pieces = [np.array([*piece.box, *piece.air]) for piece in self.pieces if piece.air]
        return [solid for solid in self._leaves + pieces if solid[5] < high and solid[6] > low]

    def of(self, category: str, room: int | None = None) -> list[Piece]:
        """The pieces of a category, in a room or anywhere."""
        return [p for p in self.pieces if p.category == category and room in (None, p.room)]

    def along_walls(
        self, room: int, size: np.ndarray, *, corner: float = 0.0, middle: float = 0.0, gap: float = GAP,
        side: float = 0.04,
    ) -> np.ndarray:  # fmt: skip
        """Backs to walls, `gap` metres away, `side` free at the ends; scored for the `corner` and the `middle`."""
        found = [np.zeros((0, 6))]
        for face in self.faces:
            if max(face.rooms) != room or face.end - face.start - size[1] - 2 * side < 0:
                continue
            way = 1 if face.rooms[1] == room else -1  # into the room
            angle = (0.0 if way > 0 else math.pi) if face.axis else way * math.pi / 2
            first, last = face.start + side + size[1] / 2, face.end - side - size[1] / 2
            boxes = np.tile([0.0, 0.0, size[0] / 2, size[1] / 2, angle], (8, 1))
            boxes[:, face.axis] = [first, last, (first + last) / 2, *self.rng.uniform(first, last, 5)]
            boxes[:, 1 - face.axis] = face.line + way * (gap + size[0] / 2)
            scores = self.rng.uniform(0, 0.5, 8) + np.array([corner, corner, middle, 0, 0, 0, 0, 0])
            found.append(np.column_stack([boxes, scores]))
        return np.concatenate(found)

    def in_room(self, room: int, size: np.ndarray, count: int) -> np.ndarray:
        """Anywhere in a room, axis-aligned or turned by a quarter, preferably near its middle."""
        rectangles = self.rooms[room].rectangles
        area = (rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1])
        picked = rectangles[self.rng.choice(len(rectangles), count, p=area / area.sum())]
        spots = picked[:, :2] + self.rng.random((count, 2)) * (picked[:, 2:] - picked[:, :2])
        middle = (rectangles[area.argmax(), :2] + rectangles[area.argmax(), 2:]) / 2
        turns = self.rng.integers(0, 2, count) * (math.pi / 2)
        scores = self.rng.uniform(0, 0.3, count) - 0.3 * np.linalg.norm(spots - middle, axis=1)
        return np.column_stack([spots, np.tile(size[:2] / 2, (count, 1)), turns, scores])

    def make(self, category: str, colour: str | None = None) -> Model:
        """A new model. Without a colour, mostly in the usual one of its kind in this home."""
        seed = int(self.rng.integers(2**31))
        colours = KINDS[category].colours
        if colour is None and colours:
            habit = self.habits.setdefault(category, str(self.rng.choice(colours)))
            colour = habit if self.rng.random() < 0.45 else str(self.rng.choice(colours))
        return build(category, colour, seed)

    def set_down(self, group: Iterable[tuple[Model, np.ndarray]], room: int, zones: np.ndarray = NOWHERE) -> bool:
        """Place models together if all rooms and pieces stay reachable, and keep `zones` free; otherwise do nothing."""
        start, around = len(self.pieces), np.isin(self._owner, self.space[room])  # nobody reaches it through a wall
        for model, box in group:
            away = distances(box, self._centres)
            ring = np.flatnonzero((away < REACH) & (away >= BODY) & around)
            self.pieces.append(Piece(room, model, box[:5], 0.0, (0.0, model.size[2]), zones, away < BODY, ring))
            zones = NOWHERE
        if not self._walkable():
            del self.pieces[start:]
        return len(self.pieces) > start

    def place_best(self, model: Model, room: int, sites: np.ndarray, front: float, reserve: bool = True) -> bool:
        """Place a model on the best candidate with `front` metres of free floor before it; `reserve` keeps it free."""
        good, reserve = self.stands(room, sites, model), reserve and front > 0
        if front > 0:
            good &= self.open_before(self.space[room], before(sites, front))
        tries = sites[best(sites, good, 10), :5]
        return any(self.set_down([(model, box)], room, before(box, front) if reserve else NOWHERE) for box in tries)

    def _walkable(self) -> bool:
        """Whether one walk leads through all doorways, into all rooms and near all pieces."""
        free = np.empty(self._walls.shape, dtype=np.int32)
        near = [piece.near for piece in self.pieces if piece.near is not None]
        ndimage.label(~np.logical_or.reduce([self._walls, *near]), output=free)
        marks = free[self._anchors]
        if marks[0] == 0 or (marks != marks[0]).any():
            return False
        main = free == marks[0]
        if (self._areas(main) < self._least).any():
            return False
        return all(main.ravel()[piece.ring].any() for piece in self.pieces if piece.solid)

    def _areas(self, cells: np.ndarray) -> np.ndarray:
        """Square metres of these cells in each room."""
        return np.bincount(self._owner[cells] + 1, minlength=len(self.rooms) + 1)[1:] * CELL**2
