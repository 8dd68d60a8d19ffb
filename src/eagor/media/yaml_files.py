"""YAML files of numbers, read node by node: errors name the line, the entry, what is there and what was wanted.

OpenCV's FileStorage writes YAML, too, with a first line and tags of its own; they are read.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

from eagor._extras import need
from eagor._files import read_file
from eagor.errors import FormatError

__all__ = ["Place", "read_yaml"]

LARGEST = 1 << 20  # bytes: a calibration has a few hundred


def read_yaml(path: str | os.PathLike[str], kind: str, wanted: str) -> Place:
    """The root of the YAML file at `path`, a file of this `kind` with what is `wanted`. Raises `FormatError`."""
    need("reading a calibration (YAML)", "photos", "yaml")
    import yaml

    name = os.fspath(path)
    try:
        if os.path.getsize(name) > LARGEST:
            raise FormatError(f"{name} is larger than {LARGEST} bytes; wanted {wanted}")
        text = read_file(name).decode("utf-8-sig")
        if text.startswith("%YAML"):  # OpenCV writes "%YAML:1.0", which YAML does not allow; the line stays counted
            text = "#" + text
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise FormatError(f"{name} cannot be read as {kind} ({why}); give a YAML file with {wanted}") from error
    except yaml.YAMLError as error:
        raise FormatError(f"{name} is not YAML ({' '.join(str(error).split())}); wanted {wanted}") from error
    if root is None:
        raise FormatError(f"{name} is empty; wanted {wanted}")
    return Place(root, "")


class Place:
    """A node of a file, of PyYAML: reads it as what is wanted, or raises `FormatError` with its line."""

    def __init__(self, node: Any, path: str) -> None:
        self.node, self.path = node, path

    def wrong(self, wanted: str) -> FormatError:
        return FormatError(f"line {self.node.start_mark.line + 1}: {self.path or 'the file'} {wanted}")

    def mapping(self, keys: Sequence[str] | None = None) -> dict[str, Place]:
        """The entries; only `keys` are allowed."""
        if self.node.id != "mapping":
            raise self.wrong(f"is {self._what()}; wanted names with values" + (f": {', '.join(keys)}" if keys else ""))
        found: dict[str, Place] = {}
        for key, value in self.node.value:
            name = str(key.value)
            place = Place(value, f"{self.path}.{name}" if self.path else name)
            line = key.start_mark.line + 1
            if name in found:
                raise FormatError(f"line {line}: {place.path} is there twice")
            if keys is not None and name not in keys:
                near = get_close_matches(name, keys, 1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise FormatError(f"line {line}: {place.path} is no key here{hint} Wanted: {', '.join(keys)}")
            found[name] = place
        return found

    def items(self, wanted: str) -> list[Place]:
        """The members of a list."""
        if self.node.id != "sequence":
            raise self.wrong(f"is {self._what()}; wanted {wanted}")
        return [Place(each, f"{self.path}[{index}]") for index, each in enumerate(self.node.value)]

    def number(self, wanted: str = "a number", whole: bool = False) -> float:
        try:
            if self.node.id != "scalar" or "_" in self.node.value:
                raise ValueError
            value = float(self.node.value)
        except ValueError:
            raise self.wrong(f"is {self._what()}; wanted {wanted}") from None
        if not math.isfinite(value) or (whole and value != int(value)):
            raise self.wrong(f"is {self._what()}; wanted {wanted}")
        return value

    def numbers(self, least: int, most: int, wanted: str) -> tuple[float, ...]:
        found = self.items(wanted)
        if not least <= len(found) <= most:
            raise self.wrong(f"has {len(found)} members; wanted {wanted}")
        return tuple(each.number() for each in found)

    def text(self) -> str:
        if self.node.id != "scalar":
            raise self.wrong(f"is {self._what()}; wanted a text")
        return str(self.node.value)

    def _what(self) -> str:
        value = self.node.value
        if isinstance(value, str):
            return repr(value if len(value) < 60 else value[:57] + "...")
        return "a list" if self.node.tag.endswith("seq") else "names with values"
