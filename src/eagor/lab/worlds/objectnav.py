"""Object-goal episodes in the file format of Habitat's ObjectNav (HM3D), reading and writing.

    <folder>/<split>/<split>.json.gz              categories, no episodes
    <folder>/<split>/content/<scene>.json.gz      the episodes of a scene, and its goals by category

Here positions are at the feet, in our world (z up), and rotations are `world_R_body`; in the files they are Habitat's
(Y up, the axes of an exported GLB; quaternions x, y, z, w). `info["eagor"]`, which Habitat ignores, holds the scene,
its version and the body that an episode was made for, so that it is never run in another scene unnoticed. Our "tv" is
its "tv_monitor", and blanks are underscores there.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import msgspec
import numpy as np

from eagor._checks import parsed, shown
from eagor._files import unpacked, written
from eagor.conventions import (
    from_gltf,
    pose_from_habitat,
    pose_to_habitat,
    rotation_from_xyzw,
    to_gltf,
    xyzw_from_rotation,
)
from eagor.errors import EagorError, FormatError, WorldError
from eagor.lab.worlds.navmesh import NavMesh
from eagor.lab.worlds.scene import Scene
from eagor.queries import SYNONYMS

HM3D_CATEGORIES = ("chair", "bed", "plant", "toilet", "tv_monitor", "sofa")  # in the order of their ids
LAB_BODY = 0.88  # metres: height of the body in habitat-lab's configurations of ObjectNav on HM3D and MP3D
LAB_CLIMB, LAB_SLOPE = 0.2, 45.0  # metres and degrees: what habitat-lab's bodies climb by default


@dataclass(frozen=True, eq=False)
class Goal:
    """A thing to find.

    `instance`: its id in the scene; `position` ``(3,)``: its centre; `view_positions` ``(n, 3)``: places that count as
    having found it; `room`: its name, which is written and not read.
    """

    category: str
    instance: int | str
    position: np.ndarray
    view_positions: np.ndarray
    room: str | None = None


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


def read_category(category: str) -> str:
    """A category of Habitat's files and scenes in our words: lower case, our spelling."""
    words = " ".join(category.replace("_", " ").replace("/", " ").lower().split())
    return SYNONYMS.get(words, words)


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


# --- writing ---


def _goal_to_json(goal: Goal) -> dict[str, Any]:
    """The entry of a goal in `goals_by_category`: from each view point the agent faces it."""
    across, along, _ = (goal.position - goal.view_positions).T
    half = (np.arctan2(along, across) - np.pi / 2) / 2  # Habitat's agents look along -z, which is our y
    still = np.zeros(len(half))
    turns = np.stack([still, np.sin(half), still, np.cos(half)], axis=1)
    return {
        "position": to_gltf(goal.position).tolist(),
        "radius": None,
        "object_id": goal.instance,
        "object_name": f"{spelt(goal.category)}_{goal.instance}",
        "object_name_id": None,
        "object_category": spelt(goal.category),
        "room_id": None,
        "room_name": goal.room,
        "view_points": [
            {"agent_state": {"position": place, "rotation": turn}, "iou": 0.0}
            for place, turn in zip(to_gltf(goal.view_positions).tolist(), turns.tolist(), strict=True)
        ],
    }


def _episode_to_json(episode: Episode) -> dict[str, Any]:
    """The entry of an episode in `episodes`."""
    info = {
        "geodesic_distance": episode.geodesic,
        "euclidean_distance": episode.euclidean,
        "closest_goal_object_id": episode.nearest,
        "eagor": episode.origin and vars(episode.origin),
    }
    return {
        "episode_id": episode.identifier,
        "scene_id": episode.scene,
        "scene_dataset_config": episode.dataset_config,
        "additional_obj_config_paths": [],
        "start_position": to_gltf(episode.position).tolist(),
        "start_rotation": xyzw_from_rotation(pose_to_habitat(episode.world_R_body)).tolist(),
        "info": {key: value for key, value in info.items() if value is not None},
        "goals": [],
        "start_room": None,
        "shortest_paths": None,
        "object_category": spelt(episode.category),
    }


def write_episodes(folder: Path | str, split: str, scenes: Sequence[SceneEpisodes]) -> Path:
    """Write the files of a split; returns the path of `<split>.json.gz`. The same episodes give the same bytes.

    The scenes have files of different names. Raises `StorageError` if a file cannot be written.
    """
    folder = Path(folder) / split
    occur = {spelt(category) for scene in scenes for category in scene.goals}
    # The six of HM3D keep their numbers, even if not all of them occur.
    every = (*HM3D_CATEGORIES, *sorted(occur.difference(HM3D_CATEGORIES)))
    numbers = {category: number for number, category in enumerate(every) if category in occur}
    head = {"category_to_task_category_id": numbers, "category_to_scene_annotation_category_id": numbers}

    def write(path: Path, content: dict[str, Any]) -> Path:
        return written(path, gzip.compress(json.dumps(content | head, allow_nan=False).encode(), mtime=0))

    for scene in scenes:
        file = PurePosixPath(scene.episodes[0].scene).name
        content = {
            "episodes": [_episode_to_json(episode) for episode in scene.episodes],
            "goals_by_category": {
                _key(file, spelt(category)): [_goal_to_json(goal) for goal in goals]
                for category, goals in scene.goals.items()
            },
        }
        write(folder / "content" / f"{file.partition('.')[0]}.json.gz", content)
    return write(folder / f"{split}.json.gz", {"episodes": []})


