"""Model inputs: sizes, pixel values, tokens with their image span, and the type ids that some families need.

No processor class of transformers is used, since those of the Qwen families need torchvision. Images are resized to
their exact size here; the image processor only normalises (and cuts patches).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
import torch

from eagor._values import lazy
from eagor.errors import EagorError, ImageError
from eagor.media.panorama import resized
from eagor.perception.vlm import Family, exact_size, nearest_size

_MOST_TILES = 12
_MOST_STEPS = 2_000_000  # lines that a chat template may run: a hundred turns with pictures take about ten thousand
_MARK = "QUESTION"


@dataclass(frozen=True)
class Block:
    """Rows and columns of tokens, row by row, that cover a window of the image.

    `window`: left, top, right, bottom as fractions of the image; it may extend beyond it (padding).
    """

    rows: int
    cols: int
    window: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    @property
    def count(self) -> int:
        """Number of tokens."""
        return self.rows * self.cols


@dataclass(frozen=True)
class Layout:
    """The blocks of an image in the order of its tokens, and the grid of cells ``(h, w)`` over the whole image."""

    shape: tuple[int, int]
    blocks: tuple[Block, ...]

    @property
    def count(self) -> int:
        """Number of image tokens."""
        return sum(block.count for block in self.blocks)

    @lazy
    def _shares(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Per block, the share of each row of tokens in each row of cells ``(h, rows)``, and the same for columns."""
        height, width = self.shape
        found = []
        for block in self.blocks:
            left, top, right, bottom = block.window
            found.append((_overlap(height, block.rows, top, bottom), _overlap(width, block.cols, left, right)))
        return tuple(found)

    def cells(self, tokens: np.ndarray) -> np.ndarray:
        """Token values ``(..., count)``, spread evenly over their windows, as sums over cells ``(..., h, w)``."""
        tokens = np.asarray(tokens)
        if tokens.shape[-1] != self.count:
            raise ValueError(f"{tokens.shape[-1]} values came for {self.count} image tokens")
        if self.blocks == (Block(*self.shape),):  # tokens are cells
            return tokens.reshape(*tokens.shape[:-1], *self.shape)
        total, start = np.zeros((*tokens.shape[:-1], *self.shape), dtype=tokens.dtype), 0
        for block, (down, across) in zip(self.blocks, self._shares, strict=True):
            part = tokens[..., start : start + block.count].reshape(*tokens.shape[:-1], block.rows, block.cols)
            total += (down @ part @ across.T).astype(tokens.dtype)
            start += block.count
        return total


def _overlap(cells: int, tokens: int, start: float, end: float) -> np.ndarray:
    """The share ``(cells, tokens)`` of each of `tokens` equal parts of [start, end] in each of `cells` of [0, 1]."""
    token = start + (end - start) * np.arange(tokens + 1) / tokens
    cell = np.arange(cells + 1) / cells
    common = np.minimum(cell[1:, None], token[None, 1:]) - np.maximum(cell[:-1, None], token[None, :-1])
    return np.where(common > 1e-12, common, 0.0) * (tokens / (end - start))


@dataclass(frozen=True)
class InputPlan:
    """How images of one aspect ratio are fed to a model.

    `size`: (height, width) in pixels to resize the image to; whole cells each way. `layout`: where its tokens look.
    `square`: side of the square that the model sees (padded, squashed or tiled), None if it takes `size`.
    """

    size: tuple[int, int]
    layout: Layout
    square: int | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self.layout.shape


def plan(family: Family, config: Any, aspect: float, pixels: int | None = None) -> InputPlan:
    """How an image with `aspect` (width over height) is fed to a model with this configuration.

    `pixels`: the most that it may have, if the family leaves a choice. Raises `ImageError` if no cell fits in them.
    """
    vision, most = config.vision_config, pixels or family.pixels
    if family.fit == "exact":
        cell = vision.patch_size * vision.spatial_merge_size
        return _exact(cell, exact_size(cell, most, aspect))
    side = _first(vision.image_size)
    if family.fit == "squash":
        rows = math.isqrt(config.mm_tokens_per_image)
        return InputPlan((side, side), Layout((rows, rows), (Block(rows, rows),)), side)
    rows = side // _first(vision.patch_size)
    if family.fit == "pad":
        return _padded(side, rows, aspect)
    return _tiled(side, round(rows * config.downsample_ratio), aspect, most)


