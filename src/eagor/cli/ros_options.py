"""The options of ``eagor ros``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from eagor.cli.shared_options import Common, Detector, Flag, Floor, Force, Whole, bare


@dataclass(frozen=True, kw_only=True)
class Ros(Common):
    """A node of ROS 2, without ROS: pictures and odometry in, directions out, until Ctrl-C.

    It writes ~/direction, ~/direction_pose, ~/markers, ~/belief_image, ~/belief and /diagnostics, where ~ is --name,
    and takes queries on ~/query.
    """

    runs: ClassVar[str] = "eagor.cli.ros:ros"

    queries: Annotated[tuple[str, ...], Positional, arg(metavar="[QUERY ...]", help_behavior_hint="")] = ()
    """What to look for, each in quotes; more, or others, come on ~/query."""
    image_topic: Annotated[str | None, bare("TOPIC")] = None
    """The panoramas: Image or CompressedImage (default: the only such topic)."""
    odom_topic: Annotated[str | None, bare("TOPIC")] = None
    """Odometry, PoseStamped, Imu, or /tf (default: the only topic of the first of these kinds)."""
    poses: Literal["odom", "auto", "level", "still"] = "odom"
    (
        "How the camera's motion is known. odom: by --odom-topic; auto: rotation from the pictures; level: the same "
        "for a camera that keeps its pictures level; still: it stands."
    )
    domain: Annotated[int | None, bare("N")] = None
    """DDS domain (default: ROS_DOMAIN_ID, else 0)."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface, such as eth0 (default: the library chooses); lo: this machine only."""
    name: Annotated[str, arg(metavar="NAME")] = "/eagor"
    """Name of the node, with its namespace: the ~ of its topics."""
    body: Annotated[str, arg(metavar="FRAME")] = "base_link"
    """Frame of the answers."""
    camera: Annotated[str | None, bare("FRAME")] = None
    """Frame of the camera (default: as its pictures say); /tf_static tells where it is on the body."""
    world: Annotated[str | None, bare("FRAME")] = None
    """Frame of the poses, with --odom-topic /tf (default: odom, else map)."""
    rate: Annotated[float, arg(metavar="HZ")] = 20.0
    """Answers per second."""
    belief_rate: Annotated[float, arg(metavar="HZ")] = 2.0
    """Pictures of the belief per second; 0: none."""
    belief_encoding: Literal["mono8", "32FC1"] = "mono8"
    """mono8: 255 is the peak; 32FC1: the density per steradian."""
    latency: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time from capture to the stamp in the pictures' headers, for drivers that stamp late."""
    use_sim_time: Flag = False
    """Take the time from /clock, as nodes do in a simulation, or beside `ros2 bag play --clock`."""
    rig: Annotated[Path | None, bare("FILE.yaml")] = None
    """The lenses, if the pictures are those of fisheye or ordinary lenses."""
    perception: Annotated[str | None, bare("NAME")] = None
    """The detector: colour, coco, onnx:MODEL.onnx, a model, or an installed one (as for locate)."""
    patience: Annotated[float, arg(metavar="SECONDS")] = 60.0
    """Time that one look may take; then the detector is ended and started anew."""
    record: Annotated[Path | None, bare("DIR")] = None
    """Record everything into this new folder: a ROS 2 bag (MCAP)."""
    cmd_vel: Annotated[str | None, bare("TOPIC")] = None
    """Drive the base to the first thing: write velocities (Twist) to this topic, such as /cmd_vel (default: never)."""
    speed: Annotated[float, arg(metavar="M/S")] = 0.3
    """With --cmd-vel: the fastest it walks, at most 0.5."""
    distance: Annotated[float, arg(metavar="METRES")] = 1.0
    """With --cmd-vel: where it stops, before the thing."""
    seconds: Annotated[float | None, bare("SECONDS")] = None
    """Stop after this time (default: at Ctrl-C)."""
    floor: Floor = None
    degree: Whole = 15
    """Degree of the spherical harmonics, 1 to 63."""
    calibration: Annotated[Path | None, bare("FILE.json")] = None
    """Calibration of the perception and of forgetting, from `eagor calibrate`."""
    detector: Detector = None
    force: Force = False
    json: Flag = False
    """At the end, print one JSON object: what was counted."""
