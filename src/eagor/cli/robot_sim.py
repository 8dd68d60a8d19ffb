"""``eagor robot sim``: a simulated Go2 on the network."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from typing import Any

from eagor._checks import above, within
from eagor.cli import terminal
from eagor.cli.robot_options import RobotSim
from eagor.robots.go2.house import ball_of
from eagor.robots.go2.plant import PlantSettings
from eagor.robots.go2.sim import CameraSettings, SimSettings, SimulatedGo2, WireSettings
from eagor.robots.go2.sim_live import LiveGo2
from eagor.robots.ros.graph import default_domain
from eagor.sphere import heading


def sim(options: RobotSim) -> int:
    """Run the command."""
    settings = settings_of(options)
    if options.seconds is not None and not above(options.seconds, 0):
        raise terminal.UsageError(f"--seconds {options.seconds:g}: wanted more than 0")
    if not options.json:
        terminal.log(f"building the house (seed {options.seed})")
    robot = SimulatedGo2(settings)
    domain = default_domain() if options.domain is None else options.domain
    with LiveGo2(robot, domain, options.interface) as live:
        if not options.json:
            terminal.log("waiting for the camera" if live.pictures else "without a camera")
        live.wait_for_camera()
        if options.json:
            terminal.emit(_facts(live, options))
        else:
            _tell(live, options)
        begun = time.monotonic()
        try:
            _until(options.seconds, live)
        finally:
            _sum_up(live, time.monotonic() - begun)
    return terminal.OK


def settings_of(options: RobotSim) -> SimSettings:
    """What is simulated with these options. Raises `UsageError`, `DeviceError`."""
    if not within(options.speed, 0, 3):
        raise terminal.UsageError(f"--speed {options.speed:g}: wanted 0 to 3 metres per second")
    camera = None
    if options.camera != "none":
        camera = CameraSettings(options.camera, options.rows, options.rate, options.latency)
    return SimSettings(
        world=options.world,
        seed=options.seed,
        target=options.target,
        speed=options.speed,
        plant=PlantSettings(upright=not options.lying),
        wire=WireSettings(
            clock_offset=options.clock_offset, drop=options.drop, delay=(0.0, options.delay), short=options.short
        ),
        camera=camera,
    )


def _facts(live: LiveGo2, options: RobotSim) -> dict[str, Any]:
    robot = live.robot
    pose = robot.truth.pose
    assert pose.position is not None
    yaw = math.degrees(heading(pose.world_R_body))
    return {
        "domain": live.link.domain,
        "interface": options.interface,
        "world": None if robot.house is None else robot.house.scene.source,
        "start": {"position": pose.position.round(3).tolist(), "yaw_deg": round(yaw, 1)},
        "target": options.target,
        "targets": [{"name": each.name, "position": each.centre.round(3).tolist()} for each in robot.targets],
        "things": dict(sorted(Counter(thing.name for thing in robot.things()).items())),
        "topics": live.topics,
    }


def _tell(live: LiveGo2, options: RobotSim) -> None:
    robot = live.robot
    pose = robot.truth.pose
    assert pose.position is not None
    x, y, _ = pose.position
    yaw = math.degrees(heading(pose.world_R_body))
    where = "only this machine" if options.interface == "lo" else f"all on {options.interface}"
    found = {
        "simulated Go2": f"DDS domain {live.link.domain} on {options.interface}, which {where} can hear",
        "house": "" if robot.house is None else robot.house.scene.source,
        "start": f"x {x:.2f} m, y {y:.2f} m, heading {yaw:.0f} degrees",
        "posture": "lying" if options.lying else "standing, ready to walk",
    }
    for each in robot.targets:
        _, distance = robot.bearing(each)
        rolls = f", which rolls at {options.speed:g} m/s" if ball_of(options.target) and options.speed else ""
        found["target"] = f"{each.name}{rolls}, {distance:.1f} m away"
    count = Counter(thing.name for thing in robot.things())
    found["things"] = ", ".join(name if number == 1 else f"{number} {name}s" for name, number in sorted(count.items()))
    terminal.facts(found)
    print("topics")
    terminal.columns(live.topics)
    print("end it with Ctrl-C" if options.seconds is None else f"it ends after {options.seconds:g} s", flush=True)


def _until(seconds: float | None, live: LiveGo2) -> None:
    """Wait; Ctrl-C and SIGTERM come as KeyboardInterrupt."""
    end = math.inf if seconds is None else time.monotonic() + seconds
    waiting = threading.Event()
    while (left := end - time.monotonic()) > 0:
        waiting.wait(min(0.5, left))
        if live.pictures is not None and not live.pictures.alive:
            raise terminal.RunError("the camera's process has ended; start the robot again")


def _sum_up(live: LiveGo2, seconds: float) -> None:
    pictures = live.pictures
    drawn = (
        "" if pictures is None else f", {pictures.drawn} pictures ({pictures.skipped} that could not be drawn in time)"
    )
    skipped = f", {live.server.skipped} steps late" if live.server.skipped else ""
    terminal.log(
        f"after {seconds:.0f} s: walked {live.robot.plant.walked:.2f} m, {live.server.asked} commands{drawn}{skipped}"
    )
