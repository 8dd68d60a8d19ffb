"""An episode of a file, ready to be played: where it starts, what counts as reached, how long the shortest way is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.sphere import heading, world_R_body
from eagor.tasks.episodes import Episode
from eagor.tasks.listed import Listed, read_file
from eagor.tasks.places import Place, load_place, pixels_of
from eagor.tasks.rules import Camera, NavigationRules
from eagor.worlds.ground import STOREY
from eagor.worlds.objectnav import Episode as FileEpisode
from eagor.worlds.objectnav import Goal, check_scene
from eagor.worlds.scene import Scene
from eagor.worlds.walkable import Way

__all__ = ["ListedEpisode", "plan", "way_to_goal"]

OFF = 0.5  # metres that a start may lie above or below the ground: meshes float by the height of a voxel, or two


@dataclass(frozen=True, eq=False)
class ListedEpisode(Episode):
    """An episode of a file: centres of its goals ``(k, 3)`` and their view points ``(n, 3)``, metres, world frame.

    View points are those of all storeys: habitat-lab measures to the nearest of all. `listed`: how long the shortest
    way is according to the file, and its number there.
    """

    goals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    view_points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    listed: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return super().as_json() | {"slot": asdict(self.slot)}


def plan(slot: Listed, file: str, camera: Camera, rules: NavigationRules) -> ListedEpisode:
    """The episode of this slot, ready to be played.

    Raises `WorldError` if the scene is another one than the episode was made for, the start is not on free ground, or
    no way leads from there to a goal.
    """
    found = next((each for each in read_file(file) if each.episodes[0].scene == slot.scene), None)
    if found is None or slot.episode >= len(found.episodes):
        raise WorldError(f"{file} has no episode {slot.episode} in {slot.scene}; it has changed: start the run anew")
    episode = found.episodes[slot.episode]
    name = f"episode {slot.episode} of {slot.scene}"
    place = load_place(slot.world, slot.seed, camera.radius)
    if isinstance(place.scene, Scene):
        check_scene([episode], place.scene, place.ground)
    zero = float(getattr(place.scene, "zero", 0.0))  # the height of our z = 0 in the file
    start = _start(place, episode, name, zero)
    things = found.goals[episode.category]
    near = _on_this_storey(things, float(episode.position[2]))
    views = np.concatenate([thing.view_positions for thing in things])
    targets = tuple(i for i, thing in enumerate(place.scene.instances) if thing.category == episode.category)
    if rules.goal == "view_points" and not near:
        raise WorldError(
            f"{name} has no view points on the storey of its start; --set goal=footprint measures to the thing itself"
        )
    if rules.goal == "footprint" and not targets:
        raise WorldError(f"{name}: {place.scene.source} names no {episode.category}; leave goal at view_points")
    planned = ListedEpisode(
        slot=slot,
        scene=place.scene.source,
        scene_hash=place.scene.hash,
        query=episode.category,
        targets=targets,
        start=(float(start[0]), float(start[1])),
        yaw=heading(episode.world_R_body),
        shortest=math.inf,
        goals=np.array([thing.position for thing in near or things]) - [0.0, 0.0, zero],
        view_points=views - [0.0, 0.0, zero],
        listed={"episode_id": episode.identifier, "geodesic_distance": episode.geodesic},
    )
    way = way_to_goal(place, planned) if rules.goal == "view_points" else place.way_to(targets)
    shortest = float(way.distance(start))
    if not math.isfinite(shortest):
        raise WorldError(
            f"{name}: no way leads from ({start[0]:.2f}, {start[1]:.2f}) to "
            f"{'a view point of ' * (rules.goal == 'view_points')}any {episode.category}; leave it out, or use the "
            "body that it was made for"
        )
    ends = views[:, :2] if rules.goal == "view_points" else planned.goals[:, :2]
    straight = float(np.hypot(*(ends - start).T).min())
    shown = pixels_of(place.ids(place.eye(start, camera.height), world_R_body(0.0)), targets)
    kind = {
        "visible": shown >= rules.visible_pixels,
        "way": "winding" if shortest > rules.winding_above * straight else "direct",
        "category": episode.category,
    }
    return ListedEpisode(**{**vars(planned), "shortest": shortest, "stratum": kind})


def way_to_goal(place: Place, episode: ListedEpisode) -> Way:
    """Geodesic distance to the nearest view point of any goal."""
    return place.way_to_views(episode.view_points)


def _start(place: Place, episode: FileEpisode, name: str, zero: float) -> np.ndarray:
    """The start ``(2,)`` on free ground, which may be a cell away: files of others hold rounded numbers.

    `zero`: the height of our z = 0 in the file.
    """
    xy = episode.position[:2]
    found = place.ground.snap(xy, within=place.ground.cell)
    if found is None:
        near = place.ground.snap(xy)
        away = (
            "nothing is free there" if near is None else f"the nearest free place is {np.hypot(*(near - xy)):.2f} m off"
        )
        raise WorldError(
            f"{name} starts at ({xy[0]:.2f}, {xy[1]:.2f}), which is not on free ground for a body of radius "
            f"{place.ground.radius:g} m in {place.scene.source}: {away}. Use the scene and the radius it was made for"
        )
    ground = zero + place.ground.height(found)
    if abs(ground - episode.position[2]) > OFF:
        raise WorldError(
            f"{name} starts at the height {episode.position[2]:.2f} m, but the ground there is at {ground:.2f} m in "
            f"{place.scene.source}: it is on another storey. Choose the world that holds its storey: --world habitat "
            "does so by itself, habitat:SCENE?storey=HEIGHT by hand"
        )
    return found


def _on_this_storey(things: Sequence[Goal], height: float) -> list[Goal]:
    """The goals with view points on the storey of this height."""
    return [thing for thing in things if (np.abs(thing.view_positions[:, 2] - height) <= STOREY).any()]
