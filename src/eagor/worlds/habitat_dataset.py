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
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from eagor._files import written
from eagor.errors import StorageError, WorldError
from eagor.worlds.glb import export_glb
from eagor.worlds.ground import Ground
from eagor.worlds.objectnav import SceneEpisodes, write_episodes
from eagor.worlds.objectnav_making import make_episodes, make_goals
from eagor.worlds.scene import Scene

__all__ = ["Exported", "Source", "all_or_nothing", "check_names", "config_of", "export_dataset"]

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


Mesh = Callable[[Path], None]
"""Writes the navigation mesh beside the stage configuration that it is given."""


def export_dataset(
    sources: Sequence[Source],
    folder: Path | str,
    *,
    name: str = "eagor",
    split: str = "val",
    episodes: int = 10,
    categories: Sequence[str] = (),
    radius: float = 0.18,
    mesh: Mesh | None = None,
    on_done: Callable[[Exported], object] | None = None,
) -> tuple[Path, list[Exported]]:
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
    return {
        "stages": {
            "default_attributes": {
                "up": [0, 1, 0],
                "front": [0, 0, -1],
                "units_to_meters": 1.0,
                "is_collidable": True,
                "shader_type": "flat",
                "semantic_asset": f"{_TAG}.semantic.glb",
                "semantic_descriptor_filename": f"{_TAG}.semantic.txt",
                "has_semantic_textures": True,
                "nav_asset": f"{_TAG}.navmesh",
            },
            "paths": {".glb": list(files)},
        },
    }


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
