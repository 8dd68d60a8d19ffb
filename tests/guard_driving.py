"""Driving a robot through the guard, and the faults that must stop it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.sport import OK, SportClient
from eagor.robots.safety.guard import Guard

RATE = 20.0  # messages per second, as the live loop gives answers


@dataclass
class Driver:
    """A program that steers, in a thread; a context manager. `wrong`: what it says instead of what is good."""

    guard: Guard
    velocity: tuple[float, float, float] = (0.5, 0.0, 0.4)
    wrong: dict[str, Any] = field(default_factory=dict)
    silent: bool = False  # a program that hangs
    mumbles: bool = False  # a status, but no command

    def __enter__(self):
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def say(self, now: float) -> None:
        """One message."""
        known = {"image_age": 0.15, "pose_age": 0.01, "belief_age": 0.5, "presence": 0.9, "faults": ()} | self.wrong
        velocity = known.pop("velocity", self.velocity)
        if not self.mumbles:
            self.guard.command(*velocity)
        self.guard.status(**known)

    def _run(self):
        while not self._ended.wait(1 / RATE):
            if not self.silent:
                with suppress(DeviceError):
                    self.say(time.monotonic())


@dataclass(frozen=True)
class Trial:
    """A fault: `begin(driver, robot)` makes it, `end` takes it away; `detection`: seconds until it can be noticed.

    `begin` may give the time (monotonic) at which the fault began, if that is later than the call.
    """

    begin: Callable[[Driver, Any], Any]
    end: Callable[[Driver, Any], Any]
    detection: float = 0.0


def says(**wrong: Any) -> Trial:
    """The program says something else than it should."""
    return Trial(
        lambda driver, robot: setattr(driver, "wrong", wrong), lambda driver, robot: setattr(driver, "wrong", {})
    )


def is_so(whose: str, name: str, value: Any, normal: Any, detection: float = 0.0) -> Trial:
    """A field of the driver or of the robot has another value."""

    def put(value: Any) -> Callable[[Driver, Any], Any]:
        return lambda driver, robot: setattr(driver if whose == "driver" else robot, name, value)

    return Trial(put(value), put(normal), detection)


class Other:
    """Somebody else who commands the robot, once."""

    def begin(self, _: Driver, robot: Any) -> float:
        self._link = Link(robot.domain, "lo")
        client = SportClient(self._link, timeout=20.0)
        assert client.wait(20)
        time.sleep(1.0)  # until the guard has found it as well
        begun = time.monotonic()
        assert client.move(0.2, 0.0, 0.0) == OK
        return begun

    def end(self, _: Driver, __: Any) -> None:
        self._link.close()


OTHER = Other()

# What can go wrong while the guard itself lives. The seconds are those of `Limits`, after which it is a fault.
TRIALS = {
    "stale command": is_so("driver", "mumbles", True, False),
    "stale image": says(image_age=1.01),
    "no image": says(image_age=None),
    "stale pose": says(pose_age=0.26),
    "stale belief (perception hangs)": says(belief_age=3.01),
    "presence too low": says(presence=0.3),
    "NaN wanted": says(velocity=(math.nan, 0.0, 0.0)),
    "NaN presence": says(presence=math.nan),
    "NaN age": says(pose_age=math.nan),
    "program hangs": is_so("driver", "silent", True, False, detection=0.25),
    "program states a fault": says(faults=("the camera is unplugged",)),
    "tilt": is_so("robot", "roll", 0.6, 0.0),
    "error code": is_so("robot", "error_code", 7, 0),
    "robot falls silent": is_so("robot", "mute", True, False, detection=0.1),
    "robot's states come later and later": is_so("robot", "growing", 1.0, 0.0, detection=0.1),
    "somebody else commands": Trial(OTHER.begin, OTHER.end),
    "emergency stop": Trial(lambda driver, _: driver.guard.emergency(), lambda driver, _: driver.guard.reset()),
    "stop": Trial(
        lambda driver, _: (setattr(driver, "mumbles", True), driver.guard.stop()),
        lambda driver, _: setattr(driver, "mumbles", False),
    ),
}
# What only the tests' own robot can do: lean, fall silent, be slow.
PEERS = ("tilt", "robot falls silent", "robot's states come later and later")


@dataclass(frozen=True)
class Time:
    """Seconds from the fault to the command being zero for good, and to the body standing."""

    zero: float
    standing: float


def until(what: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Wait until `what` is true; returns it."""
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)
    return found


def bring_to_speed(driver: Driver, robot: Any) -> None:
    """Wait until the robot goes as fast as the driver wants."""
    fast_enough(robot, driver.velocity)


def fast_enough(robot: Any, full: tuple[float, float, float]) -> None:
    """Wait until the robot is told this velocity, and has come near it."""
    until(lambda: robot.commanded(time.monotonic()) == full)
    until(lambda: math.hypot(*robot.speeds[-1][1][:2]) > 0.9 * 0.8 * full[0])


def begun_by(trial: Trial, driver: Driver, robot: Any) -> float:
    """Make the fault; when it began."""
    begun = time.monotonic()
    said = trial.begin(driver, robot)
    return said if isinstance(said, float) else begun


def measured(robot: Any, begun: float) -> Time:
    """How long it took from `begun` until nothing was commanded and the body stood."""
    while True:
        until(lambda: robot.zero_since(begun) is not None and robot.still_since(begun) is not None)
        time.sleep(0.15)  # and nothing comes after
        zero, still = robot.zero_since(begun), robot.still_since(begun)
        assert zero is not None
        if still is not None:  # else it stood only because it had not felt the last command yet: wait again
            return Time(zero - begun, still - begun)
