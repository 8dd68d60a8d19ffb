"""Boxes drawn as responses: a smooth bump around the direction of each box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eagor.evidence.shapes import MIN_SPREAD, bump
from eagor.grids import Grid
from eagor.perception.vlm.boxes import Box
from eagor.perception.vlm.found import moments_of


def drawn(boxes: Sequence[Box], image: Grid, canvas: Grid, roll: float = 0.0) -> np.ndarray:
    """The response ``canvas.shape`` float32 in [0, 1] of boxes in a picture with the geometry of `image`.

    `image` and `roll` as in `moments_of`. As in `Evidence.from_boxes`, each box becomes a Gaussian, widened by
    `MIN_SPREAD`, times its score; the highest counts. A box all around is uniform. No box: zeros.
    """
    response = np.zeros(canvas.shape)
    for box in boxes:
        meant = moments_of(box, image, roll)
        there = np.ones(canvas.shape)
        if meant is not None:
            there = bump(canvas.directions, meant[0], meant[1] + MIN_SPREAD**2 * np.eye(2))
        response = np.maximum(response, box.score * there)
    return response.astype(np.float32)
