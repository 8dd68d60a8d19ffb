"""The guard: what a program uses to move a robot safely. The gate runs in a process of its own behind it.

That process (`main`) alone sends velocities. It reads the robot's state itself, and ends by StopMove when it is
interrupted, when its parent ends however that happens, and on errors of its own. Over a pipe the program says all that
it knows, and the process answers each word: so none waits for one that is frozen, and each notices when the other is.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from eagor.errors import DeviceError, EagorError
from eagor.odometry.clocks import LatencyFilter
from eagor.robots.dds import Participant
from eagor.robots.go2.sport import ALLOWED, OK, AvoidClient, SportClient, hear_commands, in_words
from eagor.robots.go2.state import MODES, BodyState, Go2Low, Go2State
from eagor.robots.safety.gate import PERIOD, SILENCE, Gate, GateStatus, Mode, State, Stop
from eagor.robots.safety.limits import Inputs, Limits, RobotState, Velocity

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Guard", "main"]

STARTING = 60.0  # seconds beyond its patience for the process to start, on a busy machine
ENDING = 6.0  # seconds for it to end: it stops the robot first
HANGS = 2.0  # seconds without a word from it after which it is given up
STANDING_IN = 3.0  # seconds for which StopMove is sent to a robot that acknowledges none
PATIENCE = 0.1  # seconds until a StopMove counts as not acknowledged; others follow at once, or are on their way
AT_ONCE = 4  # StopMove that may wait for their answers
READY = 5.0  # seconds that commands before the first move may take
FOREIGN = 2.0  # seconds for which the robot stands after a command of somebody else
HELD, EMERGENCY, RELEASE, UNHEARD = "L1", "B", "start", 0.2  # of the remote control; seconds for which it counts

# The modes (`MODES`) in which a Go2 stands on its feet or walks, and heeds Move: idle (its default stand), standing,
# walking. In all others it lies, sits, is limp, gets up, poses, or has its joints locked; 9 and those that Unitree
# documents as jumps and flips (11 to 13) are no ground to walk from.
LOCKED, ABLE = 6, (0, 1, 3)


@dataclass(kw_only=True, eq=False)
class Guard:
    """The only way from a program to a Go2's legs; a context manager, which stops the robot when it is left.

    - `armed`: False is a dry run: the guard says what it would do, and never commands.
    - `remote`: the robot moves only while somebody holds L1 of its remote control; B stops for good, start releases
      that. False is for a simulated robot on the interface "lo".
    - `limits`, `ignored_codes`: of the `Gate`; `domain`, `interface`: of DDS; `avoid`: the robot walks around obstacles
      by itself; `patience`: seconds for the robot to be heard at first.

    Call `set_velocity` and `report` again and again: the robot stands as soon as they are older than the limits. If the
    process ends, or says nothing for `SILENCE`, a thread of the program sends StopMove itself. If both are gone or
    frozen, nobody sends anything; a Go2 then walks on until its last Move expires, which takes 1 to 2 s.
    Raises `DeviceError` if there is no robot or no switch.
    """

    armed: bool = False
    remote: bool = True
    limits: Limits = field(default_factory=Limits)
    domain: int = 0
    interface: str | None = None
    avoid: bool = False
    ignored_codes: tuple[int, ...] = (0,)
    patience: float = 10.0

    def __post_init__(self) -> None:
        if self.armed and not self.remote and self.interface != "lo":
            raise DeviceError(
                f"without a dead-man switch, but {self.interface or 'an automatic interface'} may lead to a real "
                "robot: somebody has to hold L1 of its remote control (a simulated robot is on the interface lo)"
            )
        self._settings = dict(vars(self))
        self._said = Inputs()  # all that this program knows now: every message says all of it, so that none is missed
        self._turn, self._leaving = threading.Lock(), threading.Event()
        self._link: Participant | None = None  # a dry run has no voice, not even for StopMove
        self._stood_in = False  # whether the robot acknowledged a StopMove of this program
        self._state: GateStatus | None = None
        self._error: EagorError | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            if self.armed:
                self._link = stack.enter_context(Participant(self.domain, self.interface))
                self._voice = Voice(self._link, self.avoid)
            self._line, there = Pipe()
            # Imported by its name, so that what is sent has the same types on both sides.
            code = f"from eagor.robots.safety.guard import main; main({there.fileno()})"
            command = [sys.executable, "-c", code]
            self._process = subprocess.Popen(command, pass_fds=[there.fileno()], stdin=subprocess.DEVNULL)
            self.pid = self._process.pid
            there.close()
            stack.callback(self._end)
            with suppress(OSError, EOFError):
                self._line.send(self._settings)
                self._line.send(self._said)
                if self._line.poll(self.patience + STARTING):
                    self._take(self._line.recv())
            if self._state is None:
                raise self._error or DeviceError("the guard's process ended before its first step; its words are above")
            if self._link is not None and not self._voice.sport.wait(self.patience):
                raise DeviceError("the robot does not listen to this program, which sends StopMove if the guard ends")
            thread = threading.Thread(target=self._listen, name="guard", daemon=True)
            thread.start()
            stack.callback(thread.join)
            stack.callback(self._leaving.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the robot and end the process."""
        self._stack.close()

    def _end(self) -> None:
        self._line.close()  # which tells the process to end
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDING)
        self._process.kill()
        self._process.wait()
        if self._stood_in and self._voice.avoid:  # whoever turned that on may be gone
            self._voice.avoid.end()

    @property
    def state(self) -> GateStatus:
        """What the gate did at its last step; while it says nothing, what this process does instead.

        Raises `DeviceError` if it has ended, or hangs.
        """
        if self._state is None or self._error is not None:
            raise self._error or DeviceError("the guard is not there yet: use it in a with statement")
        return self._state

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """The wanted velocity from now on, for `Limits.command_age` seconds: m/s, m/s, rad/s (left is positive)."""
        self._say(wanted=Velocity(float(forward), float(left), float(turn)), command=time.monotonic())

    def report(
        self, *, image_age: float | None, pose_age: float | None, look_age: float | None, presence: float | None,
        faults: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        """What the program knows now; ages in seconds since capture, None or infinite: nothing came yet.

        `faults`: what is wrong, in words; the robot stands while there are any.
        """
        self._say(
            image=_stamp_of(image_age), pose=_stamp_of(pose_age), look=_stamp_of(look_age),
            presence=None if presence is None else float(presence), stated=tuple(map(str, faults)),
        )  # fmt: skip

    def pose(self, age: float) -> None:
        """A pose that was true `age` seconds ago has come; between two calls of `report`."""
        self._say(pose=_stamp_of(age))

    def _say(self, **news: Any) -> None:
        """Let the thread tell this at once, beside all that was said before."""
        with self._turn:
            self._said = replace(self._said, **news)

    def _listen(self) -> None:
        """Tell the process what is known, and hear what it does, in a thread; stop the robot when it is silent."""
        with suppress(OSError, EOFError):
            while not self._leaving.is_set():
                self._line.send(self._said)
                asked = time.monotonic()
                while not self._line.poll(SILENCE):
                    if self._leaving.is_set():
                        return
                    silent = time.monotonic() - asked
                    words = self._stand_in(f"the guard has not said a word for {silent:.1f} s")
                    if silent > HANGS:
                        self._error = DeviceError(f"{words}. This machine may be too busy. Start the program again")
                self._take(self._line.recv())
        if not self._leaving.is_set():
            words = self._stand_in("the guard has ended", STANDING_IN)
            self._error = self._error or DeviceError(f"{words}. Start the program again")

    def _stand_in(self, why: str, seconds: float = 0.0) -> str:
        """Stop the robot in the place of the process; what to say of it."""
        assert self._state is not None
        mode, words = Mode.DRY_RUN, f"{why}; a dry run commands nothing"
        if self._link is not None:
            self._state = GateStatus(None, Mode.STOPPING, (why,), stops=self._state.stops)
            self._stood_in = self._voice.stop(seconds)
            heard = "and the robot acknowledged it", "not acknowledged yet: Move expires after 1 to 2 s"
            mode, words = Mode.STOPPING, f"{why}; this program sent StopMove itself, {heard[not self._stood_in]}"
        self._state = GateStatus(None, mode, (words,), stops=self._state.stops)
        return words

    def _take(self, heard: GateStatus | EagorError) -> None:
        if isinstance(heard, EagorError):  # its last word
            self._error = heard
            raise EOFError
        self._state, self._error = heard, None


def _stamp_of(age: float | None) -> float | None:
    """The stamp of what is `age` seconds old; None if nothing came yet."""
    return None if age is None or age == math.inf else time.monotonic() - float(age)


class Voice:
    """What is said to a Go2 on `link`, without ever waiting long. `avoid`: it walks around obstacles by itself."""

    def __init__(self, link: Participant, avoid: bool) -> None:
        self.sport = SportClient(link, timeout=PATIENCE)
        self.avoid = AvoidClient(link, timeout=READY) if avoid else None

    def stop(self, seconds: float = 0.0) -> bool:
        """Send StopMove, for so long until the robot acknowledges one within `PATIENCE`; whether it did."""
        end = time.monotonic() + seconds
        while True:
            if self.avoid is not None:
                self.avoid.stop()
            if (done := self.sport.stop() == OK) or time.monotonic() >= end:
                return done


# --- in the process ---------------------------------------------------------------------------------------------------


class GateProcess:
    """One step after another: what the parent says and the robot's state go into the gate, its output to the robot.

    One that is not armed never has a writer, so it cannot command anything. `settings`: the fields of `Guard`.
    """

    def __init__(self, line: Connection, settings: dict[str, Any]) -> None:
        self._line, self._patience, avoid = line, settings["patience"], settings["avoid"]
        self._gate = Gate(settings["limits"], settings["armed"], settings["ignored_codes"])
        self.ending: str | None = None  # why it ends
        self._state, self._said = State(), Inputs()
        self._acknowledged = 0
        self._robot: RobotState | None = None
        self._mode: int | None = None
        self._lateness = LatencyFilter()
        self._link = link = Participant(settings["domain"], settings["interface"])
        self._other = -math.inf, ""  # when somebody else commanded it, and what
        # A robot that avoids obstacles may command its own walking.
        hear_commands(link, self._commanded, ["obstacles_avoid"] if avoid else ALLOWED)
        self._states = Go2State(link, received=self._received)
        self._low = Go2Low(link) if settings["remote"] else None
        self._voice = Voice(link, avoid) if self._gate.armed else None
        self._stoppers = ThreadPoolExecutor(AT_ONCE, "StopMove")

    def run(self) -> None:
        """Step after step, until the robot stands after the end."""
        try:
            self._start()
            end = math.inf
            while not (self.ending and self._state.latched and self._state.mode is Mode.STANDING):
                asked = self.ending is None and self._hear()
                now = time.monotonic()
                end = min(end, now + STANDING_IN) if self.ending else end
                if now > end:
                    return
                self._state, status = self._gate.step(self._state, now, self._inputs())
                if isinstance(status.send, Stop):
                    self._stoppers.submit(self._stop, status.send.number)
                elif status.send is not None and self._voice is not None:
                    (self._voice.avoid or self._voice.sport).move(*status.send)
                if asked:
                    with suppress(OSError):  # nobody listens; the robot matters more
                        self._line.send(status)
                time.sleep(max(0.0, now + PERIOD - time.monotonic()))
        except BaseException:  # the gate itself cannot be trusted any more
            if self._voice is not None and self._state.time is not None:
                self._voice.stop(STANDING_IN)
            raise
        finally:
            self._stoppers.shutdown(cancel_futures=True)
            if self._voice is not None and self._voice.avoid is not None:
                self._voice.avoid.end()
            self._link.close()

    def _start(self) -> None:
        """Wait for the robot, and make it ready to walk if it may. Raises `DeviceError`."""
        self._states.wait(self._patience)
        if (voice := self._voice) is None:
            return
        if not voice.sport.wait(self._patience):
            raise DeviceError(
                "the robot tells its state, but nobody takes commands (rt/api/sport/request): its walking service is "
                "off, or another program holds it; switch to sport mode in the robot's app"
            )
        told = {}
        if self._mode == LOCKED:
            told["BalanceStand"] = SportClient(self._link, timeout=READY).balance_stand()
        if voice.avoid is not None:
            told["obstacle avoidance"] = voice.avoid.start()
        for what, code in told.items():
            if code != OK:
                raise DeviceError(f"{what}: {in_words(code)}; look at the robot, then try again")

    def _hear(self) -> bool:
        """Whether the parent has a word; notices its end."""
        heard = False
        try:
            while self._line.poll():
                self._said, heard = self._line.recv(), True
        except (EOFError, OSError):
            self.ending = "the program that steers has ended"
        return heard

    def _stop(self, number: int) -> None:
        if self._voice is not None and self._voice.stop():
            self._acknowledged = max(self._acknowledged, number)

    def _inputs(self) -> Inputs:
        """What the parent said, and what this process knows of the robot and of its remote control."""
        low = None if self._low is None else self._low.newest
        pressed = frozenset() if low is None or abs(time.time() - low.received) > UNHEARD else low.pressed
        return replace(
            self._said, stated=(*self._said.stated, *self._faults()), robot=self._robot,
            deadman=None if self._low is None else HELD in pressed, acknowledged=self._acknowledged,
            emergency=EMERGENCY in pressed or self.ending is not None, reset=RELEASE in pressed,
        )  # fmt: skip

    def _faults(self) -> Iterator[str]:
        """What is wrong beside what the gate finds itself, in words."""
        yield from filter(None, (self._states.fault, self.ending))
        if self._mode is not None and self._mode not in ABLE:
            words = MODES.get(self._mode, f"in mode {self._mode}")
            yield f"the robot cannot walk: it is {words}; let it stand first"
        when, words = self._other
        if (ago := time.monotonic() - when) < FOREIGN:
            yield f"somebody else commands the robot ({words}, {ago:.1f} s ago): end that program or app"

    def _commanded(self, words: str) -> None:
        self._other = time.monotonic(), words

    def _received(self, state: BodyState) -> None:
        """A state of the robot, in a thread."""
        now, up = time.monotonic(), state.world_R_body[2]
        self._mode = state.mode
        stamp = now - self._lateness.of(state.robot_stamp, now)
        roll, pitch = math.atan2(up[1], up[2]), math.asin(min(max(-up[0], -1.0), 1.0))  # REP-103: the nose down is +
        self._robot = RobotState(stamp, roll, pitch, state.speed, state.yaw_rate, state.error_code)


def main(handle: int) -> None:
    """The life of the process, until the parent ends; `handle`: of the pipe."""
    line, process = Connection(handle), None

    def interrupted(number: int, _: Any) -> None:
        if process is None:
            sys.exit(1)
        process.ending = f"the guard was interrupted ({signal.Signals(number).name})"

    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, interrupted)
    try:
        process = GateProcess(line, line.recv())
        process.run()
    except EagorError as error:
        with suppress(OSError):
            line.send(error)
        sys.exit(2)
