"""What a camera shows that does not see all around: a picture of 4:3, straight ahead.

The worlds still render panoramas, so that all perceptions and methods get what they know. Outside of the picture there
is nothing in them, and a look says nothing there.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from eagor.evidence import BodyMask
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.tasks.rules import Camera
from eagor.worlds.render import Frame

SHAPE = 3, 4  # rows and columns of the picture, up to a factor
MASK_ROWS = 256


def in_view(camera: Camera, rows: int) -> np.ndarray | None:
    """The pixels ``(rows, 2 rows)`` of a panorama in the body frame that the camera shows, bool; None: all of them."""
    return None if camera.around else _in_view(camera.hfov, rows)


def mask_of(camera: Camera) -> BodyMask | None:
    """What the camera can see, as evidence is covered with it; None: everything."""
    return None if camera.around else _mask(camera.hfov)


def cut(frame: Frame, camera: Camera) -> Frame:
    """A rendered panorama without what the camera does not show: the mean colour, no range, no thing (-1)."""
    if camera.around:
        return frame
    parts: dict[str, np.ndarray] = {}
    for name, nothing in (("rgb", None), ("range", math.inf), ("ids", -1)):
        whole = getattr(frame, name)
        if whole is None:
            continue
        seen = _in_view(camera.hfov, len(whole))
        parts[name] = whole.copy()
        parts[name][~seen] = np.rint(whole[seen].mean(axis=0)) if nothing is None else nothing
    return replace(frame, **parts)


@lru_cache(maxsize=8)
def _in_view(hfov: float, rows: int) -> np.ndarray:
    return PerspectiveGrid(*SHAPE, math.radians(hfov)).project(ErpGrid(rows, 2 * rows).directions)[2]


@lru_cache(maxsize=4)
def _mask(hfov: float) -> BodyMask:
    return BodyMask(_in_view(hfov, MASK_ROWS))
