"""The world ``habitat:SCENE``: a scene of Habitat-Sim for tasks.

SCENE is a GLB file, a ``*.stage_config.json``, a ``*.scene_instance.json``, or a name in a scene dataset. Options
follow it: ``habitat:SCENE?dataset=FILE&storey=2.9``.

- ``dataset``: the ``*.scene_dataset_config.json`` in which Habitat looks SCENE up;
- ``storey``: the height of the floor to walk on, metres, Habitat's y (default: the largest);
- ``up``: ``y`` or ``z``, the axis of a bare GLB file that points up (Habitat takes z, glTF says y);
- ``navmesh``: a ``.navmesh`` file (default: the scene's, if it was made for a body of this radius, or a new one);
- ``body``: metres, the height of a body: the navigation mesh is the one that habitat-lab would use for it (the scene's
  if made with the same settings, else a new one with voxels of 0.05 m); with it ``climb``, the height of steps that it
  climbs, and ``voxel``, the height of voxels (metres, both 0.2 as in habitat-lab);
- ``boxes``: a file of boxes (`eagor.worlds.habitat.semantics`);
- ``gpu``: the GPU's number, -1 for the CPU (default: $EAGOR_HABITAT_GPU, or what the probe finds).

A scene is the same for every seed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from eagor._lazy import lazy
from eagor.worlds import World, WorldOf
from eagor.worlds.habitat.floors import EYE, ROWS, mesh_for, roofed, true_floor
from eagor.worlds.habitat.navmesh import LEVEL, NavMesh, Storey, main_storey
from eagor.worlds.habitat.options import Options, existing, file_of, parse, scene_id_of
from eagor.worlds.habitat.semantics import Box, Things, beside, seen_boxes, things_of
from eagor.worlds.habitat.simulator import Frames, HabitatView, Session, Source, import_habitat
from eagor.worlds.scene import Instance, Room

__all__ = ["WORLD", "HabitatScene", "open_scene"]

RADIUS = 0.18  # metres: of the body for whose ground the floor is found
SPOTS = 40  # places from which the things of a scene are looked at


@dataclass(frozen=True, eq=False)
class HabitatScene:
    """A scene that Habitat-Sim holds: an `eagor.worlds.SimulatedScene`."""

    options: Options
    session: Session
    file: Path | None
    frames: Frames
    things: Things
    storey: float
    source: str
    hash: str
    facts: dict[str, str]

    @property
    def instances(self) -> tuple[Instance, ...]:
        return self.things.instances

    @property
    def rooms(self) -> tuple[Room, ...]:
        return self.things.rooms

    @property
    def zero(self) -> float:
        """Habitat's y of our z = 0."""
        return self.frames.floor

    def view(self) -> HabitatView:
        """The renderer."""
        return self._view

    @lazy
    def _view(self) -> HabitatView:
        return HabitatView(self.session, self.frames, self.things.labels)

    def close(self) -> None:
        """Close the simulator; the next look opens it again."""
        self.session.close()

    def ground(self, radius: float) -> NavMesh:
        """The navigation mesh of the storey for a body of this radius, metres. Raises `WorldError` without room."""
        return _ground(self, radius)

    def sees(self, xy: np.ndarray, thing: Instance, floor: float = 0.0) -> bool:
        """Whether a camera above a point ``(2,)`` of the ground, at this height, sees a thing."""
        ids = self._view.panorama((xy[0], xy[1], floor + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
        index = next((k for k, other in enumerate(self.instances) if other is thing), None)
        return index is None or (ids is not None and bool((ids == index).any()))


@lru_cache(maxsize=8)
def open_scene(text: str) -> HabitatScene:
    """The scene that ``habitat:text`` names. Raises `MissingExtraError`, `WorldError`."""
    options = parse(text)
    file = file_of(options)
    boxes = existing(options.boxes, "the file of boxes")
    scene_id = scene_id_of(options, file)
    dataset = existing(options.dataset, "the scene dataset's configuration")
    session = Session(Source(scene_id, str(dataset) if dataset else "default", options.gpu, str(file or options.scene)))
    sim = session.sim
    name = file.name if file else options.scene
    pathfinder, _ = mesh_for(options, file, sim, RADIUS)
    raw = HabitatView(session, Frames(), None)
    storey = main_storey(pathfinder, lambda feet: roofed(raw, feet), options.storey, name)
    frames = Frames(true_floor(raw, pathfinder, storey, name, options))
    things = things_of(sim, file, boxes, frames, lambda: _seen(session, pathfinder, storey))
    files = [path for path in (file, dataset, boxes, beside(file), _stage_file(sim)) if path is not None]
    facts = {
        "simulator": f"Habitat-Sim {getattr(import_habitat(), '__version__', '')}".strip(),
        "things": things.told,
        "floor": f"{frames.floor:.3f} m (Habitat's y of our z = 0)",
        "storey": f"{storey.level:.2f} m (Habitat's y of the navigation mesh)",
    }
    made = HabitatScene(
        options, session, file, frames, things, storey.level, f"habitat {name}", _digest(files, options, things), facts
    )
    return made


def _seen(session: Session, pathfinder: Any, storey: Storey) -> Mapping[int, Box]:
    """What is seen of each semantic id from places all over the storey, Habitat's world."""
    mesh = NavMesh(pathfinder, storey, Frames(), RADIUS)
    spots = mesh.points[:: max(1, len(mesh.points) // SPOTS)]
    return seen_boxes(session, np.array([mesh.feet(xy) for xy in spots], dtype=np.float64) + np.array([0.0, EYE, 0.0]))


@lru_cache(maxsize=16)
def _ground(scene: HabitatScene, radius: float) -> NavMesh:
    pathfinder, _ = mesh_for(scene.options, scene.file, scene.session.sim, radius)
    raw = HabitatView(scene.session, Frames(), None)
    storey = main_storey(pathfinder, lambda feet: roofed(raw, feet), scene.storey, scene.source)
    # A body of habitat-lab stands on the mesh, and its path counts each difference of height.
    level = LEVEL if scene.options.body is None else 0.0
    found = NavMesh(pathfinder, storey, scene.frames, radius, scene.rooms, None, scene.source, level)
    found.sees = lambda xy, thing: scene.sees(xy, thing, found.height(xy))
    return found


def _stage_file(sim: Any) -> Path | None:
    """The file that Habitat draws, for the scene's digest."""
    try:
        name = str(sim.get_stage_initialization_template().render_asset_handle)
    except Exception:  # scenes without a stage
        return None
    return Path(name) if Path(name).is_file() else None


def _digest(files: list[Path], options: Options, things: Things) -> str:
    body = "" if options.body is None else f"|{options.body}|{options.climb}|{options.voxel}"
    digest = hashlib.sha256(f"{options.storey}|{options.up}|{options.navmesh}{body}".encode())
    for file in dict.fromkeys(files):
        with file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    for thing in things.instances:
        digest.update(f"{thing.category}|{thing.colour}|{thing.room}|{thing.low}|{thing.high};".encode())
    return digest.hexdigest()[:16]


def _world(argument: str) -> World:
    parse(argument)  # complains at once
    make: Callable[[int], HabitatScene] = lambda seed: open_scene(argument)  # noqa: E731
    return make


WORLD = WorldOf(_world, "SCENE, a scene's file or a name in ?dataset=FILE")
