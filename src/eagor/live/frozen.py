"""A camera that shows one picture again and again while it turns: its driver hangs, and stamps the old picture anew."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable

import numpy as np

from eagor.sphere import heading

__all__ = ["Frozen"]

TURNED = math.radians(3.0)  # by which the camera may turn without its picture changing at all
HANGS = "the picture stays the same although the camera turns: does it hang? Restart the camera or its driver"
ROWS = 128  # of a picture that are compared, and as dense along them: a sensor's noise alone changes these


class Frozen:
    """Compares pictures bit by bit. `orientation(stamp)`: `world_R_body` ``(3, 3)`` at a picture that came before."""

    def __init__(self, orientation: Callable[[float], np.ndarray | None]) -> None:
        self._orientation = orientation
        self._code: int | None = None
        self._stamp = math.nan
        self._hangs = False
        self._ahead: float | None = None  # where the camera looked when this picture came first

    def take(self, panorama: np.ndarray, stamp: float) -> str:
        """What is wrong, in words, at the picture ``(H, W, 3)`` of this stamp; "" if nothing is."""
        step = max(1, len(panorama) // ROWS)
        code, before = zlib.crc32(panorama[::step, ::step].tobytes()), self._stamp
        same, self._code, self._stamp = code == self._code, code, stamp
        if not same:
            self._ahead, self._hangs = None, False
            return ""
        pose = self._orientation(before)  # poses of a picture that just came may be on their way
        if pose is None:
            return ""
        if self._ahead is None:
            self._ahead = heading(pose)
        turned = math.remainder(heading(pose) - self._ahead, 2 * math.pi)
        self._hangs |= abs(turned) > TURNED
        return HANGS if self._hangs else ""