def picture_plan(
    family: Family, config: Any, processor: Any, shape: tuple[int, int], pixels: int | None = None
) -> InputPlan:
    """How a picture ``(height, width)`` is fed in a conversation, where directions do not matter.

    It keeps its size as nearly as the model allows: if the family leaves a choice, within the limits of the
    checkpoint's own processor, and at most `pixels`.
    """
    vision = config.vision_config
    if family.fit == "exact":
        cell = vision.patch_size * vision.spatial_merge_size
        most = min(int(processor.size["longest_edge"]), pixels or sys.maxsize)
        return _exact(cell, nearest_size(cell, shape, min(int(processor.size["shortest_edge"]), most), most))
    return plan(family, config, shape[1] / shape[0], min(shape[0] * shape[1], pixels or sys.maxsize))


def _exact(cell: int, size: tuple[int, int]) -> InputPlan:
    shape = (size[0] // cell, size[1] // cell)
    return InputPlan(size, Layout(shape, (Block(*shape),)))


def _first(value: Any) -> int:
    """A side length that configurations give as a number or a pair."""
    return int(value[0] if isinstance(value, list | tuple) else value)


def _padded(side: int, tokens: int, aspect: float) -> InputPlan:
    """The image centred in the square; its cells are the rows of tokens that it fills."""
    patch = side // tokens
    share = (min(1 / aspect, 1.0), min(aspect, 1.0))  # of the square's height and width
    # Whole cells, as many above as below, so that no token crosses the border.
    rows, cols = (max(tokens - 2 * round(tokens * (1 - part) / 2), 1) for part in share)
    height, width = rows * patch, cols * patch
    top, left = ((side - length) // 2 for length in (height, width))
    window = (-left / width, -top / height, (tokens * patch - left) / width, (tokens * patch - top) / height)
    return InputPlan((height, width), Layout((rows, cols), (Block(tokens, tokens, window),)), side)


def _tiled(side: int, tokens: int, aspect: float, pixels: int) -> InputPlan:
    """Tiles in the grid nearest to the image's aspect, as many as the pixels allow, then the whole image."""
    most = min(max(pixels // (side * side), 1), _MOST_TILES)
    grids = [(rows, cols) for rows in range(1, most + 1) for cols in range(1, most + 1) if rows * cols <= most]
    rows, cols = min(grids, key=lambda grid: (round(abs(math.log(grid[1] / grid[0] / aspect)), 6), -grid[0] * grid[1]))
    blocks = [
        Block(tokens, tokens, (col / cols, row / rows, (col + 1) / cols, (row + 1) / rows))
        for row in range(rows)
        for col in range(cols)
    ]
    blocks += [Block(tokens, tokens)] if len(blocks) > 1 else []
    return InputPlan((rows * side, cols * side), Layout((rows * tokens, cols * tokens), tuple(blocks)), side)


def pictures(images: Sequence[np.ndarray], plan: InputPlan, processor: Any) -> dict[str, torch.Tensor]:
    """The image tensors of images of size ``plan.size``, by the names that the model takes."""
    squares: list[np.ndarray] = []
    for image in images:
        if image.shape[:2] != plan.size:
            raise ImageError(f"an image is {image.shape[:2]}; the plan wants {plan.size}. Resize it first")
        squares += [image] if plan.square is None else _squares(image, plan, processor)
    switches = dict.fromkeys(("do_resize", "do_center_crop", "do_pad", "do_pan_and_scan", "crop_to_patches"), False)
    known = {name: value for name, value in switches.items() if hasattr(processor, name)}
    made = processor(images=squares, return_tensors="pt", **known)
    return {name: made[name] for name in ("pixel_values", "image_grid_thw") if name in made}


def _squares(image: np.ndarray, plan: InputPlan, processor: Any) -> list[np.ndarray]:
    """The squares of one image that the model sees."""
    side, (height, width) = plan.square or 0, plan.size
    if height == width == side and len(plan.layout.blocks) == 1:
        return [image]
    if height <= side and width <= side:
        mean = getattr(processor, "image_mean", None) or (0.5, 0.5, 0.5)
        canvas = np.broadcast_to(np.array([int(255 * value) for value in mean], dtype=np.uint8), (side, side, 3)).copy()
        top, left = (side - height) // 2, (side - width) // 2
        canvas[top : top + height, left : left + width] = image
        return [canvas]
    tiles = [
        image[top : top + side, left : left + side] for top in range(0, height, side) for left in range(0, width, side)
    ]
    return [*tiles, resized(image, (side, side))]


@dataclass(frozen=True)
class Prompt:
    """Token ids: `prefix` ``(1, S)`` up to the last image, `suffix` ``(1, T)``; `columns` ``(n,)``: image tokens."""

    prefix: torch.Tensor
    columns: torch.Tensor
    suffix: torch.Tensor


def prompt(tokenizer: Any, family: Family, template: str, text: str, image_token: int, count: int) -> Prompt:
    """The tokens of `text` about an image of `count` tokens; equal text before the image gives an equal prefix.

    `template` holds ``{text}`` and the family's placeholder once each. Raises `EagorError` if the tokenizer does not
    know the image token.
    """
    written = template.replace(family.placeholder, family.expansion).replace("{text}", text)
    return tokens_of(tokenizer, family, written, image_token, [count])


def tokens_of(tokenizer: Any, family: Family, written: str, image_token: int, counts: Sequence[int]) -> Prompt:
    """The tokens of a prompt in which each image token is repeated as often as `counts` says for that image.

    Raises `EagorError` if the prompt has another number of image tokens.
    """
    begins = tokenizer.bos_token is not None and written.startswith(tokenizer.bos_token)
    ids = tokenizer(written, add_special_tokens=not begins)["input_ids"]
    places = [place for place, token in enumerate(ids) if token == image_token]
    if len(places) != len(counts):
        raise EagorError(
            f"the prompt has {len(places)} image tokens ({family.image_token!r}, id {image_token}); wanted "
            f"{len(counts)}. Do the tokenizer and the model belong together, and does the text hold no such token?"
        )
    prefix: list[int] = []
    columns: list[int] = []
    done = 0
    for place, count in zip(places, counts, strict=True):
        prefix += ids[done:place]
        columns += range(len(prefix), len(prefix) + count)
        prefix += [image_token] * count
        done = place + 1
    if not counts:  # something has to run before the answer's first token
        prefix, done = ids[:-1], len(ids) - 1
    return Prompt(torch.tensor([prefix]), torch.tensor(columns, dtype=torch.long), torch.tensor([ids[done:]]))


def template_of(tokenizer: Any, family: Family) -> str:
    """The checkpoint's own prompt around one image and a question (``{text}``), otherwise the family's.

    Checkpoints of one family differ in their system prompts; their own template holds the one of their training.
    """
    written = own_template(tokenizer, family)
    if written is None or written.index(_MARK) < written.index(family.placeholder):
        return family.template  # the image has to come first, so that questions can share the prefix
    return written.replace(_MARK, "{text}")


def own_template(tokenizer: Any, family: Family) -> str | None:
    """One image and a mark, formatted by the checkpoint's template; None if it does not support images."""
    content = [{"type": "image"}, {"type": "text", "text": _MARK}]
    written = templated(tokenizer, [{"role": "user", "content": content}])
    return written if written.count(family.placeholder) == 1 and written.count(_MARK) == 1 else None


def templated(tokenizer: Any, turns: Sequence[Mapping[str, Any]]) -> str:
    """`turns` formatted by the checkpoint's own template; empty if there is none that accepts them."""
    if not getattr(tokenizer, "chat_template", None):
        return ""
    try:
        with limited_steps(_MOST_STEPS):
            return tokenizer.apply_chat_template(turns, tokenize=False, add_generation_prompt=True)
    except Endless as error:
        raise EagorError(
            f"the chat template of {tokenizer.name_or_path!r} does not end: {error}. Fetch the checkpoint again, or "
            "take another"
        ) from None
    except Exception:  # a template is a program; one without pictures or system messages may raise anything
        return ""


def typed(family: Family, ids: torch.Tensor, image_token: int) -> dict[str, torch.Tensor]:
    """The family's type ids ``(B, S)``: 1 at image tokens, 0 elsewhere; empty for a family without them.

    Without these ids some models run with wrong positions or a wrong mask, and answer wrongly without an error.
    """
    return {family.type_ids: (ids == image_token).long()} if family.type_ids else {}


class Endless(Exception):
    """A program exceeded its number of steps."""


@contextmanager
def limited_steps(most: int) -> Iterator[None]:
    """Raise `Endless` in the code inside (this thread) after `most` lines of Python. Suspends a debugger."""
    left = most

    def step(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal left
        left -= event == "line"
        if left < 0:
            raise Endless(f"more than {most} lines were run")
        return step

    before = sys.gettrace()
    sys.settrace(step)
    try:
        yield
    finally:
        sys.settrace(before)
