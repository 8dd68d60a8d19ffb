"""Object-goal episodes in the file format of Habitat's ObjectNav (HM3D), and scenes of ours as Habitat reads HM3D.

Here positions are at the feet, in our world (z up), and rotations are `world_R_body`; in the files they are Habitat's
(Y up, the axes of an exported GLB; quaternions x, y, z, w). `info["eagor"]`, which Habitat ignores, holds the scene,
its version and the body that an episode was made for, so that it is never run in another scene unnoticed. Our "tv" is
its "tv_monitor", and blanks are underscores there.

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
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import msgspec
import numpy as np

from eagor._checks import parsed, shown
from eagor._files import written
from eagor.conventions import (
    from_gltf,
    pose_from_habitat,
    pose_to_habitat,
    rotation_from_xyzw,
    to_gltf,
    xyzw_from_rotation,
)
from eagor.errors import EagorError, StorageError, WorldError
from eagor.lab.worlds.glb import ON_MESH, STAGE, export_glb
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.habitat import CPU, Source, mesh_settings, read_category, run_apart, simulator_of
from eagor.lab.worlds.navmesh import NavMesh
from eagor.lab.worlds.render import Renderer
from eagor.lab.worlds.scene import STRUCTURE, Scene
from eagor.sphere import world_R_body

HM3D_CATEGORIES = ("chair", "bed", "plant", "toilet", "tv_monitor", "sofa")  # in the order of their ids
LAB_BODY = 0.88  # metres: height of the body in habitat-lab's configurations of ObjectNav on HM3D and MP3D


@dataclass(frozen=True, eq=False)
class Goal:
    """A thing to find.

    `instance`: its id; `position` ``(3,)``: its centre; `view_positions` ``(n, 3)``: from there it counts as found.
    """

    category: str
    instance: int | str
    position: np.ndarray
    view_positions: np.ndarray


@dataclass(frozen=True, eq=False)
class Origin:
    """The scene (`Scene.hash`, `Scene.source`) and the `Ground` (metres) that an episode was made for."""

    scene_hash: str
    version: str
    radius: float
    cell: float


@dataclass(frozen=True, eq=False)
class Episode:
    """Start and goal of one search.

    `scene`: the file that Habitat loads (its scene_id); `position` ``(3,)`` at the feet and `world_R_body` ``(3, 3)``:
    the start; `geodesic` and `euclidean`: metres from there to the goal, if given; `nearest`: the goal at that
    distance; `origin`: None in the files of others.
    """

    scene: str
    category: str
    position: np.ndarray
    world_R_body: np.ndarray
    identifier: str = ""
    geodesic: float | None = None
    euclidean: float | None = None
    nearest: int | str | None = None
    origin: Origin | None = None
    dataset_config: str = "default"


@dataclass(frozen=True, eq=False)
class SceneEpisodes:
    """The episodes of one scene, and its goals by category."""

    episodes: tuple[Episode, ...]
    goals: dict[str, tuple[Goal, ...]]


def spelt(category: str) -> str:
    """The category as written in the files."""
    return "tv_monitor" if category == "tv" else category.replace(" ", "_")


def check_scene(episode: Episode, scene: Scene, ground: NavMesh) -> None:
    """Raise `WorldError` if the episode was made for another scene than this one or an import of its export.

    Also if it was made for a body of another radius, which takes other paths. Episodes of others are not marked.
    """
    origin = episode.origin
    if origin is None:
        return
    if origin.scene_hash not in (scene.hash, scene.facts.get("exported hash")):
        raise WorldError(
            f"episode {episode.identifier!r} was made for the scene {origin.scene_hash} ({origin.version}), this one "
            f"is {scene.hash} ({scene.source}); use the version that it was made with, or make episodes anew"
        )
    if abs(origin.radius - ground.radius) > 1e-6:
        raise WorldError(
            f"episode {episode.identifier!r} was made for a body of radius {origin.radius:g} m, but the ground plan "
            f"for {ground.radius:g} m; its starts and goals may be out of reach: use the same radius"
        )


# --- the files --------------------------------------------------------------------------------------------------------

_Finite = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Triple = tuple[_Finite, _Finite, _Finite]


class _State(msgspec.Struct):
    position: _Triple


class _View(msgspec.Struct):
    agent_state: _State


class _Goal(msgspec.Struct):
    """What we read of a goal in `goals_by_category`."""

    position: _Triple
    object_id: int | str
    object_category: str
    view_points: list[_View]

    def goal(self) -> Goal:
        views = np.array([view.agent_state.position for view in self.view_points]).reshape(-1, 3)
        place = from_gltf(np.array(self.position))
        return Goal(read_category(self.object_category), self.object_id, place, from_gltf(views))


class _Info(msgspec.Struct, omit_defaults=True):
    geodesic_distance: _Finite | None = None
    euclidean_distance: _Finite | None = None
    closest_goal_object_id: int | str | None = None
    eagor: Origin | None = None


class _Episode(msgspec.Struct):
    """What we read of an episode."""

    scene_id: str
    start_position: _Triple
    start_rotation: tuple[_Finite, _Finite, _Finite, _Finite]
    object_category: str
    episode_id: str | int | None = None
    scene_dataset_config: str | None = None
    info: _Info | None = None

    def episode(self, index: int) -> Episode:
        """The `index`-th of its file. Raises `EagorError` for a quaternion of length zero."""
        info = self.info or _Info()
        return Episode(
            self.scene_id, read_category(self.object_category), from_gltf(np.array(self.start_position)),
            pose_from_habitat(rotation_from_xyzw(np.array(self.start_rotation))),
            str(index if self.episode_id is None else self.episode_id), info.geodesic_distance,
            info.euclidean_distance, info.closest_goal_object_id, info.eagor, self.scene_dataset_config or "default",
        )  # fmt: skip


class _File(msgspec.Struct):
    episodes: list[_Episode]
    goals_by_category: dict[str, list[_Goal]] = {}


def _goal_entry(goal: Goal) -> dict[str, Any]:
    """A goal with all keys that Habitat wants; from each view point the agent faces the goal."""
    across, along, _ = (goal.position - goal.view_positions).T
    half = (np.arctan2(along, across) - np.pi / 2) / 2  # Habitat's agents look along -z, which is our y
    still = np.zeros(len(half))
    turns = np.stack([still, np.sin(half), still, np.cos(half)], axis=1).tolist()
    places, name = to_gltf(goal.view_positions).tolist(), spelt(goal.category)
    states = [{"position": place, "rotation": turn} for place, turn in zip(places, turns, strict=True)]
    return {
        "position": to_gltf(goal.position).tolist(), "radius": None, "object_id": goal.instance,
        "object_name": f"{name}_{goal.instance}", "object_name_id": None, "object_category": name, "room_id": None,
        "room_name": None, "view_points": [{"agent_state": state, "iou": 0.0} for state in states],
    }  # fmt: skip


def _episode_entry(episode: Episode) -> dict[str, Any]:
    """An episode with all keys that Habitat wants; any other would stop it."""
    info = _Info(episode.geodesic, episode.euclidean, episode.nearest, episode.origin)  # "eagor": for us alone
    return {
        "episode_id": episode.identifier, "scene_id": episode.scene, "scene_dataset_config": episode.dataset_config,
        "additional_obj_config_paths": [], "start_position": to_gltf(episode.position).tolist(),
        "start_rotation": xyzw_from_rotation(pose_to_habitat(episode.world_R_body)).tolist(),
        "info": msgspec.to_builtins(info), "goals": [], "start_room": None, "shortest_paths": None,
        "object_category": spelt(episode.category),
    }  # fmt: skip


def write_episodes(folder: Path | str, split: str, scenes: Sequence[SceneEpisodes]) -> Path:
    """Write the files of a split; returns the path of `<split>.json.gz`. The same episodes give the same bytes.

    The scenes have files of different names. Raises `StorageError` if a file cannot be written.
    """
    folder = Path(folder, split)
    occur = {spelt(category) for scene in scenes for category in scene.goals}
    every = (*HM3D_CATEGORIES, *sorted(occur.difference(HM3D_CATEGORIES)))  # those of HM3D keep their numbers
    numbers = {category: number for number, category in enumerate(every) if category in occur}
    head = {"category_to_task_category_id": numbers, "category_to_scene_annotation_category_id": numbers}

    def write(path: Path, content: dict[str, Any]) -> Path:
        return written(path, gzip.compress(json.dumps(content | head, allow_nan=False).encode(), mtime=0))

    for scene in scenes:
        file = PurePosixPath(scene.episodes[0].scene).name
        goals = {_key(file, spelt(name)): [_goal_entry(goal) for goal in goals] for name, goals in scene.goals.items()}
        content = {"episodes": [_episode_entry(each) for each in scene.episodes], "goals_by_category": goals}
        write(folder / "content" / f"{file.partition('.')[0]}.json.gz", content)
    return write(folder / f"{split}.json.gz", {"episodes": []})


def read_episodes(path: Path | str) -> tuple[SceneEpisodes, ...]:
    """The episodes in `<split>.json.gz` and its content files, by scene, or in a content file alone.

    Raises `WorldError` if a file is missing, truncated, not JSON, lacks a key, or holds numbers that are not finite.
    """
    path = Path(path)
    found = _scenes_in(path) or [
        each for file in sorted((path.parent / "content").glob("*.json.gz")) for each in _scenes_in(file)
    ]
    if not found:
        raise WorldError(f"{path} has no episodes, nor has any file in {path.parent / 'content'}; wanted at least one")
    return tuple(found)


def _scenes_in(path: Path) -> list[SceneEpisodes]:
    """The episodes of a file by scene."""
    try:
        size = path.stat().st_size
        most = max(1 << 24, 100 * size)  # text packs to a tenth, a bomb to a thousandth
        with gzip.open(path) as file:
            text = file.read(most + 1)
        if len(text) > most:
            raise ValueError(f"it holds more than {most} bytes, packed in {size}")
        content = msgspec.convert(parsed(text, strict=True), _File)
    except (EOFError, zlib.error) as error:
        raise WorldError(f"{path} is cut off or corrupt ({error}); copy or write it again") from error
    except (OSError, ValueError) as error:  # OSError also if it is not gzipped
        raise WorldError(
            f"{path} cannot be read: {str(error)[:300]}; wanted ObjectNav episodes as of HM3D v1 or v2, gzipped JSON"
        ) from error
    by_scene: dict[str, list[Episode]] = {}
    for index, entry in enumerate(content.episodes):
        try:
            by_scene.setdefault(entry.scene_id, []).append(entry.episode(index))
        except EagorError as error:
            raise WorldError(f"{path}, episode {index}: {error}") from error
    found = []
    for scene, episodes in by_scene.items():
        goals: dict[str, tuple[Goal, ...]] = {}
        for key, entries in content.goals_by_category.items():
            if len(by_scene) == 1 or key.startswith(_key(scene, "")):  # those of a file with one scene belong to it
                for goal in (entry.goal() for entry in entries):
                    goals[goal.category] = (*goals.get(goal.category, ()), goal)
        for index, episode in enumerate(episodes):
            if episode.category not in goals:
                raise WorldError(f"{path}, episode {index} of {shown(scene)}: its category has no goals")
        found.append(SceneEpisodes(tuple(episodes), goals))
    return found


def _key(scene: str, category: str) -> str:
    """The key of the goals of a category in a scene, as habitat-lab makes it."""
    return f"{PurePosixPath(scene).name}_{category}"


# --- episodes in scenes of ours ---------------------------------------------------------------------------------------

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


def make_goals(scene: Scene, roomy: Ground, categories: Sequence[str] = ()) -> dict[str, tuple[Goal, ...]]:
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
    renderer, goals = Renderer(scene), {}

    @cache
    def in_sight(x: float, y: float) -> np.ndarray:
        ids = renderer.panorama((x, y, roomy.floor + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
        assert ids is not None
        return np.bincount(np.ravel(ids) + 1, minlength=len(scene.instances) + 1)[1:] >= PIXELS

    for category in asked or [read_category(name) for name in HM3D_CATEGORIES]:
        for index, thing in enumerate(scene.instances):
            if thing.category == category:
                points, _ = roomy.beside(thing)
                _, first = np.unique(np.floor(points / SPACING), axis=0, return_index=True)
                views = [[x, y, roomy.floor + ON_MESH] for x, y in points[np.sort(first)] if in_sight(x, y)[index]]
                if views:
                    goal = Goal(category, index, thing.centre, np.array(views))
                    goals[category] = (*goals.get(category, ()), goal)
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
) -> tuple[Episode, ...]:  # fmt: skip
    """So many episodes, one category after the other, from `points` ``(n, 2)``. The same arguments give the same ones.

    `file` is the scene_id.

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
    episodes, origin = [], Origin(scene.hash, scene.source, ground.radius, ground.cell)
    for number in range(count):
        category = list(goals)[number % len(goals)]
        fits, ways, straight = starts[category]
        index, yaw = int(rng.choice(fits)), float(rng.uniform(-np.pi, np.pi))
        closest = int(ways[:, index].argmin())
        place = np.array([*points[index], ground.floor + ON_MESH])
        episodes.append(
            Episode(
                file, category, place, world_R_body(yaw), str(number), float(ways[closest, index]),
                float(straight[index]), goals[category][closest].instance, origin, dataset_config,
            )
        )  # fmt: skip
    return tuple(episodes)


