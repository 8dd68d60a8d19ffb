"""Rooms that no file holds, for a camera that turns and moves: a box whose walls carry a random pattern."""

from __future__ import annotations

import numpy as np

from eagor.grids import ErpGrid

SIZE = np.array([6.0, 5.0, 2.8])  # metres


class PatternRoom:
    """A box of `SIZE` around the origin with blotches of several sizes on its walls, from a seed."""

    def __init__(self, seed: int, cells: int = 24) -> None:
        random = np.random.default_rng(seed)
        self.faces = [sum((_blotches(random, cells * 2**k) / 2**k for k in range(3)), np.zeros(())) for _ in range(6)]
        most = max(float(face.max()) for face in self.faces)
        self.faces = [face / most * 255 for face in self.faces]

    def panorama(self, world_R_body: np.ndarray, position=(0.0, 0.0, 0.0), rows: int = 256) -> np.ndarray:
        """The picture ``(rows, 2 rows, 3)`` uint8 from a position ``(3,)`` inside the box."""
        rays = ErpGrid(rows, 2 * rows).directions.reshape(-1, 3) @ world_R_body.T
        start, half = np.asarray(position, dtype=float), SIZE / 2
        with np.errstate(divide="ignore"):
            reach = (np.where(rays > 0, half, -half) - start) / rays
        axis = np.abs(reach).argmin(axis=1)
        row = np.arange(len(rays))
        hit = start + rays * np.abs(reach[row, axis])[:, None]
        across = np.stack([hit[row, (axis + 1) % 3], hit[row, (axis + 2) % 3]], axis=1)
        grey = np.empty(len(rays))
        for face, pattern in enumerate(self.faces):
            here = (axis * 2 + (rays[row, axis] > 0)) == face
            grey[here] = _read(pattern, (across[here] / 6.0 + 0.5) * (len(pattern) - 1))
        return np.repeat(np.rint(grey).astype(np.uint8).reshape(rows, 2 * rows, 1), 3, axis=-1)


def _blotches(random: np.random.Generator, cells: int) -> np.ndarray:
    """A pattern ``(384, 384)`` of so many random cells along each edge, smoothed between them."""
    coarse = random.random((cells, cells))
    at = np.linspace(0, cells - 1, 384)
    return _read(coarse, np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1).reshape(-1, 2)).reshape(384, 384)


def _read(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """`values` ``(n, n)`` bilinearly at positions ``(m, 2)``."""
    low = np.clip(np.floor(at).astype(int), 0, len(values) - 2)
    part = at - low
    (i, j), (a, b) = low.T, part.T
    upper = values[i, j] * (1 - b) + values[i, j + 1] * b
    lower = values[i + 1, j] * (1 - b) + values[i + 1, j + 1] * b
    return upper * (1 - a) + lower * a
