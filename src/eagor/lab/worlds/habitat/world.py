"""The world ``habitat:SCENE``: a scene of Habitat-Sim for tasks.

SCENE is a GLB file, a ``*.stage_config.json``, a ``*.scene_instance.json``, or a name in a scene dataset. Options
follow it: ``habitat:SCENE?dataset=FILE&storey=2.9``.

- ``dataset``: the ``*.scene_dataset_config.json`` in which Habitat looks SCENE up;
- ``storey``: the height of the floor to walk on, metres, Habitat's y (default: the largest);
- ``up``: ``y`` or ``z``, the axis of a bare GLB file that points up (Habitat takes z, glTF says y);
- ``gpu``: the GPU's number, -1 for the CPU (default: what the probe finds).

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds import World, WorldOf
from eagor.lab.worlds.glb import import_glb, read_semantics, voxel_for
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
from eagor.lab.worlds.habitat.navmesh import HabitatNavMesh, main_storey
from eagor.lab.worlds.scene import Instance, Room

GLB = (".glb", ".gltf")


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What follows ``habitat:``, see `eagor.lab.worlds.habitat.world`."""

    scene: str
    dataset: str | None = None
    storey: Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)] | None = None
    up: Literal["y", "z"] | None = None
    gpu: int | None = None


def parse(text: str) -> Options:
    """The options in ``SCENE?name=value&name=value``. Raises `WorldError`."""
    scene, _, rest = text.partition("?")
    try:
        values = dict(part.split("=", 1) for part in rest.split("&") if part)
        return msgspec.convert(values | {"scene": scene}, Options, strict=False)
    except ValueError as error:  # msgspec's, too
        raise WorldError(
            f"habitat:{text}: {error}; wanted dataset=FILE, storey=METRES, up=y or z, gpu=NUMBER, joined by &"
        ) from error


def file_of(options: Options) -> Path | None:
    """The file of the scene, None for a name in a dataset. Raises `WorldError` if one of the two is missing."""
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
    """A PathFinder for a body of this radius: that of the scene if it was made for one, else a new, finer one.

    Raises `WorldError`.
    """
    own = [sim.pathfinder]
    settings = {"cell_size": voxel_for(radius, 0.05), "cell_height": 0.05}  # Habitat's own are 0.2 m high
    settings |= {"agent_height": 1.5, "agent_max_climb": 0.2}
    if file is not None and (saved := file.with_suffix(".navmesh")).is_file():
        own.append(import_habitat().PathFinder())
        own[-1].load_nav_mesh(str(saved))
    if file is not None and (named := file.with_suffix(".navmesh.json")).is_file():
        settings |= json.loads(named.read_text(encoding="utf-8"))
    for mesh in own:
        if mesh is not None and mesh.is_loaded and abs(mesh.nav_mesh_settings.agent_radius - radius) < 1e-3:
            return mesh
    found = import_habitat().PathFinder()
    wanted = mesh_settings(settings | {"agent_radius": radius, "include_static_objects": True})
    if not sim.recompute_navmesh(found, wanted) or not found.is_loaded:
        raise WorldError(
            f"Habitat-Sim finds no ground for a body of radius {radius:g} m in {options.scene}; is it the right way up "
            "(habitat:SCENE?up=y or ?up=z), in metres, and complete?"
        )
    return found


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
        metres = euclidean(session.render(("depth",), ROWS, point + np.array([0.0, EYE, 0.0]), np.eye(3))["depth"])
        found.append(np.median(metres[[0, -1]], axis=1) * math.cos(math.pi / (2 * ROWS)))
    return np.array(found).reshape(-1, 2)


