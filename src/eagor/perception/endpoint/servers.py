"""Several servers as one: where the next request goes, how many are under way, and what happens when one fails."""

from __future__ import annotations

import os
import random
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence, Set
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from eagor._checks import above, require, whole, within
from eagor._secrets import redacted
from eagor.errors import EagorError, QueryError
from eagor.perception.endpoint.addresses import DEFAULT_SERVER, checked_address
from eagor.perception.endpoint.faults import Asked, explained, message, refused_feature, retry_after, worth_retrying
from eagor.perception.endpoint.transport import Client

LONGEST_REST = 30.0  # seconds that a failing server is left alone at most, unless it asks for more
_LONGEST = 86400.0  # seconds to wait for an answer: sockets count them in few bits
_CONNECTING = threading.Lock()
# What the client, and reading what it returns, raise where what came is not what was asked for.
_NONSENSE = (ValueError, AttributeError, TypeError, RecursionError)


Read = TypeVar("Read", covariant=True)


class Asking(Protocol[Read]):
    """One request: a `eagor.perception.endpoint.messages.Question`, or a conversation."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of its picture, for the text of errors."""
        ...

    @property
    def features(self) -> Set[str]:
        """What a server may not know."""
        ...

    def body(self, model: str, refused: frozenset[str]) -> dict[str, Any]:
        """The arguments of ``chat.completions.create``, without the features that the server refused."""
        ...

    def read(self, completion: Any, tries: int) -> Read:
        """What the client returned. Raises `AnswerError`, or AttributeError or TypeError if it is no completion."""
        ...


@dataclass(frozen=True)
class Limits:
    """How patiently, and how hard, servers are asked."""

    concurrency: int = 4  # requests at once to each server
    timeout: float = 120.0  # seconds for one answer
    retries: int = 3  # more tries of a request that failed for a reason that may pass
    backoff: float = 0.5  # seconds that a server rests after its first failure; doubled with each further one
    max_tokens: int = 1024  # of an answer


@dataclass(eq=False)
class _Server:
    client: Client
    busy: int = 0
    asked: int = 0
    failures: int = 0  # in a row
    rests_until: float = 0.0
    refused: set[str] = field(default_factory=set)  # optional features that it does not know


