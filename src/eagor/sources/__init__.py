"""Pictures, videos, lenses, and the camera's own motion. Here: what sources of pictures and of odometry give.

A picture with its time, and a pose with its time. `check_camera` is the test that every `CameraSource` has to pass: for
plugins, and for ours.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.odometry import Pose, PoseSource

__all__ = ["CameraSource", "Frame", "Pose", "PoseSource", "check_camera"]

PATIENCE = 10.0  # seconds in which a closed camera has to let go of who waits for a frame


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture and when it was taken.

    `stamp`: seconds on the clock of its source. `picture` ``(H, W, 3)`` uint8 RGB: a whole panorama of the body frame,
    or what an ordinary lens shows, with its pixels as `grid`. `name`: for texts and tables, such as "0007.png" or
    "clip.mp4 at 3.20 s". `unseen` ``(H, W)``: what this picture does not show, or None. `problem`: why a recording has
    no `picture` at this time; "" if it has one, or never had any.
    """

    stamp: float
    picture: Any  # None in a recording, with or without a problem
    name: str
    grid: PerspectiveGrid | None = None
    unseen: np.ndarray | None = None
    problem: str = ""


@runtime_checkable
class CameraSource(Protocol):
    """A camera, a file or a stream that gives pictures in order of time.

    Iterating blocks until the next frame, and ends where the source ends (a file) or after `close`. Frames are whole
    panoramas, or pictures of an ordinary lens, each with its `grid`. The stamp is the time of CAPTURE: a live source
    subtracts its `latency` from the time of arrival. Stamps increase. Frames that cannot be used are left out and
    counted, with a `UserWarning` for the first. Raises `ImageError` or `DeviceError` where nothing more can come.
    """

    @property
    def grid(self) -> ErpGrid | PerspectiveGrid:
        """The pixels of its pictures: of a whole panorama, or those of its ordinary lens."""
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


def check_camera(camera: CameraSource, frames: int = 3) -> None:
    """Raise `AssertionError` unless `camera` keeps the contract of `CameraSource`, with its first `frames` frames.

    It needs so many: give a source that is not at its end. The camera is closed at the end.
    """
    ordinary, before = isinstance(getattr(camera, "grid", None), PerspectiveGrid), -math.inf

    def require(holds: bool, what: str) -> None:
        if not holds:
            raise AssertionError(f"the camera {what}")

    require(isinstance(camera, CameraSource), "lacks a member of eagor.sources.CameraSource")
    require(ordinary or isinstance(camera.grid, ErpGrid), f"grid is {camera.grid!r}; wanted an ErpGrid, or a view's")
    require(math.isfinite(camera.latency), f"latency is {camera.latency!r}; wanted seconds")
    require(isinstance(camera.live, bool), f"live is {camera.live!r}; wanted True or False")
    came = [frame for frame, _ in zip(camera, range(frames), strict=False)]
    require(len(came) == frames, f"gave {len(came)} frames; wanted {frames} for this test")
    for frame in came:
        require(isinstance(frame, Frame), f"gave a {type(frame).__name__}; wanted eagor.sources.Frame")
        shape, picture = (*(frame.grid or camera.grid).shape, 3), np.asarray(frame.picture)
        came_as = f"{picture.dtype} {picture.shape} {frame.problem}"
        fits = picture.dtype == np.uint8 and picture.shape == shape
        require(fits, f"gave a picture of {came_as}; wanted uint8 {shape}, as its grid says")
        require(math.isfinite(frame.stamp) and frame.stamp > before, f"gave the stamp {frame.stamp} after {before}")
        require(bool(frame.name), "gave a frame without a name")
        require((frame.grid is not None) == ordinary, f"gave a frame with the grid {frame.grid!r}; its own is another")
        before = frame.stamp
    require(camera.dropped >= 0, f"dropped is {camera.dropped!r}; wanted a count")
    camera.close()
    camera.close()
    rest = threading.Thread(target=lambda: [*camera], daemon=True)
    rest.start()
    rest.join(PATIENCE)
    require(not rest.is_alive(), f"goes on for {PATIENCE:g} s after close; wanted iterating to end")
