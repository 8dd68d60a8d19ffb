"""The ledger of a run: a folder of text files that survives a kill at any moment.

``run.json`` says what is run. Each process appends to a ``worker-<k>.jsonl`` of its own, a JSON object per line, which
is on the disk (fsync) before the next unit begins. A record has "key", "attempt" (1, 2, ...) and "status" ("ok",
"failed").
"""

from __future__ import annotations

import errno
import json
import math
import os
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import parsed
from eagor._files import claimed, open_regular, redacted, written
from eagor.errors import EagorError, FormatError, StorageError

try:
    import fcntl
except ImportError:  # not a POSIX system: there is no lock, so numbers are only as good as the caller's
    fcntl = None

RUN = "run.json"
WORKER = "worker-{}.jsonl"
INPUTS, RESUMED = "inputs", "resumed"  # in run.json, beside the settings
# Settings that may become larger, as what is recorded stays a part of the run, and those that follow from them.
GROWS = {"episodes": ("development",)}


class Ledger:
    """Appends records to the first ``worker-<k>.jsonl`` of `folder` that no other process holds, k = `first`, ...

    The file is taken at the first `append`, or by `open`; `path` is None until then. Several threads may append.
    """

    def __init__(self, folder: Path, first: int = 0) -> None:
        self.path: Path | None = None
        self._folder, self._first, self._file = Path(folder), first, -1
        self._appending = threading.Lock()

    def append(self, record: Mapping[str, Any]) -> None:
        """Write one record and wait until it is on the disk.

        Raises `EagorError` for what JSON cannot hold; `StorageError` if the disk is full or fails: the file ends as
        before.
        """
        line = as_line(record)
        with self._appending:
            path = self.open()
            try:
                end = os.lseek(self._file, 0, os.SEEK_END)
                try:
                    _write(self._file, line)
                    os.fsync(self._file)
                except OSError:
                    os.ftruncate(self._file, end)  # half a line would spoil the next one
                    raise
            except OSError as error:
                raise StorageError(
                    f"could not keep the record {record.get('key')!r} ({len(line)} bytes) in {path}: "
                    f"{error.strerror or error}; everything recorded before it is safe. Make room, then start the same "
                    "run again: it goes on where it stopped"
                ) from error

    def open(self) -> Path:
        """Take hold of the file, if that has not been done, and return its path. Raises `StorageError`."""
        if self.path is not None and self._file >= 0:
            return self.path
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._file, self.path = _first_free(self._folder, self._first)
            try:
                _mend(self._file)
                _keep_name(self._folder)
            except OSError:
                self.close()
                raise
        except OSError as error:
            raise StorageError(
                f"cannot write in {self._folder}: {error.strerror or error}; everything recorded there is safe. Make "
                "room there and let it be written to, then start the same run again; or choose another folder"
            ) from error
        return self.path

    def close(self) -> None:
        """Let go of the file; the next `append` opens one again."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def begin(
    folder: Path, config: Mapping[str, Any], inputs: Mapping[str, Any] | None = None, force: bool = False
) -> None:
    """Make `folder` the folder of the run that `config` describes, or make sure that it already is.

    `inputs` are digests of what the run is made of (`eagor.evaluation.workers`). Where they have changed since, the run
    goes on only if forced: then it warns, and ``run.json`` says under "resumed" what has changed. A setting of `GROWS`
    may be larger than in the folder, and is then written there.

    Raises `EagorError` if the folder holds another run or one of other inputs (the text lists what differs), or can be
    none; `FormatError` if its ``run.json`` is no JSON object; `StorageError`.
    """
    wanted = json.loads(as_line({**config, INPUTS: inputs} if inputs else config))
    path = Path(folder) / RUN
    if not path.exists():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
                raise StorageError(f"could not make {folder}: {error.strerror}; choose another folder") from error
            raise EagorError(f"{folder} cannot be made a folder ({error.strerror or error}); choose another") from error
        if claimed(path, _text(wanted)):
            try:
                _keep_name(path.parent)
            except OSError as error:
                raise StorageError(
                    f"could not write {path}: {error.strerror or error}; choose another folder"
                ) from error
            return
    with _alone(path.parent):
        _go_on(folder, wanted, inputs, force)


def _go_on(folder: Path, wanted: dict[str, Any], inputs: Mapping[str, Any] | None, force: bool) -> None:
    """Make sure that `folder` holds the run that is wanted, or fewer units of it."""
    path, found = Path(folder) / RUN, description(folder)
    (resumed, before), (_, now) = ((each.pop(RESUMED, []), each.pop(INPUTS, {})) for each in (found, wanted))
    grown = {key for key in GROWS if _more(found.get(key), wanted.get(key))}
    found |= {each: wanted[each] for key in grown for each in (key, *GROWS[key]) if each in wanted}
    if differences := _shown(_differences(found, wanted)):
        raise EagorError(
            f"{folder} holds another run: {differences}. Ask for what it holds to go on with it, or choose another "
            "folder"
        )
    if inputs and (changed := _shown(_differences(before, now, INPUTS))):
        if not force:
            raise EagorError(
                f"{folder} holds a run that was made of something else: {changed}. Restore what has changed, choose "
                "another folder, or go on all the same with --force"
            )
        warnings.warn(f"{folder} goes on with changed inputs: {changed}", stacklevel=3)
        before, resumed = now, [*resumed, changed]
    elif not grown:
        return
    written(path, _text({**wanted, **({INPUTS: before} if before else {}), **({RESUMED: resumed} if resumed else {})}))


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the folder, so that no other process changes its description at the same time; where there are locks."""
    if fcntl is None:
        yield
        return
    try:
        place = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise FormatError(f"{folder} cannot be read ({error.strerror or error}); name the folder of a run") from None
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(place, fcntl.LOCK_EX)
        yield
    finally:
        os.close(place)


