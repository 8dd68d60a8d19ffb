"""One record as one line of JSON, checked before anything is written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from eagor._secrets import redacted
from eagor.errors import EagorError


def as_line(record: Mapping[str, Any]) -> bytes:
    """`record` as one line of JSON with its newline; NumPy numbers and arrays become plain ones, secrets stars.

    Raises `EagorError`, which names the place, for NaN, infinity, and what JSON does not know.
    """
    name = str(record.get("key", "record"))
    text = json.dumps(_plain(record, name), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    text = redacted(text) + "\n"
    return text.encode("utf-8", "backslashreplace")  # half a pair of surrogates is written as JSON escapes it


def _plain(value: Any, place: str) -> Any:
    """`value` in Python's own types, checked."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        raise EagorError(f"{place} is {value}; a record holds finite numbers, and null where there is no case")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Mapping):
        return {_name(key, place): _plain(item, f"{place}: {key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{place}[{index}]") for index, item in enumerate(value)]
    raise EagorError(
        f"{place} is a {type(value).__name__}, which JSON cannot hold; store numbers, text or lists of them"
    )


def _name(key: Any, place: str) -> str:
    if not isinstance(key, str):
        raise EagorError(f"{place} has the key {key!r}; wanted text, which is all that JSON can hold there")
    return key
