"""ROS 2, the Go2 over DDS, the simulated Go2, and what keeps a robot safe while it follows an answer.

Here: live sources of poses by their names.
"""

from __future__ import annotations

from collections.abc import Iterator
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

        self._link = Link(domain, interface)
        self._state = Go2State(self._link, source, mount=mount)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._state)

    def close(self) -> None:
        """Leave the network."""
        self._state.close()
        self._link.close()


def open_poses(
    text: str, *, domain: int | None = None, interface: str | None = None, camera: str | None = None
) -> PoseSource:
    """The live source of poses that `text` names: "ros:/odom", "go2", or "go2:lidar" (`eagor.robots.go2.state`).

    `domain`, `interface`: of DDS, for the Go2; ROS has those of its environment. `camera`: the frame of a ROS camera,
    whose poses are wanted. Raises `DeviceError` for another text, or if the network cannot be used;
    `MissingExtraError`.
    """
    if text.startswith(ROS):
        from eagor.robots.ros import RosPoses  # type: ignore[attr-defined]

        return RosPoses(text.removeprefix(ROS) or None, camera=camera)
    name, _, source = text.partition(":")
    if name == GO2:
        from eagor.robots.dds import default_domain

        return Go2Poses(default_domain() if domain is None else domain, interface, source or "sport")
    raise DeviceError(f"no poses are called {text!r}; wanted ros:/TOPIC or go2")
