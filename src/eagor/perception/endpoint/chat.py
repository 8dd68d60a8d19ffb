"""A served vision-language model that talks: conversations as chat completions."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any
from urllib.parse import parse_qsl

import numpy as np

from eagor._checks import require, whole, within
from eagor.errors import AnswerError, EagorError
from eagor.perception.endpoint.addresses import DEFAULT_SERVER, place_of
from eagor.perception.endpoint.messages import count_in, data_uri, first_choice
from eagor.perception.endpoint.servers import Servers, check_asking, connected, need_client, told, unconnected
from eagor.perception.vlm.talk import IMAGE, MAX_TOKENS, Message, Said

QUALITY = 85  # of JPEG, as H*Bench's runner sends its views
_AT_ONCE = 1024  # requests to each server: as many as there are workers


@dataclass(frozen=True)
class ServedChat:
    """A `eagor.perception.vlm.talk.Chat` of a model on OpenAI-compatible servers; requests are shared out among them.

    Nothing is connected to before the first reply. Safe to use from several threads; copies that are pickled connect
    anew. Errors are those of `eagor.perception.endpoint.servers`.

    Attributes:
        model: its name there; empty for the only model that the first server has.
        servers: addresses.
        temperature, max_tokens: of a reply.
        quality: of the JPEG that pictures are sent as, 1 to 100; 0 sends PNG.
        timeout: seconds for one reply.
        retries: more tries of a request that failed for a reason that may pass.
        backoff: seconds before the first of them; doubled for each further one.
        key: the name of the environment variable that holds the servers' key, if they want one.
        ca: a file of certificates to trust instead of the usual ones (without it, ``SSL_CERT_FILE`` counts).

    Raises `EagorError` for values that make no sense.
    """

    model: str = ""
    servers: tuple[str, ...] = (DEFAULT_SERVER,)
    temperature: float = 0.0
    max_tokens: int = MAX_TOKENS
    quality: int = QUALITY
    timeout: float = 120.0
    retries: int = 3
    backoff: float = 0.5
    key: str = ""
    ca: str = ""

    def __post_init__(self) -> None:
        wanted = {
            "temperature": (within(self.temperature, 0), "0 or more"),
            "max_tokens": (whole(self.max_tokens, 1), "a whole number, 1 or more"),
            "quality": (whole(self.quality, 0, 100), "a whole number from 0 to 100"),
        }
        require(self, wanted)
        check_asking(self)

    def __call__(self, messages: Sequence[Message]) -> Said:
        """The reply. Raises `ServerError`, `QueryError` (no such model), or `AnswerError` where there are no words."""
        asked = _Conversation(tuple(messages), self.temperature, self.max_tokens, self.quality)
        (said,) = self._servers.ask([asked])
        return said

    def check(self) -> None:
        """One word about a grey picture, before a long run: is there a server that knows model, key and pictures?

        Raises what a call raises, but for a reply without words.
        """
        grey = np.full((112, 112, 3), 128, dtype=np.uint8)
        message = Message("user", f"{IMAGE}\nWhat is this?", (grey,))
        with suppress(AnswerError):
            self._servers.ask([_Conversation((message,), self.temperature, 1, self.quality)])

    @property
    def _servers(self) -> Servers:
        return connected(self, _AT_ONCE)

    def __repr__(self) -> str:
        return told(self)

    def __getstate__(self) -> dict[str, Any]:
        return unconnected(self)


def chat_from_text(text: str) -> ServedChat:
    """The model that ``MODEL@ADDRESS[,ADDRESS...][?option=value&...]`` names; either side of the @ may be empty.

    Raises `EagorError` for an option that there is not or that makes no sense, an address that is none, or without the
    openai package.
    """
    need_client()
    place, _, written = text.partition("?")
    model, addresses = place_of(place)
    kinds = {field.name: type(field.default) for field in fields(ServedChat) if field.name not in ("model", "servers")}
    options: dict[str, Any] = {}
    for name, value in parse_qsl(written, keep_blank_values=True):
        if name in options:
            raise EagorError(f"{name} comes twice in {text!r}; wanted each option once")
        try:
            options[name] = kinds[name](value)
        except (KeyError, ValueError):
            raise EagorError(f"{name}={value} in {text!r}; a served model has the options {', '.join(kinds)}") from None
    return ServedChat(model, addresses or (DEFAULT_SERVER,), **options)


@dataclass(frozen=True, eq=False)
class _Conversation:
    """A request, as `Servers` sends it."""

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

    def body(self, model: str, refused: frozenset[str]) -> dict[str, Any]:
        told = [{"role": message.role, "content": self._content(message)} for message in self.messages]
        return {"model": model, "messages": told, "temperature": self.temperature, "max_tokens": self.max_tokens}

    def _content(self, message: Message) -> str | list[dict[str, Any]]:
        if not message.images:
            return message.text
        return [
            {"type": "text", "text": part}
            if isinstance(part, str)
            else {"type": "image_url", "image_url": {"url": self._uri(part)}}
            for part in message.parts()
        ]

    def _uri(self, image: np.ndarray) -> str:
        return data_uri(image, "jpeg", quality=self.quality) if self.quality else data_uri(image, "png")

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
        return Said(text, count_in(completion.usage, "prompt_tokens"), count_in(completion.usage, "completion_tokens"))
