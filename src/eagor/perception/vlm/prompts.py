"""The questions that a model is asked, and conversations with one: pictures and text in, text out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from eagor.errors import QueryError
from eagor.perception.vlm.answers import Frame, Order

# The question without content in relative attention (Zhang et al., "MLLMs know where to look", ICLR 2025).
GENERAL = "Write a general description of the image."

_FRAMES = {
    "pixels": ("in pixels of this image", "100, 150, 220, 310"),
    "thousand": ("as whole numbers from 0 to 1000 of the image's width and height", "100, 150, 220, 310"),
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
    number = {"type": "number"} if frame == "unit" else {"type": "integer"}
    key = _KEYS[order][0]
    entry = {
        "type": "object",
        "properties": {
            key: {"type": "array", "items": number, "minItems": 4, "maxItems": 4},
            "label": {"type": "string"},
        },
        "required": [key, "label"],
        "additionalProperties": False,
    }
    return {"type": "array", "items": entry, "maxItems": 16}


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
        texts = self.text.split(IMAGE, len(self.images))
        found: list[str | np.ndarray] = []
        for index, text in enumerate(texts):
            found += [text] if text else []
            found += [self.images[index]] if index < len(self.images) else []
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
