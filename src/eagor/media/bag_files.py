"""The files of bags, read within bounds: MCAP, and SQLite (.db3), as `ros2 bag` has written them from Foxy on.

MCAP (https://mcap.dev/spec) is read by the index at its end, or, where a recorder was killed or wrote none, by going
through it. A file is a row of records (operation, length, content); messages lie in chunks, or bare. A file may ask for
any room, so each record, each chunk and each row may have `MOST` bytes, and twice as many wait to be sorted. (The
package `mcap` keeps no such bounds: it unpacks a chunk whatever its size, and gives nothing of one that is cut off.)
"""

from __future__ import annotations

import heapq
import os
import sqlite3
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from eagor.errors import FormatError

__all__ = ["MAGIC", "MOST", "Channel", "McapFile", "SqliteFile", "read_mcap", "read_sqlite"]

MAGIC = b"\x89MCAP0\r\n"
MOST = 1 << 27  # bytes of a message, and of a chunk unpacked: a raw panorama of 8K has 0.7 of it
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_INDEX, _STATISTICS, _OFFSET, _DATA_END = 0x08, 0x0B, 0x0E, 0x0F
_READ = {_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _STATISTICS}
_DEFINITIONS = 1 << 24  # bytes of all types' texts and topics' names together
_WAITING = 200  # bytes that a message takes beside its content until its turn comes
_Waiting = tuple[int, int, int, int, bytes]  # time, place of the chunk, number in it, channel, content
_FRAMES = 64  # compressed parts of one chunk; recorders write one

_DEFINITION = 1 << 24  # bytes of one definition of a type


# --- MCAP ---


@dataclass(frozen=True)
class Channel:
    """A topic of the file: `definition` is its type's text, in ROS's msg or idl format (`encoding`)."""

    topic: str
    kind: str
    encoding: str
    definition: str


@dataclass
class McapFile:
    """What a file holds: channels by id, messages by channel, and why it ended before the end."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    broken: str | None = None
    _parts: list[tuple[int, int, bool]] = field(default_factory=list)  # first time, place, whether it is a chunk
    _schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    _defined: int = 0

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Channel, time (ns) and bytes of the messages of the `wanted` channels, in order of time.

        Raises `ValueError` or `EOFError` for damage, and where more than twice `MOST` bytes have to wait, because
        chunks overlap in time, or have millions of messages.
        """
        waiting: list[_Waiting] = []
        with self.path.open("rb") as file:
            for first, place, chunked in [*sorted(self._parts), (1 << 64, 0, False)]:
                while waiting and waiting[0][0] < first:
                    time, _, _, channel, data = heapq.heappop(waiting)
                    yield channel, time, data
                if first < 1 << 64:
                    file.seek(place)
                    _wait(file, chunked, wanted, waiting)

    def _add(self, operation: int, body: bytes | memoryview) -> int | None:
        """Take in a record; the time of a message."""
        if operation == _SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            if number not in self._schemas:  # each chunk may say it again
                name, encoding, text = self._texts(body, 2, 3)
                self._schemas[number] = name, {"omgidl": "ros2idl"}.get(encoding, encoding), text
        elif operation == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            if number not in self.channels:
                topic, _ = self._texts(body, 4, 2)
                self.channels[number] = Channel(topic, *self._schemas.get(schema, ("", "", "")))
                self.counts.setdefault(number, 0)
        elif operation == _MESSAGE:
            channel, _, time, _ = struct.unpack_from("<HIQQ", body)
            if channel in self.channels:
                self.counts[channel] += 1
                return time
        return None

    def _texts(self, body: bytes | memoryview, at: int, count: int) -> list[str]:
        """So many texts, each with its length in four bytes before it."""
        self._defined += len(body)
        if self._defined > _DEFINITIONS:
            raise ValueError(f"definitions of more than {_DEFINITIONS} bytes")
        found = []
        for _ in range(count):
            (length,) = struct.unpack_from("<I", body, at)
            found.append(str(body[at + 4 : at + 4 + length], "utf-8", "replace"))
            at += 4 + length
        return found


