"""How one server is reached by the openai client, and readable errors.

Retries are those of the client, by its rules (``Retry-After`` as seconds or as a date). `client_of` adds what it lacks:
a deadline and a bound for the whole answer, no secrets in it, errors within HTTP 200 made errors, and no retry of what
will not pass.
"""

from __future__ import annotations

import asyncio
import base64
import json
import os
import re
import ssl
from collections.abc import Set
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit

from eagor._files import keep_out, redacted
from eagor.errors import EagorError, QueryError, ServerError
from eagor.perception.endpoint.addresses import bare_address, login_of, query_of

_CONNECT = 10.0  # seconds to reach a server
_LEAST_BYTES = 4 << 20  # allowed for any answer, plus
_PER_TOKEN = 2 << 10  # for each token with ten alternatives
_LONGEST_REST = 30.0  # seconds between two tries at most, unless the server asks for longer
UNFIT = "unfit_answer"  # the code of an answer that is not read: too long, or compressed without request
_TRIES = "x-stainless-retry-count"  # where the client says how often it asked before
_OF_TRANSPORT = ("content-length", "content-encoding", "transfer-encoding")
_TOLD = ("message", "detail", "msg", "error_msg")


def client_of(
    url: str, key: str, timeout: float, max_tokens: int, authorities: str, retries: int, backoff: float
) -> Any:
    """An `openai.AsyncOpenAI` for the server at `url`.

    `key`: empty for none. `timeout`: seconds for each whole answer. `authorities`: a certificate file, empty for the
    usual ones. `backoff`: seconds before the first of `retries`, where the server says nothing else.
    """
    import openai

    host = urlsplit(url).hostname or ""
    login = base64.b64encode(login_of(url).encode()).decode() if login_of(url) else ""
    keep_out(key, login)
    authorization = f"Basic {login}" if login else f"Bearer {key or 'none'}"
    theirs = host == "openai.com" or host.endswith(".openai.com")
    most = _LEAST_BYTES + _PER_TOKEN * max_tokens

    def prepare(request: Any) -> None:
        request.headers["accept-encoding"] = "identity"
        if theirs:
            return
        # The client adds OpenAI account data from the environment for every server.
        written = os.environ.get("OPENAI_CUSTOM_HEADERS", "").split("\n")
        for name in ("openai-organization", "openai-project", *(line.partition(":")[0].strip() for line in written)):
            if name and name.lower() not in ("host", "content-length", "content-type"):
                request.headers.pop(name, None)
        request.headers["authorization"] = authorization

    async def answered(response: Any) -> Any:
        """The whole answer, as an error where it is one, with what the client's retries go by."""
        try:
            body = await _body(response, most)
        finally:
            await response.aclose()
        status, body = _honest(response.status_code, body)
        headers = {name: value for name, value in response.headers.items() if name not in _OF_TRANSPORT}
        if status >= 400:
            tried = int(response.request.headers.get(_TRIES, 0))
            if not {"retry-after", "retry-after-ms"} & headers.keys():
                headers["retry-after-ms"] = str(1000 * max(0.001, min(backoff * 2**tried, _LONGEST_REST)))
            if _hopeless(status, body.decode("utf-8", "replace").lower()):
                headers["x-should-retry"] = "false"
        return type(response)(status, headers=headers, content=body, request=response.request)

    class Client(openai.DefaultAsyncHttpxClient):
        async def send(self, request: Any, **options: Any) -> Any:
            prepare(request)
            options["stream"] = True
            try:
                async with asyncio.timeout(timeout):
                    return await answered(await super().send(request, **options))
            except TimeoutError as error:
                below = import_module(type(request).__module__.partition(".")[0])  # httpx, or its successor
                raise below.ReadTimeout(f"no answer within {timeout:g} s", request=request) from error

    limit = openai.Timeout(timeout, connect=min(_CONNECT, timeout))
    http = Client(
        timeout=limit,
        trust_env=host not in ("localhost", "127.0.0.1", "::1"),  # a proxy cannot reach this machine
        verify=_trusted(authorities),
        follow_redirects=False,  # another host gets neither key nor picture
    )
    return openai.AsyncOpenAI(
        base_url=bare_address(url),
        api_key=key or "none",
        timeout=limit,
        max_retries=retries,
        http_client=http,
        default_query=query_of(url),
    )


