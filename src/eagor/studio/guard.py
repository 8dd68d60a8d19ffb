"""Who may speak to the server: the page that it sent itself, from this machine, or whoever has the token."""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import JSONResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Gate", "Guard", "is_loopback"]

COOKIE = "eagor_token"
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
FOREIGN = 4403  # the code with which a socket is refused


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach what is bound to `host`."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@dataclass(frozen=True)
class Gate:
    """`host` that is bound; `token` that is wanted (None: none, on the loopback alone)."""

    host: str
    token: str | None = None

    def names(self, host: str) -> bool:
        """Whether a Host header means us: a foreign name for 127.0.0.1 is another site's way in (DNS rebinding)."""
        name = urlsplit(f"//{host}").hostname or ""
        return self.token is not None or name == self.host or is_loopback(name)

    def from_here(self, headers: Headers) -> bool:
        """Whether a request comes from our own page, or from no page at all."""
        origin = headers.get("origin")
        return origin is None or urlsplit(origin).netloc == headers.get("host", "")

    def knows(self, scope: Scope, headers: Headers) -> bool:
        """Whether the token is there, if one is wanted: in the address, the cookie, or as a bearer's."""
        if self.token is None:
            return True
        told = [each for each in parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])]
        told.append(cookie_parser(headers.get("cookie", "")).get(COOKIE, ""))
        told.append(headers.get("authorization", "").removeprefix("Bearer "))
        return any(hmac.compare_digest(each.encode(), self.token.encode()) for each in told)


class Guard:
    """ASGI middleware: refuses whoever the gate refuses, and sets the headers that keep a page to itself."""

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self.app, self.gate = app, gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        why = self._refusal(scope, headers)
        if scope["type"] == "websocket":
            if why is None:
                await self.app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": FOREIGN, "reason": why[1][:120]})
            return

        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                found = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    found.setdefault(name, value)
            await send(message)

        if why is not None:
            status, problem, change = why
            answer: Any = JSONResponse({"problem": problem, "change": change}, status)
        elif self._brings_token(scope):
            answer = RedirectResponse(scope["path"], 303)  # so that the token does not stay in the address
            assert self.gate.token is not None
            answer.set_cookie(COOKIE, self.gate.token, httponly=True, samesite="strict")
        else:
            answer = self.app
        await answer(scope, receive, dressed)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str, str] | None:
        host = headers.get("host", "")
        if not self.gate.names(host):
            return 421, f"This server is not called {host[:80]!r}.", f"Open it as {self.gate.host}."
        if not self.gate.from_here(headers):
            return 403, "The request comes from another site's page.", "Open the studio's own page."
        if not self.gate.knows(scope, headers):
            return 401, "The token is missing or wrong.", "Open the address that eagor studio printed, with its token."
        return None

    def _brings_token(self, scope: Scope) -> bool:
        """Whether a page is opened with the token in its address."""
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        return self.gate.token is not None and scope["path"] == "/" and "token" in query
