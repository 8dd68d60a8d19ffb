"""What a page may say, checked field by field: the browser is not trusted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eagor._json import number, parsed, shown, whole
from eagor.errors import EagorError

__all__ = ["LATE", "LONGEST", "PageError", "read"]

LONGEST = 16_384  # bytes of a message
LATE = 0.5  # seconds that a body moves at once at most: what was held up makes no leap
QUERY = 200  # characters
NAMES = 16  # methods


class PageError(EagorError):
    """A page has said or sent something that cannot be used: the `problem`, and what to `change`."""

    def __init__(self, problem: str, change: str, status: int = 400) -> None:
        super().__init__(f"{problem} {change}")
        self.problem, self.change, self.status = problem, change, status


def _text(most: int) -> Callable[[Any], str]:
    def read(value: Any) -> str:
        if not isinstance(value, str) or len(value) > most or any(ord(each) < 32 for each in value):
            raise ValueError(f"{shown(value)} is not a text of at most {most} characters")
        return " ".join(value.split())

    return read


def _one_of(*choices: str) -> Callable[[Any], str]:
    def read(value: Any) -> str:
        if value not in choices:
            raise ValueError(f"{shown(value)} is none of {', '.join(choices)}")
        return value

    return read


def _between(low: float, high: float) -> Callable[[Any], float]:
    def read(value: Any) -> float:
        found = number(value)
        if not low <= found <= high:
            raise ValueError(f"{found:g} is not from {low:g} to {high:g}")
        return found

    return read


def _whole(low: int, high: int) -> Callable[[Any], int]:
    def read(value: Any) -> int:
        found = whole(value)
        if not low <= found <= high:
            raise ValueError(f"{found} is not from {low} to {high}")
        return found

    return read


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{shown(value)} is not true or false")
    return value


def _names(value: Any) -> list[str]:
    if not isinstance(value, list) or len(value) > NAMES:
        raise ValueError(f"{shown(value)} is not a list of at most {NAMES} names")
    return [_text(64)(each) for each in value]


_QUERY, _NAME, _ANGLE = _text(QUERY), _text(64), _between(-100.0, 100.0)
# The fields of each message: how each is read, and its default (no default: it has to be there).
_FIELDS: dict[str, dict[str, tuple[Any, ...]]] = {
    "open": {
        "view": (_one_of("walk", "picture", "live"),),
        "query": (_QUERY, ""),
        "perception": (_NAME, ""),
        "seed": (_whole(0, 9999), None),
        "drive": (_one_of("policy", "person"), "policy"),
        "id": (_NAME, ""),
        "methods": (_names, []),
    },
    "query": {"text": (_QUERY,)},
    "drive": {
        "by": (_one_of("policy", "person"), "person"),
        "forward": (_between(-10.0, 10.0), 0.0),
        "turn": (_between(-100.0, 100.0), 0.0),
        "seconds": (_between(0.0, LATE), 0.0),
    },
    "camera": {"yaw": (_ANGLE, 0.0), "pitch": (_ANGLE, 0.0), "roll": (_ANGLE, 0.0)},
    "pause": {"on": (_flag,)},
    "seek": {"frame": (_whole(0, 10**9),)},
    "degree": {"L": (_whole(1, 31),)},
    "methods": {"names": (_names,)},
    "restart": {},
}


def read(text: str | bytes) -> dict[str, Any]:
    """The message in `text`, with every field that its type has. Raises `PageError`, which says what was wanted."""
    if len(text) > LONGEST:
        raise PageError(f"A message of {len(text)} bytes came; at most {LONGEST} were wanted.", "Send less.", 413)
    try:
        found = parsed(text, strict=True)
    except ValueError as error:
        raise PageError(f"A message came that is no JSON ({error}).", "Send one JSON object per message.") from None
    kinds = ", ".join(_FIELDS)
    kind = found.get("type") if isinstance(found, dict) else None
    if not isinstance(kind, str) or kind not in _FIELDS:
        raise PageError(f"A message of the type {shown(kind)} came; known are {kinds}.", "Reload the page.")
    message: dict[str, Any] = {"type": kind}
    for name, (reads, *default) in _FIELDS[kind].items():
        if found.get(name) is None:
            if not default:
                raise PageError(f"A message {kind!r} came without {name!r}.", "Reload the page.")
            message[name] = default[0]
            continue
        try:
            message[name] = reads(found[name])
        except ValueError as error:
            raise PageError(f"In a message {kind!r}, {name} is wrong: {error}.", "Reload the page.") from None
    if kind in ("query",) and not any(each.isalnum() for each in message["text"]):
        raise PageError("The query has no words.", "Say what to look for, such as 'red chair'.")
    return message
