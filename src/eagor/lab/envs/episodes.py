"""Episodes, the same for every method, and how those of a run are numbered.

N episodes with seed S use the apartments S, S + 1, ..., `PER_PLACE` in each. All randomness derives from an episode's
identity, so any part of a run can be played alone.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.lab.envs.places import APARTMENT, SEEDS, Place
from eagor.lab.worlds import FILES

PER_PLACE = 5


@dataclass(frozen=True)
class EpisodeSpec:
    """A place in a run: the `number`-th episode of the run, the `index`-th in the world of this `seed`."""

    task: str
    world: str
    seed: int
    index: int
    number: int

    @property
    def id(self) -> str:
        """Stable name: seed of the apartment, and index of the episode in it."""
        return f"{self.seed}-{self.index}"

    def rng(self, purpose: str) -> np.random.Generator:
        """An independent generator for each purpose, wherever the file of the scene is."""
        world, file = self.world, self.world.removeprefix("habitat:").partition("?")[0]
        if (file != world or Path(file).suffix.lower() in FILES) and Path(file).is_file():
            state = Path(file).stat()
            world = world.replace(file, _digest(file, state.st_mtime_ns, state.st_size), 1)
        name = f"{self.task}/{world}/{self.id}/{purpose}"
        return np.random.default_rng([zlib.crc32(name.encode()), self.seed, self.index])


@dataclass(frozen=True)
class Episode:
    """Where it happens, what to look for, and where the body starts.

    - `targets`: ids of the things that the query names; `start`: x, y in metres; `yaw`: radians; `stratum`: kind of the
      episode, for tables; `shortest`: geodesic metres from the start to the nearest target's footprint, inf if no path
      leads there (things on walls can be targets, too).
    - Of a body that is carried: `route`, rows of x, y, yaw, the first is the start; `legs`: which leg each belongs to.
    - Of a ball: x, y, z of its centre at each step (`balls`, None while it is away), its `radius` and its `colour`.
    """

    spec: EpisodeSpec
    scene: str
    scene_hash: str
    query: str
    targets: tuple[int, ...]
    start: tuple[float, float]
    yaw: float
    shortest: float
    stratum: dict[str, Any] = field(default_factory=dict)
    route: tuple[tuple[float, float, float], ...] = ()
    legs: tuple[str, ...] | None = None
    balls: tuple[tuple[float, float, float] | None, ...] | None = None
    radius: float | None = None
    colour: str | None = None

    def as_json(self) -> dict[str, Any]:
        """For records and reports, without what its spec brings back and what it has not."""
        known = {"id": self.spec.id, "seed": self.spec.seed, "world": self.spec.world, "index": self.spec.index}
        rest = {k: value for k, value in asdict(self).items() if k not in ("spec", "route") and value is not None}
        return known | rest | {"shortest": self.shortest if math.isfinite(self.shortest) else None}


def episode_specs(task: str, count: int, seed: int, world: str = APARTMENT) -> Iterator[EpisodeSpec]:
    """The specs of a run. Raises `WorldError` if there are not enough apartments."""
    if count < 1:
        raise WorldError(f"{count} episodes; wanted 1 or more")
    places = (count + PER_PLACE - 1) // PER_PLACE
    if not 0 <= seed <= SEEDS - places:
        raise WorldError(
            f"{count} episodes from seed {seed} need apartments {seed} to {seed + places - 1}; "
            f"there are 0 to {SEEDS - 1}"
        )
    for number in range(count):
        yield EpisodeSpec(task, world, seed + number // PER_PLACE, number % PER_PLACE, number)


def choose_target(place: Place, rng: np.random.Generator) -> Iterator[tuple[int, str]]:
    """The nameable things of a place in random order, with their names; every category is equally likely."""
    names, things = place.nameable(), place.scene.instances
    for category in rng.permutation(sorted({things[index].category for index in names})):
        for index in rng.permutation([index for index in names if things[index].category == category]):
            yield int(index), str(names[int(index)])


@lru_cache(maxsize=64)
def _digest(file: str, *changes: int) -> str:
    """Of the content of a file, with what changes with it."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()
