"""Failures of servers, as errors that say what to change."""

from __future__ import annotations

import re
from collections.abc import Set
from dataclasses import dataclass
from typing import Any

from eagor._secrets import redacted
from eagor.errors import EagorError, QueryError, ServerError
from eagor.perception.endpoint.transport import Unfit

RETRIED = {408, 409, 425, 429, 500, 502, 503, 504, 529}
# What servers (vLLM, SGLang, Ollama, llama.cpp, transformers serve, hosted ones) write when they reject a request.
_CONTEXT = re.compile(
    r"context (?:length|size|window)|maximum (?:model|context|allowed)? ?length|max_model_len|exceeds? .{0,40}context"
    r"|(?:prompt|input) .{0,60}(?:too long|longer than|exceeds)|too many tokens|exceed_context|context_length_exceeded"
)
_NO_IMAGES = re.compile(
    r"not a multimodal model|(?:does not|doesn't|not) support(?:ed|s)?\W.{0,30}(?:image|vision|multimodal)"
    r"|(?:image|vision|multimodal).{0,40}(?:not supported|unsupported|not enabled|mmproj)|mmproj|unknown part type"
    r"|missing data required for image|(?:at most 0|0) image|image_url.{0,40}(?:invalid|not allowed|unexpected)"
    r"|content must be a string|image_url is only supported"
)
_MODEL = re.compile(
    r"\bmodel\b.{0,200}(?:not (?:found|exist)|does not exist|doesn't exist|unknown|not available|not loaded)"
)
_FEATURES = {
    "response_format": re.compile(r"response_format|json_schema|\bschema\b|grammar|guided|structured"),
    "logprobs": re.compile(r"logprob"),
}


@dataclass(frozen=True)
class Asked:
    """Facts about the failed request, for the text of the error."""

    model: str
    server: str
    image: tuple[int, int]
    timeout: float
    tries: int


def refused_feature(error: Any, used: Set[str]) -> str | None:
    """The optional feature among `used` that the server rejects; None if the error has another cause."""
    if getattr(error, "status_code", None) not in (400, 404, 422, 500, 501):
        return None
    said = message(error).lower()
    return next((name for name, words in _FEATURES.items() if name in used and words.search(said)), None)


def worth_retrying(error: Any) -> bool:
    """Whether the same request may succeed later."""
    import openai

    if isinstance(error, openai.APIConnectionError | TimeoutError):
        return _unfit(error) is None
    said = message(error).lower()
    hopeless = _CONTEXT.search(said) or _NO_IMAGES.search(said)
    return getattr(error, "status_code", None) in RETRIED and not hopeless


def retry_after(error: Any) -> float:
    """Seconds to wait as requested by the server, at most a minute; 0 without a request."""
    headers = getattr(getattr(error, "response", None), "headers", None) or {}
    try:
        return min(max(float(headers.get("retry-after", 0)), 0.0), 60.0)
    except ValueError:
        return 0.0


def explained(error: Any, asked: Asked, served: list[str] | None) -> EagorError:
    """The error to raise for what the client raised; `served`: names of the server's models, None if unknown."""
    import openai

    server, model = asked.server, asked.model
    tries = "tried once" if asked.tries == 1 else f"tried {asked.tries} times"
    status, said = getattr(error, "status_code", None), message(error)
    if isinstance(error, openai.APITimeoutError | TimeoutError):
        return ServerError(
            f"{server} gave no answer within {asked.timeout:g} s ({tries}). Allow more time (timeout=...), send fewer "
            "pixels, or fewer requests at once (concurrency=...), or check whether the server hangs"
        )
    if unfit := _unfit(error):
        return ServerError(f"{server} {unfit}; is it an OpenAI-compatible server?")
    if isinstance(error, openai.APIConnectionError):
        cause = error.__cause__ or error
        why = f"{type(cause).__name__}: {' '.join(str(cause).split()) or 'no reason given'}"
        return ServerError(
            f"no server answers at {server} ({why}; {tries}). Start one, for example `vllm serve {model or 'MODEL'}`, "
            "or check the host, the port and the path (most end in /v1)"
        )
    if status is not None and 300 <= status < 400:
        place = str(error.response.headers.get("location", "an address that it does not name"))
        return ServerError(
            f"{server} redirects to {redacted(place.partition('?')[0])[:200]} (HTTP {status}); neither key nor "
            "picture was sent there. If the model is there, give that address"
        )
    if _CONTEXT.search(said.lower()):
        return ServerError(
            f"the picture of {asked.image[1]} x {asked.image[0]} pixels and the question are too long for {model} as "
            f"served at {server}: {said}. Send fewer pixels (pixels=...) or start the server with a longer context "
            "(vLLM --max-model-len, llama.cpp -c, Ollama num_ctx)"
        )
    if _NO_IMAGES.search(said.lower()):
        return ServerError(
            f"{model} as served at {server} takes no images: {said}. Serve a vision-language model (llama.cpp: with "
            "its --mmproj file)"
        )
    if status == 404 or _MODEL.search(said.lower()):
        if served and model not in served:
            return QueryError(
                f"{server} has no model {model!r} ({said}); it has {', '.join(map(repr, served))}. Name one of these "
                "before the @"
            )
        return ServerError(
            f"{server} has no chat completions for {model!r} (HTTP {status}: {said}). Is the model loaded, and does "
            "the address end as the server wants it (mostly /v1)?"
        )
    if status in (401, 403):
        return ServerError(
            f"{server} wants a key, or does not accept it (HTTP {status}: {said}). Put it in an environment variable "
            "and name that with key=VARIABLE"
        )
    if status is not None:
        return ServerError(f"{server} refused the request ({tries}; HTTP {status}): {said}")
    return ServerError(
        f"{server} answered with something other than a chat completion ({type(error).__name__}: {said}); is it an "
        "OpenAI-compatible server, and does the address end in /v1?"
    )


def message(error: Any) -> str:
    """The server's error message, on one line."""
    body = getattr(error, "body", None)
    for key in ("error", "message", "detail"):
        if isinstance(body, dict) and key in body:
            body = body[key]
    text = str(body if isinstance(body, str | list | dict) and body else error)
    line = " ".join(text.split())
    return line if len(line) <= 300 else line[:297] + "..."


def _unfit(error: BaseException) -> Unfit | None:
    """The `Unfit` behind the error, also where the client wrapped it; None if there is none."""
    return next((one for one in (error, error.__cause__) if isinstance(one, Unfit)), None)
