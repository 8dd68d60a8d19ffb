"""Conversations with a vision-language model on a server, as chat completions."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from eagor._checks import require, whole, within
from eagor.errors import AnswerError
from eagor.perception.endpoint.messages import Picture, Request
from eagor.perception.endpoint.server import Asker, named
from eagor.perception.vlm.prompts import IMAGE, MAX_TOKENS, Message, Said

QUALITY = 85  # of JPEG, as in H*Bench's runner
_AT_ONCE = 1024  # requests at once: the number of workers is the limit


@dataclass(frozen=True, repr=False)
class ServedChat(Asker):
    """A `eagor.perception.vlm.prompts.Chat` with a model on an OpenAI-compatible server.

    Attributes, in addition to those of `eagor.perception.endpoint.server.Asker`:
        temperature, max_tokens: of a reply.
        quality: of the JPEG pictures that are sent, 1 to 100; 0 sends PNG.

    Raises `EagorError` for invalid values.
    """

    temperature: float = 0.0
    max_tokens: int = MAX_TOKENS
    quality: int = QUALITY

    def __post_init__(self) -> None:
        wanted = {
            "temperature": (within(self.temperature, 0), "0 or more"),
            "max_tokens": (whole(self.max_tokens, 1), "a whole number, 1 or more"),
            "quality": (whole(self.quality, 0, 100), "a whole number from 0 to 100"),
        }
        require(self, wanted)
        super().__post_init__()

    def __call__(self, messages: Sequence[Message]) -> Said:
        """The reply. Raises `ServerError`, `QueryError` (no such model), or `AnswerError` for a reply without text."""
        return self._said(messages, self.max_tokens)

    def check(self) -> None:
        """Ask for one word about a grey picture, to test the setup before a long run; ignores an empty reply."""
        grey = np.full((112, 112, 3), 128, dtype=np.uint8)
        with suppress(AnswerError):
            self._said([Message("user", f"{IMAGE}\nWhat is this?", (grey,))], 1)

    def _said(self, messages: Sequence[Message], max_tokens: int) -> Said:
        said = [(message.role, [self._part(part) for part in message.parts()]) for message in messages]
        asked = Request(said, max_tokens, self.temperature, silence=True)
        (answer,) = self._server(_AT_ONCE, self.max_tokens).ask([asked])
        return Said(answer.text, answer.prompt_tokens, answer.completion_tokens)

    def _part(self, part: str | np.ndarray) -> str | Picture:
        if isinstance(part, str):
            return part
        return Picture(part, "jpeg", self.quality) if self.quality else Picture(part)


def chat_from_text(text: str) -> ServedChat:
    """The model named by ``MODEL@ADDRESS[?option=value&...]``; see `eagor.perception.endpoint.server.named`."""
    return named(ServedChat, text)
