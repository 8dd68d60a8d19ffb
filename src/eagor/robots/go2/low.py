"""Battery and remote control of a Go2: ``rt/lf/lowstate`` (20 Hz) or ``rt/lowstate``."""

from __future__ import annotations

import struct
import threading
from dataclasses import dataclass

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.wire import LowFields, raw

__all__ = ["BUTTONS", "Go2Low", "LowReading", "Remote"]

# The remote control's buttons by their bit in bytes 2 and 3, lowest first (Unitree's SDK: wireless_controller).
BUTTONS = (
    "R1", "L1", "start", "select", "R2", "L2", "F1", "F3", "A", "B", "X", "Y", "up", "right", "down", "left",
)  # fmt: skip
_STICKS = struct.Struct("<2x H f f f 4x f")  # buttons, left x, right x, right y, (unused), left y


@dataclass(frozen=True)
class Remote:
    """The remote control: `pressed` buttons of `BUTTONS`, and its sticks, -1 to 1 (right and forward are positive)."""

    pressed: frozenset[str] = frozenset()
    left: tuple[float, float] = (0.0, 0.0)
    right: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def from_bytes(cls, data: bytes) -> Remote:
        """From the 40 bytes of `wireless_remote`."""
        keys, left_x, right_x, right_y, left_y = _STICKS.unpack_from(data)
        pressed = frozenset(name for bit, name in enumerate(BUTTONS) if keys >> bit & 1)
        return cls(pressed, (left_x, left_y), (right_x, right_y))

    def to_bytes(self) -> bytes:
        """The 40 bytes."""
        keys = sum(1 << bit for bit, name in enumerate(BUTTONS) if name in self.pressed)
        return _STICKS.pack(keys, self.left[0], *self.right, self.left[1]).ljust(40, b"\0")


@dataclass(frozen=True)
class LowReading:
    """`received`: when, on this machine's clock; `soc`: the battery's charge, per cent; `tick`: the robot's own, ms."""

    received: float
    tick: int
    soc: int
    volts: float
    amperes: float
    remote: Remote


class Go2Low:
    """The newest of what a Go2 says of its battery and remote control. `fast`: the topic of 500 Hz instead of 20 Hz."""

    def __init__(self, link: Link, *, fast: bool = False) -> None:
        from eagor.robots.go2.idl import LowState

        self.topic = "rt/lowstate" if fast else "rt/lf/lowstate"
        self.newest: LowReading | None = None
        self._came = threading.Event()
        self._reader = link.subscribe(self.topic, raw(LowState), self._received)

    def wait(self, timeout: float = 5.0) -> LowReading:
        """The newest reading; waits for the first. Raises `DeviceError` if none comes within `timeout` seconds."""
        if not self._came.wait(timeout) or self.newest is None:
            raise DeviceError(f"no robot tells its battery within {timeout:g} s ({self.topic}); is one here?")
        return self.newest

    def close(self) -> None:
        """Stop listening."""
        self._reader.close()

    def _received(self, message: object, when: float) -> None:
        fields = LowFields.from_bytes(message.data)  # type: ignore[attr-defined]
        remote = Remote.from_bytes(fields.wireless_remote)
        self.newest = LowReading(when, fields.tick, fields.soc, fields.power_v, fields.power_a, remote)
        self._came.set()
