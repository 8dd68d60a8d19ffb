"""ROS 2 and the Go2 over DDS, the simulated Go2, and what keeps a robot safe while it follows an answer.

Here: live sources of poses by their names.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

from eagor.errors import DeviceError

if TYPE_CHECKING:  # the guard's process imports this file as well, and is to hold little
    from eagor.media import Pose, PoseSource

__all__ = ["GO2", "ROS", "Go2Poses", "open_poses"]

ROS, GO2 = "ros:", "go2"


class Go2Poses:
    """The odometry of a Go2 (`Go2State`), with the link that it comes over.

    `mount` ``(3,)``: where the camera is on the body, metres.
    """

    def __init__(
        self, domain: int, interface: str | None, source: str = "sport", mount: tuple[float, float, float] = (0, 0, 0)
    ) -> None:
        from eagor.robots.dds import Link
        from eagor.robots.go2.state import Go2State

        with ExitStack() as stack:
            link = stack.enter_context(Link(domain, interface))
            self._state = Go2State(link, source, mount=mount)
            self._held = stack.pop_all()

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._state)

    def close(self) -> None:
        """Leave the network."""
        self._state.close()
        self._held.close()


def open_poses(
    text: str, *, domain: int | None = None, interface: str | None = None, camera: str | None = None
) -> PoseSource:
    """The live source of poses that `text` names: "ros:/odom", "go2", or "go2:lidar" (`eagor.robots.go2.state`).

    `domain`, `interface`: of DDS. `camera`: the frame of a ROS camera, whose poses are wanted. Raises `DeviceError` for
    another text, or if the network cannot be used; `MissingExtraError`.
    """
    if text.startswith(ROS):
        from eagor.robots.ros import RosPoses

        return RosPoses(text.removeprefix(ROS) or None, domain=domain, interface=interface, camera=camera)
    if text.partition(":")[0] == GO2:
        from eagor.robots.dds import default_domain

        source = text.partition(":")[2] or "sport"
        return Go2Poses(default_domain() if domain is None else domain, interface, source)
    raise DeviceError(f"no poses are called {text!r}; wanted ros:/TOPIC or go2")
