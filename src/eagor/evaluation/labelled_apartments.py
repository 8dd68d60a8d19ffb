"""Labelled panoramas of the built-in apartments, from what the simulator knows."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from eagor.errors import EagorError
from eagor.grids import ErpGrid
from eagor.perception.vlm.labelled import Labelled, cap_radius
from eagor.sphere import unit, world_R_body
from eagor.tasks.episodes import Slot
from eagor.tasks.places import APARTMENT, DEVELOPMENT, Place, load_place
from eagor.tasks.rules import Camera

PER_PLACE = 4  # panoramas in an apartment
TRIES = 12  # places to stand that are looked at for one panorama
SIZES = (math.radians(3), math.radians(35))  # angular radii of the things that are asked for
LOOK_ROWS = 128  # of the id panoramas that labels are measured in


def apartment_labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    """`count` panoramas of `rows` rows from development apartments, each with one thing that a query singles out.

    Raises `EagorError` where the seeds reach apartments that results are taken from.
    """
    last = seed + (count - 1) // PER_PLACE
    if count < 1 or seed not in DEVELOPMENT or last not in DEVELOPMENT:
        raise EagorError(
            f"{count} panoramas from apartment {seed} on reach apartment {last}; wanted all between "
            f"{DEVELOPMENT.start} and {DEVELOPMENT.stop - 1}: the others are for results"
        )
    return _labels(count, seed, rows)


def _labels(count: int, seed: int, rows: int) -> Iterator[Labelled]:
    camera, grid = Camera(), ErpGrid(LOOK_ROWS, 2 * LOOK_ROWS)
    for number in range(count):
        apartment, index = divmod(number, PER_PLACE)
        place = load_place(APARTMENT, seed + apartment, camera.radius)
        rng = Slot("labels", APARTMENT, seed + apartment, index, number).rng("labels")
        found = _one(place, grid, camera.height, rows, rng)
        if found is not None:
            yield found


def _one(place: Place, grid: ErpGrid, height: float, rows: int, rng: np.random.Generator) -> Labelled | None:
    names = place.nameable()
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng), height])
        turned = world_R_body(float(rng.uniform(-math.pi, math.pi)))
        ids = place.ids(position, turned, LOOK_ROWS)
        shown = {thing: grid.weights * (ids == thing) for thing in names}
        sizes = {thing: cap_radius(float(share.sum())) for thing, share in shown.items()}
        fit = [thing for thing, size in sizes.items() if SIZES[0] <= size <= SIZES[1]]
        if not fit:
            continue
        thing = int(rng.choice(fit))
        centre = unit((shown[thing][..., None] * grid.directions).sum(axis=(0, 1)))
        picture = place.renderer.panorama(position, turned, rows, range=False, ids=False).rgb
        assert picture is not None
        return Labelled(picture, str(names[thing]), centre, sizes[thing])
    return None
