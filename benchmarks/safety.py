"""How long a Go2 needs from each fault to standing, through the guard over DDS, on this machine.

    python benchmarks/safety.py [--repeats 20] [--faults NAME ...]
    python benchmarks/safety.py --processes [--repeats 3] [--speeds 0.15 0.5] [--seconds 1 3 8] [--faults NAME ...]

The robot is the peer of the tests, which notes each request when it comes, and whose body has the dead time (0.15 s)
and the lag (0.30 s) that were fitted to a real Go2. It walks at 0.5 m/s and turns at 0.4 rad/s, as commanded, when the
fault begins. `zero`: seconds from the fault until nothing is commanded any more, for good. `standing`: until its body
is below 0.05 m/s and 0.05 rad/s. Both are read from the monotonic clock of this machine. A fault begins when it holds:
a picture that is older than its limit, a key that is no longer held. Exit code 1 if `zero` is ever above 0.25 s.

--processes: whole processes walk the simulated Go2 in a circle: the program (the live loop with its odometry, the
steering), the guard, the detector (`colour`), and a camera with ten pictures per second, which arrive 0.1 s after their
capture. Each is killed (SIGKILL), and frozen for some seconds (SIGSTOP, SIGCONT); the last fault is a second commander.
`zero` is then for the first time, for a robot may walk again after a fault that ended (`again`: how often it did), and
may be 0.6 s where the detector is frozen: three of its usual intervals are less than the half second that is always
allowed, and the gate's step and the way come to it.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import common
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from go2_peer import Peer, Simulated
from guard_driving import OTHER, TRIALS, Driver, Time, begun_by, bring_to_speed, fast_enough, measured, until

from eagor.errors import DeviceError
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2.house import CAMERA_FRAME, CAMERA_TOPIC
from eagor.robots.go2.sim import TRUTH
from eagor.robots.go2.state import Go2State, Odometry
from eagor.robots.safety.guard import Guard

LIMIT, FROZEN_DETECTOR = 0.25, 0.6  # seconds
ENDED = {
    "kill -9 of the program": (signal.SIGKILL, "program"), "SIGSTOP of the program": (signal.SIGSTOP, "program"),
    "SIGTERM of the program": (signal.SIGTERM, "program"), "SIGINT of the guard": (signal.SIGINT, "guard"),
    "SIGTERM of the guard": (signal.SIGTERM, "guard"), "kill -9 of the guard": (signal.SIGKILL, "guard"),
    "SIGSTOP of the guard": (signal.SIGSTOP, "guard"),
}  # fmt: skip
PROCESSES, COMMANDER = ("program", "guard", "detector", "camera"), "second commander"
TURN = 0.3  # rad/s, of the circle
RATE, ARRIVES = 10.0, 0.1  # pictures per second, and seconds from capture to arrival
LOADING, WAIT = 60.0, 10.0  # seconds for the processes to start, and for a robot to stand or to walk again


def of_a_fault(name: str, repeats: int) -> list[Time]:
    """The times of a fault that the guard survives."""
    trial, domain, found = TRIALS[name], free_domain(), []
    guard = Guard(armed=True, deadman="none", domain=domain, interface="lo")
    with Peer(domain=domain) as peer, guard, Driver(guard) as driver:
        for _ in range(repeats):
            peer.told.clear()
            peer.speeds.clear()
            bring_to_speed(driver, peer)
            begun = begun_by(trial, driver, peer)
            if name == "stale command":
                begun = guard._said["command"]  # its age counts from when it was given
            found.append(measured(peer, begun))
            trial.end(driver, peer)
    return found


def begun_part(name: str, *words: Any) -> subprocess.Popen[str]:
    """A process of this script."""
    command = [sys.executable, __file__, "--part", name, *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def driver(domain: int) -> None:
    """A program that drives, with its guard."""
    with Guard(armed=True, deadman="none", domain=domain, interface="lo") as guard, Driver(guard):
        print(guard.pid, flush=True)
        time.sleep(600)


def of_an_end(name: str, repeats: int) -> list[Time]:
    """The times of a program or guard that is ended from outside."""
    number, whom = ENDED[name]
    found, domain = [], free_domain()  # a process keeps the ports of every domain that it was on
    for _ in range(repeats):
        with Peer(domain=domain) as peer:
            child = begun_part("driver", domain)
            assert child.stdout is not None
            guard = int(child.stdout.readline())
            fast_enough(peer, Driver.velocity)
            begun = time.monotonic()
            os.kill(child.pid if whom == "program" else guard, number)
            found.append(measured(peer, begun))
            child.kill()
            child.wait()
            if whom == "guard":
                with suppress(ProcessLookupError):  # one that is frozen does not hear of its program's end
                    os.kill(guard, signal.SIGKILL)
    return found


# --- whole processes ---


class Steady:
    """A guard that always wants the same velocity, for a thing that is always there; the ages are the loop's."""

    def __init__(self, guard: Guard, speed: float) -> None:
        self.guard, self.speed, self.pose = guard, speed, guard.pose

    @property
    def state(self) -> Any:
        return self.guard.state

    def command(self, forward: float, left: float, turn: float) -> None:
        self.guard.command(self.speed, 0.0, TURN)

    def status(self, *, presence: float | None, **ages: Any) -> None:
        self.guard.status(presence=None if presence is None else 1.0, **ages)


