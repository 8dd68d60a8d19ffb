"""Messages between two processes as lines that a partial or torn write cannot confuse: a checksum, then JSON.

A line that is cut, joined with another or damaged fails its checksum and is dropped; the next line break starts anew.
"""

from __future__ import annotations

import json
import os
import select
import zlib
from typing import Any

__all__ = ["LONGEST", "LineReader", "as_line", "cut", "read_now", "write_now"]

LONGEST = select.PIPE_BUF  # bytes: a pipe takes so many as a whole, or not at all (POSIX)
_CHUNK = 65536


def as_line(message: dict[str, Any]) -> bytes:
    """A message as a line. Not-a-number and infinity pass. Raises `ValueError` if it is longer than `LONGEST`."""
    text = json.dumps(message, ensure_ascii=False, separators=(",", ":")).encode(errors="replace")
    line = b"%08x " % zlib.crc32(text) + text + b"\n"
    if len(line) > LONGEST:
        raise ValueError(f"a message of {len(line)} bytes; a pipe takes {LONGEST} at once")
    return line


def cut(text: str, most: int) -> str:
    """The beginning of a text, in at most `most` bytes of UTF-8 (twice that in JSON), printable."""
    printable = "".join(character if character.isprintable() else " " for character in text[:most])
    return printable.encode(errors="replace")[:most].decode(errors="ignore")


class LineReader:
    """Takes bytes as they come, and gives whole messages. `damaged`: lines that were dropped."""

    def __init__(self) -> None:
        self.damaged = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """The messages that these bytes complete."""
        *lines, rest = (self._rest + data).split(b"\n")
        if len(rest) > LONGEST:  # no line is so long
            rest = rest[-1:]
            self.damaged += 1
        self._rest = rest
        found = (_message(line) for line in lines if line)
        messages = []
        for message in found:
            if message is None:
                self.damaged += 1
            else:
                messages.append(message)
        return messages


def _message(line: bytes) -> dict[str, Any] | None:
    sum_, _, text = line.partition(b" ")
    if b"%08x" % zlib.crc32(text) != sum_:
        return None
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def read_now(fd: int) -> bytes | None:
    """What has come on a non-blocking pipe; None if the other end is closed."""
    found = b""
    while True:
        try:
            data = os.read(fd, _CHUNK)
        except BlockingIOError:
            return found
        if not data:
            return found or None
        found += data


def write_now(fd: int, line: bytes) -> bool:
    """Write a line as a whole to a non-blocking pipe; False if there is no room. Raises `BrokenPipeError`."""
    try:
        return os.write(fd, line) == len(line)
    except BlockingIOError:
        return False
