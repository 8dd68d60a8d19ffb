"""One pass over the image for all questions: each question runs only its own tokens on a copy of the cache.

The image precedes the question and attention is causal, so keys and values up to the image are the same for all.

The attention of the question's last token is captured on the way. A registered attention function runs scaled
dot-product attention. In chosen layers it also computes one row: the softmax of the last query over all keys, and keeps
the image's part. It never builds a whole attention matrix.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from transformers import AttentionInterface, AttentionMaskInterface
from transformers.integrations.sdpa_attention import sdpa_attention_forward
from transformers.masking_utils import sdpa_mask

from eagor.errors import EagorError
from eagor.perception.transformers.inputs import Prompt, typed
from eagor.perception.vlm import Family

NAME = "eagor_rows"
_ATTRIBUTE = "_eagor_capture"


@dataclass
class Decoded:
    """Generated token ids and their natural log probabilities, one list per image."""

    ids: list[list[int]]
    log_probabilities: list[list[float]]


@dataclass
class Run:
    """Keys and values of a batch of prompts so far.

    `columns`: positions ``(n,)`` of the image tokens, empty without images. `position`: of the next token; with
    two-dimensional rotary positions that is not the number of tokens so far. None if the model counts by itself.
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
        ids = ids.expand(self.batch, -1).to(self.columns.device)
        positions = {}
        if self.position is not None:
            steps = torch.arange(ids.shape[1], device=ids.device) + self.position
            positions["position_ids"] = steps.expand(3, self.batch, -1)
            self.position += ids.shape[1]
        out = self.model(input_ids=ids, cache=self.cache, use_cache=True, logits_to_keep=1, **positions)
        return out.logits[:, -1].float()

    def ask(self, ids: torch.Tensor, layers: Sequence[int]) -> tuple[torch.Tensor, dict[int, torch.Tensor]]:
        """Feed a question ``(1, T)``: logits of the answer's first token, the last token's attention in `layers`."""
        if not layers:
            return self.feed(ids), {}
        with capturing(self.model, layers, self.columns) as capture:
            return self.feed(ids), capture.rows

    def decode(self, logits: torch.Tensor, most: int, stops: Sequence[int]) -> Decoded:
        """Greedy decoding of at most `most` tokens, until all images have met one of `stops`.

        `logits` are those of the first token, ``(B, V)``. The stop token is not part of the answer.
        """
        answer = Decoded([[] for _ in range(self.batch)], [[] for _ in range(self.batch)])
        going = [True] * self.batch
        for step in range(most):
            best = logits.argmax(dim=-1)
            chosen = logits.log_softmax(dim=-1).gather(-1, best[:, None])[:, 0].tolist()
            for row, (token, log) in enumerate(zip(best.tolist(), chosen, strict=True)):
                going[row] = going[row] and token not in stops
                if going[row]:
                    answer.ids[row].append(token)
                    answer.log_probabilities[row].append(log)
            if not any(going) or step == most - 1:
                break
            logits = self.feed(best[:, None])
        return answer


def share(
    model: Any, family: Family, prompt: Prompt, tensors: Mapping[str, torch.Tensor], batch: int, image_token: int
) -> Run:
    """Run a prompt up to its last image, for `batch` prompts with images of the same sizes.

    `tensors` are those of all images, prompt by prompt; empty without images.
    """
    ids = prompt.prefix.expand(batch, -1).to(model.device)
    feed: dict[str, Any] = {name: tensor.to(model.device) for name, tensor in tensors.items()}
    if "pixel_values" in feed:
        feed["pixel_values"] = feed["pixel_values"].to(model.dtype)
    feed |= {"input_ids": ids, **typed(family, ids, image_token)}
    position = None
    if family.type_ids == "mm_token_type_ids":
        grid = feed.get("image_grid_thw")
        feed["position_ids"], _ = model.model.get_rope_index(ids, feed["mm_token_type_ids"], image_grid_thw=grid)
        position = int(feed["position_ids"].max()) + 1
    cache = model.model(**feed, use_cache=True).cache
    return Run(model, batch, prompt.columns.to(model.device), position, cache)


# --- attention of the last token --------------------------------------------------------------------------------------


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
    module: torch.nn.Module, query: torch.Tensor, key: torch.Tensor, value: torch.Tensor,
    attention_mask: torch.Tensor | None, **kwargs: Any,
) -> tuple[torch.Tensor, None]:  # fmt: skip
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
    """Within this context, the first pass through each of `layers` records the last token's attention to `columns`."""
    attentions = [model.model.language_model.layers[layer].self_attn for layer in layers]
    capture = Capture(columns)
    for attention in attentions:
        setattr(attention, _ATTRIBUTE, capture)
    try:
        yield capture
    finally:
        for attention in attentions:
            delattr(attention, _ATTRIBUTE)