# --- the folder -------------------------------------------------------------------------------------------------------

WITHOUT = (
    "habitat_sim is not installed here, so there are no .navmesh files: habitat-lab and eagor make them when they open "
    "a scene; in Habitat-Sim, call recompute_navmesh with the settings in <scene>.navmesh.json"
)


@dataclass(frozen=True)
class SceneSource:
    """A scene to export: its `number` and `name`, of which its folder is named, and how it is made."""

    number: int
    name: str
    make: Callable[[], Scene]


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
    sources: Sequence[SceneSource], folder: Path | str, *, name: str = "eagor", split: str = "val", episodes: int = 10,
    categories: Sequence[str] = (), radius: float = 0.18, on_done: Callable[[dict[str, Any]], object] = lambda _: None,
) -> tuple[Path, list[dict[str, Any]]]:  # fmt: skip
    """Write the folder; returns the episodes' ``<split>.json.gz``, and what was written of each scene.

    `episodes` of each scene, of these `categories` (`make_goals`), for a body of this `radius` (metres). The same call
    gives the same bytes. The folder appears when all of it is written: nothing is left of an export that fails.

    Raises `WorldError` if the folder holds something, for two scenes of one name, and as `make_goals` and
    `make_episodes`; `StorageError` if it cannot be written.
    """
    folder, names = Path(folder), [source.name for source in sources]
    for what, word in (("name", name), ("split", split)):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", word):
            raise WorldError(f"{what} = {word!r}; wanted letters, digits, - and _: folders get that name")
    if episodes < 1:
        raise WorldError(f"{episodes} episodes of each scene; wanted 1 or more")
    if twice := [each for each in names if names.count(each) > 1]:
        raise WorldError(f"two scenes have the name {twice[0]!r}; one would replace the other: rename one")
    home = Path("scene_datasets", name)
    config = home / f"{name}.scene_dataset_config.json"
    with all_or_nothing(folder) as part:
        scenes, done, files = [], [], []
        for source in sources:
            scene = source.make()
            file = f"{split}/{source.number:05d}-{source.name}/{source.name}.glb"
            ground = Ground.from_scene(scene, radius=radius)
            roomy, place = roomy_ground(scene, ground), f"./data/{config.as_posix()}"
            goals = make_goals(scene, roomy, categories)
            made = make_episodes(scene, ground, roomy.points, goals, episodes, f"{name}/{file}", place)
            glb = export_glb(scene, part / home / file, radius=radius)
            if has_meshes():
                _, error = run_apart(make_mesh, str(glb))
                if not glb.with_suffix(".navmesh").is_file():
                    raise WorldError(f"Habitat-Sim made no navigation mesh of {glb.stem}: {error}")
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
