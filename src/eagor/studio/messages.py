"""Messages between the server and a page.

To the page: a header in JSON, and blobs (pictures) after it, in one binary frame. A frame is the length of the header
(uint32, little-endian), the header in UTF-8, and the blobs back to back, as the header's ``blobs`` lists them: name and
bytes of each. From the page: JSON objects, checked field by field, because the browser is not trusted.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from eagor.errors import EagorError
from eagor.sources.intrinsics import Camera

__all__ = [
    "LONGEST", "Ask", "Drive", "FromPage", "Message", "Open", "Opening", "PageError", "Pause", "Restart", "merged",
    "packed", "read", "rounded",
]  # fmt: skip

CARRIED = ("panorama", "belief", "evidence")  # parts that stay wanted until they have been sent
LONGEST = 16_384  # bytes of a message of a page


@dataclass(frozen=True)
class Message:
    """A `header` with a "type", and `blobs` by name."""

    header: dict[str, Any]
    blobs: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def problem(cls, problem: str, change: str = "", fatal: bool = False, question: int = 0, **more: Any) -> Message:
        """What is wrong, and what to do; `question`: the number of one that is refused."""
        words = f"{problem[:1].upper()}{problem[1:].removesuffix('.')}."
        return cls({"type": "problem", "problem": words, "change": change, "fatal": fatal, "question": question} | more)

    @classmethod
    def status(cls, words: str) -> Message:
        """What is going on."""
        return cls({"type": "status", "words": words})


def packed(message: Message) -> bytes:
    """The message as one binary frame. Raises `ValueError` for numbers that JSON does not have."""
    listed = [{"name": name, "bytes": len(blob)} for name, blob in message.blobs.items()]
    text = json.dumps(message.header | {"blobs": listed}, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    head = text.encode()
    return b"".join([struct.pack("<I", len(head)), head, *message.blobs.values()])


def merged(unsent: Message | None, newer: Message) -> Message:
    """The `newer` step, with the pictures and beliefs of an `unsent` one before it that it does not have itself.

    So a page that is slow misses steps, but never the newest picture or belief.
    """
    if unsent is None:
        return newer
    kept = {name for name in CARRIED if name in unsent.header} - newer.header.keys()
    blobs = {name: blob for name, blob in unsent.blobs.items() if name in kept}
    return Message({name: unsent.header[name] for name in kept} | newer.header, blobs | newer.blobs)


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


@dataclass(frozen=True)
class Opening:
    """What a stream shows: a `source`, its `poses`, `rig` and `camera` as of `eagor.open_source`; what looks for what.

    `title`: what a person calls the source. `question`: the number of the query, which answers carry.
    """

    source: str
    title: str
    query: str
    perception: str
    question: int = 0
    poses: str = "auto"
    rig: str | None = None
    camera: Camera = field(default_factory=Camera)

    @property
    def simulated(self) -> bool:
        """Whether it is a walk through a built-in apartment."""
        return self.source.startswith("apartment:")


class PageError(EagorError):
    """A page has said or sent something that cannot be used: the `problem`, and what to `change`."""

    def __init__(self, problem: str, change: str, status: int = 400) -> None:
        super().__init__(f"{problem} {change}")
        self.problem, self.change, self.status = problem, change, status


# --- what a page may say -------------------------------------------------------------------------------------------

_LINE = r"^[^\x00-\x1f]*\Z"  # a text of one line
Name = Annotated[str, Meta(max_length=64, pattern=_LINE)]
Query = Annotated[str, Meta(max_length=200, pattern=_LINE)]
Number = Annotated[int, Meta(ge=0, le=1 << 53)]  # of a question: the page gives it, and answers carry it
Driver = Literal["tour", "policy", "person"]


class FromPage(Struct, tag_field="type", tag=str.lower):
    """A message of a page: its type is the name of its class, its fields are checked as they are annotated."""


class Open(FromPage):
    """Show a source: ``apartment:7``, ``upload:ID``, or ``live``, the one that the server was started with."""

    source: Name
    query: Query = ""
    perception: Name = ""
    drive: Driver | Literal[""] = ""
    hfov: Annotated[float, Meta(ge=2, le=150)] | None = None  # degrees, of an ordinary camera's picture
    question: Number = 0


class Ask(FromPage):
    """Look for something else, or with another perception (empty: with the same)."""

    query: Query
    perception: Name = ""
    question: Number = 0


class Drive(FromPage):
    """Who moves the body, and how the person has moved it: metres and radians per second, for so many seconds."""

    by: Driver = "person"
    forward: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    turn: Annotated[float, Meta(ge=-100, le=100)] = 0.0
    seconds: Annotated[float, Meta(ge=0, le=0.5)] = 0.0


class Pause(FromPage):
    """Stand still, or go on."""

    on: bool


class Restart(FromPage):
    """Begin again."""


def read(text: str | bytes) -> Open | Ask | Drive | Pause | Restart:
    """The message in `text`. Raises `PageError`, which says what was wanted."""
    try:
        found = msgspec.json.decode(text, type=Open | Ask | Drive | Pause | Restart)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise PageError(f"A message came that makes no sense: {error}.", "Reload the page.") from None
    if isinstance(found, Ask) and not any(each.isalnum() for each in found.query):
        raise PageError("The query has no words.", "Say what to look for, such as 'red chair'.")
    if isinstance(found, Open | Ask):
        return msgspec.structs.replace(found, query=" ".join(found.query.split()))
    return found
