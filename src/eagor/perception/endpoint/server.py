"""A model on a server, the limits of asking it (concurrency, timeout, retries), and conversations with it.

Requests run on an event loop in a thread of its own. Only there can a whole answer have one deadline, whatever the
server does meanwhile (a byte now and then, endless headers), and a look be cancelled at any moment.
"""

from __future__ import annotations

import asyncio
import os
import threading
import weakref
from collections.abc import Coroutine, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, fields
from functools import lru_cache
from typing import Any, TypeVar
from urllib.parse import parse_qsl

import numpy as np

from eagor._checks import above, require, whole, within
from eagor._extras import need
from eagor._files import redacted
from eagor.errors import AnswerError, EagorError, QueryError
from eagor.perception.endpoint.addresses import DEFAULT_SERVER, checked_address, place_of, shown_address
from eagor.perception.endpoint.client import Answer, Picture, Request
from eagor.perception.endpoint.transport import client_of, explained, message, refused_feature
from eagor.perception.vlm import IMAGE, MAX_TOKENS, ChatReply, Message

_LONGEST = 86400.0  # longest timeout, seconds: sockets store timeouts in few bits
_CONNECTING = threading.Lock()


@dataclass(frozen=True, repr=False)
class Asker:
    """A model on an OpenAI-compatible server, with timeout and retries; base class of everything that asks one.

    It connects with the first request. Threads share the connections; pickled copies and forked processes connect anew.

    `model`: its name there, empty for the server's only model. `servers`: the server's address, mostly ending in
    ``/v1``, in a tuple of one: several servers need a proxy. The rest: docs/models.md.
    """

    model: str = ""
    servers: tuple[str, ...] = (DEFAULT_SERVER,)
    _: KW_ONLY
    timeout: float = 120.0
    retries: int = 3
    backoff: float = 0.5
    key: str = ""
    ca: str = ""

    def __post_init__(self) -> None:
        addresses = list(self.servers) if isinstance(self.servers, tuple | list) else []
        require(
            self,
            {
                "model": (isinstance(self.model, str), "its name on the server, empty for the only one"),
                "key": (isinstance(self.key, str), "the name of an environment variable, empty for no key"),
                "ca": (isinstance(self.ca, str), "a file of certificates to trust, empty for the usual ones"),
                "timeout": (above(self.timeout, 0, _LONGEST), f"seconds above 0, at most {_LONGEST:g}"),
                "retries": (whole(self.retries, 0), "a whole number, 0 or more"),
                "backoff": (within(self.backoff, 0), "seconds, 0 or more"),
                "servers": (len(addresses) > 0, f"a tuple of one address, such as ({DEFAULT_SERVER!r},)"),
            },
        )
        if len(addresses) > 1:
            raise EagorError(
                f"{len(addresses)} addresses of servers came; wanted one. To share the work among several servers, put "
                "a proxy before them and give its address: docs/how-to/server.md shows how"
            )
        object.__setattr__(self, "servers", (checked_address(addresses[0]),))

    def _server(self, concurrency: int, max_tokens: int) -> Server:
        """The connections, made once per process: at most `concurrency` requests at once, answers of `max_tokens`."""
        name = f"_connected_{os.getpid()}"
        with _CONNECTING:
            if name not in self.__dict__:
                self.__dict__[name] = Server(self, concurrency, max_tokens)
            return self.__dict__[name]

    def __repr__(self) -> str:
        shown = [f"{field.name}={getattr(self, field.name)!r}" for field in fields(self)]
        return redacted(f"{type(self).__name__}({', '.join(shown)})")

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}


Named = TypeVar("Named", bound=Asker)


def named(kind: type[Named], text: str, **options: Any) -> Named:
    """The `kind` of asker named by ``MODEL@ADDRESS[?option=value&...]``; options passed by name take precedence.

    Model and address may be missing. Options are the fields of `kind`. Raises `EagorError` for unknown or unreadable
    options, and for missing packages.
    """
    need_client()
    place, _, written = text.partition("?")
    model, addresses = place_of(place)
    known = {field.name: field.default for field in fields(kind)}
    given: dict[str, Any] = {"model": model} | ({"servers": addresses} if addresses else {})
    for name, value in parse_qsl(written, keep_blank_values=True):
        if name in ("servers", "calibration", "detector", "model"):
            raise EagorError(f"{name} cannot be set after the ?; write the model and the address before it")
        if name in given:
            raise EagorError(f"{name} comes twice in the name of a served model; wanted each option once")
        given[name] = _option(name, value, known.get(name))
    given |= options
    if unknown := sorted(given.keys() - known.keys()):
        raise EagorError(f"a served model has no option {', '.join(unknown)}; it has the options {', '.join(known)}")
    return kind(**given)


def _option(name: str, value: str, default: Any) -> Any:
    """An option from text, converted to the type of its default."""
    try:
        if isinstance(default, bool):
            return {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}[value.lower()]
        return type(default)(value) if isinstance(default, int | float) else value
    except (ValueError, KeyError) as error:
        raise EagorError(f"{name}={value} for a served model; wanted a {type(default).__name__}") from error


