"""Carrying out a run: many units of work on one or several workers, each result kept the moment it is there.

What is recorded decides what is left to do. A unit that raises, or takes its process down, has had an attempt. What a
run is made of besides its settings (the data, files and models that these name, and this code) stands as digests in
run.json, so that nobody goes on with a run after something below it has changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import eagor
from eagor.errors import EagorError, FormatError
from eagor.evaluation import ledger
from eagor.evaluation.worker_pool import (
    Book,
    ProcessSeat,
    ThreadSeat,
    Unit,
    WorkError,
    attempt_unit,
    load,
    work_together,
)
from eagor.tasks.models import release

__all__ = ["Engine", "Outcome", "Unit", "WorkError", "carry_out", "run_units"]

Engine = Literal["processes", "threads", "ray"]
"""Who the workers of a run are."""
LEFT_OUT = {"__pycache__", "static"}  # the studio's page is built anew at times; it decides no result
READ = (".json", ".jsonl", ".csv", ".tsv", ".txt")  # annotations: their content counts, of other files the size


@dataclass(frozen=True)
class Outcome:
    """How many units were done now, have failed for good, and had been done before. Together: all that were asked."""

    done: int
    failed: int
    skipped: int


def run_units(
    units: Sequence[Unit],
    work: str,
    config: dict[str, Any],
    folder: Path,
    workers: int = 1,
    attempts: int = 2,
    on_done: Callable[[dict[str, Any]], object] | None = None,
    retry_failed: bool = False,
    engine: Engine = "processes",
    address: str | None = None,
) -> Outcome:
    """Do all of `units` that `folder` has no result of, and record each as soon as it ends.

    `work` is ``"package.module:function"``: ``function(config)`` is called once per process and returns a callable,
    payload -> dict; the dict becomes the record, together with key, attempt, status and seconds. One worker works in
    this process (a unit that kills it ends the run, and has had no attempt); several are new `engine`s: processes with
    one BLAS thread each, threads, or Ray actors on the cluster at `address`. A unit has so many `attempts`, earlier
    runs included; `retry_failed` gives as many again. `on_done` gets the record of each unit that is finished, without
    its "methods" and "truth".

    Raises `EagorError` for two units of one key or a number below 1; `WorkError` if `work` cannot be set up, or workers
    die before they have begun; `StorageError` if the disk does not take the results. `KeyboardInterrupt` is passed on
    after the workers have been stopped.
    """
    if workers < 1 or attempts < 1:
        raise EagorError(f"got {workers} workers and {attempts} attempts; wanted at least 1 of each")
    book = Book(units, Path(folder), config.get("task"), attempts, retry_failed, on_done)
    if book.left:
        with book.ledger:
            if engine == "ray":
                from eagor.evaluation.ray_workers import work_on_ray

                work_on_ray(book, work, config, workers, address)
            elif workers == 1:
                _alone(book, work, config)
            elif engine == "threads":
                do = load(work, config)  # which they share
                work_together(book, lambda: ThreadSeat(do, book), workers)
            else:
                work_together(book, lambda: ProcessSeat(book, work, config), workers)
    return Outcome(book.done, book.failed, book.skipped)


def carry_out(
    units: Sequence[Unit],
    work: str,
    config: dict[str, Any],
    folder: Path,
    workers: int = 1,
    engine: Engine = "processes",
    force: bool = False,
    **how: Any,
) -> Outcome:
    """A whole run: `run_units`, which `how` is for as well, into the folder of the run that `config` describes.

    What was made to check `config` (a perception, a model) is released before workers make their own, and after the
    run. Raises as `run_units` and `eagor.evaluation.ledger.begin`.
    """
    ledger.begin(folder, config, inputs_of(config), force)
    if engine == "ray" or (engine == "processes" and workers > 1):
        release()
    try:
        return run_units(units, work, config, folder, workers, engine=engine, **how)
    finally:
        release()


def _alone(book: Book, work: str, config: dict[str, Any]) -> None:
    """All units, one after the other, in this process."""
    do, group = load(work, config), None
    while (found := book.next(group, set())) is not None:
        unit, attempt = found
        group = unit.group
        book.ended(unit, attempt_unit(do, unit, attempt, book.task, book.ledger))


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
    from eagor.tasks.episodes import listed_slots, scene_files

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
