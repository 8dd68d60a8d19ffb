"""The floor while an apartment is being furnished, and the `Furnisher` that places pieces of furniture on it.

The floor knows overlaps, floor to keep clear, and whether one can still walk. A footprint is a rotated rectangle
``(5,)``: centre x, y, half depth, half width, and the angle of its front (radians, counter-clockwise from +x); metres.
`Sites` are candidate footprints with scores, before any check.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from eagor.lab.worlds.apartment.furniture import KINDS, Model, build
from eagor.lab.worlds.apartment.plans import OUTSIDE, Cells, Doorway, Plan, WallFace, wall_faces
from eagor.lab.worlds.scene import Room

CELL = 0.05
BODY = 0.25  # half of the width of passages
REACH = 0.55  # largest distance from the middle of a body to every piece
GAP = 0.02  # between the back of a piece and the wall: more than a skirting board


def footprint(x: float, y: float, depth: float, width: float, angle: float) -> np.ndarray:
    """A footprint ``(5,)`` from full sizes."""
    return np.array([x, y, depth / 2, width / 2, angle])


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


def _within(rectangles: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Whether footprints ``(n, 5)`` lie in the union of axis-aligned rectangles ``(m, 4)``: ``(n,)`` bool."""
    points = corners(boxes, 6)
    x0, y0, x1, y1 = (rectangles.T + np.array([[-1e-3], [-1e-3], [1e-3], [1e-3]]))[..., None, None]
    hit = (points[..., 0] >= x0) & (points[..., 0] <= x1) & (points[..., 1] >= y0) & (points[..., 1] <= y1)
    return np.asarray(hit.any(axis=0).all(axis=-1))


