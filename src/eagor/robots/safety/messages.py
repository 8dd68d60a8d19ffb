"""What a program and the guard's process tell each other, in lines that a torn write cannot confuse; and the switch.

The process is told its `GuardSettings` when it starts, and then again and again all that the program knows
(`inputs_from`). It answers with a `GuardState` after every step of the gate. A line is a checksum, then JSON. One that
is cut, joined with another or damaged fails its checksum and is dropped; the next line break starts anew.

The robot moves only while somebody holds the dead-man switch.
"""

from __future__ import annotations

import json
import math
import os
import select
import sys
import time
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from eagor.errors import DeviceError
from eagor.robots.safety.gate import Mode, Output
from eagor.robots.safety.limits import Body, Inputs, Limits, Velocity, stamp_of

__all__ = [
    "DEADMEN", "LONGEST", "REASONS", "WORDS", "Deadman", "GateClient", "GuardSettings", "GuardState", "HeldKey", "Keys",
    "LineReader", "Terminal", "as_line", "checked_deadman", "cut", "inputs_from", "read_now", "write_now",
]  # fmt: skip

LONGEST = select.PIPE_BUF  # bytes: a pipe takes so many as a whole, or not at all (POSIX)
REASONS, WORDS = 5, 150  # faults, and as many remarks, that are passed on; bytes of each
_CHUNK = 65536

Deadman = Literal["key", "remote", "none"]
DEADMEN: dict[str, str] = {
    "key": "hold the space bar in this terminal; x stops for good, r releases that",
    "remote": "hold L1 on the robot's remote control; B stops for good, start releases that",
    "none": "nobody holds anything: only for a simulated robot",
}


@dataclass(frozen=True)
class GuardSettings:
    """What the process is told when it starts: as for `eagor.robots.safety.guard.Guard`."""

    armed: bool = False
    deadman: Deadman = "none"
    domain: int = 0
    interface: str | None = None
    avoid: bool = False
    patience: float = 10.0  # seconds for the robot to be heard at first
    limits: Limits = field(default_factory=Limits)

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> GuardSettings:
        known = json.loads(text)
        limits = known.pop("limits")
        return cls(**known, limits=Limits(**(limits | {"calm_codes": tuple(limits["calm_codes"])})))


def inputs_from(said: dict[str, Any]) -> Inputs:
    """The program's share of the inputs. What has another type than it should counts as not a number."""
    try:
        wanted = None if said.get("wanted") is None else Velocity(*map(float, said["wanted"]))
        stated = tuple(str(text) for text in said.get("stated", ()))
        command, image, pose, belief, presence, heartbeat = (
            None if said.get(name) is None else float(said[name])
            for name in ("command", "image", "pose", "belief", "presence", "heartbeat")
        )
    except (TypeError, ValueError):
        return Inputs(stated=("what the program that steers says cannot be read",))
    return Inputs(
        wanted, command, image, pose, belief, presence, heartbeat,
        stated=stated, emergency=bool(said.get("emergency", False)),
    )  # fmt: skip


