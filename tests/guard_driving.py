"""Driving a robot through the guard, and the faults that must stop it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from eagor.errors import DeviceError
from eagor.robots.dds import Participant
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

    def say(self) -> None:
        """One message."""
        known = {"image_age": 0.15, "pose_age": 0.01, "look_age": 0.5, "presence": 0.9, "faults": ()} | self.wrong
        velocity = known.pop("velocity", self.velocity)
        if not self.mumbles:
            self.guard.set_velocity(*velocity)
        self.guard.report(**known)

    def _run(self):
        while not self._ended.wait(1 / RATE):
            if not self.silent:
                with suppress(DeviceError):
                    self.say()


@contextmanager
def other_commander(domain: int) -> Iterator[float]:
    """Somebody else who commands the robot once, inside; when that was."""
    with Participant(domain, "lo") as link:
        client = SportClient(link, timeout=20.0)
        assert client.wait(20)
        time.sleep(1.0)  # until the guard has found it as well
        begun = time.monotonic()
        assert client.move(0.2, 0.0, 0.0) == OK
        yield begun


class Time(NamedTuple):
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


def fast_enough(robot: Any, full: tuple[float, float, float], seconds: float = 60.0) -> None:
    """Wait until the robot is told this velocity, and has come near it."""
    until(lambda: robot.commanded == full and math.hypot(*robot.speeds[-1][1][:2]) > 0.72 * full[0], seconds)


def measured(robot: Any, begun: float) -> Time:
    """How long it took from `begun` until nothing was commanded and the body stood."""

    def both() -> Time | None:
        zero, still = robot.zero_since(begun), robot.still_since(begun)
        return None if zero is None or still is None else Time(zero - begun, still - begun)

    until(both)
    time.sleep(0.15)  # and nothing comes after; or it stood only because it had not felt the last command yet
    return until(both)
