"""Points of a picture that can be found again: SIFT features to match, and corners to follow by optical flow.

SIFT (Lowe, IJCV 60, 2004) on flat views that cover the sphere, so that neither the seam nor the poles differ from
other places. Of OpenCV's features it gave the most precise directions. The picture of an
ordinary camera is one such view already, as it is: distortion bends directions, not points.

Following corners takes a fiftieth of the work of matching features. Pyramidal Lucas-Kanade (Bouguet, Intel 2001) needs
things nearly where they were. So the second panorama is cut into views that stand still in the world by a guess of the
turn: what is left are errors of the guess, and parallax. An ordinary picture is warped in the same way, as far as the
two overlap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from eagor._extras import need
from eagor._values import lazy
from eagor.grids import PerspectiveGrid, tangent_views
from eagor.media.consensus import SPHERE
from eagor.media.panorama import checked_picture, cut

FIELD = math.radians(100)  # of a view; six such views cover the sphere
SIZE = 320  # pixels of a view
CONTRAST = 0.02  # half of SIFT's usual threshold: dim rooms have few strong points
MOST = 400  # points of a view, strongest first
WIDE = 640  # pixels along the longer side of an ordinary picture; larger ones are shrunk
TILES = (3, 4)  # rows and columns of an ordinary picture that share its points and corners evenly
MOST_TILE = 80  # points of such a tile
RATIO = 0.8  # of the distances to the best and the second best descriptor (Lowe 2004, section 7.1)

CORNERS = 56  # of a view, strongest first; six views give as many pairs as a turn needs
CORNERS_TILE = 20  # of a tile
FAINT = 0.001  # of the strongest corner of an ordinary picture: a thing in front of a plain room may be strong
PROBES = 9  # points along each side of a picture at which its overlap with another is found
COARSE = 8  # pixels from node to node of a table of where to read; between them it is straight to a fiftieth of a pixel
WINDOW = (15, 15)  # pixels about a corner that are compared
LEVELS = 3  # of the pyramid, each half as large: windows reach 8 degrees and more from the guess
APART = 7.0  # pixels between corners
QUALITY = 0.01  # of the strongest corner of a view
RETURN = 0.5  # pixels that a corner may miss its place by when it is followed back


@dataclass(frozen=True, eq=False)
class Features:
    """`n` points: unit vectors `directions` ``(n, 3)``, body frame; `descriptors` ``(n, 128)`` float32, unit length."""

    directions: np.ndarray
    descriptors: np.ndarray

    def __len__(self) -> int:
        return len(self.directions)

    def __getitem__(self, chosen: slice | np.ndarray) -> Features:
        """Some of the points, by a slice, a mask or indices."""
        return Features(self.directions[chosen], self.descriptors[chosen])


@dataclass(frozen=True, eq=False)
class Views:
    """Flat views: six that cover the sphere, or the one of an ordinary camera.

    `grids` in the body frame, and the grey `pictures` ``(H, W)``. `within`: None, or of an ordinary picture that was
    warped its own grid: only there is something to see.
    """

    grids: tuple[PerspectiveGrid, ...]
    pictures: tuple[np.ndarray, ...]
    within: PerspectiveGrid | None = None

    @property
    def whole(self) -> bool:
        """Whether they cover the sphere."""
        return len(self.grids) > 1

    @property
    def lens(self) -> bytes:
        """Which lens of a camera they are from."""
        return lens_of(None if self.whole else self.grids[0])

    @classmethod
    def of_picture(cls, picture: np.ndarray, grid: PerspectiveGrid) -> Views:
        """The one view of an ordinary picture ``(H, W, 3)`` uint8 with its `grid`, shrunk to `WIDE` pixels.

        Raises `ImageError` where the sizes differ, and `MissingExtraError` without OpenCV.
        """
        need("finding features in a picture", "photos", "cv2")
        import cv2

        image = checked_picture(picture, "the picture", grid)
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
        by = WIDE / max(grid.shape)
        if by < 1:
            grid = grid.resized(max(1, round(grid.height * by)), max(1, round(grid.width * by)))
            grey = cv2.resize(grey, grid.shape[::-1], interpolation=cv2.INTER_AREA)
        return cls((grid,), (grey,))

    @classmethod
    def of(cls, panorama: np.ndarray, size: int = SIZE, grids: tuple[PerspectiveGrid, ...] = ()) -> Views:
        """The views of a panorama ``(H, W, 3)`` uint8: of `size` pixels as a cube, or other `grids`.

        Raises `ImageError`, and `MissingExtraError` without OpenCV.
        """
        need("finding features in a panorama", "photos", "cv2")
        import cv2

        grids = grids or _views(size)
        pictures = cut(panorama, *grids)
        return cls(grids, tuple(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in pictures))

    @lazy
    def features(self) -> Features:
        """The points of the picture; none in a blank one.

        Views overlap. Each point counts in the view whose axis is nearest, so there are no duplicates.
        """
        import cv2

        detector = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
        directions: list[Any] = [np.empty((0, 3))]
        descriptors: list[Any] = [np.empty((0, 128), np.float32)]
        for index, picture in enumerate(self.pictures):
            points, found = detector.detectAndCompute(picture, None)
            if found is None or len(points) == 0:
                continue
            rays, own = self.seen(index, np.array([point.pt for point in points]))
            strength = np.array([point.response for point in points])
            own = np.flatnonzero(own)
            own = own[np.argsort(-strength[own], kind="stable")]
            if self.whole:
                own = own[:MOST]
            else:
                own = own[_in_tiles(np.array([points[each].pt for each in own]), picture.shape, MOST_TILE)]
            directions.append(rays[own])
            descriptors.append(found[own])
        return Features(np.concatenate(directions), _rooted(np.concatenate(descriptors)))

    def seen(self, index: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` of OpenCV's `points` ``(n, 2)`` in a view, and whether they count there.

        That is, whether its axis is the nearest one, or whether a warped picture shows them.
        """
        x, y = points.T.astype(np.float64) + 0.5  # OpenCV counts from the centre of the first pixel
        rays = self.grids[index].unproject(x, y)
        if self.within is not None:
            return rays, self.within.project(rays)[2]
        axes = np.array([grid.body_R_view[:, 0] for grid in self.grids])
        return rays, (rays @ axes.T).argmax(axis=1) == index

    @lazy
    def area(self) -> float:
        """Steradians that the views show."""
        if self.whole:
            return SPHERE
        (grid,) = self.grids
        return float(grid.resized(max(1, grid.height // COARSE), max(1, grid.width // COARSE)).weights.sum())


def _in_tiles(points: np.ndarray, shape: tuple[int, ...], most: int) -> np.ndarray:
    """Indices of the first so many of `points` ``(n, 2)`` (x, y) in each tile of a picture of this shape, in order."""
    if len(points) == 0:
        return np.empty(0, dtype=np.intp)
    rows, columns = (np.minimum(points[:, 1 - k] * TILES[k] // shape[k], TILES[k] - 1) for k in (0, 1))
    tile = (rows * TILES[1] + columns).astype(np.intp)
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(tile[order]) > 0])
    rank = np.arange(len(points)) - np.repeat(starts, np.diff(np.r_[starts, len(points)]))
    return np.sort(order[rank < most])


def lens_of(grid: PerspectiveGrid | None) -> bytes:
    """A name for the lens of an ordinary camera with this grid, by where it looks; for panoramas (None) it is empty."""
    return b"" if grid is None else grid.body_R_view.tobytes()


def features_of(panorama: np.ndarray, size: int = SIZE) -> Features:
    """The points of a panorama ``(H, W, 3)`` uint8, from views of `size` pixels; none in a blank picture.

    Raises `ImageError`, and `MissingExtraError` without OpenCV.
    """
    return Views.of(panorama, size).features


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


# --- optical flow ---


def corners_of(views: Views) -> tuple[np.ndarray, ...]:
    """Points ``(n, 1, 2)`` of each view that can be followed, float32; few or none in a plain picture."""
    import cv2

    found = []
    for index, picture in enumerate(views.pictures):
        most, least = (CORNERS, QUALITY) if views.whole else (0, FAINT)
        points = cv2.goodFeaturesToTrack(picture, most, least, APART)
        if points is None:
            points = np.empty((0, 1, 2), np.float32)
        if not views.whole:
            points = points[_in_tiles(points[:, 0], picture.shape, CORNERS_TILE)]
        found.append(points[views.seen(index, points[:, 0])[1]])
    return tuple(found)


def steadied(panorama: np.ndarray, views: Views, old_R_new: np.ndarray) -> Views:
    """Views of a panorama that look where `views` did, if the camera has turned by `old_R_new` ``(3, 3)`` since."""
    grids = tuple(replace(grid, body_R_view=old_R_new.T @ grid.body_R_view) for grid in views.grids)
    return Views.of(panorama, grids=grids)


def warped(new: Views, old: Views, old_R_new: np.ndarray) -> Views:
    """An ordinary camera's picture `new` as it would be where `old` was taken, if it has turned by `old_R_new` since.

    What `old` shows and `new` does not is made up.
    """
    import cv2

    (own,), (picture,), (grid,) = new.grids, new.pictures, old.grids
    there = replace(grid, body_R_view=old_R_new.T @ grid.body_R_view)
    (y, down), (x, across) = map(_nodes, grid.shape)
    u, v, _ = own.project(there.unproject(x, y[:, None]))
    column, row = (down @ (table - 0.5).astype(np.float32) @ across.T for table in (u, v))
    seen = cv2.remap(picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Views((there,), (seen,), own)


@lru_cache(maxsize=8)
def _nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates ``(n,)`` about every `COARSE` pixels, and weights ``(count, n)`` of them at all pixels."""
    centres = np.arange(count) + 0.5
    nodes = np.linspace(0.5, count - 0.5, max(2, -(-count // COARSE) + 1))
    columns = [np.interp(centres, nodes, row) for row in np.eye(len(nodes))]
    return nodes, np.stack(columns, axis=1).astype(np.float32)


def overlap(new: Views, old: Views, old_R_new: np.ndarray) -> float:
    """The share of `new` that `old` shows as well, if the camera has turned by `old_R_new` ``(3, 3)`` between them."""
    if old.whole:
        return 1.0
    rays = new.grids[0].resized(PROBES, PROBES).directions @ old_R_new.T
    return float(old.grids[0].project(rays)[2].mean())


def followed(old: Views, corners: tuple[np.ndarray, ...], new: Views) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(m, 3)`` of `corners` that are found again, each in its own body frame.

    A corner counts if it returns to its place when it is followed back. `new`: steadied or warped views of the same
    size.
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
        to, shown = new.seen(index, moved[good, 0])
        shown |= new.within is None
        here.append(old.seen(index, points[good, 0])[0][shown])
        there.append(to[shown])
    return np.concatenate(here), np.concatenate(there)
