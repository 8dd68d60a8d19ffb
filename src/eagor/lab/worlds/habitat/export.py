"""Scenes of ours as Habitat reads HM3D, with ObjectNav episodes: ``eagor export habitat``.

    DIR/scene_datasets/<name>/<name>.scene_dataset_config.json
    DIR/scene_datasets/<name>/<split>/00007-apartment0007/apartment0007.glb      and beside it
        .stage_config.json   axes: the GLB has Y up
        .navmesh             Habitat's navigation mesh, where habitat_sim is installed
        .navmesh.json, .semantic.json  the settings of that mesh; names and boxes of things, and what else a GLB cannot
                             hold: our world `habitat:` reads them, habitat-lab needs the episodes' goals alone
    DIR/datasets/objectnav/<name>/v1/<split>/<split>.json.gz, content/apartment0007.json.gz

DIR is what Habitat's examples call ``data``.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import uuid
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eagor._files import written
from eagor.errors import StorageError, WorldError
from eagor.lab.worlds.glb import ON_MESH, STAGE, export_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat.simulator import PATIENCE, run_apart
from eagor.lab.worlds.objectnav import (
    HM3D_CATEGORIES,
    Episode,
    Goal,
    Origin,
    SceneEpisodes,
    read_category,
    write_episodes,
)
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.sphere import world_R_body

SPACING = 0.1  # metres between view points: no place among them is farther than 0.1 m, the usual threshold, from one
EYE = 0.88  # metres above the floor: height of the camera of the ObjectNav challenges
ROWS = 64  # of the panoramas that decide whether a thing is in sight
PIXELS = 2  # of them that show a thing in sight
NEAREST, FARTHEST = 1.0, 30.0  # metres from the start to the nearest view point, along the floor
RATIO = 1.05  # least ratio of that way to the straight line
LAB_CELL = 0.05  # metres: the side of habitat-lab's voxels
MARGIN = 1.6  # of them: the 1.3 of straightened edges, and some for what is full; more closes passages that are open


def roomy_ground(scene: Scene, ground: Ground) -> Ground:
    """The part of the ground that is also on habitat-lab's mesh, and connected there, whatever Recast rounds.

    Recast rounds the radius up to whole voxels, counts a voxel as full if anything touches it, and straightens the
    edges of the mesh by up to 1.3 voxels.
    """
    radius = (math.ceil(ground.radius / LAB_CELL - 1e-6) + MARGIN) * LAB_CELL
    return Ground.from_scene(scene, cell=ground.cell, radius=radius, floor=ground.floor)


def make_goals(scene: Scene, ground: Ground, categories: Sequence[str] = ()) -> dict[str, tuple[Goal, ...]]:
    """The things of these categories with their view points, by category.

    View points are places beside a thing from which it is in sight, on the mesh that habitat-lab makes of the exported
    scene, in one piece of it (`roomy_ground`). By default those of HM3D's six categories that the scene has. Things
    without view points are left out. Raises `WorldError` if nothing is left of a category that was asked for, or of
    all.
    """
    present = {thing.category for thing in scene.instances if thing.category not in STRUCTURE}
    asked = [read_category(category) for category in categories]
    wanted = asked or [name for name in map(read_category, HM3D_CATEGORIES) if name in present]
    lacking = [name for name in wanted if name not in present]
    if lacking or not wanted:
        what = ", ".join(lacking) if lacking else f"none of {', '.join(HM3D_CATEGORIES)}"
        raise WorldError(f"{scene.source} has {'no ' * bool(lacking)}{what}; it has {', '.join(sorted(present))}")
    renderer, roomy = Renderer(scene), roomy_ground(scene, ground)

    @cache
    def pixels(x: float, y: float) -> np.ndarray:
        eye = (x, y, roomy.floor + EYE)
        ids = renderer.panorama(eye, np.eye(3), ROWS, rgb=False, range=False).ids
        assert ids is not None
        return np.bincount(ids.ravel() + 1, minlength=len(scene.instances) + 1)[1:]

    goals: dict[str, tuple[Goal, ...]] = {}
    for category in dict.fromkeys(wanted):
        for index, thing in enumerate(scene.instances):
            if thing.category != category:
                continue
            points, _ = roomy.beside(thing)
            _, first = np.unique(np.floor(points / SPACING), axis=0, return_index=True)
            views = [[x, y, roomy.floor + ON_MESH] for x, y in points[np.sort(first)] if pixels(x, y)[index] >= PIXELS]
            if views:
                goal = Goal(category, index, thing.centre, np.array(views), thing.room)
                goals[category] = (*goals.get(category, ()), goal)
        if asked and category not in goals:
            raise WorldError(f"no {category} of {scene.source} is in sight from a free place beside it; ask for others")
    if not goals:
        raise WorldError(f"none of the {', '.join(wanted)} of {scene.source} is in sight from a free place beside it")
    return goals


def make_episodes(
    scene: Scene, ground: Ground, goals: Mapping[str, Sequence[Goal]], count: int, file: str, dataset_config: str
) -> tuple[Episode, ...]:
    """So many episodes, one category after the other; `file` is the scene_id. The same arguments give the same ones.

    Raises `WorldError` if no start is far enough from a category's view points.
    """
    rng = np.random.default_rng([zlib.crc32(scene.hash.encode()), 0])
    points = roomy_ground(scene, ground).points
    starts, ways = {}, {}
    for category, things in goals.items():
        ways[category] = [ground.field(thing.view_positions[:, :2]) for thing in things]
        nearest = ways[category][0].union(*ways[category][1:]).distance(points)
        views = np.concatenate([thing.view_positions[:, :2] for thing in things])
        straight = np.array([np.hypot(*(views - point).T).min() for point in points])
        fits = np.flatnonzero((nearest >= NEAREST) & (nearest <= FARTHEST))
        if len(fits) == 0:
            raise WorldError(
                f"every place in {scene.source} is nearer than {NEAREST:g} m to a {category}, or has no way to one; "
                "ask for other categories"
            )
        bent = fits[nearest[fits] >= RATIO * straight[fits]]
        starts[category] = (bent if len(bent) else fits), nearest, straight
    episodes = []
    for number in range(count):
        category = list(goals)[number % len(goals)]
        fits, nearest, straight = starts[category]
        index = int(rng.choice(fits))
        yaw = float(rng.uniform(-np.pi, np.pi))
        closest = int(np.argmin([way.distance(points[index]) for way in ways[category]]))
        episodes.append(
            Episode(
                file, category, np.array([*points[index], ground.floor + ON_MESH]), world_R_body(yaw), str(number),
                float(nearest[index]), float(straight[index]), goals[category][closest].instance,
                Origin(scene.hash, scene.source, ground.radius, ground.cell), dataset_config,
            )
        )  # fmt: skip
    return tuple(episodes)


# --- the folder -------------------------------------------------------------------------------------------------------

WITHOUT = (
    "habitat_sim is not installed here, so there are no .navmesh files: habitat-lab and eagor make them when they open "
    "a scene; in Habitat-Sim, call recompute_navmesh with the settings in <scene>.navmesh.json"
)
_PROGRAM = """
import json, os, sys, threading
stage, target, settings, line = sys.argv[1:]
threading.Thread(target=lambda: (os.read(int(line), 1), os._exit(1)), daemon=True).start()  # ends with its parent
import habitat_sim
simulator = habitat_sim.SimulatorConfiguration()
simulator.scene_id, simulator.create_renderer, simulator.load_semantic_mesh = stage, False, False
simulator.gpu_device_id = -1
agent = habitat_sim.agent.AgentConfiguration()
agent.sensor_specifications = []
with habitat_sim.Simulator(habitat_sim.Configuration(simulator, [agent])) as sim:
    wanted = habitat_sim.NavMeshSettings()
    wanted.set_defaults()
    for name, value in json.load(open(settings)).items():
        setattr(wanted, name, value)
    made = sim.recompute_navmesh(sim.pathfinder, wanted) and sim.pathfinder.save_nav_mesh(target)
