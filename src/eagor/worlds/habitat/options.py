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
from eagor.worlds.habitat_files import LAB_CLIMB, LAB_VOXEL

__all__ = ["Options", "existing", "file_of", "is_bare", "parse", "scene_id_of"]

NUMBERS = {"storey": float, "gpu": int, "body": float, "climb": float, "voxel": float}
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
    body: float | None = None
    climb: float = LAB_CLIMB
    voxel: float = LAB_VOXEL


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
            values[name] = NUMBERS.get(name, str)(value)
        except ValueError:
            raise WorldError(f"habitat:{text}: {name} = {value!r}; wanted a number") from None
    if not math.isfinite(values.get("storey", 0.0)):
        raise WorldError(f"habitat:{text}: storey = {values['storey']}; wanted finite metres")
    for name in ("body", "climb", "voxel"):
        if not 0 < values.get(name, 1.0) < math.inf:
            raise WorldError(f"habitat:{text}: {name} = {values[name]}; wanted finite metres above 0")
    if "body" not in values and not values.keys().isdisjoint({"climb", "voxel"}):
        raise WorldError(
            f"habitat:{text} has no body; climb and voxel belong to body=HEIGHT, habitat-lab's mesh for it"
        )
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
    """What Habitat is asked for: a name, the file, or a stage configuration for it.

    Habitat takes axes and ids of a bare GLB file from a stage configuration alone. One beside the file is used as it
    is. One is written, for this process, if the axes are given, or for HM3D's files without their dataset:
    ``NAME.basis.glb`` with ``NAME.semantic.glb`` and ``NAME.semantic.txt`` beside.
    """
    if file is None:
        return options.scene
    if file.suffix.lower() not in (".glb", ".gltf") or (options.dataset is not None and options.up is None):
        return str(file)
    stage = stage_beside(file)
    if options.up is None and stage.is_file():
        return str(stage)
    stem = file.name.split(".")[0]
    painted, named = (file.with_name(f"{stem}.semantic.{kind}") for kind in ("glb", "txt"))
    annotated = painted.is_file() and named.is_file()
    if options.up is None and not annotated:
        return str(file)
    known: dict[str, Any] = {"shader_type": "flat"}
    if stage.is_file():
        known = json.loads(stage.read_text(encoding="utf-8"))
    up, front = ([0, 1, 0], [0, 0, -1]) if options.up == "y" else ([0, 0, 1], [0, 1, 0])
    known |= {"render_asset": str(file), "collision_asset": str(file), "up": up, "front": front}
    if annotated:
        known |= {"semantic_asset": str(painted), "semantic_descriptor_filename": str(named)}
        known |= {"has_semantic_textures": True, "semantic_up": up, "semantic_front": front}
    folder = Path(tempfile.mkdtemp(prefix="eagor-habitat-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    made = folder / stage.name
    made.write_text(json.dumps(known), encoding="utf-8")
    return str(made)


def stage_beside(file: Path) -> Path:
    """Where the stage configuration of a GLB file would lie."""
    return file.with_suffix(".stage_config.json")


def is_bare(options: Options) -> bool:
    """Whether nothing but Habitat's default says which way is up."""
    file = Path(options.scene).expanduser()
    glb = file.suffix.lower() in (".glb", ".gltf")
    return glb and options.up is None and options.dataset is None and not stage_beside(file).is_file()