def true_floor(session: Session, mesh: HabitatNavMesh, options: Options) -> float:
    """The height of the true floor, Habitat's y: what lies below points of the mesh.

    Raises `WorldError` if the mesh does not lie on what is drawn, or if the scene seems to lie on its side and nothing
    but Habitat's default says which way is up.
    """
    level = np.abs(mesh.heights[mesh.free] - mesh.level) <= 0.1
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
    height = float(np.median(above)) + EYE
    box = session.sim.get_active_scene_graph().get_root_node().cumulative_bb
    wide, high, deep = np.array(box.max, dtype=np.float64) - np.array(box.min, dtype=np.float64)
    lies = TALL < height < math.inf or min(wide, deep) < min(NARROW, high)
    if lies and options.up is None and options.dataset is None and session.source.scene_id.lower().endswith(GLB):
        raise WorldError(
            f"{mesh.source} seems to lie on its side (it is {wide:.1f} x {deep:.1f} m large and {high:.1f} m high): "
            "Habitat takes z for up in a bare GLB file, glTF says y; say which with habitat:SCENE?up=y or ?up=z"
        )
    floor = float(np.median(feet[:, 1] - gap))
    return 0.0 if abs(floor) < FLAT else floor


# --- the named things -------------------------------------------------------------------------------------------------

UNNAMED = {"", "unknown", "unlabeled", "unlabelled", "void", "misc", "undefined", "object", "objects", "other"}
SPOTS = 40  # places from which the things of a scene are looked at
SEEN_ROWS = 128  # of the panoramas that show the extent of things
FEWEST = 12  # pixels that a thing has to show
TRIM = 0.5  # per cent of the points at each end: edges of things mix near and far

Box = tuple[np.ndarray, np.ndarray]  # lowest and highest corner (3,)


def things_of(
    semantic: Any, file: Path | None, names: Path | None, frames: Frames, look: Callable[[], Mapping[int, Box]]
) -> tuple[tuple[Instance, ...], tuple[Room, ...], np.ndarray | None]:
    """The instances and rooms of a scene, and our index of each semantic id (None: boxes tell).

    `semantic`: Habitat's semantic scene; `names`: the semantic JSON; `look` finds the extent of what is seen of each
    semantic id, Habitat's world. Raises `WorldError` if the scene names no things, or for a malformed file.
    """
    lift = np.array([0.0, 0.0, frames.floor])  # heights in files are not above the storey's floor

    def lowered(instances: Sequence[Instance]) -> tuple[Instance, ...]:
        return tuple(replace(thing, low=thing.low - lift, high=thing.high - lift) for thing in instances)

    if names is not None:
        try:
            known = read_semantics(names.read_bytes())
        except (OSError, ValueError) as error:
            raise WorldError(
                f"{names} cannot be used ({str(error)[:200]}); wanted what export_glb writes: remove it, or export "
                "the scene again"
            ) from error
        return lowered(known.instances), tuple(known.rooms), None
    found: dict[int, tuple[str, np.ndarray]] = {}
    for thing in getattr(semantic, "objects", None) or []:
        if thing is not None and thing.category is not None:
            name = read_category(str(thing.category.name()))
            box = np.stack([np.array(end, dtype=np.float64) for end in (thing.aabb.min, thing.aabb.max)])
            if name not in UNNAMED and np.isfinite(box).all() and (box[1] > box[0]).any():
                found[int(thing.semantic_id)] = name, box
    if len(found) > 2 and all((box[0] <= 0).all() and (box[1] >= 0).all() for _, box in found.values()):
        # Habitat-Sim 0.3.4 extends the boxes of HM3D to the origin: sides at 0 become those of what is seen.
        seen = look()
        found = {
            key: (name, np.where(box == 0, np.clip(seen[key], *box), box))
            for key, (name, box) in found.items()
            if key in seen
        }
    if found:
        index = np.full(max(found) + 2, -1, dtype=np.int32)  # the last for ids beyond the table
        index[[*found]] = np.arange(len(found))
        ends = [(name, np.sort(frames.from_habitat(box), axis=0)) for name, box in found.values()]
        return tuple(Instance(name, None, None, *box) for name, box in ends), (), index
    if file is not None and file.suffix.lower() in GLB:
        named = [thing for thing in import_glb(file).instances if thing.category not in UNNAMED]
        if named:
            return lowered(named), (), None
    raise WorldError(
        f"{file or 'the scene'} names no things: it has no semantic annotations, its nodes have no names, and no "
        "<scene>.semantic.json lies beside it; write one, as export_glb does"
    )


