"""What follows ``habitat:``, and the files that it names."""

from __future__ import annotations

import atexit
import json
import math
import shutil
import tempfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from eagor.errors import WorldError

__all__ = ["Options", "existing", "file_of", "is_bare", "parse", "scene_id_of"]

SCENES = (".glb", ".gltf", ".ply", ".stage_config.json", ".scene_instance.json")


@dataclass(frozen=True)
class Options:
    """What follows ``habitat:``, see `eagor.worlds.habitat.world`."""

    scene: str
    dataset: str | None = None
    storey: float | None = None
    up: str | None = None
    navmesh: str | None = None
    boxes: str | None = None
    gpu: int | None = None


def parse(text: str) -> Options:
    """The options in ``SCENE?name=value&name=value``. Raises `WorldError`."""
    scene, _, rest = text.partition("?")
    values: dict[str, Any] = {}
    known = [each.name for each in fields(Options)][1:]
    for part in filter(None, rest.split("&")):
        name, equals, value = part.partition("=")
        if name not in known or not equals or not value:
            raise WorldError(f"habitat:{text} has the option {part!r}; wanted {'=..., '.join(known)}=...")
        try:
            values[name] = {"storey": float, "gpu": int}.get(name, str)(value)
        except ValueError:
            raise WorldError(f"habitat:{text}: {name} = {value!r}; wanted a number") from None
    if not math.isfinite(values.get("storey", 0.0)):
        raise WorldError(f"habitat:{text}: storey = {values['storey']}; wanted finite metres")
    if values.get("up", "y") not in ("y", "z"):
        raise WorldError(f"habitat:{text}: up = {values['up']!r}; wanted y or z")
    return Options(scene, **values)


def file_of(options: Options) -> Path | None:
    """The file of the scene, None for a name in a dataset. Raises `WorldError` if it is missing."""
    if not options.scene:
        raise WorldError("the world 'habitat' wants habitat:SCENE, with a file or a name in a dataset")
    file = Path(options.scene).expanduser()
    if file.is_file():
        return file.resolve()
    if options.dataset is None:
        kind = "a folder" if file.is_dir() else "missing"
        raise WorldError(
            f"the scene {options.scene!r} is {kind}; wanted a file ({', '.join(f'*{end}' for end in SCENES)}), or a "
            "name in a dataset: habitat:NAME?dataset=FILE.scene_dataset_config.json"
        )
    return None


def existing(name: str | None, what: str) -> Path | None:
    """The file `name`, absolute; None if none is named. Raises `WorldError` if it is missing."""
    if name is None:
        return None
    file = Path(name).expanduser()
    if not file.is_file():
        raise WorldError(f"{what} {name!r} is missing; give the path of an existing file")
    return file.resolve()


def scene_id_of(options: Options, file: Path | None) -> str:
    """What Habitat is asked for: the stage configuration beside a GLB file, if there is one, or the file, or a name."""
    if file is None:
        return options.scene
    if file.suffix.lower() not in (".glb", ".gltf"):
        return str(file)
    beside_it = file.with_suffix(".stage_config.json")
    if options.up is None:
        return str(beside_it if beside_it.is_file() and options.dataset is None else file)
    # Habitat takes the axes from a stage configuration alone.
    up, front = ([0, 1, 0], [0, 0, -1]) if options.up == "y" else ([0, 0, 1], [0, 1, 0])
    known: dict[str, Any] = {}
    if beside_it.is_file():
        known = json.loads(beside_it.read_text(encoding="utf-8"))
    folder = Path(tempfile.mkdtemp(prefix="eagor-habitat-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    stage = folder / beside_it.name
    stage.write_text(
        json.dumps(known | {"render_asset": str(file), "collision_asset": str(file), "up": up, "front": front})
    )
    return str(stage)


def is_bare(options: Options) -> bool:
    """Whether nothing but Habitat's default says which way is up."""
    file = Path(options.scene)
    glb = file.suffix.lower() in (".glb", ".gltf")
    return glb and options.dataset is None and not file.with_suffix(".stage_config.json").is_file()
