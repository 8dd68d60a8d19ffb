"""CSV that a spreadsheet opens as what it is: text stays text."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

_FORMULA = ("=", "+", "-", "@", "\t", "\n")  # how cells begin that a spreadsheet computes, and may run


def as_csv(rows: Iterable[Sequence[Any]], ending: str = "\n") -> str:
    """`rows` as CSV; text that would be taken for a formula has an apostrophe before it (numbers are none)."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator=ending).writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    value = value.replace("\r", "\n")  # the writer quotes the one, not always the other, which would begin a row
    if not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
