"""Responses from captured attention.

With localisation heads (`eagor.perception.transformers.heads`) the map is the attention of a few heads, relative to
uniform attention. Without them it is relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): attention for the
question over attention for a question without content. That removes attention sinks, the background tokens that get
attention whatever is asked (Kang et al., arXiv 2503.03321).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from eagor.perception.transformers.layout import Layout

SATURATION = 2.0  # excess of the ratio over 1 at which the response is one half


def mean_over_heads(rows: Mapping[int, torch.Tensor], layout: Layout) -> np.ndarray:
    """Attention per cell ``(B, h, w)``, the mean over all captured layers and heads."""
    total = sum(tensor.mean(dim=1).cpu().numpy().astype(np.float64) for tensor in rows.values())
    return layout.cells(np.asarray(total) / len(rows))


def of_heads(rows: Mapping[int, torch.Tensor], heads: Sequence[tuple[int, int]], layout: Layout) -> np.ndarray:
    """Mean attention ``(B, h, w)`` of some (layer, head), each first scaled to a mean of 1 over the cells."""
    maps = [layout.cells(rows[layer][:, head].cpu().numpy().astype(np.float64)) for layer, head in heads]
    return np.mean([densities(one) for one in maps], axis=0)


def densities(cells: np.ndarray) -> np.ndarray:
    """`cells` ``(..., h, w)`` divided by their mean; ones where they are all zero."""
    mean = cells.mean(axis=(-2, -1), keepdims=True)
    return np.where(mean > 0, cells / np.where(mean > 0, mean, 1.0), 1.0)


def relative(asked: np.ndarray, general: np.ndarray) -> np.ndarray:
    """The ratio ``(B, h, w)`` of two attention maps; 1 where the question makes no difference.

    The median of the general map is added to both, since the plain ratio explodes where nothing gets attention.
    """
    floor = np.median(general, axis=(-2, -1), keepdims=True)
    floor = np.maximum(floor, np.finfo(np.float32).tiny)
    return (asked + floor) / (general + floor)


def saturated(ratio: np.ndarray, saturation: float = SATURATION, wrap: bool = True) -> np.ndarray:
    """A response in [0, 1), float32, from a ratio ``(..., h, w)``: x / (x + saturation) for an excess x over 1.

    The scale is fixed. Scaling by the map's own maximum would turn "nothing here" into a detection. The ratio is
    blurred over 3 x 3 cells first; `wrap` if the left and right edge meet.
    """
    excess = np.maximum(blurred(ratio, wrap) - 1.0, 0.0)
    return (excess / (excess + saturation)).astype(np.float32)


def blurred(cells: np.ndarray, wrap: bool = True) -> np.ndarray:
    """`cells` ``(..., h, w)`` filtered with the binomial kernel (1 2 1) / 4 each way."""
    flat = [(0, 0)] * (cells.ndim - 2)
    wide = np.pad(cells, [*flat, (0, 0), (1, 1)], mode="wrap" if wrap else "edge")
    across = (wide[..., :-2] + 2 * cells + wide[..., 2:]) / 4
    tall = np.pad(across, [*flat, (1, 1), (0, 0)], mode="edge")
    return (tall[..., :-2, :] + 2 * across + tall[..., 2:, :]) / 4
