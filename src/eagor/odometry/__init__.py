"""How the camera turns and moves: poses from files, from an IMU, from the pictures themselves; clocks that differ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

__all__ = ["Pose", "PoseSource"]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the body is: `stamp` in seconds, `world_R_body` ``(3, 3)``, `position` ``(3,)`` in metres or None.

    The world has z up (REP-103), and does not jump while the body moves (REP-105: ``odom``). `spread`: standard
    deviation of the error of the orientation, radians per axis, where it is known. `frame`: the name of the picture
    that was taken there, as a file of poses has it, or None. `walks`: the camera goes from place to place, and its
    positions are not known.
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None = None
    spread: float = 0.0
    frame: str | None = None
    walks: bool = False


@runtime_checkable
class PoseSource(Protocol):
    """Odometry: poses in order of time, at any rate, on the clock of the frames.

    Iterating blocks until the next pose, and ends where the source ends or after `close`, which may be called twice.
    """

    def __iter__(self) -> Iterator[Pose]: ...

    def close(self) -> None: ...
