"""A vision-language model on images of one size: attention, boxes, or both, for several queries at once; its heads.

With localisation heads the map is the attention of a few heads, relative to uniform attention. Without them it is
relative attention (Zhang et al., ICLR 2025, arXiv 2502.17422): attention for the question over attention for a question
without content. That removes attention sinks, the background tokens that get attention whatever is asked (Kang et al.,
arXiv 2503.03321).

Localisation heads attend to what is asked for. They are found as by Kang et al. (arXiv 2503.06287). First, heads with
enough attention on the image (at or above the elbow of the sorted sums) are ranked by how often their maps are among
the least scattered (spatial entropy of the connected regions). Then, as directions are known here, the shortlist is
sorted by the attention on the target. The result is a small JSON file per model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
import torch

from eagor._checks import parsed
from eagor._files import read_file, written
from eagor._values import lazy
from eagor.errors import EagorError
from eagor.grids import Grid, PatchGrid, PerspectiveGrid
from eagor.media.panorama import cut, resized
from eagor.perception.json_files import checked, need
from eagor.perception.things import blurred, connected
from eagor.perception.transformers.inference import Capture, Prefix, Running, chunks, full_layers, prepare, share
from eagor.perception.transformers.inputs import InputPlan, Layout, Prompt, pictures, plan, prompt, template_of
from eagor.perception.vlm import GENERAL, Account, Extractor, Family, Labelled, ask_boxes, ask_presence
from eagor.perception.vlm.answers import Box, parse_boxes
from eagor.perception.vlm.projection import drawn
from eagor.sphere import angular_distance, unit

SATURATION = 2.0  # excess of the ratio over 1 at which the response is one half


@dataclass
class LanguageModel:
    """A loaded checkpoint of one of the vision-language families.

    `name`: hub name or folder. `revision`: commit of the hub, or a digest of a folder's configuration and weight files.
    `model`: with the capturing attention function in its language part. `heads`: None for relative attention, which
    reads `layers` (None: at the family's depth). `saturation`: see `saturated`; heads bring their own.
    `most`: tokens per answer. The others as in the perception.
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
        possible, text = full_layers(self.model), self.model.config.get_text_config()
        if self.heads is not None:
            kind, count = self.model.config.model_type, text.num_attention_heads
            if self.heads.model_type != kind:  # the same head numbers may exist here and mean nothing
                raise EagorError(
                    f"the heads were found for {self.heads.model}, a {self.heads.model_type}; {self.name} is a {kind}. "
                    "Calibrate heads for this model"
                )
            if any(layer not in possible or head >= count for layer, head in self.heads.heads):
                raise EagorError(
                    f"the heads {list(self.heads.heads)} were found for {self.heads.model}; {self.name} has layers of "
                    f"full attention {possible} with {count} heads each. Calibrate heads for this model"
                )
        elif self.layers is None:
            depth = round(self.family.depth * text.num_hidden_layers)
            self.layers = (min(possible, key=lambda layer: abs(layer - depth)),)
        elif not set(self.layers) <= set(possible) or not self.layers:
            raise EagorError(f"layers = {self.layers}; layers of full attention here are {possible}")

    @property
    def read(self) -> tuple[int, ...]:
        """The captured layers."""
        return self.heads.layers if self.heads else (self.layers or ())

    def plan(self, aspect: float) -> InputPlan:
        """How an image of this aspect ratio (width over height) is fed."""
        return plan(self.family, self.model.config, aspect, self.pixels)

    def size(self, aspect: float) -> tuple[int, int]:
        """(height, width) that images are resized to before `look`."""
        return self.plan(aspect).size

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]:
        """Rows and columns of the response. Boxes are drawn on finer cells than the model's own."""
        planned = self.plan(aspect)
        rows, cols = planned.shape
        finer = 1 if extractor == "attention" else next(k for k in (4, 2, 1) if planned.size[0] // rows % k == 0)
        return rows * finer, cols * finer

    @torch.inference_mode()
    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Account]:
        """Responses ``(B, Q, h, w)`` float32 in [0, 1] of images of the size from `size`, on the cells `grids`."""
        account = Account()
        found = np.zeros((len(images), len(queries), *grids[0].shape), dtype=np.float32)
        with self.lock:
            for part in chunks(len(images), self.batch, queries):
                look = _Batch(self, images[part], account)
                responses = look.responses(grids[part], queries, extractor)
                found[part] = np.stack(responses, axis=1)
        return found, account

    @torch.inference_mode()
    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Account]:
        """The boxes that the model writes per image and query, of images of the size from `size`."""
        account = Account()
        found: list[list[list[Box]]] = []
        with self.lock:
            for part in chunks(len(images), self.batch, queries):
                look = _Batch(self, images[part], account)
                written = [look.boxes(*look.ask(self.ask_boxes(query), ())[:2]) for query in queries]
                found += [list(ones) for ones in zip(*written, strict=True)]
        return found or [[] for _ in images], account

    def ask_boxes(self, query: str) -> str:
        """The question for boxes in the family's own coordinates. Raises `EagorError` if it cannot write boxes."""
        if self.family.frame is None:
            raise EagorError(
                f"{self.family.title} was not trained to write boxes; use extractor 'attention' or 'views' with it"
            )
        return ask_boxes(query, self.family.frame)

    def prompt(self, text: str, planned: InputPlan) -> Prompt:
        """The tokens of a question about an image."""
        image_token = self.model.config.image_token_id
        return prompt(self.tokenizer, self.family, self.template, text, image_token, planned.layout.count)

    def share(self, images: Sequence[np.ndarray], planned: InputPlan, account: Account | None = None) -> Prefix:
        """Run everything up to the (resized) images, for questions to continue from."""
        tensors = pictures(images, planned, self.processor)
        tokens = self.prompt(GENERAL, planned)
        if account is not None:
            account.images += len(images)
            account.image_tokens += planned.layout.count * len(images)
            account.prompt_tokens += (tokens.prefix.shape[1] - planned.layout.count) * len(images)
        return share(self.model, self.family, tokens, tensors, len(images), self.model.config.image_token_id)

    def yes(self, logits: torch.Tensor) -> np.ndarray:
        """The probability ``(B,)`` float32 of yes against no in the logits ``(B, V)`` of an answer's first token."""
        chances = logits.softmax(dim=-1)
        yes, no = chances[:, self._yes].sum(dim=-1), chances[:, self._no].sum(dim=-1)
        return ((yes + 1e-9) / (yes + no + 2e-9)).cpu().numpy().astype(np.float32)

    @torch.inference_mode()
    def observe(self, example: Labelled, view: PerspectiveGrid | None = None) -> Observed:
        """The attention of all heads in all full-attention layers to a labelled panorama or a view of it.

        The question is that of `look` with the extractor ``attention``. Input of `fit_heads`.
        """
        panorama = example.panorama
        planned = self.plan(1.0 if view is not None else panorama.shape[1] / panorama.shape[0])
        picture = panorama if view is None else cut(panorama, view)[0]
        rows, cols = planned.shape
        grid = PatchGrid(rows, cols) if view is None else view.resized(rows, cols)
        with self.lock:
            look = _Batch(self, [resized(picture, planned.size, wrap=view is None)], Account())
            _, _, captured = look.ask(ask_presence(example.query), full_layers(self.model))
        kept = {layer: tensor[0].cpu().numpy() for layer, tensor in captured.rows.items()}
        maps = {layer: planned.layout.cells(row) for layer, row in kept.items()}
        mass = {layer: row.sum(axis=-1) for layer, row in kept.items()}
        return Observed(maps, mass, grid, example.direction, example.radius)


