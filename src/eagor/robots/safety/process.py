"""The gate as a process of its own, which alone sends velocities: ``python -m eagor.robots.safety.process``.

`eagor.robots.safety.guard` starts it. It steps the gate on the monotonic clock, reads the robot's state itself, and
ends by StopMove when it is interrupted, when its parent ends however that happens, and on errors of its own.
"""

from __future__ import annotations

import signal
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from types import FrameType
from typing import TYPE_CHECKING, Any

from eagor.errors import EagorError
from eagor.robots.safety.deadman import EMERGENCY, HOLD, RELEASE, HeldKey, Keys
from eagor.robots.safety.gate import Gate, Mode, Output, State, Stop
from eagor.robots.safety.limits import Inputs
from eagor.robots.safety.messages import (
    GuardSettings,
    GuardState,
    LineReader,
    as_line,
    cut,
    inputs_from,
    read_now,
    write_now,
)

if TYPE_CHECKING:
    from eagor.robots.safety.body import Go2Body

__all__ = ["Watch", "main"]

ENDING = 3.0  # seconds that the last stop may take
REMOTE_HOLD, REMOTE_EMERGENCY, REMOTE_RELEASE = "L1", "B", "start"


class Watch:
    """One step after another: what the parent says and the robot's state go into the gate, its output to the robot."""

    def __init__(self, settings: GuardSettings, robot: Go2Body, keys: Keys | None = None) -> None:
        self.settings, self.robot, self._keys = settings, robot, keys
        self.gate, self.state = Gate(settings.limits, settings.armed, obeys=not settings.avoid), State()
        self.ending: str | None = None  # why it ends
        self._said: dict[str, Any] = {}
        self._held = HeldKey()
        self._resets = 0
        self._release = False

    def hear(self, message: dict[str, Any]) -> None:
        """A message of the parent: all that it knows now."""
        self._said = message

    def step(self, now: float) -> Output:
        """One step at `now`."""
        inputs = self._inputs(now)
        self.state, output = self.gate.step(self.state, now, inputs)
        if isinstance(output.send, Stop):
            self.robot.stop(output.send.number)
        elif output.send is not None:
            self.robot.move(output.send)
        return output

    @property
    def over(self) -> bool:
        """Whether the last stop has done its work: the robot stands."""
        return self.ending is not None and self.state.mode is Mode.STANDING and self.state.latched

    def _inputs(self, now: float) -> Inputs:
        deadman, emergency = self._deadman(now)
        inputs = inputs_from(self._said)
        resets = self._said.get("resets", 0)
        released, self._resets, self._release = self._release or resets > self._resets, resets, False
        return replace(
            inputs,
            gone=self.ending is not None,
            stated=inputs.stated + self.robot.faults(),
            body=self.robot.body,
            deadman=deadman,
            acknowledged=self.robot.acknowledged,
            emergency=inputs.emergency or emergency or self.ending is not None,
            reset=released,
        )

    def _deadman(self, now: float) -> tuple[bool | None, bool]:
        """Whether the switch is held (None: there is none), and whether somebody stops for good."""
        if self.settings.deadman == "remote":
            pressed = self.robot.pressed or frozenset()
            self._release |= REMOTE_RELEASE in pressed
            return REMOTE_HOLD in pressed, REMOTE_EMERGENCY in pressed
        emergency = False
        if self._keys is not None:
            for key in self._keys.read():
                if key in HOLD:
                    self._held.press(now)
                emergency |= key in EMERGENCY
                self._release |= key in RELEASE
        return (self._held.held(now) if self.settings.deadman == "key" else None), emergency

    def report(self, now: float, output: Output) -> dict[str, Any]:
        """What the parent is told about this step."""
        robot, stops = self.robot, self.state.stops if self.settings.armed else 0
        state = GuardState.of(now, output, robot.body, stops=stops, posture=robot.mode, problem=robot.problem)
        return state.as_message()


def main(arguments: list[str]) -> int:
    """Run until the parent ends; `arguments`: the settings as JSON, the pipes to read from and to write to."""
    settings, inlet, outlet = GuardSettings.from_json(arguments[0]), int(arguments[1]), int(arguments[2])
    told: list[int] = []

    def interrupted(number: int, _: FrameType | None) -> None:
        told.append(number)

    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, interrupted)
    try:
        with ExitStack() as stack:
            keys = stack.enter_context(Keys()) if settings.deadman == "key" else None
            from eagor.robots.safety.body import Go2Body

            robot = stack.enter_context(Go2Body(settings))
            robot.start(settings.patience)
            _watch(Watch(settings, robot, keys), inlet, outlet, told)
    except EagorError as error:
        _tell(outlet, {"error": cut(str(error), 1500), "kind": type(error).__name__})
        return 2
    return 0


def _watch(watch: Watch, inlet: int, outlet: int, told: list[int]) -> None:
    """Step after step, until the robot stands after the end."""
    reader, period = LineReader(), watch.settings.limits.period
    end = None
    try:
        due = time.monotonic()
        while not watch.over:
            data = None if watch.ending else read_now(inlet)
            if data is not None:
                for message in reader.feed(data):
                    watch.hear(message)
                    watch.ending = message.get("end") or watch.ending
            elif watch.ending is None:
                watch.ending = "the program that steers has ended"
            if told and watch.ending is None:
                watch.ending = f"it was interrupted ({signal.Signals(told[0]).name})"
            now = time.monotonic()
            if watch.ending is not None:
                end = end or now + ENDING
                if now > end:
                    return
            output = watch.step(now)
            _tell(outlet, watch.report(now, output))
            due = max(due + period, now)
            time.sleep(max(0.0, due - time.monotonic()))
    except BaseException:
        _stop_at_any_price(watch)
        raise


def _stop_at_any_price(watch: Watch) -> None:
    """StopMove until it is acknowledged; the gate itself cannot be trusted any more."""
    if not watch.settings.armed:
        return
    first, end = watch.state.stops + 1, time.monotonic() + ENDING
    for number in range(first, first + 1000):
        if (watch.robot.acknowledged or 0) >= first or time.monotonic() > end:
            return
        watch.robot.stop(number)
        time.sleep(watch.settings.limits.retry)


def _tell(outlet: int, message: dict[str, Any]) -> None:
    with suppress(BrokenPipeError, ValueError):  # nobody listens; the robot matters more
        write_now(outlet, as_line(message))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
