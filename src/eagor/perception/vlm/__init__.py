"""How vision-language models are asked, local or served: their families, questions, conversations.

The differences between families are data (families.json, with the order and the unit of each one's boxes): no family
has code of its own. This module imports neither torch nor transformers, so that ``eagor doctor`` can list families.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, Protocol

import msgspec
import numpy as np

from eagor.errors import ImageError, QueryError
from eagor.perception.vlm.answers import Frame, Order

__all__ = [
    "FAMILIES", "GENERAL", "IMAGE", "MAX_TOKENS", "PIXELS", "SERVED", "Chat", "ChatReply", "Extractor", "Family",
    "Labelled", "Message", "ask_boxes", "ask_presence", "boxes_schema", "exact_size", "family_of", "phrase",
]  # fmt: skip

Extractor = Literal["attention", "boxes", "views"]
PIXELS = 700 * 1400  # of a panorama, by default


@dataclass(frozen=True)
class Family:
    """A family of models, here or on a server, which reveals only the model's name.

    - `pattern` finds it in lower-case names such as ``qwen2.5vl:7b``. `source`: who says what it writes.
    - `cell`: side of an image token in pixels; pictures have multiples of it. `view`: side of a square view. `pixels`:
      the most of a picture, if the family leaves a choice. `aspect`: width / height of a panorama as sent: where
      processors make everything square, it is squeezed beforehand, and cells are twice as wide as high.
    - `frame`, `order`: of the coordinates to ask for. `grounded`: whether it was trained to write boxes; others are
      better asked yes or no.

    The rest is of families that also run here:

    - `title` is its common name, `model_types` are values of ``model_type`` in ``config.json``.
    - `fit`: how an image becomes the model's input. ``exact``: resized to whole cells, any aspect; ``squash``: to the
      model's square; ``pad``: into the square with background around it; ``tiles``: squares, then the whole, smaller.
    - `extractor`, and `per_view` for ``views``: how directions are read by default (docs/models.md).
    - `type_ids`: the input that tells image tokens from text; without it the model runs and answers wrongly.
    - `prompt`: of its training, with ``{text}`` for the question, for checkpoints without a chat template; the image's
      `placeholder` in it becomes the `expansion`, in which the `image_token` is then repeated.
    - `depth`: the layer whose attention is read by default, as a fraction of all layers. 22 of 28 for Qwen2.5-VL-7B
      and 14 of 32 for LLaVA-1.5-7B are published (Zhang et al., arXiv 2502.17422); the others are not measured.
    """

    name: str = "other"
    pattern: str = ""
    cell: int = 28
    view: int = 560
    aspect: float = 2.0
    frame: Frame = "thousand"
    order: Order = "xyxy"
    pixels: int = PIXELS
    grounded: bool = True
    source: str = ""
    title: str = ""
    model_types: tuple[str, ...] = ()
    fit: Literal["exact", "squash", "pad", "tiles"] = "exact"
    extractor: Extractor = "boxes"
    per_view: Extractor = "attention"
    type_ids: str | None = None
    placeholder: str = ""
    expansion: str = ""
    image_token: str = ""
    prompt: str = ""
    depth: float = 0.6

    def choices(self, heads: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The extractors here, and those for each view, the usual first; with localisation `heads` it is attention."""
        usual = "attention" if heads and self.extractor == "boxes" else self.extractor
        known = ("attention", "boxes") if self.grounded else ("attention",)
        return (usual, *known, "views"), (self.per_view, *known)


SERVED = msgspec.json.decode(Path(__file__).with_name("families.json").read_bytes(), type=tuple[Family, ...])
FAMILIES = tuple(each for each in SERVED if each.model_types)  # those that also run here


def family_of(model: str) -> Family:
    """How the model of this name is asked: ``Qwen/Qwen2.5-VL-7B-Instruct``, ``qwen2.5vl:7b``; x first for others."""
    return next((each for each in SERVED if re.search(each.pattern, model.lower())), Family())


