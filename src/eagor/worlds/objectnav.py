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
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

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
from eagor.queries import SYNONYMS
from eagor.worlds.scene import Scene
from eagor.worlds.walkable import Walkable


@dataclass(frozen=True, eq=False)
class Goal:
    """A thing to find.

    `instance`: its id in the scene; `position` ``(3,)``: its centre; `view_positions` ``(n, 3)``, `view_rotations`
    ``(n, 3, 3)`` and `view_overlap` ``(n,)``: poses that count as having found it, and how well it fills the view there
    (Habitat's iou); `room`: its name, if known; `radius`: Habitat's, metres, if any.
    """

    category: str
    instance: int
    position: np.ndarray
    name: str = ""
    room: str | None = None
    view_positions: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    view_rotations: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    view_overlap: np.ndarray = field(default_factory=lambda: np.zeros(0))
    radius: float | None = None


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
    distance; `info`: everything else in the file; `origin`: None in the files of others.
    """

    scene: str
    category: str
    position: np.ndarray
    world_R_body: np.ndarray
    identifier: str = ""
    geodesic: float | None = None
    euclidean: float | None = None
    nearest: int | None = None
    room: str | None = None
    origin: Origin | None = None
    dataset_config: str = "default"
    info: dict[str, Any] = field(default_factory=dict)


def spelt(category: str) -> str:
    """The category as written in the files."""
    return "tv_monitor" if category == "tv" else category.replace(" ", "_")


def _goal_to_json(goal: Goal) -> dict[str, Any]:
    """The entry of a goal in `goals_by_category`."""
    places = to_gltf(np.asarray(goal.view_positions, dtype=np.float64))
    turns = xyzw_from_rotation(pose_to_habitat(goal.view_rotations)) if len(places) else np.zeros((0, 4))
    return {
        "position": to_gltf(np.asarray(goal.position, dtype=np.float64)).tolist(),
        "radius": goal.radius,
        "object_id": goal.instance,
        "object_name": goal.name or f"{spelt(goal.category)}_{goal.instance}",
        "object_name_id": None,
        "object_category": spelt(goal.category),
        "room_id": None,
        "room_name": goal.room,
        "view_points": [
            {"agent_state": {"position": place, "rotation": turn}, "iou": float(overlap)}
            for place, turn, overlap in zip(places.tolist(), turns.tolist(), goal.view_overlap, strict=True)
        ],
    }


def _episode_to_json(episode: Episode, goals: dict[str, tuple[Goal, ...]]) -> dict[str, Any]:
    """The entry of an episode in `episodes`. Raises `WorldError` if its category is not among the goals."""
    if not goals.get(episode.category):
        raise WorldError(f"episode {episode.identifier!r} looks for a {episode.category!r}, but no such goal is given")
    known = {
        "geodesic_distance": episode.geodesic,
        "euclidean_distance": episode.euclidean,
        "closest_goal_object_id": episode.nearest,
        "eagor": episode.origin and vars(episode.origin),
    }
    info = episode.info | {key: value for key, value in known.items() if value is not None}
    return {
        "episode_id": episode.identifier,
        "scene_id": episode.scene,
        "scene_dataset_config": episode.dataset_config,
        "additional_obj_config_paths": [],
        "start_position": to_gltf(np.asarray(episode.position, dtype=np.float64)).tolist(),
        "start_rotation": xyzw_from_rotation(pose_to_habitat(episode.world_R_body)).tolist(),
        "info": info,
        "goals": [],
        "start_room": episode.room,
        "shortest_paths": None,
        "object_category": spelt(episode.category),
    }


def read_category(category: str) -> str:
    """A category of Habitat's files and scenes in our words: lower case, our spelling."""
    words = " ".join(category.replace("_", " ").replace("/", " ").lower().split())
    return SYNONYMS.get(words, words)


def _numbers(values: Any, count: int) -> np.ndarray:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise ValueError(f"{values!r} is not {count} finite numbers")
    return found


def _table(rows: list[Any], count: int) -> np.ndarray:
    """Rows ``(n, count)``, all at once, as files may have a million."""
    try:
        found = np.asarray(rows, dtype=np.float64).reshape(len(rows), -1)
    except (TypeError, ValueError):
        found = None
    if found is None or (len(rows) and (found.shape[1] != count or not np.isfinite(found).all())):
        found = np.array([_numbers(row, count) for row in rows])  # names the row
    return found.reshape(-1, count)


