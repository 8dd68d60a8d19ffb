"""From a moment's pictures and the answers about them back to the sphere: what a model is shown, and its evidence.

Several pictures of one moment overlap: a panorama and the same rolled by half a turn (the seam of one is the middle of
the other), or tangent views. Things are cut at borders, and models waste attention there; so everywhere the picture
counts most in which a direction lies farthest inside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from eagor.errors import ResponseError
from eagor.evidence.shapes import ANYWHERE, moments
from eagor.grids import OVERLAP, Grid, PatchGrid, PerspectiveGrid, depth_inside, tangent_views
from eagor.media.panorama import checked_picture, cut, resized
from eagor.perception.vlm.answers import Box
from eagor.sphere import angular_distance

SAME = math.radians(5)  # largest distance between two boxes of one small thing; the extent of large things is added
REACH = math.sqrt(3)  # half the width of a box over its standard deviation
_SAMPLES = 3  # along each side of a cell that the responses of views are projected to


class Crop(NamedTuple):
    """A picture for the model, with the geometry of `grid`, rolled to the right by the fraction `roll` of its width."""

    image: np.ndarray
    grid: Grid
    roll: float = 0.0


@dataclass(frozen=True, eq=False)
class InferencePlan:
    """What a model is shown of one moment.

    `combine` makes one response on the cells `cells` from those of the crops ``(h, w)``; `coverage` ``(H, W)``: the
    share of each cell that was shown, None: all. `view`: the ordinary picture that is looked at, None: a panorama.
    """

    crops: tuple[Crop, ...]
    cells: Grid
    combine: Callable[[Sequence[np.ndarray]], np.ndarray]
    coverage: np.ndarray | None = None
    view: PerspectiveGrid | None = None


def plan_panorama(panorama: np.ndarray, size: tuple[int, int], cells: tuple[int, int], seam: bool) -> InferencePlan:
    """The whole panorama at `size` (height, width), seen in `cells` (rows, cols); with `seam` also rolled by half."""
    picture, grid = resized(panorama, size, wrap=True), PatchGrid(*cells)
    shift = grid.cols // 2 if seam else 0
    if not shift:
        return InferencePlan((Crop(picture, grid),), grid, lambda maps: maps[0])
    roll = shift / grid.cols
    rolled = Crop(np.roll(picture, shift * (size[1] // grid.cols), axis=1), grid, roll)

    def combine(maps: Sequence[np.ndarray]) -> np.ndarray:
        return merge_seam(maps[0], np.roll(maps[1], -shift, axis=-1), roll)

    return InferencePlan((Crop(picture, grid), rolled), grid, combine)


def plan_views(panorama: np.ndarray, side: int, rows: int) -> InferencePlan:
    """Tangent views of `side` pixels that cover the sphere; responses come on a panorama of so many `rows`."""
    views, grid = tangent_views(side), PatchGrid(rows, 2 * rows)
    crops = tuple(map(Crop, cut(panorama, *views), views))
    return InferencePlan(crops, grid, lambda maps: project_to_sphere(maps, views, grid))


def plan_view(image: np.ndarray, grid: PerspectiveGrid, size: tuple[int, int], cells: tuple[int, int]) -> InferencePlan:
    """One ordinary picture with the pixels of `grid`, in the middle of one of `size` (height, width), in whole `cells`.

    The rest has the image's mean colour; stretching to the model's size would distort the view. Raises `ImageError`.
    """
    image = checked_picture(image, "the view")
    height, width = size
    scale = min(height / grid.height, width / grid.width)
    # Of the same parity as the whole, so that the middle stays the middle.
    rows, cols = (
        min(whole, max(2 - whole % 2, whole - 2 * round((whole - scale * side) / 2)))
        for whole, side in ((height, grid.height), (width, grid.width))
    )
    top, left = (height - rows) // 2, (width - cols) // 2
    inner = slice(top, top + rows), slice(left, left + cols)
    picture, shown = np.empty((height, width, 3), dtype=np.uint8), np.zeros(size)
    picture[:], shown[inner] = np.rint(image.reshape(-1, 3).mean(axis=0)), 1
    picture[inner] = resized(image, (rows, cols))
    posed = PerspectiveGrid(height, width, 2 * math.atan(width / (2 * scale * grid.focal)), grid.body_R_view)
    if grid.optics is not None:
        lens = grid.resized(rows, cols).lens
        centre = lens.centre[0] + left, lens.centre[1] + top
        posed = PerspectiveGrid.of_lens(replace(lens, size=(width, height), centre=centre))
    coverage = None if (rows, cols) == size else shown.reshape(cells[0], -1, cells[1], width // cells[1]).mean((1, 3))
    crop = Crop(picture, posed)
    return InferencePlan((crop,), posed.resized(*cells), lambda maps: np.broadcast_to(maps[0], cells), coverage, grid)


# --- boxes ------------------------------------------------------------------------------------------------------------


class Detection(NamedTuple):
    """The direction of a box: mean ``(3,)``, covariance ``(2, 2)`` about it (radians^2), and score.

    `depth`: distance from the border of its picture, where things are cut off; larger is farther inside.
    """

    direction: np.ndarray
    covariance: np.ndarray
    score: float
    depth: float

    def same_object(self, other: Detection) -> bool:
        """Whether boxes of two pictures probably show one thing, which one of the pictures may cut off."""
        small, large = sorted(math.sqrt(float(np.trace(each.covariance)) / 2) for each in (self, other))
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
