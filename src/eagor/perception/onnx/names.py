"""What the classes of a network are called: from a file of labels, a list, or what the network's own file says."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from eagor._files import read_file
from eagor._json import parsed, shown
from eagor.errors import FormatError

KEYS = ("names", "class_names", "classes", "labels", "id2label")  # of the metadata, the first that is there
_LONGEST = 4_000_000  # characters of a list of labels: tens of thousands of classes
_NOTHING = {"background", "__background__", "bg", "n/a", "na", "???", "none", ""}  # numbers that no class has
_NUMBERED = re.compile(r"(\d+)\s*[:=,\t ]\s*(.+)")

Labels = str | os.PathLike[str] | Sequence[str] | Mapping[int, str]


class Names(NamedTuple):
    """Names by number, how many numbers there are, and whether each of them had its line; `where` they came from."""

    named: dict[int, str]
    total: int
    complete: bool
    where: str


def names_of(labels: Labels | None, notes: Mapping[str, str], first: int) -> Names | None:
    """The names of classes; None where neither `labels` nor `notes`, the file's metadata, has any.

    `labels`: a file (`read_labels`), a list, or names by number. `first`: the number of the first name of a list that
    does not begin with the background; that one always has number 0. Raises `FormatError` for what is no such thing.
    """
    if labels is not None:
        if isinstance(labels, str | os.PathLike):
            return _numbered(read_labels(labels), first, f"the labels in {os.fspath(labels)}")
        return _numbered(labels, first, "labels")
    for key in KEYS:
        if notes.get(key, "").strip():
            where = f"{key!r} in the file's metadata"
            return _numbered(_literal(notes[key], where), first, where)
    return None


def read_labels(path: str | os.PathLike[str]) -> list[str] | dict[int, str]:
    """The labels in a text file: one per line; ``id name`` on each line; or a list or an object as JSON.

    Empty lines at the end do not count, nor does what follows ``#`` at the beginning of a line. Raises `FormatError`,
    which says what is wrong where.
    """
    try:
        text = read_file(path)[: _LONGEST + 1].decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise FormatError(f"{path} cannot be read ({error}); wanted a text file of labels, one per line") from error
    if text.lstrip()[:1] in ("[", "{"):
        return _literal(text, str(path))
    lines = [line.strip() for line in text.rstrip().splitlines() if not line.startswith("#")]
    if not any(lines):
        raise FormatError(f"{path} has no labels; wanted one per line, 'id name' lines, or a JSON list")
    found = [_NUMBERED.fullmatch(line) for line in lines]
    if not all(found):
        return lines
    numbers = [int(match[1]) for match in found if match]
    if len(set(numbers)) < len(numbers):
        twice = next(number for number in numbers if numbers.count(number) > 1)
        raise FormatError(f"{path} has the number {twice} twice; wanted 'id name' lines, each id once")
    return {int(match[1]): match[2] for match in found if match}


def _literal(text: str, where: str) -> Any:
    """A list or mapping written as JSON, or as Python writes it; nothing in it is run."""
    if len(text) <= _LONGEST:
        try:
            return parsed(text)
        except ValueError:
            pass
        try:
            return ast.literal_eval(text.strip())
        except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
            if re.fullmatch(r"[^\[\]{}\"]+", text) and "," in text:
                return [part.strip() for part in text.split(",")]
    raise FormatError(f"{where} cannot be read: {shown(text)}; wanted a list of names, or {{number: name}}")


def _numbered(found: Any, first: int, where: str) -> Names:
    wanted = f"{where}: {shown(found)}; wanted a list of names, or names by number"
    if isinstance(found, Mapping):
        try:
            names = {int(number): name for number, name in found.items()}
        except (TypeError, ValueError):
            raise FormatError(wanted) from None
    elif isinstance(found, Sequence) and not isinstance(found, str | bytes):
        begins = 0 if found and str(found[0]).strip().lower() in _NOTHING else first
        names = dict(enumerate(found, start=begins))
    else:
        raise FormatError(wanted)
    if not names or min(names) < 0 or not all(isinstance(name, str) for name in names.values()):
        raise FormatError(wanted)
    named = {number: name.strip() for number, name in sorted(names.items()) if name.strip().lower() not in _NOTHING}
    if not named:
        raise FormatError(wanted)
    return Names(named, max(names) + 1, isinstance(found, Sequence), where)
