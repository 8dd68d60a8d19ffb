"""A vision-language model on a server: vLLM, SGLang, Ollama, llama.cpp, ``transformers serve``, or a hosted one.

It works with any server that speaks OpenAI's chat completions. A server returns text and, at best, token probabilities.
It is asked for ``boxes`` in the whole panorama and again in the panorama rolled by half a turn, or shown ``views`` that
cover the sphere (docs/models.md). Attention needs a local model: `eagor.perception.transformers`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any

import msgspec
import numpy as np

from eagor.errors import AnswerError
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.perception import parse_options, place_of, vlm
from eagor.perception.endpoint.server import DEFAULT_SERVER, Amount, Answer, ChatClient, Count, ServerOptions, part
from eagor.perception.json_files import checked
from eagor.perception.vlm import IMAGE, MAX_TOKENS, ChatReply, Message
from eagor.perception.vlm.answers import parse_presence
from eagor.perception.vlm.perception import Cost, ModelPerception

__all__ = ["EndpointOptions", "EndpointPerception", "ServedChat", "chat_from_text", "from_text"]

_LIKELIEST = 10  # alternatives per token whose probabilities are requested
_SHORT = 5  # words: an answer that was cut behind yes or no
_SECOND_TRY = 0.5  # temperature after an unreadable answer: at 0 the model would repeat it


class EndpointOptions(ServerOptions, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """How a served model is shown panoramas; docs/models.md says what each option means."""

    extractor: Annotated[str, msgspec.Meta(pattern="^(boxes|views|)$")] = ""
    per_view: Annotated[str, msgspec.Meta(pattern="^(presence|boxes)$")] = "presence"
    pixels: Amount = 0
    cell: Amount = 0
    frame: Annotated[str, msgspec.Meta(pattern="^(pixels|thousand|percent|unit|)$")] = ""
    order: Annotated[str, msgspec.Meta(pattern="^(xyxy|yxyx|)$")] = ""
    seam: bool = True
    image_format: Annotated[str, msgspec.Meta(pattern="^(png|jpeg)$")] = "png"
    max_tokens: Count = 1024
    concurrency: Count = 4


class EndpointPerception(ModelPerception):
    """Asks the `model` (its name there, empty for the server's only one) on the server at `address`.

    `calibration`: how yes and no in views become evidence; None for the default of `Evidence`. `detector`: error model
    of boxes; None for `DetectorModel()`. `options`: those of `EndpointOptions`. Raises `EagorError` for invalid values.
    """

    view_rows = 90

    def __init__(
        self,
        model: str = "",
        address: str = DEFAULT_SERVER,
        *,
        calibration: Calibration | None = None,
        detector: DetectorModel | None = None,
        **options: Any,
    ) -> None:
        self.options = given = checked(options, EndpointOptions, "a served model")
        self.client = ChatClient(model, address, given, given.concurrency)
        self._warned = False  # whether a warning said that it may get no pictures
        super().__init__(self, given.extractor, given.per_view, given.seam, calibration, detector)

    @property
    def family(self) -> vlm.Family:
        """How the model is asked, by its name and the options."""
        stated = {name: given for name in ("cell", "frame", "order") if (given := getattr(self.options, name))}
        return replace(vlm.family_of(self.client.model()), **stated)

    def extractors(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Boxes first for a model that was trained to write them."""
        return (("boxes", "views") if self.family.grounded else ("views", "boxes")), ("presence", "boxes")

    def sizes(self, aspect: float, view: bool = False) -> tuple[tuple[int, int], tuple[int, int]]:
        """Of models that take panoramas in their own shape, whole cells of this shape; others get one square."""
        family = self.family
        pixels = self.options.pixels or (family.view**2 if view else family.pixels)
        height, width = vlm.exact_size(family.cell, pixels, aspect if family.aspect == 2.0 else family.aspect)
        return (height, width), (height // family.cell, width // family.cell)

    def boxes(self, images: Sequence[np.ndarray], texts: Sequence[str], read: Any) -> tuple[list[Any], Cost]:
        """What `read` makes of the answers per text and image; raises `AnswerError` if they cannot be read."""
        schema = {"name": "answer", "schema": vlm.boxes_schema(self.family.frame, self.family.order), "strict": True}
        how = {"response_format": {"type": "json_schema", "json_schema": schema}}

        def whole(answer: Answer) -> Any:
            boxes = read(answer.text, answer.tokens)
            if answer.cut and not boxes and not answer.text.rstrip().endswith(("]", "}", "`")):
                raise _cut_off(answer)
            return boxes

        return self._answered(images, texts, how, whole)

    def maps(self, images: Sequence[np.ndarray], queries: Sequence[str], wrap: bool) -> tuple[np.ndarray, Cost]:
        """The probability that the thing is there, as a single cell per query and image."""
        texts, how = [vlm.ask_presence(query) for query in queries], {"top_logprobs": _LIKELIEST}

        def whole(answer: Answer) -> float:
            if answer.cut and len(answer.text.split()) > _SHORT:
                raise _cut_off(answer)
            return parse_presence(answer.text, answer.verdict)

        found, cost = self._answered(images, texts, how, whole)
        return np.array(found)[..., None, None], cost

    def _answered(
        self, images: Sequence[np.ndarray], texts: Sequence[str], how: dict[str, Any], read: Any
    ) -> tuple[Any, Cost]:
        """What is read of the answers per text and image; one that cannot be read is asked for once more."""
        # The picture comes first: servers that cache common prefixes then process it once for all questions.
        pictures = [part(image, self.options.image_format) for image in images]
        contents = [[picture, part(text)] for text in texts for picture in pictures]
        always = {"temperature": 0.0, "max_tokens": self.options.max_tokens, "logprobs": True, **how}
        bodies = [{"messages": [{"role": "user", "content": each}], **always} for each in contents]
        answers, readings = self.client.ask(bodies), []
        for body, answer in zip(bodies, [*answers], strict=True):
            try:
                readings.append(read(answer))
            except AnswerError:
                answers += self.client.ask([{**body, "temperature": _SECOND_TRY}])
                readings.append(read(answers[-1]))
        counts = ([getattr(answer, f"{kind}_tokens") for answer in answers] for kind in ("prompt", "completion"))
        prompt, written = (None if None in each else sum(each) for each in counts)
        if prompt and 3 * prompt < len(images) * sum(map(len, texts)) and not self._warned:
            self._warned = True
            warnings.warn(
                f"{self.client.shown} counts {prompt} tokens in {len(answers)} questions, which is no more than their "
                f"text: is {self.client.model()!r} a vision-language model, and did it get the pictures?",
                UserWarning,
                stacklevel=6,
            )
        served, revisions = (sorted({name for answer in answers if (name := getattr(answer, kind))})
                             for kind in ("model", "revision"))  # fmt: skip
        cost = {
            "model": self.client.model(), "served_as": ", ".join(served), "revision": ", ".join(revisions) or None,
            "server": self.client.shown, "family": self.family.name, "images": len(images),
            "requests": sum(answer.requests for answer in answers), "prompt_tokens": prompt, "answer_tokens": written,
            "probabilities": any(answer.tokens for answer in answers),
        }  # fmt: skip
        return [readings[start : start + len(images)] for start in range(0, len(readings), len(images))], cost

    def check(self) -> None:
        """Look at a grey picture, to test the setup before a long run; ignores an unreadable answer."""
        with suppress(AnswerError):
            self(np.full((self.rows, 2 * self.rows, 3), 128, dtype=np.uint8), "chair")


def _cut_off(answer: Answer) -> AnswerError:
    return AnswerError(f"the model answered {answer.text[:200]!r}, and was cut off; allow more tokens (max_tokens=...)")


class ChatOptions(ServerOptions, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """`quality`: of the JPEG pictures that are sent, as in H*Bench's runner; 0 sends PNG."""

    temperature: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    max_tokens: Count = MAX_TOKENS
    quality: Annotated[int, msgspec.Meta(ge=0, le=100)] = 85


class ServedChat:
    """A `eagor.perception.vlm.Chat` with a model on an OpenAI-compatible server; `options` as of `ChatOptions`.

    Raises `EagorError` for invalid values, and as `ChatClient`.
    """

    def __init__(self, model: str = "", address: str = DEFAULT_SERVER, **options: Any) -> None:
        self.options = checked(options, ChatOptions, "a served model")
        self.client = ChatClient(model, address, self.options)

    def __call__(self, messages: Sequence[Message], max_tokens: int = 0) -> ChatReply:
        """The reply. Raises `ServerError`, `QueryError` (no such model), or `AnswerError` for a reply without text."""
        options, form = self.options, "jpeg" if self.options.quality else "png"
        turns = [{"role": each.role, "content": [part(one, form, options.quality) for one in each.parts()]
                 if each.images else each.text} for each in messages]  # fmt: skip
        body = {"messages": turns, "max_tokens": max_tokens or options.max_tokens, "temperature": options.temperature}
        (answer,) = self.client.ask([body], silence=True)
        return ChatReply(answer.text, answer.prompt_tokens, answer.completion_tokens)

    def check(self) -> None:
        """Ask for one word about a grey picture, to test the setup before a long run; ignores an empty reply."""
        grey = np.full((112, 112, 3), 128, dtype=np.uint8)
        with suppress(AnswerError):
            self([Message("user", f"{IMAGE}\nWhat is this?", (grey,))], 1)


def from_text(text: str = "", /, **options: Any) -> EndpointPerception:
    """The perception named by ``MODEL@ADDRESS[?option=value&...]``; options passed by name take precedence.

    The model defaults to the only one of the server, the address to ``http://localhost:8000/v1``; an address without a
    path gets ``/v1``. Options are those of `EndpointPerception`.

    Raises `EagorError` for unknown or unreadable options, several addresses, and missing packages.
    """
    return _named(EndpointPerception, text, options)


def chat_from_text(text: str) -> ServedChat:
    """The talking model named by ``MODEL@ADDRESS[?option=value&...]``; see `from_text`."""
    return _named(ServedChat, text, {})


def _named(make: Any, text: str, options: dict[str, Any]) -> Any:
    place, _, written = text.partition("?")
    model, address = place_of(place)
    return make(model, address or DEFAULT_SERVER, **(parse_options(written) | options))