def _goal_from_json(entry: dict[str, Any]) -> Goal:
    """The goal in an entry; a malformed entry may raise anything."""
    views = entry["view_points"]
    places = _table([view["agent_state"]["position"] for view in views], 3)
    turns = _table([view["agent_state"]["rotation"] for view in views], 4)
    return Goal(
        read_category(entry["object_category"]), int(entry["object_id"]), from_gltf(_numbers(entry["position"], 3)),
        str(entry.get("object_name") or ""), entry.get("room_name"), from_gltf(places),
        pose_from_habitat(rotation_from_xyzw(turns)) if len(turns) else np.zeros((0, 3, 3)),
        np.array([float(view.get("iou") or 0.0) for view in views]), entry.get("radius"),
    )  # fmt: skip


def _episode_from_json(entry: dict[str, Any], index: int) -> Episode:
    """The episode in an entry; a malformed entry may raise anything."""
    info = dict(entry.get("info") or {})
    ours = info.pop("eagor", None)
    geodesic, euclidean = (info.pop(key, None) for key in ("geodesic_distance", "euclidean_distance"))
    nearest = info.pop("closest_goal_object_id", None)
    for value in (geodesic, euclidean):
        if value is not None and not math.isfinite(value):
            raise ValueError(f"a distance of {value}")
    return Episode(
        str(entry["scene_id"]),
        read_category(entry["object_category"]),
        from_gltf(_numbers(entry["start_position"], 3)),
        pose_from_habitat(rotation_from_xyzw(_numbers(entry["start_rotation"], 4))),
        str(entry.get("episode_id", index)),
        geodesic,
        euclidean,
        nearest,
        entry.get("start_room"),
        None
        if ours is None
        else Origin(str(ours["scene_hash"]), str(ours["version"]), float(ours["radius"]), float(ours["cell"])),
        str(entry.get("scene_dataset_config") or "default"),
        info,
    )


# --- the episodes of a scene ------------------------------------------------------------------------------------------

HM3D_CATEGORIES = ("chair", "bed", "plant", "toilet", "tv_monitor", "sofa")  # in the order of their ids


@dataclass(frozen=True, eq=False)
class SceneEpisodes:
    """The episodes of one scene, and its goals by category."""

    episodes: tuple[Episode, ...]
    goals: dict[str, tuple[Goal, ...]]


