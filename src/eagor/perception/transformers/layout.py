"""Where the image tokens of a model look: blocks of tokens in windows of the image, summed on one grid of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._lazy import lazy


@dataclass(frozen=True)
class Block:
    """Rows and columns of tokens, row by row, that cover a window of the image.

    `window`: left, top, right, bottom as fractions of the image; it may extend beyond it (padding).
    """

    rows: int
    cols: int
    window: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    @property
    def count(self) -> int:
        """Number of tokens."""
        return self.rows * self.cols


@dataclass(frozen=True)
class Layout:
    """The blocks of an image in the order of its tokens, and the grid of cells ``(h, w)`` over the whole image."""

    shape: tuple[int, int]
    blocks: tuple[Block, ...]

    @property
    def count(self) -> int:
        """Number of image tokens."""
        return sum(block.count for block in self.blocks)

    @lazy
    def _shares(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Per block, the share of each row of tokens in each row of cells ``(h, rows)``, and the same for columns."""
        height, width = self.shape
        found = []
        for block in self.blocks:
            left, top, right, bottom = block.window
            found.append((_overlap(height, block.rows, top, bottom), _overlap(width, block.cols, left, right)))
        return tuple(found)

    def cells(self, tokens: np.ndarray) -> np.ndarray:
        """Token values ``(..., count)``, spread evenly over their windows, as sums over cells ``(..., h, w)``."""
        tokens = np.asarray(tokens)
        if tokens.shape[-1] != self.count:
            raise ValueError(f"{tokens.shape[-1]} values came for {self.count} image tokens")
        if self.blocks == (Block(*self.shape),):  # tokens are cells
            return tokens.reshape(*tokens.shape[:-1], *self.shape)
        total, start = np.zeros((*tokens.shape[:-1], *self.shape), dtype=tokens.dtype), 0
        for block, (down, across) in zip(self.blocks, self._shares, strict=True):
            part = tokens[..., start : start + block.count].reshape(*tokens.shape[:-1], block.rows, block.cols)
            total += (down @ part @ across.T).astype(tokens.dtype)
            start += block.count
        return total


def _overlap(cells: int, tokens: int, start: float, end: float) -> np.ndarray:
    """The share ``(cells, tokens)`` of each of `tokens` equal parts of [start, end] in each of `cells` of [0, 1]."""
    token = start + (end - start) * np.arange(tokens + 1) / tokens
    cell = np.arange(cells + 1) / cells
    common = np.minimum(cell[1:, None], token[None, 1:]) - np.maximum(cell[:-1, None], token[None, :-1])
    return np.where(common > 1e-12, common, 0.0) * (tokens / (end - start))
