"""What a run is made of besides its settings: the data, files and models that these name, and this code.

Digests of them stand in run.json, so that nobody goes on with a run after something below it has changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import zipfile
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import eagor
from eagor.errors import FormatError
from eagor.perception.transformers.account import revision_of

READ = (".json", ".jsonl", ".csv", ".tsv", ".txt")  # annotations: their content counts, of other files the size


def inputs_of(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Digests, by name: code, and what the settings data, perception, model and world name on this machine.

    Raises `FormatError` for what cannot be read.
    """
    found: dict[str, Any] = {"code": _code()}
    try:
        if settings.get("data"):
            found["data"] = _folder(Path(settings["data"]))
        for name in ("perception", "model", "world"):
            for part in re.split(r"[:?&=,]", str(settings.get(name) or "")):
                place = Path(part).expanduser()
                if part and (place / "config.json").is_file():
                    found[name] = revision_of(str(place), None)
                elif part and place.is_file():
                    found[name] = _digest([place.read_bytes()])
    except OSError as error:
        raise FormatError(f"{error.filename} cannot be read ({error.strerror}); a run goes by what it holds") from error
    return found


@lru_cache(maxsize=1)
def _code() -> str:
    """All of this package, weights included: its version alone does not tell one checkout from another."""
    home = Path(eagor.__file__).parent
    files = (path for path in sorted(home.rglob("*")) if path.is_file() and "__pycache__" not in path.parts)
    return _digest(part for path in files for part in (path.relative_to(home).as_posix().encode(), path.read_bytes()))


def _folder(data: Path) -> dict[str, Any]:
    """Of a folder (or one file): how many files, the content of annotations, names and sizes of all others."""
    annotations, others = [], []
    for path in _files(data) if data.is_dir() else [data]:
        name = path.relative_to(data).as_posix().encode("utf-8", "surrogateescape")
        if path.suffix.lower() in READ:
            annotations += [name, path.read_bytes()]
        else:
            others += [name, b"".join(_sizes(path))]
    count = (len(annotations) + len(others)) // 2
    return {"files": count, "annotations": _digest(annotations), "sizes": _digest(others)}


def _files(data: Path) -> Iterator[Path]:
    """What belongs to the data: no hidden files, and no runs that were put there."""
    for place, folders, names in os.walk(data):
        here = Path(place)
        if here != data and "run.json" in names:
            folders.clear()
            continue
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (here / name for name in sorted(names) if not name.startswith(".") and (here / name).is_file())


def _sizes(path: Path) -> Iterator[bytes]:
    if path.suffix.lower() == ".zip":
        try:
            with zipfile.ZipFile(path) as archive:
                yield from (f"{item.filename} {item.file_size} {item.CRC};".encode() for item in archive.infolist())
            return
        except (zipfile.BadZipFile, ValueError, NotImplementedError):
            pass  # whoever wants to read it will say what is wrong
    yield str(path.stat().st_size).encode()


def _digest(parts: Any) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(f"{len(part)}:".encode() + part)
    return digest.hexdigest()[:16]
