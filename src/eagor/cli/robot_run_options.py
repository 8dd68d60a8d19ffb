"""The options of ``eagor robot run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from eagor.cli.shared_options import Common, Detector, Flag, Force, Mask, Name, Whole, bare


@dataclass(frozen=True, kw_only=True)
class RobotRun(Common):
    """Walk a Unitree Go2 to an object. Without --arm nothing is commanded: a dry run says what it would do.

    Read docs/how-to/robot-safety.md before the first --arm. --sim does all of it with a simulated robot.
    """

    query: Annotated[str, Positional, arg(metavar="QUERY")]
    """What to walk to, in words."""
    sim: Flag = False
    """A simulated Go2 in a built-in apartment, on this machine alone (interface lo, a free DDS domain)."""
    arm: Flag = False
    """Let the robot move. Somebody has to hold the dead-man switch."""
    deadman: Annotated[Literal["key", "remote", "none"] | None, bare("SWITCH")] = None
    (
        "What is held while it may move: key (the space bar of this terminal; x stops for good, r releases that), "
        "remote (L1 of the robot's remote control; B stops for good, start releases that), none (only with --sim). "
        "Default: key; with --sim none."
    )
    source: Annotated[str | None, bare("SOURCE")] = None
    """The camera, as for `eagor live`: /dev/video0, rtsp://HOST/PATH, ros:/image_topic, ...; with --sim its own."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface to the robot, such as eth0 (this machine has 192.168.123.x on it)."""
    domain: Whole = 0
    """DDS domain of the robot."""
    distance: Annotated[float, arg(metavar="METRES")] = 1.0
    """Stop at this distance over the ground, from the camera."""
    speed: Annotated[float, arg(metavar="M/S")] = 0.4
    """Fastest walk that is wanted; the gate never lets more than 0.5 through."""
    avoid: Flag = False
    """Let the robot walk around obstacles by itself (its own obstacle avoidance)."""
    blind: Annotated[float, arg(metavar="METRES")] = 3.0
    """How far to walk while the distance is not known."""
    calm: Annotated[tuple[int, ...], bare("CODE ...")] = ()
    """Error codes of the robot that are no error: some firmware tells its mode there."""
    belief_age: Annotated[float, arg(metavar="SECONDS")] = 3.0
    (
        "Age of the newest look beyond which it stands, at most: three usual intervals between looks are less for a "
        "quick detector. A detector needs less than half of that per look."
    )
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop after this time (default: 120 with --sim, else at Ctrl-C)."""
    stay: Flag = False
    """Go on when it has arrived: follow the thing if it moves (default: end 2 s after it has arrived)."""
    report: Annotated[Path | None, bare("DIR")] = None
    """Folder for report.html and run.json (default: eagor-walk with --sim, else none)."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, onnx:MODEL.onnx, a model, or an installed one (as for locate)."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 10.0
    """Time that one look may take; then the detector is ended and started anew."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.15
    """Time from capture to arrival of the camera's pictures."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are those of fisheye or ordinary lenses."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the panoramas at most."""
    mount: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.4)
    """Where the camera is on the body: metres forward, left and up from the body's centre."""
    odometry: Annotated[Literal["sport", "slow", "lidar"], arg(metavar="NAME")] = "sport"
    """Odometry of the robot: sport (its state, 200 Hz), slow (the same at 20 Hz), lidar."""
    seed: Whole = 602
    """--sim: the apartment, 0 to 1999, and what chance decides."""
    start: Annotated[tuple[float, float, float] | None, bare("X Y DEG")] = None
    """--sim: where it starts, metres, and its heading (default: somewhere with a free way to the object)."""
    world: Name = "apartment"
    """--sim: apartment, an installed world, or a GLB file."""
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    mask: Mask = None
    force: Force = False
