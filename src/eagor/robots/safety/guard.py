"""The guard: what a program uses to move a robot safely. The gate runs in a process of its own behind it.

That process, ``python -m eagor.robots.safety.guard``, alone sends velocities. It steps the gate on the monotonic clock,
reads the robot's state itself, and ends by StopMove when it is interrupted, when its parent ends however that happens,
and on errors of its own. What speaks to the robot (`eagor.robots.safety.body`) is imported when it is needed: a process
starts quickly, and one that only watches holds little.
"""

from __future__ import annotations

import itertools
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

from eagor import errors
from eagor.errors import DeviceError, EagorError
from eagor.robots.safety.gate import Gate, Mode, Output, State, Stop
from eagor.robots.safety.limits import Inputs, Limits
from eagor.robots.safety.messages import (
    EMERGENCY,
    HOLD,
    REASONS,
    RELEASE,
    WORDS,
    Deadman,
    GateClient,
    GuardSettings,
    GuardState,
    HeldKey,
    Keys,
    LineReader,
    Terminal,
    as_line,
    checked_deadman,
    cut,
    inputs_from,
    read_now,
    write_now,
)

if TYPE_CHECKING:
    from eagor.robots.safety.body import Go2Body, Standby

__all__ = ["Guard", "Watch", "main"]

STARTING = 60.0  # seconds beyond its patience for the process to start, on a busy machine
ENDING = 6.0  # seconds for it to end: it stops the robot first
HANGS = 2.0  # seconds without a word from it after which it is given up
STANDING_IN = 3.0  # seconds for which this process sends StopMove to a robot that acknowledges none


