"""The addresses of servers, and the secrets in them."""

from __future__ import annotations

import re
from urllib.parse import parse_qsl, unquote, urlsplit, urlunsplit

from eagor._files import keep_out
from eagor.errors import EagorError

DEFAULT_SERVER = "http://localhost:8000/v1"


def place_of(text: str) -> tuple[str, tuple[str, ...]]:
    """Model and addresses in ``MODEL@ADDRESS[,ADDRESS...]``; empty where missing."""
    first = re.search(r"https?://", text)
    if first:  # a password in an address may hold another @
        model, addresses = text[: first.start()].removesuffix("@"), text[first.start() :]
    else:
        model, at, addresses = text.rpartition("@")
        model, addresses = (model, addresses) if at else (text, "")
    return model, tuple(address for address in addresses.split(",") if address)


def checked_address(url: str) -> str:
    """`url` with ``/v1`` added if it has no path; its secrets are kept out of output. Raises `EagorError`."""
    try:
        parts = urlsplit(str(url).strip())
        valid = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts, valid = None, False
    if not (parts and valid):
        shown = re.sub(r"//[^/]*@", "//***@", str(url).partition("?")[0])
        raise EagorError(f"{shown!r} is not the address of a server; wanted one such as {DEFAULT_SERVER}")
    login = login_of(url)
    keep_out(login, login.partition(":")[2], parts.netloc.rpartition("@")[0], *query_of(url).values())
    return urlunsplit(parts._replace(path=parts.path.rstrip("/") or "/v1", fragment=""))


def shown_address(url: str) -> str:
    """`url` without its secrets, for output: ``https://***@host/v1?key=***``."""
    parts = urlsplit(url)
    query = "&".join(f"{name}=***" for name in query_of(url))
    _, at, host = parts.netloc.rpartition("@")
    return urlunsplit(parts._replace(netloc=f"***@{host}" if at else host, query=query))


def bare_address(url: str) -> str:
    """`url` without user, password and parameters, which are sent separately."""
    parts = urlsplit(url)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2], query=""))


def login_of(url: str) -> str:
    """``user:password`` in `url`, empty if there is none."""
    parts = urlsplit(url)
    return f"{unquote(parts.username or '')}:{unquote(parts.password or '')}" if "@" in parts.netloc else ""


def query_of(url: str) -> dict[str, str]:
    """The query parameters of `url`."""
    return dict(parse_qsl(urlsplit(url).query, keep_blank_values=True))
