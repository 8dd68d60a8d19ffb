"""The options of ``eagor export``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg, subcommand

from eagor.cli.shared_options import Common, Whole, bare

Scenes = Annotated[tuple[str, ...], Positional, arg(metavar="APARTMENTS", help_behavior_hint="(required)")]


@dataclass(frozen=True, kw_only=True)
class ExportHabitat(Common):
    """Write apartments as a dataset folder for Habitat, laid out as HM3D, with ObjectNav episodes."""

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

    scenes: Scenes
    """Seeds of apartments, such as 0-4,7, or GLB files, which are written in the same form."""
    out: Annotated[Path, arg(metavar="DIR")]
    """The folder to write: a new one, or an empty one."""


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write scenes and episodes for other simulators."""

    runs: ClassVar[str] = "eagor.cli.export:export"

    action: Annotated[
        Annotated[ExportHabitat, subcommand("habitat")] | Annotated[ExportGlb, subcommand("glb")],
        arg(name=""),  # as in `Bench`
    ]