def description(folder: Path) -> dict[str, Any]:
    """What ``run.json`` says. Raises `FormatError` where there is none, or it is no JSON object."""
    path = Path(folder) / RUN
    try:
        with open(open_regular(path), "rb") as file:
            found = parsed(file.read())
    except FileNotFoundError:
        raise FormatError(f"{folder} has no {RUN}; name the folder of a run") from None
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror or error}); name the folder of a run") from None
    except ValueError as error:
        raise FormatError(f"{path} is no JSON ({error}); restore it, or start the run in another folder") from None
    if not isinstance(found, dict):
        raise FormatError(f"{path} holds no JSON object but {type(found).__name__}; name the folder of a run")
    return found


def read(folder: Path) -> list[dict[str, Any]]:
    """The records of a run, one per key, in the order of their keys.

    Of several with one key one that is ok counts first, then the highest attempt, then the last. A last line that a
    kill left half written is left out. Raises `FormatError` for any other line that is no record; names the file and
    the line.
    """
    found: dict[str, dict[str, Any]] = {}
    ranks: dict[str, tuple[bool, int]] = {}
    for path in files(folder):
        for record in records(path):
            rank = record["status"] == "ok", record["attempt"]
            if rank >= ranks.get(record["key"], (False, 0)):
                found[record["key"]], ranks[record["key"]] = record, rank
    return [found[key] for key in sorted(found)]


def recorded(folder: Path) -> list[dict[str, Any]]:
    """`read`, of a run that must have records. Raises `EagorError` as well where it has none."""
    if found := read(folder):
        return found
    raise EagorError(f"{folder} has no records yet; run something into it first")


def files(folder: Path) -> list[Path]:
    """The ``worker-<k>.jsonl`` of a run, by k."""
    named = [(path.stem.removeprefix("worker-"), path) for path in Path(folder).glob(WORKER.format("*"))]
    return [path for _, path in sorted((int(number), path) for number, path in named if number.isdecimal())]


def records(path: Path) -> Iterator[dict[str, Any]]:
    """The records of one file, in the order in which they were written; see `read`."""
    try:
        with open(open_regular(path), "rb") as file:
            data = file.read()
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror or error}); restore it, or let it be read") from None
    lines = data.split(b"\n")
    torn = lines.pop()  # empty, if the last line is whole
    for number, line in enumerate(lines, start=1):
        yield _record(line, path, number)
    if _is_json(torn):  # somebody's editor left out the last newline
        yield _record(torn, path, len(lines) + 1)


