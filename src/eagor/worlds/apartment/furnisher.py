"""Placed pieces of furniture, and the `Furnisher` that places them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from eagor.worlds.apartment.furniture import KINDS, Model, build
from eagor.worlds.apartment.placement import Floor, Sites, before

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
