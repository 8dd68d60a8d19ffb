"""A server that does to each request whatever a function does with the open connection."""

from __future__ import annotations

import json
import socket
import ssl
import threading
from collections.abc import Callable
from contextlib import suppress

OK = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\n"


def whole(body: bytes, head: bytes = OK) -> bytes:
    """A complete answer with this body."""
    return head + b"content-length: %d\r\nconnection: close\r\n\r\n" % len(body) + body


def completion(text: str) -> bytes:
    """A complete answer that says `text`."""
    message = {"role": "assistant", "content": text}
    choice = {"index": 0, "message": message, "finish_reason": "stop", "logprobs": None}
    body = {"id": "x", "object": "chat.completion", "created": 0, "model": "m", "choices": [choice], "usage": None}
    return whole(json.dumps(body).encode())


class HostileServer:
    """Listens on a free port of this machine while it is entered.

    `answer(connection, request, gone)` gets the socket, the bytes of the request, and an event that is set at the end.
    `requests` holds what came.
    """

    def __init__(
        self,
        answer: Callable[[socket.socket, bytes, threading.Event], None],
        secured: ssl.SSLContext | None = None,
    ) -> None:
        self._answer, self._secured = answer, secured
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._gone = threading.Event()
        self.requests: list[bytes] = []
        self.url = f"http{'s' if secured else ''}://localhost:{self._listening.getsockname()[1]}/v1"

    def __enter__(self) -> HostileServer:
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._gone.set()
        self._listening.close()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                threading.Thread(target=self._one, args=(connection,), daemon=True).start()

    def _one(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            if self._secured:
                connection = self._secured.wrap_socket(connection, server_side=True)
            with connection:
                request = _request(connection)
                if request:
                    self.requests.append(request)
                    self._answer(connection, request, self._gone)


def _request(connection: socket.socket) -> bytes:
    """A whole request."""
    data = b""
    while b"\r\n\r\n" not in data:
        part = connection.recv(1 << 16)
        if not part:
            return b""
        data += part
    head, _, body = data.partition(b"\r\n\r\n")
    lengths = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
    wanted = int(lengths[0].partition(b":")[2]) if lengths else 0
    while len(body) < wanted:
        body += connection.recv(1 << 16)
    return head + b"\r\n\r\n" + body
