"""A vision-language model on images of one size: its attention, and the boxes that it writes.

One pass over the image serves all questions: the image precedes the question and attention is causal, so keys and
values up to the image are the same for all, and each question runs only its own tokens on a copy of the cache.

The attention of the question's last token is captured on the way. A registered attention function runs scaled
dot-product attention. In chosen layers it also computes one row: the softmax of the last query over all keys, and keeps
the image's part. It never builds a whole attention matrix.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from threading import RLock
from typing import Any

import numpy as np
import torch
from transformers import AttentionInterface, AttentionMaskInterface
from transformers.integrations.sdpa_attention import sdpa_attention_forward
from transformers.masking_utils import sdpa_mask

from eagor.errors import EagorError
from eagor.grids import PatchGrid, PerspectiveGrid
from eagor.perception.transformers.heads import SATURATION, Heads, Observed, of_heads, relative, saturated
from eagor.perception.transformers.inputs import InputPlan, Prompt, pictures, plan, prompt, typed
from eagor.perception.vlm import GENERAL, Family, Labelled, ask_presence
from eagor.sources.panorama import cut, resized
from eagor.sphere import unit

NAME = "eagor_rows"
_ATTRIBUTE = "_eagor_rows"

Rows = dict[int, torch.Tensor]  # layer to the last token's attention (B, H, n) float32 to the image tokens
Decoded = list[list[tuple[int, float]]]  # per image the tokens of the answer with their natural log probabilities


@dataclass
class LanguageModel:
    """A loaded checkpoint of one of the vision-language families; `ModelPerception` says what its methods do.

    `name`: hub name or folder. `revision`: commit of the hub, or a digest of a folder. `heads`: None for relative
    attention, at the family's depth. `max_tokens`: per answer. `batch`: images at once. `presence`: whether maps are
    multiplied by the probability of yes. `pixels`: the most of an image, None for the family's.

    Raises `EagorError` for heads of another model.
    """

    name: str
    revision: str
    family: Family
    model: Any
    tokenizer: Any
    processor: Any
    heads: Heads | None = None
    presence: bool = True
    max_tokens: int = 512
    batch: int = 8
    pixels: int | None = None
    lock: Any = field(default_factory=RLock, repr=False)

    def __post_init__(self) -> None:
        self.model.set_attn_implementation({"text_config": NAME})  # results stay those of sdpa
        # First tokens of yes and of no, in the usual spellings; those that could begin either are left out.
        yes, no = ({self.tokenizer.encode(space + form, add_special_tokens=False)[0]
                    for form in (word, word.capitalize(), word.upper()) for space in ("", " ")}
                   for word in ("yes", "no"))  # fmt: skip
        self._yes, self._no = sorted(yes - no), sorted(no - yes)
        if self.heads is not None:  # the same head numbers may exist in another model and mean nothing
            possible, kind = full_layers(self.model), self.model.config.model_type
            count = self.model.config.get_text_config().num_attention_heads
            known = all(layer in possible and head < count for layer, head in self.heads.heads)
            if self.heads.model_type != kind or not known:
                raise EagorError(
                    f"the heads {list(self.heads.heads)} were found for {self.heads.model}, a {self.heads.model_type}; "
                    f"{self.name} is a {kind} with layers of full attention {possible} and {count} heads each. "
                    "Calibrate heads for this model"
                )

    @property
    def layers(self) -> tuple[int, ...]:
        """The captured layers: those of the heads, or the one at the family's depth."""
        if self.heads is not None:
            return tuple(sorted({layer for layer, _ in self.heads.heads}))
        depth = round(self.family.depth * self.model.config.get_text_config().num_hidden_layers)
        return (min(full_layers(self.model), key=lambda each: abs(each - depth)),)

    @property
    def view_rows(self) -> int:
        """As fine as the cells in the middle of a view."""
        focal = self.plan(1.0, True).shape[1] / (2 * math.tan(math.radians(50)))
        return max(12, min(90, round(math.pi * focal)))

    def extractors(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Those of the family."""
        return self.family.choices(self.heads is not None)

    def plan(self, aspect: float, view: bool = False) -> InputPlan:
        """How an image of this aspect ratio (width over height), or a view, is fed, resized to its size beforehand."""
        pixels = self.pixels or (self.family.view**2 if view else None)
        return plan(self.family, self.model.config, aspect, pixels)

    def sizes(self, aspect: float, view: bool = False) -> tuple[tuple[int, int], tuple[int, int]]:
        """(height, width) that pictures of this aspect ratio are resized to, and (rows, cols) of its cells."""
        return self.plan(aspect, view)[:2]

    @torch.inference_mode()
    def maps(
        self, images: Sequence[np.ndarray], queries: Sequence[str], wrap: bool
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Responses ``(Q, B, h, w)`` float32 in [0, 1) from attention, and the cost; `wrap`: these are panoramas."""
        cost, found = self._cost(), []
        for run, planned in self._batches(images, cost):
            general, responses = {} if self.heads else self._ask(run, planned, GENERAL, self.layers, cost)[2], []
            for query in queries:
                _, logits, maps = self._ask(run, planned, ask_presence(query), self.layers, cost)
                if self.heads is not None:
                    heat = saturated(of_heads(maps, self.heads.heads), self.heads.saturation, wrap)
                else:
                    means = (each[self.layers[0]].mean(axis=1) for each in (maps, general))
                    heat = saturated(relative(*means), SATURATION, wrap)
                responses.append(heat * self.yes(logits)[:, None, None] if self.presence else heat)
            found.append(np.stack(responses))
        return np.concatenate(found, axis=1), cost

    @torch.inference_mode()
    def boxes(self, images: Sequence[np.ndarray], texts: Sequence[str], read: Any) -> tuple[list[Any], dict[str, Any]]:
        """What `read` makes of the answers per text and image, and the cost."""
        cost, stops = self._cost(), getattr(self.model.generation_config, "eos_token_id", None)
        stops = np.ravel(self.tokenizer.eos_token_id if stops is None else stops).tolist()
        found: list[Any] = [[] for _ in texts]
        for run, planned in self._batches(images, cost):
            for readings, text in zip(found, texts, strict=True):
                running, logits, _ = self._ask(run, planned, text, (), cost)
                for answer in running.decode(logits, self.max_tokens, stops):
                    cost["answer_tokens"] += len(answer)
                    tokens = [(self.tokenizer.decode([token]), log) for token, log in answer]
                    written = self.tokenizer.decode([token for token, _ in answer], skip_special_tokens=True)
                    readings.append(read(written, tokens))
        return found, cost

    def _cost(self) -> dict[str, Any]:
        """What made evidence, and what is counted while it is made."""
        about = {"model": self.name, "revision": self.revision, "family": self.family.name}
        return about | dict.fromkeys(("images", "image_tokens", "prompt_tokens", "answer_tokens"), 0)

    def _batches(self, images: Sequence[np.ndarray], cost: dict[str, Any]) -> Iterator[tuple[Run, InputPlan]]:
        height, width = images[0].shape[:2]
        planned = plan(self.family, self.model.config, width / height, height * width)
        with self.lock:
            for start in range(0, len(images), self.batch):
                yield self.share(images[start : start + self.batch], planned, cost), planned

    def prompt(self, text: str, planned: InputPlan) -> Prompt:
        """The tokens of a question about an image."""
        return prompt(self.tokenizer, self.family, text, self.model.config.image_token_id, planned.tokens)

    def share(self, images: Sequence[np.ndarray], planned: InputPlan, cost: dict[str, Any]) -> Run:
        """Run everything up to the (resized) images, for questions to continue from."""
        model, count, tokens = self.model, len(images), self.prompt(GENERAL, planned)
        cost["images"] += count
        cost["image_tokens"] += planned.tokens * count
        cost["prompt_tokens"] += (tokens.prefix.shape[1] - planned.tokens) * count
        ids = tokens.prefix.expand(count, -1).to(model.device)
        feed = {name: each.to(model.device) for name, each in pictures(images, planned, self.processor).items()}
        feed["pixel_values"] = feed["pixel_values"].to(model.dtype)
        feed |= {"input_ids": ids, **typed(self.family, ids, model.config.image_token_id)}
        position = None
        if self.family.type_ids == "mm_token_type_ids":
            grid = feed.get("image_grid_thw")
            feed["position_ids"], _ = model.model.get_rope_index(ids, feed["mm_token_type_ids"], image_grid_thw=grid)
            position = int(feed["position_ids"].max()) + 1
        return Run(model, count, tokens.columns.to(model.device), position, model.model(**feed, use_cache=True).cache)

    def _ask(
        self, run: Run, planned: InputPlan, text: str, layers: Sequence[int], cost: dict[str, Any]
    ) -> tuple[Run, torch.Tensor, dict[int, np.ndarray]]:
        """The run after a question, the logits of the answer's first token, and the attention ``(B, H, h, w)``."""
        suffix, running = self.prompt(text, planned).suffix, run.branch()
        cost["prompt_tokens"] += suffix.shape[1] * run.batch
        logits, rows = running.ask(suffix, layers)
        maps = {layer: planned.cells(row.cpu().numpy().astype(np.float64)) for layer, row in rows.items()}
        return running, logits, maps

    def yes(self, logits: torch.Tensor) -> np.ndarray:
        """The probability ``(B,)`` float32 of yes against no in the logits ``(B, V)`` of an answer's first token."""
        chances = logits.softmax(dim=-1)
        yes, no = chances[:, self._yes].sum(dim=-1), chances[:, self._no].sum(dim=-1)
        return ((yes + 1e-9) / (yes + no + 2e-9)).cpu().numpy().astype(np.float32)

    @torch.inference_mode()
    def observe(self, example: Labelled, view: PerspectiveGrid | None = None) -> Observed:
        """The attention of all heads in all full-attention layers to a labelled panorama or a view of it.

        The question is that of `maps`. Input of `fit_heads`.
        """
        picture = example.panorama if view is None else cut(example.panorama, view)[0]
        planned = self.plan(picture.shape[1] / picture.shape[0], view is not None)
        grid = PatchGrid(*planned.shape) if view is None else view.resized(*planned.shape)
        with self.lock:
            cost = self._cost()
            run = self.share([resized(picture, planned.size, wrap=view is None)], planned, cost)
            maps = self._ask(run, planned, ask_presence(example.query), full_layers(self.model), cost)[2]
        alone = {layer: each[0] for layer, each in maps.items()}
        return Observed(alone, grid, unit(np.asarray(example.direction, dtype=float)), example.radius)


# --- one pass over the image, and questions that go on from it --------------------------------------------------------


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
