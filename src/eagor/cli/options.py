"""What can be typed: one frozen dataclass per command, and where the function is that runs it.

Nothing heavy is imported here, so that help and typing errors come at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg, subcommand

Name = Annotated[str, arg(metavar="NAME")]
Whole = Annotated[int, arg(metavar="N")]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: bool = False
    """Print exactly one JSON object on stdout."""
    debug: bool = False
    """Show the traceback of an error."""


@dataclass(frozen=True, kw_only=True)
class Locate(Common):
    """In which direction of one panorama is it?"""

    runs: ClassVar[str] = "eagor.cli.locate:locate"

    panorama: Annotated[Path, Positional, arg(metavar="PANO")]
    """An equirectangular image; its middle is forward."""
    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to look for, in words."""
    perception: Name = "colour"
    """Who looks: colour (the colour that the query names), replay:FILE.jsonl (what a detector wrote), or an
    installed one; `eagor doctor` lists them."""
    modes: Annotated[int, arg(metavar="K")] = 3
    """At most so many candidate directions."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; resolution is about 180 / N degrees."""
    stamp: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Which record of a replay to take (default: the first for this query)."""
    picture: Annotated[Path | None, arg(metavar="FILE.png")] = None
    """Draw the belief over the panorama."""


@dataclass(frozen=True, kw_only=True)
class Track(Common):
    """Follow it through a series of panoramas, with the camera's poses."""

    runs: ClassVar[str] = "eagor.cli.track:track"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="FRAMES QUERY", help_behavior_hint="(required)")]
    """A folder of panoramas (or several image files, taken in the order of their names), then what to look for."""
    poses: Annotated[Path, arg(metavar="CSV")]
    """The camera's poses: a CSV file with the columns stamp,qw,qx,qy,qz (world_R_body) or
    stamp,yaw_deg,pitch_deg,roll_deg (yaw left, pitch nose DOWN); also x,y,z (metres) and frame (file name)."""
    perception: Name = "colour"
    """Who looks: colour, replay:FILE.jsonl, or an installed one."""
    compare: bool = False
    """Run the baselines on the same evidence, side by side."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    picture: Annotated[Path | None, arg(metavar="DIR")] = None
    """Draw each frame with the belief into this folder."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the estimates as they come into FILE.csv or FILE.jsonl."""


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """Follow a red ball through a painted room, every method side by side, and leave a report with pictures."""

    runs: ClassVar[str] = "eagor.cli.demo:demo"

    out: Annotated[Path, arg(metavar="DIR")] = Path("eagor-demo")
    """Where the report and the pictures go."""
    steps: Whole = 72
    """How many panoramas the camera takes, at least 12."""
    seed: Whole = 0
    """Of the walk and of the missed detections."""


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """What is installed here: versions, perceptions, processor."""

    runs: ClassVar[str] = "eagor.cli.doctor:doctor"


Command = (
    Annotated[Locate, subcommand("locate")]
    | Annotated[Track, subcommand("track")]
    | Annotated[Demo, subcommand("demo")]
    | Annotated[Doctor, subcommand("doctor")]
)
