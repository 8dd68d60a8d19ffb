"""What is asked of a server, and what it answers: requests with pictures, and their answers."""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from PIL import Image

from eagor._checks import whole, within
from eagor._values import lazy
from eagor.errors import AnswerError
from eagor.perception.vlm.answers import Token, means, without_thoughts

LIKELIEST = 10  # alternatives per token whose probabilities are requested


@dataclass(frozen=True, eq=False)
class Picture:
    """An image ``(H, W, 3)`` uint8 to send; encoded once for all questions about it.

    PNG is lossless, JPEG much smaller. `quality`: of JPEG, 0 to 100; None: 95 without chroma subsampling.
    """

    image: np.ndarray
    format: Literal["png", "jpeg"] = "png"
    quality: int | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.image.shape[0], self.image.shape[1]

    @lazy
    def uri(self) -> str:
        """The picture as a data URI."""
        how: dict[str, Any] = {"quality": self.quality}
        if self.quality is None:
            how = {"compress_level": 1} if self.format == "png" else {"quality": 95, "subsampling": 0}
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(self.image)).save(file, self.format, **how)
        return f"data:image/{self.format};base64,{base64.b64encode(file.getvalue()).decode('ascii')}"


@dataclass(frozen=True, eq=False)
class Request:
    """One chat-completion request.

    `messages`: role, text and pictures of each. `schema`: of a JSON answer, None for plain text. `likeliest`: number of
    alternatives per token to return with log probabilities; None for no probabilities. `silence`: accept an empty
    answer.
    """

    messages: Sequence[tuple[str, Sequence[str | Picture]]]
    max_tokens: int
    temperature: float = 0.0
    schema: dict[str, Any] | None = None
    likeliest: int | None = None
    silence: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the last picture, for errors."""
        sizes = [part.size for _, parts in self.messages for part in parts if isinstance(part, Picture)]
        return sizes[-1] if sizes else (0, 0)

    @property
    def features(self) -> set[str]:
        """What a server may not support: options, and fields that reasoning models have not."""
        asked = {"response_format": self.schema, "logprobs": self.likeliest, "max_tokens": 1, "temperature": 1}
        return {name for name, value in asked.items() if value is not None}

    def body(self, model: str, refused: Set[str]) -> dict[str, Any]:
        """The arguments of ``chat.completions.create``, without the features that the server rejected."""
        wanted = self.features - refused
        body: dict[str, Any] = {
            "model": model,
            "messages": [{"role": role, "content": _content(parts)} for role, parts in self.messages],
            "max_tokens" if "max_tokens" in wanted else "max_completion_tokens": self.max_tokens,
        }
        if "temperature" in wanted:
            body["temperature"] = self.temperature
        if "logprobs" in wanted:
            body["logprobs"] = True
            if self.likeliest:
                body["top_logprobs"] = self.likeliest
        if "response_format" in wanted:
            named = {"name": "answer", "schema": self.schema, "strict": True}
            body["response_format"] = {"type": "json_schema", "json_schema": named}
        return body

    def read(self, completion: Any, model: str, tries: int) -> Answer:
        """The answer in a completion of the `model` that was asked, which took this many `tries`.

        Raises `AnswerError` if it is empty; `AttributeError` or `TypeError`, which show what came, if it is not a chat
        completion: the client does not validate what servers send.
        """
        if not isinstance(completion.choices, list):
            raise TypeError(f"no list of choices in {completion!r}")
        choice = completion.choices[0] if completion.choices else None
        prompt_tokens, completion_tokens = _counts(completion.usage)
        who = completion.model or model
        if not choice:
            raise AnswerError(f"{who} returned no choices; look at the log of its server")
        content = choice.message.content
        text, thoughts = _text(content), _text(getattr(choice.message, "reasoning_content", None) or
                                               getattr(choice.message, "reasoning", None))  # fmt: skip
        if not text.strip() and thoughts.strip() and choice.finish_reason != "length":
            # Servers whose parser waits for the end of thoughts that were never begun: the end of these is the answer.
            content = text = re.split(r"\n\s*\n", without_thoughts(thoughts).strip() or thoughts.strip())[-1]
            choice.logprobs = None
        if content is None or (not self.silence and not text.strip()):
            why = f"it stopped because of {choice.finish_reason!r}"
            why += f", {completion_tokens} tokens" if completion_tokens is not None else ""
            why += f", after {len(thoughts)} characters of reasoning" if thoughts else ""
            raise AnswerError(
                f"{who} gave an empty answer ({why}). If it thinks before it answers, allow more tokens "
                "(max_tokens=...) or turn that off; else look at the server's chat template for this model"
            )
        told = None if self.likeliest is None else getattr(choice, "logprobs", None)
        given = _tokens(getattr(told, "content", None))
        revision = getattr(completion, "system_fingerprint", None)
        return Answer(
            text,
            tuple((entry.token, entry.logprob) for entry in given),
            tuple(tuple((other.token, other.logprob) for other in _tokens(entry.top_logprobs)) for entry in given),
            str(completion.model or ""),
            str(revision) if revision else None,
            prompt_tokens,
            completion_tokens,
            tries,
        )


def question(
    picture: Picture, text: str, max_tokens: int, schema: dict[str, Any] | None = None, alternatives: bool = False
) -> Request:
    """A question about one picture; with `alternatives` also request the likeliest alternatives of each token.

    The picture comes first: servers that cache common prefixes then process it once for all questions.
    """
    messages = [("user", (picture, text))]
    return Request(messages, max_tokens, schema=schema, likeliest=LIKELIEST if alternatives else 0)


def _content(parts: Sequence[str | Picture]) -> str | list[dict[str, Any]]:
    """Text and pictures as the content of a message."""
    if not any(isinstance(part, Picture) for part in parts):
        return "".join(map(str, parts))
    return [
        {"type": "text", "text": part}
        if isinstance(part, str)
        else {"type": "image_url", "image_url": {"url": part.uri}}
        for part in parts
    ]


def _text(content: Any) -> str:
    """The text of a message's content, a string or a list of parts; parts with thoughts are left out.

    Raises `TypeError` for anything else.
    """
    if isinstance(content, list):
        parts = [{"text": part} if isinstance(part, str) else part for part in content]
        return "".join(_text(part.get("text")) for part in parts if part.get("type", "text") in ("text", "output_text"))
    if content is not None and not isinstance(content, str):
        raise TypeError(f"the answer is {content!r}")
    return content or ""


def _counts(usage: Any) -> tuple[int | None, int | None]:
    """Prompt and answer tokens as counted by the server; None where it sends no number."""
    counts = [getattr(usage, name, None) for name in ("prompt_tokens", "completion_tokens")]
    prompt, answer = (count if whole(count, 0) else None for count in counts)
    return prompt, answer


def _tokens(entries: Any) -> list[Any]:
    """The entries with a text and a log probability; some servers write null, or NaN."""
    return [entry for entry in entries or () if isinstance(entry.token, str) and within(entry.logprob, -math.inf)]


@dataclass(frozen=True)
class Answer:
    """A server's answer.

    `tokens` are the pieces of the answer with log probabilities, `likeliest` the alternatives at each piece; both are
    empty if the server sends none. Counts are None if it does not send them.
    """

    text: str
    tokens: tuple[Token, ...]
    likeliest: tuple[tuple[Token, ...], ...]
    model: str
    revision: str | None
    prompt_tokens: int | None
    completion_tokens: int | None
    requests: int

    @property
    def verdict(self) -> tuple[Token, ...]:
        """The alternatives at the first piece, after any thoughts, that means yes or no; () if there is none."""
        pieces = "".join(piece for piece, _ in self.tokens)
        bare, place = without_thoughts(pieces), 0
        for (piece, log), others in zip(self.tokens, self.likeliest, strict=True):
            said = bare[place : place + len(piece)]
            place += len(piece)
            if said.strip() and means(said) is not None:
                return others or ((piece, log),)
        return ()
