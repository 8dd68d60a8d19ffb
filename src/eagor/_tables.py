"""Tables as CSV, without text that a spreadsheet would run as a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

_FORMULA = ("=", "+", "-", "@", "\t", "\n")  # a spreadsheet takes a cell that begins with one of these for a formula


def as_csv(rows: Iterable[Sequence[Any]], ending: str = "\n") -> str:
    """`rows` as CSV. Text that looks like a formula gets an apostrophe before it; numbers do not."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator=ending).writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    value = value.replace("\r", "\n")  # the writer does not always quote \r, which would start a new row
    if not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
