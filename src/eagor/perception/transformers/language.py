"""A vision-language model on images of one size: its attention, its boxes, and the heads that attend to what is asked.

With localisation heads the map is the attention of a few heads, relative to uniform attention. Without them it is
relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): attention for the question over attention for a question
without content. That removes attention sinks, the background tokens that get attention whatever is asked (Kang et al.,
arXiv 2503.03321).

Some heads attend to what is asked for (Kang et al., arXiv 2503.06287). They are found on labelled panoramas, as those
with the most attention on the targets; the result is a small JSON file per model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
import torch

from eagor._checks import parsed
from eagor._files import read_file, written
from eagor.errors import EagorError
from eagor.grids import Grid, PatchGrid, PerspectiveGrid
from eagor.media.panorama import cut, resized
from eagor.perception.json_files import checked, need
from eagor.perception.things import blurred
from eagor.perception.transformers.inference import Run, full_layers, prepare, share
from eagor.perception.transformers.inputs import InputPlan, Prompt, pictures, plan, prompt
from eagor.perception.vlm import GENERAL, Family, Labelled, ask_boxes, ask_presence
from eagor.perception.vlm.answers import Box, parse_boxes
from eagor.sphere import angular_distance, unit

SATURATION = 2.0  # excess of the ratio over 1 at which the response is one half
_EARLIEST = 2  # layers before this one attend to tokens, not yet to things
_LEAST = 1.05  # least attention on the targets, relative to uniform: anything lower is rounding or luck
_AIM = 0.7  # response to a typical labelled target


@dataclass
class LanguageModel:
    """A loaded checkpoint of one of the vision-language families.

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
        prepare(self.model)
        self._yes, self._no = _verdict_tokens(self.tokenizer)
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
        depth = round(self.family.depth * self.model.config.get_text_config().num_hidden_layers)
        return self.heads.layers if self.heads else (min(full_layers(self.model), key=lambda each: abs(each - depth)),)

    @property
    def stops(self) -> list[int]:
        """Tokens that end an answer."""
        stops = getattr(self.model.generation_config, "eos_token_id", None)
        stops = stops if stops is not None else self.tokenizer.eos_token_id
        return [int(stop) for stop in (stops if isinstance(stops, list | tuple) else [stops]) if stop is not None]

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
        pixels = self.pixels or (self.family.served.view**2 if view else None)
        return plan(self.family, self.model.config, aspect, pixels)

    def sizes(self, aspect: float, view: bool = False) -> tuple[tuple[int, int], tuple[int, int]]:
        """(height, width) that pictures of this aspect ratio are resized to, and (rows, cols) of its cells."""
        planned = self.plan(aspect, view)
        return planned.size, planned.shape

    @torch.inference_mode()
    def maps(
        self, images: Sequence[np.ndarray], queries: Sequence[str], wrap: bool
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Responses ``(Q, B, h, w)`` float32 in [0, 1) from attention, and the cost; `wrap`: these are panoramas."""
        cost, found = self._cost(), []
        for run, planned in self._batches(images, cost):
            general = None if self.heads else self._ask(run, planned, GENERAL, self.layers, cost)[2]
            responses = []
            for query in queries:
                _, logits, rows = self._ask(run, planned, ask_presence(query), self.layers, cost)
                if self.heads is not None:
                    heat = saturated(of_heads(rows, self.heads.heads, planned), self.heads.saturation, wrap)
                else:
                    assert general is not None
                    heat = saturated(relative(*(mean_map(each, planned) for each in (rows, general))), SATURATION, wrap)
                responses.append(heat * self.yes(logits)[:, None, None] if self.presence else heat)
            found.append(np.stack(responses))
        return np.concatenate(found, axis=1), cost

    @torch.inference_mode()
    def boxes(
        self, images: Sequence[np.ndarray], queries: Sequence[str]
    ) -> tuple[list[list[list[Box]]], dict[str, Any]]:
        """The boxes that the model writes per query and image, and the cost.

        Raises `EagorError` if it cannot write boxes, `AnswerError` if they cannot be read.
        """
        frame, cost = self.family.frame, self._cost()
        if frame is None:
            raise EagorError(f"{self.family.title} was not trained to write boxes; use extractor 'attention'")
        found: list[list[list[Box]]] = [[] for _ in queries]
        for run, planned in self._batches(images, cost):
            for boxes, query in zip(found, queries, strict=True):
                running, logits, _ = self._ask(run, planned, ask_boxes(query, frame), (), cost)
                answer = running.decode(logits, self.max_tokens, self.stops)
                for ids, logs in zip(answer.ids, answer.log_probabilities, strict=True):
                    cost["answer_tokens"] += len(ids)
                    tokens = [(self.tokenizer.decode([token]), log) for token, log in zip(ids, logs, strict=True)]
                    text = self.tokenizer.decode(ids, skip_special_tokens=True)
                    boxes.append(parse_boxes(text, frame, planned.size, tokens=tokens))
        return found, cost

    def _cost(self) -> dict[str, Any]:
        """What made evidence, and what is counted while it is made."""
        about = {"model": self.name, "revision": self.revision, "family": self.family.name}
        return about | dict.fromkeys(("images", "image_tokens", "prompt_tokens", "answer_tokens"), 0)

    def _batches(self, images: Sequence[np.ndarray], cost: dict[str, Any]) -> Iterator[tuple[Run, InputPlan]]:
        with self.lock:
            for start in range(0, len(images), self.batch):
                part = images[start : start + self.batch]
                height, width = part[0].shape[:2]
                planned = plan(self.family, self.model.config, width / height, height * width)
                yield self.share(part, planned, cost), planned

    def prompt(self, text: str, planned: InputPlan) -> Prompt:
        """The tokens of a question about an image."""
        return prompt(self.tokenizer, self.family, text, self.model.config.image_token_id, planned.count)

    def share(self, images: Sequence[np.ndarray], planned: InputPlan, cost: dict[str, Any]) -> Run:
        """Run everything up to the (resized) images, for questions to continue from."""
        tokens = self.prompt(GENERAL, planned)
        cost["images"] += len(images)
        cost["image_tokens"] += planned.count * len(images)
        cost["prompt_tokens"] += (tokens.prefix.shape[1] - planned.count) * len(images)
        tensors = pictures(images, planned, self.processor)
        return share(self.model, self.family, tokens, tensors, len(images), self.model.config.image_token_id)

    def _ask(
        self, run: Run, planned: InputPlan, text: str, layers: Sequence[int], cost: dict[str, Any]
    ) -> tuple[Run, torch.Tensor, dict[int, torch.Tensor]]:
        """The run after a question, the logits of the answer's first token, and the attention in `layers`."""
        suffix, running = self.prompt(text, planned).suffix, run.branch()
        cost["prompt_tokens"] += suffix.shape[1] * run.batch
        return running, *running.ask(suffix, layers)

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
            rows = self._ask(run, planned, ask_presence(example.query), full_layers(self.model), cost)[2]
        maps = {layer: planned.cells(row[0].cpu().numpy()) for layer, row in rows.items()}
        return Observed(maps, grid, unit(np.asarray(example.direction, dtype=float)), example.radius)


def _verdict_tokens(tokenizer: Any) -> tuple[list[int], list[int]]:
    """First tokens of yes and of no, in the usual spellings; tokens that could begin either are left out."""

    def first(word: str) -> set[int]:
        forms = [space + form for form in (word, word.capitalize(), word.upper()) for space in ("", " ")]
        return {tokenizer.encode(form, add_special_tokens=False)[0] for form in forms}

    yes, no = first("yes"), first("no")
    return sorted(yes - no), sorted(no - yes)


# --- responses from captured attention --------------------------------------------------------------------------------


def mean_map(rows: Mapping[int, torch.Tensor], planned: InputPlan) -> np.ndarray:
    """Attention per cell ``(B, h, w)``, the mean over all captured layers and heads."""
    layers = [each.mean(dim=1).cpu().numpy().astype(np.float64) for each in rows.values()]
    return planned.cells(np.mean(layers, axis=0))


def of_heads(rows: Mapping[int, torch.Tensor], heads: Sequence[tuple[int, int]], planned: InputPlan) -> np.ndarray:
    """Mean attention ``(B, h, w)`` of some (layer, head), each first scaled to a mean of 1 over the cells."""
    maps = [planned.cells(rows[layer][:, head].cpu().numpy().astype(np.float64)) for layer, head in heads]
    return np.mean([densities(each) for each in maps], axis=0)


def densities(cells: np.ndarray) -> np.ndarray:
    """`cells` ``(..., h, w)`` divided by their mean; ones where they are all zero."""
    mean = cells.mean(axis=(-2, -1), keepdims=True)
    return np.where(mean > 0, cells / np.where(mean > 0, mean, 1.0), 1.0)


def relative(asked: np.ndarray, general: np.ndarray) -> np.ndarray:
    """The ratio ``(B, h, w)`` of two attention maps; 1 where the question makes no difference.

    The median of the general map is added to both, since the plain ratio explodes where nothing gets attention.
    """
    floor = np.maximum(np.median(general, axis=(-2, -1), keepdims=True), np.finfo(np.float32).tiny)
    return (asked + floor) / (general + floor)


def saturated(ratio: np.ndarray, saturation: float = SATURATION, wrap: bool = True) -> np.ndarray:
    """A response in [0, 1), float32, from a ratio ``(..., h, w)``: x / (x + saturation) for an excess x over 1.

    The scale is fixed. Scaling by the map's own maximum would turn "nothing here" into a detection. The ratio is
    blurred over 3 x 3 cells first; `wrap` if the left and right edge meet.
    """
    excess = np.maximum(blurred(ratio, wrap) - 1.0, 0.0)
    return (excess / (excess + saturation)).astype(np.float32)


# --- localisation heads -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Heads:
    """Localisation heads (layer, head) of one model, best first; `model_type` as in its configuration.

    `saturation`: the excess over uniform attention at which the response is one half. `found_by`: for information.
    """

    model: str
    model_type: str
    heads: tuple[tuple[int, int], ...]
    saturation: float
    found_by: dict[str, Any] = field(default_factory=dict)

    @property
    def layers(self) -> tuple[int, ...]:
        """The layers of the heads."""
        return tuple(sorted({layer for layer, _ in self.heads}))

    def write(self, file: Path) -> None:
        """Store it as JSON. Raises `StorageError` if it cannot be written."""
        written(file, json.dumps(asdict(self), indent=1) + "\n")


def read_heads(file: str | Path) -> Heads:
    """The heads in a file. Raises `EagorError` if it cannot be read or holds something else."""
    try:
        found = checked(parsed(read_file(file)), Heads, "the file")
        usable = len(found.heads) > 0 and min(map(min, found.heads)) >= 0
        need(usable, "heads", found.heads, "pairs (layer, head), from 0 on")
        need(0 < found.saturation < math.inf, "saturation", found.saturation, "a number above 0")
        return found
    except (OSError, ValueError) as error:
        raise EagorError(
            f"{file} cannot be read as localisation heads ({error}); wanted what `eagor calibrate heads` writes"
        ) from error


@dataclass(frozen=True, eq=False)
class Observed:
    """The attention of all heads for one labelled panorama, or for the view of it that shows the target best.

    `maps`: layer to attention ``(H, h, w)`` per cell of `grid`. `direction` ``(3,)``, `radius` (radians): the target.
    """

    maps: dict[int, np.ndarray]
    grid: Grid
    direction: np.ndarray
    radius: float

    @property
    def near(self) -> np.ndarray:
        """The cells ``(h, w)`` of the target: those within its radius, at least the nearest."""
        angle = np.asarray(angular_distance(self.grid.directions, self.direction))
        return (angle <= self.radius) | (angle <= angle.min() + 1e-12)

    def mean(self, heads: Sequence[tuple[int, int]]) -> np.ndarray:
        """The mean map ``(h, w)`` of some (layer, head), before saturation."""
        maps = [densities(self.maps[layer][head]) for layer, head in heads]
        return blurred(np.mean(maps, axis=0), isinstance(self.grid, PatchGrid))

    def error(self, heads: Sequence[tuple[int, int]]) -> float:
        """The angle (radians) between the target and the maximum of the mean map of these heads."""
        cells = self.mean(heads)
        best = self.grid.directions[np.unravel_index(np.argmax(cells), cells.shape)]
        return float(angular_distance(best, self.direction))


def fit_heads(
    looks: Sequence[Observed], model: str, model_type: str, take: int = 3, held_out: Sequence[Observed] = ()
) -> Heads:
    """The localisation heads in what a model observed on labelled panoramas, with their error on `held_out` ones.

    Raises `EagorError` if there are no panoramas, or no head attends to the targets more than elsewhere.
    """
    if not looks:
        raise EagorError("there are no labelled panoramas; give 20 or more")
    layers = [layer for layer in looks[0].maps if layer >= _EARLIEST] or list(looks[0].maps)
    on_target = [{layer: densities(look.maps[layer])[:, look.near].mean(axis=1) for layer in layers} for look in looks]
    gains = {(layer, head): float(gain) for layer in layers
             for head, gain in enumerate(np.median([each[layer] for each in on_target], axis=0))}  # fmt: skip
    chosen = [name for name in sorted(gains, key=lambda name: -gains[name]) if gains[name] > _LEAST][:take]
    if not chosen:
        raise EagorError(
            f"no head of {model} looks at the labelled targets more than elsewhere (best: {max(gains.values()):.2f} "
            f"times uniform attention, over {len(looks)} panoramas). Try more panoramas, larger pictures, or another "
            "extractor"
        )
    peaks = [float(look.mean(chosen)[look.near].max()) for look in looks]
    saturation = max(float(np.median(peaks)) - 1.0, 0.1) * (1 - _AIM) / _AIM
    figures = [{"head": list(name), "gain": gains[name]} for name in chosen]
    found_by: dict[str, Any] = {"panoramas": len(looks), "of": len(gains), "heads": figures}
    if held_out:
        error = round(math.degrees(np.median([look.error(chosen) for look in held_out])), 2)
        found_by["held_out"] = {"panoramas": len(held_out), "median_error_deg": error}
    return Heads(model, model_type, tuple(chosen), saturation, found_by)
