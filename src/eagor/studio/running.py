"""Runs the server until Ctrl-C."""

from __future__ import annotations

import asyncio
import threading
import webbrowser
from socket import SO_SNDBUF, SOL_SOCKET, socket
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from eagor.studio.hub import Settings, Studio
from eagor.studio.messages import LONGEST
from eagor.studio.server import create_app

__all__ = ["Punctual", "configured", "serve"]

LEAVING = 2  # seconds that pages have to go
NEWEST = 1 << 16  # bytes that wait in the network for a page that reads slowly: about a panorama, else it sees the past
PATIENCE = 15.0  # seconds that a request's head may take from its first byte on
OPENING = 0.5  # seconds until the browser is told: the server needs a moment


class Punctual(H11Protocol):
    """HTTP as uvicorn speaks it, that lets go whoever begins a request and does not finish its head in `PATIENCE`.

    Nothing else would: what waits for the rest of a head has no other deadline.
    """

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client that says nothing at all has as long."""
        super().connection_made(transport)
        self._late = self.loop.call_later(PATIENCE, transport.close)

    def data_received(self, data: bytes) -> None:
        """The clock runs while no request is whole; it stands still while one is answered."""
        super().data_received(data)
        answering = self.cycle is not None and not self.cycle.response_complete
        if answering or self.transport.get_protocol() is not self:  # it has become a WebSocket
            self._in_time()
        elif self._late is None:
            self._late = self.loop.call_later(PATIENCE, self.transport.close)

    def connection_lost(self, exc: Exception | None) -> None:
        """The client has gone."""
        self._in_time()
        super().connection_lost(exc)

    def _in_time(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


def configured(app: Any, **further: Any) -> uvicorn.Config:
    """How the server runs `app`."""
    return uvicorn.Config(
        app, log_level="warning", http=Punctual, ws="websockets-sansio", ws_max_size=LONGEST,
        ws_per_message_deflate=False, timeout_graceful_shutdown=LEAVING, server_header=False, **further,
    )  # fmt: skip


def serve(settings: Settings, taken: socket, opens: str | None = None) -> None:
    """Serve at a socket that is bound, until Ctrl-C or SIGTERM; `opens`: an address for this desktop's browser."""
    taken.setsockopt(SOL_SOCKET, SO_SNDBUF, NEWEST)  # connections have it from the socket that accepts them
    if opens is not None:
        threading.Timer(OPENING, webbrowser.open, [opens]).start()
    uvicorn.Server(configured(create_app(Studio(settings)))).run(sockets=[taken])
