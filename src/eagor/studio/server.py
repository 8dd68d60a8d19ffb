"""The web server of the studio: the page, JSON about runs and pictures, and a socket per page for what is live.

Only its own page may speak to it, from this machine, or whoever has the token. Nothing is computed here: a page that
reads slowly keeps the newest step alone (`eagor.studio.sessions.Page`), so it delays nobody.
"""

from __future__ import annotations

import asyncio
import hmac
import threading
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict
from functools import partial
from importlib.resources import files
from ipaddress import ip_address
from pathlib import Path
from socket import SO_SNDBUF, SOL_SOCKET, socket
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from eagor.studio.answers import media_type
from eagor.studio.messages import LONGEST, Message, Open, PageError, packed, read
from eagor.studio.sessions import Page, SessionManager, Settings

__all__ = ["Auth", "create_app", "is_loopback", "serve"]

FOREIGN = 4403  # the code with which a socket is closed
STATIC = Path(str(files("eagor.studio") / "static"))
POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
LEAVING = 2  # seconds that pages have to go
NEWEST = 1 << 16  # bytes that wait in the network for a page that reads slowly: about a panorama, else it sees the past
OPENING = 0.5  # seconds until the browser is told: the server needs a moment


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what is bound to `host`."""
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


class Auth:
    """ASGI middleware: refuses who may not speak here, and sets the headers that keep a page to itself.

    `host` that is bound; `token` that is wanted in the query of all but the page itself (None: none). Without one, only
    names of this machine are answered to: a foreign name for 127.0.0.1 is another site's way in (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, host: str, token: str | None) -> None:
        self.app, self.host, self.token = app, host, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        why = None if scope["type"] == "lifespan" else self.refusal(scope)

        async def dressed(message: Any) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        if why is None:
            await self.app(scope, receive, dressed)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": FOREIGN, "reason": why[1]})
        else:
            await JSONResponse({"problem": why[1], "change": why[2]}, why[0])(scope, receive, dressed)

    def refusal(self, scope: Scope) -> tuple[int, str, str] | None:
        """Why a request is refused: a status, the problem, and what to change; None: it is not."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        name = urlsplit(f"//{host}").hostname or ""
        if self.token is None and name != self.host and not is_loopback(name):
            return 421, "This server has another name.", f"Open it as {self.host}."
        if origin is not None and urlsplit(origin).netloc != host:
            return 403, "The request comes from another site's page.", "Open the studio's own page."
        if self.token is not None and scope["path"].startswith(("/api", "/ws")):
            given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])
            if not hmac.compare_digest(given[0].encode(), self.token.encode()):
                return 401, "The token is missing or wrong.", "Open the address that eagor studio printed."
        return None


def create_app(manager: SessionManager) -> Starlette:
    """The ASGI application. Its processes end with it."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        try:
            yield
        finally:
            await asyncio.to_thread(manager.close)

    async def index(_: Request) -> Response:
        if not (STATIC / "index.html").is_file():
            raise PageError("The page has not been built in this clone.", "Run make page (it needs Node).", 503)
        return FileResponse(STATIC / "index.html", headers={"Cache-Control": "no-cache"})

    async def state(_: Request) -> Response:
        return JSONResponse(manager.state())

    async def runs(request: Request) -> Response:
        about = [*request.path_params.values()]
        found = await manager.runs.ask(("listed", "opened", "episode", "picture")[len(about)], *about)
        if not isinstance(found, bytes):
            return JSONResponse(found)
        return Response(found, media_type=media_type(found), headers={"Cache-Control": "max-age=3600"})

    async def pictures(request: Request) -> Response:
        declared, name = request.headers.get("content-length", ""), unquote(request.headers.get("x-name", ""))
        size = int(declared) if declared.isdecimal() else 0
        with suppress(ClientDisconnect):  # nobody reads the answer
            return JSONResponse(asdict(await manager.uploads.receive(size, request.stream(), name)), 201)
        return Response(status_code=400)

    return Starlette(
        routes=[
            Route("/", index),
            Route("/api/state", state),
            Route("/api/runs", runs),
            Route("/api/runs/{name}", runs),
            Route("/api/runs/{name}/episodes/{key}", runs),
            Route("/api/runs/{name}/episodes/{key}/panorama/{number:int}", runs),
            Route("/api/pictures", pictures, methods=["POST"]),
            WebSocketRoute("/ws", partial(_serve_page, manager)),
            Mount("/assets", StaticFiles(directory=STATIC / "assets", check_dir=False)),
        ],
        lifespan=lifespan,
        middleware=[Middleware(Auth, host=manager.settings.host, token=manager.settings.token)],
        exception_handlers={PageError: _refused},
    )


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, PageError)
    return JSONResponse({"problem": error.problem, "change": error.change}, error.status)


async def _serve_page(manager: SessionManager, web: WebSocket) -> None:
    """One page, until it goes: what it says is checked and passed on, what is for it is sent as fast as it reads."""
    await web.accept()
    page = Page()

    async def send() -> None:
        while True:
            await web.send_bytes(packed(await page.get()))

    sending = asyncio.create_task(send())
    try:
        while (received := await web.receive())["type"] != "websocket.disconnect":
            message: Any = None
            try:
                message = read(received.get("text") or received.get("bytes") or "")
                (manager.open if isinstance(message, Open) else manager.tell)(page, message)
            except PageError as error:
                page.put(Message.problem(error.problem, error.change, question=getattr(message, "question", 0)))
    finally:
        manager.leave(page)
        sending.cancel()
        with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError, OSError):
            await sending


def serve(settings: Settings, taken: socket, opens: str | None = None) -> None:
    """Serve at a socket that is bound, until Ctrl-C or SIGTERM; `opens`: an address for this desktop's browser."""
    taken.setsockopt(SOL_SOCKET, SO_SNDBUF, NEWEST)  # connections have it from the socket that accepts them
    if opens is not None:
        threading.Timer(OPENING, webbrowser.open, [opens]).start()
    config = uvicorn.Config(
        create_app(SessionManager(settings)), log_level="warning", ws="websockets-sansio", ws_max_size=LONGEST,
        ws_per_message_deflate=False, timeout_graceful_shutdown=LEAVING, server_header=False,
    )  # fmt: skip
    uvicorn.Server(config).run(sockets=[taken])
