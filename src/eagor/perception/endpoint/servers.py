"""Several servers as one: where the next request goes, how many are under way, and what happens when one fails."""

from __future__ import annotations

import os
import random
import threading
import time
import weakref
from collections.abc import Sequence, Set
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from eagor._checks import above, require, whole, within
from eagor.errors import EagorError, QueryError, ServerError
from eagor.perception.endpoint.faults import Asked, explained, message, refused_feature, retry_after, worth_retrying

DEFAULT_SERVER = "http://localhost:8000/v1"
LONGEST_REST = 30.0  # seconds that a failing server is left alone at most, unless it asks for more
_CONNECT = 10.0  # seconds to reach a server
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


@dataclass(eq=False)
class _Server:
    url: str
    client: Any
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

    def __init__(self, urls: Sequence[str], model: str, key: str, limits: Limits) -> None:
        need_client()
        import openai

        self._limits = limits
        self._model = model
        self._free = threading.Condition()
        timeout = openai.Timeout(limits.timeout, connect=min(_CONNECT, limits.timeout))
        self._servers = []
        for url in urls:
            # A proxy knows no way to this machine itself.
            inside = urlsplit(url).hostname in ("localhost", "127.0.0.1", "::1")
            http = openai.DefaultHttpxClient(trust_env=not inside, timeout=timeout)
            client = openai.OpenAI(base_url=url, api_key=key, timeout=timeout, max_retries=0, http_client=http)
            self._servers.append(_Server(url, client))
        weakref.finalize(self, _close, [server.client for server in self._servers])

    def model(self) -> str:
        """The model's name; where none was given, that of the only model that the first server has.

        Raises `ServerError` if that server does not answer, `QueryError` if it has several models or none.
        """
        if not self._model:
            import openai

            first = self._servers[0]
            try:
                names = _names(first)
            except (openai.OpenAIError, *_NONSENSE) as error:
                raise explained(error, self._asked(first, (0, 0), 1), None) from error
            if len(names) != 1:
                raise QueryError(f"{first.url} has {len(names)} models ({', '.join(names)}); name one before the @")
            self._model = names[0]
        return self._model

    def ask(self, questions: Sequence[Asking[Read]]) -> list[Read]:
        """The answers to `questions`, in their order; as many at once as the limits allow.

        Raises the first error (`ServerError`, `QueryError`, `AnswerError`); what is not yet sent then stays unsent.
        """
        self.model()
        if not questions:
            return []
        stop = threading.Event()
        workers = min(len(questions), self._limits.concurrency * len(self._servers))
        pool = ThreadPoolExecutor(workers, thread_name_prefix="eagor-endpoint")
        try:
            futures = [pool.submit(self._ask, question, stop) for question in questions]
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
            return [future.result() for future in futures]
        finally:  # all done, or one failed, or interrupted: then nobody waits for what is under way
            stop.set()
            with self._free:
                self._free.notify_all()
            pool.shutdown(wait=False, cancel_futures=True)

    def _ask(self, question: Asking[Read], stop: threading.Event) -> Read:
        """One answer, after as many tries as it takes and is allowed."""
        import openai

        most, tries = self._limits.retries + len(self._servers), 0
        while True:
            server = self._next(stop)
            failed: Exception | None = None
            answer: Read | None = None
            tries += 1
            refused = frozenset(server.refused)
            try:
                body = question.body(self._model, refused)
                answer = question.read(server.client.chat.completions.create(**body), tries)
            except openai.OpenAIError as error:
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
                asked = self._asked(server, question.size, tries)
                raise explained(failed, asked, self._names_after(failed, server)) from failed

    def _next(self, stop: threading.Event) -> _Server:
        """The least busy server that has room and does not rest, once there is one."""
        with self._free:
            while True:
                if stop.is_set():
                    raise _Stopped("another request of the same look failed")
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
        return Asked(self._model, server.url, image, self._limits.timeout, tries)

    def _names_after(self, failed: Exception, server: _Server) -> list[str] | None:
        """The models that a server has, where the failure may be about their names."""
        wrong = getattr(failed, "status_code", None) in (400, 404, 422) and "model" in message(failed).lower()
        return self._listed(server) if wrong else None

    def _listed(self, server: _Server) -> list[str] | None:
        """The names of a server's models, None if it does not tell."""
        import openai

        try:
            return _names(server)
        except (openai.OpenAIError, *_NONSENSE):
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
    `timeout`, `retries` and `backoff`. Raises `EagorError` if that variable is not set, or as `Servers` does.
    """
    with _CONNECTING:
        if "_connected" not in asker.__dict__:
            key = os.environ.get(asker.key, "") if asker.key else "none"
            if not key:
                raise EagorError(
                    f"the environment variable {asker.key}, which should hold the servers' key, is not set"
                )
            limits = Limits(concurrency, asker.timeout, asker.retries, asker.backoff)
            asker.__dict__["_connected"] = Servers(asker.servers, asker.model, key, limits)
        return asker.__dict__["_connected"]


def unconnected(asker: Any) -> dict[str, Any]:
    """What of such a dataclass is pickled: its fields, no connections."""
    return {field.name: getattr(asker, field.name) for field in fields(asker)}


def _close(clients: Sequence[Any]) -> None:
    """Give the connections back."""
    for client in clients:
        client.close()


def _names(server: _Server) -> list[str]:
    return [str(model.id) for model in server.client.models.list().data]


class _Stopped(ServerError):
    """This request was given up because another one failed."""


def checked_address(url: str) -> str:
    """`url` with ``/v1`` where it has no path. Raises `EagorError` if it is none."""
    text = str(url).strip().rstrip("/")
    try:
        parts = urlsplit(text)
        valid = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts, valid = None, False
    if not (parts and valid):
        raise EagorError(f"{url!r} is no address of a server; wanted one such as {DEFAULT_SERVER}")
    return text if parts.path else text + "/v1"
