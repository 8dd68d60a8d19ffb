"""Boxes drawn as responses: a smooth bump around the direction that each box means."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eagor.detections import MIN_SPREAD
from eagor.grids import Grid
from eagor.perception.vlm.boxes import Box


def drawn(boxes: Sequence[Box], image: Grid, canvas: Grid, min_spread: float = MIN_SPREAD) -> np.ndarray:
    """The response ``canvas.shape`` float32 in [0, 1] of boxes in a picture with the geometry of `image`.

    A whole panorama is any PatchGrid or ErpGrid (its size does not matter), a view its PerspectiveGrid. No box: zeros.
    """
    raise NotImplementedError
