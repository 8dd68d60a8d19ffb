"""SQLite files of ROS 2 bags (.db3), as `ros2 bag` has written them from Foxy on; a row may have `MOST` bytes."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from eagor.media.bags.mcap import MOST, Channel

__all__ = ["Recorded", "recorded"]

_DEFINITION = 1 << 24  # bytes of one definition of a type


@dataclass(frozen=True)
class Recorded:
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


def recorded(path: Path) -> Recorded:
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
    return Recorded(path, channels, {number: counts.get(number, 0) for number in channels})


def _opened(path: Path, most: int) -> sqlite3.Connection:
    """To be read only, by whatever thread; rows of more than `most` bytes are refused by SQLite itself."""
    database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True, check_same_thread=False)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, most)
    return database
