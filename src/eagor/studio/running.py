"""Runs the server until Ctrl-C."""

from __future__ import annotations

import threading
import webbrowser
from socket import SO_SNDBUF, SOL_SOCKET, socket

import uvicorn

from eagor.studio.hub import Settings, Studio
from eagor.studio.messages import LONGEST
from eagor.studio.server import create_app

__all__ = ["serve"]

LEAVING = 2  # seconds that pages have to go
NEWEST = 1 << 16  # bytes that wait in the network for a page that reads slowly: about a panorama, else it sees the past
OPENING = 0.5  # seconds until the browser is told: the server needs a moment


def serve(settings: Settings, taken: socket, opens: str | None = None) -> None:
    """Serve at a socket that is bound, until Ctrl-C or SIGTERM; `opens`: an address for this desktop's browser."""
    taken.setsockopt(SOL_SOCKET, SO_SNDBUF, NEWEST)  # connections have it from the socket that accepts them
    app = create_app(Studio(settings))
    config = uvicorn.Config(
        app, log_level="warning", ws="websockets-sansio", ws_max_size=LONGEST, ws_per_message_deflate=False,
        timeout_graceful_shutdown=LEAVING, server_header=False,
    )  # fmt: skip
    if opens is not None:
        threading.Timer(OPENING, webbrowser.open, [opens]).start()
    uvicorn.Server(config).run(sockets=[taken])