# --- reading ---

_Finite = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Triple = tuple[_Finite, _Finite, _Finite]


class _State(msgspec.Struct):
    position: _Triple


class _View(msgspec.Struct):
    agent_state: _State


class _Goal(msgspec.Struct):
    object_category: str
    object_id: int | str
    position: _Triple
    view_points: list[_View]

    def made(self) -> Goal:
        views = np.array([view.agent_state.position for view in self.view_points]).reshape(-1, 3)
        place = from_gltf(np.array(self.position))
        return Goal(read_category(self.object_category), self.object_id, place, from_gltf(views))


class _Info(msgspec.Struct):
    geodesic_distance: _Finite | None = None
    euclidean_distance: _Finite | None = None
    closest_goal_object_id: int | str | None = None
    eagor: Origin | None = None


class _Episode(msgspec.Struct):
    scene_id: str
    start_position: _Triple
    start_rotation: tuple[_Finite, _Finite, _Finite, _Finite]
    episode_id: str | int | None = None
    object_category: str | None = None
    scene_dataset_config: str | None = None
    info: _Info | None = None
    goals: list[_Goal] = []

    def made(self, index: int) -> Episode:
        """The `index`-th of its file. Raises `EagorError` for a quaternion of length zero, `ValueError`."""
        category = self.object_category or next((goal.object_category for goal in self.goals), None)
        if category is None:
            raise ValueError("its category has no goals")
        info = self.info or _Info()
        return Episode(
            self.scene_id, read_category(category), from_gltf(np.array(self.start_position)),
            pose_from_habitat(rotation_from_xyzw(np.array(self.start_rotation))),
            str(index if self.episode_id is None else self.episode_id), info.geodesic_distance,
            info.euclidean_distance, info.closest_goal_object_id, info.eagor, self.scene_dataset_config or "default",
        )  # fmt: skip


class _File(msgspec.Struct):
    episodes: list[_Episode]
    goals_by_category: dict[str, list[_Goal]] | None = None


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
    """The episodes of a file by scene. Files that are older have the goals in each episode."""
    try:
        content = msgspec.convert(parsed(unpacked(path), strict=True), _File)
    except (EOFError, zlib.error) as error:
        raise WorldError(f"{path} is cut off or corrupt ({error}); copy or write it again") from error
    except (OSError, FormatError, ValueError, msgspec.ValidationError) as error:  # OSError also if it is not gzipped
        raise WorldError(
            f"{path} cannot be read: {str(error)[:300]}; wanted ObjectNav episodes as of HM3D v1 or v2, gzipped JSON"
        ) from error
    listed = content.goals_by_category
    if listed is None:
        listed = {}
        for entry in content.episodes:
            if entry.goals:
                category = entry.object_category or entry.goals[0].object_category
                listed.setdefault(_key(entry.scene_id, category), entry.goals)
    goals = {key: tuple(entry.made() for entry in entries) for key, entries in listed.items()}
    by_scene: dict[str, list[Episode]] = {}
    for index, entry in enumerate(content.episodes):
        try:
            episode = entry.made(index)
        except (EagorError, ValueError) as error:
            raise WorldError(f"{path}, episode {index}: {error}") from error
        by_scene.setdefault(episode.scene, []).append(episode)
    found = []
    for scene, episodes in by_scene.items():
        own = _of_scene(goals, scene, alone=len(by_scene) == 1)
        for index, episode in enumerate(episodes):
            if episode.category not in own:
                raise WorldError(f"{path}, episode {index} of {shown(scene)}: its category has no goals")
        found.append(SceneEpisodes(tuple(episodes), own))
    return found


def _key(scene: str, category: str) -> str:
    """The key of the goals of a category in a scene, as habitat-lab makes it."""
    return f"{PurePosixPath(scene).name}_{category}"


def _of_scene(goals: dict[str, tuple[Goal, ...]], scene: str, alone: bool) -> dict[str, tuple[Goal, ...]]:
    """The goals of one scene by category; those of a file with one scene all belong to it."""
    own: dict[str, tuple[Goal, ...]] = {}
    for key, things in goals.items():
        if things and (alone or key.startswith(_key(scene, ""))):
            own[things[0].category] = own.get(things[0].category, ()) + things
    return own