def read_mcap(path: Path) -> McapFile:
    """What the file's index says, else what is found by going through it, up to the first damage.

    Raises `FormatError` if it is no MCAP file, `OSError`.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise FormatError(f"{path} does not begin as an MCAP file does; wanted a ROS 2 bag (.mcap or .db3)")
        try:
            if found := _indexed(path, file):
                return found
        except (EOFError, ValueError, struct.error):
            pass  # a damaged index
        file.seek(len(MAGIC))
        return _scanned(path, file)


def _indexed(path: Path, file: IO[bytes]) -> McapFile | None:
    """What the index at the end says; None where there is none, or it leaves something out."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 37))
    end = file.read()
    if len(end) < 37 or end[:9] != struct.pack("<BQ", _FOOTER, 20) or end[29:] != MAGIC:
        return None
    (start,) = struct.unpack_from("<Q", end, 9)
    if not start:
        return None
    found, counts, total = McapFile(path), {}, -1
    file.seek(start)
    while (record := _record(file))[0] not in (_FOOTER, _OFFSET):
        operation, body = record
        if operation == _INDEX:
            first, _, place = struct.unpack_from("<QQQ", body)
            found._parts.append((first, place, True))
        elif operation == _STATISTICS:
            (total,), (long,) = struct.unpack_from("<Q", body), struct.unpack_from("<I", body, 42)
            counts = dict(struct.iter_unpack("<HQ", body[46 : 46 + long]))
        elif operation in (_SCHEMA, _CHANNEL):
            found._add(operation, body)
    found.counts = {number: counts.get(number, 0) for number in found.channels}
    whole = sum(found.counts.values()) == total and (total == 0 or found._parts)
    return found if whole else None


def _scanned(path: Path, file: IO[bytes]) -> McapFile:
    """Go through the whole file; what is damaged ends it."""
    found = McapFile(path)
    try:
        while True:
            place = file.tell()
            try:
                operation, body = _record(file)
            except _Cut as cut:
                if (operation := cut.operation) != _CHUNK:
                    raise
                body, found.broken = cut.body, str(cut)
            if operation in (_FOOTER, _DATA_END):
                return found
            if operation == _CHUNK:
                times = (found._add(*record) for record in _records(_unpacked(body)))
                first = min((time for time in times if time is not None), default=None)
                if first is not None:
                    found._parts.append((first, place, True))
                if found.broken:
                    return found
            elif (time := found._add(operation, body)) is not None:
                found._parts.append((time, place, False))
    except (EOFError, ValueError, struct.error) as error:
        found.broken = str(error) or "it ends in the middle of a record"
    return found


def _wait(file: IO[bytes], chunked: bool, wanted: Collection[int], waiting: list[_Waiting]) -> None:
    """Put the `wanted` messages of the next record, a chunk or a message, among those that are `waiting`."""
    place = file.tell()
    try:
        kind, content = _record(file)
    except _Cut as cut:
        kind, content = cut.operation, cut.body
    if (kind == _CHUNK) is not chunked:
        raise ValueError("its index is wrong")
    room = sum(len(each[-1]) + _WAITING for each in waiting)
    for at, (operation, body) in enumerate(_records(_unpacked(content)) if chunked else [(kind, content)]):
        if operation == _MESSAGE and (about := struct.unpack_from("<HIQQ", body))[0] in wanted:
            heapq.heappush(waiting, (about[2], place, at, about[0], bytes(body[22:])))
            room += len(body) + _WAITING - 22
            if room > 2 * MOST:
                raise ValueError(f"more than {2 * MOST} bytes wait to be put in order of time")


class _Cut(EOFError):
    """The file ends in the middle of a record, of which this is the beginning."""

    def __init__(self, operation: int, body: bytes) -> None:
        super().__init__("it ends in the middle of a record")
        self.operation, self.body = operation, body


def _record(file: IO[bytes]) -> tuple[int, bytes]:
    """The next record: operation and content, which is left out where nothing here reads it."""
    head = file.read(9)
    if len(head) < 9:
        raise EOFError("it has no end" if not head else "it ends in the middle of a record")
    operation, length = struct.unpack("<BQ", head)
    if operation == 0:
        raise EOFError("zeros where a record should begin")
    if operation not in _READ:  # attachments may be of any length
        end = file.tell() + length
        if end > file.seek(0, os.SEEK_END):
            raise EOFError("it ends in the middle of a record")
        file.seek(end)
        return operation, b""
    if length > MOST:
        raise ValueError(f"a record of {length} bytes; at most {MOST} are read")
    body = file.read(length)
    if len(body) < length:
        raise _Cut(operation, body)
    return operation, body


