"""Episodes, the same for every method: how those of a run are numbered, and those that a file lists.

N episodes with seed S use the apartments S, S + 1, ..., `PER_PLACE` in each. All randomness derives from an episode's
identity, so any part of a run can be played alone.

Files list episodes of ObjectNav of HM3D or MP3D, or what ``eagor export habitat`` writes. They are played in Habitat
(``--world habitat``), or, if they say which apartment or exported GLB they were made for, in our own world.
"""

from __future__ import annotations

import hashlib
import math
import re
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from eagor.errors import WorldError
from eagor.lab.envs.places import APARTMENT, SEEDS, Place, load_place, pixels_of
from eagor.lab.envs.rules import VISIBLE, WINDING, Camera, NavigationRules
from eagor.lab.worlds import FILES
from eagor.lab.worlds.ground import STOREY
from eagor.lab.worlds.objectnav import LAB_BODY, SceneEpisodes, check_scene, read_episodes
from eagor.lab.worlds.objectnav import Episode as ObjectNavEpisode
from eagor.lab.worlds.scene import Scene
from eagor.sphere import heading, world_R_body

PER_PLACE = 5
UNRECORDED = ("spec", "route", "view_points", "goals")  # long parts of an episode, which its spec brings back


@dataclass(frozen=True)
class EpisodeSpec:
    """A place in a run: the `number`-th episode of the run, the `index`-th in the world of this `seed`."""

    task: str
    world: str
    seed: int
    index: int
    number: int

    @property
    def id(self) -> str:
        """Stable name: seed of the apartment, and index of the episode in it."""
        return f"{self.seed}-{self.index}"

    def rng(self, purpose: str) -> np.random.Generator:
        """An independent generator for each purpose, wherever the file of the scene is."""
        file, world = scene_file(self.world), self.world
        if file and Path(file).is_file():
            world = world.replace(file, _digest(*_states(Path(file))), 1)
        name = f"{self.task}/{world}/{self.id}/{purpose}"
        return np.random.default_rng([zlib.crc32(name.encode()), self.seed, self.index])


@dataclass(frozen=True)
class Episode:
    """Where it happens, what to look for, and where the body starts.

    `targets`: ids of the things that the query names; `start`: x, y in metres; `yaw`: radians; `stratum`: kind of the
    episode, for tables; `shortest`: geodesic metres from the start to the nearest target's footprint, inf if no path
    leads there (things on walls can be targets, too).
    """

    spec: EpisodeSpec
    scene: str
    scene_hash: str
    query: str
    targets: tuple[int, ...]
    start: tuple[float, float]
    yaw: float
    shortest: float
    stratum: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """For records and reports."""
        known = {"id": self.spec.id, "seed": self.spec.seed, "world": self.spec.world, "index": self.spec.index}
        rest = {key: value for key, value in asdict(self).items() if key not in UNRECORDED}
        return known | rest | {"shortest": self.shortest if math.isfinite(self.shortest) else None}


