"""Corners of one panorama followed into another by optical flow: a fiftieth of the work of matching features.

Pyramidal Lucas-Kanade (Bouguet, Intel 2001) needs things nearly where they were. So the second panorama is cut into
views that stand still in the world by a guess of the turn: what is left are errors of the guess, and parallax.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eagor.media.features import Views

CORNERS = 56  # of a view, strongest first; six views give as many pairs as a turn needs
WINDOW = (15, 15)  # pixels about a corner that are compared
LEVELS = 3  # of the pyramid, each half as large: windows reach 8 degrees and more from the guess
APART = 7.0  # pixels between corners
QUALITY = 0.01  # of the strongest corner of a view
RETURN = 0.5  # pixels that a corner may miss its place by when it is followed back


def corners_of(views: Views) -> tuple[np.ndarray, ...]:
    """Points ``(n, 1, 2)`` of each view that can be followed, float32; few or none in a plain picture."""
    import cv2

    found = []
    for index, picture in enumerate(views.pictures):
        points = cv2.goodFeaturesToTrack(picture, CORNERS, QUALITY, APART)
        if points is None:
            points = np.empty((0, 1, 2), np.float32)
        found.append(points[views.seen(index, points[:, 0])[1]])
    return tuple(found)


def steadied(panorama: np.ndarray, views: Views, old_R_new: np.ndarray) -> Views:
    """Views of a panorama that look where `views` did, if the camera has turned by `old_R_new` ``(3, 3)`` since."""
    grids = tuple(replace(grid, body_R_view=old_R_new.T @ grid.body_R_view) for grid in views.grids)
    return Views.of(panorama, grids=grids)


def followed(old: Views, corners: tuple[np.ndarray, ...], new: Views) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(m, 3)`` of `corners` that are found again, each in its own body frame.

    A corner counts if it returns to its place when it is followed back. `new`: steadied views of the same size.
    """
    import cv2

    here, there = [np.empty((0, 3))], [np.empty((0, 3))]
    for index, (points, before, now) in enumerate(zip(corners, old.pictures, new.pictures, strict=True)):
        if len(points) == 0:
            continue
        moved, ahead, _ = cv2.calcOpticalFlowPyrLK(before, now, points, points.copy(), winSize=WINDOW, maxLevel=LEVELS)
        back, behind, _ = cv2.calcOpticalFlowPyrLK(now, before, moved, moved.copy(), winSize=WINDOW, maxLevel=LEVELS)
        miss = np.abs(back - points).max(axis=(1, 2))
        good = (ahead[:, 0] == 1) & (behind[:, 0] == 1) & (miss < RETURN)
        here.append(old.seen(index, points[good, 0])[0])
        there.append(new.seen(index, moved[good, 0])[0])
    return np.concatenate(here), np.concatenate(there)