def untouched(boxes: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """Which footprints ``(n, 5)`` overlap none of the others ``(5,)``: ``(n,)`` bool."""
    if not others:
        return np.ones(len(boxes), dtype=bool)
    return ~np.asarray(overlaps(boxes, np.array(others)).any(axis=1))


@dataclass
class Floor:
    """The floor of an apartment while it is being furnished (mutable).

    `solid`: footprints with their lowest and highest z ``(7,)``; `kept`: footprints that stay free of solids; `near`
    ``(rows, columns)``: where the middle of a body cannot be; `owner`: the room of each of those cells; `space`: for
    each room the rooms that are open to it, including itself.
    """

    plan: Plan
    rooms: tuple[Room, ...]
    faces: tuple[WallFace, ...]
    origin: np.ndarray
    near: np.ndarray
    owner: np.ndarray
    anchors: np.ndarray
    space: tuple[tuple[int, ...], ...]
    solid: list[np.ndarray] = field(default_factory=list)
    kept: list[np.ndarray] = field(default_factory=list)
    around: list[np.ndarray] = field(default_factory=list)
    least: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def inside(self, room: int, boxes: np.ndarray) -> np.ndarray:
        """Whether footprints ``(n, 5)`` lie in a room: ``(n,)`` bool."""
        return _within(self.rooms[room].rectangles, boxes)

    def open_inside(self, room: int, boxes: np.ndarray) -> np.ndarray:
        """Whether footprints ``(n, 5)`` lie in a room or in those that are open to it."""
        return _within(np.concatenate([self.rooms[place].rectangles for place in self.space[room]]), boxes)

    def beside_windows(self, boxes: np.ndarray, height: float) -> np.ndarray:
        """The footprints ``(n, 5)`` that do not stand before a window whose sill is lower than `height`."""
        low = [from_rectangle(w.approach(0.4)) for w in self.plan.windows if w.sill < height + 0.03]
        return untouched(boxes, low)

    def fits(
        self, room: int, boxes: np.ndarray, z: tuple[float, float], margin: float = 0.02, kept: bool = True
    ) -> np.ndarray:
        """The footprints ``(n, 5)`` from z[0] to z[1] in the room that hit nothing and keep clear of `kept`."""
        grown = boxes + np.array([0.0, 0.0, margin, margin, 0.0])
        solid = [other[:5] for other in self.solid if other[5] < z[1] and other[6] > z[0]]
        good = self.inside(room, boxes) & untouched(grown, solid)
        return good & untouched(boxes, self.kept) if kept else good

    def clear(self, boxes: np.ndarray) -> np.ndarray:
        """Which footprints ``(n, 5)`` are clear of all solids on the floor: ``(n,)`` bool."""
        return untouched(np.atleast_2d(boxes), [solid[:5] for solid in self.solid if solid[5] < 1.0])

    def put(self, boxes: list[np.ndarray], heights: list[float]) -> bool:
        """Place solids on the floor together if all rooms and pieces stay reachable; otherwise do nothing."""
        before, count = self.near.copy(), len(self.around)
        for box in boxes:
            self._block(box)
        self.around += [self._ring(box) for box in boxes]
        if not self.walkable():
            self.near = before
            del self.around[count:]
            return False
        self.solid += [np.concatenate([box, (0.0, height)]) for box, height in zip(boxes, heights, strict=True)]
        return True

    def walkable(self) -> bool:
        """Whether one walk leads through all doorways, into all rooms and near all pieces."""
        free = np.empty(self.near.shape, dtype=np.int32)
        ndimage.label(~self.near, output=free)
        marks = free[tuple(self.anchors.T)]
        if marks[0] == 0 or (marks != marks[0]).any():
            return False
        main = free == marks[0]
        area = np.bincount(self.owner[main] + 1, minlength=len(self.rooms) + 1)[1:] * CELL**2
        if (area < self.least).any():
            return False
        flat = main.ravel()
        return all(flat[ring].any() for ring in self.around)

    def _window(self, box: np.ndarray, reach: float) -> tuple[slice, slice, np.ndarray]:
        points = corners(box)[0]
        low = np.floor((points.min(axis=0) - reach - self.origin) / CELL).astype(int)
        high = np.ceil((points.max(axis=0) + reach - self.origin) / CELL).astype(int)
        low, high = np.maximum(low, 0), np.minimum(high, self.near.shape)
        x = self.origin[0] + (np.arange(low[0], high[0]) + 0.5) * CELL
        y = self.origin[1] + (np.arange(low[1], high[1]) + 0.5) * CELL
        centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        return slice(low[0], high[0]), slice(low[1], high[1]), distances(box, centres)

    def _block(self, box: np.ndarray) -> None:
        rows, columns, away = self._window(box, BODY)
        self.near[rows, columns] |= away < BODY

    def _ring(self, box: np.ndarray) -> np.ndarray:
        """Flat indices of the cells round a footprint from which it counts as reached: none behind a wall."""
        rows, columns, away = self._window(box, REACH)
        middle = np.floor((box[:2] - self.origin) / CELL).astype(int)
        around = np.isin(self.owner[rows, columns], self.space[self.owner[tuple(middle)]])
        i, j = np.nonzero((away < REACH) & (away >= BODY) & around)
        return (i + rows.start) * self.near.shape[1] + j + columns.start


def empty_floor(plan: Plan, cells: Cells, rooms: tuple[Room, ...]) -> Floor:
    """The empty floor, with walls and open doors in place and passages through the doors kept clear."""
    width, depth = plan.extent
    origin = np.array([-0.3, -0.3])
    x, y = (origin[0] + (np.arange(math.ceil((end + 0.6) / CELL)) + 0.5) * CELL for end in (width, depth))
    xs, ys, _ = cells.lines
    i = np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2)
    j = np.clip(np.searchsorted(ys, y) - 1, 0, len(ys) - 2)
    owner = np.maximum(cells.air[:, :, 0], OUTSIDE)[np.ix_(i, j)]
    near = np.asarray(ndimage.distance_transform_edt(owner >= 0, sampling=CELL)) < BODY
    anchors = []
    for doorway in plan.doorways:
        for place, side in zip(doorway.boundary.rooms, (-1, 1), strict=True):
            if place != OUTSIDE:
                x0, y0, x1, y1 = doorway.boundary.box(doorway.start, doorway.end, side * 0.45, side * 0.45)
                anchors.append((((x0 + x1) / 2, (y0 + y1) / 2) - origin) / CELL)
    floor = Floor(plan, rooms, wall_faces(cells), origin, near, owner, np.floor(anchors).astype(int), _spaces(plan))
    for doorway in plan.doorways:
        floor.kept.append(from_rectangle(doorway.approach(0.8, 0.06)))
        if doorway.leaf:
            leaf = leaf_footprint(doorway)
            floor._block(leaf)
            floor.solid.append(np.concatenate([leaf, (0.0, doorway.head)]))
    free = np.bincount(owner[~floor.near] + 1, minlength=len(rooms) + 1)[1:] * CELL**2
    floor.least = np.minimum(0.8, 0.3 * free)
    return floor


