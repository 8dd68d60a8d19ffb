"""Captures the attention of the last token while the model runs as usual.

A registered attention function runs scaled dot-product attention. In chosen layers it also computes one row: the
softmax of the last query over all keys, and keeps the image's part. It never builds a whole attention matrix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from transformers import AttentionInterface, AttentionMaskInterface
from transformers.integrations.sdpa_attention import sdpa_attention_forward
from transformers.masking_utils import sdpa_mask

from eagor.errors import EagorError

NAME = "eagor_rows"
_ATTRIBUTE = "_eagor_capture"


@dataclass
class Capture:
    """The captured attention. `rows`: layer to the last token's attention ``(B, H, n)`` float32 to keys `columns`.

    Only the first pass of each layer is recorded: inside ``generate()`` that is the prompt's.
    """

    columns: torch.Tensor
    rows: dict[int, torch.Tensor] = field(default_factory=dict)

    def record(
        self, layer: int, query: torch.Tensor, key: torch.Tensor, mask: torch.Tensor | None, scale: float | None
    ) -> None:
        """Keep the last query's attention; `query` ``(B, H, T, d)``, `key` ``(B, G, S, d)`` with H a multiple of G."""
        if layer in self.rows:
            return
        batch, heads, _, width = query.shape
        groups, keys = key.shape[1], key.shape[2]
        if keys <= int(self.columns[-1]):
            raise EagorError(
                f"layer {layer} sees {keys} keys, fewer than the prompt has: a layer with a sliding window. Choose "
                "layers of full attention"
            )
        last = query[:, :, -1].reshape(batch, groups, heads // groups, width).float()
        scores = torch.einsum("bgqd,bgkd->bgqk", last, key.float()).reshape(batch, heads, keys)
        scores = scores * (1 / math.sqrt(width) if scale is None else scale)
        if mask is not None:
            row = mask[:, :, -1, :keys]
            scores = scores.masked_fill(~row, -math.inf) if row.dtype == torch.bool else scores + row.float()
        self.rows[layer] = scores.softmax(dim=-1)[..., self.columns.to(scores.device)]


def _attend(
    module: torch.nn.Module,
    query: torch.Tensor,
    key: torch.Tensor,
    value: torch.Tensor,
    attention_mask: torch.Tensor | None,
    **kwargs: Any,
) -> tuple[torch.Tensor, None]:
    """Scaled dot-product attention that also keeps the row which `capturing` asks for."""
    capture: Capture | None = getattr(module, _ATTRIBUTE, None)
    if capture is not None:
        layer: Any = module.layer_idx
        capture.record(int(layer), query, key, attention_mask, kwargs.get("scaling"))
    return sdpa_attention_forward(module, query, key, value, attention_mask, **kwargs)


def prepare(model: Any) -> None:
    """Route the language part of `model` through the registered function; results stay those of sdpa."""
    AttentionInterface.register(NAME, _attend)
    AttentionMaskInterface.register(NAME, sdpa_mask)
    model.set_attn_implementation({"text_config": NAME})


def full_layers(model: Any) -> list[int]:
    """The layers of the language part that see the whole prompt (no sliding window)."""
    text = model.config.get_text_config()
    kinds = getattr(text, "layer_types", None) or ["full_attention"] * text.num_hidden_layers
    return [layer for layer, kind in enumerate(kinds) if kind == "full_attention"]


@contextmanager
def capturing(model: Any, layers: Sequence[int], columns: torch.Tensor) -> Iterator[Capture]:
    """Within this context, the first pass through each of `layers` records the last token's attention to `columns`.

    Raises `EagorError` for a layer that does not exist or has a sliding window.
    """
    possible = full_layers(model)
    wrong = sorted(set(layers) - set(possible))
    if wrong or not layers:
        raise EagorError(f"layers {list(layers)} were asked for; layers of full attention here are {possible}")
    attentions = [model.model.language_model.layers[layer].self_attn for layer in layers]
    capture = Capture(columns)
    for attention in attentions:
        setattr(attention, _ATTRIBUTE, capture)
    try:
        yield capture
    finally:
        for attention in attentions:
            delattr(attention, _ATTRIBUTE)
