"""The program's own way to stop a Go2, held open for the case that the guard's process is gone."""

from __future__ import annotations

from typing import Self

from eagor.errors import DeviceError
from eagor.robots.dds import Link
from eagor.robots.go2.sport import OK, AvoidClient, SportClient

__all__ = ["Standby"]

PATIENCE = 0.1  # seconds until a StopMove counts as not acknowledged; the next one follows at once


class Standby:
    """A second voice beside the guard, which can say StopMove and nothing else; a context manager.

    It is opened beforehand: processes need a second to find each other on DDS, and a robot walks on meanwhile.
    `avoid`: velocities go through the robot's obstacle avoidance, so that these are stopped as well. `sent`: StopMove
    so far; `acknowledged`: whether the robot acknowledged the newest. Raises `DeviceError`, `MissingExtraError`.
    """

    def __init__(self, domain: int, interface: str | None, *, avoid: bool = False) -> None:
        self.sent, self.acknowledged = 0, False
        self._link = Link(domain, interface)
        self._sport = SportClient(self._link, timeout=PATIENCE)
        self._avoid = AvoidClient(self._link, timeout=PATIENCE) if avoid else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._avoid is not None and self.sent:  # whoever turned this on may be gone
            self._avoid.end()
        self._link.close()

    def wait(self, timeout: float) -> None:
        """Wait until the robot listens. Raises `DeviceError` if it does not within `timeout` seconds."""
        if not self._sport.wait(timeout):
            raise DeviceError(
                f"the robot does not listen to this program's own StopMove within {timeout:g} s, which has to work if "
                "the guard ends: relieve this machine's processor, look at the network, start the program again"
            )

    def stop(self) -> bool:
        """Send StopMove; whether the robot acknowledged it, for which it has `PATIENCE`."""
        if self._avoid is not None:
            self._avoid.stop()
        self.acknowledged = self._sport.stop() == OK
        self.sent += 1
        return self.acknowledged
