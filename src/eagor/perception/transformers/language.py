"""A vision-language model that looks at images of one size: attention, boxes, or both, for several queries at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from threading import RLock
from typing import Any

import numpy as np
import torch

from eagor.errors import EagorError
from eagor.grids import Grid, PatchGrid, PerspectiveGrid
from eagor.perception.transformers.account import Account
from eagor.perception.transformers.attention import SATURATION, mean_over_heads, of_heads, relative, saturated
from eagor.perception.transformers.capture import full_layers, prepare
from eagor.perception.transformers.heads import Heads, Observed
from eagor.perception.transformers.inputs import Plan, Prompt, pictures, plan, prompt, template_of
from eagor.perception.transformers.prefix import Prefix, Running, chunks, share
from eagor.perception.vlm.boxes import Box, parse_boxes
from eagor.perception.vlm.drawing import drawn
from eagor.perception.vlm.families import Extractor, Family
from eagor.perception.vlm.labelled import Labelled
from eagor.perception.vlm.prompts import GENERAL, ask_boxes, ask_presence
from eagor.perception.vlm.sizes import resized
from eagor.perception.vlm.views import cut


@dataclass
class LanguageModel:
    """A loaded checkpoint of one of the vision-language families.

    Attributes:
        name: hub name or folder.
        revision: commit of the hub, or a digest of a folder's configuration and weight files.
        family: what it is.
        model: the transformers model, its language part running through the capturing attention function.
        tokenizer: its tokenizer.
        processor: its image processor.
        heads: localisation heads, None for relative attention.
        layers: layers that relative attention reads; None for the family's depth.
        presence: multiply attention by the probability that the answer to "is it there?" is yes.
        saturation: see `attention.saturated`; the heads' own where there are heads.
        most: tokens that an answer may have.
        batch: images run at once.
        pixels: of an image, where the family leaves a choice.
    """

    name: str
    revision: str
    family: Family
    model: Any
    tokenizer: Any
    processor: Any
    heads: Heads | None = None
    layers: tuple[int, ...] | None = None
    presence: bool = True
    saturation: float = SATURATION
    most: int = 512
    batch: int = 8
    pixels: int | None = None
    lock: Any = field(default_factory=RLock, repr=False)

    def __post_init__(self) -> None:
        prepare(self.model)
        self.template = template_of(self.tokenizer, self.family)
        self._yes, self._no = _answers(self.tokenizer)
        possible = full_layers(self.model)
        if self.heads is not None:
            kind = self.model.config.model_type
            if self.heads.model_type != kind:  # heads of another family may exist here, too, and look at anything
                raise EagorError(
                    f"the heads were found for {self.heads.model}, a {self.heads.model_type}; {self.name} is a {kind}. "
                    "Calibrate heads for this model"
                )
            count = self.model.config.get_text_config().num_attention_heads
            if any(layer not in possible or head >= count for layer, head in self.heads.heads):
                raise EagorError(
                    f"the heads {list(self.heads.heads)} were found for {self.heads.model}; {self.name} has layers of "
                    f"full attention {possible} with {count} heads each. Calibrate heads for this model"
                )
        elif self.layers is None:
            depth = round(self.family.depth * self.model.config.get_text_config().num_hidden_layers)
            self.layers = (min(possible, key=lambda layer: abs(layer - depth)),)
        elif not set(self.layers) <= set(possible) or not self.layers:
            raise EagorError(f"layers = {self.layers}; layers of full attention here are {possible}")

    @property
    def read(self) -> tuple[int, ...]:
        """The layers that are captured."""
        return self.heads.layers if self.heads else (self.layers or ())

    def plan(self, aspect: float) -> Plan:
        """How an image of this aspect (width over height) is fed."""
        return plan(self.family, self.model.config, aspect, self.pixels)

    def size(self, aspect: float) -> tuple[int, int]:
        """(height, width) that images are resized to before `look`."""
        return self.plan(aspect).size

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]:
        """Rows and columns of the response. Boxes are drawn on finer cells than the model's own."""
        planned = self.plan(aspect)
        rows, cols = planned.shape
        finer = 1
        if extractor != "attention":
            finer = next(k for k in (4, 2, 1) if planned.size[0] // rows % k == 0)
        return rows * finer, cols * finer

    @torch.inference_mode()
    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Account]:
        """Responses ``(B, Q, h, w)`` float32 in [0, 1] of images that all have the size that `size` gives.

        `grids`: the cells of each image's response, of the shape that `cells` gives.
        """
        account = Account()
        shape = grids[0].shape
        found = np.zeros((len(images), len(queries), *shape), dtype=np.float32)
        with self.lock:
            for part in chunks(len(images), self.batch) if queries else ():
                found[part] = self._look(images[part], grids[part], queries, extractor, account)
        return found, account

    @torch.inference_mode()
    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Account]:
        """The boxes that the model writes per image and query, of images that all have the size that `size` gives."""
        account = Account()
        found: list[list[list[Box]]] = [[] for _ in images]
        with self.lock:
            for part in chunks(len(images), self.batch) if queries else ():
                planned = self.plan(images[0].shape[1] / images[0].shape[0])
                prefix = self.share(images[part], planned, account)
                for query in queries:
                    running = prefix.continued()
                    suffix = self._suffix(self.ask_boxes(query), planned, prefix, account)
                    logits, _ = running.ask(suffix, ())
                    for row, ones in zip(found[part], self._boxes(running, logits, planned, account), strict=True):
                        row.append(ones)
        return found, account

    def _look(
        self,
        images: Sequence[np.ndarray],
        grids: Sequence[Grid],
        queries: Sequence[str],
        extractor: Extractor,
        account: Account,
    ) -> np.ndarray:
        planned = self.plan(images[0].shape[1] / images[0].shape[0])
        prefix = self.share(images, planned, account)
        wrap = isinstance(grids[0], PatchGrid)
        general = None
        if extractor != "boxes" and self.heads is None:
            _, rows = prefix.continued().ask(self._suffix(GENERAL, planned, prefix, account), self.read)
            general = mean_over_heads(rows.rows if rows else {}, planned.layout)
        return np.stack(
            [
                self._respond(prefix, planned, query, extractor, general, grids, wrap, account)
                for query in queries
            ],
            axis=1,
        )  # fmt: skip

    def _respond(
        self,
        prefix: Prefix,
        planned: Plan,
        query: str,
        extractor: Extractor,
        general: np.ndarray | None,
        grids: Sequence[Grid],
        wrap: bool,
        account: Account,
    ) -> np.ndarray:
        """The response ``(B, h, w)`` to one query."""
        text = ask_presence(query) if extractor == "attention" else self.ask_boxes(query)
        running = prefix.continued()
        logits, rows = running.ask(
            self._suffix(text, planned, prefix, account), self.read if extractor != "boxes" else ()
        )
        heat = None
        if rows is not None:
            if self.heads is not None:
                ratio, scale = of_heads(rows.rows, self.heads.heads, planned.layout), self.heads.saturation
            else:
                assert general is not None
                ratio, scale = relative(mean_over_heads(rows.rows, planned.layout), general), self.saturation
            heat = saturated(ratio, scale, wrap)
        if extractor == "attention":
            assert heat is not None
            return heat * self.yes(logits)[:, None, None] if self.presence else heat
        answers = self._boxes(running, logits, planned, account)
        boxed = np.stack([drawn(boxes, grid, grid) for boxes, grid in zip(answers, grids, strict=True)])
        if heat is None:
            return boxed
        finer = boxed.shape[-1] // heat.shape[-1]
        return 0.5 * (boxed + np.kron(heat, np.ones((1, finer, finer), dtype=np.float32)))  # a linear opinion pool

    def ask_boxes(self, query: str) -> str:
        """The question for boxes in the family's own coordinates. Raises `EagorError` if it has none."""
        if self.family.frame is None:
            raise EagorError(
                f"{self.family.title} was not trained to write boxes; use extractor 'attention' or 'views' with it"
            )
        return ask_boxes(query, self.family.frame)

    def _suffix(self, text: str, planned: Plan, prefix: Prefix, account: Account) -> torch.Tensor:
        suffix = self.prompt(text, planned).suffix
        account.prompt_tokens += suffix.shape[1] * prefix.batch
        return suffix

    def prompt(self, text: str, planned: Plan) -> Prompt:
        """The tokens of a question about an image."""
        image_token = self.model.config.image_token_id
        return prompt(self.tokenizer, self.family, self.template, text, image_token, planned.layout.count)

    def share(self, images: Sequence[np.ndarray], planned: Plan, account: Account | None = None) -> Prefix:
        """Run everything up to the images (already resized), to be continued by questions."""
        tensors = pictures(images, planned, self.processor)
        tokens = self.prompt(GENERAL, planned)
        if account is not None:
            account.images += len(images)
            account.image_tokens += planned.layout.count * len(images)
            account.prompt_tokens += (tokens.prefix.shape[1] - planned.layout.count) * len(images)
        return share(self.model, self.family, tokens, tensors, len(images), self.model.config.image_token_id)

    def yes(self, logits: torch.Tensor) -> np.ndarray:
        """The probability of yes against no ``(B,)`` float32 in the logits ``(B, V)`` of an answer's first token."""
        chances = logits.softmax(dim=-1)
        yes, no = chances[:, self._yes].sum(dim=-1), chances[:, self._no].sum(dim=-1)
        return ((yes + 1e-9) / (yes + no + 2e-9)).cpu().numpy().astype(np.float32)

    def _boxes(self, running: Running, logits: torch.Tensor, planned: Plan, account: Account) -> list[list[Box]]:
        """The boxes that the model goes on to write, per image."""
        stops = stops_of(self.model, self.tokenizer)
        answer = running.decode(logits, self.most, stops)
        found = []
        for ids, logs in zip(answer.ids, answer.log_probabilities, strict=True):
            account.answer_tokens += len(ids)
            text = self.tokenizer.decode(ids, skip_special_tokens=True)
            pieces = [self.tokenizer.decode([token]) for token in ids]
            assert self.family.frame is not None
            found.append(
                parse_boxes(text, self.family.frame, planned.size, tokens=list(zip(pieces, logs, strict=True)))
            )
        return found

    @torch.inference_mode()
    def observe(self, example: Labelled, view: PerspectiveGrid | None = None) -> Observed:
        """What all heads of all layers of full attention do for a labelled panorama, or a view of it, for `fit_heads`.

        They are asked what `look` asks them with the extractor ``attention``.
        """
        aspect = 1.0 if view is not None else example.panorama.shape[1] / example.panorama.shape[0]
        planned = self.plan(aspect)
        picture = example.panorama if view is None else cut(example.panorama, view)
        rows, cols = planned.shape
        grid = PatchGrid(rows, cols) if view is None else replace(view, height=rows, width=cols)
        with self.lock:
            prefix = self.share([resized(picture, planned.size, wrap=view is None)], planned)
            suffix = self.prompt(ask_presence(example.query), planned).suffix
            _, captured = prefix.continued().ask(suffix, full_layers(self.model))
        assert captured is not None
        kept = {layer: tensor[0].cpu().numpy() for layer, tensor in captured.rows.items()}
        return Observed(
            maps={layer: planned.layout.cells(row) for layer, row in kept.items()},
            mass={layer: row.sum(axis=-1) for layer, row in kept.items()},
            grid=grid,
            direction=example.direction,
            radius=example.radius,
        )


def _answers(tokenizer: Any) -> tuple[list[int], list[int]]:
    """First tokens of yes and of no, in the spellings that models use; what could begin either counts for none."""

    def first(word: str) -> set[int]:
        forms = [space + form for form in (word, word.capitalize(), word.upper()) for space in ("", " ")]
        return {tokenizer.encode(form, add_special_tokens=False)[0] for form in forms}

    yes, no = first("yes"), first("no")
    return sorted(yes - no), sorted(no - yes)


def stops_of(model: Any, tokenizer: Any) -> list[int]:
    """Tokens that end an answer."""
    stops = getattr(model.generation_config, "eos_token_id", None)
    stops = stops if stops is not None else tokenizer.eos_token_id
    return [int(stop) for stop in (stops if isinstance(stops, list | tuple) else [stops]) if stop is not None]
