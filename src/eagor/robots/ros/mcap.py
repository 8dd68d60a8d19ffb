"""MCAP files that have no end: a recorder was killed, or wrote no index. What is whole in them is read.

Format: https://mcap.dev/spec. A file is a row of records (operation, length, content); messages lie in chunks, or bare.
Complete files are read by `rosbags`; it refuses those without a footer, and those whose bare messages are not in order.
"""

from __future__ import annotations

import heapq
import io
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from eagor.errors import FormatError

__all__ = ["MAGIC", "Channel", "Unfinished", "scan"]

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_MOST = 1 << 32  # bytes of a chunk: a longer one is damage


@dataclass(frozen=True)
class Channel:
    """A topic of the file: `definition` is its type's text, in ROS's msg or idl format (`encoding`)."""

    topic: str
    kind: str
    encoding: str
    definition: str


@dataclass
class Unfinished:
    """What a scan has found: channels by id, messages by channel, the time span, and why it ended before the end."""

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    broken: str | None = None
    _parts: list[tuple[int, int, bool]] = field(default_factory=list)  # first time, place, whether it is a chunk
    _schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Channel, time (ns) and bytes of the messages of the `wanted` channels, in order of time."""
        waiting: list[tuple[int, int, int, bytes]] = []
        number = 0
        with self.path.open("rb") as file:
            for first, place, chunked in sorted(self._parts):
                while waiting and waiting[0][0] < first:
                    time, _, channel, data = heapq.heappop(waiting)
                    yield channel, time, data
                file.seek(place)
                try:
                    kind, content = _record(file)
                except _Cut as cut:
                    kind, content = cut.operation, cut.body
                inside = _records(_unpacked(content)) if chunked else iter([(kind, content)])
                for operation, body in inside:
                    if operation == _MESSAGE and (about := struct.unpack_from("<HIQQ", body))[0] in wanted:
                        heapq.heappush(waiting, (about[2], number, about[0], body[22:]))
                        number += 1
            while waiting:
                time, _, channel, data = heapq.heappop(waiting)
                yield channel, time, data

    def _add(self, operation: int, body: bytes) -> int | None:
        """Take in a record; the time of a message."""
        if operation == _SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            name, encoding, text = _texts(body, 2, 3)
            self._schemas[number] = name, encoding, text
        elif operation == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, _ = _texts(body, 4, 2)
            self.channels[number] = Channel(topic, *self._schemas.get(schema, ("", "", "")))
            self.counts.setdefault(number, 0)
        elif operation == _MESSAGE:
            channel, _, time, _ = struct.unpack_from("<HIQQ", body)
            if channel in self.channels:
                self.counts[channel] += 1
                return time
        return None


def scan(path: Path) -> Unfinished:
    """Go through the whole file; what is damaged ends it. Raises `FormatError` if it is no MCAP file."""
    found = Unfinished(path)
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise FormatError(f"{path} does not begin as an MCAP file does; wanted a ROS 2 bag (.mcap or .db3)")
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
                    times = [found._add(*record) for record in _records(_unpacked(body))]
                    if times := [time for time in times if time is not None]:
                        found._parts.append((min(times), place, True))
                    if found.broken:
                        return found
                elif (time := found._add(operation, body)) is not None:
                    found._parts.append((time, place, False))
        except (EOFError, ValueError, struct.error) as error:
            found.broken = str(error) or "it ends in the middle of a record"
    return found


class _Cut(EOFError):
    """The file ends in the middle of a record, of which this is the beginning."""

    def __init__(self, operation: int, body: bytes) -> None:
        super().__init__("it ends in the middle of a record")
        self.operation, self.body = operation, body


def _record(file: IO[bytes]) -> tuple[int, bytes]:
    """The next record: operation and content."""
    head = file.read(9)
    if len(head) < 9:
        raise EOFError("it has no end" if not head else "it ends in the middle of a record")
    operation, length = struct.unpack("<BQ", head)
    if length > _MOST:
        raise ValueError(f"a record of {length} bytes")
    body = file.read(length)
    if len(body) < length:
        raise _Cut(operation, body)
    return operation, body


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The whole records in the content of a chunk, which may be cut off."""
    file = io.BytesIO(data)
    while file.tell() < len(data):
        try:
            yield _record(file)
        except EOFError:
            return


def _unpacked(body: bytes) -> bytes:
    """The content of a chunk; of one that is cut off, and not compressed, its beginning."""
    _, _, size, check = struct.unpack_from("<QQQI", body)
    (long,) = struct.unpack_from("<I", body, 28)
    compression = body[32 : 32 + long].decode("ascii", "replace")
    (packed_size,) = struct.unpack_from("<Q", body, 32 + long)
    packed = body[40 + long :]
    if size > _MOST:
        raise ValueError(f"a chunk of {size} bytes")
    if len(packed) < packed_size and compression == "":
        return packed
    try:
        data = _decompressed(packed, compression)
    except Exception as error:  # each library has errors of its own
        raise ValueError(f"a chunk cannot be unpacked ({error})") from error
    if len(data) != size or (check and zlib.crc32(data) != check):
        raise ValueError("a chunk is damaged")
    return data


def _decompressed(packed: bytes, compression: str) -> bytes:
    """Unpack by the libraries that come with `rosbags`."""
    if compression == "":
        return packed
    if compression == "lz4":
        from lz4.frame import decompress as unpacked

        return unpacked(packed)
    if compression != "zstd":
        raise ValueError(f"compression {compression!r}")
    try:
        from backports.zstd import decompress
    except ImportError:  # Python 3.14 has its own
        from compression.zstd import decompress  # type: ignore[import-not-found, no-redef]
    return decompress(packed)


def _texts(body: bytes, at: int, count: int) -> list[str]:
    """So many texts, each with its length in four bytes before it."""
    found = []
    for _ in range(count):
        (length,) = struct.unpack_from("<I", body, at)
        found.append(body[at + 4 : at + 4 + length].decode("utf-8", "replace"))
        at += 4 + length
    return found
