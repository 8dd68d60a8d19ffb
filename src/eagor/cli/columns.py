"""Text in columns, for people who read a terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any


def table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows under their heads: the first column to the left, the others to the right."""
    wide = [max(len(row[k]) for row in rows if k < len(row)) for k in range(len(rows[0]))]
    for row in rows:
        cells = (text.ljust(wide[k]) if k == 0 else text.rjust(wide[k]) for k, text in enumerate(row))
        print("  ".join(cells).rstrip())


def columns(pairs: Mapping[str, Any], indent: int = 4) -> None:
    """Print names and what they mean."""
    wide = max((len(name) for name in pairs), default=0)
    for name, what in pairs.items():
        print(f"{' ' * indent}{name.ljust(wide)}  {what}")


def words(value: Any) -> str:
    """Text as it is, anything else as JSON."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
