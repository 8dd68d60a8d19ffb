"""The options of ``eagor camera``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg, subcommand

from eagor.cli.shared_options import Common, Flag, bare


@dataclass(frozen=True, kw_only=True)
class CameraCalibrate(Common):
    """Fit the lenses of a dual fisheye camera from its pictures, for --rig.

    The lenses are tied together where both see the same. Pictures of a camera that turned in place (--turned) also fix
    the inside of each lens: put it on a tripod, and take 8 or more pictures, 45 degrees apart.
    """

    pictures: Annotated[tuple[str, ...], Positional, arg(metavar="PICTURE ...", help_behavior_hint="(required)")]
    (
        "Two or more pictures with both circles, side by side; for a camera that writes one picture per lens, "
        "FRONT.jpg,BACK.jpg with a comma between. Or one video; --every takes pictures of it."
    )
    out: Annotated[Path, arg(metavar="FILE.yaml")] = Path("rig.yaml")
    """File for the lenses; other commands take it as --rig."""
    turned: Flag = False
    """The camera turned in place between the pictures (on a tripod; things two metres away or farther)."""
    field: Annotated[float | None, bare("DEG")] = None
    """The angle across a lens' circle (default: what fits best of 180 to 220)."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """Lenses to begin with, for other layouts than two circles side by side."""
    every: Annotated[float, arg(metavar="SECONDS")] = 2.0
    """Of a video, a picture each so many seconds."""


@dataclass(frozen=True, kw_only=True)
class CameraView(Common):
    """Show a stitched picture, and how far the lenses disagree where both see the same."""

    picture: Annotated[str, Positional, arg(metavar="PICTURE")]
    """A picture of the lenses, FRONT.jpg,BACK.jpg, or a video."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses (default: two ideal ones of 200 degrees, side by side)."""
    out: Annotated[Path | None, bare("FILE.png")] = None
    """Draw the panorama with the rims of the lenses, above a map of their difference."""
    stitched: Annotated[Path | None, bare("FILE.png")] = None
    """Write the panorama alone."""
    stamp: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Of a video, which picture."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the panorama (default: as fine as the pictures)."""


@dataclass(frozen=True, kw_only=True)
class CameraLatency(Common):
    """Estimate how late a camera's stamps are, from the turns that its pictures and odometry show.

    Turn the robot or camera left and right, briskly, for half a minute.
    """

    source: Annotated[str, Positional, arg(metavar="SOURCE")]
    """A live camera (as for `eagor live`), a video or a folder."""
    poses: Annotated[Path, arg(metavar="CSV")]
    """Odometry of the same time, on the clock of the pictures (as for `eagor track`); of a live camera it is read at
    the end."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are not panoramas."""
    rate: Annotated[float, arg(metavar="HZ")] = 10.0
    """Pictures per second to look at; of a folder, how many per second were taken."""
    seconds: Annotated[float, arg(metavar="SECONDS")] = 30.0
    """How long to look at a live camera."""
    most: Annotated[float, arg(metavar="SECONDS")] = 1.0
    """The largest latency to consider."""
    level: Flag = False
    """The camera keeps its pictures level; only the heading turns."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Lenses and latency of a camera."""

    runs: ClassVar[str] = "eagor.cli.camera:camera"

    action: Annotated[
        Annotated[CameraCalibrate, subcommand("calibrate")]
        | Annotated[CameraView, subcommand("view")]
        | Annotated[CameraLatency, subcommand("latency")],
        arg(name=""),
    ]
