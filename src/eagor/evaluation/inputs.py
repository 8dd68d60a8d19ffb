"""What a run is made of besides its settings: the data, files and models that these name, and this code.

Digests of them stand in run.json, so that nobody goes on with a run after something below it has changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import eagor
from eagor.errors import FormatError

LEFT_OUT = {"__pycache__", "static"}  # the studio's page is built anew at times; it decides no result
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
            if places := list(_places(str(settings.get(name) or ""))):
                found[name] = " ".join(_contents(place) if place.is_dir() else _digest([place]) for place in places)
        if settings.get("episodes_file"):
            found |= _episodes(Path(settings["episodes_file"]), settings)
    except OSError as error:
        raise FormatError(f"{error.filename} cannot be read ({error.strerror}); a run goes by what it holds") from error
    return found


def _episodes(file: Path, settings: Mapping[str, Any]) -> dict[str, str]:
    """Of the files that list episodes their content, of the scenes (gigabytes) names and sizes."""
    from eagor.tasks.episode_files import listed_slots, scene_files

    scenes = Path(settings["scenes"]) if settings.get("scenes") else None
    slots = listed_slots(settings["task"], file, None, settings["world"], scenes)
    parts = [file, *sorted((file.parent / "content").glob("*.json.gz"))]
    there = [path for path in scene_files(slots) if path.is_file()]
    found = {"episodes_file": _digest(part for path in parts for part in (path.name.encode(), path))}
    if there:
        found["scenes"] = _digest(part for path in there for part in (path.name.encode(), *_sizes(path)))
    return found


def _places(text: str) -> Iterator[Path]:
    """The files and model folders that stand in an option such as ``replay:FILE`` or ``FOLDER?heads=FILE``.

    Their names may have in them what separates the parts of options: the longest that is there counts.
    """
    ends = [mark.start() for mark in re.finditer("[:?&=,@]", text)] + [len(text)]
    start = 0
    while start < len(text):
        for end in reversed([each for each in ends if each > start]):
            place = os.path.expanduser(text[start:end])
            if os.path.isfile(place) or os.path.isfile(os.path.join(place, "config.json")):
                yield Path(place)
                break
        else:
            end = min(each for each in ends if each >= start)
        start = end + 1


@lru_cache(maxsize=1)
def _code() -> str:
    """All of this package, weights included: its version alone does not tell one checkout from another."""
    home = Path(eagor.__file__).parent
    files = (
        path for path in sorted(home.rglob("*")) if path.is_file() and not LEFT_OUT & {*path.relative_to(home).parts}
    )
    return _digest(part for path in files for part in (_name(path, home), path))


def _contents(model: Path) -> str:
    """All of a model's folder, each byte of its weights: this may read gigabytes, once a run."""
    return _digest(part for path in _files(model) for part in (_name(path, model), path))


def _folder(data: Path) -> dict[str, Any]:
    """Of a folder (or one file): how many files, the content of annotations, names and sizes of all others."""
    annotations: list[bytes | Path] = []
    others: list[bytes | Path] = []
    for path in _files(data) if data.is_dir() else [data]:
        name = _name(path, data)
        if path.suffix.lower() in READ:
            annotations += [name, path]
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


def _name(path: Path, home: Path) -> bytes:
    return path.relative_to(home).as_posix().encode("utf-8", "surrogateescape")


def _digest(parts: Iterable[bytes | Path]) -> str:
    """Of bytes and of what files hold, which is read a piece at a time."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bytes):
            digest.update(f"{len(part)}:".encode() + part)
            continue
        with part.open("rb") as file:
            digest.update(f"{part.stat().st_size}:".encode())
            hashlib.file_digest(file, lambda: digest)
    return digest.hexdigest()[:16]