def as_line(record: Mapping[str, Any]) -> bytes:
    """`record` as one line of JSON with its newline; NumPy numbers and arrays become plain ones, secrets stars.

    Raises `EagorError`, which names the place, for NaN, infinity, and what JSON does not know.
    """
    name = str(record.get("key", "record"))
    text = json.dumps(_plain(record, name), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    text = redacted(text) + "\n"
    return text.encode("utf-8", "backslashreplace")  # half a pair of surrogates is written as JSON escapes it


def _plain(value: Any, place: str) -> Any:
    """`value` in Python's own types, checked."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        raise EagorError(f"{place} is {value}; a record holds finite numbers, and null where there is no case")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Mapping):
        if strange := [key for key in value if not isinstance(key, str)]:
            raise EagorError(f"{place} has the key {strange[0]!r}; wanted text, which is all that JSON can hold there")
        return {key: _plain(item, f"{place}: {key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{place}[{index}]") for index, item in enumerate(value)]
    raise EagorError(
        f"{place} is a {type(value).__name__}, which JSON cannot hold; store numbers, text or lists of them"
    )


def _text(found: Mapping[str, Any]) -> str:
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


def _shown(differences: Iterable[str]) -> str:
    listed = list(differences)
    return "; ".join(listed[:8]) + ("; ..." if len(listed) > 8 else "")


def _write(file: int, data: bytes) -> None:
    """All of `data`; a disk that fills up takes part of it first, and fails at the next call."""
    while data:
        data = data[os.write(file, data) :]


def _first_free(folder: Path, number: int) -> tuple[int, Path]:
    """The first worker file from `number` on that nobody holds, open and held until it is closed."""
    while True:
        path = folder / WORKER.format(number)
        file = open_regular(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            number += 1
            continue
        except OSError:
            pass  # a file system without locks
        return file, path


def _mend(file: int) -> None:
    """Bring the end of `file` to the end of a whole line: what comes next must begin on a line of its own."""
    size = os.lseek(file, 0, os.SEEK_END)
    tail = b""
    while len(tail) < size and b"\n" not in tail:
        begin = max(0, size - len(tail) - (1 << 16))
        os.lseek(file, begin, os.SEEK_SET)
        tail = os.read(file, size - len(tail) - begin) + tail
    torn = tail[tail.rfind(b"\n") + 1 :]
    if _is_json(torn):
        _write(file, b"\n")
    elif torn:
        os.ftruncate(file, size - len(torn))


def _keep_name(folder: Path) -> None:
    """Have the disk remember which files the folder has."""
    if os.name != "posix":
        return
    place = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)


def _is_json(line: bytes) -> bool:
    try:
        parsed(line)
    except ValueError:
        return False
    return True


def _record(line: bytes, path: Path, number: int) -> dict[str, Any]:
    try:
        found = parsed(line)
    except ValueError as error:
        raise FormatError(f"{path}, line {number}: no JSON ({error}); restore the line, or delete it") from None
    whole = isinstance(found, dict) and isinstance(found.get("key"), str) and type(found.get("attempt")) is int
    if not whole or found["attempt"] < 1 or found.get("status") not in ("ok", "failed"):
        raise FormatError(
            f"{path}, line {number}: no record; wanted an object with key (text), attempt (1, 2, ...) and status "
            "('ok' or 'failed'). Restore the line, or delete it"
        )
    return found


def _differences(found: Any, wanted: Any, place: str = "") -> Iterator[str]:
    """Where two descriptions differ, in words."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in dict.fromkeys([*found, *wanted]):
            inner = f"{place}.{_cut(key)}".replace('"', "").lstrip(".")
            if key not in wanted:
                yield f"{inner} is {_cut(found[key])} there and nothing was asked for"
            elif key not in found:
                yield f"{inner} is not set there and {_cut(wanted[key])} was asked for"
            else:
                yield from _differences(found[key], wanted[key], inner)
    elif found != wanted:
        more = " (a run can get more, not fewer)" if place in GROWS and _more(wanted, found) else ""
        yield f"{place} is {_cut(found)} there and {_cut(wanted)} was asked for{more}"


def _more(old: Any, new: Any) -> bool:
    """Whether both are whole numbers, and the second is larger."""
    return type(old) is int and type(new) is int and new > old


def _cut(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
