"""How well the lenses of a rig agree where two of them see the same; and the picture that shows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from eagor.media.cameras.rig import Rig
from eagor.media.cameras.sightings import pairs_of, points_of
from eagor.media.cameras.stitching import Stitcher

__all__ = ["Overlap", "overlap_of", "with_seam"]

GATE = math.radians(6.0)  # between the two rays of a thing; farther apart, it is probably two things
COLOURS = ((60, 200, 255), (255, 170, 40), (140, 255, 120), (255, 110, 220))  # of the lenses' rims
LINE = 1 / 400  # of the picture's rows: width of a rim


@dataclass(frozen=True, eq=False)
class Overlap:
    """The error where lenses overlap.

    `share` of the sphere that two lenses see. `gaps` ``(n,)``: angles between the rays of things that both see,
    radians. `grey`: the mean difference in grey levels (of 255); None if nothing overlaps.
    """

    share: float
    gaps: np.ndarray
    grey: float | None


def overlap_of(rig: Rig, pictures: Sequence[np.ndarray], rows: int | None = None) -> Overlap:
    """Measure it in the `pictures` ``(H, W, 3)`` uint8 of one moment. Needs OpenCV. Raises `ImageError`."""
    sizes = tuple((picture.shape[1], picture.shape[0]) for picture in pictures)
    rig = rig.scaled(rig.factor_of(sizes, "the picture"))
    stitcher = Stitcher(rig, rows)
    views = [stitcher.alone(index, *pictures) for index in range(len(rig.lenses))]
    total, levels = 0.0, 0.0
    weights = stitcher.grid.weights
    seen_twice = np.sum([seen for _, seen in views], axis=0) > 1
    for (a, sees_a), (b, sees_b) in combinations(views, 2):
        both = sees_a & sees_b
        difference = np.abs(a[both].astype(np.float64).mean(axis=1) - b[both].astype(np.float64).mean(axis=1))
        levels += float(difference @ weights[both])
        total += float(weights[both].sum())
    area = float(weights[seen_twice].sum()) / (4 * math.pi)
    if len(rig.lenses) < 2:
        return Overlap(0.0, np.empty(0), None)
    pairs = pairs_of(rig, points_of(rig, [tuple(pictures)], lambda: None), np.eye(3)[None], GATE, turned=False)
    rays = np.empty((len(pairs), 2, 3))
    for index, lens in enumerate(rig.lenses):
        for side in (0, 1):
            mine = pairs.lenses[:, side] == index
            rays[mine, side] = lens.unproject(*pairs.pixels[mine, side].T)
    gaps = np.linalg.norm(rays[:, 0] - rays[:, 1], axis=1)
    return Overlap(area, gaps, levels / total if total else None)


def with_seam(rig: Rig, pictures: Sequence[np.ndarray], rows: int | None = None) -> np.ndarray:
    """The stitched panorama over a map of the lenses' difference, ``(2 rows, 2 rows, 3)`` uint8.

    Above, each lens' rim is drawn in its colour: between two rims both see the same. Below, the difference of the
    lenses in grey levels, from black (none) to white (64 or more); what one lens alone sees is dark blue.
    """
    sizes = tuple((picture.shape[1], picture.shape[0]) for picture in pictures)
    rig = rig.scaled(rig.factor_of(sizes, "the picture"))
    stitcher = Stitcher(rig, rows)
    shown = stitcher.stitch(*pictures)
    views = [stitcher.alone(index, *pictures) for index in range(len(rig.lenses))]
    below = np.zeros_like(shown)
    below[:] = (12, 16, 40)
    for (a, sees_a), (b, sees_b) in combinations(views, 2):
        both = sees_a & sees_b
        difference = np.abs(a[both].astype(np.int16).mean(axis=1) - b[both].astype(np.int16).mean(axis=1))
        below[both] = np.clip(4 * difference, 0, 255).astype(np.uint8)[:, None]
    width = max(1, round(LINE * shown.shape[0]))
    for index, (_, seen) in enumerate(views):
        shown[_border(seen, width)] = COLOURS[index % len(COLOURS)]
    return np.concatenate([shown, below])


def _border(seen: np.ndarray, width: int) -> np.ndarray:
    """The inner border of a region of a panorama, so many pixels wide; around the seam too."""
    from scipy import ndimage

    tiled = np.pad(seen, ((1 + width, 1 + width), (0, 0)), mode="edge")
    tiled = np.pad(tiled, ((0, 0), (1 + width, 1 + width)), mode="wrap")
    inner = ndimage.binary_erosion(tiled, np.ones((3, 3), bool), iterations=width)
    crop = slice(1 + width, -1 - width)
    return seen & np.logical_not(inner[crop, crop])
