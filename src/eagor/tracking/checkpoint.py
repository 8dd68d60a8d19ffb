"""Saving dataclasses with arrays to a file of NumPy (npz), without pickle: loading a file never runs code.

One entry, or without arrays the whole, is JSON, in which {"tuple": [...]} stands for a tuple and {"array": 3} for the
entry arr_3, the fourth array.
Only dataclasses of the packages named here can be saved. Loading calls their constructors, which check the fields, and
sets their `given` values. An object in two places is saved once.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from eagor._arrays import to_numpy
from eagor._files import read_file, write_atomic
from eagor._values import state_of
from eagor.errors import FormatError

STRUCTURE = "eagor 8"  # the name of that entry, a new one when the same names mean something else
PACKAGES = ("eagor.belief.", "eagor.evidence.", "eagor.cameras.", "eagor.grids.", "eagor.tracking.")


def packed(value: Any) -> bytes:
    """`value` as bytes, exactly; `unpacked` gives it back. Raises `FormatError` for what cannot be saved."""
    arrays: list[np.ndarray] = []
    places: dict[int, dict[str, int]] = {}  # of dataclasses and arrays

    def put(each: Any) -> Any:
        each = each.item() if isinstance(each, np.generic) else each
        if each is None or isinstance(each, bool | int | float | str):
            return each
        if isinstance(each, list):
            return [put(one) for one in each]
        if isinstance(each, tuple):
            return {"tuple": put([*each])}
        if isinstance(each, Mapping):
            return {"dict": put([[*item] for item in each.items()])}
        if isinstance(each, bytes):
            return {"bytes": each.hex()}
        if id(each) in places:
            return places[id(each)]
        kind = type(each)
        if is_dataclass(each) and f"{kind.__module__}.".startswith(PACKAGES):
            names = [field.name for field in fields(each)]
            values = state_of(each) if hasattr(each, "__dict__") else {name: getattr(each, name) for name in names}
            new = {"new": [kind.__module__, kind.__qualname__, put(values)]}
            places[id(each)] = {"made": len(places) - len(arrays)}
            return new
        array = to_numpy(each) if hasattr(each, "shape") else np.array(None)
        if array.dtype.kind not in "biufc":
            raise FormatError(f"a {kind.__module__}.{kind.__qualname__} cannot be saved; wanted numbers, text, arrays")
        places[id(each)] = {"array": len(arrays)}
        arrays.append(array)
        return places[id(each)]

    text = json.dumps(put(value)).encode()
    if not arrays:
        return text
    file = io.BytesIO()
    np.savez(file, *arrays, **{STRUCTURE: np.frombuffer(text, np.uint8)})  # type: ignore[arg-type]
    return file.getvalue()


def unpacked(content: bytes) -> Any:
    """The value that `packed` turned into bytes; no code in them is run. Raises `FormatError`."""
    made: list[Any] = []

    def get(found: dict[str, Any]) -> Any:
        ((kind, inner),) = found.items()
        if kind != "new":
            return kinds[kind](inner)
        made.append(_made(*inner))
        return made[-1]

    try:
        arrays, text = [], content
        if content.startswith(b"PK"):
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                arrays = [file[f"arr_{number}"] for number in range(len(file.files) - 1)]
                text = file[STRUCTURE].tobytes()
        kinds: dict[str, Callable[[Any], Any]] = {"tuple": tuple, "dict": dict, "bytes": bytes.fromhex}
        kinds |= {"array": arrays.__getitem__, "made": made.__getitem__}
        return json.loads(text, object_hook=get)
    except Exception as error:  # of zipfile, zlib, NumPy or JSON, or of a constructor
        raise FormatError(f"these bytes were packed by another version of eagor, or are damaged: {error}") from error


def _made(module: str, name: str, values: dict[str, Any]) -> Any:
    kind: Any = getattr(import_module(module), name) if f"{module}.".startswith(PACKAGES) else None
    made = kind(**{each.name: values.pop(each.name) for each in fields(kind)})  # an error for all but dataclasses
    if not all(hasattr(kind, key) for key in values):
        raise ValueError(f"{module}.{name} has other fields")
    if values:
        made.__dict__.update(values)
    return made


def save(path: Path, state: Any) -> Path:
    """Write `state` to `path`, whole or not at all. Raises `FormatError` for what cannot be saved, `StorageError`."""
    return write_atomic(path, packed(state))


def load(path: Path) -> Any:
    """What `save` wrote to `path`. Raises `FormatError` for any other file, one of another version, or a torn one."""
    try:
        return unpacked(read_file(path))
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); wanted a file of tracker.save") from error
    except FormatError as error:
        raise FormatError(
            f"{path} is not a whole tracker of this version of eagor ({error.__cause__}); wanted a file of "
            "tracker.save. Load it with the version that saved it, or save it again"
        ) from error