def episode_specs(task: str, count: int, seed: int, world: str = APARTMENT) -> Iterator[EpisodeSpec]:
    """The specs of a run. Raises `WorldError` if there are not enough apartments."""
    if count < 1:
        raise WorldError(f"{count} episodes; wanted 1 or more")
    places = (count + PER_PLACE - 1) // PER_PLACE
    if not 0 <= seed <= SEEDS - places:
        raise WorldError(
            f"{count} episodes from seed {seed} need apartments {seed} to {seed + places - 1}; "
            f"there are 0 to {SEEDS - 1}"
        )
    for number in range(count):
        yield EpisodeSpec(task, world, seed + number // PER_PLACE, number % PER_PLACE, number)


def choose_target(place: Place, rng: np.random.Generator) -> Iterator[tuple[int, str]]:
    """The nameable things of a place in random order, with their names; every category is equally likely."""
    by_category: dict[str, list[int]] = {}
    names = place.nameable()
    for index in names:
        by_category.setdefault(place.scene.instances[index].category, []).append(index)
    for category in rng.permutation(sorted(by_category)):
        for index in rng.permutation(by_category[str(category)]):
            yield int(index), str(names[int(index)])


# --- episodes that a file lists ---------------------------------------------------------------------------------------

HABITAT = "habitat"  # the world in which scenes of others can be played
BODY = f"body={LAB_BODY:g}"  # the option that asks for the mesh on which habitat-lab judges such episodes
_PREFIX = "data/scene_datasets/"  # of some scene_ids; habitat-lab takes it off, too
OFF = 0.5  # metres that a start may lie above or below the ground: meshes float by the height of a voxel, or two


@dataclass(frozen=True)
class FileEpisodeSpec(EpisodeSpec):
    """An episode of a file: the `episode`-th of its `scene` (the scene_id there)."""

    scene: str = ""
    episode: int = 0

    @property
    def id(self) -> str:
        """Stable name: the scene's, and the index of the episode among those of the scene."""
        return f"{PurePosixPath(self.scene).name.partition('.')[0]}-{self.episode}"

    def rng(self, purpose: str) -> np.random.Generator:
        """An independent generator for each purpose, wherever the folder of scenes is."""
        name = f"{self.task}/{self.scene}/{self.episode}/{purpose}"
        return np.random.default_rng([zlib.crc32(name.encode()), self.episode])


@dataclass(frozen=True, eq=False)
class FileEpisode(Episode):
    """An episode of a file: centres of its goals ``(k, 3)`` and their view points ``(n, 3)``, metres, world frame.

    View points are those of all storeys: habitat-lab measures to the nearest of all. `listed`: how long the shortest
    way is according to the file, and its number there.
    """

    goals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    view_points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    listed: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return super().as_json() | {"slot": asdict(self.spec)}


def spec_from_json(values: dict[str, Any]) -> EpisodeSpec:
    """The spec of a unit of work."""
    return FileEpisodeSpec(**values) if "scene" in values else EpisodeSpec(**values)


def file_episode_specs(
    task: str, file: Path | str, count: int | None, world: str, scenes: Path | None
) -> list[FileEpisodeSpec]:
    """The specs of a file's episodes; of `count` (None: all) scene after scene gets one until there are enough.

    `world`: "apartment" (ours), "habitat" (options may follow "?"), or one scene of either (a GLB file,
    ``habitat:SCENE``). `scenes`: the folder that the scene_ids are relative to; None: the nearest ``scene_datasets``
    above the file. Raises `WorldError` if the file cannot be read, or its scenes cannot be played in that world.
    """
    if count is not None and count < 1:
        raise WorldError(f"{count} episodes; wanted 1 or more")
    by_scene = {each.episodes[0].scene: each for each in read_file(file)}
    name, _, options = world.partition("?")
    whole = HABITAT if name.partition(":")[0] == HABITAT else APARTMENT
    if whole == HABITAT:
        options = "&".join(filter(None, (options, "" if "body=" in options else BODY)))
        world = HABITAT if name in (HABITAT, f"{HABITAT}:") else f"{name}?{options}"
    if world != whole and len(by_scene) > 1:
        raise WorldError(
            f"{file} has episodes in {len(by_scene)} scenes, but --world {world} is one of them; name the world "
            f"{whole} alone, and their folder with --scenes"
        )
    homes: dict[str, list[tuple[str, int]]] = {}  # world and seed of each episode of a scene
    for seed, (scene, listed) in enumerate(by_scene.items(), SEEDS):
        if world == HABITAT:
            homes[scene] = [(home, seed) for home in _storeys(scene, listed, options, Path(file), scenes)]
        else:
            home = _home_of_ours(scene, listed, seed, Path(file), scenes) if world == APARTMENT else (world, seed)
            homes[scene] = [home] * len(listed.episodes)
    paths = [scene_file(each[0][0]) for each in homes.values()]
    if all(paths) and not any(Path(path).exists() for path in paths):  # a part of them is what many people have
        raise WorldError(
            f"none of the {len(paths)} scenes of {file} is there, such as {paths[0]}; --scenes names the folder that "
            f"holds {next(iter(homes)).removeprefix(_PREFIX)}"
        )
    turns = [(index, order, scene) for order, scene in enumerate(homes) for index in range(len(homes[scene]))]
    chosen = sorted(turns)[:count]
    # One scene after the other, and of a scene one storey after the other: opening one takes seconds.
    chosen.sort(key=lambda turn: (turn[1], homes[turn[2]][turn[0]][0], turn[0]))
    return [
        FileEpisodeSpec(task, *homes[scene][index], index, number, scene, index)
        for number, (index, _, scene) in enumerate(chosen)
    ]


def _storeys(scene: str, listed: SceneEpisodes, options: str, file: Path, scenes: Path | None) -> list[str]:
    """The world of each episode of a scene in Habitat: the storey of its start."""
    _, found, rest = listed.episodes[0].dataset_config.rpartition("scene_datasets/")
    config = _below(rest, file, scenes) if found else None
    dataset = f"dataset={config}&" if config is not None and config.is_file() else ""
    heights = np.array([float(episode.position[2]) for episode in listed.episodes])
    lowest: list[float] = []  # near starts share a storey, as to open one takes seconds
    for height in np.sort(heights):
        if not lowest or height - lowest[-1] > STOREY:  # starts on stairs must not join the storeys that these join
            lowest.append(height)
    group = np.searchsorted(lowest, heights, side="right") - 1
    world = f"{HABITAT}:{_below(scene, file, scenes)}?{dataset}{options}"
    return [f"{world}&storey={np.median(heights[group == each]):.2f}" for each in group]


def _home_of_ours(scene: str, listed: SceneEpisodes, seed: int, file: Path, scenes: Path | None) -> tuple[str, int]:
    """World and seed of the apartment, or of the exported file, that a scene's episodes were made for."""
    (version, *others) = {each.origin.version if each.origin is not None else None for each in listed.episodes}
    if version is None or others:
        raise WorldError(
            f"{file}: the episodes in {scene} do not say which of our scenes they were made for, so they can only be "
            f"played in Habitat: --world {HABITAT} --scenes DIR"
        )
    match = re.fullmatch(r"apartment (\S+) seed (\d+)", version)
    if match is None:
        return str(_below(scene, file, scenes)), seed
    from eagor.lab.worlds.apartment import VERSION

    if match[1] != VERSION or int(match[2]) >= SEEDS:
        raise WorldError(
            f"{file}: the episodes in {scene} were made for {version}; this version makes apartments {VERSION} "
            f"with seeds below {SEEDS}. Export them anew"
        )
    return APARTMENT, int(match[2])


def _below(scene: str, file: Path, scenes: Path | None) -> Path:
    """The file of a scene below the folder of scenes."""
    scene = scene.removeprefix(_PREFIX)
    above = [parent / "scene_datasets" for parent in file.absolute().parents]
    scenes = scenes or next((folder for folder in above if folder.is_dir()), None)
    if scenes is None:
        raise WorldError(
            f"no folder scene_datasets is above {file}; say where the scenes are with --scenes DIR, the folder that "
            f"holds {scene}"
        )
    return Path(scenes) / scene


def scene_file(world: str) -> str:
    """The file of a world that is a scene in a file; empty for others."""
    name = world.removeprefix(f"{HABITAT}:").partition("?")[0]
    return name if name != world or Path(name).suffix.lower() in FILES else ""


def read_file(file: Path | str) -> tuple[SceneEpisodes, ...]:
    """The episodes of a file by scene, kept as long as it does not change. Raises `WorldError`."""
    path = Path(file)
    return _read(*_states(path, *sorted((path.parent / "content").glob("*.json.gz"))))


def _states(*paths: Path) -> list[tuple[Path, int, int]]:
    """Files, each with what changes with its content."""
    found = [(path, path.stat() if path.exists() else None) for path in paths]
    return [(path, state.st_mtime_ns if state else 0, state.st_size if state else 0) for path, state in found]


@lru_cache(maxsize=64)
def _digest(file: tuple[Path, int, int]) -> str:
    return hashlib.sha256(file[0].read_bytes()).hexdigest()


@lru_cache(maxsize=2)
def _read(file: tuple[Path, int, int], *content: tuple[Path, int, int]) -> tuple[SceneEpisodes, ...]:
    return read_episodes(file[0])


def plan_listed(spec: FileEpisodeSpec, file: str, camera: Camera, rules: NavigationRules) -> FileEpisode:
    """The episode of this spec: where it starts, what counts as reached, how long the shortest way is.

    Raises `WorldError` if the scene is another one, the start is not on free ground, or no way leads to a goal.
    """
    found = next((each for each in read_file(file) if each.episodes[0].scene == spec.scene), None)
    if found is None or spec.episode >= len(found.episodes):
        raise WorldError(f"{file} has no episode {spec.episode} in {spec.scene}; it has changed: start the run anew")
    episode = found.episodes[spec.episode]
    name, category = f"episode {spec.episode} of {spec.scene}", episode.category
    place = load_place(spec.world, spec.seed, camera.radius)
    if isinstance(place.scene, Scene):
        check_scene(episode, place.scene, place.ground)
    zero = float(getattr(place.scene, "zero", 0.0))  # the height of our z = 0 in the file
    start = _start(place, episode, name, zero)
    things, storey = found.goals[category], float(episode.position[2])
    near = [thing for thing in things if (np.abs(thing.view_positions[:, 2] - storey) <= STOREY).any()]
    views = np.concatenate([thing.view_positions for thing in things]) - [0.0, 0.0, zero]
    goals = np.array([thing.position for thing in near or things]) - [0.0, 0.0, zero]
    targets = tuple(i for i, thing in enumerate(place.scene.instances) if thing.category == category)
    if rules.goal == "view_points":
        if not near:
            raise WorldError(
                f"{name} has no view points on the storey of its start; --set goal=footprint measures to the thing "
                "itself"
            )
        way, ends, to = place.way_to_views(views), views, "a view point of any"
    else:
        if not targets:
            raise WorldError(f"{name}: {place.scene.source} names no {category}; leave goal at view_points")
        way, ends, to = place.way_to(targets), goals, "any"
    shortest = float(way.distance(start))
    if not math.isfinite(shortest):
        raise WorldError(
            f"{name}: no way leads from ({start[0]:.2f}, {start[1]:.2f}) to {to} {category}; leave it out, or use the "
            "body that it was made for"
        )
    straight = float(np.hypot(*(ends[:, :2] - start).T).min())
    shown = pixels_of(place.ids(place.eye(start, camera.height), world_R_body(0.0)), targets)
    way_kind = "winding" if shortest > WINDING * straight else "direct"
    return FileEpisode(
        spec=spec, scene=place.scene.source, scene_hash=place.scene.hash, query=category, targets=targets,
        start=(float(start[0]), float(start[1])), yaw=heading(episode.world_R_body), shortest=shortest,
        stratum={"visible": shown >= VISIBLE, "way": way_kind, "category": category}, goals=goals, view_points=views,
        listed={"episode_id": episode.identifier, "geodesic_distance": episode.geodesic},
    )  # fmt: skip


def _start(place: Place, episode: ObjectNavEpisode, name: str, zero: float) -> np.ndarray:
    """The start ``(2,)`` on free ground, perhaps a cell away; `zero`: the height of our z = 0 in the file."""
    xy, ground = episode.position[:2], place.ground
    found = ground.snap(xy, within=ground.cell)
    if found is None:
        near = ground.snap(xy)
        away = (
            f"the nearest free place is {np.hypot(*(near - xy)):.2f} m off" if near is not None else "nothing is free"
        )
        raise WorldError(
            f"{name} starts at ({xy[0]:.2f}, {xy[1]:.2f}), which is not on free ground for a body of radius "
            f"{ground.radius:g} m in {place.scene.source}: {away}. Use the scene and the radius it was made for"
        )
    height = zero + ground.height(found)
    if abs(height - episode.position[2]) > OFF:
        raise WorldError(
            f"{name} starts at the height {episode.position[2]:.2f} m, but the ground there is at {height:.2f} m in "
            f"{place.scene.source}: it is on another storey. Choose the world that holds its storey: --world habitat "
            "does so by itself, habitat:SCENE?storey=HEIGHT by hand"
        )
    return found
