"""What the classes of a detector are called: by a file, a list, names by number, or an ONNX file's own metadata."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

from eagor._checks import shown
from eagor._files import read_file
from eagor.errors import FormatError

MOST = 100_000  # classes
WANTED = "wanted a list of names, or names by number"
_NOTHING = {"background", "__background__", "n/a", "none", "???", ""}  # what numbers are called that no class has
_NUMBERED = re.compile(r"(\d+)\s*[:=,\t ]\s*(.+)")

Labels = str | os.PathLike[str] | Sequence[str] | Mapping[int, str]


def names_of(labels: Labels, first: int, where: str = "labels") -> tuple[str, ...]:
    """The names of classes in the order of their numbers, "" for a number without a class.

    `labels`: a file (`read_labels`), a list, or names by number. `first`: the number of the first name of a list that
    does not begin with the background, which has number 0. Raises `FormatError` for what is no such thing.
    """
    listed: Any = labels
    if isinstance(labels, str | os.PathLike):
        where, listed = f"the labels in {os.fspath(labels)}", read_labels(labels)
    try:
        if not isinstance(listed, Mapping):
            listed = dict(enumerate(listed, 0 if listed[0].strip().lower() in _NOTHING else first))
        names = {int(number): name.strip() for number, name in listed.items()}
    except (TypeError, ValueError, AttributeError, IndexError):
        names = {}
    names = {number: "" if name.lower() in _NOTHING else name for number, name in names.items()}
    if not any(names.values()) or min(names) < 0 or max(names) >= MOST:
        raise FormatError(f"{where}: {shown(listed)}; {WANTED}")
    return tuple(names.get(number, "") for number in range(max(names) + 1))


def read_labels(path: str | os.PathLike[str]) -> Any:
    """The labels in a text file: one per line, ``id name`` on each line, or a list or an object as JSON.

    Empty lines at the end do not count. Raises `FormatError`, which says what is wrong where.
    """
    try:
        text = read_file(path).decode("utf-8-sig").rstrip()
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); wanted a text file of labels, one per line") from error
    if not text:
        raise FormatError(f"{path} has no labels; wanted one per line, 'id name' lines, or a JSON list")
    if text.lstrip()[0] in "[{":
        return literal(text, str(path))
    lines = [line.strip() for line in text.splitlines()]
    numbered = [match.groups() for line in lines if (match := _NUMBERED.fullmatch(line))]
    if len(numbered) < len(lines):
        return lines
    if len({int(number) for number, _ in numbered}) < len(numbered):
        raise FormatError(f"{path} has a number twice; wanted 'id name' lines, each id once")
    return {number: name for number, name in numbered}


def literal(text: str, where: str) -> Any:
    """A list or mapping written as JSON or as Python writes it; nothing in it is run. Raises `FormatError`."""
    try:
        return ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        raise FormatError(f"{where} cannot be read: {shown(text)}; {WANTED}") from None
