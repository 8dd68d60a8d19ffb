"""Boxes drawn as responses: a smooth bump around the direction that each box means."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eagor.detections import MIN_SPREAD, bump, moments
from eagor.errors import ResponseError
from eagor.grids import Grid
from eagor.perception.vlm.boxes import Box


def drawn(boxes: Sequence[Box], image: Grid, canvas: Grid, roll: float = 0.0) -> np.ndarray:
    """The response ``canvas.shape`` float32 in [0, 1] of boxes in a picture with the geometry of `image`.

    A whole panorama is any `PatchGrid` or `ErpGrid` (its size does not matter), a view its `PerspectiveGrid`. As in
    `Evidence.from_boxes`, each box becomes the Gaussian with the mean direction and the second moments of its solid
    angle, widened by `MIN_SPREAD`, times its score; the highest counts. Other than there, a box all around, such as
    one of the whole panorama, is no error: it names no direction, and counts alike everywhere. No box: zeros.

    `roll` is the fraction of its width by which a panorama was rolled to the right before the model saw it; the
    response is that of the panorama itself.
    """
    height, width = image.shape
    response = np.zeros(canvas.shape)
    for box in boxes:
        left, right = (box.x0 - roll) * width, (box.x1 - roll) * width  # columns go on beyond the seam
        corners = np.array([left, box.y0 * height, right, box.y1 * height])
        try:
            centre, spread = moments(corners, image)
            there = bump(canvas.directions, centre, spread + MIN_SPREAD**2 * np.eye(2))
        except ResponseError:  # all around: a `Box` has some area
            there = np.ones(canvas.shape)
        response = np.maximum(response, box.score * there)
    return response.astype(np.float32)
