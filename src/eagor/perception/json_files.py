"""JSON that people write, checked at the border: lines of a file, and objects by their structure.

Every fault is a `FormatError` that says where it is, what came and what was wanted.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterator
from json import JSONDecodeError
from typing import Annotated, Any, TypeVar

import msgspec

from eagor._checks import parsed, shown
from eagor._files import read_file
from eagor.errors import EagorError, FormatError

__all__ = ["Finite", "Tilt", "Turn", "checked", "object_of", "parsed_lines", "require_field"]

Finite = Annotated[float, msgspec.Meta(ge=-1e300, le=1e300)]
# Degrees: azimuth, yaw and roll; elevation and pitch.
Turn = Annotated[float, msgspec.Meta(ge=-360, le=360)]
Tilt = Annotated[float, msgspec.Meta(ge=-90, le=90)]

_Kind = TypeVar("_Kind")


def parsed_lines(path: str | os.PathLike[str], parse: Callable[[bytes], _Kind]) -> Iterator[tuple[_Kind, str]]:
    """What `parse` makes of each line of a file that is not blank, and where it stands: ``looks.jsonl, line 3``.

    Raises `FormatError` for what `parse` refuses, with the file and the line, and for a file that cannot be read.
    """
    name = os.fspath(path)
    try:
        lines = read_file(path).removeprefix(b"\xef\xbb\xbf").split(b"\n")
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise FormatError(f"{name} cannot be read ({error}); give the path of a JSONL file") from error
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        where, hint = f"{name}, line {number}", ""
        try:
            yield parse(line), where
        except EagorError as error:
            if number == len(lines) and isinstance(error.__cause__, JSONDecodeError | UnicodeDecodeError):
                hint = ". The last line is incomplete: the writer was probably interrupted; remove the line"
            raise FormatError(f"{where}: {error}{hint}") from error


def object_of(line: str | bytes) -> dict[str, Any]:
    """The JSON object in a line."""
    try:
        entry = parsed(line.decode("utf-8") if isinstance(line, bytes) else line, strict=True)
    except ValueError as error:  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        raise FormatError(f"is not JSON ({error}); wanted one JSON object") from error
    require_field(isinstance(entry, dict), "the line", entry, "one JSON object")
    return entry


def checked(entry: Any, kind: type[_Kind], name: str, *, noted: bool = False) -> _Kind:
    """Parsed JSON as the structure `kind`, a `msgspec.Struct` or a dataclass, which errors call `name`.

    `noted`: keys that begin with ``_`` are notes, and null means absent, at any depth. Raises `FormatError`; a key that
    is not known is refused with the nearest that is.
    """
    bare = _without_notes(entry) if noted else entry
    try:
        return msgspec.convert(bare, kind)
    except UnicodeEncodeError as error:
        raise FormatError(f"{name} has a key that is no text ({error})") from error
    except msgspec.ValidationError as error:
        own = error.__cause__  # what the class in the structure says itself
        text = str(own) if isinstance(own, EagorError) else _fault(bare, kind, name, str(error))
        raise FormatError(text) from error


def _without_notes(entry: Any) -> Any:
    if isinstance(entry, dict):
        stated = {key: value for key, value in entry.items() if value is not None and not key.startswith("_")}
        return {key: _without_notes(value) for key, value in stated.items()}
    return [_without_notes(each) for each in entry] if isinstance(entry, list) else entry


def require_field(holds: bool, what: str, came: Any, wanted: str) -> None:
    """Raise `FormatError` unless it holds."""
    if not holds:
        raise FormatError(f"{what} {'is missing' if came is None else f'is {shown(came)}'}; wanted {wanted}")


def _fault(entry: Any, kind: type, name: str, error: str) -> str:
    """What came and what was wanted, from the text of msgspec, which tells the types and the place."""
    text, _, place = error.removesuffix("`").partition(" - at `$")
    for key, index in re.findall(r"\.(\w+)|\[(\d+)\]", place):
        entry = entry[key or int(index)]
    where = place.lstrip(".") or name
    match = re.match(r"Object (missing required|contains unknown) field `([^`]*)", text)
    if match is None:
        return f"{where} is {shown(entry)}; {text.replace('Expected', 'wanted', 1)}"
    what, key = match.groups()
    if what == "missing required":
        return f"{key} is missing in {where}"
    known = msgspec.json.schema(kind, schema_hook=lambda _: {}).get("$defs", {}).values()
    near = difflib.get_close_matches(key, {key for each in known for key in each.get("properties", ())}, 1, 0.5)
    return f"{key!r} is no key of {where}" + "".join(f"; did you mean {each}?" for each in near)
