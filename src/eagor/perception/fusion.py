"""From boxes and regions to things on the sphere: one for each, however many pictures show it.

A box that touches the border of its picture may be only a part of the thing. Its direction is then that of the part,
which for large furniture is tens of degrees off. Where another picture shows the whole thing, that box counts; where
all pictures cut it, the parts are put together; where a cut side stays open, the thing goes on there by an unknown
length. Extended things are the connected regions of a response map.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from eagor._values import lazy
from eagor.errors import ResponseError
from eagor.evidence import Evidence
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import WHOLE_SPHERE, box_samples, moments_of
from eagor.grids import ErpGrid, Grid, PatchGrid, PerspectiveGrid
from eagor.sphere import unit

BORDER = 0.01  # of a view's side
SAME = 0.5  # of the smaller box, where both views look: with more in common, two boxes are of one thing
# The visible part of a thing that is cut at a random place is on average (in the median) half of it.
HIDDEN = 1.0  # of the visible length: by how much a thing goes on behind an open side
# Of the picture: a box that lies farther outside is in the pixels of another one; one that reaches so far may be.
BEYOND, FAR = 0.1, 0.15


class RawDetections(NamedTuple):
    """Boxes ``(n, 4)`` x0, y0, x1, y1 in pixels, scores ``(n,)`` in [0, 1], and n labels, or None where none came."""

    boxes: np.ndarray
    scores: np.ndarray
    labels: list[str] | None = None


class ViewDetections(NamedTuple):
    """What a detector found in one view, before a query chooses: the view, and boxes in its pixels."""

    grid: PerspectiveGrid
    boxes: RawDetections


@dataclass(frozen=True, eq=False)
class ViewBox:
    """A box ``(4,)`` of a view, in its pixels, with its score; the view is number `view` of those that look.

    `near`: a box that ends nearer to the border than this share of a side is cut; detectors are not exact there.
    """

    view: int
    grid: PerspectiveGrid
    box: np.ndarray
    score: float
    near: float = BORDER

    @property
    def cut(self) -> np.ndarray:
        """Which sides ``(4,)`` touch the border of the view: left, top, right, bottom."""
        size = np.array([self.grid.width, self.grid.height])
        near = self.near * size
        return np.concatenate([self.box[:2] <= near, self.box[2:] >= size - near])

    @lazy
    def plane(self) -> PerspectiveGrid:
        """The view without distortion, in whose plane a thing may go on beyond the border; as it is if it has none."""
        lens = self.grid.lens
        return PerspectiveGrid.of_lens(replace(lens, distortion=())) if any(lens.distortion) else self.grid

    def in_plane(self, box: np.ndarray) -> np.ndarray:
        """A box ``(4,)`` of the view as one of `plane`: as far as the middles of its sides."""
        if self.plane is self.grid:
            return np.asarray(box, dtype=np.float64)
        lens, (x0, y0, x1, y1) = self.grid.lens, box
        middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
        right, down = lens.plane(np.array([x0, middle_x, x1, middle_x]), np.array([middle_y, y0, middle_y, y1]))
        x, y = lens.centre[0] + lens.focal[0] * right, lens.centre[1] + lens.focal[1] * down
        return np.array([x[0], y[1], x[2], y[3]])

    @lazy
    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions ``(n, 3)`` in the body frame that fill the box, and their solid angles ``(n,)``."""
        return box_samples(self.box, self.grid)

    def holds(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the directions ``(n, 3)`` lie in the box, and which in the view."""
        x, y, seen = self.grid.project(directions)
        x0, y0, x1, y1 = self.box
        return seen & (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1), seen

    def same_object(self, other: ViewBox) -> bool:
        """Whether it shows the same thing as a box of another view, judged by what both views see."""
        shared, seen = [], []
        for one, two in ((self, other), (other, self)):
            directions, weights = one.samples
            held, visible = two.holds(directions)
            shared.append(float(weights[held].sum()))
            seen.append(float(weights[visible].sum()))
        # A sliver at a border may fall between the samples of the larger box: the smaller one decides then.
        smaller = min((area for area in seen if area > 0), default=0.0)
        return smaller > 0 and max(shared) > SAME * smaller


class SphericalDetection(NamedTuple):
    """A thing on the sphere: mean `direction` ``(3,)``, `covariance` ``(2, 2)`` about it (radians squared), score."""

    direction: np.ndarray
    covariance: np.ndarray
    score: float


def fuse_views(pieces: Sequence[ViewBox]) -> list[SphericalDetection]:
    """One `SphericalDetection` for each group of pieces that show the same, the surest first."""
    groups: list[list[ViewBox]] = []
    for piece in sorted(pieces, key=lambda each: -each.score):
        for group in groups:
            if all(other.view != piece.view for other in group) and any(piece.same_object(other) for other in group):
                group.append(piece)
                break
        else:
            groups.append([piece])
    return [_fused(group) for group in groups]


def _fused(group: Sequence[ViewBox]) -> SphericalDetection:
    """The thing that all pieces of a group show; the first is the surest."""
    score = group[0].score
    for piece in group:
        if not piece.cut.any():
            return SphericalDetection(*moments_of(*piece.samples), score)
    directions, weights = [], []
    for number, piece in enumerate(group):
        found, areas = box_samples(extend_truncated_box(piece, group), piece.plane)
        new = np.ones(len(found), dtype=bool)
        for place, other in enumerate(group):
            held, seen = other.holds(found)
            if place < number:
                new &= ~held  # counted already
            elif place > number:
                new &= held | ~seen  # where another view looks, its box says how far the thing goes
        directions.append(found[new])
        weights.append(areas[new])
    if not sum(len(found) for found in directions):
        return SphericalDetection(*moments_of(*group[0].samples), score)
    return SphericalDetection(*moments_of(unit(np.concatenate(directions)), np.concatenate(weights)), score)


def extend_truncated_box(piece: ViewBox, group: Sequence[ViewBox], chords: np.ndarray | None = None) -> np.ndarray:
    """The box ``(4,)`` of a piece in its plane, longer at each cut side beyond which no other goes on.

    `chords` ``(4,)``: on how much of its length the thing meets each side of the box, if that is known. One that
    narrows towards the border is nearly whole; a sliver that does not is the edge of one as wide as long. With the
    fourth power that is up to 0.39 of the radius too much for a disc that shows half or more.
    """
    x0, y0, x1, y1 = piece.box
    middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
    found = piece.in_plane(piece.box).copy()
    wide, high = found[2:] - found[:2]
    grid, lens = piece.grid, piece.plane.lens
    border = np.abs(piece.in_plane(np.array([0, 0, grid.width, grid.height])) - np.tile(lens.centre, 2))
    beyond = np.array([[x0 - 1, middle_y], [middle_x, y0 - 1], [x1 + 1, middle_y], [middle_x, y1 + 1]])
    for side in np.flatnonzero(piece.cut):
        there = piece.grid.unproject(*beyond[side])[None]
        if any(other is not piece and other.holds(there)[0].any() for other in group):
            continue
        length = HIDDEN * (wide, high)[side % 2]
        if chords is not None:
            length = chords[side] ** 4 * max(length, (high, wide)[side % 2] - (wide, high)[side % 2])
        # A plane stretches without bound towards its horizon: go on by the angle, not by pixels.
        centre, focal = lens.centre[side % 2], lens.focal[side % 2]
        angle = math.atan(border[side] / focal) + min(length / focal, math.radians(60))
        reach = focal * math.tan(min(angle, math.radians(80)))
        before, after = max(found[side] - length, centre - reach), min(found[side] + length, centre + reach)
        found[side] = after if side >= 2 else before
    return found


# --- extended things --------------------------------------------------------------------------------------------------


def blobs(response: np.ndarray, grid: Grid, level: float, least: float) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Mean direction, covariance and mean response of each connected region of a map ``(H, W)`` that reaches `level`.

    Regions cross the seam of a panorama and its poles (the cells of the first row touch, and those of the last). Those
    whose integral of the response is below `least` (steradians) are left out. The covariance ``(2, 2)`` (radians^2) is
    about the mean direction; a region all around the sphere gets the widest possible.

    The border of an ordinary picture cuts what it meets: as a box does (`eagor.perception.fusion`), a region goes on
    there by an unknown length, as dense as in its box.
    """
    labels = connected(response >= level, isinstance(grid, ErpGrid | PatchGrid)).reshape(-1)
    where = np.flatnonzero(labels)
    order = where[np.argsort(labels[where], kind="stable")]
    ends = np.cumsum(np.bincount(labels[where])[1:])
    areas, values = grid.weights.reshape(-1), response.reshape(-1)
    found = []
    for cells in np.split(order, ends[:-1]) if len(order) else ():
        weights = areas[cells] * values[cells]
        mass = float(weights.sum())
        if mass >= least:
            rows, columns = np.divmod(cells, grid.width)
            points, masses = grid.unproject(columns + 0.5, rows + 0.5), weights
            if isinstance(grid, PerspectiveGrid):
                beyond, more = _beyond(rows, columns, mass, grid)
                points, masses = np.concatenate([points, beyond]), np.concatenate([weights, more])
            found.append((*moments_of(points, masses), mass / float(areas[cells].sum())))
    return found


def _beyond(rows: np.ndarray, columns: np.ndarray, mass: float, grid: PerspectiveGrid) -> tuple[np.ndarray, np.ndarray]:
    """Where a region of these cells may go on outside of its picture: directions ``(n, 3)``, their weights ``(n,)``.

    `mass`: the integral of the response in it. None (n = 0) if no border cuts it.
    """
    box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], dtype=np.float64)
    piece = ViewBox(0, grid, box, 1.0, near=0.0)
    if not piece.cut.any():
        return np.zeros((0, 3)), np.zeros(0)
    at_side = np.array([columns == box[0], rows == box[1], columns + 1 == box[2], rows + 1 == box[3]])
    chords = at_side.sum(axis=1) / np.tile((box[2:] - box[:2])[::-1], 2)
    points, areas = box_samples(extend_truncated_box(piece, [piece], chords), piece.plane)
    outside = ~grid.project(points)[2]
    return points[outside], areas[outside] * mass / piece.samples[1].sum()


