"""Places: a scene with its ground plan and its renderer, cached while in use."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._values import lazy
from eagor.grids import ErpGrid
from eagor.lab import worlds
from eagor.lab.worlds import ground_of, view_of
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.navmesh import DistanceField
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.queries import COLOURS, Query

APARTMENT = "apartment"
SEEDS = 10_000  # number of apartments
DEVELOPMENT = range(SEEDS // 5)  # the first fifth is for tuning parameters, never for results
LOOK_ROWS = 64  # of the id panoramas that decide visibility, and that `truth` reads
FLOORS = ("floor", "rug")  # categories that one walks on
LEVEL = 0.02  # metres: where nothing is called a floor, it is what lies as high as the ground, to within this
UNTARGETED = (*STRUCTURE, "ceiling lamp", "rug", "painting", "vase", "book", "books", "curtain")  # never targets


@dataclass(frozen=True, eq=False)
class Place:
    """Somewhere to walk and look."""

    scene: Scene | worlds.SimulatedScene
    ground: Ground
    renderer: worlds.View
    _ways: dict[Any, DistanceField] = field(default_factory=dict, init=False, repr=False)  # go when the place goes

    def eye(self, xy: np.ndarray, height: float) -> np.ndarray:
        """The point ``(3,)`` at this height (metres) above the ground at a point ``(2,)``: of a camera, say."""
        return np.array([*xy, height + self.ground.height(xy)])

    def ids(self, position: np.ndarray, world_R_body: np.ndarray, rows: int = LOOK_ROWS) -> np.ndarray:
        """The instance in each direction: an equirectangular image ``(rows, 2 rows)``, -1 for none."""
        return np.asarray(self.renderer.panorama(position, world_R_body, rows, rgb=False, range=False).ids)

    def floor_in(self, ids: np.ndarray, position: np.ndarray, world_R_body: np.ndarray) -> np.ndarray:
        """Which pixels of an image of `ids` ``(rows, 2 rows)``, taken from this pose, show what one walks on, bool.

        That is a floor or a rug; in a scene that names neither what lies as high as the ground under the camera.
        """
        if len(self._floors):
            return np.isin(ids, self._floors)
        frame = self.renderer.panorama(position, world_R_body, len(ids), rgb=False, range=True, ids=False)
        metres = np.asarray(frame.range)
        up = ErpGrid(*ids.shape).directions @ world_R_body[2]  # how far a ray rises per metre
        with np.errstate(invalid="ignore"):  # no hit: infinitely far
            height = position[2] + up * metres - self.ground.height(position[:2])
        return (ids >= 0) & (np.abs(height) < LEVEL)

    @lazy
    def _floors(self) -> np.ndarray:
        return np.flatnonzero([thing.category in FLOORS for thing in self.scene.instances])

    def nameable(self) -> dict[int, Query]:
        """The things with a unique query, "[colour] category", by their index in the scene."""
        things, names = self.scene.instances, {}
        count = Counter(thing.category for thing in things)
        for index, thing in enumerate(things):
            only = count[thing.category] == 1  # the only sofa is called "sofa", one of several chairs has its colour
            if thing.category not in UNTARGETED and (only or thing.colour):
                names[index] = Query(thing.category, None if only else thing.colour)
        twins = Counter(names.values())
        return {index: name for index, name in names.items() if twins[name] == 1}

    def missing(self, rng: np.random.Generator, known: bool = False) -> Query:
        """A query without an answer: an absent category (not if `known`), or a category here in another colour."""
        from eagor.lab.worlds.apartment import CATEGORIES

        here = {thing.category for thing in self.scene.instances} - {*UNTARGETED}
        absent = sorted({*CATEGORIES} - {*UNTARGETED} - here)
        if absent and not (known and here) and (rng.random() < 0.5 or not here):
            return Query(str(rng.choice(absent)))
        category = str(rng.choice(sorted(here)))
        taken = {thing.colour for thing in self.scene.instances if thing.category == category}
        return Query(category, str(rng.choice([colour for colour in COLOURS if colour not in taken])))

    def way_to(self, targets: tuple[int, ...]) -> DistanceField:
        """Geodesic distance to the nearest of the targets' footprints."""
        if targets not in self._ways:
            first, *others = (self.ground.footprint(self.scene.instances[target]) for target in targets)
            self._ways[targets] = first.union(*others) if others else first
        return self._ways[targets]


@lru_cache(maxsize=4)
def load_place(world: str, seed: int, radius: float) -> Place:
    """The scene of this seed in a world that `eagor.lab.worlds.load` finds, with the ground for a body of this radius.

    Raises `WorldError` if there is no such world, or no room to stand in it.
    """
    scene = worlds.load(world)(seed)
    return Place(scene, ground_of(scene, radius), view_of(scene))


def pixels_of(ids: np.ndarray, targets: tuple[int, ...]) -> int:
    """The number of pixels of an id image that show one of the targets."""
    return int(np.isin(ids, targets).sum())
