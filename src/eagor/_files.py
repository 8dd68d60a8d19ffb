"""Files that are written whole or not at all, and packed ones that are read only as far as makes sense."""

from __future__ import annotations

import gzip
import os
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
    data = redacted(content).encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise StorageError(
            f"{path} cannot be written ({error.strerror or error}); {len(data)} bytes are wanted there. Make room, or "
            "name another place"
        ) from error
    return path


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
