"""Saving dataclasses with arrays to a file, without pickle: loading a file never runs code.

A file has three parts: a line of JSON with kind, version, length and digest; a line of JSON with the structure, in
which arrays and dataclasses are numbers; and the bytes of the arrays. Only dataclasses of the packages named here can
be saved. Loading calls their constructors, which check the fields, and sets their `given` values. An object in two
places is saved once.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._files import open_regular, written
from eagor._values import state_of
from eagor.errors import FormatError

VERSION = 7
FORMAT = "eagor tracker"
LONGEST = 1000  # bytes of the first line
# Only dataclasses of these, and of their modules, may be in a file.
PACKAGES = ("eagor.belief", "eagor.evidence", "eagor.cameras", "eagor.grids", "eagor.tracking")


def packed(value: Any) -> bytes:
    """`value` as bytes, exactly; `unpacked` gives it back. Raises `FormatError` for what cannot be saved."""
    writer = _Writer()
    found = writer.put(value)
    kinds = [{"dtype": array.dtype.str, "shape": array.shape} for array in writer.arrays]
    text = json.dumps({"arrays": kinds, "nodes": writer.nodes, "state": found}, separators=(",", ":"))
    return b"".join([text.encode(), b"\n", *(array.tobytes() for array in writer.arrays)])


def unpacked(content: bytes) -> Any:
    """The value that `packed` turned into bytes; no code in them is run. Raises `FormatError`."""
    text, _, data = content.partition(b"\n")
    try:
        return _Reader(json.loads(text), data).state
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ImportError, RecursionError) as error:
        raise FormatError(f"these bytes were packed by another version of eagor, or are damaged: {error}") from error


def save(path: Path, state: Any) -> Path:
    """Write `state` to `path`, whole or not at all. Raises `FormatError` for what cannot be saved, `StorageError`."""
    body = packed(state)
    head = {"format": FORMAT, "version": VERSION, "bytes": len(body), "sha256": hashlib.sha256(body).hexdigest()}
    return written(path, json.dumps(head).encode() + b"\n" + body)


def load(path: Path) -> Any:
    """What `save` wrote to `path`. Raises `FormatError` for any other file, one of another version, or a torn one."""
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            first = file.readline(LONGEST)
            body = file.read() if first.startswith(b"{") else b""
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read ({error.strerror or error}); wanted a file of tracker.save"
        ) from error
    try:
        head = json.loads(first)
        known = head["format"] == FORMAT
        version = head["version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        head, known, version = {}, False, None
    if not known:
        raise FormatError(f"{path} is not a saved tracker; wanted a file of tracker.save")
    if version != VERSION:
        raise FormatError(f"{path} is of version {version!r}; wanted {VERSION}: load it with the eagor that saved it")
    if head.get("bytes") != len(body) or head.get("sha256") != hashlib.sha256(body).hexdigest():
        raise FormatError(f"{path} is damaged: {len(body)} bytes, not the ones that were saved. Save it again")
    try:
        return unpacked(body)
    except FormatError as error:
        why = error.__cause__
        raise FormatError(f"{path} was saved by another version of eagor: {why}. Load it with that one") from error


def _is_ours(module: str) -> bool:
    return any(f"{module}.".startswith(f"{package}.") for package in PACKAGES)


class _Writer:
    """Turns values into JSON, arrays and dataclasses into places in lists."""

    def __init__(self) -> None:
        self.arrays: list[np.ndarray] = []
        self.nodes: list[list[Any]] = []
        self._places: dict[int, list[Any]] = {}

    def put(self, value: Any) -> Any:
        """`value` as JSON: itself, or its kind and content."""
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, bytes):
            return ["bytes", value.hex()]
        if isinstance(value, tuple | list):
            return ["tuple" if isinstance(value, tuple) else "list", [self.put(each) for each in value]]
        if isinstance(value, Mapping):
            return ["dict", [[self.put(key), self.put(each)] for key, each in value.items()]]
        if id(value) not in self._places:
            self._places[id(value)] = self._added(value)
        return self._places[id(value)]

    def _added(self, value: Any) -> list[Any]:
        kind = type(value)
        if is_dataclass(value) and _is_ours(kind.__module__):
            found = {each.name: getattr(value, each.name) for each in fields(value)}
            found |= state_of(value) if hasattr(value, "__dict__") else {}
            self.nodes.append(
                [kind.__module__, kind.__qualname__, {key: self.put(each) for key, each in found.items()}]
            )
            return ["node", len(self.nodes) - 1]
        array = to_numpy(value) if hasattr(value, "shape") else np.empty(0, dtype=object)
        if array.dtype.kind not in "biufc":
            raise FormatError(
                f"a {kind.__module__}.{kind.__qualname__} cannot be saved; wanted numbers, text or arrays"
            )
        self.arrays.append(array)
        return ["array", len(self.arrays) - 1]


class _Reader:
    """Turns the JSON back into values."""

    def __init__(self, found: dict[str, Any], data: bytes) -> None:
        self.arrays: list[np.ndarray] = []
        start = 0
        for each in found["arrays"]:
            dtype, shape = np.dtype(each["dtype"]), tuple(each["shape"])
            if dtype.kind not in "biufc":
                raise ValueError(f"an array of {dtype}")
            count = math.prod(shape)
            self.arrays.append(np.frombuffer(data, dtype, count, start).reshape(shape).copy())
            start += count * dtype.itemsize
        self.nodes: list[Any] = []
        for module, name, values in found["nodes"]:
            self.nodes.append(self._made(module, name, {key: self.get(each) for key, each in values.items()}))
        self.state = self.get(found["state"])

    def get(self, value: Any) -> Any:
        """The value that the JSON `value` stands for."""
        if not isinstance(value, list):
            return value
        kind, inner = value
        if kind in ("array", "node"):
            return (self.arrays if kind == "array" else self.nodes)[inner]
        if kind == "bytes":
            return bytes.fromhex(inner)
        if kind == "dict":
            return {self.get(key): self.get(each) for key, each in inner}
        found = [self.get(each) for each in inner]
        return tuple(found) if kind == "tuple" else found

    @staticmethod
    def _made(module: str, name: str, values: dict[str, Any]) -> Any:
        if not _is_ours(module):
            raise ValueError(f"{module} is not saved")
        kind = getattr(import_module(module), name)
        if not is_dataclass(kind) or not isinstance(kind, type):
            raise ValueError(f"{module}.{name} is not saved")
        names = {each.name for each in fields(kind)}
        more = {key: values.pop(key) for key in [*values] if key not in names}
        if names != values.keys() or not all(hasattr(kind, key) for key in more):
            raise ValueError(f"{module}.{name} has other fields")
        made = kind(**values)
        if more:
            made.__dict__.update(more)
        return made
