"""Poses by text: `open_poses` for what ``--poses`` means.

Packages add sources of poses under the entry points ``eagor.poses``: a name, and a function ``(text, *, camera, domain,
interface) -> PoseSource``, which gets the whole text, such as ``NAME:REST``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor import plugins
from eagor._extras import need
from eagor.errors import DeviceError
from eagor.odometry import Pose, PoseSource
from eagor.odometry.axes import odometry_of_file

if TYPE_CHECKING:
    from eagor.odometry.visual import VisualOdometer

__all__ = ["GivenPoses", "open_poses", "poses_for"]

GROUP = "eagor.poses"
BUILT_IN = {"go2": "eagor.robots:go2_poses", "ros": "eagor.robots.ros:ros_poses"}
RATE = 100.0  # poses per second that are taken from a motion track


class GivenPoses:
    """Poses that are there already, in order of time."""

    def __init__(self, poses: Iterable[Pose]) -> None:
        self._poses = tuple(poses)

    def __iter__(self) -> Iterator[Pose]:
        return iter(self._poses)

    def close(self) -> None:
        """Nothing is held."""


def open_poses(
    text: str = "auto",
    source: Any = None,
    *,
    axes: str = "auto",
    domain: int | None = None,
    interface: str | None = None,
    again: Callable[[], Any] | None = None,
) -> PoseSource | VisualOdometer | None:
    """The poses that `text` names, for the pictures of `source`, a `CameraSource`; None for a camera that stands still.

    "auto": a bag's odometry or a video's IMU, where `source` has them, else what the pictures themselves tell (rotation
    only); "level": the same for a camera that keeps its pictures level; "still"; a file, whose `axes` are as of
    `eagor.odometry.axes.settled`; ``ros:/odom``, a topic of ROS 2 or of a bag; ``go2``, a robot's odometry, over the
    DDS `domain` and network `interface`; or what another package brings. `again`: opens the source once more; a file of
    poses is then compared with its pictures.

    Raises `DeviceError` for live poses of a recording, and the other way round, and what the source raises.
    """
    name, _, rest = text.partition(":")
    recorded, motion = getattr(source, "odometry", None), getattr(source, "motion", None)
    if recorded is not None and (text == "auto" or name == "ros") and (found := recorded(rest or None)) is not None:
        return found
    if text == "auto" and motion is not None:
        stamps = np.append(np.arange(motion.start, motion.end, 1 / RATE), motion.end)
        return GivenPoses(Pose(stamp, motion.world_R_body(stamp)) for stamp in stamps.tolist())
    if text in ("auto", "level"):
        need("the rotation from pictures", "photos", "cv2")
        from eagor.odometry.visual import VisualOdometer

        return VisualOdometer(level=text == "level")
    if text == "still":
        return None
    known = plugins.known(GROUP, BUILT_IN)
    if name in known:
        if source is not None and not source.live:
            raise DeviceError(f"the poses {text} are live, and the pictures are a recording; wanted a file of poses")
        frame = getattr(source, "frame", None)
        return plugins.bring(known[name], "poses")(text, camera=frame, domain=domain, interface=interface)
    if source is not None and source.live:
        names = ", ".join(f"{each}:..." for each in sorted(known))
        raise DeviceError(f"poses {text!r}: a live camera needs live poses; wanted auto, level, still, {names}")
    if again is None:
        return GivenPoses(odometry_of_file(text, axes))
    with closing(again()) as pictures:
        return GivenPoses(odometry_of_file(text, axes, pictures))


def poses_for(text: str, source: Any, **how: Any) -> Any:
    """As `open_poses`, or a function that does so, for poses that are live: who may not be there yet, or may go."""
    live = source.live and text.partition(":")[0] in plugins.known(GROUP, BUILT_IN)
    return partial(open_poses, text, source, **how) if live else open_poses(text, source, **how)
