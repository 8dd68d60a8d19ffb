"""A picture with its time, and a pose with its time: what sources of pictures and of odometry give."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from eagor.grids import ErpGrid

__all__ = ["CameraSource", "Frame", "Pose", "PoseSource"]


@dataclass(frozen=True, eq=False)
class Frame:
    """A panorama and when it was taken.

    `stamp`: seconds on the clock of its source. `panorama` ``(H, W, 3)`` uint8 RGB, body frame. `name`: for texts and
    tables, such as "0007.png" or "clip.mp4 at 3.20 s".
    """

    stamp: float
    panorama: np.ndarray
    name: str


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the body is: `stamp` in seconds, `world_R_body` ``(3, 3)``, `position` ``(3,)`` in metres or None.

    The world has z up (REP-103), and does not jump while the body moves (REP-105: ``odom``).
    """

    stamp: float
    world_R_body: np.ndarray
    position: np.ndarray | None = None


@runtime_checkable
class CameraSource(Protocol):
    """A camera, a file or a stream that gives panoramas in order of time.

    Iterating blocks until the next frame, and ends where the source ends (a file) or after `close`. Frames are whole
    panoramas: a source that sees with lenses stitches them. The stamp is the time of CAPTURE: a live source subtracts
    its `latency` from the time of arrival. Frames that cannot be used are left out and counted, with a `UserWarning`
    for the first. Raises `ImageError` or `DeviceError` where nothing more can come.
    """

    @property
    def grid(self) -> ErpGrid:
        """The pixels of its panoramas."""
        ...

    @property
    def latency(self) -> float:
        """Seconds from capture to arrival, as stated or measured; 0 for files."""
        ...

    @property
    def dropped(self) -> int:
        """Frames that came, but were not given: nobody asked in time, or they were damaged."""
        ...

    @property
    def live(self) -> bool:
        """Whether its stamps are this machine's clock (``time.time()``): a frame that is not taken now is lost."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Let go of the device. A thread that waits for a frame comes back. May be called twice."""
        ...


@runtime_checkable
class PoseSource(Protocol):
    """Odometry: poses in order of time, at any rate, on the clock of the frames. Otherwise as `CameraSource`."""

    def __iter__(self) -> Iterator[Pose]: ...

    def close(self) -> None: ...
