"""From a moment's pictures and the answers about them back to the sphere: what a model is shown, and its evidence.

Several pictures of one moment overlap: a panorama and the same rolled by half a turn (the seam of one is the middle of
the other), or tangent views. Things are cut at borders, and models waste attention there; so everywhere the picture
counts most in which a direction lies farthest inside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import EagorError, ResponseError
from eagor.evidence import Evidence
from eagor.evidence.calibration import Calibration
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import ANYWHERE, WHOLE_SPHERE, moments
from eagor.grids import OVERLAP, Grid, PatchGrid, PerspectiveGrid, depth_inside, tangent_views
from eagor.media.panorama import checked_picture, cut, resized
from eagor.perception.things import spread_evidence
from eagor.perception.vlm.answers import Box
from eagor.sphere import angular_distance

SAME = math.radians(5)  # largest distance between two boxes of one small thing; the extent of large things is added
REACH = math.sqrt(3)  # half the width of a box over its standard deviation
_SAMPLES = 3  # along each side of a cell that the responses of views are projected to


@dataclass(frozen=True, eq=False)
class Crop:
    """A picture for the model, with the geometry of `grid`, rolled to the right by the fraction `roll` of its width."""

    image: np.ndarray
    grid: Grid
    roll: float = 0.0


@dataclass(frozen=True, eq=False)
class InferencePlan:
    """What a model is shown of one moment, and how its answers become evidence.

    `combine` makes one response on the cells `cells` from those of the crops ``(h, w)``; `coverage` ``(H, W)``: the
    share of each cell that was shown, None: all. `view`: the ordinary picture that is looked at, None: a panorama.
    """

    crops: tuple[Crop, ...]
    cells: Grid
    combine: Callable[[Sequence[np.ndarray]], np.ndarray]
    coverage: np.ndarray | None = None
    view: PerspectiveGrid | None = None

    @property
    def wrap(self) -> bool:
        """Whether the left and the right edge of the pictures meet."""
        return isinstance(self.crops[0].grid, PatchGrid)

    def evidence(
        self,
        answers: Sequence[list[Box]] | Sequence[np.ndarray],
        detector: DetectorModel | None,
        calibration: Calibration | None,
        stamp: float | None,
        source: Mapping[str, object],
    ) -> Evidence:
        """The evidence of the crops' answers: boxes, which err as `detector` says, or responses ``(h, w)``.

        Raises `EagorError` for a calibration of boxes: they are detections.
        """
        if isinstance(answers[0], np.ndarray):
            response = self.combine([np.asarray(each) for each in answers])
            return Evidence.from_response(response, self.cells, calibration, stamp, self.coverage, source)
        if calibration is not None:
            raise EagorError("a calibration came for boxes, which are detections; wanted detector=DetectorModel(...)")
        pictures = zip(answers, self.crops, strict=True)
        found = fuse_detections(box_detections(boxes, crop.grid, crop.roll) for boxes, crop in pictures)
        if self.view is not None:
            found = [each for each in found if self.view.project(each.direction)[2]]
        parts = [(each.direction, each.covariance, each.score) for each in found]
        scored = any(each.score != 1 for each in found)  # a model that tells none has 1 everywhere
        view = View(self.view or WHOLE_SPHERE)
        return replace(spread_evidence(parts, detector, view, stamp, scored), source=source)


def plan_panorama(panorama: np.ndarray, size: tuple[int, int], cells: tuple[int, int], seam: bool) -> InferencePlan:
    """The whole panorama at `size` (height, width), seen in `cells` (rows, cols); with `seam` also rolled by half."""
    picture, grid = resized(panorama, size, wrap=True), PatchGrid(*cells)
    shift = grid.cols // 2 if seam else 0
    roll = shift / grid.cols
    crops = [Crop(picture, grid)]
    if shift:
        crops.append(Crop(np.roll(picture, shift * (size[1] // grid.cols), axis=1), grid, roll))

    def combine(maps: Sequence[np.ndarray]) -> np.ndarray:
        return merge_seam(maps[0], np.roll(maps[1], -shift, axis=-1), roll) if shift else maps[0]

    return InferencePlan(tuple(crops), grid, combine)


def plan_views(panorama: np.ndarray, side: int, rows: int) -> InferencePlan:
    """Tangent views of `side` pixels that cover the sphere; responses come on a panorama of so many `rows`."""
    views, grid = tangent_views(side), PatchGrid(rows, 2 * rows)
    crops = tuple(Crop(image, view) for image, view in zip(cut(panorama, *views), views, strict=True))
    return InferencePlan(crops, grid, lambda maps: project_to_sphere(maps, views, grid))


def plan_view(image: np.ndarray, grid: PerspectiveGrid, size: tuple[int, int], cells: tuple[int, int]) -> InferencePlan:
    """One ordinary picture with the pixels of `grid`, shown at `size` (height, width), seen in `cells` (rows, cols)."""
    picture, posed, inner = letterbox(image, grid, size)
    coverage = None if inner == size else letterbox_coverage(cells, size, inner)
    crop = Crop(picture, posed)
    return InferencePlan((crop,), posed.resized(*cells), lambda maps: np.broadcast_to(maps[0], cells), coverage, grid)


# --- boxes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Detection:
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

    def same_object(self, other: Detection) -> bool:
        """Whether boxes of two pictures probably show one thing, which one of the pictures may cut off."""
        small, large = sorted((self.size, other.size))
        if large > 3 * small + SAME:
            return False
        return float(angular_distance(self.direction, other.direction)) < math.hypot(SAME, REACH * large)


def box_detections(boxes: Iterable[Box], image: Grid, roll: float = 0.0) -> list[Detection]:
    """The boxes in a picture with the geometry of `image` as directions in the body frame.

    For a whole panorama, `image` is any grid of the whole sphere; `roll`: the fraction of its width by which it was
    rolled to the right. A box all around has no direction and counts everywhere.
    """
    height, width = image.shape
    found = []
    for box in boxes:
        corners = [(box.x0 - roll) * width, box.y0 * height, (box.x1 - roll) * width, box.y1 * height]
        try:
            centre, spread = moments(np.array(corners), image)  # columns continue across the seam
        except ResponseError:  # all around: every `Box` has some area
            centre, spread = np.array([1.0, 0.0, 0.0]), ANYWHERE**2 * np.eye(2)
        view = isinstance(image, PerspectiveGrid)
        depth = float(centre @ image.body_R_view[:, 0]) if view else 1 - abs(box.x0 + box.x1 - 1)
        found.append(Detection(centre, spread, box.score, depth))
    return found


def fuse_detections(pictures: Iterable[Sequence[Detection]]) -> list[Detection]:
    """The things in several pictures, each once: from the picture in which it lies farthest inside."""
    marked = [(each, index) for index, found in enumerate(pictures) for each in found]
    kept: list[tuple[Detection, int]] = []
    for each, index in sorted(marked, key=lambda pair: -pair[0].depth):
        if not any(index != other and each.same_object(earlier) for earlier, other in kept):
            kept.append((each, index))
    return [each for each, _ in kept]


# --- responses --------------------------------------------------------------------------------------------------------


def merge_seam(first: np.ndarray, second: np.ndarray, roll: float = 0.5) -> np.ndarray:
    """One response, float32, from two ``(..., h, w)`` to one panorama, both in the panorama's own frame.

    `second` was seen in the panorama rolled to the right by the fraction `roll` of its width (near 1/2); its columns
    are rolled back already. The weights are sin^2 of half the azimuth from the border; they sum to 1 (after division
    if `roll` is not 1/2).
    """
    fractions = (np.arange(first.shape[-1]) + 0.5) / first.shape[-1]
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (first * share + second * (1 - share)).astype(np.float32)


def project_to_sphere(responses: Sequence[np.ndarray], views: Sequence[PerspectiveGrid], grid: PatchGrid) -> np.ndarray:
    """One response ``(h, w)`` float32 on `grid` from those of views that cover the sphere.

    `responses`: per view the values in [0, 1] of its cells ``(rows, cols)``, which divide the view evenly; a single
    cell covers the whole view. Where views overlap it is the mean, weighted by sin^2 over a margin at each side.
    """
    # Several points per cell: borders of views run through cells, and cells of views may be finer than ours.
    fine = PatchGrid(grid.rows * _SAMPLES, grid.cols * _SAMPLES)
    total, weights = np.zeros(fine.shape), np.zeros(fine.shape)
    for response, view in zip(responses, views, strict=True):
        depth = depth_inside(fine.directions @ view.body_R_view, view.hfov / 2, view.hfov / 2)
        inside = depth > 0
        weight = np.sin(np.clip(depth[inside] / (OVERLAP / 2), 0, 1) * (math.pi / 2)) ** 2
        x, y, _ = view.project(fine.directions[inside])
        total[inside] += weight * bilinear(response[None], x / view.width, y / view.height)[0]
        weights[inside] += weight
    total, share = ((each * fine.weights).reshape(grid.rows, _SAMPLES, grid.cols, _SAMPLES).sum(axis=(1, 3))
                    for each in (total, weights))  # fmt: skip
    return np.clip(total / share, 0, 1).astype(np.float32)


def bilinear(layers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`layers` ``(Q, rows, cols)`` of a view at fractions (x, y) of it; constant beyond the outer centres."""
    from scipy.ndimage import map_coordinates

    places = np.stack([y * layers.shape[1] - 0.5, x * layers.shape[2] - 0.5])
    return np.stack([map_coordinates(layer, places, np.float64, order=1, mode="nearest") for layer in layers])


