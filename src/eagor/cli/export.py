"""``eagor export``: scenes and episodes for other simulators."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.options import Common, Whole, bare

if TYPE_CHECKING:
    from collections.abc import Callable

    from eagor.lab.worlds.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Export(Common):
    """Write apartments as a dataset folder for Habitat, laid out as HM3D, with ObjectNav episodes."""

    to: Annotated[Literal["habitat"], Positional, arg(metavar="habitat")]
    """The simulator."""
    scenes: Annotated[tuple[str, ...], Positional, arg(metavar="APARTMENTS", help_behavior_hint="(required)")]
    """Seeds of apartments, such as 0-4,7, or GLB files."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The folder to write: a new one, or an empty one. Habitat's examples call it data."""
    episodes: Whole = 10
    """Number of episodes in each scene."""
    categories: Annotated[tuple[str, ...], bare("NAME ...")] = ()
    """What the episodes look for (default: chair, bed, plant, toilet, tv and sofa, as in HM3D, where there is one)."""
    name: Annotated[str, arg(metavar="NAME")] = "eagor"
    """Name of the dataset. With hm3d the folders have the names of HM3D's."""
    split: Annotated[str, arg(metavar="NAME")] = "val"
    """Name of the split."""
    radius: Annotated[float, arg(metavar="METRES")] = 0.18
    """Radius of the body for which starts, view points and distances are made."""


def export(options: Export) -> int:
    """``eagor export habitat``."""
    from eagor.lab.worlds.objectnav import export_dataset, has_meshes

    scenes = scenes_of(options.scenes)
    with terminal.progress("export", len(scenes)) as advance:

        def done(found: dict[str, Any]) -> None:
            advance()
            terminal.log(
                f"{Path(found['scene']).stem}: {found['instances']} instances, {found['goals']} goals with "
                f"{found['view_points']} view points, {found['episodes']} episodes"
            )

        path, found = export_dataset(
            scenes, options.out, name=options.name, split=options.split, episodes=options.episodes,
            categories=options.categories, radius=options.radius, on_done=done,
        )  # fmt: skip
    config = options.out / "scene_datasets" / options.name / f"{options.name}.scene_dataset_config.json"
    if not has_meshes():
        terminal.log(
            "habitat_sim is not installed here, so there are no .navmesh files: habitat-lab and eagor make them when "
            "they open a scene; in Habitat-Sim, call recompute_navmesh with the settings in <scene>.navmesh.json"
        )
    total = sum(each["episodes"] for each in found)
    return terminal.give(
        options.json,
        {"episodes_file": str(path), "config": str(config), "meshes": has_meshes(), "scenes": found},
        f"{terminal.many(len(found), 'scene')}, {terminal.many(total, 'episode')} in {options.out}",
        f"  episodes  {path}",
        f"  scenes    {config}",
    )


def scenes_of(words: tuple[str, ...]) -> dict[str, Callable[[], Scene]]:
    """How the scenes that the words name are made, by their folders: seeds (``0-4,7``) and GLB files.

    Raises `UsageError` for any other word.
    """
    from eagor.lab.envs.places import SEEDS
    from eagor.lab.worlds.apartment import generate
    from eagor.lab.worlds.glb import import_glb

    found: dict[str, Callable[[], Scene]] = {}
    files = [word for word in dict.fromkeys(words) if Path(word).suffix.lower() in (".glb", ".gltf")]
    for number, word in enumerate(files, SEEDS):
        if not Path(word).is_file():
            raise terminal.UsageError(f"there is no file {word}")
        name = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(word).name.partition(".")[0]) or "scene"
        found[f"{number:05d}-{name}"] = partial(import_glb, Path(word))
    for part in (part for word in words if word not in files for part in word.split(",") if part):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", part)
        if match is None:
            raise terminal.UsageError(f"{part!r} names no apartment; wanted seeds, such as 0-4,7, or GLB files")
        first, last = int(match[1]), int(match[2] or match[1])
        if not 0 <= first <= last < SEEDS:
            raise terminal.UsageError(
                f"there are no apartments {part}; wanted seeds from 0 to {SEEDS - 1}, the lower one first"
            )
        found |= {f"{seed:05d}-apartment{seed:04d}": partial(generate, seed) for seed in range(first, last + 1)}
    if not found:
        raise terminal.UsageError("no apartment is named; wanted seeds, such as 0-4,7, or GLB files")
    return found
