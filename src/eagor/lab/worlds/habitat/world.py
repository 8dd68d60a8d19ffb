"""The world ``habitat:SCENE``: a scene of Habitat-Sim for tasks.

SCENE is a GLB file, a ``*.stage_config.json``, a ``*.scene_instance.json``, or a name in a scene dataset. Options
follow it: ``habitat:SCENE?dataset=FILE&storey=2.9``.

- ``dataset``: the ``*.scene_dataset_config.json`` in which Habitat looks SCENE up;
- ``storey``: the height of the floor to walk on, metres, Habitat's y (default: the largest);
- ``up``: ``y`` or ``z``, the axis of a bare GLB file that points up (Habitat takes z, glTF says y);
- ``gpu``: the GPU's number, -1 for the CPU (default: what the probe finds);
- ``body``: metres, the height of a body: the navigation mesh is the one that habitat-lab would use for it (the scene's
  if made with the same settings, else a new one with voxels of 0.05 m); with it ``climb``, the height of steps that it
  climbs, and ``voxel``, the height of voxels (metres, both 0.2 as in habitat-lab).

A scene is the same for every seed. Its navigation mesh is ``<scene>.navmesh`` beside the file if that was made for the
wanted body, else a new one. A mesh floats above the floor by up to a voxel, and Habitat's heights have no zero. So the
floor is what the camera sees below points of the mesh.

The named things of a scene are those of ``<scene>.semantic.json`` beside its file (`export_glb`), or of Habitat's own
semantic scene (HM3D, MP3D, Gibson, Replica), or the nodes of the GLB file (`name_from_nodes`). Of the second, ids
decide which thing a pixel shows; otherwise it is the smallest box that contains the point.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import math
import shutil
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds import World, WorldOf
from eagor.lab.worlds.glb import LAB_VOXEL, import_glb, read_semantics, voxel_for
from eagor.lab.worlds.habitat import (
    Frames,
    HabitatView,
    Session,
    Source,
    euclidean,
    import_habitat,
    mesh_settings,
    read_category,
)
from eagor.lab.worlds.habitat.navmesh import LEVEL, HabitatNavMesh, main_storey
from eagor.lab.worlds.scene import Instance, Room

LAB_CLIMB, LAB_SLOPE = 0.2, 45.0  # metres and degrees: what habitat-lab's bodies climb by default
NUMBERS = {"storey": float, "gpu": int, "body": float, "climb": float, "voxel": float}
GLB = (".glb", ".gltf")


@dataclass(frozen=True)
class Options:
    """What follows ``habitat:``, see `eagor.lab.worlds.habitat.world`."""

    scene: str
    dataset: str | None = None
    storey: float | None = None
    up: str | None = None
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
        name, _, value = part.partition("=")
        if name not in known or not value:
            raise WorldError(f"habitat:{text} has the option {part!r}; wanted {'=..., '.join(known)}=...")
        try:
            values[name] = NUMBERS.get(name, str)(value)
        except ValueError:
            raise WorldError(f"habitat:{text}: {name} = {value!r}; wanted a number") from None
        if name in ("body", "climb", "voxel") and not 0 < values[name] < math.inf:
            raise WorldError(f"habitat:{text}: {name} = {values[name]}; wanted finite metres above 0")
    if not math.isfinite(values.get("storey", 0.0)):
        raise WorldError(f"habitat:{text}: storey = {values['storey']}; wanted finite metres")
    if "body" not in values and not values.keys().isdisjoint({"climb", "voxel"}):
        raise WorldError(
            f"habitat:{text} has no body; climb and voxel belong to body=HEIGHT, habitat-lab's mesh for it"
        )
    if values.get("up", "y") not in ("y", "z"):
        raise WorldError(f"habitat:{text}: up = {values['up']!r}; wanted y or z")
    return Options(scene, **values)


def file_of(options: Options) -> Path | None:
    """The file of the scene, None for a name in a dataset. Raises `WorldError` if one of the two is missing."""
    if not options.scene:
        raise WorldError("the world 'habitat' wants habitat:SCENE, with a file or a name in a dataset")
    if options.dataset and not Path(options.dataset).expanduser().is_file():
        raise WorldError(f"the scene dataset's configuration {options.dataset!r} is missing; give the path of a file")
    file = Path(options.scene).expanduser()
    if not file.is_file() and not options.dataset:
        raise WorldError(
            f"the scene {options.scene!r} is {'a folder' if file.is_dir() else 'missing'}; wanted a file (*.glb, "
            "*.gltf, *.ply, *.stage_config.json, *.scene_instance.json), or a name in a dataset: "
            "habitat:NAME?dataset=FILE.scene_dataset_config.json"
        )
    return file.resolve() if file.is_file() else None


def scene_id_of(options: Options, file: Path | None) -> str:
    """What Habitat is asked for: a name, the file, or a stage configuration for it.

    Habitat takes the axes of a bare GLB file from a stage configuration alone: from one beside the file, or, if the
    axes are given, from one that is written for this process.
    """
    if file is None:
        return options.scene
    stage, bare = file.with_suffix(".stage_config.json"), file.suffix.lower() in GLB
    if not bare or options.up is None:
        return str(stage if bare and options.dataset is None and stage.is_file() else file)
    up, front = ([0, 1, 0], [0, 0, -1]) if options.up == "y" else ([0, 0, 1], [0, 1, 0])
    known = json.loads(stage.read_text(encoding="utf-8")) if stage.is_file() else {"shader_type": "flat"}
    known |= {"render_asset": str(file), "collision_asset": str(file), "up": up, "front": front}
    folder = Path(tempfile.mkdtemp(prefix="eagor-habitat-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    made = folder / stage.name
    made.write_text(json.dumps(known), encoding="utf-8")
    return str(made)


# --- the navigation mesh for a body -----------------------------------------------------------------------------------


def mesh_for(options: Options, file: Path | None, sim: Any, radius: float) -> Any:
    """A PathFinder for a body of this radius. Raises `WorldError`."""
    pathfinder = import_habitat().PathFinder
    own = [sim.pathfinder]
    if file is not None and file.with_suffix(".navmesh").is_file():
        own.append(pathfinder())
        own[-1].load_nav_mesh(str(file.with_suffix(".navmesh")))
    settings = settings_for(options, file, radius)
    for mesh in own:
        if mesh is None or not mesh.is_loaded:
            continue
        # habitat-lab takes a scene's own mesh only if all of its settings are those wanted.
        its, lab = mesh.nav_mesh_settings, options.body is not None
        if (lab and its == settings) or (not lab and abs(its.agent_radius - radius) < 1e-3):
            return mesh
    found = pathfinder()
    if not sim.recompute_navmesh(found, settings) or not found.is_loaded:
        raise WorldError(
            f"Habitat-Sim finds no ground for a body of radius {radius:g} m in {options.scene}; is it the right way up "
            "(habitat:SCENE?up=y or ?up=z), in metres, and complete?"
        )
    return found


def settings_for(options: Options, file: Path | None, radius: float) -> Any:
    """Habitat's NavMeshSettings: those of habitat-lab for `Options.body`, otherwise finer ones."""
    if options.body is not None:
        # habitat-lab's `default_agent_navmesh`: what is not named is Habitat's default, static objects do not count.
        lab = {"agent_height": options.body, "agent_max_climb": options.climb, "cell_height": options.voxel}
        lab |= {"agent_max_slope": LAB_SLOPE, "agent_radius": radius, "include_static_objects": False}
        return mesh_settings(lab)
    finer = {"cell_size": voxel_for(radius, 0.05), "cell_height": 0.05}  # Habitat's own are 0.2 m high
    finer |= {"agent_height": 1.5, "agent_max_climb": 0.2}
    named = None if file is None else file.with_suffix(".navmesh.json")
    if named is not None and named.is_file():
        finer |= json.loads(named.read_text(encoding="utf-8"))
    return mesh_settings(finer | {"agent_radius": radius, "include_static_objects": True})


