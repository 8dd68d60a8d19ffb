"""``eagor robot``: a simulated Go2 on the network; whether a Go2 can be heard and spoken to."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import arg, subcommand

from eagor._checks import above, within
from eagor.cli import terminal
from eagor.cli.options import Common, Flag, Whole, bare
from eagor.cli.robot_run import RobotRun

if TYPE_CHECKING:
    from eagor.robots.go2.sim import SimSettings, SimulatedGo2


Domain = Annotated[int | None, bare("N")]
Seconds = Annotated[float, arg(metavar="SECONDS")]


@dataclass(frozen=True, kw_only=True)
class RobotSim(Common):
    """Simulate a Go2 with a 360-degree camera in a house, on the network as a real one; until Ctrl-C.

    It obeys whoever speaks to it, and has the faults of a real one: it trots, drifts, and needs its time. Only this
    machine can hear it, unless you name a network interface.
    """

    runs: ClassVar[str] = "sim"

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

    runs: ClassVar[str] = "check"

    domain: Domain = None
    """DDS domain (default: ROS_DOMAIN_ID, else 0). A real robot is on 0."""
    interface: Annotated[str | None, bare("NAME")] = None
    """Network interface to the robot, such as eth0; lo for a simulated one (default: the library chooses)."""
    seconds: Seconds = 3.0
    """How long to listen."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A Unitree Go2, real or simulated."""

    action: Annotated[
        Annotated[RobotRun, subcommand("run")]
        | Annotated[RobotSim, subcommand("sim")]
        | Annotated[RobotCheck, subcommand("check")],
        arg(name=""),  # as in `Bench`
    ]


def check(options: RobotCheck) -> int:
    """Run the command; exit code 1 if something is wrong."""
    from eagor.robots.dds import Participant, default_domain
    from eagor.robots.go2.sport import check_robot

    if not within(options.seconds, 0.5, 600):
        raise terminal.UsageError(f"--seconds {options.seconds:g}: wanted 0.5 to 600")
    domain = default_domain() if options.domain is None else options.domain
    with Participant(domain, options.interface) as link:
        report = check_robot(link, options.seconds)
    if options.json:
        terminal.emit(report | {"usable": not report["problems"]})
    else:
        terminal.facts(_heard(report))
        for problem in report["problems"]:
            terminal.say(f"problem: {problem}")
        print("it cannot be used like this" if report["problems"] else "a Go2 that can be used")
    return terminal.FAILED if report["problems"] else terminal.OK


def _heard(report: dict[str, Any]) -> dict[str, str]:
    """The report in words; only what was heard."""
    found = {"topics": ", ".join(report["topics"])}
    if report["rates"]:
        found["messages per second"] = ", ".join(f"{topic} {rate:g}" for topic, rate in report["rates"].items())
    if "firmware" in report:
        found["firmware"] = report["firmware"]
    if "mode" in report:
        found["robot"] = report["mode"] + (f", error {report['error_code']}" if report["error_code"] else "")
        clock, (median, late) = report["clock"], report["lateness"]
        way = "ahead of" if clock > 0 else "behind"
        found["its clock"] = f"{abs(clock):.3f} s {way} this machine's, or less by the time that messages take"
        found["lateness of states"] = f"median {1000 * median:.1f} ms, one in a hundred {1000 * late:.1f} ms"
    if "battery" in report:
        found["battery"] = f"{report['battery']} %, {report['volts']:.1f} V"
    if "answer" in report:
        found["walking service"] = f"version {report['sport_version']}, answers in {1000 * report['answer']:.1f} ms"
    if report["commands"]:
        found["commands of others"] = str(report["commands"])
    found["cameras"] = ", ".join(report["cameras"]) or "none on DDS"
    return found


def sim(options: RobotSim) -> int:
    """Run the command."""
    from eagor.robots.dds import default_domain
    from eagor.robots.go2.sim import SimulatedGo2

    settings = settings_of(options)
    if options.seconds is not None and not above(options.seconds, 0):
        raise terminal.UsageError(f"--seconds {options.seconds:g}: wanted more than 0")
    if not options.json:
        terminal.log(f"building the house (seed {options.seed})")
    domain = default_domain() if options.domain is None else options.domain
    robot = SimulatedGo2(settings, domain, options.interface)
    if not options.json:
        terminal.log("waiting for the camera" if settings.rows else "without a camera")
    with robot as live:
        facts, begun = _facts(live, options), time.monotonic()
        terminal.emit(facts) if options.json else _tell(facts, options)
        try:
            _until(options.seconds, live)
        finally:
            skipped = f", {live.skipped} steps late" if live.skipped else ""
            did = f"walked {live.plant.walked:.2f} m, {live.asked} commands{skipped}"
            terminal.log(f"after {time.monotonic() - begun:.0f} s: {did}")
    return terminal.OK


def settings_of(options: RobotSim) -> SimSettings:
    """What is simulated with these options. Raises `UsageError`, `DeviceError`."""
    from eagor.robots.go2.sim import SimSettings

    if not within(options.speed, 0, 3):
        raise terminal.UsageError(f"--speed {options.speed:g}: wanted 0 to 3 metres per second")
    return SimSettings(
        options.world, options.seed, options.target, options.speed, upright=not options.lying,
        rows=None if options.camera == "none" else options.rows, rate=options.rate, latency=options.latency,
        clock_offset=options.clock_offset, short=options.short,
    )  # fmt: skip


def _facts(live: SimulatedGo2, options: RobotSim) -> dict[str, Any]:
    from eagor.sphere import heading

    house, pose = live.house, live.plant.truth.pose
    assert house is not None
    assert pose.position is not None
    yaw = math.degrees(heading(pose.world_R_body))
    return {
        "domain": live.link.domain,
        "interface": options.interface,
        "world": house.scene.source,
        "start": {"position": pose.position.round(3).tolist(), "yaw_deg": round(yaw, 1)},
        "target": options.target,
        "targets": [{"name": each.name, "position": each.centre.round(3).tolist()} for each in house.targets],
        "things": dict(sorted(Counter(thing.name for thing in house.things).items())),
        "topics": live.topics,
    }


def _tell(facts: dict[str, Any], options: RobotSim) -> None:
    (x, y, _), yaw = facts["start"]["position"], facts["start"]["yaw_deg"]
    targets = [f"{each['name']}, {math.dist(each['position'][:2], (x, y)):.1f} m away" for each in facts["targets"]]
    things = facts["things"].items()
    where = "only this machine" if options.interface == "lo" else f"all on {options.interface}"
    found = {
        "simulated Go2": f"DDS domain {facts['domain']} on {options.interface}, which {where} can hear",
        "house": facts["world"],
        "start": f"x {x:.2f} m, y {y:.2f} m, heading {yaw:.0f} degrees, {'lying' if options.lying else 'standing'}",
        "target": "; ".join(targets) or "none",
        "things": ", ".join(name if number == 1 else f"{number} {name}s" for name, number in things),
        "topics": ", ".join(facts["topics"]),
    }
    terminal.facts(found)
    print("end it with Ctrl-C" if options.seconds is None else f"it ends after {options.seconds:g} s", flush=True)


def _until(seconds: float | None, live: SimulatedGo2) -> None:
    """Wait; Ctrl-C and SIGTERM come as KeyboardInterrupt."""
    end = math.inf if seconds is None else time.monotonic() + seconds
    waiting = threading.Event()
    while (left := end - time.monotonic()) > 0:
        waiting.wait(min(0.5, left))
        if not live.alive:
            raise terminal.RunError("the camera's process has ended; start the robot again")
