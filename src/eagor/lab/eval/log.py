"""The log of a run: a folder with ``run.json``, which says what is run, and ``records.jsonl``, a JSON object per line.

One process writes at a time. A record is on the disk (fsync) before its unit counts as done, so a kill at any moment
loses nothing that was finished; a last line that it left half written is dropped. A record has "key", "attempt" (1, 2,
...) and "status" ("ok", "failed").
"""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import stat
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

import eagor
from eagor._checks import parsed
from eagor._files import append_all, redacted, written
from eagor.errors import EagorError, FormatError, StorageError

RUN, RECORDS = "run.json", "records.jsonl"
# In run.json, for readers only: of which code and samples the first records are, and how many were asked for so far.
INFORMATION = ("commit", "samples", "versions", "development", "episodes")
LONGEST = 1 << 28  # bytes: no record is as long


class AnotherRunError(EagorError):
    """A folder holds another run than the one that was to begin in it; `lines` say so one by one."""

    def __init__(self, *lines: str) -> None:
        super().__init__("; ".join(lines))
        self.lines = lines


class _Head(msgspec.Struct):
    """What every record has."""

    key: str
    attempt: Annotated[int, msgspec.Meta(ge=1)]
    status: Literal["ok", "failed"]


class Log:
    """Appends records to ``records.jsonl`` in `folder`, which it makes.

    Raises `EagorError` where another process is writing there, or a folder cannot be; `StorageError`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path, self._file = Path(folder), Path(folder) / RECORDS, -1
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._file = _regular(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                why = f"another process is writing into {folder}; wait for it, or choose another folder"
                raise EagorError(why) from None
            except OSError:
                pass  # a file system without locks
            # What comes next must begin on a line of its own.
            size = os.lseek(self._file, 0, os.SEEK_END)
            torn = os.pread(self._file, LONGEST, max(0, size - LONGEST)).rpartition(b"\n")[2]
            if _parsed(torn) is not None:  # somebody's editor left out the last newline
                append_all(self._file, b"\n")
            else:
                os.ftruncate(self._file, size - len(torn))
        except (OSError, EagorError) as error:
            if self._file >= 0:
                os.close(self._file)
            if isinstance(error, FileExistsError | NotADirectoryError):
                raise EagorError(f"{folder} cannot be made a folder ({error.strerror}); choose another") from error
            if isinstance(error, EagorError):
                raise
            raise StorageError(
                f"cannot write in {folder}: {error.strerror or error}; everything recorded there is safe. Make room "
                "there and let it be written to, then start the same run again; or choose another folder"
            ) from error

    def begin(self, config: Mapping[str, Any], samples: Mapping[str, Any] | None = None) -> None:
        """Make the folder that of the run which `config` describes, or make sure that it already is.

        What `INFORMATION` names (the commit of this package and the `samples` among it) may differ. Raises `EagorError`
        if the folder holds another run; `FormatError` if its ``run.json`` is no JSON object; `StorageError`.
        """
        wanted, path = json.loads(as_line({**config, "commit": commit(), "samples": samples})), self.folder / RUN
        found = description(self.folder) if os.path.lexists(path) else wanted
        settings = [key for key in {**found, **wanted} if key not in INFORMATION]
        if differing := [key for key in settings if found.get(key) != wanted.get(key)]:
            more = f" and {len(differing) - 4} more" if len(differing) > 4 else ""
            raise AnotherRunError(
                f"{self.folder} holds another run, of {found.get('task')}",
                f"it differs in {', '.join(differing[:4])}{more} ({path} has its settings)",
                "choose another folder, or ask for what it holds to go on with it",
            )
        if wanted.get("episodes", 0) > found.get("episodes", 0):
            found = {**found, **{key: wanted[key] for key in ("samples", "episodes", "development")}}
        elif path.exists():
            return
        written(path, json.dumps(found, indent=1, ensure_ascii=False) + "\n")

    def append(self, record: Mapping[str, Any]) -> None:
        """Write one record and wait until it is on the disk.

        Raises `EagorError` for what JSON cannot hold; `StorageError` if the disk is full or fails: the file ends as
        before.
        """
        line = as_line(record)
        try:
            if not os.fstat(self._file).st_nlink:
                raise OSError(errno.ENOENT, "somebody has removed the file")
            append_all(self._file, line, sync=True)
        except OSError as error:
            raise StorageError(
                f"could not keep the record {record.get('key')!r} ({len(line)} bytes) in {self.path}: "
                f"{error.strerror or error}; everything recorded before it is safe. Make room, then start the same run "
                "again: it goes on where it stopped"
            ) from error

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)


def commit() -> str | None:
    """The commit of this package, where it lies in a git checkout; "+" follows it where files have changed since."""
    git = ["git", "-C", str(Path(eagor.__file__).parent)]
    try:
        tracked = subprocess.run([*git, "ls-files", "--error-unmatch", "errors.py"], capture_output=True)
        words = ["describe", "--always", "--dirty=+", "--exclude=*", "--abbrev=12"]
        found = subprocess.run([*git, *words], capture_output=True, text=True)
    except OSError:  # no git here
        return None
    return found.stdout.strip() or None if tracked.returncode == 0 else None


def description(folder: Path) -> dict[str, Any]:
    """What ``run.json`` says. Raises `FormatError` where there is none, or it is no JSON object."""
    path = Path(folder) / RUN
    if (content := _content(path, "name the folder of a run")) is None:
        raise FormatError(f"{folder} has no {RUN}; name the folder of a run")
    try:
        return msgspec.convert(parsed(content), dict[str, Any])
    except (ValueError, msgspec.ValidationError) as error:
        raise FormatError(
            f"{path} is no JSON object ({error}); restore it, or start the run in another folder"
        ) from None


def read(folder: Path) -> list[dict[str, Any]]:
    """The records of a run, one per key, in the order of their keys.

    Of several with one key one that is ok counts first, then the highest attempt, then the last. Raises `FormatError`
    for a line that is no record, but for a last one that a kill left half written; names the file and the line.
    """
    path = Path(folder) / RECORDS
    lines = (_content(path, "restore it, or let it be read") or b"").split(b"\n")
    found: dict[str, Any] = {}
    for number, line in enumerate(lines, start=1):
        record = _parsed(line)
        if record is None and number == len(lines):
            break  # empty, or left half written
        try:
            head = msgspec.convert(record, _Head)
        except msgspec.ValidationError:
            raise FormatError(
                f"{path}, line {number}: no record; wanted a JSON object with key (text), attempt (1, 2, ...) and "
                "status ('ok' or 'failed'). Restore the line, or delete it"
            ) from None
        before = found.get(head.key)
        if before is None or (head.status == "ok", head.attempt) >= (before["status"] == "ok", before["attempt"]):
            found[head.key] = record
    return [found[key] for key in sorted(found)]


def as_line(record: Mapping[str, Any]) -> bytes:
    """`record` as one line of JSON with its newline; NumPy numbers and arrays become plain ones, secrets stars.

    Raises `EagorError`, which names the place, for NaN, infinity, and what JSON does not know.
    """
    text = json.dumps(as_plain(record, str(record.get("key", "record"))), ensure_ascii=False, separators=(",", ":"))
    return f"{redacted(text)}\n".encode("utf-8", "backslashreplace")  # half a pair of surrogates as JSON escapes it


def as_plain(value: Any, place: str) -> Any:
    """`value`, which errors call `place`, in the types that JSON knows. Raises `EagorError` where that cannot be."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        raise EagorError(f"{place} is {value}; a record holds finite numbers, and null where there is no case")
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Mapping):
        if strange := [key for key in value if not isinstance(key, str)]:
            raise EagorError(f"{place} has the key {strange[0]!r}; wanted text, which is all that JSON can hold there")
        return {key: as_plain(item, f"{place}: {key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(item, f"{place}[{index}]") for index, item in enumerate(value)]
    raise EagorError(
        f"{place} is a {type(value).__name__}, which JSON cannot hold; store numbers, text or lists of them"
    )


def _regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """A descriptor of the regular file at `path`, without following links. Raises `OSError` for anything else."""
    careful = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    refused = OSError(errno.EINVAL, f"{path.name} is a link, a pipe, a device or a folder; wanted a regular file")
    try:
        file = os.open(path, flags | careful, 0o644)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENXIO, errno.EISDIR):
            raise refused from error
        raise
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise refused
    return file


def _content(path: Path, advice: str) -> bytes | None:
    """All of a file of a run, None where there is none. Raises `FormatError` where it cannot be read."""
    try:
        with open(_regular(path), "rb") as file:
            return file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror or error}); {advice}") from None


def _parsed(line: bytes) -> Any:
    """The value that a line of JSON holds, None if it holds none."""
    try:
        return parsed(line)
    except ValueError:
        return None
