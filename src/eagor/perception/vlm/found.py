"""Boxes as one set of detections, from one picture or from several overlapping pictures of one moment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import ANYWHERE, moments
from eagor.grids import Grid, PerspectiveGrid
from eagor.perception.blobs import spread_evidence
from eagor.perception.vlm.boxes import Box
from eagor.sphere import angular_distance

SAME = math.radians(5)  # largest distance between two boxes of one small thing; the extent of large things is added
REACH = math.sqrt(3)  # half the width of a box over its standard deviation
WHOLE = 0.95  # coverage from which on a direction counts as fully seen


@dataclass(frozen=True, eq=False)
class Thing:
    """The direction of a box: mean ``(3,)``, covariance ``(2, 2)`` about it (radians^2), and score.

    `depth`: distance from the border of its picture, where things are cut off; larger is farther inside.
    """

    direction: np.ndarray
    covariance: np.ndarray
    score: float
    depth: float

    @property
    def size(self) -> float:
        """Standard deviation, radians."""
        return math.sqrt(float(np.trace(self.covariance)) / 2)

    def is_same(self, other: Thing) -> bool:
        """Whether boxes of two pictures probably show one thing, which one of the pictures may cut off."""
        small, large = sorted((self.size, other.size))
        if large > 3 * small + SAME:
            return False
        return float(angular_distance(self.direction, other.direction)) < math.hypot(SAME, REACH * large)


def moments_of(box: Box, image: Grid, roll: float = 0.0) -> tuple[np.ndarray, np.ndarray] | None:
    """Mean direction ``(3,)`` and covariance ``(2, 2)`` of a box in a picture with the geometry of `image`.

    For a whole panorama, `image` is any grid of the whole sphere. `roll`: the fraction of its width by which it was
    rolled to the right. None for a box all around, which has no direction.
    """
    height, width = image.shape
    corners = [(box.x0 - roll) * width, box.y0 * height, (box.x1 - roll) * width, box.y1 * height]
    try:
        return moments(np.array(corners), image)  # columns continue across the seam
    except ResponseError:  # all around: every `Box` has some area
        return None


def things(boxes: Sequence[Box], image: Grid, roll: float = 0.0) -> list[Thing]:
    """The boxes in a picture as directions in the body frame; `image` and `roll` as in `moments_of`."""
    found = []
    for box in boxes:
        centre, spread = moments_of(box, image, roll) or (np.array([1.0, 0.0, 0.0]), ANYWHERE**2 * np.eye(2))
        if isinstance(image, PerspectiveGrid):
            depth = float(centre @ image.body_R_view[:, 0])
        else:
            depth = 1 - abs(box.x0 + box.x1 - 1)
        found.append(Thing(centre, spread, box.score, depth))
    return found


def united(pictures: Iterable[Sequence[Thing]]) -> list[Thing]:
    """The things in several pictures, each once: from the picture in which it lies farthest inside."""
    marked = [(thing, index) for index, found in enumerate(pictures) for thing in found]
    kept: list[tuple[Thing, int]] = []
    for thing, index in sorted(marked, key=lambda pair: -pair[0].depth):
        if not any(index != other and thing.is_same(earlier) for earlier, other in kept):
            kept.append((thing, index))
    return [thing for thing, _ in kept]


def detected(
    found: Sequence[Thing],
    model: DetectorModel | None,
    grid: Grid,
    stamp: float | None,
    coverage: np.ndarray | None = None,
    source: Mapping[str, object] | None = None,
) -> Evidence:
    """The evidence of `found` within `grid`, as far as `coverage` ``(H, W)`` says (None: all of it)."""
    seen = None if coverage is None or bool((coverage >= WHOLE).all()) else coverage
    parts = [(thing.direction, thing.covariance, thing.score) for thing in found]
    return replace(spread_evidence(parts, model, View(grid, seen), stamp), source=source)
