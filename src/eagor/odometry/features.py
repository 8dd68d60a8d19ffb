"""Points of a picture that can be found again: SIFT features to match, and corners to follow by optical flow.

SIFT (Lowe, IJCV 60, 2004) on flat views that cover the sphere, so that neither the seam nor the poles differ from other
places. The picture of an ordinary camera is one such view already: distortion bends directions, not points.

Following corners takes a fiftieth of the work. Pyramidal Lucas-Kanade (Bouguet, Intel 2001) needs things nearly where
they were. So the second picture is laid out as if the camera had stood still, by a guess of its turn: what is left are
errors of the guess, and parallax.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor._checks import checked_picture
from eagor._extras import require_extra
from eagor._values import lazy
from eagor.grids import ErpGrid, PerspectiveGrid, tangent_views

FIELD, SIZE = math.radians(100), 320  # of a view of a panorama, in pixels; six such views cover the sphere
WIDE = 640  # pixels along the longer side of an ordinary picture; larger ones are shrunk
CONTRAST = 0.02  # half of SIFT's usual threshold: dim rooms have few strong points
RATIO = 0.8  # of the distances to the best and the second best descriptor (Lowe 2004, section 7.1)
TILES = (3, 4)  # rows and columns of an ordinary picture that share its points and corners evenly
FEATURES, CORNERS = (400, 80), (56, 20)  # at most, strongest first: of one of six views, of a tile
QUALITY = (0.01, 0.001)  # of the strongest corner: in front of a plain room a thing may be strong
APART = 7.0  # pixels between corners
FLOW = {"winSize": (15, 15), "maxLevel": 3}  # pixels that are compared; pyramid: reaches 8 degrees from the guess
RETURN = 0.5  # pixels that a corner may miss its place by when it is followed back
COARSE = 4  # pixels: where to read a picture is straight between so distant ones
PROBES = 9  # points along each side of a picture at which its overlap with another is found


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

    `grids` in the body frame, and the grey `pictures` ``(H, W)``. `within`: None, or of an ordinary picture that is
    laid out in another grid its own one: only there is something to see.
    """

    grids: tuple[PerspectiveGrid, ...]
    pictures: tuple[np.ndarray, ...]
    within: PerspectiveGrid | None = None

    @classmethod
    def of(cls, picture: np.ndarray, grid: PerspectiveGrid | None = None, size: int = SIZE) -> Views:
        """Views of `size` pixels of a panorama ``(H, W, 3)`` uint8; of an ordinary picture, which has a `grid`, one.

        Raises `ImageError`, and `MissingExtraError` without OpenCV.
        """
        grey = _grey(picture, grid)
        if grid is None:
            return cls._cut(grey, tangent_views(size, FIELD))
        if (by := WIDE / max(grid.shape)) < 1:
            import cv2

            grid = grid.resized(max(1, round(grid.height * by)), max(1, round(grid.width * by)))
            grey = cv2.resize(grey, grid.shape[::-1], interpolation=cv2.INTER_AREA)
        return cls((grid,), (grey,))

    @classmethod
    def _cut(cls, grey: np.ndarray, grids: tuple[PerspectiveGrid, ...]) -> Views:
        """What these grids show of a grey panorama ``(H, W)``."""
        import cv2

        # As fine as the views half way between their middle and their border.
        rows = max(math.ceil(math.pi * grid.focal / math.cos(grid.hfov / 2)) for grid in grids)
        if len(grey) > rows:
            columns = max(2, round(rows * grey.shape[1] / len(grey)))
            grey = cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA)
        sphere, half = ErpGrid(*grey.shape), grey.shape[1] // 2
        canvas = np.concatenate([np.roll(grey[:1], half, 1), grey, np.roll(grey[-1:], half, 1)])  # over the poles
        pictures = []
        for grid in grids:
            x, y, _ = sphere.project(grid.directions)
            column, row = (x - 0.5).astype(np.float32), (y + 0.5).astype(np.float32)
            pictures.append(cv2.remap(canvas, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
        return cls(grids, tuple(pictures))

    def steadied(self, picture: np.ndarray | Views, old_R_new: np.ndarray) -> Views:
        """What a picture, taken after a turn by `old_R_new` ``(3, 3)``, shows where these views look.

        `picture`: a panorama, or the view of an ordinary camera; what that does not show is made up.
        """
        grids = tuple(replace(each, body_R_view=old_R_new.T @ each.body_R_view) for each in self.grids)
        if not isinstance(picture, Views):
            return Views._cut(_grey(picture, None), grids)
        import cv2

        places = picture.grids[0].project(self._nodes @ old_R_new)[:2]
        column, row = (cv2.resize((each - 0.5).astype(np.float32), grids[0].shape[::-1]) for each in places)
        shown = cv2.remap(picture.pictures[0], column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return Views(grids, (shown,), picture.grids[0])

    @lazy
    def _nodes(self) -> np.ndarray:
        """Directions of some pixels of the view."""
        (grid,) = self.grids
        return grid.resized(max(1, grid.height // COARSE), max(1, grid.width // COARSE)).directions

    @property
    def whole(self) -> bool:
        """Whether they cover the sphere."""
        return len(self.grids) > 1

    @lazy
    def area(self) -> float:
        """Steradians that the views show."""
        return 4 * math.pi if self.whole else float(self.grids[0].resized(24, 32).weights.sum())

    @lazy
    def features(self) -> Features:
        """The points of the picture; none in a blank one.

        Views overlap. Each point counts in the view whose axis is nearest, so there are no duplicates.
        """
        import cv2

        detector = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
        directions, descriptors = [np.empty((0, 3))], [np.empty((0, 128), np.float32)]
        for index, picture in enumerate(self.pictures):
            points, found = detector.detectAndCompute(picture, None)
            if found is None or len(points) == 0:
                continue
            order = np.argsort([-point.response for point in points], kind="stable")
            rays, own = self.seen(index, np.array([points[k].pt for k in order]))
            order = order[own]
            chosen = self._strongest(index, np.array([points[k].pt for k in order]), FEATURES)
            directions.append(rays[own][chosen])
            # Square roots of shares: distances between them are Hellinger's (Arandjelovic & Zisserman, CVPR 2012).
            shares = found[order[chosen]] / np.maximum(found[order[chosen]].sum(axis=1, keepdims=True), 1e-12)
            descriptors.append(np.sqrt(shares))
        return Features(np.concatenate(directions), np.concatenate(descriptors))

    @lazy
    def corners(self) -> tuple[np.ndarray, ...]:
        """Points ``(n, 1, 2)`` of each view that can be followed, float32; few or none in a plain picture."""
        import cv2

        found = []
        for index, picture in enumerate(self.pictures):
            points = cv2.goodFeaturesToTrack(picture, CORNERS[0] if self.whole else 0, QUALITY[not self.whole], APART)
            points = np.empty((0, 1, 2), np.float32) if points is None else points
            points = points[self._strongest(index, points[:, 0], CORNERS)]
            found.append(points[self.seen(index, points[:, 0])[1]])
        return tuple(found)

    def _strongest(self, index: int, points: np.ndarray, most: tuple[int, int]) -> np.ndarray:
        """Indices of the first so many of `points` ``(n, 2)`` of a view; of an ordinary picture, of each tile."""
        if self.whole or not len(points):
            return np.arange(min(len(points), most[0]))
        row, column = (points[:, ::-1] * TILES / self.pictures[index].shape).astype(int).T
        tile = row * TILES[1] + column
        return np.sort(np.concatenate([np.flatnonzero(tile == each)[: most[1]] for each in np.unique(tile)]))

    def seen(self, index: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` of OpenCV's `points` ``(n, 2)`` in a view, and whether they count there.

        That is, whether its axis is the nearest one, or whether the picture shows them.
        """
        x, y = points.T.astype(np.float64) + 0.5  # OpenCV counts from the centre of the first pixel
        rays = self.grids[index].unproject(x, y)
        if self.within is not None:
            return rays, self.within.project(rays)[2]
        axes = np.array([grid.body_R_view[:, 0] for grid in self.grids])
        return rays, (rays @ axes.T).argmax(axis=1) == index

    def followed(self, new: Views) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(m, 3)`` of corners that are found again in steadied views, before and after.

        A corner counts if it returns to its place when it is followed back.
        """
        import cv2

        here, there = [np.empty((0, 3))], [np.empty((0, 3))]
        for index, (points, before, now) in enumerate(zip(self.corners, self.pictures, new.pictures, strict=True)):
            if len(points) == 0:
                continue
            moved, ahead, _ = cv2.calcOpticalFlowPyrLK(before, now, points, points.copy(), **FLOW)
            back, behind, _ = cv2.calcOpticalFlowPyrLK(now, before, moved, moved.copy(), **FLOW)
            good = np.logical_and(ahead, behind)[:, 0] & (np.abs(back - points).max(axis=(1, 2)) < RETURN)
            to, shown = new.seen(index, moved[good, 0])
            shown |= new.within is None
            here.append(self.seen(index, points[good, 0])[0][shown])
            there.append(to[shown])
        return np.concatenate(here), np.concatenate(there)

    def overlap(self, new: Views, old_R_new: np.ndarray) -> float:
        """The share of `new` that these show as well, if the camera has turned by `old_R_new` ``(3, 3)`` between."""
        if self.whole:
            return 1.0
        rays = new.grids[0].resized(PROBES, PROBES).directions @ old_R_new.T
        return float(self.grids[0].project(rays)[2].mean())


def _grey(picture: np.ndarray, grid: PerspectiveGrid | None) -> np.ndarray:
    require_extra("finding features in pictures", "photos", "cv2")
    import cv2

    image = checked_picture(picture, "the panorama" if grid is None else "the picture", grid)
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)


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
    second = [np.partition(table, 1, axis=1)[:, 1] for table in (squared[index], squared[:, nearest].T)]
    clear = squared[index, nearest] < np.minimum(*second) * RATIO**2
    return index[clear], nearest[clear]