def leaf_footprint(doorway: Doorway) -> np.ndarray:
    """The open leaf with its handles."""
    length = doorway.end - doorway.start
    middle = doorway.at(length / 2, 0.02)
    along = doorway.at(1.0, 0.0) - doorway.at(0.0, 0.0)
    return footprint(float(middle[0]), float(middle[1]), length, 0.14, math.atan2(along[1], along[0]))


def _spaces(plan: Plan) -> tuple[tuple[int, ...], ...]:
    """For each room all rooms that are open to it, directly or through others."""
    group = list(range(len(plan.spaces)))
    for a, b in sorted(plan.open_to):
        group = [group[a] if g == group[b] else g for g in group]
    return tuple(tuple(i for i, g in enumerate(group) if g == own) for own in group)


@dataclass(frozen=True, eq=False)
class Sites:
    """Candidates: footprints ``(n, 5)`` and scores ``(n,)``, more is better."""

    boxes: np.ndarray
    scores: np.ndarray

    def best(self, good: np.ndarray, most: int) -> np.ndarray:
        """Indices of the `most` best ones among those that are `good` ``(n,)``, best first."""
        places = np.flatnonzero(good)
        return places[np.argsort(-self.scores[places], kind="stable")][:most]


def joined(*several: Sites) -> Sites:
    """All candidates together."""
    if not several:
        return Sites(np.zeros((0, 5)), np.zeros(0))
    return Sites(np.concatenate([s.boxes for s in several]), np.concatenate([s.scores for s in several]))


def facing(face: WallFace) -> float:
    """The angle of a piece with its back to a wall."""
    if face.axis == 0:
        return math.copysign(math.pi / 2, face.side)
    return 0.0 if face.side > 0 else math.pi


def on_face(face: WallFace, along: np.ndarray, away: float, size: np.ndarray) -> np.ndarray:
    """Footprints ``(n, 5)`` of a `size`: middles `along` ``(n,)`` a wall, backs `away` metres from it."""
    boxes = np.zeros((len(along), 5))
    boxes[:, face.axis] = along
    boxes[:, 1 - face.axis] = face.line + face.side * (away + size[0] / 2)
    boxes[:, 2:] = size[0] / 2, size[1] / 2, facing(face)
    return boxes


def along_walls(
    floor: Floor, room: int, size: np.ndarray, rng: np.random.Generator, *,
    corner: float = 0.0, middle: float = 0.0, gap: float = GAP, side: float = 0.04,
) -> Sites:  # fmt: skip
    """Backs to walls: in the corners (score `corner`), the `middle`, and between; `side` metres free at the ends."""
    found = []
    for face in floor.faces:
        if face.room != room or face.end - face.start - size[1] - 2 * side < 0:
            continue
        first, last = face.start + side + size[1] / 2, face.end - side - size[1] / 2
        along = np.concatenate([[first, last, (first + last) / 2], rng.uniform(first, last, 5)])
        scores = rng.uniform(0, 0.5, len(along)) + np.array([corner, corner, middle, 0, 0, 0, 0, 0])
        found.append(Sites(on_face(face, along, gap, size), scores))
    return joined(*found)


