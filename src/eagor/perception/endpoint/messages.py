"""Requests and answers of a chat completion: a picture as a data URI, a question, what came back."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from PIL import Image

from eagor._checks import whole, within
from eagor._lazy import lazy
from eagor.errors import AnswerError
from eagor.perception.vlm.boxes import without_thoughts
from eagor.perception.vlm.presence import means
from eagor.perception.vlm.tokens import Token

LIKELIEST = 10  # tokens whose probabilities are asked for at each place


@dataclass(frozen=True, eq=False)
class Picture:
    """An image ``(H, W, 3)`` uint8 as it is sent; encoded once, however many questions there are about it.

    PNG is exact to the bit, JPEG a fraction of its length; `quality` 0 to 100 is of JPEG, with all of its colours
    where None.
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


def content(parts: Iterable[str | Picture]) -> list[dict[str, Any]]:
    """Words and pictures as the content of a message."""
    return [
        {"type": "text", "text": part}
        if isinstance(part, str)
        else {"type": "image_url", "image_url": {"url": part.uri}}
        for part in parts
    ]


@dataclass(frozen=True, eq=False)
class Question:
    """One request: a picture, words, and how the answer is wanted.

    `alternatives`: whether to ask for the likeliest tokens, not only for those of the answer.
    """

    picture: Picture
    text: str
    max_tokens: int
    schema: dict[str, Any] | None = None
    alternatives: bool = False
    temperature: float = 0.0

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.picture.size

    @property
    def features(self) -> Set[str]:
        """What a server may not know."""
        return {"logprobs", "response_format"} if self.schema else {"logprobs"}

    def body(self, model: str, refused: Set[str]) -> dict[str, Any]:
        """The arguments of ``chat.completions.create``, without the features that the server refused.

        The picture comes first: servers that keep the work on equal beginnings then do it once for all questions.
        """
        body: dict[str, Any] = {
            "model": model,
            "messages": [{"role": "user", "content": content([self.picture, self.text])}],
            "temperature": self.temperature,
            "max_tokens": self.max_tokens,
        }
        if "logprobs" not in refused:
            body["logprobs"] = True
            if self.alternatives:
                body["top_logprobs"] = LIKELIEST
        if self.schema and "response_format" not in refused:
            named = {"name": "answer", "schema": self.schema, "strict": True}
            body["response_format"] = {"type": "json_schema", "json_schema": named}
        return body

    def read(self, completion: Any, tries: int) -> Answer:
        """The answer in what the client returned after so many `tries`.

        Raises `AnswerError` if it is empty, `AttributeError` or `TypeError` if it is no chat completion at all.
        """
        choice = first_choice(completion)
        text = (choice.message.content or "") if choice else ""
        prompt_tokens, completion_tokens = counts_in(completion)
        if not text.strip():
            why = f"it stopped because of {choice.finish_reason!r}" if choice else "no choices"
            raise AnswerError(
                f"{completion.model} gave an empty answer ({why}, {completion_tokens} tokens). If it thinks before it "
                "answers, allow more tokens (max_tokens=...) or turn that off; else look at the server's chat template "
                "for this model"
            )
        given = _tokens(getattr(getattr(choice, "logprobs", None), "content", None))
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


def first_choice(completion: Any) -> Any:
    """The first choice of a completion, None where its list is empty.

    Raises `AttributeError` or `TypeError`, which show what came, if it is no chat completion. The client does not look
    at what servers send.
    """
    if not isinstance(completion.choices, list):
        raise TypeError(f"no list of choices in {completion!r}")
    return completion.choices[0] if completion.choices else None


def counts_in(completion: Any) -> tuple[int | None, int | None]:
    """How many tokens of prompt and answer a server says there were; None where it does not tell, or no number."""
    counts = [getattr(completion.usage, name, None) for name in ("prompt_tokens", "completion_tokens")]
    prompt, answer = (count if whole(count, 0) else None for count in counts)
    return prompt, answer


def _tokens(entries: Any) -> list[Any]:
    """Those that are a piece with the logarithm of its probability; some servers write null, or NaN."""
    return [entry for entry in entries or () if isinstance(entry.token, str) and within(entry.logprob, -math.inf)]


@dataclass(frozen=True)
class Answer:
    """What a server answered.

    `tokens` are the answer's pieces with their log probabilities, `likeliest` the alternatives at each piece; both are
    empty where the server gives none. Counts are None where it does not tell.
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
        """The alternatives at the first piece after any thoughts that means yes or no; () where there is none."""
        pieces = "".join(piece for piece, _ in self.tokens)
        bare, place = without_thoughts(pieces), 0
        for (piece, log), others in zip(self.tokens, self.likeliest, strict=True):
            said = bare[place : place + len(piece)]
            place += len(piece)
            if said.strip() and means(said) is not None:
                return others or ((piece, log),)
        return ()
