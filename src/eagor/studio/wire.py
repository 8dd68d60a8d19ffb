"""Messages to the page: a header in JSON, and blobs (pictures, coefficients) after it, in one binary frame.

A frame is the length of the header (uint32, little-endian), the header in UTF-8, and the blobs back to back, as the
header's ``blobs`` lists them: name, type and bytes of each.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Blob", "Message", "merged", "packed", "rounded"]

CARRIED = ("panorama", "belief", "evidence")  # parts that stay wanted until they have been sent


@dataclass(frozen=True)
class Blob:
    """Bytes of a media type, such as image/jpeg, or float32 (little-endian)."""

    type: str
    content: bytes


@dataclass(frozen=True)
class Message:
    """A `header` with a "type", and `blobs` by name."""

    header: dict[str, Any]
    blobs: dict[str, Blob] = field(default_factory=dict)


def packed(message: Message) -> bytes:
    """The message as one binary frame. Raises `ValueError` for numbers that JSON does not have."""
    listed = [{"name": name, "type": b.type, "bytes": len(b.content)} for name, b in message.blobs.items()]
    text = json.dumps(message.header | {"blobs": listed}, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    head = text.encode()
    return b"".join([struct.pack("<I", len(head)), head, *(blob.content for blob in message.blobs.values())])


def merged(unsent: Message | None, newer: Message) -> Message:
    """The `newer` step, with what an `unsent` one before it had and it has not: pictures and beliefs.

    So a client that is slow misses steps, but never the newest picture or belief.
    """
    if unsent is None:
        return newer
    header, blobs = dict(newer.header), dict(newer.blobs)
    for name in CARRIED:
        if name in unsent.header and name not in header:
            header[name] = unsent.header[name]
            if name in unsent.blobs:
                blobs[name] = unsent.blobs[name]
    return Message(header, blobs)


def rounded(value: Any, digits: int = 5) -> Any:
    """Numbers rounded, arrays as lists, and None for what is not finite; also inside of lists and dicts."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [rounded(each, digits) for each in value]
    if isinstance(value, float):
        return round(value, digits) if math.isfinite(value) else None
    return value
