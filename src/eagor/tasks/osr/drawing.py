"""Places on the floor drawn as the benchmark's layouts, and the likeliest label as the answer.

The labels of OSR-Bench derive from layouts of whole cells, so rounding decides near the border between two answers.
Even with all places known exactly, 19 of 20 published answers (left and right corrected) would be met. So the rounding
is modelled: layouts are drawn along the walls in each of the four orientations (any orientation if no wall is known),
with uncertain places drawn anew each time. The most frequent label is the answer, its share the probability.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eagor.tasks.osr.geometry import FloorLine, Placed
from eagor.tasks.osr.layout import SIZE, named, products, swapped

DRAWS = 16  # for each of the four orientations


@dataclass(frozen=True, eq=False)
class Drawings:
    """Layouts of the same things: `cells` ``(M, n, 2)``, rows and columns of the n things `placed`, mirrored."""

    placed: tuple[Placed, ...]
    cells: np.ndarray

    def directions(self, P: int, O: Sequence[int], Q: Sequence[int]) -> dict[str, float]:
        """The share of each answer, left and right as in the room, for the thing P and the candidates O and Q."""
        start = self.cells[:, P]
        facing, asked = self._nearest(start, O), self._nearest(start, Q)
        signs = np.sign(products(facing.T, asked.T)).astype(int).T
        found: Counter[str] = Counter()
        for (along, aside), count in Counter(map(tuple, signs.tolist())).items():
            found[swapped(named(along, aside))] += count
        del found[""]  # the benchmark leaves such questions out
        total = found.total()
        return {label: count / total for label, count in found.most_common()}

    def nearest(self, P: int, groups: Mapping[str, Sequence[int]]) -> dict[str, float]:
        """The share of layouts in which each of `groups` is the nearest to P (the first of equal ones)."""
        start = self.cells[:, P]
        away = np.stack([(self._nearest(start, members) ** 2).sum(axis=1) for members in groups.values()])
        first = np.bincount(away.argmin(axis=0), minlength=len(groups)) / len(self.cells)
        return dict(zip(groups, first.tolist(), strict=True))

    def _nearest(self, start: np.ndarray, things: Sequence[int]) -> np.ndarray:
        """Steps ``(M, 2)`` to the nearest of the things; of equally near ones to that with the smallest angle."""
        steps = self.cells[:, list(things)] - start[:, None]
        angle = np.arctan2(steps[..., 0], steps[..., 1]) % (2 * math.pi)
        rank = (steps**2).sum(axis=-1) + angle / 7  # squares are whole numbers, so angles only break ties
        return steps[np.arange(len(steps)), rank.argmin(axis=1)]


def draw(placed: Sequence[Placed], walls: FloorLine | None, rng: np.random.Generator, draws: int = DRAWS) -> Drawings:
    """`draws` layouts in each of the four orientations; one each if every place is certain and the walls are known."""
    if not placed:
        return Drawings((), np.zeros((0, 0, 2), dtype=int))
    xy = np.array([each.xy for each in placed])
    spread = np.array([each.spread for each in placed])
    if walls is not None and not spread.any():
        draws = 1
    away = np.maximum(np.hypot(*xy.T), 1e-9)
    # Only ranges have errors: along the ray.
    error = rng.standard_normal((draws, len(placed))) * spread
    moved = xy * np.maximum(1 + error / away, 0.1)[..., None]
    axes = np.full(draws, walls.axis) if walls is not None else rng.uniform(0, math.pi / 2, draws)
    turns = (axes[:, None] + np.arange(4) * math.pi / 2)[..., None]
    x, y = moved[:, None, :, 0], moved[:, None, :, 1]
    ahead, left = np.cos(turns) * x + np.sin(turns) * y, np.cos(turns) * y - np.sin(turns) * x
    points = np.stack([ahead, left], axis=-1).reshape(4 * draws, len(placed), 2)
    return Drawings(tuple(placed), _cells(points, mirror=True))


def layout_from(
    placed: Mapping[str, Sequence[tuple[float, float]]], mirror: bool = False
) -> dict[str, list[list[int]]]:
    """The layout of places (x ahead, y left) on the smallest grid of square cells that holds them all.

    Row 0 is ahead; columns grow to the right, or, with `mirror`, to the left as in the published layouts.
    """
    points = np.array([xy for where in placed.values() for xy in where], dtype=np.float64)
    if not len(points):
        return {}
    each = iter(_cells(points[None], mirror)[0].tolist())
    return {name: [next(each) for _ in where] for name, where in placed.items()}


def _cells(points: np.ndarray, mirror: bool) -> np.ndarray:
    """Rows and columns ``(M, n, 2)`` of points ``(M, n, 2)``, x ahead and y left."""
    x, y = points[..., 0], points[..., 1]
    rows = x.max(axis=1, keepdims=True) - x
    columns = y - y.min(axis=1, keepdims=True) if mirror else y.max(axis=1, keepdims=True) - y
    both = np.stack([rows, columns], axis=-1)
    cell = np.maximum(both.max(axis=(1, 2), keepdims=True), 1e-9) / SIZE
    return np.minimum(both / cell, SIZE - 1).astype(int)
