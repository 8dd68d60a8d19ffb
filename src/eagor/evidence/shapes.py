"""From a box or a mask in an image to a bump about a direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eagor.errors import ResponseError
from eagor.evidence.detections import tangent_frame
from eagor.grids import FisheyeGrid, Grid, PatchGrid, PerspectiveGrid

CELL = math.radians(2)  # cell size of the grid on which boxes and points of a panorama are drawn
WHOLE_SPHERE = PatchGrid(90, 180)
MIN_SPREAD = math.radians(4)  # least standard deviation of a box's middle


def canvas_of(grid: Grid) -> Grid:
    """The grid on which detections are drawn: the whole sphere for a panorama, else a coarse copy of the view."""
    if isinstance(grid, FisheyeGrid):
        return replace(grid, size=min(grid.size, math.ceil(grid.fov / CELL)))
    if not isinstance(grid, PerspectiveGrid):
        return WHOLE_SPHERE
    if grid.width <= 96:
        return grid
    # Square pixels at the same field of view: the width whose matching height is nearest to a whole number.
    ratio = grid.height / grid.width
    width = min(range(48, 97), key=lambda w: abs(w * ratio - round(w * ratio)) / (w * ratio) if w * ratio >= 1 else 1.0)
    return grid.resized(max(1, round(width * ratio)), width)


def moments(box: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of a box's solid angle and its covariance ``(2, 2)`` about it in the tangent plane."""
    height, width = grid.shape
    x0, y0, x1, y1 = box
    seam = not hasattr(grid, "body_R_view")
    if seam and x1 < x0:
        x1 += width
    y0, y1 = max(y0, 0.0), min(y1, float(height))
    if not seam:
        x0, x1 = max(x0, 0.0), min(x1, float(width))
    if not (np.isfinite(box).all() and x1 > x0 and y1 > y0 and x1 - x0 <= width):
        raise _no_area(box, grid)
    points, areas = box_samples((x0, y0, x1, y1), grid)
    if float(np.linalg.norm(areas @ points)) < 1e-9 * areas.sum():
        raise ResponseError(f"box {box.tolist()} spans the whole sphere, so it has no direction")
    return moments_of(points, areas)


def check_on_picture(box: np.ndarray, grid: Grid) -> None:
    """Raise `ResponseError` for a box beside a panorama, or in fractions of the picture."""
    x0, _, x1, _ = box
    if are_fractions(box) or (not hasattr(grid, "body_R_view") and is_beside(x0, x1, grid.shape[1])):
        raise _no_area(box, grid)


def _no_area(box: np.ndarray, grid: Grid) -> ResponseError:
    height, width = grid.shape
    return ResponseError(
        f"box {box.tolist()} has no area inside the {width} x {height} image; wanted x0, y0, x1, y1 in its pixels "
        "(not x, y, width, height, and not 0 to 1)"
    )


def are_fractions(boxes: np.ndarray, beyond: float = 0.0) -> bool:
    """Whether boxes ``(n, 4)`` seem to be in fractions of the picture: all lie in its first pixel.

    `beyond`: the part of the picture by which some may lie outside of it.
    """
    inside = boxes.size > 0 and boxes.min() >= -beyond and boxes.max() <= 1 + beyond
    return bool(inside and (boxes != np.round(boxes)).any())


def is_beside(x0: float, x1: float, width: float) -> bool:
    """Whether a box from column x0 to x1 does not touch a panorama of this width; x0 > x1 crosses the seam."""
    return x0 >= width or max(x0, x1) <= 0


def box_samples(box: Sequence[float] | np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``(n, 3)`` that fill a box, and their solid angles ``(n,)``: Gauss-Legendre nodes along each side."""
    x0, y0, x1, y1 = box
    nodes, weights = np.polynomial.legendre.leggauss(12)
    x = x0 + (x1 - x0) * (nodes + 1) / 2
    y = (y0 + (y1 - y0) * (nodes + 1) / 2)[:, None]
    areas = grid.density(x, y) * weights * weights[:, None] * ((x1 - x0) * (y1 - y0) / 4)
    return grid.unproject(x, y).reshape(-1, 3), areas.reshape(-1)


def bump(directions: np.ndarray, centre: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """exp(-d^2 / 2) with d the Mahalanobis distance in the tangent plane at `centre`."""
    offsets = _tangent(directions, centre)
    return np.exp(-0.5 * np.einsum("...k,kl,...l->...", offsets, np.linalg.inv(spread), offsets))


def mask_moments(mask: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of a mask's solid angle and its covariance ``(2, 2)`` about it in the tangent plane."""
    points, areas = grid.directions[mask], grid.weights[mask]
    if float(np.linalg.norm(areas @ points)) < 1e-9 * areas.sum():
        raise ResponseError("a mask spans the whole sphere, so it has no direction; wanted the pixels of one thing")
    return moments_of(points, areas)


ANYWHERE = 1e4  # standard deviation (radians) of something that is all around and has no direction


def moments_of(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean direction ``(3,)`` of weighted directions ``(n, 3)``, and their covariance ``(2, 2)`` about it.

    If they are spread evenly all around, there is no mean direction and the covariance is `ANYWHERE` squared.
    """
    middle = weights @ points
    length = float(np.linalg.norm(middle))
    if length < 1e-9 * weights.sum():
        return np.array([1.0, 0.0, 0.0]), ANYWHERE**2 * np.eye(2)
    offsets = _tangent(points, middle / length)
    return middle / length, np.einsum("i,ik,il->kl", weights, offsets, offsets) / weights.sum()


def widened(mask: np.ndarray, grid: Grid, spread: float) -> np.ndarray:
    """A mask ``(H, W)`` as a response; if it is narrower than a bump of `spread` (radians), that bump is added."""
    points, areas = grid.directions[mask], grid.weights[mask]
    middle = areas @ points
    length = np.linalg.norm(middle)
    if spread <= 0 or length < 1e-9 * areas.sum() or not len(points):
        return mask
    centre = middle / length
    if areas @ (_tangent(points, centre) ** 2).sum(axis=-1) > 2 * spread**2 * areas.sum():
        return mask
    return np.maximum(mask, np.exp((grid.directions @ centre - 1) / spread**2))


def _tangent(directions: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Coordinates ``(..., 2)`` (radians) of directions in the tangent plane at `centre`: length is the angle."""
    plane = directions @ tangent_frame(centre).T
    across = np.linalg.norm(plane, axis=-1)
    angle = np.arctan2(across, directions @ centre)
    return plane * (angle / np.maximum(across, 1e-12))[..., None]
