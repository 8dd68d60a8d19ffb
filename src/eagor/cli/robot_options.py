"""The options of ``eagor robot``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from tyro.conf import arg, subcommand

from eagor.cli.robot_run_options import RobotRun
from eagor.cli.shared_options import Common, Flag, Whole, bare

Domain = Annotated[int | None, bare("N")]
Seconds = Annotated[float, arg(metavar="SECONDS")]


@dataclass(frozen=True, kw_only=True)
class RobotSim(Common):
    """Simulate a Go2 with a 360-degree camera in a house, on the network as a real one; until Ctrl-C.

    It obeys whoever speaks to it, and has the faults of a real one: it trots, drifts, and needs its time. Only this
    machine can hear it, unless you name a network interface.
    """

    seed: Whole = 7
    """Seed of the house and of all that is random."""
    world: Annotated[str, arg(metavar="WORLD")] = "apartment"
    """apartment, an installed world, or a GLB file."""
    domain: Domain = None
    """DDS domain (default: ROS_DOMAIN_ID, else 0). A real robot is on 0."""
    interface: Annotated[str, arg(metavar="NAME")] = "lo"
    """Network interface; lo stays on this machine."""
    target: Annotated[str | None, bare("QUERY")] = None
    (
        'What is to be found: it starts some metres away from it. "red ball" (blue, yellow, green) brings a ball along '
        "that rolls about."
    )
    speed: Annotated[float, arg(metavar="M_PER_S")] = 0.3
    """Speed of the ball; 0: it lies."""
    camera: Literal["erp", "fisheye", "none"] = "erp"
    """Pictures of the camera: panoramas, both circles of a dual fisheye side by side, or none."""
    rows: Whole = 128
    """Rows of its pictures."""
    rate: Annotated[float, arg(metavar="HZ")] = 5.0
    """Pictures per second, as far as this machine can draw them."""
    latency: Seconds = 0.15
    """Time from capture to arrival of a picture."""
    clock_offset: Seconds = 0.0
    """By how much the robot's clock is ahead of this machine's."""
    drop: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of the robot's messages, both ways, that get lost."""
    delay: Seconds = 0.0
    """Time that its messages take at most; each takes another one."""
    short: Flag = False
    """States in the short form of some firmware, without a planned path."""
    lying: Flag = False
    """It lies at first: it has to be told to stand up, and then takes some seconds."""
    seconds: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="", aliases=("--duration",))] = None
    """Stop after this time (default: at Ctrl-C)."""


@dataclass(frozen=True, kw_only=True)
class RobotCheck(Common):
    """Listen for a Go2: what it says, how fast, and whether it answers. Moves nothing.

    Exit codes: 0 it can be used, 1 it is there but something is wrong, 2 nobody is there.
    """

    domain: Domain = None
    """DDS domain (default: ROS_DOMAIN_ID, else 0). A real robot is on 0."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface to the robot, such as eth0; lo for a simulated one (default: the library chooses)."""
    seconds: Seconds = 3.0
    """How long to listen."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A Unitree Go2, real or simulated."""

    runs: ClassVar[str] = "eagor.cli.robot:robot"

    action: Annotated[
        Annotated[RobotRun, subcommand("run")]
        | Annotated[RobotSim, subcommand("sim")]
        | Annotated[RobotCheck, subcommand("check")],
        arg(name=""),  # as in `Bench`
    ]
