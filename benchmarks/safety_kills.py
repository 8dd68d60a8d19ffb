"""How soon a walking Go2 is commanded to stand when a process that it depends on is killed, or frozen for a while.

    python benchmarks/safety_kills.py [--repeats 3] [--speeds 0.15 0.5] [--seconds 1 3 8] [--faults NAME ...]

Four processes walk the package's simulated Go2 in a circle, over DDS on this machine: the program (the live loop with
its odometry, the steering), the guard, the detector (`colour`), and a camera with ten pictures per second, which arrive
0.1 s after their capture. Each is killed (SIGKILL), and frozen for some seconds (SIGSTOP, SIGCONT). The last fault is a
second commander. The robot is this process, which notes each request when it comes. `zero`: seconds from the fault
until nothing is commanded any more, for the first time; `standing`: until the body is below 0.05 m/s and 0.05 rad/s.
`again`: of the trials with a fault that ended, those after which the robot walked again by itself. Exit code 1 if a
robot that was told to walk is not told to stand within 0.25 s, or 0.6 s where the detector is frozen: three of its
usual intervals are less than the half second that is always allowed, and the gate's step and the way come to it.
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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import common
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from go2_peer import Simulated
from guard_driving import OTHER, fast_enough, until

from eagor.errors import DeviceError
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2.house import CAMERA_FRAME, CAMERA_TOPIC
from eagor.robots.go2.sim_wire import TRUTH
from eagor.robots.go2.state import Go2State
from eagor.robots.safety.guard import Guard
from eagor.robots.safety.messages import GuardState

PROCESSES = ("program", "guard", "detector", "camera")
TURN = 0.3  # rad/s
RATE, ARRIVES = 10.0, 0.1  # pictures per second, and seconds from capture to arrival
LIMIT, FROZEN_DETECTOR = 0.25, 0.6  # seconds
LOADING = 60.0  # seconds for the processes to start


@dataclass
class Steady:
    """A guard that always wants the same velocity, for a thing that is always there; the ages are the loop's."""

    guard: Guard
    speed: float

    @property
    def state(self) -> GuardState:
        return self.guard.state

    def command(self, forward: float, left: float, turn: float) -> None:
        self.guard.command(self.speed, 0.0, TURN)

    def status(
        self, *, image_age: float | None, pose_age: float | None, belief_age: float | None, presence: float | None,
        faults: Sequence[str] = (),
    ) -> None:  # fmt: skip
        there = None if presence is None else 1.0
        self.guard.status(image_age=image_age, pose_age=pose_age, belief_age=belief_age, presence=there, faults=faults)

    def pose(self, age: float) -> None:
        self.guard.pose(age)


def program(domain: int, speed: float) -> None:
    """The program that steers: says the numbers of its processes, and walks until somebody ends it."""
    from eagor.live.loop import LiveLoop
    from eagor.robots.ros.sources import RosCamera
    from eagor.robots.safety.walking import Odometer, WalkSettings, steer

    network, topic = {"domain": domain, "interface": "lo"}, CAMERA_TOPIC.removeprefix("rt")
    with Link(domain, "lo") as link, Guard(armed=True, deadman="none", **network) as guard:
        steady = Steady(guard, speed)
        odometer = Odometer(steady, lambda: loop.clock.now())
        loop = LiveLoop(
            lambda: RosCamera(topic, rows=128, **network), "colour", ["red chair"], poses=lambda: Go2State(link),
            watchers=[odometer],
        )  # fmt: skip
        told = False
        for step in steer(loop, steady, odometer, WalkSettings()):
            if not told and math.isfinite(step.answer.look_age):
                print(json.dumps({"guard": guard.pid, "detector": loop._keeper._worker.process.pid}), flush=True)
                told = True


