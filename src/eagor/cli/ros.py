"""``eagor ros``: a node of ROS 2 over DDS."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from eagor.cli import terminal
from eagor.cli.checks import (
    checked_latency,
    checked_queries,
    checked_record,
    checked_seconds,
    ordinary,
    perception_for_all,
    rows_for,
    tracker_config,
    wants_panoramas,
)
from eagor.cli.options import CameraInfo, Common, Detector, Flag, Floor, Force, Hfov, Static, Whole, bare


@dataclass(frozen=True, kw_only=True)
class Ros(Common):
    """A node of ROS 2, without ROS: pictures and odometry in, directions out, until Ctrl-C.

    It writes ~/direction, ~/direction_pose, ~/markers, ~/belief_image, ~/belief, /diagnostics, and for an ordinary
    camera ~/next_look, where ~ is --name. It takes queries on ~/query.
    """

    runs: ClassVar[str] = "ros"

    queries: Annotated[tuple[str, ...], Positional, arg(metavar="[QUERY ...]", help_behavior_hint="")] = ()
    """What to look for, each in quotes; more, or others, come on ~/query."""
    image_topic: Annotated[str | None, bare("TOPIC")] = None
    (
        "The pictures: Image or CompressedImage (default: the only such topic); of several cameras, their topics with "
        "commas between."
    )
    camera_info: CameraInfo = None
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
    hfov: Hfov = None
    intrinsics: Annotated[Path | None, bare("FILE")] = None
    """An ordinary camera without camera_info: its calibration in a file; --camera is its frame."""
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
    static: Static = False
    force: Force = False
    json: Flag = False
    """At the end, also after Ctrl-C, print one JSON object: what was counted."""


NAME = re.compile(r"(/[A-Za-z]\w*)+")


def ros(options: Ros) -> int:
    """Run the command; returns its exit code."""
    from eagor.robots.ros.graph import DdsGraph
    from eagor.robots.ros.node import Node, NodeSettings
    from eagor.robots.safety.walking import WalkSettings

    queries = tuple(checked_queries(options.queries))
    name = options.name if options.name.startswith("/") else f"/{options.name}"
    if not NAME.fullmatch(name):
        raise terminal.UsageError(
            f"--name {options.name}; wanted letters, digits and _, such as /eagor or /robot1/eagor"
        )
    checked_seconds(options.seconds)
    checked_latency(options.latency)
    checked_record(options.record)
    if options.cmd_vel is not None and options.poses != "odom":
        raise terminal.UsageError(
            f"--cmd-vel with --poses {options.poses}: a base is driven only by odometry; leave --poses out"
        )
    several = "," in (options.image_topic or "")
    if several and options.camera is not None and options.rig is None:
        raise terminal.UsageError(
            f"--camera {options.camera} names one frame, and --image-topic {options.image_topic} several cameras: "
            "leave it out, and each one's pictures name its frame; or give their places with --rig"
        )
    rig = None
    if options.rig is not None:
        from eagor.media.rigs import read_rig

        rig = read_rig(options.rig)
    spec = perception_for_all(queries, options.perception) if queries else options.perception or "colour"
    config = tracker_config(options.degree, spec, options.calibration, options.detector, options.force, options.static)
    settings = NodeSettings(
        image_topic=options.image_topic,
        odom_topic=options.odom_topic,
        poses=options.poses,
        body=options.body,
        camera=options.camera,
        world=options.world,
        rate=options.rate,
        belief_rate=options.belief_rate,
        belief_encoding=options.belief_encoding,
        latency=options.latency,
        rows=rows_for(spec),
        patience=options.patience,
        rig=rig,
        lens=ordinary(options.hfov, options.intrinsics, options.rig, options.camera_info),
        camera_info=options.camera_info,
        stitched=(several or rig is not None) and wants_panoramas(spec),
        record=options.record,
        cmd_vel=options.cmd_vel,
        walking=WalkSettings(speed=options.speed, distance=options.distance),
        config=replace(config, floor_height=options.floor),
        use_sim_time=options.use_sim_time,
    )
    with DdsGraph(options.domain, options.interface, name) as graph:
        node = Node(
            graph, queries=queries, settings=settings, said=terminal.log,
            choose=lambda words: perception_for_all(words, options.perception),
        )  # fmt: skip
        terminal.log(
            f"node {name} on domain {graph.link.domain}, {options.interface or 'an interface of its choice'}: "
            f"directions on {name}/direction, queries on {name}/query"
        )
        if options.cmd_vel is not None:
            terminal.log(f"it DRIVES: velocities on {options.cmd_vel}; be ready to stop the base")
        timer = None
        if options.seconds is not None:
            timer = threading.Timer(options.seconds, node.stop)
            timer.daemon = True
            timer.start()
        ended = None
        try:
            node.run()
            ended = "time"
        except KeyboardInterrupt:
            ended = "interrupted"
            raise
        finally:
            if timer is not None:
                timer.cancel()
            terminal.log(f"{node.answers} answers")
            if options.json and ended is not None:
                terminal.emit({"queries": list(node.queries), "answers": node.answers, "ended": ended})
    return terminal.OK
