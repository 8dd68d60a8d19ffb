"""Conversations with models: pictures and text in, text out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

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
class Said:
    """A model's reply, and its cost if known."""

    text: str
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chat(Protocol):
    """A model that answers a conversation."""

    def __call__(self, messages: Sequence[Message]) -> Said:
        """The reply to `messages`. Raises if there is none: that is a failed attempt, never a wrong answer."""
        ...