class _Batch:
    """A batch of images of one size that questions are asked about."""

    def __init__(self, model: LanguageModel, images: Sequence[np.ndarray], account: Account) -> None:
        self._model, self._account = model, account
        self._planned = model.plan(images[0].shape[1] / images[0].shape[0])
        self._prefix = model.share(images, self._planned, account)

    def ask(self, text: str, layers: Sequence[int]) -> tuple[Running, torch.Tensor, Capture]:
        """The run after a question, the logits of the answer's first token, and the attention in `layers`."""
        suffix = self._model.prompt(text, self._planned).suffix
        self._account.prompt_tokens += suffix.shape[1] * self._prefix.batch
        running = self._prefix.continued()
        logits, captured = running.ask(suffix, layers)
        return running, logits, captured or Capture(self._prefix.columns)

    def responses(self, grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor) -> list[np.ndarray]:
        """The response ``(B, h, w)`` to each query, on the cells of `grids`."""
        model, layers = self._model, () if extractor == "boxes" else self._model.read
        general = None
        if layers and model.heads is None:
            general = mean_over_heads(self.ask(GENERAL, layers)[2].rows, self._planned.layout)
        found = []
        for query in queries:
            text = ask_presence(query) if extractor == "attention" else model.ask_boxes(query)
            running, logits, captured = self.ask(text, layers)
            heat = self._heat(captured, general, isinstance(grids[0], PatchGrid)) if layers else None
            if extractor == "attention" and heat is not None:
                found.append(heat * model.yes(logits)[:, None, None] if model.presence else heat)
                continue
            answers = self.boxes(running, logits)
            boxed = np.stack([drawn(boxes, grid, grid) for boxes, grid in zip(answers, grids, strict=True)])
            if heat is not None:  # a linear opinion pool
                finer = boxed.shape[-1] // heat.shape[-1]
                boxed = 0.5 * (boxed + np.kron(heat, np.ones((1, finer, finer), dtype=np.float32)))
            found.append(boxed)
        return found

    def _heat(self, captured: Capture, general: np.ndarray | None, wrap: bool) -> np.ndarray:
        """The response ``(B, h, w)`` from attention; `general`: attention for the question without content."""
        model, layout = self._model, self._planned.layout
        if model.heads is not None:
            return saturated(of_heads(captured.rows, model.heads.heads, layout), model.heads.saturation, wrap)
        assert general is not None
        return saturated(relative(mean_over_heads(captured.rows, layout), general), model.saturation, wrap)

    def boxes(self, running: Running, logits: torch.Tensor) -> list[list[Box]]:
        """The boxes in the continuation of the answer, per image."""
        model, frame = self._model, self._model.family.frame
        assert frame is not None
        answer = running.decode(logits, model.most, stops_of(model.model, model.tokenizer))
        found = []
        for ids, logs in zip(answer.ids, answer.log_probabilities, strict=True):
            self._account.answer_tokens += len(ids)
            text = model.tokenizer.decode(ids, skip_special_tokens=True)
            tokens = [(model.tokenizer.decode([token]), log) for token, log in zip(ids, logs, strict=True)]
            found.append(parse_boxes(text, frame, self._planned.size, tokens=tokens))
        return found