# --- the true floor below a mesh, looked at from above ----------------------------------------------------------------

EYE = 1.25  # metres above the ground from which things and floors are looked at
ROWS = 64  # of these panoramas
FLAT = 0.02  # metres: a floor this close to y = 0 is meant to be there
SUNK = 0.4  # metres between the mesh and what is below it that are not the mesh's own roughness
TALL = 4.5  # metres from the floor to the ceiling, beyond which a scene may lie on its side
NARROW = 3.5  # metres: a scene that is narrower than this and than it is high may lie on its side, too


def looks(session: Session, feet: np.ndarray) -> np.ndarray:
    """Metres ``(n, 2)`` up and down from the eye above points ``(n, 3)`` of Habitat's world."""
    found = []
    for point in feet:
        metres = euclidean(session.look(("depth",), ROWS, point + np.array([0.0, EYE, 0.0]), np.eye(3))["depth"])
        found.append(np.median(metres[[0, -1]], axis=1) * math.cos(math.pi / (2 * ROWS)))
    return np.array(found).reshape(-1, 2)


def true_floor(session: Session, mesh: HabitatNavMesh, options: Options) -> float:
    """The height of the true floor, Habitat's y: what lies below points of the mesh.

    Raises `WorldError` if the mesh does not lie on what is drawn, or if the scene seems to lie on its side and nothing
    says which way is up.
    """
    level = np.abs(mesh.heights[mesh.free] - mesh.storey.level) <= 0.1
    spots = mesh.points[level][:: max(1, int(level.sum()) // 25)]
    feet = np.array([mesh.feet(xy) for xy in spots], dtype=np.float64).reshape(-1, 3)
    above, below = looks(session, feet).T
    gap = below - EYE  # the mesh floats above the floor
    if not (np.abs(gap) < SUNK).mean() > 0.5:
        raise WorldError(
            f"under most of the navigation mesh of {mesh.source} there is no floor within {SUNK:g} m: mesh and scene "
            "do not have the same way up, or belong to different scenes; try habitat:SCENE?up=y or ?up=z, or remove "
            "the .navmesh beside the scene"
        )
    _check_upright(mesh.source, float(np.median(above)) + EYE, session, options)
    floor = float(np.median(feet[:, 1] - gap))
    return 0.0 if abs(floor) < FLAT else floor


def _check_upright(name: str, height: float, session: Session, options: Options) -> None:
    """Judge whether the scene, with rooms of this height, seems to lie on its side.

    Raises `WorldError` if nothing but Habitat's default says which way is up; who has said it is warned.
    """
    bare = session.source.dataset == "default" and session.source.scene_id.lower().endswith(GLB)
    box = session.sim.get_active_scene_graph().get_root_node().cumulative_bb
    wide, high, deep = np.array(box.max, dtype=np.float64) - np.array(box.min, dtype=np.float64)
    narrow = min(wide, deep)
    if not (TALL < height < math.inf or (narrow < NARROW and narrow < high)) or not (bare or options.up):
        return
    seems = f"{name} seems to lie on its side (it is {wide:.1f} x {deep:.1f} m large and {high:.1f} m high)"
    if options.up is None:
        raise WorldError(
            f"{seems}: Habitat takes z for up in a bare GLB file, glTF says y; say which with habitat:SCENE?up=y or "
            "?up=z"
        )
    other = "z" if options.up == "y" else "y"
    warnings.warn(f"{seems} with up={options.up}; if it does, say up={other}", UserWarning, stacklevel=2)


# --- the named things -------------------------------------------------------------------------------------------------

UNNAMED = {"", "unknown", "unlabeled", "unlabelled", "void", "misc", "undefined", "object", "objects", "other"}
SPOTS = 40  # places from which the things of a scene are looked at
SEEN_ROWS = 128  # of the panoramas that show the extent of things
FEWEST = 12  # pixels that a thing has to show
TRIM = 0.5  # per cent of the points at each end: edges of things mix near and far

Box = tuple[np.ndarray, np.ndarray]  # lowest and highest corner (3,)
Things = tuple[tuple[Instance, ...], tuple[Room, ...], np.ndarray | None, str]


def things_of(
    semantic: Any, file: Path | None, names: Path | None, frames: Frames, look: Callable[[], Mapping[int, Box]]
) -> Things:
    """The instances and rooms of a scene, our index of each semantic id (None: boxes tell), and where names come from.

    `semantic`: Habitat's semantic scene; `names`: the semantic JSON; `look` finds the extent of what is seen of each
    semantic id, Habitat's world. Raises `WorldError` if the scene names no things, or for a malformed file.
    """
    if names is not None:
        try:
            known = read_semantics(names.read_bytes())
        except (OSError, ValueError) as error:
            raise WorldError(
                f"{names} cannot be used ({str(error)[:200]}); wanted what export_glb writes: remove it, or export "
                "the scene again"
            ) from error
        return _lowered(known.instances, frames), tuple(known.rooms), None, f"boxes of {names.name}"
    found: dict[int, Instance] = {}
    for thing in getattr(semantic, "objects", None) or []:
        if thing is None or thing.category is None or (box := _bounds(thing)) is None:
            continue
        category = read_category(str(thing.category.name()))
        if category not in UNNAMED:
            found[int(thing.semantic_id)] = Instance(category, None, None, *box)
    if len(found) > 2 and all((thing.low <= 0).all() and (thing.high >= 0).all() for thing in found.values()):
        seen = look()  # Habitat-Sim 0.3.4 extends the boxes of HM3D to the origin
        found = {key: _repaired(thing, *seen[key]) for key, thing in found.items() if key in seen}
    if found:
        index = np.full(max(found) + 2, -1, dtype=np.int32)  # the last for ids beyond the table
        index[[*found]] = np.arange(len(found))
        instances = []
        for thing in found.values():
            corners = frames.from_habitat(np.stack([thing.low, thing.high]))
            instances.append(replace(thing, low=corners.min(axis=0), high=corners.max(axis=0)))
        return tuple(instances), (), index, "Habitat's semantic scene"
    if file is not None and file.suffix.lower() in GLB:
        named = [thing for thing in import_glb(file).instances if thing.category not in UNNAMED]
        if named:
            return _lowered(named, frames), (), None, f"nodes of {file.name}"
    raise WorldError(
        f"{file or 'the scene'} names no things: it has no semantic annotations, its nodes have no names, and no "
        "<scene>.semantic.json lies beside it; write one, as export_glb does"
    )


def _lowered(instances: Sequence[Instance], frames: Frames) -> tuple[Instance, ...]:
    """Things with heights as in the file (z up), above the storey's floor."""
    lift = np.array([0.0, 0.0, frames.floor])
    return tuple(replace(thing, low=thing.low - lift, high=thing.high - lift) for thing in instances)


def _bounds(part: Any) -> Box | None:
    """The bounds of an object of Habitat's, None if it has none."""
    low, high = np.array(part.aabb.min, dtype=np.float64), np.array(part.aabb.max, dtype=np.float64)
    return (low, high) if np.isfinite([low, high]).all() and (high > low).any() else None


def _repaired(thing: Instance, first: np.ndarray, last: np.ndarray) -> Instance:
    """The same with the sides of its box at 0 replaced by those of what was seen."""
    first, last = np.clip([first, last], thing.low, thing.high)
    return replace(
        thing, low=np.where(thing.low == 0, first, thing.low), high=np.where(thing.high == 0, last, thing.high)
    )


def seen_boxes(session: Session, eyes: np.ndarray) -> dict[int, Box]:
    """The extent of what is seen of each semantic id from points ``(n, 3)``, all in Habitat's world."""
    directions = Frames().to_habitat(ErpGrid(SEEN_ROWS, 2 * SEEN_ROWS).directions)
    ids, points = [], []
    for eye in eyes:
        seen = session.look(("depth", "semantic"), SEEN_ROWS, eye, np.eye(3))
        metres = euclidean(seen["depth"])
        hit = np.isfinite(metres)
        ids.append(seen["semantic"][hit])
        points.append(eye + metres[hit][:, None] * directions[hit])
    every, where = np.concatenate(ids), np.concatenate(points)
    parts = {int(name): where[every == name] for name in np.unique(every)}
    return {
        name: (np.percentile(part, TRIM, axis=0), np.percentile(part, 100 - TRIM, axis=0))
        for name, part in parts.items()
        if len(part) >= FEWEST
    }


# --- the scene --------------------------------------------------------------------------------------------------------

RADIUS = 0.18  # metres: of the body for whose ground the floor is found


class HabitatScene:
    """The scene that ``habitat:text`` names: an `eagor.lab.worlds.SimulatedScene`.

    Raises `MissingExtraError`, `WorldError`.
    """

    def __init__(self, text: str) -> None:
        self.options = options = parse(text)
        self.file = file = file_of(options)
        dataset = Path(options.dataset).expanduser().resolve() if options.dataset else None
        self.source = f"habitat {file.name if file else options.scene}"
        self.session = Session(
            Source(scene_id_of(options, file), str(dataset or "default"), options.gpu, str(file or options.scene))
        )
        self._grounds: dict[float, HabitatNavMesh] = {}
        self.frames, self.rooms = Frames(), ()
        mesh = self._ground(RADIUS, options.storey, LEVEL)
        self.storey, self.zero = mesh.storey.level, true_floor(self.session, mesh, options)
        self.frames = Frames(self.zero)
        sim = self.session.sim

        def look() -> Mapping[int, Box]:
            spots = mesh.points[:: max(1, len(mesh.points) // SPOTS)]
            feet = np.array([mesh.feet(xy) for xy in spots], dtype=np.float64)
            return seen_boxes(self.session, feet + np.array([0.0, EYE, 0.0]))

        names = None if file is None else file.with_name(f"{file.name.split('.')[0]}.semantic.json")
        names = names if names and names.is_file() else None
        semantic = getattr(sim, "semantic_scene", None)
        self.instances, self.rooms, index, source = things_of(semantic, file, names, self.frames, look)
        self._view = HabitatView(self.session, self.frames, self.instances, index)
        self.facts = {
            "simulator": f"Habitat-Sim {getattr(import_habitat(), '__version__', '')}".strip(),
            "things": source,
            "floor": f"{self.zero:.3f} m (Habitat's y of our z = 0)",
            "storey": f"{self.storey:.2f} m (Habitat's y of the navigation mesh)",
        }
        drawn = Path(str(getattr(sim.get_stage_initialization_template(), "render_asset_handle", "")))
        self.hash = self._digest([file, dataset, names, drawn if drawn.is_file() else None])

    def view(self) -> HabitatView:
        return self._view

    def close(self) -> None:
        self.session.close()

    def ground(self, radius: float) -> HabitatNavMesh:
        if radius not in self._grounds:
            # A body of habitat-lab stands on the mesh, and its path counts each difference of height.
            self._grounds[radius] = self._ground(radius, self.storey, LEVEL if self.options.body is None else 0.0)
        return self._grounds[radius]

    def _ground(self, radius: float, storey: float | None, level: float) -> HabitatNavMesh:
        pathfinder = mesh_for(self.options, self.file, self.session.sim, radius)

        def roofed(feet: np.ndarray) -> float:
            return float(np.isfinite(looks(self.session, feet)[:, 0]).mean()) if len(feet) else 0.0

        found = main_storey(pathfinder, roofed, storey, self.source)
        return HabitatNavMesh(pathfinder, found, self.frames, radius, self.rooms, self.source, level, self._sees)

    def _sees(self, xy: np.ndarray, height: float, thing: Instance) -> bool:
        """Whether a camera above a point ``(2,)`` of the ground, at this height, sees a thing."""
        ids = self._view.panorama((xy[0], xy[1], height + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
        assert ids is not None
        index = next(k for k, other in enumerate(self.instances) if other is thing)
        return bool((ids == index).any())

    def _digest(self, files: list[Path | None]) -> str:
        options = self.options
        body = "" if options.body is None else f"|{options.body}|{options.climb}|{options.voxel}"
        digest = hashlib.sha256(f"{options.storey}|{options.up}|None{body}".encode())
        for file in dict.fromkeys(file for file in files if file is not None):
            digest.update(hashlib.sha256(file.read_bytes()).digest())
        for thing in self.instances:
            digest.update(f"{thing.category}|{thing.colour}|{thing.room}|{thing.low}|{thing.high};".encode())
        return digest.hexdigest()[:16]


@lru_cache(maxsize=8)
def open_scene(text: str) -> HabitatScene:
    """The scene that ``habitat:text`` names, kept open. Raises `MissingExtraError`, `WorldError`."""
    return HabitatScene(text)


def _world(argument: str) -> World:
    parse(argument)  # complains at once
    return lambda seed: open_scene(argument)


WORLD = WorldOf(_world, "SCENE, a scene's file or a name in ?dataset=FILE")
