"""The web server of the studio: pages, JSON about runs and pictures, and a socket per page for what is live.

Nothing is computed here. Sessions run in the engine's process, episodes are drawn again in a worker's; this process
passes bytes on. A page that reads slowly has a slot of its own with the newest step (`eagor.studio.hub.Slot`), so it
delays nobody.
"""

from __future__ import annotations

import asyncio
import threading
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from pathlib import Path
from socket import SO_SNDBUF, SOL_SOCKET, socket
from typing import Any
from urllib.parse import quote, unquote

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from eagor.studio.guard import Guard
from eagor.studio.hub import Page, Settings, Studio
from eagor.studio.messages import LONGEST, Message, PageError, media_type, packed, read

__all__ = ["Punctual", "configured", "create_app", "serve"]

PAGES = 64  # open at a time
RUBBISH = 10  # messages that make no sense, after which a page is sent away
TOO_MANY, TOO_WRONG = 4429, 4400  # codes with which a socket is closed


def create_app(studio: Studio) -> Starlette:
    """The ASGI application. Its processes run from its start to its end."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        studio.start()
        try:
            yield
        finally:
            await asyncio.to_thread(studio.close)

    async def state(_: Request) -> Response:
        return JSONResponse(studio.state())

    async def runs(_: Request) -> Response:
        folder = str(studio.settings.runs)
        return JSONResponse({"folder": folder, "runs": await studio.library.listed()})

    async def run(request: Request) -> Response:
        name = request.path_params["name"]
        return JSONResponse({"name": name, **await studio.library.opened(name)})

    async def episode(request: Request) -> Response:
        name, key = request.path_params["name"], request.path_params["key"]
        found = await studio.library.episode(name, key)
        if isinstance(found, int):
            return JSONResponse({"progress": found}, 202)
        here = f"/api/runs/{quote(name, safe='')}/episodes/{quote(key, safe='')}/panorama"
        return JSONResponse(found.as_json(lambda number: f"{here}/{number}"))

    async def panorama(request: Request) -> Response:
        name, key, number = (request.path_params[each] for each in ("name", "key", "number"))
        found = await studio.library.episode(name, key)
        if isinstance(found, int) or number not in found.pictures:
            raise PageError(f"Step {number} has no picture here.", "Open the episode again.", 404)
        picture = found.pictures[number]
        return Response(picture, media_type=media_type(picture), headers={"Cache-Control": "max-age=3600"})

    async def pictures(request: Request) -> Response:
        declared = request.headers.get("content-length", "")
        name = unquote(request.headers.get("x-name", ""))
        try:
            path = await studio.uploads.receive(int(declared) if declared.isdecimal() else None, request.stream())
        except ClientDisconnect:
            return Response(status_code=400)  # nobody reads it
        found = await asyncio.to_thread(studio.uploads.keep, path, name)
        return JSONResponse(found.as_json(), 201)

    async def socket(web: WebSocket) -> None:
        await serve_page(studio, web)

    routes = [
        Route("/", index),
        Route("/api/state", state),
        Route("/api/runs", runs),
        Route("/api/runs/{name}", run),
        Route("/api/runs/{name}/episodes/{key}", episode),
        Route("/api/runs/{name}/episodes/{key}/panorama/{number:int}", panorama),
        Route("/api/pictures", pictures, methods=["POST"]),
        WebSocketRoute("/ws", socket),
        Mount("/assets", _Assets(directory=str(assets() / "assets"), check_dir=False)),
    ]
    handlers: dict[Any, Any] = {PageError: _refused, 404: _missing, 405: _missing, 500: _broken}
    return Starlette(
        routes=routes,
        lifespan=lifespan,
        middleware=[Middleware(Guard, gate=studio.settings.gate)],
        exception_handlers=handlers,
    )


class _Assets(StaticFiles):
    """The built files; none, while the page has not been built."""

    async def check_config(self) -> None:
        if not (assets() / "assets").is_dir():
            raise HTTPException(404)
        await super().check_config()


def assets() -> Path:
    """The folder of the built page."""
    return Path(str(files("eagor.studio") / "static"))


async def index(_: Request) -> Response:
    """The page."""
    page = assets() / "index.html"
    if not page.is_file():
        raise PageError(
            "The page has not been built in this clone.", "Run make page there (it needs Node), then reload.", 503
        )
    return FileResponse(page, headers={"Cache-Control": "no-cache"})


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, PageError)
    return JSONResponse({"problem": error.problem, "change": error.change}, error.status)


async def _missing(request: Request, error: Exception) -> Response:
    said = {"problem": f"There is nothing at {request.url.path[:200]}.", "change": "Open the page at /."}
    return JSONResponse(said, getattr(error, "status_code", 404))


async def _broken(_: Request, error: Exception) -> Response:
    said = {"problem": f"The server has failed ({type(error).__name__}).", "change": "Its terminal says more."}
    return JSONResponse(said, 500)


async def serve_page(studio: Studio, web: WebSocket) -> None:
    """One page, until it goes: what it says is checked and passed on, what is for it is sent as fast as it reads."""
    await web.accept()
    if studio.open >= PAGES:
        await web.close(TOO_MANY, f"{PAGES} pages are open already; close one of them")
        return
    studio.open += 1
    page = Page()
    sending = asyncio.create_task(_send(page, web))
    try:
        await _listen(studio, page, web)
    finally:
        studio.open -= 1
        studio.hide(page)
        sending.cancel()
        with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError, OSError):
            await sending


async def _send(page: Page, web: WebSocket) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await web.send_bytes(packed(await page.slot.get()))


async def _listen(studio: Studio, page: Page, web: WebSocket) -> None:
    while True:
        received = await web.receive()
        if received["type"] == "websocket.disconnect":
            return
        text, message = received.get("text"), {}
        try:
            if text is None:
                raise PageError("A message of bytes came; text was wanted.", "Reload the page.")
            message = read(text)
            if not page.may_speak():
                continue
            if message["type"] == "open":
                studio.show(page, message)
            else:
                studio.tell(page, message)
        except PageError as error:
            page.rubbish += 1
            words = {"problem": error.problem, "change": error.change, "fatal": False,
                     "question": message.get("question", 0)}  # fmt: skip
            page.slot.put(Message({"type": "problem", **words}))
            if page.rubbish >= RUBBISH:
                await web.close(TOO_WRONG, "too many messages that make no sense")
                return


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
