"""The cells of a horizontal grid that triangles between two heights touch, and the height of the floor.

Exact and conservative: a triangle is clipped to the slab and projected, and a cell counts if its square meets the
projection (separating axes). So neither a thin wall nor a chair leg falls between samples. A face exactly between two
cells, as walls on round numbers, counts for the one behind it.
"""

from __future__ import annotations

import numpy as np

_INWARD = 1e-3  # in cells: shift of a face to its back
_TOUCH = 1e-4  # in cells: smaller overlaps do not count, to be safe from rounding
_AT_ONCE = 400_000  # candidate cells tested together; bounds the memory


def touched(
    corners: np.ndarray, low: float, high: float, origin: np.ndarray, cell: float, shape: tuple[int, int]
) -> np.ndarray:
    """Cells ``(rows, cols)`` bool that the part of the triangles with low < z < high touches.

    `corners` ``(n, 3, 3)`` metres; `origin` ``(2,)``: the low corner of cell (0, 0); rows along y, columns along x.
    """
    mask = np.zeros(shape, dtype=bool)
    z = corners[:, :, 2]
    bottom, top = z.min(axis=1), z.max(axis=1)
    flat = top - bottom < 1e-9
    meets = np.where(flat, (bottom > low) & (bottom < high), (top > low) & (bottom < high))
    inside = meets & (bottom >= low) & (top <= high)
    whole, cut = (_in_cells(corners[chosen], origin, cell) for chosen in (inside, meets & ~inside))
    _mark(mask, whole[:, :, :2])
    _mark(mask, _clip(_clip(cut, low, 1.0), -high, -1.0)[:, :, :2])
    return mask


def level_triangles(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which triangles ``(n, 3, 3)`` are level within 45 degrees, which look up, and their areas."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(normal, axis=1)
    return (np.abs(normal[:, 2]) > 0.7071 * double) & (double > 0), normal[:, 2] > 0, double / 2


def floor_height(corners: np.ndarray, level: np.ndarray, upward: np.ndarray, area: np.ndarray) -> float:
    """0 if there is a floor at 0, otherwise the height of the lowest large level surface."""
    chosen = level & upward if (level & upward).any() else level
    if not chosen.any():
        return 0.0
    heights, areas = corners[chosen][:, :, 2].mean(axis=1), area[chosen]
    levels, bins = np.unique(np.round(heights / 0.05), return_inverse=True)
    total = np.bincount(bins, weights=areas)
    large = levels[total >= 0.5 * total.max()]
    if 0 in large:
        return 0.0
    within = levels[bins] == large[0]
    return float(np.average(heights[within], weights=areas[within]))


def _in_cells(corners: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """Triangles with x and y in cells, z in metres, shifted a little to their back."""
    corners = corners.astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    inward = _INWARD * normal[:, :2] / np.where(length > 0, length, 1.0)
    corners[:, :, :2] = (corners[:, :, :2] - origin) / cell - inward[:, None]
    return corners


def _clip(polygons: np.ndarray, limit: float, sign: float) -> np.ndarray:
    """The parts ``(n, k + 1, 3)`` with sign z >= limit of convex polygons ``(n, k, 3)``; the last corner repeats."""
    count, sides = polygons.shape[:2]
    if count == 0:
        return np.zeros((0, sides + 1, 3))
    height = sign * polygons[:, :, 2] - limit
    following = np.roll(height, -1, axis=1)
    inside = height >= 0
    crossing = inside != (following >= 0)
    step = np.where(crossing, height - following, 1.0)
    share = (height / step)[:, :, None]
    between = polygons + share * (np.roll(polygons, -1, axis=1) - polygons)
    # Sutherland and Hodgman: every edge gives its start if that is inside, then its crossing. Valid ones go first.
    points = np.stack([polygons, between], axis=2).reshape(count, 2 * sides, 3)
    valid = np.stack([inside, crossing], axis=2).reshape(count, 2 * sides)
    order = np.argsort(~valid, axis=1, kind="stable")[:, : sides + 1]
    last = np.clip(valid.sum(axis=1) - 1, 0, sides)
    order = np.take_along_axis(order, np.minimum(np.arange(sides + 1), last[:, None]), axis=1)
    return np.take_along_axis(points, order[:, :, None], axis=1)[valid.any(axis=1)]


def _mark(mask: np.ndarray, polygons: np.ndarray) -> None:
    """Mark the cells that convex polygons ``(n, k, 2)``, in cells, touch."""
    rows, cols = mask.shape
    limit = np.array([cols, rows])
    first = np.floor(polygons.min(axis=1) + _TOUCH)
    last = np.maximum(first, np.floor(polygons.max(axis=1) - _TOUCH))
    near = ((last >= 0) & (first < limit)).all(axis=1)
    polygons = polygons[near]
    first = np.clip(first[near], 0, limit - 1).astype(np.int64)
    size = np.clip(last[near], 0, limit - 1).astype(np.int64) - first + 1
    # A polygon within one row or one column of cells touches all cells of its box.
    simple = (size == 1).any(axis=1)
    _each_cell(mask, first[simple], size[simple], None)
    _each_cell(mask, first[~simple], size[~simple], polygons[~simple])


def _each_cell(mask: np.ndarray, first: np.ndarray, size: np.ndarray, polygons: np.ndarray | None) -> None:
    ends = np.cumsum(size[:, 0] * size[:, 1])
    start = 0
    while start < len(first):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _AT_ONCE, side="right")))
        width, height = size[start:stop, 0], size[start:stop, 1]
        counts = width * height
        owner = np.repeat(np.arange(stop - start), counts)
        local = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        col = first[start:stop, 0][owner] + local % width[owner]
        row = first[start:stop, 1][owner] + local // width[owner]
        if polygons is not None:
            met = _meets(polygons[start:stop], owner, col + 0.5, row + 0.5)
            col, row = col[met], row[met]
        mask[row, col] = True
        start = stop


def _meets(polygons: np.ndarray, owner: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whether the unit square about (x, y) meets polygon `owner`: no edge normal separates the two."""
    met = np.ones(len(owner), dtype=bool)
    for side in range(polygons.shape[1]):
        edge = np.roll(polygons, -1, axis=1)[:, side] - polygons[:, side]
        length = np.hypot(edge[:, 0], edge[:, 1])
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1) / np.where(length > 1e-12, length, 1.0)[:, None]
        normal[length <= 1e-12] = 0.0  # a repeated corner separates nothing
        along = np.einsum("nkj,nj->nk", polygons, normal)
        half = 0.5 * np.abs(normal).sum(axis=1) - _TOUCH * (length > 1e-12)
        low, high = along.min(axis=1) - half, along.max(axis=1) + half
        place = x * normal[owner, 0] + y * normal[owner, 1]
        met &= (place >= low[owner]) & (place <= high[owner])
    return met