def _answers(tokenizer: Any) -> tuple[list[int], list[int]]:
    """First tokens of yes and of no, in the usual spellings; tokens that could begin either are left out."""

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


# --- responses from captured attention --------------------------------------------------------------------------------


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


# --- localisation heads -----------------------------------------------------------------------------------------------

TAKE = 3
SHORTLIST = 10
_EARLIEST = 2  # layers before this one attend to tokens, not yet to things
_LEAST = 1.05  # least attention on the targets, relative to uniform: anything lower is rounding or luck
_AIM = 0.7  # response to a typical labelled target


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
    except OSError as error:
        raise EagorError(f"the heads {file} cannot be read ({error}); make them: `eagor calibrate heads`") from error
    except ValueError as error:
        raise EagorError(
            f"{file} holds no localisation heads ({error}); wanted what `eagor calibrate heads` writes"
        ) from error


@dataclass(frozen=True, eq=False)
class Observed:
    """The attention of all heads for one labelled panorama, or for the view of it that shows the target best.

    `maps`: layer to attention ``(H, h, w)`` per cell of `grid`. `mass`: layer to the share of attention ``(H,)`` on
    the image. `direction` ``(3,)`` and `radius` (radians): of the target.
    """

    maps: dict[int, np.ndarray]
    mass: dict[int, np.ndarray]
    grid: Grid
    direction: np.ndarray
    radius: float

    @property
    def wrap(self) -> bool:
        """Whether the left and right edge of the picture meet."""
        return isinstance(self.grid, PatchGrid)

    @lazy
    def near(self) -> np.ndarray:
        """The cells ``(h, w)`` of the target: those within its radius, at least the nearest."""
        angle = np.asarray(angular_distance(self.grid.directions, unit(np.asarray(self.direction, dtype=float))))
        return (angle <= self.radius) | (angle <= angle.min() + 1e-12)

    def mean(self, heads: Sequence[tuple[int, int]]) -> np.ndarray:
        """The mean map ``(h, w)`` of some (layer, head), before saturation."""
        return blurred(np.mean([densities(self.maps[layer][head]) for layer, head in heads], axis=0), self.wrap)

    def error(self, heads: Sequence[tuple[int, int]]) -> float:
        """The angle (radians) between the target and the maximum of the mean map of these heads."""
        cells = self.mean(heads)
        best = self.grid.directions[np.unravel_index(np.argmax(cells), cells.shape)]
        return float(angular_distance(best, unit(np.asarray(self.direction, dtype=float))))


