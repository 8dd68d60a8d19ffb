"""From answers about pictures back to the sphere: boxes as detections or as bumps, several responses as one.

Several pictures of one moment overlap: a panorama and the same rolled by half a turn (the seam of one is the middle of
the other), or tangent views. Things are cut at borders, and models waste attention there; so everywhere the picture
counts most in which a direction lies farthest inside.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import ANYWHERE, MIN_SPREAD, bump, moments
from eagor.grids import OVERLAP, Grid, PatchGrid, PerspectiveGrid, depth_inside
from eagor.media.panorama import checked_picture, resized
from eagor.perception.things import spread_evidence
from eagor.perception.vlm.answers import Box
from eagor.sphere import angular_distance

SAME = math.radians(5)  # largest distance between two boxes of one small thing; the extent of large things is added
REACH = math.sqrt(3)  # half the width of a box over its standard deviation
WHOLE = 0.95  # coverage from which on a direction counts as fully seen


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

    def is_same(self, other: Detection) -> bool:
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


def things(boxes: Sequence[Box], image: Grid, roll: float = 0.0) -> list[Detection]:
    """The boxes in a picture as directions in the body frame; `image` and `roll` as in `moments_of`."""
    found = []
    for box in boxes:
        centre, spread = moments_of(box, image, roll) or (np.array([1.0, 0.0, 0.0]), ANYWHERE**2 * np.eye(2))
        if isinstance(image, PerspectiveGrid):
            depth = float(centre @ image.body_R_view[:, 0])
        else:
            depth = 1 - abs(box.x0 + box.x1 - 1)
        found.append(Detection(centre, spread, box.score, depth))
    return found


def united(pictures: Iterable[Sequence[Detection]]) -> list[Detection]:
    """The things in several pictures, each once: from the picture in which it lies farthest inside."""
    marked = [(thing, index) for index, found in enumerate(pictures) for thing in found]
    kept: list[tuple[Detection, int]] = []
    for thing, index in sorted(marked, key=lambda pair: -pair[0].depth):
        if not any(index != other and thing.is_same(earlier) for earlier, other in kept):
            kept.append((thing, index))
    return [thing for thing, _ in kept]


def detected(
    found: Sequence[Detection],
    model: DetectorModel | None,
    grid: Grid,
    stamp: float | None,
    coverage: np.ndarray | None = None,
    source: Mapping[str, object] | None = None,
) -> Evidence:
    """The evidence of `found` within `grid`, as far as `coverage` ``(H, W)`` says (None: all of it)."""
    seen = None if coverage is None or bool((coverage >= WHOLE).all()) else coverage
    parts = [(thing.direction, thing.covariance, thing.score) for thing in found]
    scored = any(thing.score != 1 for thing in found)  # a model that tells none has 1 everywhere
    return replace(spread_evidence(parts, model, View(grid, seen), stamp, scored), source=source)


# --- boxes as responses -----------------------------------------------------------------------------------------------


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


# --- the seam ---------------------------------------------------------------------------------------------------------


def merged(first: np.ndarray, second: np.ndarray, roll: float = 0.5) -> np.ndarray:
    """One response, float32, from two ``(..., h, w)`` to one panorama, both in the panorama's own frame.

    `second` was seen in the panorama rolled to the right by the fraction `roll` of its width (near 1/2); its columns
    are rolled back already. The weights are sin^2 of half the azimuth from the border; they sum to 1 (after division
    if `roll` is not 1/2).
    """
    fractions = (np.arange(first.shape[-1]) + 0.5) / first.shape[-1]
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (first * share + second * (1 - share)).astype(np.float32)


# --- tangent views ----------------------------------------------------------------------------------------------------

_SAMPLES = 3  # along each side of a cell that responses are lifted to


def framed(
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


def filled(shape: tuple[int, int], size: tuple[int, int], inner: tuple[int, int]) -> np.ndarray:
    """The fraction of each cell ``(h, w)`` of a picture of `size` that lies in the middle part of `inner` pixels."""
    shares = []
    for count, whole, part in zip(shape, size, inner, strict=True):
        edges = np.clip(np.arange(count + 1) * (whole / count), (whole - part) / 2, (whole + part) / 2)
        shares.append(np.diff(edges) * (count / whole))
    return np.minimum(shares[0][:, None] * shares[1], 1.0)


def lift(
    responses: Sequence[np.ndarray], views: Sequence[PerspectiveGrid], grid: PatchGrid, margin: float = OVERLAP / 2
) -> tuple[np.ndarray, np.ndarray]:
    """One response on the sphere from one ``(Q, rows, cols)`` per view, and its coverage.

    Args:
        responses: per view the values in [0, 1] of its cells, which divide the view evenly; a single cell covers the
            whole view.
        views: their poses.
        grid: the cells of the result.
        margin: radians at each side of a view over which its weight rises from 0 to 1 (as sin^2).

    Returns the response ``(Q, h, w)`` float32, the weighted mean where views overlap, and the coverage ``(h, w)`` in
    [0, 1], the weight of the view that sees the cell best. Where coverage is 0 nothing was seen (response 0): pass it
    to `Evidence.from_response`. Raises `ResponseError` if the responses do not fit the views.
    """
    arrays = [np.asarray(response) for response in responses]
    if len(arrays) != len(views) or not arrays:
        raise ResponseError(f"there are {len(arrays)} responses for {len(views)} views; wanted one each, one at least")
    if any(array.ndim != 3 or array.shape[0] != arrays[0].shape[0] or array.size == 0 for array in arrays):
        shapes = sorted({array.shape for array in arrays})
        raise ResponseError(f"responses of views have shapes {shapes}; wanted (queries, rows, cols), queries alike")
    # Several points per cell: borders of views run through cells, and cells of views may be finer than ours.
    fine = PatchGrid(grid.rows * _SAMPLES, grid.cols * _SAMPLES)
    total = np.zeros((arrays[0].shape[0], *fine.shape))
    weights, coverage = np.zeros(fine.shape), np.zeros(fine.shape)
    for array, view in zip(arrays, views, strict=True):
        half_height = math.atan(math.tan(view.hfov / 2) * view.height / view.width)
        depth = depth_inside(fine.directions @ view.body_R_view, view.hfov / 2, half_height)
        inside = depth > 0
        rise = np.clip(depth[inside] / margin, 0, 1) if margin > 0 else 1.0
        weight = np.sin(rise * (math.pi / 2)) ** 2
        x, y, _ = view.project(fine.directions[inside])
        total[:, inside] += weight * bilinear(array, x / view.width, y / view.height)
        weights[inside] += weight
        coverage[inside] = np.maximum(coverage[inside], weight)
    solid = fine.weights * weights
    shape = (grid.rows, _SAMPLES, grid.cols, _SAMPLES)
    share = solid.reshape(shape).sum(axis=(1, 3))
    summed = (total * fine.weights).reshape(-1, *shape).sum(axis=(2, 4))
    response = np.divide(summed, share, out=np.zeros_like(summed), where=share > 0)
    seen = (coverage * fine.weights).reshape(shape).sum(axis=(1, 3)) / grid.weights
    return np.clip(response, 0, 1).astype(np.float32), np.clip(seen, 0, 1)


def bilinear(layers: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`layers` ``(Q, rows, cols)`` of a view at fractions (x, y) of it; constant beyond the outer centres."""
    rows, cols = layers.shape[1:]
    u, v = np.clip(x * cols - 0.5, 0, cols - 1), np.clip(y * rows - 0.5, 0, rows - 1)
    left, top = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    right, below = np.minimum(left + 1, cols - 1), np.minimum(top + 1, rows - 1)
    across, down = u - left, v - top
    upper = layers[:, top, left] * (1 - across) + layers[:, top, right] * across
    lower = layers[:, below, left] * (1 - across) + layers[:, below, right] * across
    return upper * (1 - down) + lower * down