class Guard(GateClient):
    """The only way from a program to a Go2's legs; a context manager, which stops the robot when it is left.

    - `armed`: False is a dry run: the guard says what it would do, and never commands.
    - `deadman`: what somebody holds while the robot may move: "key" (the space bar of this terminal), "remote" (L1 of
      the robot's remote control), or "none", which only a simulated robot on the interface "lo" allows.
    - `limits`: see there. `domain`, `interface`: of DDS. `avoid`: the robot walks around obstacles by itself.
    - `watch(state)`: called after every step of the gate, 50 times a second, in a thread.

    Call `command` and `status` again and again: the robot stands as soon as they are older than the limits. A program
    that hangs, or is killed, leaves a robot that stands. The other way round a thread of the program watches the
    guard's process: if that ends, or says nothing for `Limits.silence`, the thread sends StopMove itself, over a
    connection that was opened beforehand (`eagor.robots.safety.body`). If both processes are gone or frozen, nobody
    sends anything any more; a Go2 then walks on until its last Move expires, which takes 1 to 2 s.

    Raises `DeviceError` if there is no robot or no switch.
    """

    def __init__(
        self,
        *,
        armed: bool = False,
        deadman: Deadman = "key",
        limits: Limits | None = None,
        domain: int = 0,
        interface: str | None = None,
        avoid: bool = False,
        patience: float = 10.0,
        watch: Callable[[GuardState], Any] | None = None,
    ) -> None:
        self.armed, self.limits = armed, limits or Limits()
        deadman = checked_deadman(deadman, armed, interface)
        if not armed and deadman == "key" and not sys.stdin.isatty():
            deadman = "none"  # a dry run needs no switch
        self._settings = GuardSettings(armed, deadman, domain, interface, avoid, patience, self.limits)
        self._watch = watch
        # All that this program knows now: every message says all of it, so that none is missed.
        self._said: dict[str, Any] = {}
        self._resets = itertools.count(1)
        self._turn = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._out = -1
        self._state: GuardState | None = None
        self._error: EagorError | None = None
        self._heard = threading.Event()
        self._standby: Standby | None = None

    def __enter__(self) -> Self:
        if self.armed:  # a dry run has no voice, not even for StopMove
            from eagor.robots.safety.body import Standby

            settings = self._settings
            self._standby = Standby(settings.domain, settings.interface, avoid=settings.avoid)
        self._terminal = Terminal() if self._settings.deadman == "key" else None
        inlet, self._out = os.pipe()
        there, outlet = os.pipe()
        os.set_blocking(inlet, False)
        os.set_blocking(self._out, False)
        os.set_blocking(outlet, False)
        command = [sys.executable, "-m", "eagor.robots.safety.guard", self._settings.to_json()]
        try:
            self._process = subprocess.Popen(
                [*command, str(inlet), str(outlet)], pass_fds=(inlet, outlet), stdin=subprocess.DEVNULL
            )
        finally:
            os.close(inlet)
            os.close(outlet)
        self._thread = threading.Thread(target=self._listen, args=(there,), name="guard", daemon=True)
        self._thread.start()
        self._heard.wait(self._settings.patience + STARTING)
        if self._state is None:
            code = self._process.poll()
            code = "it does not answer" if code is None else f"exit code {code}"
            self.close()
            raise self._error or DeviceError(
                f"the guard's process ended before its first step ({code}); its words, if any, are above"
            )
        if self._standby is not None:
            try:
                self._standby.wait(self._settings.patience)
            except DeviceError:
                self.close()
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def state(self) -> GuardState:
        """What the guard did at its last step; while it says nothing, that and what this process does instead.

        Raises `DeviceError` if it has ended, or hangs.
        """
        if self._state is None or self._process is None or self._process.poll() is not None:
            raise self._end()
        if (silent := time.monotonic() - self._state.time) <= self.limits.silence:
            return self._state
        words = f"the guard has not said a word for {silent:.1f} s; {self._instead()}"
        if silent > HANGS:
            raise DeviceError(f"{words}. This machine may be too busy. Start the program again")
        mode = Mode.STOPPING if self.armed else self._state.mode
        return replace(self._state, mode=mode, sent=None, faults=(("guard", words),), remarks=())

    def _end(self) -> EagorError:
        """Why there is no guard any more, and what stops the robot."""
        if self._process is not None and threading.current_thread() is not self._thread:
            self._thread.join(STANDING_IN)
        return self._error or DeviceError(f"the guard has ended; {self._instead()}. Start the program again")

    def _instead(self) -> str:
        """What stops the robot while the guard does not, in words."""
        if (standby := self._standby) is None:
            return "it was a dry run, which commanded nothing"
        if standby.acknowledged:
            return "this program sent StopMove itself, and the robot acknowledged it"
        return (
            f"this program sent StopMove itself {standby.sent} times, and the robot acknowledged none: if none came, "
            "it walks on until its last Move expires, 1 to 2 s after it was sent"
        )

    @property
    def pid(self) -> int:
        """The number of the guard's process."""
        assert self._process is not None
        return self._process.pid

    def stop(self) -> None:
        """Stand, until the next `command`."""
        self._say(wanted=None, command=None)

    def emergency(self) -> None:
        """The emergency stop: nothing but `reset` leads out."""
        self._say(emergency=True)

    def reset(self) -> None:
        """Release the emergency stop. The robot moves again after `Limits.settle` seconds, if it is commanded."""
        self._say(emergency=False, resets=next(self._resets))

    def close(self) -> None:
        """Stop the robot and end the process. May be called twice."""
        process, self._process = self._process, None
        if process is None:
            self._let_go()
            return
        with suppress(BrokenPipeError):
            write_now(self._out, as_line({"end": "the program ends"}))
        os.close(self._out)  # the end of the pipe says it too
        try:
            process.wait(ENDING)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._thread.join(STANDING_IN)
        self._let_go()
        if self._terminal is not None:
            self._terminal.restore()

    def _let_go(self) -> None:
        standby, self._standby = self._standby, None
        if standby is not None:
            with standby:
                pass

    def _say(self, **news: Any) -> None:
        """Write all that is known, with these news. A guard that does not read hangs, which the thread notices."""
        with self._turn:
            if self._process is None:
                raise DeviceError("the guard is not running: use it in a with statement")
            self._said |= news
            try:
                stated = [cut(text, WORDS) for text in self._said.get("stated", ())[:REASONS]]
                write_now(self._out, as_line(self._said | {"stated": stated, "heartbeat": time.monotonic()}))
            except BrokenPipeError:
                raise self._end() from None

    def _listen(self, there: int) -> None:
        """Take what the process says, in a thread, until it ends; stop the robot while it says nothing."""
        reader, ended = LineReader(), False
        try:
            while not ended:
                if select.select([there], [], [], self._left())[0]:
                    data = os.read(there, 65536)
                    ended = not data
                    for message in reader.feed(data):
                        self._take(message)
                elif self._stand_in():
                    select.select([there], [], [])  # until it has a word again
        finally:
            os.close(there)
            self._heard.set()
            if self._state is not None and self._process is not None:  # it was not told to end
                end = time.monotonic() + STANDING_IN
                while not self._stand_in() and time.monotonic() < end:
                    pass

    def _left(self) -> float | None:
        """Seconds until the guard has been silent for too long; None before its first word.

        At least two steps of the gate: this process may have been away itself, and the pipe may hold old words.
        """
        if self._state is None:
            return None
        return max(2 * self.limits.period, self._state.time + self.limits.silence - time.monotonic())

    def _stand_in(self) -> bool:
        """Send StopMove in the guard's stead; whether the robot acknowledged it, or was never commanded."""
        return self._standby is None or self._standby.stop()

    def _take(self, message: dict[str, Any]) -> None:
        if "error" in message:
            self._error = getattr(errors, message["kind"], DeviceError)(message["error"])
            return
        self._state = GuardState.from_message(message)
        self._heard.set()
        if self._watch is not None:
            self._watch(self._state)


# --- in the process ---------------------------------------------------------------------------------------------------

LAST_STOP = 3.0  # seconds that the last stop may take
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
            inputs, gone=self.ending is not None, stated=inputs.stated + self.robot.faults(), body=self.robot.body,
            deadman=deadman, acknowledged=self.robot.acknowledged,
            emergency=inputs.emergency or emergency or self.ending is not None, reset=released,
        )  # fmt: skip

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
                end = end or now + LAST_STOP
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
    first, end = watch.state.stops + 1, time.monotonic() + LAST_STOP
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
