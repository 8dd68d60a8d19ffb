"""The places of a field on the sphere: which part of it belongs to which of its peaks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor.belief.basins import climbed
from eagor.belief.field import LARGEST, SphereField, cells_of


@dataclass(frozen=True, eq=False)
class Places:
    """The basins of a field, numbered from 0 to `count` - 1.

    Of its `cells` ``(H, W)``, and of its `patches` ``(n,)``: each is one place, that of the cell below its peak.
    """

    count: int
    cells: np.ndarray
    patches: np.ndarray

    @classmethod
    def of(cls, field: SphereField, labels: tuple[int, np.ndarray]) -> Places:
        """With the `labels` of the cells."""
        grid, (count, cells) = field.grid, labels
        tops = [patch.directions.reshape(-1, 3)[int(patch.values.argmax())] for patch in field.patches]
        return cls(count, cells, cells.reshape(-1)[cells_of(grid, np.array(tops).reshape(-1, 3))])


def labelled(values: np.ndarray) -> tuple[int, np.ndarray]:
    """The number of basins of a field ``(H, W)``, and that of each cell ``(H, W)``: each climbs to its peak."""
    label = climbed(values).reshape(-1)
    there = np.zeros(len(label), dtype=bool)
    there[label] = True
    return int(there.sum()), (np.cumsum(there) - 1)[label].reshape(values.shape)


def log_sums(field: SphereField, places: Places) -> np.ndarray:
    """log of the integral ``(m,)`` of exp(field) over each of the places."""
    log, weight, _ = field.nodes
    of_patches = [np.full(patch.values.size, home) for patch, home in zip(field.patches, places.patches, strict=True)]
    home = np.concatenate([places.cells.reshape(-1)[field.free], *of_patches])
    top = np.full(places.count, -np.inf)
    np.maximum.at(top, home, log)
    top = np.clip(top, -LARGEST, None)  # a place may lie under patches of other places
    sums = np.bincount(home, np.exp(log - top[home]) * weight, minlength=places.count)
    return np.log(np.maximum(sums, math.exp(-LARGEST))) + top
