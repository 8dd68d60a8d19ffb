"""What the options of several commands share: names of values, and the options of every command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from tyro.conf import arg, subcommand

from eagor.cli.terminal import UsageError


def bare(metavar: str | None = None, help: str | None = None) -> Any:
    """An option without a default value; its text says what happens then, and "(default: None)" is not shown."""
    return arg(metavar=metavar, help=help, help_behavior_hint="")


Name = Annotated[str, arg(metavar="NAME")]
Whole = Annotated[int, arg(metavar="N")]
Flag = Annotated[bool, bare()]
Rows = Annotated[
    int | None,
    bare("N", "Rows of rendered panoramas (default: those of the perception, else 256; truth reads ids instead)."),
]

Detector = Annotated[
    str | None,
    bare(
        "spread=DEG,...",
        "Error model of the detector (how-to/detector-errors): habit=A+B or detection_probability=P, "
        "false_alarms_per_look=N, look_alikes=N, look_alike_habit=A+B, kept_for=SECONDS, kept_within=METRES, "
        "hidden=SHARE, spread=DEG (differs in each look), offset=DEG (stays at a place), spread_of_size=S, "
        "offset_of_size=S, parts=P, prior_correct=P.",
    ),
]
Axes = Annotated[
    Literal["auto", "body", "optical", "opengl", "euroc"],
    arg(
        help="The camera's axes in a file of --poses, or of its frame in a bag. auto: as its form or name tells, or as "
        "the pictures turn; body: x ahead, y left, z up; optical: x right, y down, z ahead (SLAM, COLMAP); opengl: x "
        "right, y up, z back (nerfstudio); euroc: x up, y right, z ahead."
    ),
]
Static = Annotated[
    bool,
    bare(help="What is looked for never moves, comes or goes: what is out of view stays where it was seen."),
]
Eyes = Annotated[
    Literal["mono", "left-right", "right-left", "top-bottom", "bottom-top", "vr180", "vr180-top-bottom"] | None,
    bare("LAYOUT"),
]
Force = Annotated[
    bool,
    bare(
        help="Accept pictures that are not 2:1 (all columns for 360 degrees, all rows for 180), and a calibration that "
        "was fitted for another perception."
    ),
]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: Flag = False
    """Print exactly one JSON object on stdout."""
    debug: Flag = False
    """Show the traceback of an error."""


@dataclass(frozen=True, kw_only=True)
class Lens(Common):
    """Options of the commands that open a camera or pictures: what took them."""

    hfov: Annotated[float | None, bare("DEGREES")] = None
    """An ordinary camera: its field of view across the picture's width (default: as its file says)."""
    camera: Annotated[Path | None, bare("FILE")] = None
    """An ordinary camera: its calibration by ROS, OpenCV, Kalibr or COLMAP, or a rig with one lens."""
    eyes: Eyes = None
    """Two eyes: left-right, top-bottom (left eye first), right-left, bottom-top, vr180, vr180-top-bottom; mono: one."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """Lenses, for pictures that are not stitched: their circles (eagor camera calibrate), or ordinary cameras."""


@dataclass(frozen=True, kw_only=True)
class Looking(Lens):
    """Options of the commands that look for something: who looks, and how the looks are added up."""

    perception: Annotated[str | None, bare("NAME")] = None
    (
        "The detector (default: coco, or colour for a bare colour such as 'red'): colour (colour:rows=512 for things "
        "of 1 degree), coco, replay:FILE.jsonl, onnx:MODEL.onnx, my.py:FUNCTION, a model (FOLDER, a hub name, "
        "endpoint:MODEL@http://HOST:PORT/v1; options after ?), or an installed one: `eagor doctor` lists them."
    )
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63; the resolution is about 180 / N degrees."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    mask: Annotated[Path | None, bare("FILE.png")] = None
    """What the camera never sees (tripod, robot's back): black there, white elsewhere, 2:1."""
    force: Force = False


@dataclass(frozen=True, kw_only=True)
class Answering(Looking):
    """Options of the commands that answer in a table or a file."""

    modes: Annotated[int, arg(metavar="K")] = 10
    """Maximum number of candidate directions in the output."""
    floor: Annotated[float | None, bare("Z")] = None
    """Height of the floor in the world of the poses, metres: tells distances sooner. The camera of locate is at 0."""


@dataclass(frozen=True, kw_only=True)
class TrackingOptions(Answering):
    """Options of the commands that follow something over time."""

    static: Static = False
    drift: Annotated[float | None, bare("DEG_PER_S")] = None
    """Heading drift of the poses in the first second, degrees (default: learnt); it grows with the root of time."""
    rerun: Annotated[Path | None, bare("FILE.rrd")] = None
    """Log panorama, belief, directions, pose and status for the Rerun viewer (extra rerun)."""


@dataclass(frozen=True, kw_only=True)
class Footage(Lens):
    """Options of the commands that go through footage: how the camera moved, and what of it is looked at."""

    poses: Annotated[str, arg(metavar="CSV|auto|level|still")] = "auto"
    (
        "How the camera turned and moved. auto: by a bag's odometry, a video's IMU, else the pictures (rotation only); "
        "level: the same, only the heading turns; still: it stands. CSV: a file with stamp,qw,qx,qy,qz (world_R_body) "
        "or stamp,yaw_deg,pitch_deg,roll_deg (yaw left, nose DOWN), also x,y,z and frame (file name); or a trajectory "
        "of TUM, EuRoC, COLMAP (images.txt) or nerfstudio (transforms.json)."
    )
    axes: Axes = "auto"
    rate: Annotated[float | None, bare("HZ")] = None
    """Looks per second of a video or bag (default: 2); of images without times, how many were taken (default: 1)."""
    start: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Where to begin in a video or bag."""
    end: Annotated[float | None, bare("SECONDS")] = None
    """Where to stop in a video or bag (default: at its end)."""
    image_topic: Annotated[str | None, bare("TOPIC")] = None
    """The pictures of a bag (default: the only topic of Images or CompressedImages)."""
    camera_info: Annotated[str | None, bare("TOPIC")] = None
    """An ordinary camera in a bag: its CameraInfo (default: beside its pictures); of several with commas."""
    odom_topic: Annotated[str | None, bare("TOPIC")] = None
    """The odometry of a bag: Odometry, PoseStamped, Imu, or /tf (default: the only one of the first of these kinds)."""
    force: Force = False


def grouped(name: str, text: str, *commands: type) -> Any:
    """A command that is one of several: `commands`, whose names begin with its own."""
    options = tuple(Annotated[each, subcommand(each.__name__.removeprefix(name).lower())] for each in commands)
    # Without a name, options are listed with those of every command, and a text appears once in the help.
    kind = Annotated[Union[options], arg(name="")]  # noqa: UP007
    made = make_dataclass(name, [("action", kind)], frozen=True, kw_only=True)
    made.__doc__ = text
    return made


def given(options: Common, names: Iterable[str]) -> list[str]:
    """Those of `names`, of options that the command has, that differ from their default."""
    defaults = {field.name: field.default for field in fields(options)}
    return [name for name in names if name in defaults and getattr(options, name) != defaults[name]]


def refuse(options: Common, names: Iterable[str], why: str) -> None:
    """Raise `UsageError` if one of these options is given: its name, and `why` not."""
    if wrong := given(options, names):
        raise UsageError(f"--{wrong[0].replace('_', '-')} {why}")
