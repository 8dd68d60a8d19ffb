"""How the wire of a simulated Go2 behaves: its clock, what gets lost, what comes late."""

from __future__ import annotations

from dataclasses import dataclass

from eagor._checks import require, stretch, within
from eagor.errors import DeviceError

__all__ = ["WireSettings"]


@dataclass(frozen=True)
class WireSettings:
    """How a simulated Go2's wire behaves.

    `clock_offset`: seconds by which the robot's clock is ahead of this machine's at first; `clock_drift`: seconds per
    second by which it gains. `drop`: share of messages that get lost, in both directions. `delay`: from and to how many
    seconds messages take. `short`: states without the planned path. `battery`: per cent at the start.
    """

    clock_offset: float = 0.0
    clock_drift: float = 0.0
    drop: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)
    short: bool = False
    battery: int = 87

    def __post_init__(self) -> None:
        require(
            self,
            {
                "clock_offset": (within(self.clock_offset, -1e8, 1e8), "seconds"),
                "clock_drift": (within(self.clock_drift, -0.01, 0.01), "at most 0.01 s per second"),
                "drop": (within(self.drop, 0, 1), "a share, 0 to 1"),
                "delay": (stretch(self.delay, 0, 10), "seconds (from, to), at most 10"),
                "battery": (within(self.battery, 0, 100), "0 to 100"),
            },
            DeviceError,
        )

    def robot_time(self, host: float, seconds: float) -> float:
        """The robot's clock at `host` on ours, `seconds` after its start."""
        return host + self.clock_offset + self.clock_drift * seconds
