"""What is said to models that talk, and by them: pictures and words in, words out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

IMAGE = "<image>"  # in a message's text: the place of the next of its pictures
MAX_TOKENS = 512  # of a reply, where nobody says


@dataclass(frozen=True, eq=False)
class Message:
    """What one side says: `text` with an `IMAGE` for each of `images` ``(H, W, 3)`` uint8."""

    role: Literal["system", "user", "assistant"]
    text: str
    images: tuple[np.ndarray, ...] = ()

    def parts(self) -> list[str | np.ndarray]:
        """Words and pictures in turn; words that are empty are left out."""
        texts = self.text.split(IMAGE, len(self.images))
        found: list[str | np.ndarray] = []
        for index, text in enumerate(texts):
            found += [text] if text else []
            found += [self.images[index]] if index < len(self.images) else []
        return found


@dataclass(frozen=True)
class Said:
    """A model's reply, and what it cost where it is known."""

    text: str
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chat(Protocol):
    """A model that answers a conversation."""

    def __call__(self, messages: Sequence[Message]) -> Said:
        """The reply to `messages`. Raises where there is none: that is a failed attempt, never a wrong answer."""
        ...
