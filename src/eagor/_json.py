"""Reading JSON from elsewhere: every fault is a `ValueError` with a readable text."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

_DEEPEST = 200  # nesting of lists that repr, copy and json can still recurse over


def parsed(text: str | bytes, strict: bool = False) -> Any:
    """The value that `text` holds; `strict`: NaN and Infinity are errors, as in the JSON standard.

    Raises `ValueError` for invalid JSON, undecodable bytes, numbers of thousands of digits, an object that has a key
    twice, and lists or objects nested too deep to recurse over.
    """
    try:
        found = json.loads(text, parse_constant=_refused if strict else None, object_pairs_hook=_once)
    except RecursionError:
        raise ValueError("the lists are nested too deep to be read") from None
    opened = text.count(b"[") + text.count(b"{") if isinstance(text, bytes) else text.count("[") + text.count("{")
    if opened > _DEEPEST and _is_deep(found):
        raise ValueError(f"the lists are nested more than {_DEEPEST} deep")
    return found


def number(value: Any) -> float:
    """`value` as a float. Raises `ValueError` unless it is a finite number; text and True are not numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{shown(value)} is not a number")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found):
        raise ValueError(f"{shown(value)} is not a finite number")
    return found


def whole(value: Any) -> int:
    """`value` itself. Raises `ValueError` unless it is a whole number."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{shown(value)} is not a whole number")
    return value


def shown(value: Any, most: int = 60) -> str:
    """`value` for an error text, cut at `most` characters."""
    text = repr(value)
    return text if len(text) <= most else text[: most - 3] + "..."


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys differ: which of two values is meant cannot be known."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"an object has the key {shown(twice)} twice")
    return found


def _is_deep(value: Any) -> bool:
    level = [value]
    for _ in range(_DEEPEST):
        inner = [each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)]
        level = [value for values in inner for value in values]
    return any(isinstance(each, dict | list) for each in level)


def _refused(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
