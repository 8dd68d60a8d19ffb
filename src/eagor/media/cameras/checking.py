"""The test that every camera has to pass: for plugins, and for ours."""

from __future__ import annotations

import math
import threading

import numpy as np

from eagor.grids import ErpGrid
from eagor.media.frames import CameraSource, Frame

__all__ = ["check_camera"]

PATIENCE = 10.0  # seconds in which a closed camera has to let go of who waits for a frame


def check_camera(camera: CameraSource, frames: int = 3) -> None:
    """Raise `AssertionError` unless `camera` keeps the contract of `CameraSource`, with its first `frames` frames.

    It needs so many: give a source that is not at its end. The camera is closed at the end.
    """
    _require(isinstance(camera, CameraSource), "lacks a member of eagor.media.frames.CameraSource")
    _require(isinstance(camera.grid, ErpGrid), f"grid is {camera.grid!r}; wanted an ErpGrid")
    _require(math.isfinite(camera.latency), f"latency is {camera.latency!r}; wanted seconds")
    _require(isinstance(camera.live, bool), f"live is {camera.live!r}; wanted True or False")
    last = -math.inf
    came = 0
    for frame in camera:
        came += 1
        _require(isinstance(frame, Frame), f"gave a {type(frame).__name__}; wanted eagor.media.frames.Frame")
        picture = frame.panorama
        _require(
            isinstance(picture, np.ndarray) and picture.dtype == np.uint8 and picture.shape == (*camera.grid.shape, 3),
            f"gave a picture of {getattr(picture, 'dtype', type(picture))} {np.shape(picture)}; wanted uint8 "
            f"{(*camera.grid.shape, 3)}, as its grid says",
        )
        _require(math.isfinite(frame.stamp), f"gave the stamp {frame.stamp!r}; wanted seconds")
        _require(frame.stamp > last, f"gave the stamp {frame.stamp:.6f} after {last:.6f}; wanted increasing stamps")
        _require(bool(frame.name), "gave a frame without a name")
        last = frame.stamp
        if came == frames:
            break
    _require(came == frames, f"gave {came} frames; wanted {frames} for this test")
    _require(camera.dropped >= 0, f"dropped is {camera.dropped!r}; wanted a count")
    camera.close()
    camera.close()
    ended = threading.Event()

    def rest() -> None:
        for _ in camera:
            pass
        ended.set()

    threading.Thread(target=rest, daemon=True).start()
    _require(ended.wait(PATIENCE), f"goes on for {PATIENCE:g} s after close; wanted iterating to end")


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise AssertionError(f"the camera {what}")
