"""A model on an OpenAI-compatible server: how it is reached, and what it answers.

The openai client asks, waits and tries again. Two features are tried, JSON schemas and token probabilities; what a
server refuses is left out from then on. The client is told what it does not know: a deadline for the whole answer,
errors within HTTP 200, and the first pause.
"""

from __future__ import annotations

import asyncio
import base64
import io
import json
import math
import os
import re
import ssl
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from typing import Annotated, Any, NamedTuple
from urllib.parse import unquote, urlsplit, urlunsplit

import msgspec
import numpy as np
from PIL import Image

from eagor._checks import whole, within
from eagor._extras import require_extra
from eagor._files import keep_out, redacted
from eagor.errors import AnswerError, EagorError, QueryError, ServerError
from eagor.perception.vlm.answers import Token, verdict
from eagor.perception.vlm.thoughts import without_thoughts

DEFAULT_SERVER = "http://localhost:8000/v1"
_TRIES = "x-stainless-retry-count"  # where the client says how often it asked before
_SENT = re.compile("host|content-type|content-length|accept|connection|user-agent|x-stainless-.*")  # headers
_MOST = 32 << 20  # bytes of an answer
_LONGEST_PAUSE = 30.0  # seconds between two tries at most, unless the server asks for longer
# Features that are tried, and how servers name them that refuse them.
_FEATURES = {"response_format": "response_format|json_schema|schema|grammar|structured|guided", "logprobs": "logprobs"}
_CUT = {"length", "max_tokens", "max_output_tokens", "model_length", "model_context_window_exceeded"}
# Why answers end that are none: they were withheld, or something broke.
_WITHHELD = {
    "content_filter", "safety", "recitation", "blocklist", "prohibited_content", "spii", "image_safety", "language",
    "refusal", "sensitive", "guardrail_intervened", "error", "abort", "aborted", "cancelled", "network_error",
    "insufficient_system_resource", "malformed_function_call", "malformed_response",
}  # fmt: skip
_BARE = re.compile(r"\s*(?:[\[{<`|]|\W*\w+\W*\Z)")  # boxes or one word: no more thoughts
_RENAMED = {"max_tokens": "max_completion_tokens"}  # as OpenAI's reasoning models call it

Count = Annotated[int, msgspec.Meta(ge=1)]
Amount = Annotated[int, msgspec.Meta(ge=0)]