def spread_evidence(
    found: Sequence[tuple[np.ndarray, np.ndarray, float]],
    model: DetectorModel | None,
    view: View,
    stamp: float | None = None,
    scored: bool = True,
) -> Evidence:
    """The evidence of detections (mean direction, covariance, score) in `view`, widened by the spread of `model`.

    `scored`: whether the scores mean anything.
    """
    scores = np.array([score for _, _, score in found]) if scored else None
    return Evidence.from_moments([(centre, spread) for centre, spread, _ in found], scores, view, model, stamp)


def connected(inside: np.ndarray, around: bool) -> np.ndarray:
    """A label for each cell ``(H, W)``: the number of its connected region, 0 outside. Diagonal neighbours connect.

    `around`: the last column touches the first, all cells of the first row touch, and all of the last.
    """
    from scipy.ndimage import label
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    counted: Any = label(inside, structure=np.ones((3, 3), dtype=int))
    labels, count = counted
    if not around or count < 2:
        return labels
    left, right = labels[:, 0], labels[:, -1]
    poles = [row[row > 0] for row in (labels[0], labels[-1])]
    pairs = [(left, right), (left[1:], right[:-1]), (left[:-1], right[1:]), *((row[:-1], row[1:]) for row in poles)]
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    touching = (one > 0) & (other > 0)
    graph = coo_array((np.ones(int(touching.sum())), (one[touching], other[touching])), shape=(count + 1, count + 1))
    # The background is a component of its own, the first.
    return connected_components(graph, directed=False)[1][labels]