def fit_heads(observed: Iterable[Observed], model: str, model_type: str, take: int = TAKE) -> Heads:
    """The localisation heads in what `eagor.perception.transformers.language` observed on labelled panoramas.

    Raises `EagorError` if there are no panoramas, or no head attends to the targets more than elsewhere.
    """
    looks = list(observed)
    if not looks:
        raise EagorError("there are no labelled panoramas; give 20 or more")
    layers = [layer for layer in looks[0].maps if layer >= _EARLIEST] or list(looks[0].maps)
    names = [(layer, head) for layer in layers for head in range(len(looks[0].mass[layer]))]
    mass = np.array([np.mean([look.mass[layer][head] for look in looks]) for layer, head in names])
    attentive = [name for name, share in zip(names, mass, strict=True) if share >= elbow(mass)]
    votes = dict.fromkeys(attentive, 0)
    for look in looks:
        scatter = {name: spatial_entropy(look.maps[name[0]][name[1]], look.wrap) for name in attentive}
        for name in sorted(scatter, key=lambda name: scatter[name])[:SHORTLIST]:
            votes[name] += bool(np.isfinite(scatter[name]))
    shortlist = sorted(attentive, key=lambda name: -votes[name])[:SHORTLIST]
    gains = {name: float(np.median([_gain(look, name) for look in looks])) for name in shortlist}
    chosen = [name for name in sorted(shortlist, key=lambda name: -gains[name]) if gains[name] > _LEAST][:take]
    if not chosen:
        best = max(gains.values(), default=0.0)
        raise EagorError(
            f"no head of {model} looks at the labelled targets more than elsewhere (best: {best:.2f} times uniform "
            f"attention, over {len(looks)} panoramas). Try more panoramas, larger pictures, or another extractor"
        )
    peaks = [float(look.mean(chosen)[look.near].max()) for look in looks]
    saturation = max(float(np.median(peaks)) - 1.0, 0.1) * (1 - _AIM) / _AIM
    figures = [{"head": list(name), "gain": gains[name], "votes": votes[name]} for name in chosen]
    found_by = {"panoramas": len(looks), "attentive": len(attentive), "of": len(names), "heads": figures}
    return Heads(model, model_type, tuple(chosen), saturation, found_by)


def judged(found: Heads, held_out: Sequence[Observed]) -> Heads:
    """`found` with its error (degrees) on held-out panoramas."""
    if not held_out:
        return found
    errors = np.degrees([look.error(found.heads) for look in held_out])
    figures = {"panoramas": len(errors), "median_error_deg": round(float(np.median(errors)), 2)}
    return replace(found, found_by=found.found_by | {"held_out": figures})


def elbow(values: np.ndarray) -> float:
    """The value at the elbow of sorted `values`: farthest below the chord from the first to the last."""
    rising = np.sort(np.asarray(values, dtype=float))
    if len(rising) < 3 or rising[-1] <= rising[0]:
        return float(rising[0])
    along = np.linspace(0, 1, len(rising))
    below = along - (rising - rising[0]) / (rising[-1] - rising[0])
    return float(rising[int(below.argmax())])


def spatial_entropy(cells: np.ndarray, wrap: bool = True) -> float:
    """Scatter of a map ``(h, w)`` over a panorama: entropy (nats) of the shares of its connected regions.

    Regions exceed twice the mean; they connect diagonally and, with `wrap`, across the seam. Infinite for a map that is
    highest in the bottom row (as of some heads whatever is asked) or has no region.
    """
    lit = np.maximum(cells - 2 * cells.mean(), 0.0)
    if not lit.any() or lit[-1].sum() > 0.5 * lit.sum():
        return float("inf")
    shares = np.bincount(connected(lit > 0, wrap).reshape(-1), lit.reshape(-1))[1:] / lit.sum()
    return float(-(shares * np.log(shares)).sum())


def _gain(look: Observed, name: tuple[int, int]) -> float:
    """The mean attention of a head on the target, relative to uniform attention over the cells."""
    return float(densities(look.maps[name[0]][name[1]])[look.near].mean())