def program(domain: int, speed: float) -> None:
    """The program that steers: says the numbers of its processes, and walks until somebody ends it."""
    from eagor.live.loop import LiveLoop
    from eagor.robots.go2.camera import DdsCamera
    from eagor.robots.safety.walking import Odometer, WalkSettings, steer

    with Link(domain, "lo") as link, Guard(armed=True, deadman="none", domain=domain, interface="lo") as guard:
        steady = Steady(guard, speed)
        odometer = Odometer(steady, lambda: loop.clock.now())
        loop = LiveLoop(
            lambda: DdsCamera(CAMERA_TOPIC, domain, "lo"), "colour", ["red chair"], poses=lambda: Go2State(link),
            watchers=[odometer],
        )  # fmt: skip
        told = False
        for step in steer(loop, steady, odometer, WalkSettings()):
            if not told and math.isfinite(step.answer.look_age):
                print(json.dumps({"guard": guard.pid, "detector": loop._keeper._worker.process.pid}), flush=True)
                told = True


def camera(domain: int) -> None:
    """The camera: a painted room far away, which turns as the robot does."""
    from eagor.lab.worlds.painted import painted_room
    from eagor.media.ros_messages import pose_of
    from eagor.robots.go2.camera import PICTURE, picture_message
    from eagor.sphere import heading

    room, turned = painted_room(128, 256), [0.0]

    def seen(message: Any, _: float) -> None:
        turned[0] = heading(pose_of(message).world_R_body)

    with Link(domain, "lo") as link:
        link.subscribe(TRUTH, Odometry, seen)
        writer = link.publish(CAMERA_TOPIC, PICTURE)
        due = time.monotonic()
        while True:
            stamp, columns = time.time(), round(turned[0] / (2 * math.pi) * room.shape[1])
            time.sleep(ARRIVES)
            writer.write(picture_message(np.roll(room, columns, axis=1), stamp, CAMERA_FRAME))
            due = max(due + 1 / RATE, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


class Rig:
    """The robot, and the processes that walk it. `pids`: by the name of the process."""

    def __init__(self, robot: Simulated, speed: float) -> None:
        self.robot, self.speed = robot, speed
        self.pids: dict[str, int] = {}
        self.running: dict[str, subprocess.Popen[str]] = {}

    def walking(self) -> None:
        """Start what does not run, and wait until the robot goes as fast as it is told."""
        self._start("camera", self.robot.domain)
        if said := self._start("program", self.robot.domain, self.speed):
            self.pids |= json.loads(said.readline())
        self.robot.told.clear()
        self.robot.speeds.clear()
        until(lambda: self.robot.commanded(time.monotonic()) == (self.speed, 0.0, TURN), LOADING)
        fast_enough(self.robot, (self.speed, 0.0, TURN))

    def _start(self, name: str, *words: Any) -> Any:
        """What a process says, if it was started now."""
        if name in self.running and self.running[name].poll() is None:
            return None
        begun = begun_part(name, *words)
        self.running[name], self.pids[name] = begun, begun.pid
        return begun.stdout

    def stop(self, *names: str) -> None:
        """End processes that are not to go on."""
        for name in names:
            self.running[name].kill()
            self.running[name].wait()


def of_a_process(rig: Rig, whom: str, frozen: float | None) -> tuple[Time, bool | None]:
    """Make a fault while the robot walks (`frozen`: for so many seconds, None kills); whether it walked again."""
    rig.walking()
    robot, begun = rig.robot, time.monotonic()
    if whom == COMMANDER:
        begun = OTHER.begin(None, robot)  # type: ignore[arg-type]
    else:
        os.kill(rig.pids[whom], signal.SIGKILL if frozen is None else signal.SIGSTOP)
    try:
        until(lambda: robot.zero_since(begun) is not None and robot.still_since(begun) is not None, WAIT)
        zero, still = robot.zero_since(begun), robot.still_since(begun)
        assert zero is not None
        assert still is not None
    finally:
        if frozen is not None:
            time.sleep(max(0.0, begun + frozen - time.monotonic()))
            with suppress(ProcessLookupError):
                os.kill(rig.pids[whom], signal.SIGCONT)
    again = None
    if whom == COMMANDER:
        OTHER.end(None, None)  # type: ignore[arg-type]
    if whom == COMMANDER or frozen is not None:
        since, again = time.monotonic(), False
        with suppress(AssertionError):
            again = until(lambda: any(told.when > since and any(told.velocity or ()) for told in robot.told), WAIT)
    killed = frozen is None and whom in ("program", "guard", "detector")
    if killed or again is False or rig.running["program"].poll() is not None:
        rig.stop("program")  # with what belongs to it
    return Time(zero - begun, still - begun), again


# --- the tables ---


def row(name: str, times: Sequence[Time], most: float = LIMIT, more: str = "") -> bool:
    """Print a line of the table; whether it is too late."""
    zero, standing = 1000 * np.array([(found.zero, found.standing) for found in times]).T
    late = bool(zero.max() > 1000 * most)
    values = (np.median(zero), zero.max(), np.median(standing), standing.max())
    print(f"| {name} | {' | '.join(f'{v:.0f}' for v in values)} | {more}{'TOO LATE' if late else ''} |", flush=True)
    return late


def processes(options: argparse.Namespace) -> bool:
    """The table of whole processes; whether any was too late."""
    late = False
    for speed in options.speeds:
        with Simulated(domain=free_domain()) as robot:
            rig = Rig(robot, speed)
            try:
                for whom in options.faults or (*PROCESSES, COMMANDER):
                    for frozen in [None] if whom == COMMANDER else [None, *options.seconds]:
                        tried = [of_a_process(rig, whom, frozen) for _ in range(options.repeats or 3)]
                        fate = f" frozen for {frozen:g} s" if frozen else "" if whom == COMMANDER else " killed"
                        ended = [again for _, again in tried if again is not None]
                        more = f"again {sum(ended)} of {len(ended)} " if ended else ""
                        most = FROZEN_DETECTOR if frozen and whom == "detector" else LIMIT
                        late |= row(f"{whom}{fate}, at {speed:g} m/s", [found for found, _ in tried], most, more)
            finally:
                rig.stop(*rig.running)
    return late


def main() -> int:
    parser = common.parser(__doc__, repeats=int, processes=False, speeds=[0.15, 0.5])
    parser.add_argument("--faults", nargs="+")
    parser.add_argument("--seconds", type=float, nargs="*", default=[1.0, 3.0, 8.0], help="for which it is frozen")
    parser.add_argument("--part", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        with suppress(KeyboardInterrupt, DeviceError):
            name, domain, *speed = options.part
            {"camera": camera, "driver": driver, "program": program}[name](int(domain), *map(float, speed))
            return 0
        return 1
    print("| fault | zero p50 (ms) | zero max (ms) | standing p50 (ms) | standing max (ms) | |")
    print("|---|---:|---:|---:|---:|---|")
    if options.processes:
        return processes(options)
    late = False
    for name in options.faults or (*TRIALS, *ENDED):
        late |= row(name, (of_a_fault if name in TRIALS else of_an_end)(name, options.repeats or 20))
    return late


if __name__ == "__main__":
    sys.exit(main())
