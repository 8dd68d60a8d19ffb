"""Which instance each pixel shows: by Habitat's semantic ids, or by boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eagor.worlds.scene import Instance

__all__ = ["BoxLabels", "IdLabels"]

LOOSE = 0.03  # metres by which a box is widened: depth is exact to a centimetre
_CHUNK = 1 << 22  # comparisons of a point with a box at a time


class IdLabels:
    """Labels by Habitat's semantic ids: `place` ``(n,)``, our index (or -1) of each id."""

    raw = True

    def __init__(self, place: np.ndarray) -> None:
        self._place = np.append(place, -1).astype(np.int32)  # the last for ids beyond the table

    def ids(self, semantic: np.ndarray | None, points: np.ndarray | None) -> np.ndarray:
        """The ids ``(H, W)`` int32 of Habitat's `semantic` ``(H, W)``."""
        assert semantic is not None
        return self._place[np.minimum(semantic, len(self._place) - 1).astype(np.intp)]


class BoxLabels:
    """Labels by points: the smallest box that contains a point, -1 if none does."""

    raw = False

    def __init__(self, instances: Sequence[Instance]) -> None:
        size = [float(np.prod(np.maximum(thing.high - thing.low, LOOSE))) for thing in instances]
        self._order = np.argsort(size, kind="stable")
        self._low = np.array([instances[k].low for k in self._order]).reshape(-1, 3) - LOOSE
        self._high = np.array([instances[k].high for k in self._order]).reshape(-1, 3) + LOOSE

    def ids(self, semantic: np.ndarray | None, points: np.ndarray | None) -> np.ndarray:
        """The ids ``(H, W)`` int32 at `points` ``(H, W, 3)``, our world, NaN for no hit."""
        assert points is not None
        flat = points.reshape(-1, 3)
        found = np.full(len(flat), -1, dtype=np.int32)
        if len(self._order) == 0:
            return found.reshape(points.shape[:-1])
        for start in range(0, len(flat), step := max(1, _CHUNK // len(self._order))):
            part = flat[start : start + step, None]
            inside = np.all((part >= self._low) & (part <= self._high), axis=-1)
            first = inside.argmax(axis=1)
            hit = inside[np.arange(len(first)), first]
            found[start : start + step] = np.where(hit, self._order[first], -1)
        return found.reshape(points.shape[:-1])