def goal_of(scene: Scene, ground: Walkable, index: int, spacing: float = 0.25) -> Goal:
    """An instance of the scene as a goal: its view points are free points beside it, `spacing` metres apart, facing it.

    `Ground.beside` finds them. `view_overlap` is not computed: it is 0.
    """
    thing = scene.instances[index]
    points, _ = ground.beside(thing)
    _, first = np.unique(np.floor(points / spacing), axis=0, return_index=True)
    points = points[np.sort(first)]
    across, along = (thing.centre[:2] - points).T
    azimuth = np.arctan2(along, across)
    turns = np.zeros((len(points), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(azimuth)
    turns[:, 1, 0], turns[:, 0, 1], turns[:, 2, 2] = np.sin(azimuth), -np.sin(azimuth), 1.0
    places = np.column_stack([points, np.full(len(points), ground.floor)])
    return Goal(
        thing.category, index, thing.centre, room=thing.room, view_positions=places, view_rotations=turns,
        view_overlap=np.zeros(len(points)),
    )  # fmt: skip


def check_scene(episode: Episode, scene: Scene, ground: Walkable) -> None:
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


def write_episodes(folder: Path | str, split: str, scenes: Sequence[SceneEpisodes]) -> Path:
    """Write the files of a split; returns the path of `<split>.json.gz`. The same episodes give the same bytes.

    Raises `WorldError` for a scene without episodes, two scenes with files of one name, an episode whose category has
    no goal, or numbers that are not finite; `StorageError` if a file cannot be written.
    """
    folder = Path(folder) / split
    occur = {spelt(category) for scene in scenes for category in scene.goals}
    # The six of HM3D keep their numbers, even if not all of them occur.
    every = (*HM3D_CATEGORIES, *sorted(occur.difference(HM3D_CATEGORIES)))
    numbers = {category: number for number, category in enumerate(every) if category in occur}
    head = {"category_to_task_category_id": numbers, "category_to_scene_annotation_category_id": numbers}
    contents: dict[str, dict[str, Any]] = {}
    for scene in scenes:
        names = {episode.scene for episode in scene.episodes}
        if len(names) != 1:
            raise WorldError(f"the episodes of one scene name the scenes {sorted(names)}; wanted exactly one")
        (file,) = names
        stem = PurePosixPath(file).name.split(".")[0]
        if stem in contents:
            raise WorldError(f"two scenes have files of the name {stem!r}; one would replace the other: rename one")
        contents[stem] = {
            "episodes": [_episode_to_json(episode, scene.goals) for episode in scene.episodes],
            "goals_by_category": {
                _key(file, spelt(category)): [_goal_to_json(goal) for goal in goals]
                for category, goals in scene.goals.items()
            },
            **head,
        }
    for stem, content in contents.items():
        _write(folder / "content" / f"{stem}.json.gz", content)
    return _write(folder / f"{split}.json.gz", {"episodes": [], **head})


def _write(path: Path, content: dict[str, Any]) -> Path:
    try:
        text = json.dumps(content, allow_nan=False)
    except ValueError as error:
        raise WorldError(
            f"{path.name} would hold numbers that are not finite (no way to the goal?): {error}"
        ) from error
    return written(path, gzip.compress(text.encode(), mtime=0))


# --- reading ---


def read_episodes(path: Path | str) -> tuple[SceneEpisodes, ...]:
    """The episodes in `<split>.json.gz` and its content files, by scene, or in a content file alone.

    Raises `WorldError` if a file is missing, truncated, not JSON, lacks a key, or holds numbers that are not finite.
    """
    path = Path(path)
    files = sorted((path.parent / "content").glob("*.json.gz"))
    found = _scenes_from_json(path, _read(path))
    if not found:
        found = [each for file in files for each in _scenes_from_json(file, _read(file))]
    if not found:
        raise WorldError(f"{path} has no episodes, nor has any file in {path.parent / 'content'}; wanted at least one")
    return tuple(found)


def _read(path: Path) -> dict[str, Any]:
    try:
        content = parsed(unpacked(path), strict=True)
    except OSError as error:  # also raised by gzip for files that are not gzipped
        raise WorldError(f"{path} cannot be read: {error}; wanted gzipped JSON") from error
    except (EOFError, zlib.error) as error:
        raise WorldError(f"{path} is cut off or corrupt ({error}); copy or write it again") from error
    except FormatError as error:
        raise WorldError(f"{path} cannot be read: {error}; wanted ObjectNav episodes") from error
    except ValueError as error:
        raise WorldError(f"{path} holds no valid JSON ({error}); wanted ObjectNav episodes") from error
    if not isinstance(content, dict):
        raise WorldError(f"{path} holds a {type(content).__name__}; wanted an object with episodes")
    return content


def _scenes_from_json(path: Path, content: dict[str, Any]) -> list[SceneEpisodes]:
    """The episodes of a file by scene. Files that are older have the goals in each episode."""
    where = str(path)
    try:
        listed = content.get("goals_by_category")
        if listed is None:
            listed = {}
            for index, entry in enumerate(content["episodes"]):
                where = f"{path}, episode {index}"
                if not entry["goals"]:
                    raise WorldError("its category has no goals")
                entry.setdefault("object_category", entry["goals"][0]["object_category"])
                listed.setdefault(_key(str(entry["scene_id"]), entry["object_category"]), entry["goals"])
        goals: dict[str, tuple[Goal, ...]] = {}
        for key, entries in listed.items():
            where = f"{path}, goals {shown(key)}"
            goals[key] = tuple(_goal_from_json(entry) for entry in entries)
        by_scene: dict[str, list[Episode]] = {}
        for index, entry in enumerate(content["episodes"]):
            where = f"{path}, episode {index}"
            episode = _episode_from_json(entry, index)
            by_scene.setdefault(episode.scene, []).append(episode)
        found = []
        for scene, episodes in by_scene.items():
            own = _of_scene(goals, scene, alone=len(by_scene) == 1)
            for index, episode in enumerate(episodes):
                where = f"{path}, episode {index} of {scene}"
                if episode.category not in own:
                    raise WorldError("its category has no goals")
            found.append(SceneEpisodes(tuple(episodes), own))
    except KeyError as error:
        raise WorldError(f"{where} lacks the key {error}; wanted the layout of HM3D ObjectNav v1 or v2") from error
    except (EagorError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise WorldError(f"{where}: {str(error)[:300]}; wanted the layout of HM3D ObjectNav v1 or v2") from error
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