def seen_boxes(session: Session, eyes: np.ndarray) -> dict[int, Box]:
    """The extent of what is seen of each semantic id from points ``(n, 3)``, all in Habitat's world."""
    directions = Frames().to_habitat(ErpGrid(SEEN_ROWS, 2 * SEEN_ROWS).directions)
    ids, points = [], []
    for eye in eyes:
        seen = session.render(("depth", "semantic"), SEEN_ROWS, eye, np.eye(3))
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
        self.frames, self.rooms, self.storey = Frames(), (), options.storey
        mesh = self._ground(RADIUS)
        self.frames, self.storey = Frames(true_floor(self.session, mesh, options)), mesh.level

        def look() -> Mapping[int, Box]:
            spots = mesh.points[:: max(1, len(mesh.points) // SPOTS)]
            feet = np.array([mesh.feet(xy) for xy in spots], dtype=np.float64)
            return seen_boxes(self.session, feet + np.array([0.0, EYE, 0.0]))

        names = None if file is None else file.with_name(f"{file.name.split('.')[0]}.semantic.json")
        names = names if names and names.is_file() else None
        semantic = getattr(self.session.sim, "semantic_scene", None)
        self.instances, self.rooms, index = things_of(semantic, file, names, self.frames, look)
        self._view = HabitatView(self.session, self.frames, self.instances, index)
        drawn = Path(str(getattr(self.session.sim.get_stage_initialization_template(), "render_asset_handle", "")))
        digest = hashlib.sha256(f"{options.storey}|{options.up}|None".encode())
        for each in dict.fromkeys((file, dataset, names, drawn)):
            if each is not None and each.is_file():
                digest.update(hashlib.sha256(each.read_bytes()).digest())
        for thing in self.instances:
            digest.update(f"{thing.category}|{thing.colour}|{thing.room}|{thing.low}|{thing.high};".encode())
        self.hash = digest.hexdigest()[:16]

    def view(self) -> HabitatView:
        return self._view

    def close(self) -> None:
        self.session.close()

    def ground(self, radius: float) -> HabitatNavMesh:
        if radius not in self._grounds:
            self._grounds[radius] = self._ground(radius)
        return self._grounds[radius]

    def _ground(self, radius: float) -> HabitatNavMesh:
        pathfinder = mesh_for(self.options, self.file, self.session.sim, radius)

        def roofed(feet: np.ndarray) -> float:
            return float(np.isfinite(looks(self.session, feet)[:, 0]).mean()) if len(feet) else 0.0

        storey = main_storey(pathfinder, roofed, self.storey, self.source)
        return HabitatNavMesh.of(pathfinder, storey, self.frames, radius, self.rooms, self.source, self._sees)

    def _sees(self, xy: np.ndarray, height: float, thing: Instance) -> bool:
        """Whether a camera above a point ``(2,)`` of the ground, at this height, sees a thing."""
        ids = self._view.panorama((xy[0], xy[1], height + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
        index = next(k for k, other in enumerate(self.instances) if other is thing)
        return bool((np.asarray(ids) == index).any())


@lru_cache(maxsize=8)
def open_scene(text: str) -> HabitatScene:
    """The scene that ``habitat:text`` names, kept open. Raises `MissingExtraError`, `WorldError`."""
    return HabitatScene(text)


def _world(argument: str) -> World:
    parse(argument)  # complains at once
    return lambda seed: open_scene(argument)


WORLD = WorldOf(_world, "SCENE, a scene's file or a name in ?dataset=FILE")
