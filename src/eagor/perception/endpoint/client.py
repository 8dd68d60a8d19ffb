"""The exchange with one server: requests with pictures and their answers, its address, bounds, readable errors."""

from __future__ import annotations

import base64
import io
import math
import os
import re
import ssl
from collections.abc import AsyncIterator, Sequence, Set
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal
from urllib.parse import parse_qsl, unquote, urlsplit, urlunsplit

import numpy as np
from PIL import Image

from eagor._checks import whole, within
from eagor._files import keep_out, redacted
from eagor._values import lazy
from eagor.errors import AnswerError, EagorError, QueryError, ServerError
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
        """The optional features used, which a server may not support."""
        asked = {"response_format": self.schema, "logprobs": self.likeliest}
        return {name for name, value in asked.items() if value is not None}

    def body(self, model: str, refused: Set[str]) -> dict[str, Any]:
        """The arguments of ``chat.completions.create``, without the features that the server rejected."""
        wanted = self.features - refused
        body: dict[str, Any] = {
            "model": model,
            "messages": [{"role": role, "content": _content(parts)} for role, parts in self.messages],
            "temperature": self.temperature,
            "max_tokens": self.max_tokens,
        }
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
        text = choice.message.content if choice else None
        prompt_tokens, completion_tokens = _counts(completion.usage)
        who = completion.model or model
        if not choice:
            raise AnswerError(f"{who} returned no choices; look at the log of its server")
        if text is None or (not self.silence and not text.strip()):
            why = f"it stopped because of {choice.finish_reason!r}"
            why += f", {completion_tokens} tokens" if completion_tokens is not None else ""
            raise AnswerError(
                f"{who} gave an empty answer ({why}). If it thinks before it answers, allow more tokens "
                "(max_tokens=...) or turn that off; else look at the server's chat template for this model"
            )
        if not isinstance(text, str):
            raise TypeError(f"the answer is {text!r}")
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


# --- the HTTP client --------------------------------------------------------------------------------------------------

_CONNECT = 10.0  # seconds to reach a server
_LEAST_BYTES = 4 << 20  # allowed for any answer, plus
_PER_TOKEN = 2 << 10  # for each token with ten alternatives


class Unfit(ValueError):
    """An answer was rejected: too long, or compressed without request."""


def client_of(url: str, key: str, timeout: float, max_tokens: int, authorities: str) -> Any:
    """An `openai.AsyncOpenAI` for the server at `url`, without retries.

    `key`: empty for none. `timeout`: seconds per step. `authorities`: a certificate file, empty for the usual ones.
    """
    import openai

    host = urlsplit(url).hostname or ""
    login = base64.b64encode(login_of(url).encode()).decode() if login_of(url) else ""
    keep_out(key, login)
    authorization = f"Basic {login}" if login else f"Bearer {key or 'none'}"
    theirs = host == "openai.com" or host.endswith(".openai.com")
    most = _LEAST_BYTES + _PER_TOKEN * max_tokens

    async def prepare(request: Any) -> None:
        request.headers["accept-encoding"] = "identity"
        if theirs:
            return
        # The client adds OpenAI account data from the environment for every server.
        written = os.environ.get("OPENAI_CUSTOM_HEADERS", "").split("\n")
        for name in ("openai-organization", "openai-project", *(line.partition(":")[0].strip() for line in written)):
            if name and name.lower() not in ("host", "content-length", "content-type"):
                request.headers.pop(name, None)
        request.headers["authorization"] = authorization

    async def bound(response: Any) -> None:
        coding = response.headers.get("content-encoding", "identity")
        if coding.strip().lower() not in ("", "identity"):
            raise Unfit(f"compressed its answer ({coding[:40]}), although that was not asked for")
        below = import_module(type(response).__module__.partition(".")[0])  # httpx, or its successor
        response.stream = _whole(below.AsyncByteStream, response.stream, most)

    limit = openai.Timeout(timeout, connect=min(_CONNECT, timeout))
    http = openai.DefaultAsyncHttpxClient(
        timeout=limit,
        trust_env=host not in ("localhost", "127.0.0.1", "::1"),  # a proxy cannot reach this machine
        verify=_trusted(authorities),
        follow_redirects=False,  # another host gets neither key nor picture
        event_hooks={"request": [prepare], "response": [bound]},
    )
    return openai.AsyncOpenAI(
        base_url=bare_address(url),
        api_key=key or "none",
        timeout=limit,
        max_retries=0,
        http_client=http,
        default_query=query_of(url),
    )