sys.exit(0 if made else 3)
"""


class Source(NamedTuple):
    """A scene to export: its `number` and `name`, of which its folder is named, and how it is made."""

    number: int
    name: str
    make: Callable[[], Scene]


def has_meshes() -> bool:
    """Whether navigation meshes can be written here."""
    return find_spec("habitat_sim") is not None


def write_mesh(glb: Path) -> None:
    """Write ``<name>.navmesh`` beside an exported GLB. Raises `WorldError` if Habitat-Sim makes none."""
    stage, target, settings = (glb.with_suffix(end) for end in (".stage_config.json", ".navmesh", ".navmesh.json"))
    code, _, said = run_apart(_PROGRAM, str(stage), str(target), str(settings))
    if code is None:
        raise WorldError(f"Habitat-Sim took longer than {PATIENCE:.0f} s for the mesh of {glb.stem}")
    if code or not target.is_file():
        last = (said.strip().splitlines() or ["it said nothing"])[-1]
        raise WorldError(f"Habitat-Sim made no navigation mesh of {glb.stem} (exit code {code}): {last}")


def export_dataset(
    sources: Sequence[Source], folder: Path | str, *, name: str = "eagor", split: str = "val", episodes: int = 10,
    categories: Sequence[str] = (), radius: float = 0.18, on_done: Callable[[dict[str, Any]], object] = lambda _: None,
) -> tuple[Path, list[dict[str, Any]]]:  # fmt: skip
    """Write the folder; returns the episodes' ``<split>.json.gz``, and what was written of each scene.

    `episodes` of each scene, of these `categories` (`make_goals`), for a body of this `radius` (metres). The same call
    gives the same bytes. The folder appears when all of it is written: nothing is left of an export that fails.

    Raises `WorldError` if the folder holds something, for two scenes of one name, and as `make_goals` and
    `make_episodes`; `StorageError` if it cannot be written.
    """
    folder = Path(folder)
    for what, word in (("name", name), ("split", split)):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", word):
            raise WorldError(f"{what} = {word!r}; wanted letters, digits, - and _: folders get that name")
    if episodes < 1:
        raise WorldError(f"{episodes} episodes of each scene; wanted 1 or more")
    names = [source.name for source in sources]
    if twice := sorted({each for each in names if names.count(each) > 1}):
        raise WorldError(f"two scenes have the name {twice[0]!r}; one would replace the other: rename one")
    home = Path("scene_datasets", name)
    config = home / f"{name}.scene_dataset_config.json"
    with all_or_nothing(folder) as part:
        scenes, done, files = [], [], []
        for source in sources:
            scene = source.make()
            file = f"{split}/{source.number:05d}-{source.name}/{source.name}.glb"
            ground = Ground.from_scene(scene, radius=radius)
            goals = make_goals(scene, ground, categories)
            made = make_episodes(scene, ground, goals, episodes, f"{name}/{file}", f"./data/{config.as_posix()}")
            export_glb(scene, part / home / file, radius=radius)
            if has_meshes():
                write_mesh(part / home / file)
            scenes.append(SceneEpisodes(made, goals))
            files.append(file)
            things = [goal for each in goals.values() for goal in each]
            found = {
                "scene": str(folder / home / file), "source": scene.source, "instances": len(scene.instances),
                "goals": len(things), "view_points": sum(len(goal.view_positions) for goal in things),
                "episodes": len(made),
            }  # fmt: skip
            done.append(found)
            on_done(found)
        # Every scene has its files beside it, under its own name, which Habitat puts for this word.
        mesh = "%%CONFIG_NAME_AS_ASSET_FILENAME%%.navmesh"
        stages = {"default_attributes": STAGE | {"nav_asset": mesh}, "paths": {".glb": files}}
        written(part / config, json.dumps({"stages": stages}, indent=1) + "\n")
        path = write_episodes(part / "datasets" / "objectnav" / name / "v1", split, scenes)
    return folder / path.relative_to(part), done


@contextmanager
def all_or_nothing(folder: Path) -> Iterator[Path]:
    """A new folder beside `folder`, which becomes it if all goes well, and is removed otherwise.

    Raises `WorldError` if `folder` holds something, `StorageError` if it cannot be made.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        what = "holds something" if folder.is_dir() else "is a file"
        raise WorldError(f"{folder} {what}; name a new folder, or an empty one")
    part = folder.with_name(f"{folder.name}.{uuid.uuid4().hex[:12]}.part")
    try:
        part.mkdir(parents=True)
        yield part
        if folder.exists():
            folder.rmdir()
        part.rename(folder)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made ({error.strerror or error}); name another place") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