def in_room(floor: Floor, room: int, size: np.ndarray, rng: np.random.Generator, count: int = 60) -> Sites:
    """Anywhere in a room, axis-aligned or turned by a quarter, preferably near its middle."""
    rectangles = floor.rooms[room].rectangles
    area = (rectangles[:, 2] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 1])
    picked = rectangles[rng.choice(len(rectangles), count, p=area / area.sum())]
    spot = rng.random((count, 2))
    middle = (rectangles[area.argmax(), :2] + rectangles[area.argmax(), 2:]) / 2
    boxes = np.zeros((count, 5))
    boxes[:, :2] = picked[:, :2] + spot * (picked[:, 2:] - picked[:, :2])
    boxes[:, 2:4] = size[:2] / 2
    boxes[:, 4] = rng.integers(0, 2, count) * (math.pi / 2)
    off = np.linalg.norm(boxes[:, :2] - middle, axis=1)
    return Sites(boxes, rng.uniform(0, 0.3, count) - 0.3 * off)


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
    """The floor ``(n, 5)`` in front of footprints, `depth` metres deep."""
    zone = advanced(boxes, np.atleast_2d(boxes)[:, 2] + depth / 2)
    zone[:, 2] = depth / 2 - 1e-3
    return zone


def reversed_(boxes: np.ndarray) -> np.ndarray:
    """Footprints ``(n, 5)`` that look the other way."""
    back = boxes.copy()
    back[:, 4] = np.remainder(boxes[:, 4] + 2 * math.pi, 2 * math.pi) - math.pi
    return back


# --- pieces of furniture ----------------------------------------------------------------------------------------------

_LEAST_UNIQUE = 3
# Without a colour of their own: fixtures take the colour of their room, and all units of a kitchen share one.
_FIXED = ("sink", "toilet", "bathtub", "cabinet", "refrigerator", "stove")


class NoRoom(Exception):
    """A required piece does not fit."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A placed model.

    `room`: its index in the plan; `box`: its footprint ``(5,)``; `position` ``(3,)`` of the model's origin; `solid`:
    whether it is an obstacle.
    """

    room: int
    model: Model
    box: np.ndarray
    position: np.ndarray
    solid: bool = True

    @property
    def category(self) -> str:
        """What it is."""
        return self.model.category

    @property
    def name(self) -> str:
        """Colour and category, as in `Instance.name`."""
        return f"{self.model.colour} {self.category}" if self.model.colour else self.category

    @property
    def bottom(self) -> float:
        """Height of its lowest point."""
        return float(self.position[2] + min(part.low[2] for part in self.model.parts))

    @property
    def top(self) -> float:
        """Height of its highest point."""
        return self.bottom + self.model.height


