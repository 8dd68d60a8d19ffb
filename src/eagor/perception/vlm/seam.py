"""The seam: a panorama looked at twice, rolled by half a turn in between, so that nothing is cut in both looks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def seamless(respond: Callable[[np.ndarray], np.ndarray], panorama: np.ndarray, cells: int) -> np.ndarray:
    """Responses ``(Q, h, cells)`` of two looks at `panorama`, rolled by a whole number of cells near half, merged.

    `respond` maps an image ``(H, W, 3)`` to ``(Q, h, cells)``; W must be a multiple of `cells`.
    """
    raise NotImplementedError
