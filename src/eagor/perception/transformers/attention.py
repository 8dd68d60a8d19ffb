"""From captured attention to a response on the cells.

With localisation heads (`eagor.perception.transformers.heads`) the attention of a few heads is the map, in multiples of
an even spread. Without them, relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): the attention for the
question over that for a question of no content, which removes the background tokens that soak up attention whatever is
asked (Kang et al., arXiv 2503.03321).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from eagor.perception.transformers.layout import Layout

SATURATION = 2.0  # by how much a ratio exceeds 1 where the response is one half


def mean_over_heads(rows: Mapping[int, torch.Tensor], layout: Layout) -> np.ndarray:
    """Attention ``(B, h, w)`` per cell, the mean over all captured layers and heads."""
    total = sum(tensor.mean(dim=1).cpu().numpy().astype(np.float64) for tensor in rows.values())
    return layout.cells(np.asarray(total) / len(rows))


def of_heads(rows: Mapping[int, torch.Tensor], heads: Sequence[tuple[int, int]], layout: Layout) -> np.ndarray:
    """Attention ``(B, h, w)`` of some (layer, head), each scaled to a mean of 1 over the cells, and their mean."""
    maps = [layout.cells(rows[layer][:, head].cpu().numpy().astype(np.float64)) for layer, head in heads]
    return np.mean([densities(one) for one in maps], axis=0)


def densities(cells: np.ndarray) -> np.ndarray:
    """`cells` ``(..., h, w)`` as multiples of their mean; ones where they are all zero."""
    mean = cells.mean(axis=(-2, -1), keepdims=True)
    return np.where(mean > 0, cells / np.where(mean > 0, mean, 1.0), 1.0)


def relative(asked: np.ndarray, general: np.ndarray) -> np.ndarray:
    """The ratio ``(B, h, w)`` of two attention maps, 1 where the question made no difference.

    Both carry a floor, the median of the general map, since the bare ratio explodes where nothing looks.
    """
    floor = np.median(general, axis=(-2, -1), keepdims=True)
    floor = np.maximum(floor, np.finfo(np.float32).tiny)
    return (asked + floor) / (general + floor)


def saturated(ratio: np.ndarray, saturation: float = SATURATION, wrap: bool = True) -> np.ndarray:
    """A response in [0, 1), float32, from a ratio ``(..., h, w)``: x / (x + saturation) for an excess x over 1.

    The scale is fixed, never the map's own maximum, which would turn "nothing here" into a detection. The ratio is
    blurred over 3 x 3 cells first; `wrap` where left and right meet.
    """
    excess = np.maximum(blurred(ratio, wrap) - 1.0, 0.0)
    return (excess / (excess + saturation)).astype(np.float32)


def blurred(cells: np.ndarray, wrap: bool = True) -> np.ndarray:
    """`cells` ``(..., h, w)`` under the binomial kernel (1 2 1) / 4 each way."""
    flat = [(0, 0)] * (cells.ndim - 2)
    wide = np.pad(cells, [*flat, (0, 0), (1, 1)], mode="wrap" if wrap else "edge")
    across = (wide[..., :-2] + 2 * cells + wide[..., 2:]) / 4
    tall = np.pad(across, [*flat, (1, 1), (0, 0)], mode="edge")
    return (tall[..., :-2, :] + 2 * across + tall[..., 2:, :]) / 4
