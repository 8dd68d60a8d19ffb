"""Events as bytes and back, exactly: what a recording is played back from.

The first byte tells the kind; numbers are little-endian doubles, text is UTF-8 JSON, evidence and settings are bytes of
`eagor.tracking.checkpoint`. Reading runs no code of the file.
"""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np

from eagor.errors import EagorError, FormatError
from eagor.evidence import Evidence
from eagor.live.core import Settings
from eagor.live.events import Asked, Event, EvidenceCame, Following, FrameCame, PoseCame, PosesLost, Trouble
from eagor.media.frames import Pose
from eagor.tracking import TrackerConfig
from eagor.tracking.checkpoint import packed, unpacked

__all__ = ["event_from", "event_in_bytes", "settings_from", "settings_in_bytes"]

VERSION = 2
_FRAME, _POSE = struct.Struct("<dd"), struct.Struct("<dd??9d3d")
_LOOK = struct.Struct("<ddddI")


def event_in_bytes(event: Event) -> bytes:
    """An event without its picture."""
    match event:
        case FrameCame():
            return b"F" + _FRAME.pack(event.arrival, event.stamp) + event.name.encode()
        case PoseCame():
            pose = event.pose
            where = (0.0, 0.0, 0.0) if pose.position is None else np.asarray(pose.position, dtype=np.float64).tolist()
            turn = np.asarray(pose.world_R_body, dtype=np.float64).reshape(9).tolist()
            placed = pose.position is not None
            return b"P" + _POSE.pack(event.arrival, pose.stamp, event.of_picture, placed, *turn, *where)
        case EvidenceCame():
            query = event.query.encode()
            head = _LOOK.pack(event.arrival, event.stamp, event.told, event.seconds, len(query))
            return b"E" + head + query + _looks_in_bytes(event.looks)
        case Asked():
            return b"A" + struct.pack("<d", event.arrival)
        case Trouble():
            return _text(b"T", event.arrival, event.part, event.text, event.about)
        case PosesLost():
            return _text(b"L", event.arrival, event.text)
        case Following():
            return _text(b"Q", event.arrival, *event.queries)


def event_from(content: bytes) -> Event:
    """The event that `event_in_bytes` turned into bytes. Raises `FormatError`."""
    kind, rest = content[:1], content[1:]
    try:
        if kind == b"F":
            arrival, stamp = _FRAME.unpack_from(rest)
            return FrameCame(arrival, stamp, rest[_FRAME.size :].decode())
        if kind == b"P":
            arrival, stamp, of_picture, placed, *numbers = _POSE.unpack(rest)
            position = np.array(numbers[9:]) if placed else None
            return PoseCame(arrival, Pose(stamp, np.array(numbers[:9]).reshape(3, 3), position), of_picture)
        if kind == b"E":
            arrival, stamp, told, seconds, length = _LOOK.unpack_from(rest)
            query, looks = rest[_LOOK.size :][:length].decode(), unpacked(rest[_LOOK.size + length :])
            if not isinstance(looks, tuple) or not all(isinstance(look, Evidence) for look in looks):
                raise FormatError("it holds no evidence")
            return EvidenceCame(arrival, stamp, told, query, looks, seconds)
        if kind == b"A":
            return Asked(*struct.unpack("<d", rest))
        arrival, *words = json.loads(rest)
        if kind == b"T":
            return Trouble(arrival, *words)
        if kind == b"L":
            return PosesLost(arrival, *words)
        if kind == b"Q":
            return Following(arrival, tuple(words))
    except (struct.error, ValueError, TypeError) as error:
        raise FormatError(f"an event of the recording cannot be read: {error}") from error
    raise FormatError(f"the recording has an event of the unknown kind {kind!r}; play it with the eagor that made it")


def settings_in_bytes(settings: Settings) -> bytes:
    """What the core began with."""
    values = settings.queries, settings.config, settings.poses, settings.latency, settings.acceleration
    return b"S" + packed((VERSION, *values))


def settings_from(content: bytes) -> Settings:
    """The settings that `settings_in_bytes` turned into bytes. Raises `FormatError`."""
    found = unpacked(content[1:]) if content[:1] == b"S" else None
    if not isinstance(found, tuple) or len(found) < 5 or not isinstance(found[2], TrackerConfig):
        raise FormatError("the recording does not begin with its settings; it is not one of eagor live --record")
    if found[0] != VERSION:
        raise FormatError(
            f"the recording is of version {found[0]}; wanted {VERSION}: play it with the eagor that made it"
        )
    _, queries, config, poses, latency, acceleration = found
    return Settings(tuple(queries), config, bool(poses), float(latency), float(acceleration))


def _looks_in_bytes(looks: tuple[Evidence, ...]) -> bytes:
    try:
        return packed(looks)
    except EagorError:  # what it says of its source may be anything
        return packed(tuple(replace(look, source=None) for look in looks))


def _text(kind: bytes, arrival: float, *words: Any) -> bytes:
    return kind + json.dumps([arrival, *words]).encode()
