"""Addresses of servers, and the secrets that some of them hold."""

from __future__ import annotations

import re
from urllib.parse import parse_qsl, unquote, urlsplit, urlunsplit

from eagor._secrets import keep_out
from eagor.errors import EagorError

DEFAULT_SERVER = "http://localhost:8000/v1"


def place_of(text: str) -> tuple[str, tuple[str, ...]]:
    """Model and addresses in ``MODEL@ADDRESS``; empty where they are missing, several where commas are between them."""
    first = re.search(r"https?://", text)
    if first:  # there may be a password, and so another @, in an address
        model, addresses = text[: first.start()].removesuffix("@"), text[first.start() :]
    else:
        model, at, addresses = text.rpartition("@")
        model, addresses = (model, addresses) if at else (text, "")
    return model, tuple(address for address in addresses.split(",") if address)


def checked_address(url: str) -> str:
    """`url` with ``/v1`` where it has no path. Raises `EagorError` if it is none.

    A password in it, and what follows a question mark, count as secrets from now on.
    """
    try:
        parts = urlsplit(str(url).strip())
        valid = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts, valid = None, False
    if not (parts and valid):
        shown = re.sub(r"//[^/]*@", "//***@", str(url).partition("?")[0])
        raise EagorError(f"{shown!r} is no address of a server; wanted one such as {DEFAULT_SERVER}")
    login = login_of(url)
    keep_out(login, login.partition(":")[2], parts.netloc.rpartition("@")[0], *query_of(url).values())
    return urlunsplit(parts._replace(path=parts.path.rstrip("/") or "/v1", fragment=""))


def shown_address(url: str) -> str:
    """`url` without its secrets, as it may stand in tables: ``https://***@host/v1?key=***``."""
    parts = urlsplit(url)
    query = "&".join(f"{name}=***" for name in query_of(url))
    _, at, host = parts.netloc.rpartition("@")
    return urlunsplit(parts._replace(netloc=f"***@{host}" if at else host, query=query))


def bare_address(url: str) -> str:
    """`url` without user, password and parameters, which are sent in their own way."""
    parts = urlsplit(url)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2], query=""))


def login_of(url: str) -> str:
    """``user:password`` in `url`, empty where there is none."""
    parts = urlsplit(url)
    return f"{unquote(parts.username or '')}:{unquote(parts.password or '')}" if "@" in parts.netloc else ""


def query_of(url: str) -> dict[str, str]:
    """The parameters after the question mark."""
    return dict(parse_qsl(urlsplit(url).query, keep_blank_values=True))