class Servers:
    """Sends questions to OpenAI-compatible servers that all serve the same model.

    A server that fails rests for a while, the longer the more often in a row, and what it was asked goes elsewhere if
    there is an elsewhere. Safe to use from several threads, which then share the limits.

    Raises `EagorError` without the openai package.
    """

    def __init__(self, urls: Sequence[str], model: str, key: str, limits: Limits, authorities: str = "") -> None:
        need_client()
        self._limits = limits
        self._model = model
        self._free = threading.Condition()
        self._servers = [_Server(Client(url, key, limits.timeout, limits.max_tokens, authorities)) for url in urls]

    def model(self) -> str:
        """The model's name; where none was given, that of the only model that the first server has.

        Raises `ServerError` if that server does not answer, `QueryError` if it has several models or none.
        """
        if not self._model:
            import openai

            first = self._servers[0]
            try:
                names = _names(first)
            except (openai.OpenAIError, TimeoutError, *_NONSENSE) as error:
                raise explained(error, self._asked(first, (0, 0), 1), None) from error
            if len(names) != 1:
                has = f"{first.client.shown} has {len(names)} models"
                raise QueryError(f"{has} ({', '.join(names)}); name one before the @")
            self._model = names[0]
        return self._model

    def ask(self, questions: Sequence[Asking[Read]]) -> list[Read]:
        """The answers to `questions`, in their order; as many at once as the limits allow.

        Raises the first error (`ServerError`, `QueryError`, `AnswerError`); what is not yet sent then stays unsent.
        """
        self.model()
        if not questions:
            return []
        asked, waiting = _Round(), deque(enumerate(questions))
        news: SimpleQueue[tuple[int, Read | BaseException]] = SimpleQueue()

        def serve() -> None:
            with suppress(IndexError):
                while True:
                    index, question = waiting.popleft()
                    try:
                        news.put((index, self._ask(question, asked)))
                    except BaseException as error:
                        news.put((index, error))

        # Threads that nobody waits for, also when the process ends: those of a pool would be.
        for _ in range(min(len(questions), self._limits.concurrency * len(self._servers))):
            threading.Thread(target=serve, name="eagor-endpoint", daemon=True).start()
        try:
            found: dict[int, Read] = {}
            while len(found) < len(questions):
                index, answer = news.get()
                if isinstance(answer, BaseException):
                    raise answer
                found[index] = answer
            return [found[index] for index in range(len(questions))]
        finally:  # all done, or one failed, or interrupted: then nobody waits for what is under way
            waiting.clear()
            asked.stop()
            with self._free:
                self._free.notify_all()

    def _ask(self, question: Asking[Read], asked: _Round) -> Read:
        """One answer, after as many tries as it takes and is allowed."""
        import openai

        most, tries = self._limits.retries + len(self._servers), 0
        while True:
            server = self._next(asked)
            failed: Exception | None = None
            answer: Read | None = None
            tries += 1
            refused = frozenset(server.refused)
            try:
                body = question.body(self._model, refused)
                answer = question.read(asked.result(server, lambda c, b=body: c.chat.completions.create(**b)), tries)
            except (openai.OpenAIError, TimeoutError) as error:
                failed = error
            except _NONSENSE as error:
                if isinstance(error, EagorError):
                    raise
                failed = error
            finally:
                self._done(server, failed)
            if answer is not None:
                return answer
            assert failed is not None
            feature = refused_feature(failed, question.features - refused)
            if feature:
                server.refused.add(feature)
                tries -= 1
            elif tries >= most or not worth_retrying(failed):
                about = self._asked(server, question.size, tries)
                raise explained(failed, about, self._names_after(failed, server)) from failed

    def _next(self, asked: _Round) -> _Server:
        """The least busy server that has room and does not rest, once there is one."""
        with self._free:
            while True:
                if asked.stopped:
                    raise _Stopped
                now = time.monotonic()
                room = [server for server in self._servers if server.busy < self._limits.concurrency]
                ready = [server for server in room if server.rests_until <= now]
                if ready:
                    server = min(ready, key=lambda s: (s.failures, s.busy, s.asked))
                    server.busy += 1
                    server.asked += 1
                    return server
                self._free.wait(min((server.rests_until - now for server in room), default=None))

    def _done(self, server: _Server, failed: Exception | None) -> None:
        """Note how a request went."""
        with self._free:
            server.busy -= 1
            now = time.monotonic()
            if failed is None:
                server.failures = 0
                server.rests_until = 0.0
            elif worth_retrying(failed) and server.rests_until <= now:  # failures at the same time count once
                pause = self._limits.backoff * 2**server.failures
                pause = min(pause, LONGEST_REST) * random.uniform(0.75, 1.25)  # not all clients at once
                server.failures = min(server.failures + 1, 20)
                server.rests_until = now + max(pause, retry_after(failed))
            self._free.notify_all()

    def _asked(self, server: _Server, image: tuple[int, int], tries: int) -> Asked:
        return Asked(self._model, server.client.shown, image, self._limits.timeout, tries)

    def _names_after(self, failed: Exception, server: _Server) -> list[str] | None:
        """The models that a server has, where the failure may be about their names."""
        wrong = getattr(failed, "status_code", None) in (400, 404, 422) and "model" in message(failed).lower()
        return self._listed(server) if wrong else None

    def _listed(self, server: _Server) -> list[str] | None:
        """The names of a server's models, None if it does not tell."""
        import openai

        try:
            return _names(server)
        except (openai.OpenAIError, TimeoutError, *_NONSENSE):
            return None


def need_client() -> None:
    """Raise `EagorError` without the openai package."""
    if find_spec("openai") is None:
        raise EagorError("a served model needs the openai package: pip install 'eagor[endpoint]'")


