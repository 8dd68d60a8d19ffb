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
- ``boxes``: a file of boxes (`eagor.lab.worlds.habitat.semantics`);
- ``gpu``: the GPU's number, -1 for the CPU (default: $EAGOR_HABITAT_GPU, or what the probe finds).

A scene is the same for every seed.

A mesh floats above the floor by up to a voxel, and Habitat's heights have no zero. So the floor is what the camera sees
below points of the mesh. This also shows whether mesh and scene have the same way up.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import math
import shutil
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from eagor._values import lazy
from eagor.errors import WorldError
from eagor.lab.worlds import World, WorldOf
from eagor.lab.worlds.glb import LAB_VOXEL, voxel_for
from eagor.lab.worlds.habitat.navmesh import LEVEL, HabitatNavMesh, Storey, main_storey
from eagor.lab.worlds.habitat.semantics import Box, Things, beside, seen_boxes, things_of
from eagor.lab.worlds.habitat.simulator import Frames, HabitatView, Session, Source, import_habitat
from eagor.lab.worlds.objectnav import LAB_CLIMB, LAB_SLOPE
from eagor.lab.worlds.scene import Instance, Room

NUMBERS = {"storey": float, "gpu": int, "body": float, "climb": float, "voxel": float}
SCENES = (".glb", ".gltf", ".ply", ".stage_config.json", ".scene_instance.json")


@dataclass(frozen=True)
class Options:
    """What follows ``habitat:``, see `eagor.lab.worlds.habitat.world`."""

    scene: str
    dataset: str | None = None
    storey: float | None = None
    up: str | None = None
    navmesh: str | None = None
    boxes: str | None = None
    gpu: int | None = None
    body: float | None = None
    climb: float = LAB_CLIMB
    voxel: float = LAB_VOXEL


def parse(text: str) -> Options:
    """The options in ``SCENE?name=value&name=value``. Raises `WorldError`."""
    scene, _, rest = text.partition("?")
    values: dict[str, Any] = {}
    known = [each.name for each in fields(Options)][1:]
    for part in filter(None, rest.split("&")):
        name, equals, value = part.partition("=")
        if name not in known or not equals or not value:
            raise WorldError(f"habitat:{text} has the option {part!r}; wanted {'=..., '.join(known)}=...")
        try:
            values[name] = NUMBERS.get(name, str)(value)
        except ValueError:
            raise WorldError(f"habitat:{text}: {name} = {value!r}; wanted a number") from None
    if not math.isfinite(values.get("storey", 0.0)):
        raise WorldError(f"habitat:{text}: storey = {values['storey']}; wanted finite metres")
    for name in ("body", "climb", "voxel"):
        if not 0 < values.get(name, 1.0) < math.inf:
            raise WorldError(f"habitat:{text}: {name} = {values[name]}; wanted finite metres above 0")
    if "body" not in values and not values.keys().isdisjoint({"climb", "voxel"}):
        raise WorldError(
            f"habitat:{text} has no body; climb and voxel belong to body=HEIGHT, habitat-lab's mesh for it"
        )
    if values.get("up", "y") not in ("y", "z"):
        raise WorldError(f"habitat:{text}: up = {values['up']!r}; wanted y or z")
    return Options(scene, **values)


def file_of(options: Options) -> Path | None:
    """The file of the scene, None for a name in a dataset. Raises `WorldError` if it is missing."""
    if not options.scene:
        raise WorldError("the world 'habitat' wants habitat:SCENE, with a file or a name in a dataset")
    file = Path(options.scene).expanduser()
    if file.is_file():
        return file.resolve()
    if options.dataset is None:
        kind = "a folder" if file.is_dir() else "missing"
        raise WorldError(
            f"the scene {options.scene!r} is {kind}; wanted a file ({', '.join(f'*{end}' for end in SCENES)}), or a "
            "name in a dataset: habitat:NAME?dataset=FILE.scene_dataset_config.json"
        )
    return None


def existing(name: str | None, what: str) -> Path | None:
    """The file `name`, absolute; None if none is named. Raises `WorldError` if it is missing."""
    if name is None:
        return None
    file = Path(name).expanduser()
    if not file.is_file():
        raise WorldError(f"{what} {name!r} is missing; give the path of an existing file")
    return file.resolve()


