"""A served vision-language model that talks: conversations as chat completions."""

from __future__ import annotations

from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor._checks import require, whole, within
from eagor.errors import AnswerError
from eagor.perception.endpoint.messages import Picture, content, counts_in, first_choice
from eagor.perception.endpoint.server import Asker, named
from eagor.perception.vlm.talk import IMAGE, MAX_TOKENS, Message, Said

QUALITY = 85  # of JPEG, as H*Bench's runner sends its views
_AT_ONCE = 1024  # requests: as many as there are workers


@dataclass(frozen=True, repr=False)
class ServedChat(Asker):
    """A `eagor.perception.vlm.talk.Chat` of a model on an OpenAI-compatible server.

    Attributes, beside those of `eagor.perception.endpoint.server.Asker`:
        temperature, max_tokens: of a reply.
        quality: of the JPEG that pictures are sent as, 1 to 100; 0 sends PNG.

    Raises `EagorError` for values that make no sense.
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
        """The reply. Raises `ServerError`, `QueryError` (no such model), or `AnswerError` where there are no words."""
        return self._said(messages, self.max_tokens)

    def check(self) -> None:
        """One word about a grey picture, before a long run: is there a server that knows model, key and pictures?

        Raises what a call raises, but for a reply without words.
        """
        grey = np.full((112, 112, 3), 128, dtype=np.uint8)
        with suppress(AnswerError):
            self._said([Message("user", f"{IMAGE}\nWhat is this?", (grey,))], 1)

    def _said(self, messages: Sequence[Message], max_tokens: int) -> Said:
        asked = _Conversation(tuple(messages), self.temperature, max_tokens, self.quality)
        (said,) = self._server(_AT_ONCE, self.max_tokens).ask([asked])
        return said


def chat_from_text(text: str) -> ServedChat:
    """The model that ``MODEL@ADDRESS[?option=value&...]`` names; see `eagor.perception.endpoint.server.named`."""
    return named(ServedChat, text)


@dataclass(frozen=True, eq=False)
class _Conversation:
    """A request, as a `Server` sends it."""

    messages: tuple[Message, ...]
    temperature: float
    max_tokens: int
    quality: int
    features: frozenset[str] = frozenset()

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the last picture."""
        shapes = [image.shape[:2] for message in self.messages for image in message.images]
        return shapes[-1] if shapes else (0, 0)

    def body(self, model: str, refused: Set[str]) -> dict[str, Any]:
        said = [{"role": message.role, "content": self._content(message)} for message in self.messages]
        return {"model": model, "messages": said, "temperature": self.temperature, "max_tokens": self.max_tokens}

    def _content(self, message: Message) -> str | list[dict[str, Any]]:
        if not message.images:
            return message.text
        return content(part if isinstance(part, str) else self._picture(part) for part in message.parts())

    def _picture(self, image: np.ndarray) -> Picture:
        return Picture(image, "jpeg", self.quality) if self.quality else Picture(image)

    def read(self, completion: Any, tries: int) -> Said:
        """The reply. An empty one is one; none at all is an `AnswerError`."""
        choice = first_choice(completion)
        text = choice.message.content if choice else None
        if text is None:
            reason = choice.finish_reason if choice else "no choices"
            raise AnswerError(
                f"{completion.model} returned no text (finish reason: {reason}); is max_tokens too small?"
            )
        if not isinstance(text, str):
            raise TypeError(f"the reply is {text!r}")
        return Said(text, *counts_in(completion))
