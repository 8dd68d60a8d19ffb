"""The files of bags, read within bounds: MCAP, and SQLite (.db3), as `ros2 bag` has written them from Foxy on.

A file may ask for any room, so each record, each chunk unpacked and each row may have `MOST` bytes, and twice as many
wait to be sorted: `mcap` reads the records, but chunks are unpacked here, which it does whatever their size.
"""

from __future__ import annotations

import heapq
import io
import os
import shutil
import sqlite3
import struct
import sys
import tempfile
import weakref
import zlib
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel as ChannelTold
from mcap.records import Chunk, Message, Schema
from mcap.stream_reader import StreamReader
from zstandard import ZstdDecompressor

from eagor.errors import FormatError

__all__ = ["MAGIC", "MOST", "Channel", "McapFile", "SqliteFile"]

MAGIC = b"\x89MCAP0\r\n"
MOST = 1 << 27  # bytes of a message, and of a chunk unpacked: a raw panorama of 8K has 0.7 of it
_DEFINITIONS = 1 << 24  # bytes of all types' texts and topics' names together
_WAITING = 200  # bytes that a message takes beside its content until its turn comes
_CUT = "it ends in the middle of a record"


class Channel(NamedTuple):
    """A topic of the file: `definition` is its type's text, in ROS's msg or idl format (`encoding`)."""

    topic: str
    kind: str
    encoding: str = ""
    definition: str = ""


