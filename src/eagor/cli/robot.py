"""``eagor robot``: a simulated Go2 on the network; whether a Go2 can be heard and spoken to."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg

from eagor.cli import terminal
from eagor.cli.options import Common, Flag, Whole, bare, grouped
from eagor.cli.robot_run import RobotRun

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
    """What is to be found: it starts some metres from it. "red ball" (or blue, yellow, green) brings one that rolls."""
    speed: Annotated[float, arg(metavar="M_PER_S")] = 0.3
    """Speed of the ball; 0: it lies."""
    camera: Literal["erp", "none"] = "erp"
    """Pictures of the camera: panoramas, or none."""
    rows: Whole = 128
    """Rows of its pictures."""
    rate: Annotated[float, arg(metavar="HZ")] = 5.0
    """Pictures per second, as far as this machine can draw them."""
    latency: Seconds = 0.15
    """Time from capture to arrival of a picture."""
    clock_offset: Seconds = 0.0
    """By how much the robot's clock is ahead of this machine's."""
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


Robot = grouped("Robot", "A Unitree Go2, real or simulated.", RobotRun, RobotSim, RobotCheck)


def robot_check(options: RobotCheck) -> int:
    """``eagor robot check``; exit code 1 if something is wrong."""
    from eagor.robots.dds import Participant, default_domain
    from eagor.robots.go2.sport import check_robot

    domain = default_domain() if options.domain is None else options.domain
    with Participant(domain, options.interface) as link:
        report = check_robot(link, options.seconds)
    facts, problems = {name: value for name, value in report.items() if name != "problems"}, report["problems"]
    if "clock" in report:
        clock, (median, late) = report["clock"], report["lateness"]
        way = "ahead of" if clock > 0 else "behind"
        facts["clock"] = f"{abs(clock):.3f} s {way} this machine's, or less by the time that messages take"
        facts["lateness"] = f"of states: median {1000 * median:.1f} ms, one in a hundred {1000 * late:.1f} ms"
    lines = [*terminal.facts(facts), *(f"problem: {problem}" for problem in problems)]
    lines.append("it cannot be used like this" if problems else "a Go2 that can be used")
    terminal.give(options.json, report | {"usable": not problems}, *lines)
    return terminal.FAILED if problems else terminal.OK


def robot_sim(options: RobotSim) -> int:
    """``eagor robot sim``."""
    from eagor.robots.dds import default_domain
    from eagor.robots.go2.sim import SimSettings, SimulatedGo2
    from eagor.sphere import heading

    settings = SimSettings(
        options.world, options.seed, options.target, options.speed, upright=not options.lying,
        rows=None if options.camera == "none" else options.rows, rate=options.rate, latency=options.latency,
        clock_offset=options.clock_offset, short=options.short,
    )  # fmt: skip
    terminal.log(f"building the house (seed {options.seed}), and waiting for the camera")
    domain = default_domain() if options.domain is None else options.domain
    with SimulatedGo2(settings, domain, options.interface) as live:
        house, pose, begun = live.house, live.plant.truth.pose, time.monotonic()
        assert house is not None
        assert pose.position is not None
        yaw = round(math.degrees(heading(pose.world_R_body)), 1)
        facts = {
            "domain": domain,
            "interface": options.interface,
            "world": house.scene.source,
            "start": {"position": pose.position.round(3).tolist(), "yaw_deg": yaw},
            "target": options.target,
            "targets": [{"name": each.name, "position": each.centre.round(3).tolist()} for each in house.targets],
            "things": dict(sorted(Counter(thing.name for thing in house.things).items())),
            "topics": live.topics,
        }
        shown = {"things": [f"{count} {name}" for name, count in facts["things"].items()]}
        seconds = math.inf if options.seconds is None else options.seconds
        ending = "end it with Ctrl-C" if options.seconds is None else f"it ends after {seconds:g} s"
        terminal.give(options.json, facts, "a simulated Go2", *terminal.facts(facts | shown, 2), ending)
        waiting = threading.Event()  # Ctrl-C and SIGTERM come as KeyboardInterrupt
        try:
            while (left := begun + seconds - time.monotonic()) > 0:
                waiting.wait(min(0.5, left))
                if not live.alive:
                    raise terminal.RunError("the camera's process has ended; start the robot again")
        finally:
            did = f"walked {live.plant.walked:.2f} m, {live.asked} commands"
            skipped = f", {live.skipped} steps late" if live.skipped else ""
            terminal.log(f"after {time.monotonic() - begun:.0f} s: {did}{skipped}")
    return terminal.OK
