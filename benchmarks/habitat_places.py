"""An apartment in our world and in Habitat-Sim, for `habitat_comparison.py` and `habitat_tasks.py`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from eagor import worlds
from eagor.tasks.places import Place
from eagor.worlds import ground_of, view_of
from eagor.worlds.apartment import generate
from eagor.worlds.glb import export_glb
from eagor.worlds.ground import Ground
from eagor.worlds.render import Renderer

RADIUS = 0.18  # metres: of the body


@dataclass(frozen=True, eq=False)
class Both:
    """An apartment in both worlds. `world`: the name of the second."""

    seed: int
    ours: Place
    theirs: Place
    world: str


def need_habitat() -> None:
    """End the process, with a sentence, where Habitat-Sim is not installed."""
    if find_spec("habitat_sim") is None:
        print("this compares with Habitat-Sim, which is not installed here (docs/how-to/habitat.md says how to get it)")
        sys.exit(0)


def opened(seed: int, folder: Path) -> Both:
    """The apartment of this seed, ours and in Habitat-Sim: exported to a GLB file with ids, and opened from it."""
    scene = generate(seed)
    file = export_glb(scene, folder / f"apartment{seed:04d}.glb", radius=RADIUS, annotated=True)
    name = f"habitat:{file}"
    held = worlds.load(name)(seed)
    theirs = Place(held, ground_of(held, RADIUS), view_of(held))
    return Both(seed, Place(scene, Ground.from_scene(scene, radius=RADIUS), Renderer(scene)), theirs, name)


def free_in_both(both: Both, rng: np.random.Generator, clearance: float = 0.1) -> np.ndarray:
    """A random point ``(2,)`` on which a body can stand in both."""
    while True:
        point = both.ours.ground.sample(rng, RADIUS + clearance)
        if bool(both.theirs.ground.is_free(point)):
            return point
