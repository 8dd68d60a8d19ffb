"""Tables as files: CSV without text that a spreadsheet would run as a formula, and Parquet (the extra ``parquet``)."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

from eagor._extras import need

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


def need_parquet() -> None:
    """Raise `MissingExtraError` unless Parquet files can be written; asked before long work."""
    need("a Parquet file", "parquet", "pyarrow")


def as_parquet(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """`rows` as a Parquet file; None is null. Raises `MissingExtraError` without pyarrow.

    A column has one type: bool, int64, double, or string if its values are anything else. One without values is double.
    """
    need_parquet()
    import pyarrow  # pyright: ignore[reportMissingImports]
    from pyarrow import parquet  # pyright: ignore[reportMissingImports]

    types = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
    values = list(zip(*rows, strict=True)) or [()] * len(columns)
    arrays = []
    for column in values:
        kind = _kind(column)
        arrays.append(pyarrow.array([None if value is None else kind(value) for value in column], types[kind]))
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(arrays, names=list(columns)), sink)
    return sink.getvalue().to_pybytes()


def _kind(column: Sequence[Any]) -> type:
    """The type that holds all values of a column."""
    values = [value for value in column if value is not None]
    if values and all(isinstance(value, bool) for value in values):
        return bool
    if values and all(isinstance(value, Integral) and not isinstance(value, bool) for value in values):
        return int
    if all(isinstance(value, Real) and not isinstance(value, bool) for value in values):
        return float
    return str
