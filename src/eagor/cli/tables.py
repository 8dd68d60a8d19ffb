"""The file of ``--out``: answers as CSV, JSON lines or Parquet, with the same columns for every command."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eagor._csv import as_csv
from eagor._files import Lines, written
from eagor._parquet import as_parquet, need_parquet
from eagor.cli.looking import checked_out
from eagor.cli.terminal import UsageError

COLUMNS = (
    "frame", "stamp", "azimuth_deg", "elevation_deg", "credible_angle_deg", "presence", "distance_m", "distance_spread",
    "status",
)  # fmt: skip
SUFFIXES = (".csv", ".jsonl", ".parquet")

Entry = Mapping[str, Any]


@contextmanager
def table(path: Path, rivals: Sequence[str] = ()) -> Iterator[Callable[[Entry], None]]:
    """The file `path`; the yielded function adds one answer, as ``--json`` shows it. The first one creates the file.

    CSV and JSON lines are flushed after every answer. A Parquet file is written at the end, also if the run fails.
    `rivals` are the other methods that the answers have under "methods". Raises `UsageError` if the file cannot be
    written, `MissingExtraError` for Parquet without pyarrow, both before the first answer.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"--out {path}: wanted a file name that ends in .csv, .jsonl or .parquet")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"--out {path}: there is no folder {path.absolute().parent}; make it first")
    checked_out(path)
    columns = columns_of(rivals)
    if suffix == ".parquet":
        need_parquet()
        rows: list[list[Any]] = []
        try:
            yield lambda entry: rows.append(row_of(entry, columns))
        finally:
            if rows:
                written(path, as_parquet(columns, rows))
        return
    with Lines(path) as file:
        head = [columns]

        def write(entry: Entry) -> None:
            if suffix == ".jsonl":
                file.add(json.dumps(entry) + "\n")
            else:
                file.add(as_csv([*head, row_of(entry, columns)], "\r\n"))
                head.clear()

        yield write


def columns_of(rivals: Sequence[str]) -> list[str]:
    """The columns of CSV and Parquet; `modes` is the number of candidates."""
    return [*COLUMNS, "modes", "problem", *(f"{name}_{angle}_deg" for name in rivals for angle in _ANGLES)]


def row_of(entry: Entry, columns: Sequence[str]) -> list[Any]:
    """The values of an answer in these columns; None where it has none."""
    flat = {**entry, "modes": len(entry["modes"]), "problem": entry.get("problem", "")}
    for name, found in entry.get("methods", {}).items():
        flat |= {f"{name}_{angle}": value for angle, value in found.items()}
    return [flat.get(name) for name in columns]


_ANGLES = ("azimuth", "elevation")