class ServerOptions(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """How a server is asked; docs/models.md says what each option means."""

    timeout: Annotated[float, msgspec.Meta(gt=0, le=86400)] = 120.0
    retries: Amount = 3
    backoff: Annotated[float, msgspec.Meta(ge=0, le=86400)] = 0.5
    key: str = ""
    ca: str = ""


class Answer(NamedTuple):
    """A server's answer.

    `tokens` are the pieces of the answer with log probabilities, `likeliest` the alternatives at each piece; both are
    empty if the server sends none. Counts are None if it does not send them.
    """

    text: str
    tokens: list[Token]
    likeliest: list[list[Token]]
    model: str
    revision: str | None
    prompt_tokens: int | None
    completion_tokens: int | None
    requests: int
    cut: bool = False  # by the limit of tokens

    @property
    def verdict(self) -> list[Token]:
        """The alternatives at the piece that decides between yes and no; [] if there is none."""
        place, _ = verdict("".join(piece for piece, _ in self.tokens))
        for token, others in zip(self.tokens, self.likeliest, strict=True):
            if 0 <= place < len(token[0]):
                return others or [token]
            place -= len(token[0])
        return []


class ChatClient:
    """Asks the `model` at `address`: its name there (empty for the only one), and the address, mostly with ``/v1``.

    It connects anew for each call of `ask`, with `concurrency` requests at once at most. Raises `EagorError` for an
    address that is none, and `MissingExtraError`.
    """

    def __init__(self, model: str, address: str, options: ServerOptions, concurrency: int = 1) -> None:
        require_extra("a served model", "endpoint", "openai")
        self.address, self.options = checked_address(address), options
        self._model, self._concurrency = model, concurrency
        self.shown = redacted(self.address)  # without a password
        self._left_out: set[str] = set()  # what the server refused

    def model(self) -> str:
        """The model's name; if none was given, that of the server's only model.

        Raises `ServerError` if the server does not answer, `QueryError` if it has several models or none.
        """
        if not self._model:
            names = self._awaited(self._names)
            if len(names) != 1:
                has = f"{self.shown} has {len(names)} models"
                raise QueryError(f"{has} ({', '.join(names)}); name one before the @")
            (self._model,) = names
        return self._model

    def ask(self, bodies: Sequence[Mapping[str, Any]], silence: bool = False) -> list[Answer]:
        """The answers to chat completions, in order; `silence`: an empty one is an answer.

        Raises the first error (`ServerError`, `QueryError`, `AnswerError`) and drops what is not yet sent.
        """
        model = self.model()

        async def all_of_them(client: Any) -> list[Answer]:
            room = asyncio.Semaphore(self._concurrency)
            each = (self._one(client, room, {"model": model, **body}, silence) for body in bodies)
            tasks = [*map(asyncio.ensure_future, each)]
            try:
                return await asyncio.gather(*tasks)
            finally:  # all done, one failed, or the caller was interrupted
                for task in tasks:
                    task.cancel()

        return self._awaited(all_of_them)

    async def _one(self, client: Any, room: asyncio.Semaphore, body: dict[str, Any], silence: bool) -> Answer:
        """One answer, without what the server refuses; the client tries again, and keeps its place meanwhile."""
        async with room:
            left_out = set(self._left_out)
            while True:
                sent = {_RENAMED[key] if key in left_out else key: value for key, value in body.items()
                        if key not in left_out or key in _RENAMED}  # fmt: skip
                if "logprobs" not in sent:
                    sent.pop("top_logprobs", None)
                try:
                    raw = await client.chat.completions.with_raw_response.create(**sent)
                    answer = _read(raw.http_response.json(), sent, silence, 1 + raw.retries_taken)
                except AnswerError:
                    raise
                except Exception as error:  # of the client, and of reading what is no completion
                    refused = _refused(error, body.keys() - left_out)
                    if not refused:
                        raise await self._explained(client, error) from error
                    left_out |= refused
                else:
                    self._left_out |= left_out
                    return answer

    async def _names(self, client: Any) -> list[str]:
        """The names of the server's models."""
        try:
            raw = await client.with_options(max_retries=0).models.with_raw_response.list()
            return [str(each["id"]) for each in raw.http_response.json()["data"]]
        except Exception as error:
            raise await self._explained(client, error) from error

    def _awaited(self, work: Any) -> Any:
        """The result of `work` with an `openai.AsyncOpenAI`; it is cancelled if the caller is interrupted."""

        async def worked() -> Any:
            async with self._client() as client:
                return await work(client)

        future = asyncio.run_coroutine_threadsafe(worked(), _loop(os.getpid()))
        try:
            return future.result()
        finally:
            future.cancel()

    def _client(self) -> Any:
        """An `openai.AsyncOpenAI` for this server. Raises `EagorError` without the key or certificates."""
        import openai

        options, host = self.options, urlsplit(self.address).hostname or ""
        key = os.environ.get(options.key, "") if options.key else "none"
        if not key:
            variable = options.key if options.key.isupper() else "that key=... names"  # it may hold the key itself
            raise EagorError(f"the environment variable {variable}, which should hold the server's key, is not set")
        keep_out(key)
        theirs = f".{host}".endswith(".openai.com")

        class Http(openai.DefaultAsyncHttpxClient):
            async def send(self, request: Any, **how: Any) -> Any:
                if not theirs:  # the client adds account data of OpenAI from the environment for every server
                    for name in {name for name in request.headers if not _SENT.match(name)}:
                        del request.headers[name]
                request.headers.update({"authorization": f"Bearer {key}", "accept-encoding": "identity"})
                try:
                    return await asyncio.wait_for(self._whole(request, **how), options.timeout)
                except asyncio.TimeoutError as error:
                    below = import_module(type(request).__module__.partition(".")[0])  # httpx, or its successor
                    raise below.ReadTimeout("too late", request=request) from error

            async def _whole(self, request: Any, **how: Any) -> Any:
                response, body = await super().send(request, **{**how, "stream": True}), bytearray()
                try:
                    async for piece in response.aiter_raw():
                        body += piece
                        if len(body) > _MOST:
                            return _honest(response, 413, '{"error": "it sent more than 32 MiB for one answer"}', 0.0)
                finally:
                    await response.aclose()
                return _honest(response, response.status_code, body.decode("utf-8", "replace"), options.backoff)

        authorities = options.ca or os.environ.get("SSL_CERT_FILE")
        try:
            trusted = ssl.create_default_context(cafile=authorities) if authorities else True
        except OSError as error:  # includes ssl.SSLError
            raise EagorError(f"ca is {authorities}, where no certificates can be read ({error})") from error
        local = host in ("localhost", "127.0.0.1", "::1")  # which a proxy cannot reach
        return openai.AsyncOpenAI(
            base_url=self.address,
            api_key=key,
            timeout=openai.Timeout(options.timeout, connect=min(10.0, options.timeout)),
            max_retries=options.retries,
            http_client=Http(trust_env=not local, verify=trusted, follow_redirects=False),
        )

    async def _explained(self, client: Any, error: Any) -> EagorError:
        """The error to raise for what the client raised after its tries."""
        import openai

        request, model, reason = getattr(error, "request", None), self._model, _message(error)
        count = 1 + int(request.headers.get(_TRIES, 0)) if request is not None else 1
        tries, status = "tried once" if count == 1 else f"tried {count} times", getattr(error, "status_code", None)
        named = status == 404 or (status is not None and "model" in reason.lower())
        if model and named and not re.search("multimodal|mmproj|image", reason.lower()):
            with suppress(EagorError):
                if (served := await self._names(client)) and model not in served:
                    has = f"{self.shown} has no model {model!r} ({reason}); it has {', '.join(map(repr, served))}"
                    return QueryError(f"{has}. Name one of these before the @")
        what = f"{self.shown} refused the request ({tries}; HTTP {status}): {reason}"
        advice = (
            f"Is {model!r} a vision-language model, and loaded (llama.cpp: with its --mmproj file)? If the picture "
        )
        advice += "is too large for it, send fewer pixels (pixels=...), or start it with a longer context"
        if isinstance(error, openai.APITimeoutError):
            what = f"{self.shown} gave no answer within {self.options.timeout:g} s ({tries})"
            advice = "Allow more time (timeout=...), send fewer pixels, or fewer requests at once (concurrency=...)"
        elif isinstance(error, openai.APIConnectionError):
            cause = error.__cause__ or error
            reason = f"{type(cause).__name__}: {' '.join(str(cause).split())}"
            what = f"no server answers at {self.shown} ({reason}; {tries})"
            advice = f"Start one (`vllm serve {model or 'MODEL'}`), or check host, port and path (most end in /v1)"
        elif status is None:
            what = (
                f"{self.shown} answered with something other than a chat completion ({type(error).__name__}: {reason})"
            )
            advice = "Is it an OpenAI-compatible server, and does the address end in /v1?"
        elif status in (401, 403):
            advice = "It wants a key: put that in an environment variable, and name it with key=VARIABLE"
        elif status < 400:  # a redirect
            place = redacted(str(error.response.headers.get("location", "")).partition("?")[0])[:200]
            advice = f"It redirects to {place}; neither key nor picture was sent there: if it moved, name that address"
        return ServerError(f"{what}. {advice}")


@lru_cache(maxsize=1)
def _loop(_process: int) -> asyncio.AbstractEventLoop:
    """The event loop of all requests of this process; a forked process has none of its parent's threads."""
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, name="eagor-servers", daemon=True).start()
    return loop