async def _body(response: Any, most: int) -> bytes:
    """The body, without the secrets that the server echoes; an error instead of one too long, or compressed."""
    coding, parts, size = response.headers.get("content-encoding", "identity"), [], 0
    if coding.strip().lower() not in ("", "identity"):
        return _unfit(f"compressed its answer ({coding[:40]}), although that was not asked for")
    async for part in response.aiter_raw():
        parts.append(part)
        size += len(part)
        if size > most:
            return _unfit(f"sent more than {most} bytes for one answer")
    return redacted(b"".join(parts).decode("utf-8", "surrogateescape")).encode("utf-8", "surrogateescape")


def _unfit(text: str) -> bytes:
    return json.dumps({"error": {"message": text, "code": UNFIT}}).encode()


def _honest(status: int, body: bytes) -> tuple[int, bytes]:
    """HTTP status and body, where an error hides in the body of a success (OpenRouter, proxies) those of the error.

    Its own code counts, if it is an HTTP status; else 500.
    """
    try:
        found = json.loads(body) if status < 300 else None
    except (ValueError, RecursionError):
        return status, body
    if not isinstance(found, dict) or isinstance(found.get("data"), list):
        return status, body
    choices = found.get("choices")
    first = choices[0] if isinstance(choices, list) and choices else choices
    if isinstance(first, dict) and not first.get("error"):
        return status, body
    error = first.get("error") if isinstance(first, dict) else found.get("error")
    if not error and not first and (told := next((found[key] for key in _TOLD if found.get(key)), None)):
        error = {"message": told, "code": found.get("code")}
    if not error:
        return status, body
    codes = [error.get(key) for key in ("code", "status")] if isinstance(error, dict) else []
    numbers = [int(code) for code in map(str, codes) if re.fullmatch("[45][0-9]{2}", code)]
    guess = 429 if re.search(r"rate.?limit|too many requests", str(error).lower()) else 500
    if UNFIT in codes:
        guess = 400
    return (numbers or [guess])[0], json.dumps({"error": error}).encode()


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


# --- failures ---------------------------------------------------------------------------------------------------------

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
    "max_tokens": re.compile(r"max_completion_tokens|max_tokens\b.{0,60}(?:not supported|unsupported|not permitted)"),
    "temperature": re.compile(r"temperature\b.{0,80}(?:not support|unsupported|deprecated|only the default)"),
}


def refused_feature(error: Any, used: Set[str]) -> str | None:
    """The feature among `used` that the server rejects; None if the error has another cause."""
    said = message(error).lower()
    if getattr(error, "status_code", None) not in (400, 404, 422, 500, 501) or _CONTEXT.search(said):
        return None
    named = getattr(error, "param", None)
    if named in ("max_tokens", "logprobs", "response_format") and named in used:
        return named
    return next((name for name, words in _FEATURES.items() if name in used and words.search(said)), None)


def _hopeless(status: int, said: str) -> bool:
    """Whether the same request will fail again, although the status may promise more."""
    words = [_CONTEXT, _NO_IMAGES, *(_FEATURES.values() if status in (500, 501) else ())]
    return UNFIT in said or any(each.search(said) for each in words)


def explained(
    error: Any, model: str, server: str, timeout: float, *, image: tuple[int, int], served: list[str] | None
) -> EagorError:
    """The error to raise for what the client raised after its tries to send an `image` of this (height, width).

    `served`: names of the server's models, None if unknown.
    """
    import openai

    request = getattr(error, "request", None)
    count = 1 + int(request.headers.get(_TRIES, 0)) if request is not None else 1
    tries = "tried once" if count == 1 else f"tried {count} times"
    status, said = getattr(error, "status_code", None), message(error)
    if isinstance(error, openai.APITimeoutError | TimeoutError):
        return ServerError(
            f"{server} gave no answer within {timeout:g} s ({tries}). Allow more time (timeout=...), send fewer "
            "pixels, or fewer requests at once (concurrency=...), or check whether the server hangs"
        )
    if getattr(error, "code", None) == UNFIT:
        return ServerError(f"{server} {said}; is it an OpenAI-compatible server?")
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
