"""A small server that speaks the part of OpenAI's interface that perceptions use, and can be told to misbehave.

It sees: answers come from a function of the decoded picture and the question. `reddish` is such a function; it finds
saturated red, as a model would find a thing, and writes what it found as the question asks for it.
"""

from __future__ import annotations

import base64
import io
import json
import math
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from PIL import Image


def error(status: int, message: str, **more: str) -> tuple[int, dict[str, Any]]:
    return status, {"error": {"message": message, **more}}


FAULTS: dict[str, tuple[int, dict[str, Any]]] = {
    "500": error(500, "CUDA error: an illegal memory access", type="InternalServerError"),
    "429": error(429, "too many requests, try again", type="rate_limit"),
    "401": error(401, "Incorrect API key provided", type="invalid_request_error"),
    "404 model": error(404, "The model `qwen` does not exist.", type="NotFoundError"),
    "404 path": (404, {"detail": "Not Found"}),
    "400 context": error(400, "This model's maximum context length is 512 tokens. However, you requested 1400 tokens"),
    "404 model ollama": error(404, "model 'qwen' not found", type="api_error"),
    "400 image": (400, {"object": "error", "message": "Qwen2.5-7B is not a multimodal model"}),
    "500 image llama.cpp": error(500, "image input is not supported - hint: you may need to provide the mmproj"),
    "400 other": error(400, "temperature must be positive"),
}


@dataclass
class Request:
    """One chat completion that was asked for."""

    body: dict[str, Any]
    images: list[np.ndarray]
    kinds: list[str]  # media types of the images
    text: str
    headers: dict[str, str]

    @property
    def image(self) -> np.ndarray:
        (image,) = self.images
        return image


@dataclass
class Reply:
    """What the model says: text, or pieces with (log probability, alternatives)."""

    text: str = ""
    pieces: list[tuple[str, float]] = field(default_factory=list)
    alternatives: list[list[tuple[str, float]]] = field(default_factory=list)


