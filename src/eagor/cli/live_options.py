"""The options of ``eagor live``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from eagor.cli.shared_options import Common, Detector, Flag, Floor, Force, Mask, Modes, Rerun, Whole, bare


@dataclass(frozen=True, kw_only=True)
class Live(Common):
    """Follow objects with a live camera: answers at a steady rate, however slow the detector is.

    A file or folder is played at its own speed. `eagor live replay DIR` plays a recording of --record again.
    """

    runs: ClassVar[str] = "eagor.cli.live:live"

    words: Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE QUERY ...", help_behavior_hint="(required)")]
    (
        "A camera (/dev/video0, rtsp://HOST/PATH, http://..., udp://..., ros:/image_topic, - or pipe:rgb24:1920x960 "
        "for standard input), a video, a folder, or a ROS 2 bag (BAG?topic=/image); then what to look for, each in "
        "quotes. Or: replay DIR."
    )
    poses: Annotated[str, arg(metavar="SOURCE")] = "auto"
    (
        "How the camera turns and moves. auto: by a bag's odometry, a video's IMU, else the pictures (rotation only); "
        "level: the same for a camera that keeps its pictures level; still: it stands; ros:/odom: a ROS 2 topic, also "
        "of a bag; go2: the robot's odometry; CSV: a file, as for track, for a recorded source."
    )
    rate: Annotated[float, arg(metavar="HZ")] = 20.0
    """Answers per second."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, onnx:MODEL.onnx, a model, or an installed one (as for locate). Also with replay."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 60.0
    """Time that one look may take; then the detector is ended and started anew."""
    record: Annotated[Path | None, bare("DIR")] = None
    """Record everything into this new folder: a ROS 2 bag (MCAP)."""
    pictures: Literal["jpeg", "png", "none"] = "jpeg"
    """How --record keeps the pictures; png is exact, but slow."""
    rerun: Rerun = None
    fast: Flag = False
    """Look at every picture of a file or folder, as fast as the detector can; time is that of the recording."""
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop after this time (default: when the source ends, or at Ctrl-C)."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time from capture to arrival of the camera's pictures."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are those of fisheye or ordinary lenses."""
    rows: Annotated[int | None, bare("N")] = None
    """Rows of the panoramas at most (default: 960, or what the detector wants)."""
    domain: Annotated[int | None, bare("N")] = None
    """DDS domain of ros: and go2 (default: ROS_DOMAIN_ID, else 0)."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface of ros: and go2, such as eth0."""
    modes: Modes = 10
    floor: Floor = None
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    drift: Annotated[float, arg(metavar="DEG_PER_S")] = 0.0
    """Heading drift of the poses in the first second, degrees; it grows with the square root of time."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    mask: Mask = None
    force: Force = False
    json: Flag = False
    """Print one JSON object per line: each answer."""
