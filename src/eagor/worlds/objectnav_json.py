"""Goals, episodes, and their keys in Habitat's ObjectNav files; the public entry point is `eagor.worlds.objectnav`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from eagor.conventions import (
    from_gltf,
    pose_from_habitat,
    pose_to_habitat,
    rotation_from_xyzw,
    to_gltf,
    xyzw_from_rotation,
)
from eagor.errors import WorldError
from eagor.queries import SYNONYMS


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


def goal_to_json(goal: Goal) -> dict[str, Any]:
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


def episode_to_json(episode: Episode, goals: dict[str, tuple[Goal, ...]]) -> dict[str, Any]:
    """The entry of an episode in `episodes`. Raises `WorldError` if its category is not among the goals."""
    if not goals.get(episode.category):
        raise WorldError(f"episode {episode.identifier!r} looks for a {episode.category!r}, but no such goal is given")
    info = dict(episode.info)
    for key, value in (
        ("geodesic_distance", episode.geodesic),
        ("euclidean_distance", episode.euclidean),
        ("closest_goal_object_id", episode.nearest),
    ):
        if value is not None:
            info[key] = value
    if episode.origin is not None:
        info["eagor"] = vars(episode.origin)
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
    """A category of the files in our words."""
    words = category.replace("_", " ")
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


def goal_from_json(entry: dict[str, Any]) -> Goal:
    """The goal in an entry; a malformed entry may raise anything."""
    views = entry["view_points"]
    places = _table([view["agent_state"]["position"] for view in views], 3)
    turns = _table([view["agent_state"]["rotation"] for view in views], 4)
    return Goal(
        read_category(entry["object_category"]),
        int(entry["object_id"]),
        from_gltf(_numbers(entry["position"], 3)),
        str(entry.get("object_name") or ""),
        entry.get("room_name"),
        from_gltf(places),
        pose_from_habitat(rotation_from_xyzw(turns)) if len(turns) else np.zeros((0, 3, 3)),
        np.array([float(view.get("iou") or 0.0) for view in views]),
        entry.get("radius"),
    )


def episode_from_json(entry: dict[str, Any], index: int) -> Episode:
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
