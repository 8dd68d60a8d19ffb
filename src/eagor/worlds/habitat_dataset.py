"""A folder of scenes and ObjectNav episodes as Habitat reads HM3D, made of scenes of ours.

    DIR/scene_datasets/<name>/<name>.scene_dataset_config.json
    DIR/scene_datasets/<name>/<split>/00007-apartment0007/apartment0007.glb      and beside it
        .stage_config.json   axes (the GLB has Y up), and the two files of the ids
        .semantic.glb, .semantic.txt   ids of the instances, in HM3D's format
        .navmesh             Habitat's navigation mesh, where habitat_sim is installed
        .navmesh.json, .semantic.json  the settings of that mesh; what a GLB cannot hold
    DIR/datasets/objectnav/<name>/v1/<split>/<split>.json.gz, content/apartment0007.json.gz

DIR is what Habitat's examples call ``data``.
"""

from __future__ import annotations

import json
import re
import shutil
import uuid
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eagor._files import written
from eagor.errors import StorageError, WorldError
from eagor.worlds.glb import export_glb
from eagor.worlds.ground import Ground
from eagor.worlds.habitat_files import FIRST_ID, ON_MESH, STAGE, roomy_radius
from eagor.worlds.objectnav import (
    HM3D_CATEGORIES,
    Episode,
    Goal,
    Origin,
    SceneEpisodes,
    goal_of,
    read_category,
    spelt,
    write_episodes,
)
from eagor.worlds.render import Renderer
from eagor.worlds.scene import STRUCTURE, Scene

SPACING = 0.1  # metres between view points: no place among them is farther than 0.1 m, the usual threshold, from one
EYE = 0.88  # metres above the floor: height of the camera of the ObjectNav challenges
ROWS = 64  # of the panoramas that decide whether a thing is in sight
PIXELS = 2  # of them that show a thing in sight
NEAREST, FARTHEST = 1.0, 30.0  # metres from the start to the nearest view point, along the floor
RATIO = 1.05  # least ratio of that way to the straight line


def roomy_ground(scene: Scene, ground: Ground) -> Ground:
    """The part of the ground that is also on habitat-lab's mesh, and connected there, whatever Recast rounds."""
    return Ground.from_scene(scene, cell=ground.cell, radius=roomy_radius(ground.radius), floor=ground.floor)


def make_goals(scene: Scene, ground: Ground, categories: Sequence[str] = ()) -> dict[str, tuple[Goal, ...]]:
    """The things of these categories with their view points, by category. `instance` is the id in Habitat.

    View points lie on the mesh that habitat-lab makes of the exported scene, in one piece of it (`roomy_ground`). By
    default those of HM3D's six categories that the scene has. Things that are in sight from nowhere near are left
    out. Raises `WorldError` if nothing is left of a category that was asked for, or of all.
    """
    present = {thing.category for thing in scene.instances if thing.category not in STRUCTURE}
    asked = [read_category(category) for category in categories]
    wanted = asked or [name for name in map(read_category, HM3D_CATEGORIES) if name in present]
    lacking = [name for name in wanted if name not in present]
    if lacking or not wanted:
        what = ", ".join(lacking) if lacking else f"none of {', '.join(HM3D_CATEGORIES)}"
        raise WorldError(f"{scene.source} has {'no ' * bool(lacking)}{what}; it has {', '.join(sorted(present))}")
    renderer = Renderer(scene)
    roomy = roomy_ground(scene, ground)
    seen: dict[tuple[float, float], np.ndarray] = {}
    goals = {}
    for category in dict.fromkeys(wanted):
        found = []
        for index, thing in enumerate(scene.instances):
            if thing.category == category:
                goal = _in_sight(goal_of(scene, roomy, index, SPACING), index, renderer, seen)
                found += [goal] if len(goal.view_positions) else []
        if found:
            goals[category] = tuple(found)
        elif asked:
            raise WorldError(f"no {category} of {scene.source} is in sight from a free place beside it; ask for others")
    if not goals:
        raise WorldError(f"none of the {', '.join(wanted)} of {scene.source} is in sight from a free place beside it")
    return goals


def _in_sight(goal: Goal, index: int, renderer: Renderer, seen: dict[tuple[float, float], np.ndarray]) -> Goal:
    """The goal with its id in Habitat, and those view points from which it is seen; `seen`: the ids by place.

    Its places are on the floor, those of the result on habitat-lab's mesh.
    """
    shown = np.zeros(len(goal.view_positions), dtype=bool)
    for row, (x, y, z) in enumerate(goal.view_positions.tolist()):
        if (x, y) not in seen:
            ids = renderer.panorama((x, y, z + EYE), np.eye(3), ROWS, rgb=False, range=False).ids
            assert ids is not None
            seen[x, y] = np.bincount(ids.ravel() + 1, minlength=len(renderer.scene.instances) + 1)[1:]
        shown[row] = seen[x, y][index] >= PIXELS
    return Goal(
        goal.category, index + FIRST_ID, goal.position, f"{spelt(goal.category)}_{index + FIRST_ID}", goal.room,
        goal.view_positions[shown] + [0.0, 0.0, ON_MESH], goal.view_rotations[shown], goal.view_overlap[shown],
    )  # fmt: skip


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
        yaw, (x, y) = float(rng.uniform(-np.pi, np.pi)), points[index]
        cos, sin = np.cos(yaw), np.sin(yaw)
        closest = int(np.argmin([way.distance(points[index]) for way in ways[category]]))
        room = scene.room_at(float(x), float(y))
        episodes.append(
            Episode(
                scene=file,
                category=category,
                position=np.array([x, y, ground.floor + ON_MESH]),
                world_R_body=np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]),
                identifier=str(number),
                geodesic=float(nearest[index]),
                euclidean=float(straight[index]),
                nearest=goals[category][closest].instance,
                room=room.name if room else None,
                origin=Origin(scene.hash, scene.source, ground.radius, ground.cell),
                dataset_config=dataset_config,
            )
        )
    return tuple(episodes)


