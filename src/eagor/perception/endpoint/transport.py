"""The HTTP client of one server, with bounds on what it reveals and on the size of answers."""

from __future__ import annotations

import base64
import os
import ssl
from collections.abc import AsyncIterator
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit

from eagor._secrets import keep_out, redacted
from eagor.errors import EagorError
from eagor.perception.endpoint.addresses import bare_address, login_of, query_of

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
