"""A ROS 2 bag (MCAP) that can be read although its writer was killed.

`rosbags` writes messages in chunks, and an index at the end. Here a chunk is closed and handed to the system at each
`flush`: what came before it survives the writer. `mend` puts an end behind a file that lacks it.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from eagor._extras import need
from eagor.errors import FormatError, StorageError
from eagor.robots.dds.ros_types import store

__all__ = ["Bag", "mend", "messages"]

MAGIC = b"\x89MCAP0\r\n"
CHUNK, INDEX, DATA_END, FOOTER = 0x06, 0x07, 0x0F, 0x02
_END = bytes([DATA_END]) + struct.pack("<QI", 4, 0) + bytes([FOOTER]) + struct.pack("<QQQI", 20, 0, 0, 0) + MAGIC


class Bag:
    """A new bag in the folder `path`, which must not exist. Raises `StorageError`, `MissingExtraError`."""

    def __init__(self, path: Path) -> None:
        need("recording", "robot", "rosbags")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.errors import WriterError

        self.path = Path(path)
        self._topics: dict[str, Any] = {}
        try:
            self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except (OSError, WriterError) as error:
            raise StorageError(f"{path} cannot be made a new folder for a recording: {_why(error)}") from error
        self._storage: Any = self._writer.storage
        fcntl.flock(self._storage.bio, fcntl.LOCK_EX | fcntl.LOCK_NB)  # so that nobody mends what is being written

    def write(self, topic: str, kind: str, seconds: float, **fields: Any) -> None:
        """Write a message of the ROS type `kind` that came at `seconds`. Raises `StorageError`."""
        if topic not in self._topics:
            self._topics[topic] = self._writer.add_connection(topic, kind, typestore=store())
        message = store().types[kind](**fields)
        try:
            self._writer.write(self._topics[topic], round(seconds * 1e9), store().serialize_cdr(message, kind))
        except OSError as error:
            raise StorageError(f"{self.path} cannot be written: {_why(error)}") from error

    def flush(self) -> None:
        """Hand all that was written to the system. Raises `StorageError`."""
        try:
            if self._storage.chunk.msgs:
                self._storage.close_chunk()
            self._storage.bio.flush()
        except OSError as error:
            raise StorageError(f"{self.path} cannot be written: {_why(error)}") from error

    def close(self) -> None:
        """Write the index. Raises `StorageError`."""
        try:
            self._writer.close()
        except OSError as error:
            self.abort()
            raise StorageError(f"{self.path} cannot be written: {_why(error)}") from error

    def abort(self) -> None:
        """Stop writing; what is there can be mended."""
        with suppress(OSError):
            os.close(os.dup(self._storage.bio.fileno()))
        raw = self._storage.bio
        with suppress(OSError, ValueError):
            raw.detach().close()  # without the rest that has no room


def messages(path: Path) -> Iterator[tuple[str, str, float, Any]]:
    """Each message of a bag by time: topic, type, seconds, message. Raises `FormatError`, `MissingExtraError`."""
    need("reading a recording", "robot", "rosbags")
    from rosbags.rosbag2 import Reader
    from rosbags.rosbag2.errors import ReaderError

    try:
        with Reader(path) as reader:
            for connection, when, data in reader.messages():
                yield (
                    connection.topic, connection.msgtype, when * 1e-9,
                    store().deserialize_cdr(data, connection.msgtype),
                )  # fmt: skip
    except (ReaderError, OSError) as error:
        raise FormatError(f"{path} cannot be read as a ROS 2 bag: {error}") from error


def mend(folder: Path) -> int:
    """Put an end behind the bag in `folder` if its writer left none; returns how many bytes of a torn end were dropped.

    Raises `FormatError` if there is no bag, or if it is being written, and `StorageError`.
    """
    files = sorted(folder.glob("*.mcap")) if folder.is_dir() else []
    if len(files) != 1:
        raise FormatError(f"{folder} holds {len(files) or 'no'} MCAP files; wanted the folder of eagor live --record")
    with files[0].open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise FormatError(f"{files[0]} is no MCAP file")
        size = os.path.getsize(files[0])
        file.seek(max(0, size - len(MAGIC)))
        if size > len(_END) and file.read() == MAGIC:
            return 0
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            raise FormatError(f"{folder} is being recorded; end that first (Ctrl-C)") from error
        whole = _whole(file, size)
    try:
        with files[0].open("r+b") as file:
            file.truncate(whole)
            file.seek(whole)
            file.write(_END)
    except OSError as error:
        raise StorageError(f"{files[0]} cannot be mended: {_why(error)}") from error
    return size - whole


def _whole(file: Any, size: int) -> int:
    """Where the last whole record before the index ends."""
    place = len(MAGIC)
    file.seek(place)
    while len(head := file.read(9)) == 9:
        kind, length = head[0], struct.unpack("<Q", head[1:])[0]
        if kind in (DATA_END, FOOTER) or place + 9 + length > size:
            break
        place += 9 + length
        file.seek(place)
    return place


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
