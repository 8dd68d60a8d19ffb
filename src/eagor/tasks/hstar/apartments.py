"""Episodes in H*Bench's format from the built-in apartments: any number of them, with exact boxes.

For each apartment a camera stands somewhere on its floor. Things in sight that a query names uniquely and that are
large enough become targets. The same seed gives the same episodes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eagor.grids import ErpGrid
from eagor.sphere import world_R_body
from eagor.tasks.hstar.data import ANNOTATION, STARTS
from eagor.tasks.hstar.rules import View, level_of
from eagor.tasks.places import APARTMENT, Place, load_place
from eagor.tasks.rules import Camera

ROWS = 128  # of the id image for the boxes: 1.4 degrees
SMALLEST = 12  # pixels of that image
HEIGHT = 1.25  # metres of the camera above the floor
CLEARANCE = 0.4
TRIES = 8


@dataclass(frozen=True, eq=False)
class Spot:
    """A camera in an apartment, and the entries of its annotation.json."""

    name: str
    place: Place
    position: np.ndarray
    yaw: float
    items: tuple[dict[str, Any], ...]


def spot(seed: int, most: int = 4, named: Callable[[Place], Mapping[int, Any]] = Place.nameable) -> Spot:
    """A camera in the apartment of this seed, with at most `most` targets. Raises `WorldError` if there is no room.

    `named`: what may be a target, by index in the scene, and the words for it.
    """
    place = load_place(APARTMENT, seed, Camera().radius)
    rng = np.random.default_rng([seed, 0x5EA])
    best = Spot(f"apartment_{seed:04d}", place, np.zeros(3), 0.0, ())
    for _ in range(TRIES):
        position = np.array([*place.ground.sample(rng, CLEARANCE), HEIGHT])
        yaw = float(rng.uniform(-math.pi, math.pi))
        items = tuple(_items(place, position, yaw, rng, most, named(place)))
        if len(items) > len(best.items):
            best = Spot(best.name, place, position, yaw, items)
        if len(items) == most:
            break
    return best


def write_scene(spot: Spot, folder: Path, rows: int = 512) -> Path | None:
    """Write one published-format scene, `rows` high (0: a grey picture); its folder, or None without a target."""
    from PIL import Image

    if not spot.items:
        return None
    target = folder / spot.name
    target.mkdir(parents=True, exist_ok=True)
    picture = target / f"{spot.name}.png"
    if rows:
        spot.place.save_panorama(spot.position, spot.yaw, rows, picture)
    else:
        Image.new("RGB", (16, 8), (128, 128, 128)).save(picture)
    (target / ANNOTATION).write_text(json.dumps(list(spot.items), indent=1) + "\n", encoding="utf-8")
    return target


def _items(
    place: Place, position: np.ndarray, yaw: float, rng: np.random.Generator, most: int, names: Mapping[int, Any]
) -> Iterator[dict[str, Any]]:
    ids = place.ids(position, world_R_body(yaw), ROWS)
    seen = np.bincount(ids[ids >= 0], minlength=len(place.scene.instances))
    chosen = [index for index in names if seen[index] >= SMALLEST]
    for index in sorted(rng.permutation(chosen)[:most].tolist()):
        left, right, low, high = _box(ids == index)
        item = {"task": f"Find the {names[index]}", "yaw": [left, right], "pitch": [low, high]}
        levels = [level_of(View(float(start), 0.0), (left, right), (low, high)) for start in STARTS]
        yield item | {"initial yaw": list(STARTS), "level": levels}


def _box(mask: np.ndarray) -> tuple[float, float, float, float]:
    """Yaw and pitch ranges, degrees, of the pixels ``(H, W)`` of one thing."""
    height, width = mask.shape
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    gaps = np.diff(np.append(columns, columns[0] + width))
    widest = int(gaps.argmax())
    first, last = columns[(widest + 1) % len(columns)], columns[widest]
    latitudes, degrees = ErpGrid(height, width).latitudes, 360.0 / width
    left, right = ((edge * degrees + 180.0) % 360.0 for edge in (first, last + 1))
    high = math.degrees(latitudes[rows[0]]) + 90.0 / height
    low = math.degrees(latitudes[rows[-1]]) - 90.0 / height
    return round(float(left), 2), round(float(right), 2), round(low, 2), round(high, 2)
