"""Safe files: the cache, atomic writes, no devices, no keys or passwords.

Code that reads a secret passes it to `keep_out`. Code that writes text to a file, a report or a terminal passes the
text through `redacted`; `write_atomic` does.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
import uuid
from contextlib import suppress
from pathlib import Path

from eagor.errors import StorageError

_SHORTEST = 6  # letters: shorter ones occur in ordinary words
_GONE = "***"
_LOGIN = re.compile(r"(?<=://)[^/\s@\"']*:[^/\s@\"']*(?=@)")  # user and password in an address
_secrets: set[str] = set()


def cache_folder() -> Path:
    """What can be made again: $EAGOR_CACHE, else eagor in $XDG_CACHE_HOME, else in ~/.cache, else (no home) in /tmp."""
    if chosen := os.environ.get("EAGOR_CACHE"):
        return Path(chosen)
    if chosen := os.environ.get("XDG_CACHE_HOME"):
        return Path(chosen) / "eagor"
    try:
        return Path.home() / ".cache" / "eagor"
    except RuntimeError:  # a user without a home, as in containers
        return Path(tempfile.gettempdir()) / "eagor"


def write_atomic(path: Path, content: str | bytes) -> Path:
    """Write `content` (text as UTF-8, without secrets) to `path`, and return it; folders above it are made.

    The old file stays until all of the new content is on the disk. If writing fails, the old file stays and nothing
    else is left. Raises `StorageError`, which says where, why, and how much room is needed.
    """
    data = redacted(content).encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:12]}.part")  # other threads and machines may write too
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise StorageError(
            f"{path} cannot be written ({error.strerror or error}); {len(data)} bytes are needed there. Make room, or "
            "name another place"
        ) from error
    finally:
        with suppress(OSError):
            part.unlink()
    return path


def read_file(path: str | os.PathLike[str]) -> bytes:
    """All of a regular file, through links too. Raises `OSError` for anything else: a pipe may never end, or begin."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0))) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, f"{os.fspath(path)} is a pipe or a device; wanted a file on a disk")
        return file.read()


def append_all(file: int, data: bytes, sync: bool = False) -> None:
    """Write all of `data` at the end of an open file, and if `sync` wait until it is on the disk.

    Raises `OSError`; the file is then as it was: half a line would spoil the next one.
    """
    end = os.lseek(file, 0, os.SEEK_END)
    try:
        while data:  # a disk that fills up takes part of it first, and fails at the next call
            data = data[os.write(file, data) :]
        if sync:
            os.fsync(file)
    except OSError:
        os.ftruncate(file, end)
        os.lseek(file, end, os.SEEK_SET)
        raise


def keep_out(*secrets: str) -> None:
    """Remember `secrets`, so that `redacted` hides them; very short ones are ignored."""
    _secrets.update(secret for secret in secrets if len(secret) >= _SHORTEST)


def redacted(text: str) -> str:
    """`text` with stars in place of every secret, and of user and password in every address."""
    for secret in sorted(_secrets, key=len, reverse=True):  # longest first: one may be part of another
        text = text.replace(secret, _GONE)
    return _LOGIN.sub(_GONE, text)


def natural(name: str) -> list[tuple[int, int, str]]:
    """A key to sort names by, numbers in them by value."""
    parts = enumerate(re.split(r"0*([0-9]+)", name))  # every other one is a number
    return [(0, len(part), part) if at % 2 else (1, 0, part) for at, part in parts if part]
