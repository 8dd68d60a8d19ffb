"""``eagor export``: scenes and episodes for other simulators."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg, subcommand

from eagor.cli import terminal
from eagor.cli.options import Common, Whole, bare

if TYPE_CHECKING:
    from eagor.worlds.habitat_dataset import Exported, Source

Scenes = Annotated[tuple[str, ...], Positional, arg(metavar="APARTMENTS", help_behavior_hint="(required)")]


@dataclass(frozen=True, kw_only=True)
class ExportHabitat(Common):
    """Write apartments as a dataset folder for Habitat, laid out as HM3D, with ObjectNav episodes."""

    runs: ClassVar[str] = "habitat"

    scenes: Scenes
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


@dataclass(frozen=True, kw_only=True)
class ExportGlb(Common):
    """Write apartments as GLB files (binary glTF, Y up) with a JSON file of their objects, for viewers."""

    runs: ClassVar[str] = "glb"

    scenes: Scenes
    """Seeds of apartments, such as 0-4,7, or GLB files, which are written in the same form."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The folder to write: a new one, or an empty one."""


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write scenes and episodes for other simulators."""

    action: Annotated[
        Annotated[ExportHabitat, subcommand("habitat")] | Annotated[ExportGlb, subcommand("glb")],
        arg(name=""),  # as in `Bench`
    ]


_SEEDS = re.compile(r"(\d+)(?:-(\d+))?")


def habitat(options: ExportHabitat) -> int:
    """``eagor export habitat``."""
    from eagor.worlds.habitat_dataset import export_dataset
    from eagor.worlds.habitat_files import WITHOUT, mesh_writer

    sources, mesh = sources_of(options.scenes), mesh_writer()
    with terminal.progress("export", len(sources)) as advance:

        def done(found: Exported) -> None:
            advance()
            terminal.log(
                f"{found.scene.stem}: {found.instances} instances, {found.goals} goals with {found.view_points} view "
                f"points, {found.episodes} episodes"
            )

        path, found = export_dataset(
            sources, options.out, name=options.name, split=options.split, episodes=options.episodes,
            categories=options.categories, radius=options.radius, mesh=mesh, on_done=done,
        )  # fmt: skip
    total = sum(each.episodes for each in found)
    config = options.out / "scene_datasets" / options.name / f"{options.name}.scene_dataset_config.json"
    if mesh is None:
        terminal.log(WITHOUT)
    if options.json:
        scenes = [vars(each) | {"scene": str(each.scene)} for each in found]
        meshes = mesh is not None
        terminal.emit({"episodes_file": str(path), "config": str(config), "meshes": meshes, "scenes": scenes})
        return terminal.OK
    print(f"{terminal.many(len(found), 'scene')}, {terminal.many(total, 'episode')} in {options.out}")
    terminal.facts({"episodes": str(path), "scenes": str(config)}, indent=2)
    return terminal.OK


def glb(options: ExportGlb) -> int:
    """``eagor export glb``."""
    from eagor.worlds.glb import export_glb
    from eagor.worlds.habitat_dataset import all_or_nothing, check_names

    sources: list[Source] = sources_of(options.scenes)
    check_names(sources)
    written: list[dict[str, Any]] = []
    with terminal.progress("export", len(sources)) as advance, all_or_nothing(options.out) as part:
        for source in sources:
            scene = source.make()
            path = options.out / export_glb(scene, part / f"{source.name}.glb").relative_to(part)
            written.append({"scene": str(path), "source": scene.source, "instances": len(scene.instances)})
            advance()
    if options.json:
        terminal.emit({"scenes": written})
    else:
        for each in written:
            print(f"{each['scene']}: {each['instances']} instances")
    return terminal.OK


def sources_of(words: tuple[str, ...]) -> list[Source]:
    """The scenes that the words name: seeds (``0-4,7``) and GLB files. Raises `UsageError` for any other word."""
    from eagor.tasks.places import SEEDS
    from eagor.worlds.apartment import generate
    from eagor.worlds.glb import import_glb
    from eagor.worlds.habitat_dataset import Source

    found: dict[str, Source] = {}
    files = 0
    for word in words:
        if Path(word).suffix.lower() in (".glb", ".gltf"):
            name = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(word).name.partition(".")[0]) or "scene"
            if not Path(word).is_file():
                raise terminal.UsageError(f"there is no file {word}")
            if word not in found:
                found[word] = Source(SEEDS + files, name, lambda word=word: import_glb(Path(word)))
                files += 1
            continue
        for part in filter(None, word.split(",")):
            match = _SEEDS.fullmatch(part)
            if match is None:
                raise terminal.UsageError(f"{part!r} names no apartment; wanted seeds, such as 0-4,7, or GLB files")
            first, last = int(match[1]), int(match[2] or match[1])
            if not 0 <= first <= last < SEEDS:
                raise terminal.UsageError(
                    f"there are no apartments {part}; wanted seeds from 0 to {SEEDS - 1}, the lower one first"
                )
            for seed in range(first, last + 1):
                found.setdefault(str(seed), Source(seed, f"apartment{seed:04d}", lambda seed=seed: generate(seed)))
    if not found:
        raise terminal.UsageError("no apartment is named; wanted seeds, such as 0-4,7, or GLB files")
    return list(found.values())