def checked_address(url: str) -> str:
    """`url` without ``/chat/completions``, with ``/v1`` added if it has no path; its password is kept out of output.

    Raises `EagorError`.
    """
    shown = re.sub(r"//[^/]*@", "//***@", str(url).partition("?")[0])
    try:
        parts = urlsplit(str(url).strip())
        known = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
        if not known or parts.query or "," in str(url):
            raise ValueError
    except ValueError:
        raise EagorError(
            f"{shown!r} is not the address of a server; wanted one such as {DEFAULT_SERVER}. To share the work among "
            "several servers, put a proxy before them (nginx, HAProxy, LiteLLM) and give its address"
        ) from None
    login, at, _ = parts.netloc.rpartition("@")
    if at:  # also as it is sent
        keep_out(unquote(parts.password or ""), login, base64.b64encode(unquote(login).encode()).decode())
    path = parts.path.rstrip("/").removesuffix("/chat/completions")
    return urlunsplit(parts._replace(path=path or "/v1", fragment=""))


# --- requests and answers ---------------------------------------------------------------------------------------------


def part(content: str | np.ndarray, form: str = "png", quality: int = 0) -> dict[str, Any]:
    """Text, or a picture ``(H, W, 3)`` uint8, as a part of a message.

    `quality`: of JPEG; 0: 95 without chroma subsampling.
    """
    if isinstance(content, str):
        return {"type": "text", "text": content}
    how = {"compress_level": 1} if form == "png" else {"quality": quality or 95, "subsampling": 2 if quality else 0}
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(content)).save(file, form, **how)
    uri = f"data:image/{form};base64,{base64.b64encode(file.getvalue()).decode('ascii')}"
    return {"type": "image_url", "image_url": {"url": uri}}


