"""Models that talk: pictures and words in, words out. What the ``vlm`` agents of the benchmarks ask.

Any callable that fits `Chat` will do. `load_chat` makes one from a line of text: a model on one or several
OpenAI-compatible servers, or a function of one's own.
"""

from __future__ import annotations

import base64
import hashlib
import importlib
import inspect
import io
import itertools
import os
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from eagor.errors import EagorError

IMAGE = "<image>"  # in a message's text: the place of the next of its pictures
DEFAULT_SERVER = "http://localhost:8000/v1"
QUALITY = 85  # of JPEG, as H*Bench's runner sends its views


@dataclass(frozen=True, eq=False)
class Message:
    """What one side says: `text` with an `IMAGE` for each of `images` ``(H, W, 3)`` uint8."""

    role: Literal["system", "user", "assistant"]
    text: str
    images: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class Said:
    """A model's reply, and what it cost where the server tells."""

    text: str
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chat(Protocol):
    """A model that answers a conversation."""

    def __call__(self, messages: Sequence[Message]) -> Said:
        """The reply to `messages`. Raises where there is none: that is a failed attempt, never a wrong answer."""
        ...


def load_chat(spec: str) -> Chat:
    """The model that `spec` names.

    - ``MODEL@ADDRESS[,ADDRESS...][?option=value&...]``: on OpenAI-compatible servers; model or address may be missing
      (the server's only model; ``http://localhost:8000/v1``). Options are the attributes of `ServedChat`.
    - ``package.module:function``: what ``function()`` returns, a `Chat` of one's own.

    Raises `EagorError` if it cannot be made.
    """
    module, colon, name = spec.partition(":")
    named = module.replace(".", "").isidentifier() and name.isidentifier()
    if colon and named and not {"@", "/"} & set(spec):
        try:
            return getattr(importlib.import_module(module), name)()
        except (ImportError, AttributeError) as error:
            raise EagorError(
                f"the model {spec!r} cannot be imported ({error}); wanted package.module:function"
            ) from error
    return _served(spec)


def _served(spec: str) -> Chat:
    place, _, written = spec.partition("?")
    model, at, addresses = place.rpartition("@")
    if not at:
        model, addresses = ("", place) if "://" in place else (place, "")
    servers = tuple(_address(address) for address in addresses.split(",") if address) or (DEFAULT_SERVER,)
    kinds = {f.name: type(f.default) for f in fields(ServedChat) if f.name not in ("model", "servers")}
    options: dict[str, Any] = {}
    for name, value in parse_qsl(written, keep_blank_values=True):
        try:
            options[name] = kinds[name](value)
        except (KeyError, ValueError):
            raise EagorError(f"{name}={value} in {spec!r}; a served model has the options {', '.join(kinds)}") from None
    return ServedChat(model, servers, **options)


def _address(text: str) -> str:
    parts = urlsplit(text.strip().rstrip("/"))
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise EagorError(f"{text!r} is no address of a server; wanted one such as {DEFAULT_SERVER}")
    return parts.geturl() if parts.path else parts.geturl() + "/v1"