@dataclass
class Furnisher:
    """Builds pieces and places them (mutable); `pieces` are the placed ones."""

    floor: Floor
    rng: np.random.Generator
    habits: dict[str, str] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)

    def make(self, category: str, colour: str | None = None) -> Model:
        """A new model. Without a colour, mostly in the usual one of its kind in this home."""
        seed = int(self.rng.integers(2**31))
        colours = KINDS[category].colours
        if colour is None and colours:
            habit = self.habits.setdefault(category, str(self.rng.choice(colours)))
            colour = habit if self.rng.random() < 0.45 else str(self.rng.choice(colours))
        return replace(build(category, colour, np.random.default_rng(seed)), seed=seed)

    def fits(self, room: int, boxes: np.ndarray, model: Model) -> np.ndarray:
        """The footprints ``(n, 5)`` with room for a model on the floor, and not before a window that it would cover."""
        good = self.floor.fits(room, boxes, (0.0, model.height))
        return good & self.floor.beside_windows(boxes, model.height)

    def open_before(self, room: int, zone: np.ndarray) -> np.ndarray:
        """The pieces of floor ``(n, 5)`` that are free and lie in the room or in those that are open to it."""
        return self.floor.clear(zone) & self.floor.open_inside(room, zone)

    def record(self, model: Model, room: int, box: np.ndarray, z: float = 0.0, solid: bool = True) -> Piece:
        """Add a piece whose place has been checked."""
        self.pieces.append(Piece(room, model, box, np.array([box[0], box[1], z]), solid))
        return self.pieces[-1]

    def set_down(self, group: list[tuple[Model, np.ndarray]], room: int) -> list[Piece] | None:
        """Place models together on the floor if one can still walk everywhere; otherwise None."""
        if not self.floor.put([box for _, box in group], [model.height for model, _ in group]):
            return None
        return [self.record(model, room, box) for model, box in group]

    def settle(
        self, model: Model, room: int, sites: Sites, *, front: float = 0.5, reserve: bool = True
    ) -> Piece | None:
        """Place a model on the best site with `front` metres of free floor before it; None if there is none.

        `reserve` keeps that floor free from then on.
        """
        if not len(sites.boxes):
            return None
        good = self.fits(room, sites.boxes, model)
        if front > 0:
            good &= self.open_before(room, before(sites.boxes, front))
        for place in sites.best(good, 10):
            if done := self.set_down([(model, sites.boxes[place])], room):
                if front > 0 and reserve:
                    self.floor.kept.append(before(sites.boxes[place], front)[0])
                return done[0]
        return None

    def mark(self) -> tuple[np.ndarray, int, int, int, int]:
        """The state, for `back_to`."""
        floor = self.floor
        return floor.near.copy(), len(floor.solid), len(floor.kept), len(floor.around), len(self.pieces)

    def back_to(self, mark: tuple[np.ndarray, int, int, int, int]) -> None:
        """Remove everything placed since `mark`."""
        floor = self.floor
        floor.near = mark[0].copy()
        for things, count in zip((floor.solid, floor.kept, floor.around, self.pieces), mark[1:], strict=True):
            del things[count:]

    def of(self, category: str, room: int | None = None) -> list[Piece]:
        """The pieces of a category, in a room or anywhere."""
        return [p for p in self.pieces if p.category == category and room in (None, p.room)]


def tell_apart(f: Furnisher) -> None:
    """Recolour single pieces, mostly a chair, so that "the red chair" is one of several chairs.

    Afterwards at least three solid pieces have a unique name although their category occurs more than once, and at
    least one name occurs several times. Raises `NoRoom` if that fails.
    """
    chairs = f.of("chair")
    odd = int(f.rng.choice([0, 1, 2], p=[0.12, 0.7, 0.18])) if len(chairs) > 3 else 0
    for i in f.rng.permutation(len(chairs))[:odd]:
        _recolour(f, chairs[i])
    for _ in range(40):
        solid = [piece for piece in f.pieces if piece.solid]
        names, categories = Counter(piece.name for piece in solid), Counter(piece.category for piece in solid)
        unique = [p for p in solid if names[p.name] == 1 and categories[p.category] > 1]
        repeated = [p for p in solid if names[p.name] > 1]
        if len(unique) >= _LEAST_UNIQUE and repeated:
            return
        # At least two chairs stay alike.
        pool = [p for p in repeated if p.category not in _FIXED and (p.category != "chair" or names[p.name] > 2)]
        if not pool:
            break
        _recolour(f, pool[f.rng.integers(len(pool))])
    raise NoRoom("too few pieces to tell apart by colour")


def _recolour(f: Furnisher, piece: Piece) -> None:
    """Build `piece` again in a colour that no other of its category has, if its size stays the same."""
    taken = {other.model.colour for other in f.of(piece.category)}
    colours = [colour for colour in KINDS[piece.category].colours if colour not in taken]
    for colour in f.rng.permutation(colours).tolist():
        model = build(piece.category, colour, np.random.default_rng(piece.model.seed))
        if np.allclose(model.size, piece.model.size, atol=2e-3):
            f.pieces = [replace(piece, model=model) if other is piece else other for other in f.pieces]
            return