def check_asking(asker: Any) -> None:
    """Check the fields of a frozen dataclass that `connected` reads, and complete its addresses.

    Raises `EagorError` for values that make no sense, and where no server is named.
    """
    wanted = {
        "model": (isinstance(asker.model, str), "its name on the servers, empty for the only one"),
        "key": (isinstance(asker.key, str), "the name of an environment variable, empty for no key"),
        "ca": (isinstance(asker.ca, str), "a file of certificates to trust, empty for the usual ones"),
        "timeout": (above(asker.timeout, 0, _LONGEST), f"seconds above 0, at most {_LONGEST:g}"),
        "retries": (whole(asker.retries, 0), "a whole number, 0 or more"),
        "backoff": (within(asker.backoff, 0), "seconds, 0 or more"),
        "servers": (isinstance(asker.servers, tuple | list), f"a tuple of addresses, such as ({DEFAULT_SERVER!r},)"),
    }
    require(asker, wanted)
    require(asker, {"servers": (len(asker.servers) > 0, f"at least one address, such as {DEFAULT_SERVER}")})
    object.__setattr__(asker, "servers", tuple(checked_address(url) for url in asker.servers))


def connected(asker: Any, concurrency: int) -> Servers:
    """The connections of a frozen dataclass, made at its first request and then shared by all threads.

    It has the fields `servers`, `model`, `key` (the name of the environment variable that holds the servers' key),
    `timeout`, `retries`, `backoff`, `max_tokens` and `ca`. Raises `EagorError` if that variable is not set, or as
    `Servers` does.
    """
    name = f"_connected_{os.getpid()}"  # a forked process cannot use its parent's connections
    with _CONNECTING:
        if name not in asker.__dict__:
            key = os.environ.get(asker.key, "") if asker.key else ""
            if asker.key and not key:
                named = asker.key if asker.key.isupper() else "that key=... names"  # it may be the key itself
                raise EagorError(f"the environment variable {named}, which should hold the servers' key, is not set")
            limits = Limits(concurrency, asker.timeout, asker.retries, asker.backoff, asker.max_tokens)
            asker.__dict__[name] = Servers(asker.servers, asker.model, key, limits, asker.ca)
        return asker.__dict__[name]


def told(asker: Any) -> str:
    """`repr` of such a dataclass, without secrets in its addresses."""
    shown = [f"{field.name}={getattr(asker, field.name)!r}" for field in fields(asker)]
    return redacted(f"{type(asker).__name__}({', '.join(shown)})")


def unconnected(asker: Any) -> dict[str, Any]:
    """What of such a dataclass is pickled: its fields, no connections."""
    return {field.name: getattr(asker, field.name) for field in fields(asker)}


class _Stopped(Exception):
    """This request was given up: another one failed, or nobody waits for it any more."""


class _Round:
    """The requests of one `Servers.ask`, which end together."""

    def __init__(self) -> None:
        self.stopped = False
        self._lock = threading.Lock()
        self._under_way: set[Future[Any]] = set()

    def result(self, server: _Server, ask: Callable[[Any], Awaitable[Any]]) -> Any:
        """What `ask` gets from `server`. Raises what that raises, `TimeoutError`, or `_Stopped`."""
        with self._lock:
            if self.stopped:
                raise _Stopped
            future = server.client.begin(ask)
            self._under_way.add(future)
        try:
            return future.result()
        except CancelledError:
            raise _Stopped from None
        finally:
            future.cancel()  # interrupted while it waited
            self._under_way.discard(future)

    def stop(self) -> None:
        """Give up what is under way, and begin nothing more."""
        with self._lock:
            self.stopped = True
            for future in list(self._under_way):
                future.cancel()


def _names(server: _Server) -> list[str]:
    async def listed(client: Any) -> Any:
        return await client.models.list()

    return [str(model.id) for model in _Round().result(server, listed).data]
