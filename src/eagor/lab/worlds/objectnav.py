"""Object-goal episodes in scenes of ours, and the scenes, as Habitat's ObjectNav reads HM3D.

Here positions are at the feet, in our world (z up); in the files they are Habitat's (Y up, the axes of an exported GLB;
quaternions x, y, z, w). `info["eagor"]`, which Habitat ignores, holds the scene, its version and the body that an
episode was made for. Our "tv" is its "tv_monitor", and blanks are underscores there.

`export_dataset` (``eagor export habitat``) writes a folder that Habitat's examples call ``data``: the episodes as
``datasets/objectnav/<name>/v1/<split>/<split>.json.gz`` (categories) and ``content/<scene>.json.gz`` beside it, and
``scene_datasets/<name>/`` with the scene dataset's configuration and what `export_glb` writes of each scene, and its
navigation mesh, where habitat_sim is installed.
"""

from __future__ import annotations

import gzip
import json
import math
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from eagor._files import written
from eagor.conventions import pose_to_habitat, to_gltf, xyzw_from_rotation
from eagor.errors import StorageError, WorldError
from eagor.lab.worlds.glb import ON_MESH, STAGE, export_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat import CPU, Source, mesh_settings, read_category, run_apart, simulator_of
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.sphere import world_R_body

HM3D_CATEGORIES = ("chair", "bed", "plant", "toilet", "tv_monitor", "sofa")  # in the order of their ids
SPACING = 0.1  # metres between view points: no place among them is farther than 0.1 m, the usual threshold, from one
EYE = 0.88  # metres above the floor: height of the camera of the ObjectNav challenges
ROWS = 64  # of the panoramas that decide whether a thing is in sight
PIXELS = 2  # of them that show a thing in sight
NEAREST, FARTHEST = 1.0, 30.0  # metres from the start to the nearest view point, along the floor
RATIO = 1.05  # least ratio of that way to the straight line
LAB_CELL = 0.05  # metres: the side of habitat-lab's voxels
MARGIN = 1.6  # of them: the 1.3 of straightened edges, and some for what is full; more closes passages that are open


@dataclass(frozen=True, eq=False)
class Goal:
    """A thing to find.

    `instance`: its id; `position` ``(3,)``: its centre; `view_positions` ``(n, 3)``: from there it counts as found.
    """

    category: str
    instance: int
    position: np.ndarray
    view_positions: np.ndarray

    def entry(self) -> dict[str, Any]:
        """The goal with all keys that Habitat wants; from each view point the agent faces it."""
        across, along, _ = (self.position - self.view_positions).T
        half = (np.arctan2(along, across) - np.pi / 2) / 2  # Habitat's agents look along -z, which is our y
        still = np.zeros(len(half))
        turns = np.stack([still, np.sin(half), still, np.cos(half)], axis=1).tolist()
        places, name = to_gltf(self.view_positions).tolist(), spelt(self.category)
        states = [{"position": place, "rotation": turn} for place, turn in zip(places, turns, strict=True)]
        return {
            "position": to_gltf(self.position).tolist(), "radius": None, "object_id": self.instance,
            "object_name": f"{name}_{self.instance}", "object_name_id": None, "object_category": name, "room_id": None,
            "room_name": None, "view_points": [{"agent_state": state, "iou": 0.0} for state in states],
        }  # fmt: skip


def spelt(category: str) -> str:
    """The category as written in the files."""
    return "tv_monitor" if category == "tv" else category.replace(" ", "_")


def roomy_ground(scene: Scene, ground: Ground) -> Ground:
    """The part of the ground that is also on habitat-lab's mesh, and connected there, whatever Recast rounds.

    Recast rounds the radius up to whole voxels, counts a voxel as full if anything touches it, and straightens the
    edges of the mesh by up to 1.3 voxels.
    """
    radius = (math.ceil(ground.radius / LAB_CELL - 1e-6) + MARGIN) * LAB_CELL
    return Ground.from_scene(scene, cell=ground.cell, radius=radius, floor=ground.floor)