@dataclass(frozen=True)
class GuardState:
    """What the guard did at its last step.

    `time`: ``time.monotonic()``. `sent`: the velocity that was sent, if one was; `would`: the velocity that would have
    been sent if the guard were armed; `stops`: StopMove sent so far. `faults`: name and words of each fault; `remarks`:
    other reasons why the robot does not do what is wanted. `roll`, `pitch` (radians), `speed` (m/s), `turn` (rad/s): of
    the robot, as it says itself; NaN before its first state. `posture`: its mode (`eagor.robots.go2.state.MODES`).
    """

    time: float
    mode: Mode
    sent: Velocity | None = None
    would: Velocity | None = None
    stops: int = 0
    faults: tuple[tuple[str, str], ...] = ()
    remarks: tuple[str, ...] = ()
    roll: float = math.nan
    pitch: float = math.nan
    speed: float = math.nan
    turn: float = math.nan
    posture: int | None = None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the robot does not do what is wanted, in words."""
        return tuple(words for _, words in self.faults) + self.remarks

    @classmethod
    def of(
        cls,
        now: float,
        output: Output,
        body: Body | None,
        *,
        stops: int,
        posture: int | None = None,
        problem: str | None = None,
    ) -> GuardState:
        """After a step of the gate at `now`; `body`: the robot's state then; `problem`: of the last command."""
        seen = {} if body is None else {name: getattr(body, name) for name in ("roll", "pitch", "speed", "turn")}
        return cls(
            now, output.mode, output.send if isinstance(output.send, Velocity) else None,
            output.would if isinstance(output.would, Velocity) else None, stops,
            tuple((fault.name, fault.words) for fault in output.faults),
            output.remarks + ((problem,) if problem else ()), posture=posture, **seen,
        )  # fmt: skip

    def as_message(self) -> dict[str, Any]:
        """For a line: with the first reasons, shortened."""
        return vars(self) | {
            "sent": self.sent and self.sent.parts,
            "would": self.would and self.would.parts,
            "faults": [(name, cut(words, WORDS)) for name, words in self.faults[:REASONS]],
            "remarks": [cut(words, WORDS) for words in self.remarks[:REASONS]],
        }

    @classmethod
    def from_message(cls, message: dict[str, Any]) -> GuardState:
        sent, would = (None if (v := message[name]) is None else Velocity(*v) for name in ("sent", "would"))
        values: dict[str, Any] = message | {
            "mode": Mode(message["mode"]),
            "sent": sent,
            "would": would,
            "faults": tuple((name, words) for name, words in message["faults"]),
            "remarks": tuple(message["remarks"]),
        }
        return cls(**values)


class GateClient(ABC):
    """What a program tells the gate that moves its robot, however that gets there."""

    @property
    @abstractmethod
    def state(self) -> GuardState:
        """What the gate did at its last step."""

    @abstractmethod
    def _say(self, **news: Any) -> None:
        """Let the gate know these news (`inputs_from`), beside all that it was told before."""

    def command(self, forward: float, left: float, turn: float) -> None:
        """The wanted velocity from now on, for `Limits.command_age` seconds: m/s, m/s, rad/s (left is positive)."""
        self._say(wanted=(forward, left, turn), command=time.monotonic())

    def status(
        self,
        *,
        image_age: float | None,
        pose_age: float | None,
        belief_age: float | None,
        presence: float | None,
        faults: Sequence[str] = (),
    ) -> None:
        """What the program knows now; ages in seconds since capture, None or infinite: nothing came yet.

        `faults`: what is wrong, in words; the robot stands while there are any.
        """
        now = time.monotonic()
        self._say(
            image=stamp_of(now, image_age), pose=stamp_of(now, pose_age), belief=stamp_of(now, belief_age),
            presence=presence, stated=tuple(faults), heartbeat=now,
        )  # fmt: skip

    def pose(self, age: float) -> None:
        """A pose that was true `age` seconds ago has come; between two calls of `status`."""
        self._say(pose=stamp_of(time.monotonic(), age))


def as_line(message: dict[str, Any]) -> bytes:
    """A message as a line. Not-a-number and infinity pass. Raises `ValueError` if it is longer than `LONGEST`."""
    text = json.dumps(message, ensure_ascii=False, separators=(",", ":")).encode(errors="replace")
    line = b"%08x " % zlib.crc32(text) + text + b"\n"
    if len(line) > LONGEST:
        raise ValueError(f"a message of {len(line)} bytes; a pipe takes {LONGEST} at once")
    return line


def cut(text: str, most: int) -> str:
    """The beginning of a text, in at most `most` bytes of UTF-8 (twice that in JSON), printable."""
    printable = "".join(character if character.isprintable() else " " for character in text[:most])
    return printable.encode(errors="replace")[:most].decode(errors="ignore")


class LineReader:
    """Takes bytes as they come, and gives whole messages. `damaged`: lines that were dropped."""

    def __init__(self) -> None:
        self.damaged = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """The messages that these bytes complete."""
        *lines, rest = (self._rest + data).split(b"\n")
        if len(rest) > LONGEST:  # no line is so long
            rest = rest[-1:]
            self.damaged += 1
        self._rest = rest
        found = (_message(line) for line in lines if line)
        messages = []
        for message in found:
            if message is None:
                self.damaged += 1
            else:
                messages.append(message)
        return messages