def exact_size(cell: int, pixels: int, aspect: float = 2.0) -> tuple[int, int]:
    """(height, width) of the largest picture of at most `pixels` pixels whose sides are multiples of `cell`.

    width / height is exactly `aspect` if such a picture fits (2 for a panorama, 1 for a view; others are rounded to
    the nearest ratio of whole numbers up to 16), otherwise as near to it as whole cells allow. Raises `ImageError` if
    not even one cell fits.
    """
    cells = pixels // (cell * cell) if cell >= 1 else 0
    if cells < 1 or not (math.isfinite(aspect) and aspect > 0):
        raise ImageError(
            f"no picture of {aspect:g}:1 with cells of {cell} pixels has at most {pixels} pixels; allow more pixels"
        )
    ratio = Fraction(aspect).limit_denominator(16) if aspect >= 1 else 1 / Fraction(1 / aspect).limit_denominator(16)
    if times := math.isqrt(cells // (ratio.numerator * ratio.denominator)):
        return cell * times * ratio.denominator, cell * times * ratio.numerator
    shapes = [(row, max(1, min(round(row * aspect), cells // row))) for row in range(1, cells + 1)]
    row, column = min(shapes, key=lambda shape: (abs(math.log(shape[1] / shape[0] / aspect)), -shape[0] * shape[1]))
    return cell * row, cell * column


@dataclass(frozen=True, eq=False)
class Labelled:
    """A panorama ``(H, W, 3)`` uint8, a query, and the direction ``(3,)`` and angular radius of its target."""

    panorama: np.ndarray
    query: str
    direction: np.ndarray
    radius: float


# --- questions --------------------------------------------------------------------------------------------------------

# The question without content in relative attention (Zhang et al., "MLLMs know where to look", ICLR 2025).
GENERAL = "Write a general description of the image."

_FRAMES = {
    "pixels": ("in pixels of this image", "100, 150, 220, 310"),
    "thousand": ("as whole numbers from 0 to 1000 of the image's width and height", "100, 150, 220, 310"),
    "percent": ("as numbers from 0 to 100 of the image's width and height", "10.0, 15.0, 22.0, 31.0"),
    "unit": ("as fractions from 0 to 1 of the image's width and height", "0.10, 0.15, 0.22, 0.31"),
}
_KEYS = {"xyxy": ("bbox_2d", "x1, y1, x2, y2"), "yxyx": ("box_2d", "y1, x1, y2, x2")}


def phrase(query: str) -> str:
    """`query` on one line. Raises `QueryError` if it is empty."""
    words = " ".join(query.split()) if isinstance(query, str) else ""
    if not words:
        raise QueryError(f"the query is {query!r}; wanted words for what to look for, such as 'red chair'")
    return words


def ask_boxes(query: str, frame: Frame, order: Order = "xyxy") -> str:
    """The request for all boxes of what `query` names, as JSON, in the model's own frame and order of coordinates."""
    name = phrase(query)
    key, corners = _KEYS[order]
    where, numbers = _FRAMES[frame]
    return (
        f"Locate every instance of this in the image: {name}. Answer with a JSON list and nothing else, one entry per "
        f'instance: [{{"{key}": [{corners}], "label": "{name.replace(chr(34), chr(39))}"}}], with the coordinates '
        f"{where}, for example [{numbers}]. If there is none in the image, answer []."
    )


def boxes_schema(frame: Frame, order: Order = "xyxy") -> dict[str, Any]:
    """The JSON schema of the answer to `ask_boxes`."""
    number, key = {"type": "number" if frame in ("percent", "unit") else "integer"}, _KEYS[order][0]
    corners = {"type": "array", "items": number, "minItems": 4, "maxItems": 4}
    entry = {"type": "object", "properties": {key: corners, "label": {"type": "string"}}, "required": [key, "label"]}
    return {"type": "array", "items": {**entry, "additionalProperties": False}, "maxItems": 16}


def ask_presence(query: str) -> str:
    """The question whether the picture shows what `query` names, to be answered by yes or no."""
    return f"Does this image show the following: {phrase(query)}? Answer with one word, yes or no."


# --- conversations ----------------------------------------------------------------------------------------------------

IMAGE = "<image>"  # in a message's text: the place of the next of its pictures
MAX_TOKENS = 512  # default length of a reply


@dataclass(frozen=True, eq=False)
class Message:
    """One message: `text` with an `IMAGE` for each of `images` ``(H, W, 3)`` uint8."""

    role: Literal["system", "user", "assistant"]
    text: str
    images: tuple[np.ndarray, ...] = ()

    def parts(self) -> list[str | np.ndarray]:
        """Text and pictures in order; empty text is left out."""
        found: list[str | np.ndarray] = []
        for index, text in enumerate(self.text.split(IMAGE, len(self.images))):
            found += [text] * bool(text) + [*self.images[index : index + 1]]
        return found


@dataclass(frozen=True)
class ChatReply:
    """A model's reply, and its cost if known."""

    text: str
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chat(Protocol):
    """A model that answers a conversation."""

    def __call__(self, messages: Sequence[Message]) -> ChatReply:
        """The reply to `messages`. Raises if there is none: that is a failed attempt, never a wrong answer."""
        ...
