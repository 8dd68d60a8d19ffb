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
from eagor.perception.transformers.account import Account
from eagor.perception.transformers.prefix import chunks
from eagor.perception.vlm.boxes import Box
from eagor.perception.vlm.drawing import drawn
from eagor.perception.vlm.families import Extractor, Family
from eagor.perception.vlm.prompts import phrase

_FINEST = 180  # columns of the cells that boxes are drawn on, at most
_MOST = 50  # boxes per picture and query
_POOLED = 4  # pixels of a mask to a cell
# Below these scores the models' own examples drop boxes.
_THRESHOLDS = {"owlv2": 0.1, "grounding_dino": 0.25}


@dataclass
class Localiser:
    """A loaded localiser.

    Attributes:
        name: hub name or folder.
        revision: as in `language.LanguageModel`.
        family: what it is.
        model: the transformers model.
        tokenizer: its tokenizer.
        processor: its image processor.
        batch: images run at once.
        threshold: boxes with a lower score are dropped; None for the family's.
        pixels: of an image at most, where the family leaves a choice.
    """

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
            side = int(self.model.config.vision_config.image_size)
            return side, side
        if self.family.fit == "pad":
            side = int(self.model.config.vision_config.image_size)
            return (max(1, round(side / aspect)), side) if aspect >= 1 else (side, max(1, round(side * aspect)))
        edges = self.processor.size
        longest = min(float(edges["longest_edge"]), float(edges["shortest_edge"]) * max(aspect, 1 / aspect))
        if self.pixels is not None:
            longest = min(longest, (self.pixels * max(aspect, 1 / aspect)) ** 0.5)
        # Whole cells that boxes can be drawn on: a width of many divisors.
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
        """Responses ``(B, Q, h, w)`` float32 in [0, 1] of images that all have the size that `size` gives."""
        found = np.zeros((len(images), len(queries), *grids[0].shape), dtype=np.float32)
        words = [phrase(query) for query in queries]
        if self.family.name != "clipseg":
            boxes, account = self.boxes(images, queries)
            for row, grid in enumerate(grids):
                for column, ones in enumerate(boxes[row]):
                    found[row, column] = drawn(ones, grid, grid)
            return found, account
        account = Account(images=len(images))
        with self.lock:
            for part in chunks(len(images), self.batch) if words else ():
                found[part] = _masks(self, self._pixels(images[part]), words, account)
        return found, account

    @torch.inference_mode()
    def boxes(self, images: Sequence[np.ndarray], queries: Sequence[str]) -> tuple[list[list[list[Box]]], Account]:
        """Boxes per image and query, of images that all have the size that `size` gives."""
        account, found = Account(images=len(images)), []
        words = [phrase(query) for query in queries]
        if not words:
            return [[] for _ in images], account
        with self.lock:
            for part in chunks(len(images), self.batch):
                pixels = self._pixels(images[part])
                found += _DETECTORS[self.family.name](self, pixels, words, images[0].shape[:2], account)
        return found, account

    @property
    def least(self) -> float:
        """The score that a box needs."""
        return _THRESHOLDS[self.family.name] if self.threshold is None else self.threshold

    def _pixels(self, images: Sequence[np.ndarray]) -> torch.Tensor:
        """Normalised pixels ``(B, 3, h, w)``; OWLv2's in the upper left corner of its black square."""
        if self.family.fit == "pad":
            side = int(self.model.config.vision_config.image_size)
            canvas = np.zeros((len(images), side, side, 3), dtype=np.uint8)
            for square, image in zip(canvas, images, strict=True):
                square[: image.shape[0], : image.shape[1]] = image
            images = list(canvas)
        made = self.processor(images=list(images), do_resize=False, do_pad=False, return_tensors="pt")
        return made["pixel_values"].to(self.model.device, self.model.dtype)

    def tokens(self, texts: Sequence[str], longest: int, padding: str | bool) -> dict[str, torch.Tensor]:
        """Token ids and masks of texts, on the model's device."""
        made = self.tokenizer(list(texts), padding=padding, truncation=True, max_length=longest, return_tensors="pt")
        return {key: value.to(self.model.device) for key, value in made.items()}