def _records(data: bytes) -> Iterator[tuple[int, memoryview]]:
    """The whole records in the content of a chunk, which may be cut off."""
    view, at = memoryview(data), 0
    while at + 9 <= len(view):
        operation, length = struct.unpack_from("<BQ", view, at)
        at += 9 + length
        if not operation or at > len(view):
            return
        yield operation, view[at - length : at]


def _unpacked(body: bytes) -> bytes:
    """The content of a chunk; of one that is cut off, and not compressed, its beginning."""
    _, _, size, check = struct.unpack_from("<QQQI", body)
    (long,) = struct.unpack_from("<I", body, 28)
    compression = body[32 : 32 + long].decode("ascii", "replace")
    (packed_size,) = struct.unpack_from("<Q", body, 32 + long)
    packed = body[40 + long :]
    if size > MOST:
        raise ValueError(f"a chunk of {size} bytes; at most {MOST} are read")
    if len(packed) < packed_size and compression == "":
        return packed
    try:
        data = _decompressed(packed, compression, size)
    except Exception as error:  # each library has errors of its own
        raise ValueError(f"a chunk cannot be unpacked ({error})") from error
    if len(data) != size or (check and zlib.crc32(data) != check):
        raise ValueError("a chunk is damaged")
    return data


def _decompressed(packed: bytes, compression: str, size: int) -> bytes:
    """Unpack by the libraries that come with `rosbags`, no further than `size` bytes."""
    if compression == "":
        return packed
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor as Decompressor
    elif compression == "zstd":
        try:
            from backports.zstd import ZstdDecompressor as Decompressor
        except ImportError:  # Python 3.14 has its own
            from compression.zstd import (  # type: ignore[import-not-found, no-redef]
                ZstdDecompressor as Decompressor,
            )
    else:
        raise ValueError(f"compression {compression!r}")
    found, rest, room = [], packed, size
    for _ in range(_FRAMES):
        frame = Decompressor()
        found.append(frame.decompress(rest, max_length=room + 1))
        room -= len(found[-1])
        if room < 0:
            raise ValueError(f"it holds more than the {size} bytes that it declares")
        rest = frame.unused_data
        if not frame.eof or not rest:
            break
    return found[0] if len(found) == 1 else b"".join(found)


# --- SQLite ---


@dataclass(frozen=True)
class SqliteFile:
    """What a file holds: channels by id, messages by channel. A database is whole, or no database (`broken`)."""

    path: Path
    channels: dict[int, Channel]
    counts: dict[int, int]
    broken: None = None

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Channel, time (ns) and bytes of the messages of the `wanted` channels, in order of time.

        Raises `ValueError` for damage, and for a message of more than `MOST` bytes.
        """
        numbers = ", ".join(map(str, wanted))
        try:
            with closing(_opened(self.path, MOST)) as database:
                for channel, time, data in database.execute(
                    f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({numbers}) ORDER BY timestamp"
                ):
                    if not isinstance(time, int) or not isinstance(data, bytes):
                        raise ValueError("a row of its messages has no time or no content")
                    yield channel, time, data
        except sqlite3.DataError as error:
            raise ValueError(f"a message of more than {MOST} bytes: {error}") from error
        except sqlite3.Error as error:
            raise ValueError(str(error)) from error


def read_sqlite(path: Path) -> SqliteFile:
    """The topics and the number of their messages. Raises `ValueError` for what is no such database."""
    try:
        with closing(_opened(path, _DEFINITION)) as database:
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise ValueError("it has no tables of topics and messages")
            texts: dict[str, tuple[str, str]] = {}
            if "message_definitions" in tables:
                rows = database.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                texts = {kind: (encoding, text) for kind, encoding, text in rows}
            rows = database.execute("SELECT id, name, type FROM topics ORDER BY id").fetchall()
            if not all(isinstance(each, kind) for row in rows for each, kind in zip(row, (int, str, str), strict=True)):
                raise ValueError("a row of its topics has no number, name or type")
            channels = {number: Channel(name, kind, *texts.get(kind, ("", ""))) for number, name, kind in rows}
            counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    except sqlite3.Error as error:
        raise ValueError(str(error)) from error
    return SqliteFile(path, channels, {number: counts.get(number, 0) for number in channels})


def _opened(path: Path, most: int) -> sqlite3.Connection:
    """To be read only, by whatever thread; rows of more than `most` bytes are refused by SQLite itself."""
    database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True, check_same_thread=False)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, most)
    return database