def blurred(cells: np.ndarray, wrap: bool = True) -> np.ndarray:
    """`cells` ``(..., h, w)`` filtered with the binomial kernel (1 2 1) / 4 each way."""
    from scipy.ndimage import correlate1d

    across = correlate1d(cells, [0.25, 0.5, 0.25], axis=-1, mode="wrap" if wrap else "nearest")
    return correlate1d(across, [0.25, 0.5, 0.25], axis=-2, mode="nearest")


def combined(
    seen: Sequence[ViewDetections],
    fit: Collection[str],
    detector: DetectorModel | None = None,
    stamp: float | None = None,
    weighed: Callable[[Sequence[ViewBox]], Sequence[ViewBox]] = lambda pieces: pieces,
) -> Evidence:
    """The evidence of a look from what was `seen` in its views: one view, or several that cover the whole sphere.

    `fit`: the labels that count (`eagor.perception.vocabulary.fitting`); `weighed`: gives their boxes other scores.
    """
    view = View(seen[0].grid if len(seen) == 1 else WHOLE_SPHERE)
    return spread_evidence(fuse_views(weighed(pieces_of(seen, fit))), detector or DetectorModel(), view, stamp)


def pieces_of(seen: Sequence[ViewDetections], fit: Collection[str]) -> list[ViewBox]:
    """The boxes of all views whose labels `fit`."""
    pieces = []
    for number, (grid, (boxes, scores, labels)) in enumerate(seen):
        size = np.array([grid.width, grid.height] * 2, dtype=np.float64)
        for box, score, label in zip(boxes, scores, labels or [None] * len(boxes), strict=True):
            if label is not None and label not in fit:
                continue
            inside = np.clip(box, 0, size)
            if np.abs(inside - box).reshape(2, 2).min(axis=0).max() > BEYOND * size.max():
                raise ResponseError(
                    f"the box {np.round(box, 1).tolist()} lies outside of the {grid.width} x {grid.height} picture; "
                    "wanted its pixels: if the detector resizes pictures, scale its boxes back"
                )
            if (inside[2:] - inside[:2] > 1e-6 * size[:2]).all():
                pieces.append(ViewBox(number, grid, inside, float(score)))
        corners = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
        # Not if they reach as far on the other sides: some detectors guess how things go on behind the border.
        if (corners - size).max(initial=0.0) > FAR * size.max() > -corners.min(initial=0.0):
            text = f"boxes reach far beyond the {grid.width} x {grid.height} picture: are they its pixels? If the "
            warnings.warn(f"{text}detector resizes pictures, scale its boxes back", UserWarning, stacklevel=2)
    return pieces
