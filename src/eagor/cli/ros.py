"""``eagor ros``: a node of ROS 2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from eagor.cli import checks, terminal
from eagor.cli.options import Common, TrackingOptions

if TYPE_CHECKING:
    from eagor.tracking import TrackerConfig


@dataclass(frozen=True, kw_only=True)
class Ros(Common):
    """A node of ROS 2: pictures and odometry in, directions out, until Ctrl-C. It is told as nodes are.

    eagor ros --ros-args -r image:=/x3/image -r odom:=/wheels -p queries:='["red chair"]'

    `ros2 node info /eagor` lists its topics, `ros2 param describe /eagor NAME` says what a parameter means; where there
    is no `ros2`, eagor.robots.ros.PARAMETERS has them.
    """

    arguments: Positional[tuple[str, ...]] = ()
    """--ros-args and what follows it."""


def ros(options: Ros) -> int:
    """Run the command; returns its exit code."""
    from eagor.robots.ros import need_rclpy

    need_rclpy()
    from eagor.robots.ros.node import run

    return terminal.OK if run(setup, options.arguments) else terminal.USAGE


def setup(values: Mapping[str, Any], queries: Sequence[str]) -> tuple[str, TrackerConfig, dict[str, Any]]:
    """What the node's parameters mean: see `eagor.robots.ros.node.Setup`. Raises `EagorError`."""

    def told(name: str) -> Any:
        return None if values[name] == "" or values[name] != values[name] else values[name]

    calibration, camera, rig = (path and Path(path) for path in map(told, ("calibration", "intrinsics", "rig")))
    options = TrackingOptions(
        calibration=calibration, detector=told("detector"), static=values["static"], floor=told("floor"),
        hfov=told("hfov_deg"), camera=camera, rig=rig,
    )  # fmt: skip
    perception = checks.perception_for(queries, told("perception"))
    lenses = checks.lens_of(options) | {"rows": checks.rows_for(perception)}
    return perception, checks.tracker_config(perception, options), lenses
