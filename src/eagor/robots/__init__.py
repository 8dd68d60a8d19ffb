"""ROS 2, the Go2 over DDS, the simulated Go2, and what keeps a robot safe while it follows an answer.

Here: the poses of a Go2.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from eagor.errors import DeviceError

if TYPE_CHECKING:  # the guard's process imports this file as well, and is to hold little
    from eagor.robots.go2.state import BodyState
    from eagor.sources import Pose

__all__ = ["Go2Poses", "go2_poses"]

KEPT = 2000  # states of a Go2 that wait for whoever iterates: 10 s at 200 Hz
LOOK = 1.0  # seconds between looks at what is wrong while nothing comes


class Go2Poses:
    """The odometry of a Go2, with the link that it comes over; `source`: of `eagor.robots.go2.state.SOURCES`.

    `mount` ``(3,)``: where the camera is on the body, metres. Iterating raises `DeviceError` for a `Go2State.fault`.
    """

    def __init__(
        self, domain: int, interface: str | None, source: str = "sport", mount: tuple[float, float, float] = (0, 0, 0)
    ) -> None:
        from eagor.robots.dds import Participant
        from eagor.robots.go2.state import Go2State

        self._mount, self._came = mount, SimpleQueue[Any]()
        self._link = Participant(domain, interface)
        self._state = Go2State(self._link, source, received=self._received)

    def _received(self, state: BodyState) -> None:
        if self._came.qsize() >= KEPT:
            with suppress(Empty):
                self._came.get_nowait()
        self._came.put(state)

    def __iter__(self) -> Iterator[Pose]:
        from eagor.sources import Pose

        while True:
            with suppress(Empty):
                if (state := self._came.get(timeout=LOOK)) is None:
                    return
                yield Pose(state.stamp, state.world_R_body, state.position + state.world_R_body @ self._mount)
            if (fault := self._state.fault) is not None:
                raise DeviceError(fault)

    def close(self) -> None:
        """Leave the network; who iterates comes to the end."""
        self._link.close()
        self._came.put(None)


def go2_poses(text: str, *, domain: int | None, interface: str | None, **_: object) -> Go2Poses:
    """The poses that "go2" or "go2:lidar" names, for `eagor.open_poses`. Raises as `Go2Poses`."""
    from eagor.robots.dds import default_domain

    return Go2Poses(default_domain() if domain is None else domain, interface, text.partition(":")[2] or "sport")
