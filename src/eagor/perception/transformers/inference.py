"""One pass over the image for all questions: each question runs only its own tokens on a copy of the cache.

The image precedes the question and attention is causal, so keys and values up to the image are the same for all.

The attention of the question's last token is captured on the way. A registered attention function runs scaled
dot-product attention. In chosen layers it also computes one row: the softmax of the last query over all keys, and keeps
the image's part. It never builds a whole attention matrix.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import torch
from transformers import AttentionInterface, AttentionMaskInterface
from transformers.integrations.sdpa_attention import sdpa_attention_forward
from transformers.masking_utils import sdpa_mask

NAME = "eagor_rows"
_ATTRIBUTE = "_eagor_rows"

Rows = dict[int, torch.Tensor]  # layer to the last token's attention (B, H, n) float32 to the image tokens
Decoded = list[list[tuple[int, float]]]  # per image the tokens of the answer with their natural log probabilities


@dataclass
class Run:
    """Keys and values of a batch of prompts so far.

    `columns`: positions ``(n,)`` of the image tokens. `position`: of the next token; with two-dimensional rotary
    positions that is not the number of tokens so far. None if the model counts by itself.
    """

    model: Any
    batch: int
    columns: torch.Tensor
    position: int | None
    cache: Any

    def branch(self) -> Run:
        """A run that goes on from here and leaves this one as it is."""
        return replace(self, cache=copy.deepcopy(self.cache))

    def feed(self, ids: torch.Tensor) -> torch.Tensor:
        """Run tokens ``(B, T)`` (or ``(1, T)``, the same for all images); logits ``(B, V)`` float32 of the next."""
        ids, positions = ids.expand(self.batch, -1).to(self.columns.device), {}
        if self.position is not None:
            steps = torch.arange(ids.shape[1], device=ids.device) + self.position
            positions["position_ids"] = steps.expand(3, self.batch, -1)
            self.position += ids.shape[1]
        out = self.model(input_ids=ids, cache=self.cache, use_cache=True, logits_to_keep=1, **positions)
        return out.logits[:, -1].float()

    def ask(self, ids: torch.Tensor, layers: Sequence[int]) -> tuple[torch.Tensor, Rows]:
        """Feed a question ``(1, T)``: logits of the answer's first token, the last token's attention in `layers`."""
        with capturing(self.model, layers, self.columns) as rows:
            return self.feed(ids), rows

    def decode(self, logits: torch.Tensor, most: int, stops: Sequence[int]) -> Decoded:
        """Greedy decoding of at most `most` tokens, until all images have met one of `stops`, which is left out.

        `logits` are those of the first token, ``(B, V)``.
        """
        answers: Decoded = [[] for _ in range(self.batch)]
        going = [True] * self.batch
        for step in range(most):
            best = logits.argmax(dim=-1)
            logs = logits.log_softmax(dim=-1).gather(-1, best[:, None])[:, 0].tolist()
            for row, pair in enumerate(zip(best.tolist(), logs, strict=True)):
                going[row] = going[row] and pair[0] not in stops
                answers[row] += [pair] * going[row]
            if not any(going) or step == most - 1:
                break
            logits = self.feed(best[:, None])
        return answers


# --- attention of the last token --------------------------------------------------------------------------------------


def last_row(
    query: torch.Tensor, key: torch.Tensor, mask: torch.Tensor | None, scale: float | None, columns: torch.Tensor
) -> torch.Tensor:
    """The last query's attention ``(B, H, n)`` to the keys `columns`.

    `query` ``(B, H, T, d)``, `key` ``(B, G, S, d)`` with H a multiple of G.
    """
    batch, heads, _, width = query.shape
    groups, keys = key.shape[1], key.shape[2]
    last = query[:, :, -1].reshape(batch, groups, heads // groups, width).float()
    scores = torch.einsum("bgqd,bgkd->bgqk", last, key.float()).reshape(batch, heads, keys)
    scores = scores * (1 / math.sqrt(width) if scale is None else scale)
    if mask is not None:
        row = mask[:, :, -1, :keys]
        scores = scores.masked_fill(~row, -math.inf) if row.dtype == torch.bool else scores + row.float()
    return scores.softmax(dim=-1)[..., columns.to(scores.device)]


def _attend(
    module: Any, query: torch.Tensor, key: torch.Tensor, value: torch.Tensor, attention_mask: torch.Tensor | None,
    **kwargs: Any,
) -> tuple[torch.Tensor, None]:  # fmt: skip
    """Scaled dot-product attention that also keeps the row which `capturing` asks for."""
    rows, columns = getattr(module, _ATTRIBUTE, (None, None))
    if rows is not None and columns is not None and module.layer_idx not in rows:
        rows[module.layer_idx] = last_row(query, key, attention_mask, kwargs.get("scaling"), columns)
    return sdpa_attention_forward(module, query, key, value, attention_mask, **kwargs)


AttentionInterface.register(NAME, _attend)
AttentionMaskInterface.register(NAME, sdpa_mask)


def full_layers(model: Any) -> list[int]:
    """The layers of the language part that see the whole prompt (no sliding window)."""
    text = model.config.get_text_config()
    kinds = getattr(text, "layer_types", None) or ["full_attention"] * text.num_hidden_layers
    return [layer for layer, kind in enumerate(kinds) if kind == "full_attention"]


@contextmanager
def capturing(model: Any, layers: Sequence[int], columns: torch.Tensor) -> Iterator[Rows]:
    """Within this context, the first pass through each of `layers` records the last token's attention to `columns`."""
    attentions, rows = [model.model.language_model.layers[layer].self_attn for layer in layers], {}
    for attention in attentions:
        setattr(attention, _ATTRIBUTE, (rows, columns))
    try:
        yield rows
    finally:
        for attention in attentions:
            delattr(attention, _ATTRIBUTE)