# --- ordinary pictures ------------------------------------------------------------------------------------------------


def letterbox(
    image: np.ndarray, grid: PerspectiveGrid, size: tuple[int, int]
) -> tuple[np.ndarray, PerspectiveGrid, tuple[int, int]]:
    """A picture of `size` (height, width) with `image` in its middle, its grid, and the rows and columns of `image`.

    The rest has the image's mean colour; stretching to the model's size would distort the view. `grid` describes the
    pixels of `image`. Raises `ImageError`.
    """
    image = checked_picture(image, "the view")
    height, width = size
    scale = min(height / grid.height, width / grid.width)
    # Of the same parity as the whole, so that the middle stays the middle.
    rows, cols = (
        min(whole, max(2 - whole % 2, whole - 2 * round((whole - scale * side) / 2)))
        for whole, side in ((height, grid.height), (width, grid.width))
    )
    picture = np.empty((height, width, 3), dtype=np.uint8)
    picture[:] = np.rint(image.reshape(-1, 3).mean(axis=0)).astype(np.uint8)
    top, left = (height - rows) // 2, (width - cols) // 2
    picture[top : top + rows, left : left + cols] = resized(image, (rows, cols))
    if grid.optics is None:
        hfov = 2 * math.atan(width / (2 * scale * grid.focal))
        return picture, PerspectiveGrid(height, width, hfov, grid.body_R_view), (rows, cols)
    inner = grid.resized(rows, cols).lens
    centre = inner.centre[0] + left, inner.centre[1] + top
    return picture, PerspectiveGrid.of_lens(replace(inner, size=(width, height), centre=centre)), (rows, cols)


def letterbox_coverage(shape: tuple[int, int], size: tuple[int, int], inner: tuple[int, int]) -> np.ndarray:
    """The fraction of each cell ``(h, w)`` of a picture of `size` that lies in the middle part of `inner` pixels."""
    shares = []
    for count, whole, part in zip(shape, size, inner, strict=True):
        edges = np.clip(np.arange(count + 1) * (whole / count), (whole - part) / 2, (whole + part) / 2)
        shares.append(np.diff(edges) * (count / whole))
    return np.minimum(shares[0][:, None] * shares[1], 1.0)
