"""Text in columns for the terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def columns(pairs: Mapping[str, Any], indent: int = 4) -> None:
    """Print names and their meanings."""
    wide = max((len(name) for name in pairs), default=0)
    for name, what in pairs.items():
        print(f"{' ' * indent}{name.ljust(wide)}  {what}")


def facts(pairs: Mapping[str, Any], indent: int = 0) -> None:
    """Print names and values; nested values are indented below their name."""
    plain = {name: words(value) for name, value in pairs.items() if not (isinstance(value, Mapping) and value)}
    wide = max((len(name) for name in plain), default=0)
    for name, value in pairs.items():
        if name in plain:
            print(f"{' ' * indent}{name.ljust(wide)}  {plain[name]}")
        else:
            print(f"{' ' * indent}{name}")
            facts(value, indent + 2)


def words(value: Any) -> str:
    """Text unchanged, a list with commas, empty values as "none", anything else as JSON."""
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple) or value == {}:
        return ", ".join(words(item) for item in value) or "none"
    return json.dumps(value, ensure_ascii=False)
