"""Extended things: the connected regions of a response map, their evidence, and a blur against lone cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eagor.evidence import Evidence
from eagor.evidence.detections import View
from eagor.evidence.detector import DetectorModel
from eagor.evidence.shapes import box_samples, moments_of
from eagor.grids import ErpGrid, Grid, PatchGrid, PerspectiveGrid
from eagor.perception.things import ViewBox, opened


def blobs(response: np.ndarray, grid: Grid, level: float, least: float) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Mean direction, covariance and mean response of each connected region of a map ``(H, W)`` that reaches `level`.

    Regions cross the seam of a panorama and its poles (the cells of the first row touch, and those of the last). Those
    whose integral of the response is below `least` (steradians) are left out. The covariance ``(2, 2)`` (radians^2) is
    about the mean direction; a region all around the sphere gets the widest possible.

    The border of an ordinary picture cuts what it meets: as a box does (`eagor.perception.things`), a region goes on
    there by an unknown length, as dense as in its box.
    """
    around = isinstance(grid, ErpGrid | PatchGrid)
    labels = connected(response >= level, around, poles=around).reshape(-1)
    where = np.flatnonzero(labels)
    order = where[np.argsort(labels[where], kind="stable")]
    ends = np.cumsum(np.bincount(labels[where])[1:])
    directions, areas, values = grid.directions.reshape(-1, 3), grid.weights.reshape(-1), response.reshape(-1)
    found = []
    for cells in np.split(order, ends[:-1]) if len(order) else ():
        weights = areas[cells] * values[cells]
        if weights.sum() >= least:
            beyond, more = _beyond(cells, float(weights.sum()), grid)
            points, masses = np.concatenate([directions[cells], beyond]), np.concatenate([weights, more])
            centre, spread = moments_of(points, masses)
            found.append((centre, spread, float(weights.sum() / areas[cells].sum())))
    return found


def _beyond(cells: np.ndarray, mass: float, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Where a region of these `cells` may go on outside of its picture: directions ``(n, 3)``, their weights ``(n,)``.

    `mass`: the integral of the response in it. None (n = 0) if no border cuts it.
    """
    nothing = np.zeros((0, 3)), np.zeros(0)
    if not isinstance(grid, PerspectiveGrid):
        return nothing
    rows, columns = np.divmod(cells, grid.width)
    left, top, right, bottom = columns.min(), rows.min(), columns.max(), rows.max()
    box = np.array([left, top, right + 1, bottom + 1], dtype=np.float64)
    piece = ViewBox(0, grid, box, 1.0, near=0.0)
    if not piece.cut.any():
        return nothing
    at_side = np.array([columns == left, rows == top, columns == right, rows == bottom])
    chords = at_side.sum(axis=1) / np.tile([bottom + 1 - top, right + 1 - left], 2)
    points, areas = box_samples(opened(piece, [piece], chords), piece.plane)
    outside = ~grid.project(points)[2]
    return points[outside], areas[outside] * mass / piece.samples[1].sum()


def spread_evidence(
    found: Sequence[tuple[np.ndarray, np.ndarray, float]],
    model: DetectorModel | None,
    view: View,
    stamp: float | None = None,
) -> Evidence:
    """The evidence of detections (mean direction, covariance, score) in `view`, widened by the spread of `model`."""
    scores = np.array([score for _, _, score in found])
    return Evidence.from_moments([(centre, spread) for centre, spread, _ in found], scores, view, model, stamp)


def connected(inside: np.ndarray, seam: bool, poles: bool = False) -> np.ndarray:
    """A label for each cell ``(H, W)``: the number of its connected region, 0 outside. Diagonal neighbours connect.

    With `seam` the last column touches the first; with `poles` all cells of the first row touch, and all of the last.
    """
    from scipy.ndimage import label
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    counted: Any = label(inside, structure=np.ones((3, 3), dtype=int))
    labels, count = counted
    if not seam or count < 2:
        return labels
    left, right = labels[:, 0], labels[:, -1]
    pairs = [(left, right), (left[1:], right[:-1]), (left[:-1], right[1:])]
    for row in (labels[0], labels[-1]) if poles else ():
        met = row[row > 0]
        pairs.append((met[:-1], met[1:]))
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    touching = (one > 0) & (other > 0)
    graph = coo_array((np.ones(int(touching.sum())), (one[touching], other[touching])), shape=(count + 1, count + 1))
    parts = connected_components(graph, directed=False)[1]
    # The background is a component of its own and has to keep label 0.
    return np.where(labels > 0, ((parts - parts[0]) % (int(parts.max()) + 1))[labels], 0)


def blurred(cells: np.ndarray, wrap: bool = True) -> np.ndarray:
    """`cells` ``(..., h, w)`` filtered with the binomial kernel (1 2 1) / 4 each way."""
    flat = [(0, 0)] * (cells.ndim - 2)
    wide = np.pad(cells, [*flat, (0, 0), (1, 1)], mode="wrap" if wrap else "edge")
    across = (wide[..., :-2] + 2 * cells + wide[..., 2:]) / 4
    tall = np.pad(across, [*flat, (1, 1), (0, 0)], mode="edge")
    return (tall[..., :-2, :] + 2 * across + tall[..., 2:, :]) / 4