class Server:
    """The connections to one server, shared by threads. Raises `EagorError` without the packages or the key."""

    def __init__(self, asker: Asker, concurrency: int, max_tokens: int) -> None:
        need_client()
        import openai

        key = os.environ.get(asker.key, "") if asker.key else ""
        if asker.key and not key:
            variable = asker.key if asker.key.isupper() else "that key=... names"  # it may hold the key itself
            raise EagorError(f"the environment variable {variable}, which should hold the server's key, is not set")
        (url,) = asker.servers
        self._model, self._timeout = asker.model, asker.timeout
        self._shown = shown_address(url)
        # What the client raises, and what reading its result raises if the server sent something else.
        nonsense = (ValueError, AttributeError, TypeError, RecursionError)
        self._failures = (openai.OpenAIError, *nonsense)
        self._refused: set[str] = set()  # what the server rejected
        self._room = asyncio.Semaphore(concurrency)
        self._client = client_of(url, key, asker.timeout, max_tokens, asker.ca, asker.retries, asker.backoff)
        self._loop = _loop(os.getpid())
        weakref.finalize(self, _close, self._client).atexit = False

    def model(self) -> str:
        """The model's name; if none was given, that of the server's only model.

        Raises `ServerError` if the server does not answer, `QueryError` if it has several models or none.
        """
        if not self._model:
            self._model = self._awaited(self._only_model())
        return self._model

    def ask(self, requests: Sequence[Request]) -> list[Answer]:
        """The answers to `requests`, in order; as many at once as the limit allows.

        Raises the first error (`ServerError`, `QueryError`, `AnswerError`) and drops the requests not yet sent.
        """
        self.model()
        return self._awaited(self._all(requests))

    def _awaited(self, work: Coroutine[Any, Any, Any]) -> Any:
        """The result of `work`; cancels it if the caller is interrupted."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        finally:
            future.cancel()

    async def _all(self, requests: Sequence[Request]) -> list[Answer]:
        tasks = [asyncio.ensure_future(self._one(request)) for request in requests]
        try:
            return await asyncio.gather(*tasks)
        finally:  # all done, one failed, or the caller was interrupted
            for task in tasks:
                task.cancel()

    async def _one(self, request: Request) -> Answer:
        """One answer, without what the server rejects; the client retries, and keeps its slot meanwhile."""
        async with self._room:
            while True:
                refused = frozenset(self._refused)
                body = await asyncio.to_thread(request.body, self._model, refused)  # encodes pictures
                try:
                    raw = await self._client.chat.completions.with_raw_response.create(**body)
                    return request.read(raw.parse(), self._model, 1 + raw.retries_taken)
                except self._failures as error:
                    if isinstance(error, EagorError):
                        raise
                    if feature := refused_feature(error, request.features - refused):
                        self._refused.add(feature)
                        continue
                    raise self._explained(error, request.size, await self._served(error)) from error

    async def _served(self, error: Any) -> list[str] | None:
        """The server's models, if the failure may have to do with the model's name."""
        if getattr(error, "status_code", None) in (400, 404, 422) and "model" in message(error).lower():
            with suppress(*self._failures):
                return await self._names()
        return None

    def _explained(self, error: Any, image: tuple[int, int], served: list[str] | None) -> EagorError:
        return explained(error, self._model, self._shown, self._timeout, image=image, served=served)

    async def _names(self) -> list[str]:
        return [str(model.id) for model in (await self._client.with_options(max_retries=0).models.list()).data]

    async def _only_model(self) -> str:
        try:
            names = await self._names()
        except self._failures as error:
            raise self._explained(error, (0, 0), None) from error
        if len(names) != 1:
            has = f"{self._shown} has {len(names)} models"
            raise QueryError(f"{has} ({', '.join(names)}); name one before the @")
        return names[0]


def need_client() -> None:
    """Raise `MissingExtraError` if the packages of the extra are missing."""
    need("a served model", "endpoint", "openai")


@lru_cache(maxsize=1)
def _loop(_process: int) -> asyncio.AbstractEventLoop:
    """The event loop of all requests of this process; a forked process has none of its parent's threads."""
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, name="eagor-servers", daemon=True).start()
    return loop


def _close(client: Any) -> None:
    """Close the connections."""
    asyncio.run_coroutine_threadsafe(client.close(), _loop(os.getpid()))


# --- conversations ----------------------------------------------------------------------------------------------------

QUALITY = 85  # of JPEG, as in H*Bench's runner
_AT_ONCE = 1024  # requests at once: the number of workers is the limit


@dataclass(frozen=True, repr=False)
class ServedChat(Asker):
    """A `eagor.perception.vlm.Chat` with a model on an OpenAI-compatible server.

    Attributes, in addition to those of `eagor.perception.endpoint.server.Asker`:
        temperature, max_tokens: of a reply.
        quality: of the JPEG pictures that are sent, 1 to 100; 0 sends PNG.

    Raises `EagorError` for invalid values.
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

    def __call__(self, messages: Sequence[Message]) -> ChatReply:
        """The reply. Raises `ServerError`, `QueryError` (no such model), or `AnswerError` for a reply without text."""
        return self._said(messages, self.max_tokens)

    def check(self) -> None:
        """Ask for one word about a grey picture, to test the setup before a long run; ignores an empty reply."""
        grey = np.full((112, 112, 3), 128, dtype=np.uint8)
        with suppress(AnswerError):
            self._said([Message("user", f"{IMAGE}\nWhat is this?", (grey,))], 1)

    def _said(self, messages: Sequence[Message], max_tokens: int) -> ChatReply:
        said = [(message.role, [self._part(part) for part in message.parts()]) for message in messages]
        asked = Request(said, max_tokens, self.temperature, silence=True)
        (answer,) = self._server(_AT_ONCE, self.max_tokens).ask([asked])
        return ChatReply(answer.text, answer.prompt_tokens, answer.completion_tokens)

    def _part(self, part: str | np.ndarray) -> str | Picture:
        if isinstance(part, str):
            return part
        return Picture(part, "jpeg", self.quality) if self.quality else Picture(part)


def chat_from_text(text: str) -> ServedChat:
    """The model named by ``MODEL@ADDRESS[?option=value&...]``; see `eagor.perception.endpoint.server.named`."""
    return named(ServedChat, text)