def _read(found: Any, sent: Mapping[str, Any], silence: bool, tries: int) -> Answer:
    """The answer in a completion. Raises `AnswerError` if it is empty; other errors if it is no chat completion."""
    choices, who = found["choices"], str(found.get("model") or sent["model"])
    if choices == []:
        raise AnswerError(f"{who} returned no choices; look at the log of its server")
    choice = next((each for each in choices if each.get("index") == 0), choices[0])
    message, reason, probabilities = choice["message"], choice.get("finish_reason"), choice.get("logprobs")
    content, ended = message.get("content"), str(reason).lower()
    text, thoughts = _text(content), _text(message.get("reasoning_content") or message.get("reasoning"))
    if not silence and (ended in _WITHHELD or message.get("refusal")):
        refusal = str(message.get("refusal") or text)[:200]
        raise AnswerError(f"{who} gave no answer: it stopped because of {reason!r}, and says {refusal!r}")
    if not text.strip() and message.get("tool_calls"):  # its parser took the model's JSON for a call
        content = text = "\n".join(str(call["function"]["arguments"]) for call in message["tool_calls"])
        probabilities = None
    if not text.strip() and thoughts.strip() and ended not in _CUT:
        # Servers whose parser waits for the end of thoughts that were never begun: the end of these is the answer.
        last = re.split(r"\n\s*\n", without_thoughts(thoughts).strip() or thoughts.strip())[-1]
        if silence or _BARE.match(last):
            content, text, probabilities = last, last, None
    usage = found.get("usage")
    counts = [usage.get(f"{each}_tokens") if isinstance(usage, dict) else None for each in ("prompt", "completion")]
    prompt, answer = (count if whole(count, 0) else None for count in counts)
    if content is None or (not silence and not text.strip()):
        why = f"it stopped because of {reason!r}" + (f", {answer} tokens" if answer is not None else "")
        why += f", after {len(thoughts)} characters of reasoning" if thoughts else ""
        raise AnswerError(
            f"{who} gave an empty answer ({why}). If it thinks before it answers, allow more tokens (max_tokens=...) "
            "or turn that off; else look at the server's chat template for this model"
        )
    pieces = _pieces(probabilities.get("content") if "logprobs" in sent and probabilities else None)
    tokens, likeliest = [each[:2] for each in pieces], [[one[:2] for one in _pieces(each[2])] for each in pieces]
    revision = str(found.get("system_fingerprint") or "") or None
    model = str(found.get("model") or "")
    return Answer(text, tokens, likeliest, model, revision, prompt, answer, tries, ended in _CUT)