# --- the folder -------------------------------------------------------------------------------------------------------

_TAG = "%%CONFIG_NAME_AS_ASSET_FILENAME%%"  # Habitat puts the name of the scene there


@dataclass(frozen=True)
class Source:
    """A scene to export: its `number` and `name`, of which its folder is named, and how it is made."""

    number: int
    name: str
    make: Callable[[], Scene]


@dataclass(frozen=True)
class Exported:
    """What was written of a scene: its GLB, and the numbers of instances, goals, their view points, and episodes."""

    scene: Path
    source: str
    instances: int
    goals: int
    view_points: int
    episodes: int


def export_dataset(
    sources: Sequence[Source], folder: Path | str, *,
    name: str = "eagor", split: str = "val", episodes: int = 10, categories: Sequence[str] = (), radius: float = 0.18,
    mesh: Callable[[Path], None] | None = None, on_done: Callable[[Exported], object] | None = None,
) -> tuple[Path, list[Exported]]:  # fmt: skip
    """Write the folder; returns the episodes' ``<split>.json.gz``, and what was written of each scene.

    `episodes` of each scene, of these `categories` (`make_goals`), for a body of this `radius` (metres). `mesh` writes
    the navigation mesh beside the stage configuration that it is given (`mesh_writer`). The same call gives the same
    bytes. The folder appears when all of it is written: nothing is left of an export that fails.

    Raises `WorldError` if the folder holds something, for two scenes of one name, and as `make_goals` and
    `make_episodes`; `StorageError` if it cannot be written.
    """
    folder = Path(folder)
    for what, word in (("name", name), ("split", split)):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", word):
            raise WorldError(f"{what} = {word!r}; wanted letters, digits, - and _: folders get that name")
    if episodes < 1:
        raise WorldError(f"{episodes} episodes of each scene; wanted 1 or more")
    if not sources:
        raise WorldError("there is no scene to export; name at least one")
    check_names(sources)
    with all_or_nothing(folder) as part:
        scenes, done = [], []
        home = part / "scene_datasets" / name
        for source in sources:
            scene = source.make()
            place = f"{split}/{source.number:05d}-{source.name}"
            ground = Ground.from_scene(scene, radius=radius)
            goals = make_goals(scene, ground, categories)
            file = f"{name}/{place}/{source.name}.glb"
            config = f"./data/scene_datasets/{name}/{name}.scene_dataset_config.json"
            made = make_episodes(scene, ground, goals, episodes, file, config)
            glb = export_glb(scene, home / place / f"{source.name}.glb", radius=radius, annotated=True)
            if mesh is not None:
                mesh(glb.with_suffix(".stage_config.json"))
            scenes.append(SceneEpisodes(made, goals))
            things = [goal for each in goals.values() for goal in each]
            views = sum(len(goal.view_positions) for goal in things)
            found = Exported(
                folder / glb.relative_to(part), scene.source, len(scene.instances), len(things), views, len(made)
            )
            done.append(found)
            if on_done is not None:
                on_done(found)
        files = [each.scene.relative_to(folder / "scene_datasets" / name).as_posix() for each in done]
        written(home / f"{name}.scene_dataset_config.json", json.dumps(config_of(files), indent=1) + "\n")
        path = write_episodes(part / "datasets" / "objectnav" / name / "v1", split, scenes)
    return folder / path.relative_to(part), done


def check_names(sources: Sequence[Source]) -> None:
    """Raise `WorldError` if two scenes have one name."""
    names = [source.name for source in sources]
    if twice := sorted({each for each in names if names.count(each) > 1}):
        raise WorldError(f"two scenes have the name {twice[0]!r}; one would replace the other: rename one")


def config_of(files: Iterable[str]) -> dict:
    """The scene dataset configuration: every scene of it has its files beside it, under its own name."""
    attributes = STAGE | {
        "semantic_asset": f"{_TAG}.semantic.glb", "semantic_descriptor_filename": f"{_TAG}.semantic.txt",
        "has_semantic_textures": True, "nav_asset": f"{_TAG}.navmesh",
    }  # fmt: skip
    return {"stages": {"default_attributes": attributes, "paths": {".glb": list(files)}}}


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
        try:
            part.mkdir(parents=True)
        except OSError as error:
            raise StorageError(f"{part} cannot be made ({error.strerror or error}); name another place") from error
        yield part
        try:
            if folder.exists():
                folder.rmdir()
            part.rename(folder)
        except OSError as error:
            raise StorageError(f"{folder} cannot be put in place ({error.strerror or error}); name another") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