def _whole(kind: type, stream: Any, most: int) -> Any:
    """`stream` in one piece, with secrets that the server echoes removed; raises `Unfit` beyond `most` bytes."""

    class Whole(kind):
        async def __aiter__(self) -> AsyncIterator[bytes]:
            parts, size = [], 0
            async for part in stream:
                parts.append(part)
                size += len(part)
                if size > most:
                    raise Unfit(f"sent more than {most} bytes for one answer")
            yield redacted(b"".join(parts).decode("utf-8", "surrogateescape")).encode("utf-8", "surrogateescape")

        async def aclose(self) -> None:
            await stream.aclose()

    return Whole()


def _trusted(authorities: str) -> ssl.SSLContext | bool:
    """The trusted certificates: from a file, from ``SSL_CERT_FILE`` or ``SSL_CERT_DIR``, or the usual ones."""
    file = authorities or os.environ.get("SSL_CERT_FILE") or None
    folder = None if file else os.environ.get("SSL_CERT_DIR") or None
    if not (file or folder):
        return True
    try:
        return ssl.create_default_context(cafile=file, capath=folder)
    except OSError as error:  # includes ssl.SSLError
        name = "ca" if authorities else "SSL_CERT_FILE" if file else "SSL_CERT_DIR"
        raise EagorError(f"{name} is {file or folder}, where no certificates can be read ({error})") from error


# --- addresses, and the secrets in them -------------------------------------------------------------------------------

DEFAULT_SERVER = "http://localhost:8000/v1"


def place_of(text: str) -> tuple[str, tuple[str, ...]]:
    """Model and addresses in ``MODEL@ADDRESS[,ADDRESS...]``; empty where missing."""
    first = re.search(r"https?://", text)
    if first:  # a password in an address may hold another @
        model, addresses = text[: first.start()].removesuffix("@"), text[first.start() :]
    else:
        model, at, addresses = text.rpartition("@")
        model, addresses = (model, addresses) if at else (text, "")
    return model, tuple(address for address in addresses.split(",") if address)


def checked_address(url: str) -> str:
    """`url` with ``/v1`` added if it has no path; its secrets are kept out of output. Raises `EagorError`."""
    try:
        parts = urlsplit(str(url).strip())
        valid = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts, valid = None, False
    if not (parts and valid):
        shown = re.sub(r"//[^/]*@", "//***@", str(url).partition("?")[0])
        raise EagorError(f"{shown!r} is not the address of a server; wanted one such as {DEFAULT_SERVER}")
    login = login_of(url)
    keep_out(login, login.partition(":")[2], parts.netloc.rpartition("@")[0], *query_of(url).values())
    return urlunsplit(parts._replace(path=parts.path.rstrip("/") or "/v1", fragment=""))


def shown_address(url: str) -> str:
    """`url` without its secrets, for output: ``https://***@host/v1?key=***``."""
    parts = urlsplit(url)
    query = "&".join(f"{name}=***" for name in query_of(url))
    _, at, host = parts.netloc.rpartition("@")
    return urlunsplit(parts._replace(netloc=f"***@{host}" if at else host, query=query))


def bare_address(url: str) -> str:
    """`url` without user, password and parameters, which are sent separately."""
    parts = urlsplit(url)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2], query=""))


def login_of(url: str) -> str:
    """``user:password`` in `url`, empty if there is none."""
    parts = urlsplit(url)
    return f"{unquote(parts.username or '')}:{unquote(parts.password or '')}" if "@" in parts.netloc else ""


def query_of(url: str) -> dict[str, str]:
    """The query parameters of `url`."""
    return dict(parse_qsl(urlsplit(url).query, keep_blank_values=True))


# --- failures ---------------------------------------------------------------------------------------------------------

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


def explained(
    error: Any, model: str, server: str, timeout: float, *, image: tuple[int, int], count: int, served: list[str] | None
) -> EagorError:
    """The error to raise for what the client raised after `count` tries to send an `image` of this (height, width).

    `served`: names of the server's models, None if unknown.
    """
    import openai

    tries = "tried once" if count == 1 else f"tried {count} times"
    status, said = getattr(error, "status_code", None), message(error)
    if isinstance(error, openai.APITimeoutError | TimeoutError):
        return ServerError(
            f"{server} gave no answer within {timeout:g} s ({tries}). Allow more time (timeout=...), send fewer "
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
            f"the picture of {image[1]} x {image[0]} pixels and the question are too long for {model} as "
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
