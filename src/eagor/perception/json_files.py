"""JSON that people write, checked at the border: lines of a file, and objects by their structure.

A structure is a `msgspec.Struct` whose fields say in ``Meta(description=...)`` what is wanted, or a dataclass. Every
fault is a `FormatError` that says where it is, what came and what was wanted.
"""

from __future__ import annotations

import difflib
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from json import JSONDecodeError
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import msgspec

from eagor._checks import parsed, shown
from eagor.errors import EagorError, FormatError

__all__ = ["Finite", "Tilt", "Turn", "checked", "need", "object_of", "parsed_lines"]

MOST_BYTES = 1 << 30  # of a file: more is taken for something that never ends

Finite = Annotated[float, msgspec.Meta(ge=-1e300, le=1e300, description="a finite number")]
# Degrees: azimuth, yaw and roll; elevation and pitch.
Turn = Annotated[float, msgspec.Meta(ge=-360, le=360, description="a number from -360 to 360")]
Tilt = Annotated[float, msgspec.Meta(ge=-90, le=90, description="a number from -90 to 90")]

_TYPES = {"float": "a number", "int": "a whole number", "str": "text", "array": "a list", "object": "an object"}
_Kind = TypeVar("_Kind")


def parsed_lines(path: str | os.PathLike[str], parse: Callable[[bytes], _Kind]) -> Iterator[tuple[_Kind, str]]:
    """What `parse` makes of each line of a file that is not blank, and where it stands: ``looks.jsonl, line 3``.

    Raises `FormatError` for what `parse` refuses, with the file and the line, and for a file that cannot be read: also
    a device or a pipe, which may never end.
    """
    name = os.fspath(path)
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            kind = os.fstat(file.fileno()).st_mode
            content = file.read(MOST_BYTES + 1) if stat.S_ISREG(kind) else None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FormatError(f"{name} cannot be read ({error}); give the path of a JSONL file") from error
    if content is None:
        raise FormatError(f"{name} cannot be read (it is a device or a pipe); wanted a JSONL file on a disk")
    if len(content) > MOST_BYTES:
        raise FormatError(f"{name} has more than {MOST_BYTES >> 20} MiB; wanted a JSONL file of less: split it")
    lines = content.removeprefix(b"\xef\xbb\xbf").split(b"\n")
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        where, hint = f"{name}, line {number}", ""
        try:
            found = parse(line)
        except EagorError as error:
            if number == len(lines) and isinstance(error.__cause__, JSONDecodeError | UnicodeDecodeError):
                hint = ". The last line is incomplete: the writer was probably interrupted; remove the line"
            raise FormatError(f"{where}: {error}{hint}") from error
        yield found, where


def _open_at_once(path: str, flags: int) -> int:
    """A descriptor; opening a pipe without a writer does not wait for one."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def object_of(line: str | bytes) -> dict[str, Any]:
    """The JSON object in a line."""
    try:
        entry = parsed(line.decode("utf-8") if isinstance(line, bytes) else line, strict=True)
    except ValueError as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise FormatError(f"is not JSON ({error}); wanted one JSON object") from error
    need(isinstance(entry, dict), "the line", entry, "one JSON object")
    return entry


def checked(
    entry: Any, kind: type[_Kind], name: str, *, noted: bool = False, hints: Mapping[str, str] | None = None
) -> _Kind:
    """Parsed JSON as the structure `kind`, which errors call `name`.

    `noted`: keys that begin with ``_`` are notes, and null means absent, at any depth. `hints`: what to say of keys
    that others use. Raises `FormatError`; a key that is not known is refused with the nearest that is.
    """
    bare = _unnoted(entry) if noted else entry
    try:
        return msgspec.convert(bare, kind)
    except UnicodeEncodeError as error:
        raise FormatError(f"{name} has a key that is no text ({error})") from error
    except msgspec.ValidationError as error:
        own = error.__cause__  # what the class in the structure says itself
        note = ". A note of your own begins with _" if noted else ""
        text = str(own) if isinstance(own, EagorError) else _explained(bare, kind, name, str(error), hints or {}, note)
        raise FormatError(text) from error


def _unnoted(entry: Any) -> Any:
    if isinstance(entry, dict):
        return {key: _unnoted(each) for key, each in entry.items() if each is not None and not key.startswith("_")}
    return [_unnoted(each) for each in entry] if isinstance(entry, list) else entry


def need(holds: bool, what: str, came: Any, wanted: str) -> None:
    """Raise `FormatError` unless it holds."""
    if not holds:
        found = "is missing" if came is None else f"is {shown(came)}"
        raise FormatError(f"{what} {found}; wanted {wanted}")


def _explained(entry: Any, kind: Any, name: str, text: str, hints: Mapping[str, str], note: str) -> str:
    """What came and what was wanted, for an error of msgspec, which tells only the types and the place."""
    what, came, wanted, at = name, entry, "one JSON object", entry
    text, _, path = text.partition(" - at `$")
    for field, place in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        if not field:
            at, name = at[int(place)], f"an item of {what}"
            continue
        wanted, inner = _wanted(kind, field)
        kind, what, name, came, at = inner or kind, field, field, at[field], at[field]
    if missing := re.match(r"Object missing required field `(\w+)`", text):
        return f"{missing[1]} is missing; wanted {_wanted(kind, missing[1])[0] or 'it'}"
    if text.startswith("Object contains unknown field"):
        known = kind.__struct_fields__
        strange = next(key for key in at if key not in known)
        near = difflib.get_close_matches(strange, known, n=1, cutoff=0.5)
        start = f"did you mean {near[0]}? Known are" if near else "known are"
        hint = f" ({hints[strange]})" if strange in hints else ""
        return f"{shown(strange)} is no key of {name}; {start} {', '.join(known)}{hint}{note}"
    if not wanted and (expected := re.match(r"Expected `([\w |]+)`( of length \d+)?", text)):
        wanted = " or ".join(_TYPES.get(each, each) for each in expected[1].split(" | ")) + (expected[2] or "")
    return f"{what} is {shown(came)}; wanted {wanted or text}"


def _wanted(kind: Any, field: str) -> tuple[str, Any]:
    """What a field of a structure wants in words, and the structure in it, None if there is none."""
    wanted, inner = "", None
    parts = [get_type_hints(kind, include_extras=True)[field]]
    for part in parts:  # grows while it is gone through: from the outside to the inside
        told = [each.description for each in getattr(part, "__metadata__", ()) if isinstance(each, msgspec.Meta)]
        wanted = wanted or next(filter(None, told), "")
        if isinstance(part, type) and (issubclass(part, msgspec.Struct) or is_dataclass(part)):
            inner = part
        parts += get_args(part)
    return wanted, inner
