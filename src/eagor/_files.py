"""Files that are written whole or not at all, are what they seem, and are unpacked only as far as makes sense."""

from __future__ import annotations

import errno
import gzip
import os
import stat
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from eagor._secrets import redacted
from eagor.errors import FormatError, StorageError


def most_unpacked(size: int) -> int:
    """How many bytes something packed into `size` may have: text is packed to a tenth, a bomb to a thousandth."""
    return max(1 << 24, 100 * size)


def unpacked(path: Path) -> bytes:
    """What a gzipped file holds. Raises `OSError`, `EOFError`, `zlib.error`, or `FormatError` for a bomb."""
    most = most_unpacked(path.stat().st_size)
    with gzip.open(path) as file:
        found = file.read(most + 1)
    if len(found) > most:
        raise FormatError(f"it holds more than {most} bytes, packed in {path.stat().st_size}")
    return found


def written(path: Path, content: str | bytes) -> Path:
    """Write `content` (text as UTF-8, without secrets) to `path`, and return it; folders above it are made.

    What was there stays until all of the new content is on the disk, and stays if that fails; nothing half-written is
    left. Raises `StorageError`, which says where, why, and how much room is wanted.
    """
    _put(path, content, Path.replace)
    return path


def claimed(path: Path, content: str) -> bool:
    """Write `content` to `path` as `written` does, but only if nothing has that name; False if something has.

    Of several processes that try at once, exactly one succeeds. Raises `StorageError`.
    """
    won = True

    def link(part: Path, place: Path) -> None:
        nonlocal won
        try:
            os.link(part, place)  # unlike a rename, it replaces nothing
        except FileExistsError:
            won = False
        except OSError:  # a file system without such links
            try:
                os.close(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                won = False
            else:
                part.replace(place)

    _put(path, content, link)
    return won


def _put(path: Path, content: str | bytes, place: Callable[[Path, Path], object]) -> None:
    """Have all of `content` on the disk under a name of its own, then `place` it at `path`."""
    data = redacted(content).encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:12]}.part")  # other threads and machines may write too
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        place(part, path)
    except OSError as error:
        raise StorageError(
            f"{path} cannot be written ({error.strerror or error}); {len(data)} bytes are wanted there. Make room, or "
            "name another place"
        ) from error
    finally:
        with suppress(OSError):
            part.unlink()


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """A descriptor of the regular file at `path`, opened without following a link there.

    Raises `OSError` also for a link, a pipe, a device or a folder: whoever put it there, it is not ours to use.
    """
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


class Lines:
    """A text file that grows line by line: each line is whole, or not there. The first line makes the file."""

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, -1

    def add(self, text: str) -> None:
        """Append `text`. Raises `StorageError` if the disk does not take it; the file then ends as it did before."""
        data = redacted(text).encode("utf-8", "backslashreplace")
        try:
            if self._file < 0:
                self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            end = os.lseek(self._file, 0, os.SEEK_CUR)
            try:
                rest = data
                while rest:
                    rest = rest[os.write(self._file, rest) :]
            except OSError:
                os.ftruncate(self._file, end)
                os.lseek(self._file, end, os.SEEK_SET)
                raise
        except OSError as error:
            raise StorageError(
                f"{self.path} takes no more ({error.strerror or error}); {len(data)} bytes are wanted. What was "
                "written before is whole. Make room, or name another place, then start again"
            ) from error

    def __enter__(self) -> Lines:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