def scene_id_of(options: Options, file: Path | None) -> str:
    """What Habitat is asked for: a name, the file, or a stage configuration for it.

    Habitat takes axes and ids of a bare GLB file from a stage configuration alone. One beside the file is used as it
    is. One is written, for this process, if the axes are given, or for HM3D's files without their dataset:
    ``NAME.basis.glb`` with ``NAME.semantic.glb`` and ``NAME.semantic.txt`` beside.
    """
    if file is None:
        return options.scene
    if file.suffix.lower() not in (".glb", ".gltf") or (options.dataset is not None and options.up is None):
        return str(file)
    stage = stage_beside(file)
    if options.up is None and stage.is_file():
        return str(stage)
    stem = file.name.split(".")[0]
    painted, named = (file.with_name(f"{stem}.semantic.{kind}") for kind in ("glb", "txt"))
    annotated = painted.is_file() and named.is_file()
    if options.up is None and not annotated:
        return str(file)
    known: dict[str, Any] = {"shader_type": "flat"}
    if stage.is_file():
        known = json.loads(stage.read_text(encoding="utf-8"))
    up, front = ([0, 1, 0], [0, 0, -1]) if options.up == "y" else ([0, 0, 1], [0, 1, 0])
    known |= {"render_asset": str(file), "collision_asset": str(file), "up": up, "front": front}
    if annotated:
        known |= {"semantic_asset": str(painted), "semantic_descriptor_filename": str(named)}
        known |= {"has_semantic_textures": True, "semantic_up": up, "semantic_front": front}
    folder = Path(tempfile.mkdtemp(prefix="eagor-habitat-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    made = folder / stage.name
    made.write_text(json.dumps(known), encoding="utf-8")
    return str(made)


def stage_beside(file: Path) -> Path:
    """Where the stage configuration of a GLB file would lie."""
    return file.with_suffix(".stage_config.json")


def is_bare(options: Options) -> bool:
    """Whether nothing but Habitat's default says which way is up."""
    file = Path(options.scene).expanduser()
    glb = file.suffix.lower() in (".glb", ".gltf")
    return glb and options.up is None and options.dataset is None and not stage_beside(file).is_file()


# --- the navigation mesh for a body, and the true floor below it, looked at from above --------------------------------

HEIGHT, CLIMB = 1.5, 0.2  # metres: of a body, and of the steps that it climbs (Habitat's defaults)
CELL, CELL_HEIGHT = 0.05, 0.05  # metres: of a new mesh's voxels; Habitat's own height is 0.2, four times as coarse
EYE = 1.25  # metres above the ground from which things and floors are looked at
ROWS = 64  # of these panoramas
FLAT = 0.02  # metres: a floor this close to y = 0 is meant to be there
SUNK = 0.4  # metres between the mesh and what is below it that are not the mesh's own roughness
TALL = 4.5  # metres from the floor to the ceiling, beyond which a scene may lie on its side
NARROW = 3.5  # metres: a scene that is narrower than this and than it is high may lie on its side, too


def mesh_for(options: Options, file: Path | None, sim: Any, radius: float) -> Any:
    """A PathFinder for a body of this radius. Raises `WorldError`."""
    habitat_sim = import_habitat()
    given = existing(options.navmesh, "the navigation mesh")
    if given is not None:
        found = habitat_sim.PathFinder()
        if not found.load_nav_mesh(str(given)) or not found.is_loaded:
            raise WorldError(f"{given} is no navigation mesh that Habitat-Sim reads; wanted what save_nav_mesh writes")
        return found
    settings = settings_for(habitat_sim, options, file, radius)
    for own in (sim.pathfinder, _beside(habitat_sim, file)):
        if own is not None and own.is_loaded and _fits(own.nav_mesh_settings, settings, options):
            return own
    found = habitat_sim.PathFinder()
    if not sim.recompute_navmesh(found, settings) or not found.is_loaded:
        raise WorldError(
            f"Habitat-Sim finds no ground for a body of radius {radius:g} m in {options.scene}; is it the right way up "
            "(habitat:SCENE?up=y or ?up=z), in metres, and complete?"
        )
    return found


def settings_for(habitat_sim: Any, options: Options, file: Path | None, radius: float) -> Any:
    """Habitat's NavMeshSettings: those of habitat-lab for `Options.body`, otherwise finer ones."""
    settings = habitat_sim.NavMeshSettings()
    settings.set_defaults()
    settings.agent_radius = radius
    if options.body is not None:
        # habitat-lab's `default_agent_navmesh`: what is not named is Habitat's default, static objects do not count.
        settings.agent_height, settings.agent_max_climb = options.body, options.climb
        settings.cell_height, settings.agent_max_slope = options.voxel, LAB_SLOPE
        settings.include_static_objects = False
        return settings
    settings.cell_size, settings.cell_height = voxel_for(radius, CELL), CELL_HEIGHT
    settings.agent_height, settings.agent_max_climb = HEIGHT, CLIMB
    wanted = file.with_suffix(".navmesh.json") if file is not None else None
    if wanted is not None and wanted.is_file():
        for name, value in json.loads(wanted.read_text(encoding="utf-8")).items():
            if hasattr(settings, name):
                setattr(settings, name, value)
    settings.agent_radius = radius
    settings.include_static_objects = True
    return settings


def _fits(own: Any, wanted: Any, options: Options) -> bool:
    """Whether a scene's own mesh is used: habitat-lab takes it only if all of its settings are those wanted."""
    return own == wanted if options.body is not None else abs(own.agent_radius - wanted.agent_radius) < 1e-3


def _beside(habitat_sim: Any, file: Path | None) -> Any:
    """The mesh in ``<scene>.navmesh``, None if there is none that can be read."""
    place = None if file is None else file.with_suffix(".navmesh")
    if place is None or not place.is_file():
        return None
    found = habitat_sim.PathFinder()
    return found if found.load_nav_mesh(str(place)) else None


def _looks(view: HabitatView, feet: np.ndarray) -> np.ndarray:
    """Metres ``(n, 2)`` up and down from the eye above points ``(n, 3)`` of Habitat's world."""
    found = []
    for point in view.frames.from_habitat(feet):
        metres = view.panorama(point + np.array([0.0, 0.0, EYE]), np.eye(3), ROWS, rgb=False, ids=False).range
        assert metres is not None
        found.append(np.median(metres[[0, -1]], axis=1) * math.cos(math.pi / (2 * ROWS)))
    return np.array(found).reshape(-1, 2)


def _check_upright(name: str, height: float, sim: Any, up: str | None) -> None:
    """Judge whether the scene that `sim` has opened, with rooms of this height, seems to lie on its side.

    Raises `WorldError` if nobody has said which way is up; who has said it is warned.
    """
    box = sim.get_active_scene_graph().get_root_node().cumulative_bb
    extent = np.array(box.max, dtype=np.float64) - np.array(box.min, dtype=np.float64)  # x, y (up), z of its world
    narrow, upwards = float(extent[[0, 2]].min()), float(extent[1])
    if not (TALL < height < math.inf or (narrow < NARROW and narrow < upwards)):
        return
    seems = (
        f"{name} seems to lie on its side (it is {extent[0]:.1f} x {extent[2]:.1f} m large and {upwards:.1f} m high)"
    )
    if up is None:
        raise WorldError(
            f"{seems}: Habitat takes z for up in a bare GLB file, glTF says y; say which with habitat:SCENE?up=y or "
            "?up=z"
        )
    warnings.warn(f"{seems} with up={up}; if it does, say up={'z' if up == 'y' else 'y'}", UserWarning, stacklevel=2)


def roofed(view: HabitatView, feet: np.ndarray) -> float:
    """The share of points of the mesh with something above them."""
    return float(np.isfinite(_looks(view, feet)[:, 0]).mean()) if len(feet) else 0.0


def true_floor(view: HabitatView, mesh: HabitatNavMesh, options: Options) -> float:
    """The height of the true floor, Habitat's y: what lies below points of the mesh.

    Raises `WorldError` if the mesh does not lie on what is drawn, or if the scene seems to lie on its side and nothing
    says which way is up.
    """
    level = np.abs(mesh.surface.heights[mesh.free] - mesh.surface.storey.level) <= 0.1
    spots = mesh.points[level][:: max(1, int(level.sum()) // 25)]
    feet = np.array([mesh.feet(xy) for xy in spots]).reshape(-1, 3)
    above, below = _looks(view, feet).T
    gap = below - EYE  # the mesh floats above the floor
    if not (np.abs(gap) < SUNK).mean() > 0.5:
        raise WorldError(
            f"under most of the navigation mesh of {mesh.source} there is no floor within {SUNK:g} m: mesh and scene "
            "do not have the same way up, or belong to different scenes; try habitat:SCENE?up=y or ?up=z, or leave out "
            "navmesh"
        )
    if is_bare(options) or options.up is not None:
        _check_upright(mesh.source, float(np.median(above)) + EYE, view.session.sim, options.up)
    floor = float(np.median(feet[:, 1] - gap))
    return 0.0 if abs(floor) < FLAT else floor


# --- the world ``habitat:SCENE`` --------------------------------------------------------------------------------------

RADIUS = 0.18  # metres: of the body for whose ground the floor is found
SPOTS = 40  # places from which the things of a scene are looked at


@dataclass(frozen=True, eq=False)
class HabitatScene:
    """A scene that Habitat-Sim holds: an `eagor.lab.worlds.SimulatedScene`."""

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
        return self.frames.floor

    def view(self) -> HabitatView:
        return self._view

    @lazy
    def _view(self) -> HabitatView:
        return HabitatView(self.session, self.frames, self.things.labels)

    def close(self) -> None:
        self.session.close()

    def ground(self, radius: float) -> HabitatNavMesh:
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
    raw = HabitatView(session, Frames(), None)
    mesh = HabitatNavMesh(*_storey(options, file, raw, RADIUS, options.storey, name), Frames(), RADIUS, source=name)
    frames = Frames(true_floor(raw, mesh, options))
    things = things_of(sim, file, boxes, frames, lambda: _seen(session, mesh))
    files = [path for path in (file, dataset, boxes, beside(file), _stage_file(sim)) if path is not None]
    facts = {
        "simulator": f"Habitat-Sim {getattr(import_habitat(), '__version__', '')}".strip(),
        "things": things.told,
        "floor": f"{frames.floor:.3f} m (Habitat's y of our z = 0)",
        "storey": f"{mesh.surface.storey.level:.2f} m (Habitat's y of the navigation mesh)",
    }
    digest = _digest(files, options, things)
    storey = mesh.surface.storey.level
    return HabitatScene(options, session, file, frames, things, storey, f"habitat {name}", digest, facts)


def _storey(
    options: Options, file: Path | None, raw: HabitatView, radius: float, height: float | None, source: str
) -> tuple[Any, Storey]:
    """The navigation mesh for a body of this radius, and its storey at this `height`, or its main one."""
    pathfinder = mesh_for(options, file, raw.session.sim, radius)
    return pathfinder, main_storey(pathfinder, lambda feet: roofed(raw, feet), height, source)


def _seen(session: Session, mesh: HabitatNavMesh) -> Mapping[int, Box]:
    """What is seen of each semantic id from places all over a mesh, Habitat's world."""
    spots = mesh.points[:: max(1, len(mesh.points) // SPOTS)]
    return seen_boxes(session, np.array([mesh.feet(xy) for xy in spots], dtype=np.float64) + np.array([0.0, EYE, 0.0]))


@lru_cache(maxsize=16)
def _ground(scene: HabitatScene, radius: float) -> HabitatNavMesh:
    raw = HabitatView(scene.session, Frames(), None)
    on_storey = _storey(scene.options, scene.file, raw, radius, scene.storey, scene.source)
    # A body of habitat-lab stands on the mesh, and its path counts each difference of height.
    level = LEVEL if scene.options.body is None else 0.0
    found = HabitatNavMesh(*on_storey, scene.frames, radius, scene.rooms, scene.source, level)
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
    return lambda seed: open_scene(argument)


WORLD = WorldOf(_world, "SCENE, a scene's file or a name in ?dataset=FILE")