@dataclass(frozen=True)
class ServedChat:
    """A model on OpenAI-compatible servers; conversations are dealt out among them in turn.

    Nothing is connected to before the first reply. Safe to use from several threads; copies that are pickled connect
    anew.

    Attributes:
        model: its name there; empty for the only model that the first server has.
        servers: addresses.
        temperature, max_tokens: of a reply.
        quality: of the JPEG that pictures are sent as; 0 sends PNG.
        timeout: seconds for one reply.
        retries: of a request that failed for a reason that may pass; the client waits longer each time.
        key: the name of the environment variable that holds the servers' key, if they want one.
    """

    model: str = ""
    servers: tuple[str, ...] = (DEFAULT_SERVER,)
    temperature: float = 0.0
    max_tokens: int = 512
    quality: int = QUALITY
    timeout: float = 120.0
    retries: int = 3
    key: str = ""
    _live: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def __call__(self, messages: Sequence[Message]) -> Said:
        clients, turn, model = self._connected()
        reply = clients[next(turn) % len(clients)].chat.completions.create(
            model=model,
            messages=[self._as_sent(message) for message in messages],
            temperature=self.temperature,
            max_tokens=self.max_tokens,
        )
        if not reply.choices or reply.choices[0].message.content is None:
            raise EagorError(f"{model} returned no text (finish reason: {_reason(reply)}); is max_tokens too small?")
        used = reply.usage
        return Said(
            reply.choices[0].message.content,
            used.prompt_tokens if used else None,
            used.completion_tokens if used else None,
        )

    def _connected(self) -> tuple[list[Any], Any, str]:
        with _CONNECTING:
            if not self._live:
                self._live.update(self._connect())
        return self._live["clients"], self._live["turn"], self._live["model"]

    def _connect(self) -> dict[str, Any]:
        try:
            import openai
        except ImportError as error:
            raise EagorError("a served model needs the openai package: pip install 'eagor[endpoint]'") from error
        key = os.environ.get(self.key, "") if self.key else "none"
        if not key:
            raise EagorError(f"the environment variable {self.key}, which should hold the servers' key, is not set")
        clients = []
        for url in self.servers:
            inside = urlsplit(url).hostname in ("localhost", "127.0.0.1", "::1")  # no proxy knows a way there
            http = openai.DefaultHttpxClient(trust_env=not inside, timeout=self.timeout)
            clients.append(
                openai.OpenAI(
                    base_url=url, api_key=key, timeout=self.timeout, max_retries=self.retries, http_client=http
                )
            )
        weakref.finalize(clients[0], _close, clients[1:])
        model = self.model
        if not model:
            names = [found.id for found in clients[0].models.list().data]
            if len(names) != 1:
                raise EagorError(
                    f"{self.servers[0]} has {len(names)} models ({', '.join(names)}); name one before the @"
                )
            model = names[0]
        return {"clients": clients, "turn": itertools.count(), "model": model}

    def _as_sent(self, message: Message) -> dict[str, Any]:
        if not message.images:
            return {"role": message.role, "content": message.text}
        parts: list[dict[str, Any]] = []
        texts = message.text.split(IMAGE, len(message.images))
        for index, text in enumerate(texts):
            if text:
                parts.append({"type": "text", "text": text})
            if index < len(message.images):
                parts.append({"type": "image_url", "image_url": {"url": data_uri(message.images[index], self.quality)}})
        return {"role": message.role, "content": parts}

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)} | {"_live": {}}


def check_chat(spec: str | None, agent: str) -> None:
    """Raise `EagorError` unless `spec` names a model that can be made; `agent` is who needs it."""
    if not spec:
        raise EagorError(
            f"the agent {agent} asks a model; name it with --model, such as MODEL@http://localhost:8000/v1, or "
            "package.module:function"
        )
    made = load_chat(spec)
    if isinstance(made, ServedChat):
        from importlib.util import find_spec

        if find_spec("openai") is None:
            raise EagorError("a served model needs the openai package: pip install 'eagor[endpoint]'")
    elif not callable(made):
        raise EagorError(f"the model {spec!r} is a {type(made).__name__}; wanted something to call with messages")
    elif not inspect.signature(made).parameters:
        raise EagorError(f"the model {spec!r} takes no argument; wanted the messages of a conversation")


def digest(messages: Sequence[Message]) -> str:
    """A short name of what was said and shown, the same for the same conversation."""
    found = hashlib.sha256()
    for message in messages:
        found.update(f"{message.role}\0{message.text}\0".encode())
        for image in message.images:
            found.update(np.ascontiguousarray(image).tobytes())
    return found.hexdigest()[:16]


def data_uri(image: np.ndarray, quality: int = QUALITY) -> str:
    """An image ``(H, W, 3)`` uint8 as a data URI: JPEG of this quality, PNG for 0."""
    from PIL import Image

    file = io.BytesIO()
    kind = "jpeg" if quality else "png"
    Image.fromarray(np.ascontiguousarray(image)).save(file, kind, **({"quality": quality} if quality else {}))
    return f"data:image/{kind};base64,{base64.b64encode(file.getvalue()).decode('ascii')}"


_CONNECTING = threading.Lock()


def _close(clients: Sequence[Any]) -> None:
    for client in clients:
        client.close()


def _reason(reply: Any) -> str:
    return str(reply.choices[0].finish_reason) if reply.choices else "none"