class ContractServer:
    """Serves on a free port of this machine while it is entered.

    Attributes:
        answer: what the model says to a request.
        models: the names it lists.
        logprobs: whether it gives probabilities; else it ignores that they are asked for.
        knows: optional fields that it does not refuse; None for all.
        faults: what goes wrong with the next requests, one each: a key of `FAULTS`, "drop", "slow", "html" or "cut".
        lasting: a fault of every request after that; `headers` of these answers.
        refuses: fields that it refuses, and how it says so.
        gate: a barrier that requests wait at before they are answered.
        requests: what was asked so far; `most_at_once` how many of them at the same time.
    """

    def __init__(self, answer: Callable[[Request], Reply | str], models: tuple[str, ...] = ("qwen",)) -> None:
        self.answer, self.models, self.logprobs = answer, models, True
        self.knows: set[str] | None = None
        self.faults: list[str] = []
        self.lasting, self.slow = "", 2.0
        self.headers: dict[str, str] = {}
        self.refuses: dict[str, str] = {}
        self.gate: threading.Barrier | None = None
        self.requests: list[Request] = []
        self.tries = self.now = self.most_at_once = 0
        self._lock, self._released = threading.Lock(), threading.Event()
        does = {"do_GET": self._list, "do_POST": self._chat, "log_message": lambda *_: None}
        members = {name: lambda handler, *_, do=do: do(handler) for name, do in does.items()}
        handler = type("Handler", (BaseHTTPRequestHandler,), {"protocol_version": "HTTP/1.1", **members})
        self._http = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._http.handle_error = lambda *_: None  # type: ignore[method-assign]  # clients that went away are part of it
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._http.server_port}/v1"

    def __enter__(self) -> ContractServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._released.set()
        if self.gate is not None:
            self.gate.abort()
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def _list(self, handler: BaseHTTPRequestHandler) -> None:
        if handler.path != "/v1/models":
            return self._send(handler, 404, {"detail": "Not Found"})
        return self._send(handler, 200, {"object": "list", "data": [{"id": name} for name in self.models]})

    def _chat(self, handler: BaseHTTPRequestHandler) -> None:
        raw = handler.rfile.read(int(handler.headers["content-length"]))
        if handler.path.partition("?")[0] != "/v1/chat/completions":
            return self._send(handler, 404, {"detail": "Not Found"})
        with self._lock:
            self.tries += 1
            self.now += 1
            self.most_at_once = max(self.most_at_once, self.now)
            fault = self.faults.pop(0) if self.faults else self.lasting
        try:
            if self.gate is not None:
                self.gate.wait(20)
            if fault:
                return self._fail(handler, fault)
            return self._complete(handler, json.loads(raw))
        finally:
            with self._lock:
                self.now -= 1

    def _fail(self, handler: BaseHTTPRequestHandler, fault: str) -> None:
        if fault == "drop":
            handler.close_connection = True
            handler.connection.close()
        elif fault == "slow":
            self._released.wait(self.slow)
            self._send(handler, 200, {})
        elif fault == "html":
            self._write(handler, 200, b"<html>It works!</html>", "text/html")
        elif fault == "cut":
            self._write(handler, 200, b'{"id": "x", "choices": [{"mess', "application/json")
        elif fault == "empty":
            self._send(handler, 200, self._completion({}, Reply(""), "qwen"))
        else:
            self._send(handler, *FAULTS[fault])

    def _complete(self, handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
        unknown = set() if self.knows is None else {"logprobs", "response_format"} & body.keys() - self.knows
        if unknown:
            name = sorted(unknown)[0]
            return self._send(handler, 400, {"error": {"message": f"{name} is not supported by this server"}})
        for name in self.refuses.keys() & body.keys():
            return self._send(handler, 400, {"error": {"message": self.refuses[name], "type": "invalid_request_error"}})
        request = _read(body, {key.lower(): value for key, value in handler.headers.items()})
        with self._lock:
            self.requests.append(request)
        reply = self.answer(request)
        reply = Reply(reply) if isinstance(reply, str) else reply
        return self._send(handler, 200, self._completion(body, reply, body["model"]))

    def _completion(self, body: dict[str, Any], reply: Reply, model: str) -> dict[str, Any]:
        pieces = reply.pieces or [(piece, -0.01) for piece in re.findall(r"\w+|\W", reply.text)]
        text = reply.text or "".join(piece for piece, _ in pieces)
        said = {"role": "assistant", "content": text}
        choice: dict[str, Any] = {"index": 0, "message": said, "finish_reason": "stop", "logprobs": None}
        if self.logprobs and body.get("logprobs"):
            content = []
            for index, (piece, log) in enumerate(pieces):
                others = reply.alternatives[index] if index < len(reply.alternatives) else [(piece, log)]
                shown = others[: body.get("top_logprobs", 0)]
                listed = [{"token": token, "logprob": value, "bytes": None} for token, value in shown]
                content.append({"token": piece, "logprob": log, "bytes": None, "top_logprobs": listed})
            choice["logprobs"] = {"content": content}
        used = {"prompt_tokens": 2000, "completion_tokens": len(pieces), "total_tokens": 2000 + len(pieces)}
        return {"id": "chatcmpl-1", "object": "chat.completion", "created": 0, "model": model,
                "system_fingerprint": "fp_7", "choices": [choice], "usage": used}  # fmt: skip

    def _send(self, handler: BaseHTTPRequestHandler, status: int, body: dict[str, Any]) -> None:
        self._write(handler, status, json.dumps(body).encode(), "application/json")

    def _write(self, handler: BaseHTTPRequestHandler, status: int, raw: bytes, kind: str) -> None:
        handler.send_response(status)
        handler.send_header("content-type", kind)
        handler.send_header("content-length", str(len(raw)))
        for name, value in self.headers.items() if status >= 400 else ():
            handler.send_header(name, value)
        handler.end_headers()
        handler.wfile.write(raw)


def _read(body: dict[str, Any], headers: dict[str, str]) -> Request:
    """The request with its pictures decoded. Fails as a real server would if a part is not as documented."""
    images, kinds, texts = [], [], []
    for part in body["messages"][-1]["content"]:
        if part["type"] == "text":
            texts.append(part["text"])
        else:
            assert part["type"] == "image_url"
            match = re.fullmatch(r"data:(image/\w+);base64,([A-Za-z0-9+/=]+)", part["image_url"]["url"])
            assert match is not None
            kinds.append(match[1])
            images.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(match[2], validate=True))).convert("RGB")))
    return Request(body, images, kinds, "\n".join(texts), headers)


def reddish(request: Request, then: Callable[[str], str] = str) -> Reply:
    """What a model that knows red things only says to a request; `then` changes what it writes."""
    image = request.image.astype(int)
    red = (image[..., 0] > 120) & (image[..., 1:].max(axis=-1) < 80)
    if "yes or no" in request.text:
        there = red.any()
        probability = 0.9 if there else 0.04
        pieces = [("Yes" if there else "No", math.log(max(probability, 1 - probability))), (".", -0.1)]
        others = [[("Yes", math.log(probability)), ("No", math.log(1 - probability))], [(".", -0.1)]]
        return Reply("", pieces, others)
    words = {"0 to 1000": 1000, "from 0 to 100 ": 100, "from 0 to 1 ": 1}  # else pixels
    scale = next((scale for text, scale in words.items() if text in request.text), None)
    key, order = ("bbox_2d", [0, 1, 2, 3]) if "bbox_2d" in request.text else ("box_2d", [1, 0, 3, 2])
    written, columns = [], np.flatnonzero(red.any(axis=0))
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1) if len(columns) else []:
        rows = np.flatnonzero(red[:, run[0] : run[-1] + 1].any(axis=1))
        box = np.array([run[0], rows[0], run[-1] + 1, rows[-1] + 1])[order]
        if scale is not None:
            box = np.round(scale * box / np.array([*red.shape[::-1], *red.shape[::-1]])[order], 0 if scale > 100 else 4)
        numbers = (box.astype(int) if scale in (None, 1000) else box).tolist()
        written.append({key: numbers, "label": "red thing"})
    return Reply(then(json.dumps(written)))


def wait_until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Return once `condition` holds; fail after `seconds`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition never came true"
        time.sleep(0.005)
