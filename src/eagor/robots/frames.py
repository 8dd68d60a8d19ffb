"""A picture with its time: what every source of pictures gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Frame"]


@dataclass(frozen=True, eq=False)
class Frame:
    """A panorama and when it was taken.

    `stamp`: seconds on the clock of its source. `panorama` ``(H, W, 3)`` uint8 RGB, body frame. `name`: for texts and
    tables, such as "0007.png" or "clip.mp4 at 3.20 s".
    """

    stamp: float
    panorama: np.ndarray
    name: str