def camera(domain: int) -> None:
    """The camera: a painted room far away, which turns as the robot does."""
    from eagor.media.ros_messages import compressed_message, pose_of
    from eagor.sphere import heading
    from eagor.worlds.painted import painted_room

    room, turned = painted_room(128, 256), [0.0]

    def seen(message: Any, _: float) -> None:
        turned[0] = heading(pose_of(message).world_R_body)

    with Link(domain, "lo") as link:
        link.subscribe(TRUTH, "nav_msgs/msg/Odometry", seen)
        writer = link.publish(CAMERA_TOPIC, "sensor_msgs/msg/CompressedImage")
        due = time.monotonic()
        while True:
            stamp, columns = time.time(), round(turned[0] / (2 * math.pi) * room.shape[1])
            time.sleep(ARRIVES)
            writer.write(compressed_message(np.roll(room, columns, axis=1), stamp, CAMERA_FRAME))
            due = max(due + 1 / RATE, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


@dataclass
class Rig:
    """The robot, and the processes that walk it; a context manager. `pids`: by the name of the process."""

    speed: float
    domain: int = field(default_factory=free_domain)
    pids: dict[str, int] = field(default_factory=dict)
    _running: dict[str, subprocess.Popen[str]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self.robot = Simulated(domain=self.domain).__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        for each in reversed(self._running.values()):
            each.kill()
            each.wait()
        self.robot.__exit__()

    def walking(self) -> None:
        """Start what does not run, and wait until the robot goes as fast as it is told."""
        self._start("camera", "--camera", self.domain)
        if said := self._start("program", "--program", self.domain, self.speed):
            self.pids |= json.loads(said.readline())
        self.robot.told.clear()
        self.robot.speeds.clear()
        until(lambda: self.robot.commanded(time.monotonic()) == (self.speed, 0.0, TURN), LOADING)
        fast_enough(self.robot, (self.speed, 0.0, TURN))

    def stop(self, name: str) -> None:
        """End a process that is not to go on."""
        self._running[name].kill()
        self._running[name].wait()

    def runs(self, name: str) -> bool:
        return self._running[name].poll() is None

    def _start(self, name: str, *words: Any) -> Any:
        """What a process says, if it was started now."""
        before = self._running.get(name)
        if before is not None and before.poll() is None:
            return None
        if before is not None:
            before.wait()
        command = [sys.executable, __file__, *map(str, words)]
        begun = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self._running[name], self.pids[name] = begun, begun.pid
        return begun.stdout


@dataclass(frozen=True)
class Trial:
    """What came of a fault: seconds to zero and to standing, and whether it walked again after a fault that ended."""

    zero: float
    standing: float
    again: bool | None


def tried(rig: Rig, whom: str, frozen: float | None) -> Trial:
    """Make a fault while the robot walks; `frozen`: for so many seconds, None kills."""
    rig.walking()
    robot, begun = rig.robot, time.monotonic()
    if whom == "second commander":
        begun = OTHER.begin(None, robot)  # type: ignore[arg-type]
    else:
        os.kill(rig.pids[whom], signal.SIGKILL if frozen is None else signal.SIGSTOP)
    try:
        until(lambda: robot.zero_since(begun) is not None and robot.still_since(begun) is not None, 10.0)
        zero, still = robot.zero_since(begun), robot.still_since(begun)
        assert zero is not None
        assert still is not None
    finally:
        if frozen is not None:
            time.sleep(max(0.0, begun + frozen - time.monotonic()))
            with suppress(ProcessLookupError):
                os.kill(rig.pids[whom], signal.SIGCONT)
    again = None
    if whom == "second commander":
        OTHER.end(None, None)  # type: ignore[arg-type]
    if whom == "second commander" or frozen is not None:
        since, again = time.monotonic(), True
        try:
            until(lambda: any(told.when > since and any(told.velocity or ()) for told in robot.told), 10.0)
        except AssertionError:
            again = False
    if frozen is None and whom != "second commander" and whom != "camera":
        rig.stop("program")  # with what belongs to it
    elif not rig.runs("program") or again is False:
        rig.stop("program")
    return Trial(zero - begun, still - begun, again)


def main() -> int:
    parser = common.parser(__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--speeds", type=float, nargs="+", default=[0.15, 0.5], help="metres per second")
    parser.add_argument("--seconds", type=float, nargs="*", default=[1.0, 3.0, 8.0], help="for which it is frozen")
    parser.add_argument("--faults", nargs="+", default=[*PROCESSES, "second commander"])
    parser.add_argument("--program", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--camera", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    with suppress(KeyboardInterrupt, DeviceError):
        if options.camera is not None:
            camera(options.camera)
        if options.program is not None:
            program(int(options.program[0]), float(options.program[1]))
            return 0
    if options.program is not None:
        return 1
    bad = 0
    print("| fault | m/s | zero p50 (ms) | zero max (ms) | standing max (ms) | again |  |")
    print("|---|---:|---:|---:|---:|---:|---|")
    for speed in options.speeds:
        with Rig(speed) as rig:
            for whom in options.faults:
                for frozen in [None] if whom == "second commander" else [None, *options.seconds]:
                    trials = [tried(rig, whom, frozen) for _ in range(options.repeats)]
                    what = whom if whom == "second commander" else f"{whom} killed"
                    what = what if frozen is None else f"{whom} frozen for {frozen:g} s"
                    zero = 1000 * np.array([trial.zero for trial in trials])
                    standing = 1000 * max(trial.standing for trial in trials)
                    ended = [trial.again for trial in trials if trial.again is not None]
                    again = f"{sum(ended)} of {len(ended)}" if ended else ""
                    most = FROZEN_DETECTOR if (whom, frozen is None) == ("detector", False) else LIMIT
                    fine = zero.max() <= 1000 * most
                    bad += not fine
                    row = f"{speed:g} | {np.median(zero):.0f} | {zero.max():.0f} | {standing:.0f} | {again}"
                    print(f"| {what} | {row} | {'' if fine else 'TOO LATE'} |", flush=True)
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