def _owlv2(
    localiser: Localiser, pixels: torch.Tensor, words: Sequence[str], size: tuple[int, int], account: Account
) -> list[list[list[Box]]]:
    """Boxes per image and query; the image is run once for all queries."""
    config = localiser.model.config
    texts = [_photo(word) for word in words]
    tokens = localiser.tokens(texts, config.text_config.max_position_embeddings, "max_length")
    account.prompt_tokens += tokens["input_ids"].numel()
    count = len(pixels)
    out = localiser.model(
        pixel_values=pixels,
        input_ids=tokens["input_ids"].repeat(count, 1),
        attention_mask=tokens["attention_mask"].repeat(count, 1),
    )
    account.image_tokens += out.pred_boxes.shape[0] * out.pred_boxes.shape[1]
    side = int(config.vision_config.image_size)
    share = (size[0] / side, size[1] / side)  # of the square that the picture fills
    scores = out.logits.float().sigmoid().cpu().numpy()
    corners = _corners(out.pred_boxes, share)
    return [
        [_kept(corners[row], scores[row, :, column], word, localiser.least) for column, word in enumerate(words)]
        for row in range(count)
    ]


def _grounding_dino(
    localiser: Localiser, pixels: torch.Tensor, words: Sequence[str], size: tuple[int, int], account: Account
) -> list[list[list[Box]]]:
    """Boxes per image and query; words and image are mixed early, so that each query is a run of its own."""
    found: list[list[list[Box]]] = [[] for _ in pixels]
    for word in words:
        tokens = localiser.tokens(
            [f"{word.lower().rstrip('.')}."] * len(pixels), localiser.model.config.max_text_len, True
        )
        account.prompt_tokens += tokens["input_ids"].numel()
        out = localiser.model(pixel_values=pixels, **tokens)
        account.image_tokens += out.encoder_last_hidden_state_vision.shape[:2].numel()
        scores = out.logits.float().sigmoid().amax(dim=-1).cpu().numpy()
        corners = _corners(out.pred_boxes, (1.0, 1.0))
        for row in range(len(pixels)):
            found[row].append(_kept(corners[row], scores[row], word, localiser.least))
    return found


def _masks(localiser: Localiser, pixels: torch.Tensor, words: Sequence[str], account: Account) -> np.ndarray:
    """CLIPSeg's probabilities ``(B, Q, h, w)``, the mean over cells."""
    texts = [_photo(word) for word in words]
    tokens = localiser.tokens(texts, localiser.model.config.text_config.max_position_embeddings, True)
    account.prompt_tokens += tokens["input_ids"].numel()
    account.image_tokens += len(pixels) * (pixels.shape[-1] // localiser.model.config.vision_config.patch_size) ** 2
    out = localiser.model(
        pixel_values=pixels.repeat_interleave(len(words), dim=0),
        **{key: tokens[key].repeat(len(pixels), 1) for key in ("input_ids", "attention_mask")},
    )
    chances = out.logits.float().sigmoid().reshape(len(pixels), len(words), *pixels.shape[-2:])
    rows, cols = pixels.shape[-2] // _POOLED, pixels.shape[-1] // _POOLED
    cut = chances[..., : rows * _POOLED, : cols * _POOLED]
    return cut.reshape(len(pixels), len(words), rows, _POOLED, cols, _POOLED).mean(dim=(3, 5)).cpu().numpy()


_DETECTORS: dict[str, Callable[..., list[list[list[Box]]]]] = {"owlv2": _owlv2, "grounding_dino": _grounding_dino}


def _photo(word: str) -> str:
    """The sentence that CLIP models are asked with."""
    return f"a photo of a {re.sub(r'^(the|an|a) ', '', word.lower())}"


def _corners(boxes: torch.Tensor, share: tuple[float, float]) -> np.ndarray:
    """Corners, in fractions of the picture, of boxes ``(..., 4)``: centre x, y, width, height, fractions of a square.

    `share`: of the square's height and width that the picture fills, from its upper left corner.
    """
    x, y, width, height = np.moveaxis(boxes.float().cpu().numpy().astype(np.float64), -1, 0)
    left, right = (np.clip(edge / share[1], 0.0, 1.0) for edge in (x - width / 2, x + width / 2))
    top, bottom = (np.clip(edge / share[0], 0.0, 1.0) for edge in (y - height / 2, y + height / 2))
    return np.stack([left, top, right, bottom], axis=-1)


def _kept(corners: np.ndarray, scores: np.ndarray, word: str, least: float) -> list[Box]:
    """Boxes with area and a score of at least `least`, best first, and no more than can matter."""
    good = np.flatnonzero((scores >= least) & (corners[:, 2] > corners[:, 0]) & (corners[:, 3] > corners[:, 1]))
    best = good[np.argsort(-scores[good], kind="stable")][:_MOST]
    found = [(*corners[i].tolist(), float(scores[i])) for i in best]
    return [Box(x0, y0, x1, y1, word, score) for x0, y0, x1, y1, score in found]
