"""Points of a panorama that can be found again: directions and descriptors, and which of two panoramas belong together.

SIFT (Lowe, IJCV 60, 2004) on flat views that cover the sphere, so that neither the seam nor the poles differ from
other places. Of OpenCV's features it gave the most precise directions: see benchmarks/rotation.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._extras import need
from eagor.grids import PerspectiveGrid
from eagor.perception.cutting import cut, tangent_views

FIELD = math.radians(100)  # of a view; six such views cover the sphere
SIZE = 320  # pixels of a view
CONTRAST = 0.02  # half of SIFT's usual threshold: dim rooms have few strong points
MOST = 400  # points of a view, strongest first
RATIO = 0.8  # of the distances to the best and the second best descriptor (Lowe 2004, section 7.1)


@dataclass(frozen=True, eq=False)
class Features:
    """`n` points: unit vectors `directions` ``(n, 3)``, body frame; `descriptors` ``(n, 128)`` float32, unit length."""

    directions: np.ndarray
    descriptors: np.ndarray

    def __len__(self) -> int:
        return len(self.directions)


def features_of(panorama: np.ndarray, size: int = SIZE) -> Features:
    """The points of a panorama ``(H, W, 3)`` uint8, from views of `size` pixels; none in a blank picture.

    Views overlap. Each point counts in the view whose axis is nearest, so there are no duplicates. Raises `ImageError`,
    and `MissingExtraError` without OpenCV.
    """
    need("finding features in a panorama", "photos", "cv2")
    import cv2

    views = _views(size)
    axes = np.array([view.body_R_view[:, 0] for view in views])
    detector = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
    directions: list[Any] = [np.empty((0, 3))]
    descriptors: list[Any] = [np.empty((0, 128), np.float32)]
    for index, (view, picture) in enumerate(zip(views, cut(panorama, *views), strict=True)):
        points, found = detector.detectAndCompute(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), None)
        if found is None or len(points) == 0:
            continue
        x, y = np.array([point.pt for point in points]).T + 0.5  # OpenCV counts from the centre of the first pixel
        rays = view.unproject(x, y)
        strength = np.array([point.response for point in points])
        own = np.flatnonzero((rays @ axes.T).argmax(axis=1) == index)
        own = own[np.argsort(-strength[own], kind="stable")][:MOST]
        directions.append(rays[own])
        descriptors.append(found[own])
    return Features(np.concatenate(directions), _rooted(np.concatenate(descriptors)))


def match(a: Features, b: Features) -> tuple[np.ndarray, np.ndarray]:
    """Indices into `a` and `b`, ``(m,)`` each, of points that look alike.

    Each is the other's nearest by its descriptor, and clearly nearer than the second (Lowe's ratio test) both ways.
    """
    if min(len(a), len(b)) < 2:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    squared = 2 - 2 * (a.descriptors @ b.descriptors.T)
    nearest = squared.argmin(axis=1)
    index = np.flatnonzero(squared.argmin(axis=0)[nearest] == np.arange(len(a)))
    nearest = nearest[index]
    limit = np.minimum(_second(squared[index]), _second(squared[:, nearest].T)) * RATIO**2
    clear = squared[index, nearest] < limit
    return index[clear], nearest[clear]


def _second(values: np.ndarray) -> np.ndarray:
    """The second least of each row."""
    return np.partition(values, 1, axis=1)[:, 1]


def _rooted(descriptors: np.ndarray) -> np.ndarray:
    """Square roots of shares: distances between them are Hellinger's (Arandjelovic & Zisserman, CVPR 2012)."""
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    return np.sqrt(np.maximum(descriptors, 0) / total)


@lru_cache(maxsize=4)
def _views(size: int) -> tuple[PerspectiveGrid, ...]:
    return tangent_views(size, FIELD)
