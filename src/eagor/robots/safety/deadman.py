"""The dead-man switch: the robot moves only while somebody holds it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal

from eagor.errors import DeviceError

__all__ = ["DEADMEN", "Deadman", "HeldKey", "Keys", "Terminal", "checked_deadman"]

Deadman = Literal["key", "remote", "none"]
DEADMEN: dict[str, str] = {
    "key": "hold the space bar in this terminal; x stops for good, r releases that",
    "remote": "hold L1 on the robot's remote control; B stops for good, start releases that",
    "none": "nobody holds anything: only for a simulated robot",
}
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