def _message(line: bytes) -> dict[str, Any] | None:
    sum_, _, text = line.partition(b" ")
    if b"%08x" % zlib.crc32(text) != sum_:
        return None
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def read_now(fd: int) -> bytes | None:
    """What has come on a non-blocking pipe; None if the other end is closed."""
    found = b""
    while True:
        try:
            data = os.read(fd, _CHUNK)
        except BlockingIOError:
            return found
        if not data:
            return found or None
        found += data


def write_now(fd: int, line: bytes) -> bool:
    """Write a line as a whole to a non-blocking pipe; False if there is no room. Raises `BrokenPipeError`."""
    try:
        return os.write(fd, line) == len(line)
    except BlockingIOError:
        return False


# --- the dead-man switch ----------------------------------------------------------------------------------------------

# A terminal tells of a held key by repeating it: after 0.25 to 0.7 s the first time, then 10 to 35 times a second.
REPEAT = 0.2  # seconds: a key that does not come again within this time is released
HOLD, EMERGENCY, RELEASE = b" ", b"xX", b"rR"


class HeldKey:
    """Whether a key is held, from the times at which a terminal says it. Held counts from the first repeat on."""

    def __init__(self, repeat: float = REPEAT) -> None:
        self.repeat = repeat
        self._last: float | None = None
        self._repeats = False

    def press(self, now: float) -> None:
        """The key came once, at `now` (seconds)."""
        self._repeats = self._last is not None and now - self._last <= self.repeat
        self._last = now

    def held(self, now: float) -> bool:
        return self._repeats and self._last is not None and now - self._last <= self.repeat


class Keys:
    """The keys of the terminal of this process, as they come; a context manager. Ctrl-C still interrupts.

    Raises `DeviceError` if there is no terminal.
    """

    def __init__(self) -> None:
        try:
            self._fd = os.open("/dev/tty", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            raise DeviceError(
                f"there is no terminal to hold a key in ({error.strerror}): take --deadman remote, or start it from one"
            ) from error
        self._before: list[Any] | None = None

    def __enter__(self) -> Keys:
        import termios
        import tty

        self._before = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)
        return self

    def __exit__(self, *_: object) -> None:
        import termios

        if self._before is not None:
            with suppress(termios.error, OSError):
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
        os.close(self._fd)

    def read(self) -> bytes:
        """The keys since the last call."""
        with suppress(BlockingIOError, OSError):
            return os.read(self._fd, 1024)
        return b""


class Terminal:
    """How the terminal was set, to set it so again where the process that reads keys was killed."""

    def __init__(self) -> None:
        self._before: list[Any] | None = None
        with self._open() as fd:
            if fd is not None:
                import termios

                self._before = termios.tcgetattr(fd)

    def restore(self) -> None:
        """Set it as it was."""
        with self._open() as fd:
            if fd is not None and self._before is not None:
                import termios

                with suppress(termios.error):
                    termios.tcsetattr(fd, termios.TCSANOW, self._before)

    @contextmanager
    def _open(self) -> Iterator[int | None]:
        """The terminal; None if there is none, which the process that reads keys says."""
        try:
            fd = os.open("/dev/tty", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError:
            yield None
            return
        try:
            yield fd
        finally:
            os.close(fd)


def checked_deadman(deadman: str, armed: bool, interface: str | None) -> Deadman:
    """`deadman`, if it can be had here. Raises `DeviceError` otherwise."""
    if deadman not in DEADMEN:
        raise DeviceError(f"dead-man switch {deadman!r}; wanted one of {', '.join(DEADMEN)}")
    if armed and deadman == "none" and interface != "lo":
        raise DeviceError(
            f"no dead-man switch, but {interface or 'an automatic interface'} may lead to a real robot: take key or "
            "remote (none is for a simulated robot on the interface lo)"
        )
    if armed and deadman == "key" and not sys.platform.startswith(("linux", "darwin")):
        raise DeviceError("keys cannot be held in a terminal of this system: take --deadman remote")
    return deadman  # type: ignore[return-value]
