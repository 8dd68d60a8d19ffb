"""Messages between the server and a page.

To the page: a header in JSON, and blobs (pictures, coefficients) after it, in one binary frame. A frame is the length
of the header (uint32, little-endian), the header in UTF-8, and the blobs back to back, as the header's ``blobs`` lists
them: name, type and bytes of each.

From the page: JSON objects, checked field by field, because the browser is not trusted.
"""

from __future__ import annotations

import io
import json
import math
import struct
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct
from PIL import Image

from eagor._checks import parsed, shown
from eagor.errors import EagorError

__all__ = ["LATE", "LONGEST", "SEED", "Blob", "Message", "PageError", "jpeg", "merged", "packed", "read", "rounded"]

CARRIED = ("panorama", "belief", "evidence", "things")  # parts that stay wanted until they have been sent


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


QUALITY = 80


def jpeg(panorama: np.ndarray) -> bytes:
    """A picture ``(H, W, 3)`` uint8 as JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(panorama).save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()


def webp(picture: np.ndarray) -> bytes:
    """A picture ``(H, W, 3)`` uint8 as WebP, for what is kept: half the bytes of JPEG, and more time."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "WEBP", quality=QUALITY)
    return buffer.getvalue()


def media_type(picture: bytes) -> str:
    """The media type of a picture by `jpeg` or `webp`."""
    return "image/webp" if picture.startswith(b"RIFF") else "image/jpeg"


LONGEST = 16_384  # bytes of a message
LATE = 0.5  # seconds that a body moves at once at most: what was held up makes no leap
NO_CONTROL = r"^[^\x00-\x1f]*\Z"  # a text of one line
SEED = 11  # the apartment of the first walk: see `eagor.studio.houses.TOUR`


class PageError(EagorError):
    """A page has said or sent something that cannot be used: the `problem`, and what to `change`."""

    def __init__(self, problem: str, change: str, status: int = 400) -> None:
        super().__init__(f"{problem} {change}")
        self.problem, self.change, self.status = problem, change, status


# --- what a page may say -------------------------------------------------------------------------------------------

Name = Annotated[str, Meta(max_length=64, pattern=NO_CONTROL)]
Query = Annotated[str, Meta(max_length=200, pattern=NO_CONTROL)]
Seed = Annotated[int, Meta(ge=0, le=9999)]
Methods = Annotated[list[Name], Meta(max_length=16)]
Number = Annotated[int, Meta(ge=0, le=1 << 53)]  # of a question: the page gives it, and answers carry it
Angle = Annotated[float, Meta(ge=-100, le=100)]  # radians, or radians per second


class FromPage(Struct, tag_field="type", tag=str.lower):
    """A message of a page: its type is the name of its class, its fields are checked as they are annotated."""


class Open(FromPage):
    """Show a view."""

    view: Literal["walk", "picture", "live"]
    query: Query = ""
    perception: Name = ""
    seed: Seed | None = None
    drive: Literal["policy", "person", "tour"] = "policy"
    id: Name = ""
    hfov: Annotated[float, Meta(ge=2, le=150)] | None = None  # degrees, of an ordinary camera's picture
    methods: Methods = []
    question: Number = 0


class Ask(FromPage, tag="query"):
    """Look for something else, or with another perception (empty: with the same)."""

    text: Query
    perception: Name = ""
    question: Number = 0


class Drive(FromPage):
    """Who moves the body, and how the person has moved it: metres and radians per second, for so many seconds."""

    by: Literal["policy", "person"] = "person"
    forward: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    turn: Angle = 0.0
    seconds: Annotated[float, Meta(ge=0, le=LATE)] = 0.0


class Camera(FromPage):
    """Where the camera points in a photograph."""

    yaw: Angle = 0.0
    pitch: Angle = 0.0
    roll: Angle = 0.0


class Pause(FromPage):
    """Stand still, or go on."""

    on: bool


class Seek(FromPage):
    """Go to a frame of a video."""

    frame: Annotated[int, Meta(ge=0, le=10**9)]


class Degree(FromPage):
    """Believe with harmonics of this degree."""

    L: Annotated[int, Meta(ge=1, le=31)]


class Compare(FromPage, tag="methods"):
    """Run these methods beside ours."""

    names: Methods


class Restart(FromPage):
    """Begin again."""


_KINDS = {
    str(kind.__struct_config__.tag): kind for kind in (Open, Ask, Drive, Camera, Pause, Seek, Degree, Compare, Restart)
}


def read(text: str | bytes) -> dict[str, Any]:
    """The message in `text`, with every field that its type has. Raises `PageError`, which says what was wanted."""
    if len(text) > LONGEST:
        raise PageError(f"A message of {len(text)} bytes came; at most {LONGEST} were wanted.", "Send less.", 413)
    try:
        found = parsed(text, strict=True)
    except ValueError as error:
        raise PageError(f"A message came that is no JSON ({error}).", "Send one JSON object per message.") from None
    name = found.get("type") if isinstance(found, dict) else None
    if not isinstance(name, str) or name not in _KINDS:
        raise PageError(f"A message of the type {shown(name)} came; known are {', '.join(_KINDS)}.", "Reload the page.")
    try:
        told = msgspec.convert({key: each for key, each in found.items() if each is not None}, _KINDS[name])
    except (msgspec.ValidationError, OverflowError) as error:
        raise PageError(f"In a message {name!r} something is wrong: {error}.", "Reload the page.") from None
    message = {key: _tidy(each) for key, each in msgspec.to_builtins(told).items()}
    if name == "query" and not any(each.isalnum() for each in message["text"]):
        raise PageError("The query has no words.", "Say what to look for, such as 'red chair'.")
    return message


def _tidy(value: Any) -> Any:
    """Texts with one space between words."""
    if isinstance(value, list):
        return [_tidy(each) for each in value]
    return " ".join(value.split()) if isinstance(value, str) else value
