"""Open-vocabulary localisers: OWLv2 and Grounding DINO answer with boxes, CLIPSeg with a mask.

OWLv2: Minderer et al., arXiv 2306.09683. Grounding DINO: Liu et al., arXiv 2303.05499. CLIPSeg: Lüddecke and Ecker,
arXiv 2112.10003.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import RLock
from typing import Any

import numpy as np
import torch

from eagor.errors import ImageError
from eagor.grids import Grid
from eagor.perception.transformers.inference import chunks
from eagor.perception.vlm import Account, Extractor, Family, phrase
from eagor.perception.vlm.answers import Box
from eagor.perception.vlm.projection import drawn

_FINEST = 180  # columns of the cells that boxes are drawn on, at most
_MOST = 50  # boxes per picture and query
_POOLED = 4  # pixels of a mask per cell


@dataclass(frozen=True)
class Kind:
    """How a family of localisers is used.

    `loaded_by`: its class in transformers. `sentence`: turns a query into its text. `threshold`: the score below which
    the model's own examples drop boxes. `together`: whether one run answers all queries (otherwise text and image are
    fused early, and each query is a run of its own). `padding`, `longest`: of its tokens, from its configuration.
    """

    loaded_by: str
    sentence: Callable[[str], str]
    threshold: float
    together: bool
    padding: str | bool
    longest: Callable[[Any], int]


def _photo(word: str) -> str:
    """The sentence that CLIP models expect."""
    return f"a photo of a {re.sub(r'^(the|an|a) ', '', word.lower())}"


def _of_text(config: Any) -> int:
    return config.text_config.max_position_embeddings


_DETECTION = "AutoModelForZeroShotObjectDetection"
KINDS = {
    "owlv2": Kind(_DETECTION, _photo, 0.1, True, "max_length", _of_text),
    "grounding_dino": Kind(
        _DETECTION, lambda word: f"{word.lower().rstrip('.')}.", 0.25, False, True, lambda config: config.max_text_len
    ),
    "clipseg": Kind("CLIPSegForImageSegmentation", _photo, 0.0, True, True, _of_text),
}


@dataclass
class Localiser:
    """A loaded localiser, asked as a `LanguageModel` is; drops boxes below `threshold` (None: the family's)."""

    name: str
    revision: str
    family: Family
    model: Any
    tokenizer: Any
    processor: Any
    batch: int = 8
    threshold: float | None = None
    pixels: int | None = None
    lock: Any = field(default_factory=RLock, repr=False)

    def size(self, aspect: float) -> tuple[int, int]:
        """(height, width) that images are resized to before `look`. Raises `ImageError` for too few pixels."""
        if self.family.fit == "squash":
            return self._side, self._side
        if self.family.fit == "pad":
            side = self._side
            return (max(1, round(side / aspect)), side) if aspect >= 1 else (side, max(1, round(side * aspect)))
        edges, longer = self.processor.size, max(aspect, 1 / aspect)
        longest = min(float(edges["longest_edge"]), float(edges["shortest_edge"]) * longer)
        if self.pixels is not None:
            longest = min(longest, (self.pixels * longer) ** 0.5)
        # Whole cells to draw boxes on: a width with many divisors.
        width = longest if aspect >= 1 else longest * aspect
        width = width // _FINEST * _FINEST if width >= _FINEST else width // 12 * 12
        if width < 1:
            raise ImageError(
                f"no picture of {aspect:g}:1 for {self.name} has at most {self.pixels} pixels; allow more pixels"
            )
        return max(1, round(width / aspect)), int(width)

    def cells(self, aspect: float, extractor: Extractor) -> tuple[int, int]:
        """Rows and columns of the response."""
        height, width = self.size(aspect)
        if extractor == "mask":
            return height // _POOLED, width // _POOLED
        cols = max(k for k in range(1, _FINEST + 1) if width % k == 0 and (k % 2 == 0 or width % 2))
        if aspect < 1.5:  # a view: cells of about 2 degrees
            cols = min(cols, 48)
        return max(1, round(cols / aspect)), cols

    @torch.inference_mode()
    def look(
        self, images: Sequence[np.ndarray], grids: Sequence[Grid], queries: Sequence[str], extractor: Extractor
    ) -> tuple[np.ndarray, Account]:
        """Responses ``(B, Q, h, w)`` float32 in [0, 1] of images of the size from `size`."""
        found = np.zeros((len(images), len(queries), *grids[0].shape), dtype=np.float32)
        if extractor != "mask":
            boxes, account = self.boxes(images, queries)
            for row, grid in enumerate(grids):
                for column, ones in enumerate(boxes[row]):
                    found[row, column] = drawn(ones, grid, grid)
            return found, account
        account = Account(images=len(images))
        with self.lock:
            for part in chunks(len(images), self.batch, queries):
                found[part] = self._masks(images[part], queries, account)
        return found, account

    @torch.inference_mode()
    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Account]:
        """Boxes per image and query, of images of the size from `size`."""
        account = Account(images=len(images))
        found: list[list[list[Box]]] = [[] for _ in images]
        words = [phrase(query) for query in queries]
        height, width = images[0].shape[:2]
        side = self._side if self.family.fit == "pad" else 0
        share = (height / side, width / side) if side else (1.0, 1.0)  # of the square that the picture fills
        with self.lock:
            for part in chunks(len(images), self.batch, queries):
                for asked in [words] if KINDS[self.family.name].together else [[word] for word in words]:
                    corners, scores = self._boxes(images[part], asked, share, account)
                    for row, ones in enumerate(found[part]):
                        ones += [
                            _kept(corners[row], scores[row, :, column], word, self.least)
                            for column, word in enumerate(asked)
                        ]
        return found, account

    @property
    def least(self) -> float:
        """The least score of a box."""
        return KINDS[self.family.name].threshold if self.threshold is None else self.threshold

    @property
    def _side(self) -> int:
        """Side of the square that the model sees."""
        return int(self.model.config.vision_config.image_size)

    def _boxes(
        self, images: Sequence[np.ndarray], words: Sequence[str], share: tuple[float, float], account: Account
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corners ``(B, n, 4)`` and scores ``(B, n, Q)`` from one run."""
        pixels = self._pixels(images)
        out = self.model(pixel_values=pixels, **self._tokens(words, len(pixels), account))
        scores = out.logits.float().sigmoid()
        if KINDS[self.family.name].together:
            account.image_tokens += out.pred_boxes.shape[:2].numel()
        else:  # one score per token of the single query
            account.image_tokens += out.encoder_last_hidden_state_vision.shape[:2].numel()
            scores = scores.amax(dim=-1, keepdim=True)
        return _corners(out.pred_boxes, share), scores.cpu().numpy()

    def _masks(self, images: Sequence[np.ndarray], words: Sequence[str], account: Account) -> np.ndarray:
        """CLIPSeg's probabilities ``(B, Q, h, w)``, averaged over cells."""
        pixels = self._pixels(images)
        count, (height, width) = len(pixels), pixels.shape[-2:]
        account.image_tokens += count * (width // self.model.config.vision_config.patch_size) ** 2
        tokens = self._tokens([phrase(word) for word in words], count, account)
        out = self.model(pixel_values=pixels.repeat_interleave(len(words), dim=0), **tokens)
        chances = out.logits.float().sigmoid().reshape(count, len(words), height, width)
        rows, cols = height // _POOLED, width // _POOLED
        cut = chances[..., : rows * _POOLED, : cols * _POOLED]
        return cut.reshape(count, len(words), rows, _POOLED, cols, _POOLED).mean(dim=(3, 5)).cpu().numpy()

    def _pixels(self, images: Sequence[np.ndarray]) -> torch.Tensor:
        """Normalised pixels ``(B, 3, h, w)``; OWLv2 gets the picture in the upper left corner of a black square."""
        if self.family.fit == "pad":
            canvas = np.zeros((len(images), self._side, self._side, 3), dtype=np.uint8)
            for square, image in zip(canvas, images, strict=True):
                square[: image.shape[0], : image.shape[1]] = image
            images = list(canvas)
        made = self.processor(images=list(images), do_resize=False, do_pad=False, return_tensors="pt")
        return made["pixel_values"].to(self.model.device, self.model.dtype)

    def _tokens(self, words: Sequence[str], count: int, account: Account) -> dict[str, torch.Tensor]:
        """Token ids and masks of all words for each of `count` images, on the model's device."""
        kind = KINDS[self.family.name]
        texts, most = [kind.sentence(word) for word in words], kind.longest(self.model.config)
        made = self.tokenizer(texts, padding=kind.padding, truncation=True, max_length=most, return_tensors="pt")
        taken = ("input_ids", "attention_mask") if kind.together else tuple(made)
        repeated = {key: made[key].to(self.model.device).repeat(count, 1) for key in taken}
        account.prompt_tokens += made["input_ids"].numel() * (1 if kind.together else count)
        return repeated


def _corners(boxes: torch.Tensor, share: tuple[float, float]) -> np.ndarray:
    """Corners, as fractions of the picture, of boxes ``(..., 4)``: centre x, y, width, height as fractions of a square.

    `share`: of the square's height and width that the picture fills, from its upper left corner.
    """
    x, y, width, height = np.moveaxis(boxes.float().cpu().numpy().astype(np.float64), -1, 0)
    left, right = (np.clip(edge / share[1], 0.0, 1.0) for edge in (x - width / 2, x + width / 2))
    top, bottom = (np.clip(edge / share[0], 0.0, 1.0) for edge in (y - height / 2, y + height / 2))
    return np.stack([left, top, right, bottom], axis=-1)


def _kept(corners: np.ndarray, scores: np.ndarray, word: str, least: float) -> list[Box]:
    """Boxes with area and a score of at least `least`, best first, at most `_MOST`."""
    good = np.flatnonzero((scores >= least) & (corners[:, 2] > corners[:, 0]) & (corners[:, 3] > corners[:, 1]))
    best = good[np.argsort(-scores[good], kind="stable")][:_MOST]
    found = [(*corners[i].tolist(), float(scores[i])) for i in best]
    return [Box(x0, y0, x1, y1, word, score) for x0, y0, x1, y1, score in found]