def make_goals(scene: Scene, roomy: Ground, categories: Sequence[str] = ()) -> dict[str, list[Goal]]:
    """The things of these categories with their view points, by category.

    View points are places beside a thing from which it is in sight, on the mesh that habitat-lab makes of the exported
    scene, in one piece of it (`roomy`, of `roomy_ground`). By default those of HM3D's six categories that the scene
    has. Things without view points are left out. Raises `WorldError` if nothing is left of a category that was asked
    for, or of all.
    """
    present = {thing.category for thing in scene.instances if thing.category not in STRUCTURE}
    asked = list(dict.fromkeys(read_category(category) for category in categories))
    lacking = [name for name in asked if name not in present]
    if lacking:
        raise WorldError(f"{scene.source} has no {', '.join(lacking)}; it has {', '.join(sorted(present))}")
    renderer, goals = Renderer(scene), dict[str, list[Goal]]()

    @cache
    def in_sight(x: float, y: float) -> np.ndarray:
        ids = renderer.panorama((x, y, roomy.floor + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
        return np.bincount(np.ravel(np.asarray(ids)) + 1, minlength=len(scene.instances) + 1)[1:] >= PIXELS

    for category in asked or [read_category(name) for name in HM3D_CATEGORIES]:
        for index, thing in enumerate(scene.instances):
            if thing.category == category:
                points, _ = roomy.beside(thing)
                _, first = np.unique(np.floor(points / SPACING), axis=0, return_index=True)
                views = [[x, y, roomy.floor + ON_MESH] for x, y in points[np.sort(first)] if in_sight(x, y)[index]]
                if views:
                    goals.setdefault(category, []).append(Goal(category, index, thing.centre, np.array(views)))
    hidden = [category for category in asked if category not in goals]
    if hidden or not goals:
        raise WorldError(
            f"no {hidden[0] if hidden else ' and no '.join(HM3D_CATEGORIES)} of {scene.source} is in sight from a free "
            f"place beside it; ask for others; it has {', '.join(sorted(present))}"
        )
    return goals


def make_episodes(
    scene: Scene, ground: Ground, points: np.ndarray, goals: Mapping[str, Sequence[Goal]], count: int, file: str,
    dataset_config: str,
) -> list[dict[str, Any]]:  # fmt: skip
    """So many episodes, one category after the other, from `points` ``(n, 2)``, with all keys that Habitat wants.

    The same arguments give the same ones. `file` is the scene_id. Any other key in an episode would stop Habitat.
    Raises `WorldError` if no start is far enough from a category's view points.
    """
    rng, starts = np.random.default_rng([zlib.crc32(scene.hash.encode()), 0]), {}
    for category, things in goals.items():
        ways = np.array([ground.field(thing.view_positions[:, :2]).distance(points) for thing in things])
        views = np.concatenate([thing.view_positions[:, :2] for thing in things])
        nearest, straight = ways.min(axis=0), np.array([np.hypot(*(views - point).T).min() for point in points])
        fits = np.flatnonzero((nearest >= NEAREST) & (nearest <= FARTHEST))
        if len(fits) == 0:
            raise WorldError(
                f"every place in {scene.source} is nearer than {NEAREST:g} m to a {category}, or has no way to one; "
                "ask for other categories"
            )
        bent = fits[nearest[fits] >= RATIO * straight[fits]]
        starts[category] = (bent if len(bent) else fits), ways, straight
    episodes = []
    for number in range(count):
        category = list(goals)[number % len(goals)]
        fits, ways, straight = starts[category]
        index, yaw = int(rng.choice(fits)), float(rng.uniform(-np.pi, np.pi))
        closest = int(ways[:, index].argmin())
        info = {
            "geodesic_distance": float(ways[closest, index]), "euclidean_distance": float(straight[index]),
            "closest_goal_object_id": goals[category][closest].instance,
            "eagor": {  # for us alone
                "scene_hash": scene.hash, "version": scene.source, "radius": ground.radius, "cell": ground.cell
            },
        }  # fmt: skip
        place = np.array([*points[index], ground.floor + ON_MESH])
        episode = {
            "episode_id": str(number), "scene_id": file, "scene_dataset_config": dataset_config,
            "additional_obj_config_paths": [], "start_position": to_gltf(place).tolist(),
            "start_rotation": xyzw_from_rotation(pose_to_habitat(world_R_body(yaw))).tolist(), "info": info,
            "goals": [], "start_room": None, "shortest_paths": None, "object_category": spelt(category),
        }  # fmt: skip
        episodes.append(episode)
    return episodes


# --- the folder -------------------------------------------------------------------------------------------------------


def has_meshes() -> bool:
    """Whether navigation meshes can be written here."""
    return find_spec("habitat_sim") is not None


def make_mesh(glb: str) -> None:
    """Write ``<name>.navmesh`` beside an exported GLB. Runs in a process of its own."""
    path = Path(glb)
    settings = mesh_settings(json.loads(path.with_suffix(".navmesh.json").read_text()))
    with simulator_of(Source(str(path.with_suffix(".stage_config.json"))), CPU, ()) as sim:
        if sim.recompute_navmesh(sim.pathfinder, settings):
            sim.pathfinder.save_nav_mesh(str(path.with_suffix(".navmesh")))


def export_dataset(
    scenes: Mapping[str, Callable[[], Scene]], folder: Path | str, *, name: str = "eagor", split: str = "val",
    episodes: int = 10, categories: Sequence[str] = (), radius: float = 0.18,
    on_done: Callable[[dict[str, Any]], object] = lambda _: None,
) -> tuple[Path, list[dict[str, Any]]]:  # fmt: skip
    """Write the folder; returns the episodes' ``<split>.json.gz``, and what was written of each scene.

    `scenes`: how each is made, by the name of its folder, NUMBER-NAME as in HM3D; `episodes` of each, of these
    `categories` (`make_goals`), for a body of this `radius` (metres). The same call gives the same bytes. The folder
    appears when all of it is written: nothing is left of an export that fails.

    Raises `WorldError` if the folder holds something, for two scenes of one name, and as `make_goals` and
    `make_episodes`; `StorageError` if it cannot be written.
    """
    folder, names = Path(folder), [place.partition("-")[2] for place in scenes]
    for what, word in (("name", name), ("split", split)):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", word):
            raise WorldError(f"{what} = {word!r}; wanted letters, digits, - and _: folders get that name")
    if episodes < 1:
        raise WorldError(f"{episodes} episodes of each scene; wanted 1 or more")
    if twice := [each for each in names if names.count(each) > 1]:
        raise WorldError(f"two scenes have the name {twice[0]!r}; one would replace the other: rename one")
    home, sets = Path("scene_datasets", name), Path("datasets", "objectnav", name, "v1", split)
    config = home / f"{name}.scene_dataset_config.json"
    with all_or_nothing(folder) as part:
        contents, done, files = {}, [], []
        for place, short in zip(scenes, names, strict=True):
            scene, file = scenes[place](), f"{split}/{place}/{short}.glb"
            ground = Ground.from_scene(scene, radius=radius)
            roomy = roomy_ground(scene, ground)
            goals = make_goals(scene, roomy, categories)
            made = make_episodes(
                scene, ground, roomy.points, goals, episodes, f"{name}/{file}", f"./data/{config.as_posix()}"
            )
            glb = export_glb(scene, part / home / file, radius=radius)
            if has_meshes():
                _, error = run_apart(make_mesh, str(glb))
                if not glb.with_suffix(".navmesh").is_file():
                    raise WorldError(f"Habitat-Sim made no navigation mesh of {glb.stem}: {error}")
            entries = {f"{glb.name}_{spelt(each)}": [goal.entry() for goal in goals[each]] for each in goals}
            contents[short] = {"episodes": made, "goals_by_category": entries}
            things = [goal for each in goals.values() for goal in each]
            found = {
                "scene": str(folder / home / file), "source": scene.source, "instances": len(scene.instances),
                "goals": len(things), "view_points": sum(len(goal.view_positions) for goal in things),
                "episodes": len(made),
            }  # fmt: skip
            files.append(file)
            done.append(found)
            on_done(found)
        # Every scene has its files beside it, under its own name, which Habitat puts for this word.
        mesh = "%%CONFIG_NAME_AS_ASSET_FILENAME%%.navmesh"
        stages = {"default_attributes": STAGE | {"nav_asset": mesh}, "paths": {".glb": files}}
        written(part / config, json.dumps({"stages": stages}, indent=1) + "\n")
        write_episodes(part / sets, contents)
    return folder / sets / f"{split}.json.gz", done


def write_episodes(folder: Path, contents: Mapping[str, dict[str, Any]]) -> None:
    """Write the files of a split: `contents` by the names of the scenes, and the one that names all categories."""
    goals = [goal for content in contents.values() for each in content["goals_by_category"].values() for goal in each]
    occur = {goal["object_category"] for goal in goals}
    every = (*HM3D_CATEGORIES, *sorted(occur.difference(HM3D_CATEGORIES)))  # those of HM3D keep their numbers
    numbers = {category: number for number, category in enumerate(every) if category in occur}
    head = {"category_to_task_category_id": numbers, "category_to_scene_annotation_category_id": numbers}
    files = {f"content/{name}": content for name, content in contents.items()} | {folder.name: {"episodes": []}}
    for name, content in files.items():
        text = json.dumps(content | head, allow_nan=False)
        written(folder / f"{name}.json.gz", gzip.compress(text.encode(), mtime=0))


@contextmanager
def all_or_nothing(folder: Path) -> Iterator[Path]:
    """A new folder, which becomes `folder` if all goes well, and is removed otherwise.

    Raises `WorldError` if `folder` holds something, `StorageError` if it cannot be made.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        what = "holds something" if folder.is_dir() else "is a file"
        raise WorldError(f"{folder} {what}; name a new folder, or an empty one")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f"{folder.name}.", suffix=".part", dir=folder.parent) as beside:
            part = Path(beside, folder.name)
            part.mkdir()
            yield part
            if folder.exists():
                folder.rmdir()
            part.rename(folder)
    except OSError as error:
        raise StorageError(f"{folder} cannot be made ({error.strerror or error}); name another place") from error
