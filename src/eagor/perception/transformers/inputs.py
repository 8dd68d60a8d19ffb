"""Model inputs: sizes, pixel values, tokens with their image span, and the type ids that some families need.

No processor class of transformers is used, since those of the Qwen families need torchvision. Images are resized to
their exact size here; the image processor only normalises (and cuts patches).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import torch

from eagor.errors import EagorError
from eagor.perception.vlm import Family, exact_size
from eagor.sources.panorama import resized

_MOST_TILES = 12


class Block(NamedTuple):
    """Rows and columns of tokens, row by row, that cover a window of the image.

    `window`: left, top, right, bottom as fractions of the image; it may extend beyond it (padding).
    """

    rows: int
    cols: int
    window: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)


class InputPlan(NamedTuple):
    """How images of one aspect ratio are fed to a model.

    `size`: (height, width) in pixels to resize the image to. `shape`: rows and columns of cells over the image.
    `blocks`: where its tokens look, in their order. `square`: side of the square that the model sees of each block,
    None if it takes the image as it is.
    """

    size: tuple[int, int]
    shape: tuple[int, int]
    blocks: tuple[Block, ...]
    square: int | None = None

    @property
    def tokens(self) -> int:
        """Number of image tokens."""
        return sum(rows * cols for rows, cols, _ in self.blocks)

    def cells(self, tokens: np.ndarray) -> np.ndarray:
        """Token values ``(..., n)``, spread evenly over their windows, as sums over cells ``(..., h, w)``."""
        total, start = np.zeros((*tokens.shape[:-1], *self.shape), dtype=tokens.dtype), 0
        for rows, cols, (left, top, right, bottom) in self.blocks:
            down, across = _shares(self.shape[0], rows, top, bottom), _shares(self.shape[1], cols, left, right)
            part = tokens[..., start : start + rows * cols].reshape(*tokens.shape[:-1], rows, cols)
            total += (down @ part @ across.T).astype(tokens.dtype)
            start += rows * cols
        return total


def _shares(cells: int, tokens: int, start: float, end: float) -> np.ndarray:
    """The share ``(cells, tokens)`` of each of `tokens` equal parts of [start, end] in each of `cells` of [0, 1]."""
    token = start + (end - start) * np.arange(tokens + 1) / tokens
    cell = np.arange(cells + 1) / cells
    common = np.minimum(cell[1:, None], token[None, 1:]) - np.maximum(cell[:-1, None], token[None, :-1])
    return np.where(common > 1e-12, common, 0.0) * (tokens / (end - start))


def plan(family: Family, config: Any, aspect: float, pixels: int | None = None) -> InputPlan:
    """How an image with `aspect` (width over height) is fed to a model with this configuration.

    `pixels`: the most that it may have, if the family leaves a choice. Raises `ImageError` if no cell fits in them.
    """
    vision, most = config.vision_config, pixels or family.pixels
    if family.fit == "exact":
        cell = vision.patch_size * vision.spatial_merge_size
        size = exact_size(cell, most, aspect)
        shape = (size[0] // cell, size[1] // cell)
        return InputPlan(size, shape, (Block(*shape),))
    side, patch = (int(np.ravel(value)[0]) for value in (vision.image_size, vision.patch_size))  # numbers, or pairs
    if family.fit == "squash":
        rows = math.isqrt(config.mm_tokens_per_image)
        return InputPlan((side, side), (rows, rows), (Block(rows, rows),), side)
    tokens = side // patch
    if family.fit == "pad":
        # The image fills whole cells in the middle of the square, as many above as below.
        rows, cols = (max(tokens - 2 * round(tokens * (1 - min(part, 1.0)) / 2), 1) for part in (1 / aspect, aspect))
        beyond, beside = (tokens / rows - 1) / 2, (tokens / cols - 1) / 2
        block = Block(tokens, tokens, (-beside, -beyond, 1 + beside, 1 + beyond))
        return InputPlan((rows * side // tokens, cols * side // tokens), (rows, cols), (block,), side)
    # Tiles in the grid nearest to the image's aspect, as many as the pixels allow, then the whole image.
    tokens, most = round(tokens * config.downsample_ratio), min(max(most // (side * side), 1), _MOST_TILES)
    grids = [(rows, cols) for rows in range(1, most + 1) for cols in range(1, most // rows + 1)]
    rows, cols = min(grids, key=lambda grid: (round(abs(math.log(grid[1] / grid[0] / aspect)), 6), -grid[0] * grid[1]))
    blocks = [Block(tokens, tokens, (col / cols, row / rows, (col + 1) / cols, (row + 1) / rows))
              for row in range(rows) for col in range(cols)]  # fmt: skip
    blocks += [Block(tokens, tokens)] if len(blocks) > 1 else []
    return InputPlan((rows * side, cols * side), (rows * tokens, cols * tokens), tuple(blocks), side)


def pictures(images: Sequence[np.ndarray], plan: InputPlan, processor: Any) -> dict[str, torch.Tensor]:
    """The image tensors of images of size ``plan.size``, by the names that the model takes."""
    shown = [*images]
    if plan.square is not None:
        mean = [int(255 * value) for value in getattr(processor, "image_mean", None) or (0.5, 0.5, 0.5)]
        shown = [_square(image, block.window, plan.square, mean) for image in images for block in plan.blocks]
    switches = ("do_resize", "do_center_crop", "do_pad", "do_pan_and_scan", "crop_to_patches")
    off = dict.fromkeys((name for name in switches if hasattr(processor, name)), False)
    made = processor(images=shown, return_tensors="pt", **off)
    return {name: made[name] for name in ("pixel_values", "image_grid_thw") if name in made}


def _square(image: np.ndarray, window: Sequence[float], side: int, mean: Sequence[int]) -> np.ndarray:
    """What the model sees of a window of the image: `side` by `side` pixels, `mean` colour beyond the image."""
    height, width = image.shape[:2]
    left, top, right, bottom = np.rint(np.multiply(window, (width, height, width, height))).astype(int).tolist()
    canvas = np.empty((bottom - top, right - left, 3), dtype=np.uint8)
    canvas[:] = mean
    inner = image[max(top, 0) : bottom, max(left, 0) : right]
    canvas[max(-top, 0) :, max(-left, 0) :][: len(inner), : inner.shape[1]] = inner
    return resized(canvas, (side, side))


class Prompt(NamedTuple):
    """Token ids: `prefix` ``(1, S)`` up to the image, `suffix` ``(1, T)``; `columns` ``(n,)``: image tokens."""

    prefix: torch.Tensor
    columns: torch.Tensor
    suffix: torch.Tensor


def prompt(tokenizer: Any, family: Family, text: str, image_token: int, count: int) -> Prompt:
    """The tokens of a question about an image of `count` tokens; every question has the same prefix.

    It is written by the checkpoint's own template, which holds the system prompt of its training, or else (no template,
    or one that does not put the picture first, so that questions could not share it) by the family's. Raises
    `EagorError` if the tokenizer does not know the image token.
    """
    for token in (family.placeholder, family.image_token):
        text = text.replace(token, token.strip("<|>"))  # written in the text, it would be taken for a picture
    written = ""
    with suppress(Exception):  # a template is a program; one without pictures may raise anything
        turn = {"role": "user", "content": [{"type": "image"}, {"type": "text", "text": text}]}
        written = tokenizer.apply_chat_template([turn], tokenize=False, add_generation_prompt=True)
    if written.count(family.placeholder) != 1 or written.find(family.placeholder) > written.find(text):
        written = family.prompt.replace("{text}", text)
    written = written.replace(family.placeholder, family.expansion)
    begins = tokenizer.bos_token is not None and written.startswith(tokenizer.bos_token)
    ids = tokenizer(written, add_special_tokens=not begins)["input_ids"]
    if ids.count(image_token) != 1:
        raise EagorError(
            f"the prompt has {ids.count(image_token)} image tokens ({family.image_token!r}, id {image_token}); wanted "
            "one. Do the tokenizer and the model belong together?"
        )
    place = ids.index(image_token)
    prefix = torch.tensor([ids[:place] + [image_token] * count])
    return Prompt(prefix, torch.arange(place, place + count), torch.tensor([ids[place + 1 :]]))


def typed(family: Family, ids: torch.Tensor, image_token: int) -> dict[str, torch.Tensor]:
    """The family's type ids ``(B, S)``: 1 at image tokens, 0 elsewhere; empty for a family without them.

    Without these ids some models run with wrong positions or a wrong mask, and answer wrongly without an error.
    """
    return {family.type_ids: (ids == image_token).long()} if family.type_ids else {}
