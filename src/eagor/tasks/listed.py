"""Episodes that a file lists: ObjectNav of HM3D or MP3D, or what ``eagor export habitat`` writes.

They are played in Habitat (``--world habitat``), in the scene that the file names below the folder of scenes. In our
own world only episodes of ours can be played: they say which apartment or exported GLB they were made for.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.sphere import azimuth_elevation, world_R_body
from eagor.tasks.episodes import Episode, Slot
from eagor.tasks.places import APARTMENT, SEEDS, Place, load_place, pixels_of
from eagor.tasks.rules import Camera, NavigationRules
from eagor.worlds.objectnav import Episode as FileEpisode
from eagor.worlds.objectnav import SceneEpisodes, check_scene, read_episodes
from eagor.worlds.scene import Scene
from eagor.worlds.walkable import Way

__all__ = ["HABITAT", "Listed", "ListedEpisode", "listed_slots", "plan", "scene_files", "slot_of", "way_to_goal"]

HABITAT = "habitat"  # the world in which scenes of others can be played
_APARTMENT = re.compile(r"apartment (\S+) seed (\d+)")
STOREY = 1.5  # metres: view points higher or lower than that are on another storey
_PREFIX = "data/scene_datasets/"  # of some scene_ids; habitat-lab takes it off, too


@dataclass(frozen=True)
class Listed(Slot):
    """An episode of a file: the `episode`-th of its `scene` (the scene_id there)."""

    scene: str = ""
    episode: int = 0

    @property
    def id(self) -> str:
        """Stable name: the scene's, and the index of the episode among those of the scene."""
        return f"{_stem(self.scene)}-{self.episode}"

    def rng(self, purpose: str) -> np.random.Generator:
        """An independent generator for each purpose, wherever the folder of scenes is."""
        name = f"{self.task}/{self.scene}/{self.episode}/{purpose}"
        return np.random.default_rng([zlib.crc32(name.encode()), self.episode])


@dataclass(frozen=True, eq=False)
class ListedEpisode(Episode):
    """An episode of a file: centres of its goals ``(k, 3)`` and their view points ``(n, 3)``, metres, world frame.

    `listed`: how long the shortest way is according to the file, and its number there.
    """

    goals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    view_points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    listed: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return super().as_json() | {"slot": asdict(self.slot)}


def slot_of(values: dict[str, Any]) -> Slot:
    """The slot of a unit of work, from JSON."""
    return Listed(**values) if "scene" in values else Slot(**values)


def listed_slots(task: str, file: Path | str, count: int | None, world: str, scenes: Path | None) -> list[Listed]:
    """The slots of a file's episodes; of `count` (None: all) scene after scene gets one until there are enough.

    `world`: "apartment" (ours), "habitat", or one scene of either (a GLB file, ``habitat:SCENE``). `scenes`: the folder
    that the scene_ids are relative to; None: the nearest ``scene_datasets`` above the file.

    Raises `WorldError` if the file cannot be read, or its scenes cannot be played in that world.
    """
    if count is not None and count < 1:
        raise WorldError(f"{count} episodes; wanted 1 or more")
    by_scene = {each.episodes[0].scene: each for each in _read(str(file))}
    if world not in (APARTMENT, HABITAT) and len(by_scene) > 1:
        raise WorldError(
            f"{file} has episodes in {len(by_scene)} scenes, but --world {world} is one of them; name the world "
            f"{HABITAT if world.startswith(f'{HABITAT}:') else APARTMENT} alone, and their folder with --scenes"
        )
    homes = {scene: _home(scene, each, world, number, Path(file), scenes)
             for number, (scene, each) in enumerate(by_scene.items())}  # fmt: skip
    _check_files({scene: home[0] for scene, home in homes.items()}, file)
    turns = [
        (index, scene) for scene, each in by_scene.items() for index in range(len(each.episodes))
    ]  # (0, a), (1, a), (0, b), ...
    if count is not None:
        turns = sorted(sorted(turns, key=lambda turn: turn[0])[:count], key=lambda turn: (homes[turn[1]][1], turn[0]))
    return [
        Listed(task, _storey(homes[scene][0], by_scene[scene], index), homes[scene][1], index, number, scene, index)
        for number, (index, scene) in enumerate(turns)
    ]


def _storey(world: str, episodes: SceneEpisodes, index: int) -> str:
    """The world, with the storey of Habitat's scene on which the episode starts (to half a metre)."""
    if not world.startswith(f"{HABITAT}:") or "storey=" in world:
        return world
    height = round(2 * float(episodes.episodes[index].position[2])) / 2
    return f"{world}{'&' if '?' in world else '?'}storey={height:g}"


def scene_files(slots: Sequence[Slot]) -> list[Path]:
    """The files of the scenes in which these are played; none of apartments."""
    return [Path(path) for path in dict.fromkeys(_file(slot.world) for slot in slots) if path]