def _text(content: Any) -> str:
    """The text of a message's content, a string or a list of parts; parts with thoughts are left out."""
    if isinstance(content, list):
        if any(isinstance(part, dict) and not {"type", "text"} & part.keys() for part in content):
            return json.dumps(content)  # the server has read the model's JSON itself
        parts = [{"text": part} if isinstance(part, str) else part for part in content if part is not None]
        shown = (
            part for part in parts if part.get("type", "text") in ("text", "output_text") and not part.get("thought")
        )
        return "".join(_text(part.get("text")) for part in shown)
    if content is not None and not isinstance(content, str):
        raise TypeError(f"the answer is {content!r}")
    return content or ""


def _pieces(entries: Any) -> list[tuple[str, float, Any]]:
    """The pieces with their log probability and their alternatives; some servers write null, or NaN."""
    return [(each["token"], each["logprob"], each.get("top_logprobs")) for each in entries or ()
            if isinstance(each["token"], str) and within(each["logprob"], -math.inf)]  # fmt: skip


# --- failures ---------------------------------------------------------------------------------------------------------


def _honest(response: Any, status: int, body: str, backoff: float) -> Any:
    """The answer without secrets that the server echoes, and as an error where one hides in a success.

    An error in the body of HTTP 200 (OpenRouter, proxies) counts by its own code, if that is an HTTP status; else as
    429 or 500. The pause before the next try is told where the server tells none.
    """
    body = redacted(body)
    if status < 300 and (error := _error_within(body)):
        codes = [str(error.get(key)) for key in ("code", "status")] if isinstance(error, dict) else []
        guess = 429 if re.search(r"rate.?limit|too many requests", str(error).lower()) else 500
        status = next((int(code) for code in codes if re.fullmatch("[45][0-9]{2}", code)), guess)
        body = json.dumps({"error": error})
    kept = {"content-type", "location", "retry-after", "retry-after-ms"} & response.headers.keys()
    headers = {name: response.headers[name] for name in kept}
    if status >= 400 and not {"retry-after", "retry-after-ms"} & kept:
        pause = backoff * 2 ** int(response.request.headers.get(_TRIES, 0))
        headers["retry-after-ms"] = str(1000 * max(0.001, min(pause, _LONGEST_PAUSE)))
    return type(response)(status, headers=headers, content=body.encode(), request=response.request)


def _error_within(body: str) -> Any:
    """The error in the body of a success; None if there is none."""
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or isinstance(found.get("data"), list):
        return None
    choices = found.get("choices")
    if isinstance(choices, list) and choices:
        return found.get("error") or (choices[0].get("error") if isinstance(choices[0], dict) else None)
    fault = next((found[key] for key in ("message", "detail", "msg", "error_msg") if found.get(key)), None)
    return found.get("error") or (fault and not choices and {"message": fault, "code": found.get("code")})


def _refused(error: Any, used: set[str]) -> set[str]:
    """What to leave out or call otherwise where a server refuses a request: what it names, else what is tried."""
    if getattr(error, "status_code", None) not in (400, 404, 422, 500, 501):
        return set()
    reason = _message(error).lower()
    ways = _FEATURES | {name: name for name in (*_RENAMED, "temperature")}
    named = {name for name in used & ways.keys() if re.search(ways[name], reason)}
    unnamed = error.status_code in (400, 422, 501) or "requested parameters" in reason
    return named or (used & _FEATURES.keys() if unnamed else set())


def _message(error: Any) -> str:
    """The server's error message, on one line."""
    body = getattr(error, "body", None)
    for key in ("error", "message", "detail"):
        if isinstance(body, dict) and key in body:
            body = body[key]
    text = " ".join(str(body if isinstance(body, str | list | dict) and body else error).split())
    return text if len(text) <= 300 else text[:297] + "..."