class _Bounded(io.BufferedReader):
    """A file of which nobody gets more than `MOST` bytes at once: room is taken before it is known what there is."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(MOST if size is None or not 0 <= size <= MOST else size)


class McapFile:
    """What a file holds: `channels` by id, `counts` of messages by channel, and why it ended early (`broken`).

    It is known from the index at its end, or, where a recorder was killed or wrote none, by going through it, up to the
    first damage. Raises `FormatError` if it is no MCAP file, `OSError`, `ValueError`.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.broken = path, None
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self._parts: list[tuple[int, int, frozenset[int] | None]] = []  # first time, place, the channels if told
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._defined = 0
        with _Bounded(path) as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise FormatError(f"{path} does not begin as an MCAP file does; wanted a ROS 2 bag (.mcap or .db3)")
            if not self._by_index(file):
                self.broken = self._by_reading(file)

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Channel, time (ns) and bytes of the messages of the `wanted` channels, in order of time.

        Raises `ValueError` for damage, and where more than twice `MOST` bytes have to wait, because chunks overlap in
        time, or have millions of messages.
        """
        waiting: list[tuple[int, int, int, int, bytes]] = []
        room, end = 0, (1 << 64, 0, frozenset[int]())
        with _Bounded(self.path) as file:
            for first, place, held in [*sorted(self._parts, key=lambda part: part[:2]), end]:
                while waiting and waiting[0][0] < first:
                    time, _, _, channel, data = heapq.heappop(waiting)
                    room -= len(data) + _WAITING
                    yield channel, time, data
                if held is not None and held.isdisjoint(wanted):
                    continue
                for at, record in enumerate(_records(file, place)[0]):
                    if isinstance(record, Message) and record.channel_id in wanted:
                        heapq.heappush(waiting, (record.log_time, place, at, record.channel_id, record.data))
                        room += len(record.data) + _WAITING
                        if room > 2 * MOST:
                            raise ValueError(f"more than {2 * MOST} bytes wait to be put in order of time")

    def _by_index(self, file: _Bounded) -> bool:
        """Take what the index at the end says; False where there is none, or it is damaged, or leaves something out."""
        file.seek(0)
        try:
            summary = SeekingReader(file, record_size_limit=MOST).get_summary()
        except Exception:  # as the library happens to meet the damage
            return False
        if summary is None or (told := summary.statistics) is None:
            return False
        counts, parts = told.channel_message_counts, summary.chunk_indexes
        total = sum(many for number, many in counts.items() if number in summary.channels)
        if total != told.message_count or (total and not parts):
            return False
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._take(record)
        self.counts |= {number: counts.get(number, 0) for number in self.channels}
        self._parts = [
            (each.message_start_time, each.chunk_start_offset, frozenset(each.message_index_offsets) or None)
            for each in parts
        ]
        return True

    def _by_reading(self, file: _Bounded) -> str | None:
        """Go through the whole file; what ended it before its end."""
        place, size = len(MAGIC), file.seek(0, os.SEEK_END)
        try:
            while place < size:
                records, after = _records(file, place)
                times = (time for time in map(self._take, records) if time is not None)
                if (first := min(times, default=None)) is not None:
                    self._parts.append((first, place, None))
                if after is None:
                    return None
                place = after
        except Exception as error:  # as the libraries happen to meet the damage
            return str(error) or _CUT
        return "it has no end" if place == size else _CUT

    def _take(self, record: Any) -> int | None:
        """Take in a record; the time of a message."""
        if isinstance(record, Message) and record.channel_id in self.channels:
            self.counts[record.channel_id] += 1
            return record.log_time
        if isinstance(record, Schema) and record.id not in self._schemas:  # each chunk may say it again
            self._defined += len(record.name) + len(record.data)
            encoding = {"omgidl": "ros2idl"}.get(record.encoding, record.encoding)
            self._schemas[record.id] = record.name, encoding, str(record.data, "utf-8", "replace")
        elif isinstance(record, ChannelTold) and record.id not in self.channels:
            self._defined += len(record.topic)
            self.channels[record.id] = Channel(record.topic, *self._schemas.get(record.schema_id, ("",)))
            self.counts[record.id] = 0
        if self._defined > _DEFINITIONS:
            raise ValueError(f"definitions of more than {_DEFINITIONS} bytes")
        return None


def _records(file: _Bounded, place: int) -> tuple[Iterator[Any], int | None]:
    """The record at a place, or those in a chunk, as far as they are whole; and where the next begins, None at the end.

    Raises `ValueError` or `EOFError`, also while they are read.
    """
    file.seek(place)
    head = file.read(9)
    if len(head) < 9 or not head[0]:
        raise EOFError(_CUT if len(head) < 9 else "zeros where a record should begin")
    operation, length = struct.unpack("<BQ", head)
    if operation in (Opcode.FOOTER, Opcode.DATA_END):
        return iter(()), None
    after = place + 9 + length
    if operation not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
        return iter(()), after  # attachments may be of any length
    if length > MOST:
        raise ValueError(f"a record of {length} bytes; at most {MOST} are read")
    body = file.read(length)
    if operation == Opcode.CHUNK:
        return _whole(_unpacked(Chunk.read(ReadDataStream(io.BytesIO(body))), len(body) < length)), after
    return _whole(head + body), after


def _whole(data: bytes) -> Iterator[Any]:
    with suppress(EndOfFile, struct.error):
        yield from StreamReader(io.BytesIO(data), skip_magic=True, emit_chunks=True).records


def _unpacked(chunk: Chunk, cut: bool) -> bytes:
    """The content of a chunk, no further than it declares; of one that is `cut` off its beginning."""
    data, size, check = chunk.data, chunk.uncompressed_size, chunk.uncompressed_crc
    if size > MOST:
        raise ValueError(f"a chunk of {size} bytes; at most {MOST} are read")
    try:
        if chunk.compression == "zstd":
            data = ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
        elif chunk.compression == "lz4":
            data, rest = b"", data
            while rest and len(data) <= size:
                frame = LZ4FrameDecompressor()
                data += frame.decompress(rest, max_length=size + 1 - len(data))
                rest = frame.unused_data
        elif chunk.compression:
            raise ValueError(f"compression {chunk.compression!r}")
    except Exception as error:  # each library has errors of its own
        raise ValueError(f"a chunk cannot be unpacked ({error})") from error
    if len(data) > size:
        raise ValueError(f"a chunk holds more than the {size} bytes that it declares")
    if not cut and (len(data) < size or (check and zlib.crc32(data) != check)):
        raise ValueError("a chunk is damaged")
    return data


class SqliteFile:
    """What a database holds: `channels` by id, `counts` of messages by channel. It is whole, or none (`broken`).

    What a recorder that was killed left beside it (``-wal``, ``-journal``) counts, and is not touched: where SQLite
    would have to write there to read it, a copy is read. Raises `ValueError` for what is no such database, `OSError`.
    """

    broken = None

    def __init__(self, path: Path) -> None:
        self.path, self._place, self._how = path, path.resolve(), "immutable=1"
        beside = [Path(f"{self._place}{end}") for end in ("-wal", "-journal")]
        if beside := [each for each in beside if each.exists() and each.stat().st_size]:
            self._how = "mode=ro&readonly_shm=1"
            try:
                with closing(self._opened()) as database:
                    database.execute("SELECT count(*) FROM sqlite_master")
            except sqlite3.Error:
                folder = tempfile.mkdtemp(prefix="eagor-bag-")
                weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
                for each in (self._place, *beside):
                    shutil.copyfile(each, Path(folder, each.name))
                self._place, self._how = Path(folder, self._place.name), "mode=rw"
        with closing(self._opened()) as database:
            try:
                self._read(database)
            except sqlite3.Error as error:
                raise ValueError(str(error)) from error

    def _read(self, database: sqlite3.Connection) -> None:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise ValueError("it has no tables of topics and messages")
        texts: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            texts = {kind: (encoding, text) for kind, encoding, text in rows}
        topics = database.execute("SELECT id, name, type FROM topics ORDER BY id").fetchall()
        if not all(isinstance(each, kind) for row in topics for each, kind in zip(row, (int, str, str), strict=True)):
            raise ValueError("a row of its topics has no number, name or type")
        self.channels = {number: Channel(name, kind, *texts.get(kind, ("", ""))) for number, name, kind in topics}
        counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        self.counts = {number: counts.get(number, 0) for number in self.channels}

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """As `McapFile.messages`; raises `ValueError` for damage, and for a message of more than `MOST` bytes."""
        numbers = ", ".join(map(str, wanted))
        rows = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({numbers}) ORDER BY timestamp"
        try:
            with closing(self._opened()) as database:
                for channel, time, data in database.execute(rows):
                    if channel not in wanted or not isinstance(time, int) or not isinstance(data, bytes):
                        raise ValueError("a row of its messages has no topic, time or content")
                    yield channel, time, data
        except sqlite3.Error as error:
            raise ValueError(f"a row of more than {MOST} bytes" if "too big" in str(error) else str(error)) from error

    def _opened(self) -> sqlite3.Connection:
        """To be read, by whatever thread; larger rows are refused by SQLite itself."""
        database = sqlite3.connect(f"{self._place.as_uri()}?{self._how}", uri=True, check_same_thread=False)
        if sys.version_info >= (3, 11):
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST)
        return database