def plan(slot: Listed, file: str, camera: Camera, rules: NavigationRules) -> ListedEpisode:
    """The episode of this slot, ready to be played.

    Raises `WorldError` if the scene is another one than the episode was made for, the start is not on free ground, or
    no way leads from there to a goal.
    """
    found = next((each for each in _read(file) if each.episodes[0].scene == slot.scene), None)
    if found is None or slot.episode >= len(found.episodes):
        raise WorldError(f"{file} has no episode {slot.episode} in {slot.scene}; it has changed: start the run anew")
    episode = found.episodes[slot.episode]
    name = f"episode {slot.episode} of {slot.scene}"
    place = load_place(slot.world, slot.seed, camera.radius)
    if isinstance(place.scene, Scene):
        check_scene([episode], place.scene, place.ground)
    start = _start(place, episode, name)
    things = found.goals[episode.category]
    zero = 0.0 if isinstance(place.scene, Scene) else place.scene.zero
    views = np.concatenate([thing.view_positions for thing in things]) - np.array([0.0, 0.0, zero])
    here = np.array([abs(point[2] - place.ground.height(point[:2])) < STOREY for point in views], dtype=bool)
    if len(views) and not here.any():
        raise WorldError(f"{name}: all view points are on other storeys, and the body stays on its own; leave it out")
    views = views[here]
    targets = tuple(i for i, thing in enumerate(place.scene.instances) if thing.category == episode.category)
    if rules.goal == "view_points" and len(views) == 0:
        raise WorldError(f"{name} has no view points; --set goal=footprint measures to the thing itself")
    if rules.goal == "footprint" and not targets:
        raise WorldError(f"{name}: {place.scene.source} names no {episode.category}; leave goal at view_points")
    azimuth, _ = azimuth_elevation(episode.world_R_body[:, 0])
    planned = ListedEpisode(
        slot=slot,
        scene=place.scene.source,
        scene_hash=place.scene.hash,
        query=episode.category,
        targets=targets,
        start=(float(start[0]), float(start[1])),
        yaw=float(azimuth),
        shortest=math.inf,
        goals=np.array([thing.position for thing in things]) - np.array([0.0, 0.0, zero]),
        view_points=views,
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
    kind = {
        "visible": pixels_of(place.ids(place.eye(start, camera.height), world_R_body(0.0)), targets)
        >= rules.visible_pixels,
        "way": "winding" if shortest > rules.winding_above * straight else "direct",
        "category": episode.category,
    }
    return ListedEpisode(**{**vars(planned), "shortest": shortest, "stratum": kind})


def way_to_goal(place: Place, episode: ListedEpisode) -> Way:
    """Geodesic distance to the nearest view point of any goal."""
    return place.way_to_points(episode.view_points[:, :2])


def _start(place: Place, episode: FileEpisode, name: str) -> np.ndarray:
    """The start ``(2,)`` on free ground, which may be a cell away: files of others hold rounded numbers."""
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
    return found


def _home(
    scene: str, episodes: SceneEpisodes, world: str, number: int, file: Path, scenes: Path | None
) -> tuple[str, int]:
    """World and seed in which the episodes of this scene are played; seeds of what is no apartment begin at 10 000."""
    if world == HABITAT:
        return f"{HABITAT}:{_below(scene, file, scenes)}", SEEDS + number
    if world != APARTMENT:
        return world, SEEDS + number
    origins = {episode.origin.version for episode in episodes.episodes if episode.origin is not None}
    if len(origins) != 1 or any(episode.origin is None for episode in episodes.episodes):
        raise WorldError(
            f"{file}: the episodes in {scene} do not say which of our scenes they were made for, so they can only be "
            f"played in Habitat: --world {HABITAT} --scenes DIR"
        )
    (version,) = origins
    if match := _APARTMENT.fullmatch(version):
        from eagor.worlds.apartment import VERSION

        if match[1] != VERSION or int(match[2]) >= SEEDS:
            raise WorldError(
                f"{file}: the episodes in {scene} were made for {version}; this version makes apartments {VERSION} "
                f"with seeds below {SEEDS}. Export them anew"
            )
        return APARTMENT, int(match[2])
    return str(_below(scene, file, scenes)), SEEDS + number


def _below(scene: str, file: Path, scenes: Path | None) -> Path:
    """The file of a scene below the folder of scenes."""
    if scenes is None:
        above = [parent / "scene_datasets" for parent in file.absolute().parents]
        scenes = next((folder for folder in above if folder.is_dir()), None)
    if scenes is None:
        raise WorldError(
            f"no folder scene_datasets is above {file}; say where the scenes are with --scenes DIR, the folder that "
            f"holds {scene.removeprefix(_PREFIX)}"
        )
    return Path(scenes) / scene.removeprefix(_PREFIX)


def _check_files(worlds: dict[str, str], file: Path | str) -> None:
    """Raise `WorldError` if not one of the scenes is there; a part of them is what many people have."""
    paths = {scene: Path(path) for scene, world in worlds.items() if (path := _file(world))}
    if paths and len(paths) == len(worlds) and not any(path.exists() for path in paths.values()):
        scene, path = next(iter(paths.items()))
        raise WorldError(
            f"none of the {len(paths)} scenes of {file} is there, such as {path}; --scenes names the folder that holds "
            f"{scene.removeprefix(_PREFIX)}"
        )


def _file(world: str) -> str:
    """The file of a world; empty for apartments."""
    return "" if world == APARTMENT else world.removeprefix(f"{HABITAT}:").partition("?")[0]


def _stem(scene: str) -> str:
    return PurePosixPath(scene).name.partition(".")[0]


@lru_cache(maxsize=2)
def _read(file: str) -> tuple[SceneEpisodes, ...]:
    return read_episodes(Path(file))
