"""A live run as a ROS 2 bag that other tools read, and that plays back bit for bit.

Topics: ``/eagor/events`` (exact: `event_in_bytes`), ``/eagor/image/compressed``, ``/eagor/odom``,
``/eagor/direction/QUERY``, ``/eagor/answers`` (JSON).
"""

from __future__ import annotations

import json
import math
import re
import struct
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal

import numpy as np

from eagor.errors import EagorError, FormatError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import (
    Answer,
    Asked,
    Event,
    EvidenceCame,
    Following,
    FrameCame,
    PoseCame,
    PosesLost,
    Trouble,
)
from eagor.live.inference import PATIENCE, Failed, InferenceWorker, Looked, looks_in_bytes
from eagor.media import Pose
from eagor.media.bags import BagWriter, bag_topics, read_bag
from eagor.media.ros_messages import (
    COMPRESSED,
    ODOMETRY,
    TEXT,
    VECTOR,
    compressed_message,
    message,
    odometry_message,
    panorama_of,
    text_message,
    vector_message,
)
from eagor.perception import Perception
from eagor.tracking import TrackerConfig
from eagor.tracking.checkpoint import packed, unpacked

__all__ = [
    "ANSWERS", "EVENTS", "IMAGES", "Compared", "Pictures", "Recorder", "Replay", "event_from", "event_in_bytes",
    "settings_from", "settings_in_bytes",
]  # fmt: skip

EVENTS, IMAGES, ODOM = "/eagor/events", "/eagor/image/compressed", "/eagor/odom"
ANSWERS, DIRECTION = "/eagor/answers", "/eagor/direction"
BYTES = "std_msgs/msg/UInt8MultiArray"
FLUSHED = 0.5  # seconds between two flushes: as much may be lost
WAITING = 16  # pictures that may wait to be written; further ones are left out
QUALITY = 92  # of JPEG
BODY = "base_link"  # REP-105
VERSION = 6  # of the events

Pictures = Literal["jpeg", "png", "none"]

_FRAME, _POSE = struct.Struct("<ddI"), struct.Struct("<dd??9d3d")
_LOOK = struct.Struct("<ddddI")


def event_in_bytes(event: Event) -> bytes:
    """An event without its picture, exactly.

    The first byte tells the kind; numbers are little-endian doubles, text is UTF-8 JSON, evidence and settings are
    bytes of `eagor.tracking.checkpoint`. Reading runs no code of the file.
    """
    match event:
        case FrameCame():
            name = event.name.encode()
            head = _FRAME.pack(event.arrival, event.stamp, len(name))
            return b"F" + head + name + packed(event.grid)
        case PoseCame():
            pose = event.pose
            where = (0.0, 0.0, 0.0) if pose.position is None else np.asarray(pose.position, dtype=np.float64).tolist()
            turn = np.asarray(pose.world_R_body, dtype=np.float64).reshape(9).tolist()
            placed = pose.position is not None
            return b"P" + _POSE.pack(event.arrival, pose.stamp, event.of_picture, placed, *turn, *where)
        case EvidenceCame():
            query = event.query.encode()
            head = _LOOK.pack(event.arrival, event.stamp, event.told, event.seconds, len(query))
            return b"E" + head + query + looks_in_bytes(event.looks)
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
            arrival, stamp, length = _FRAME.unpack_from(rest)
            name, grid = rest[_FRAME.size :][:length].decode(), unpacked(rest[_FRAME.size + length :])
            if not (grid is None or isinstance(grid, PerspectiveGrid)):
                raise FormatError("it holds no lens")
            return FrameCame(arrival, stamp, name, None, grid)
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


def settings_in_bytes(settings: LoopSettings) -> bytes:
    """What the core began with."""
    return b"S" + packed((VERSION, *(getattr(settings, each.name) for each in fields(settings))))


def settings_from(content: bytes) -> LoopSettings:
    """The settings that `settings_in_bytes` turned into bytes. Raises `FormatError`."""
    found = unpacked(content[1:]) if content[:1] == b"S" else None
    if not isinstance(found, tuple) or len(found) < 5 or not isinstance(found[2], TrackerConfig):
        raise FormatError("the recording does not begin with its settings; it is not one of eagor live --record")
    if found[0] != VERSION:
        raise FormatError(
            f"the recording is of version {found[0]}; wanted {VERSION}: play it with the eagor that made it"
        )
    _, queries, config, poses, latency, acceleration, extrapolate, exact = found
    numbers = float(latency), float(acceleration)
    return LoopSettings(tuple(queries), config, bool(poses), *numbers, extrapolate, exact)


def _text(kind: bytes, arrival: float, *words: Any) -> bytes:
    return kind + json.dumps([arrival, *words]).encode()


class Recorder:
    """A sink of the loop that writes all into a new folder `path`; `trouble` is told what goes wrong, in words.

    Everything is written in a thread of its own, and handed to the system every `FLUSHED` seconds: a run that is killed
    loses no more than that. If the disk is full, the recording ends, and the loop goes on.

    `pictures`: as JPEG, as PNG (exact, but slow), or not at all. Raises `StorageError` if the folder cannot be made.
    """

    def __init__(
        self, path: Path, settings: LoopSettings, trouble: Callable[[str], Any], pictures: Pictures = "jpeg"
    ) -> None:
        self.path, self.pictures, self.left_out = Path(path), pictures, 0
        self.problem: str | None = None
        self._trouble = trouble
        self._bag = BagWriter(self.path, at_risk=FLUSHED)
        self._last = -math.inf
        self._waiting = 0
        self._queue: SimpleQueue[tuple[Event, Sequence[Answer]] | None] = SimpleQueue()
        self._settings: bytes | None = settings_in_bytes(settings)
        self._thread = threading.Thread(target=self._serve, name="eagor recording", daemon=True)
        self._thread.start()

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """Write down an event and the answers to it, soon."""
        if self.problem is None:
            self._waiting += isinstance(event, FrameCame)
            self._queue.put((event, answers))

    def close(self) -> None:
        """Write the rest, and the index."""
        self._queue.put(None)
        self._thread.join()

    def _serve(self) -> None:
        entry: tuple[Event, Sequence[Answer]] | None = None
        try:
            while True:
                try:
                    entry = self._queue.get(timeout=FLUSHED)
                except Empty:
                    self._bag.flush()
                    continue
                if entry is None:
                    break
                self._write(*entry)
            self._bag.close()
        except (EagorError, OSError) as error:
            self.problem = f"the recording has ended early: {error}"
            self._trouble(self.problem)
            self._bag.close()
            while self._queue.get() is not None:
                continue  # nobody writes them any more

    def _write(self, event: Event, answers: Sequence[Answer]) -> None:
        if self._settings is not None:
            self._put(event.arrival, self._settings)
            self._settings = None
        self._put(event.arrival, event_in_bytes(event))
        if isinstance(event, FrameCame):
            self._waiting -= 1
            self._picture(event)
        elif isinstance(event, PoseCame):
            pose = event.pose
            flat = Pose(max(0.0, pose.stamp), pose.world_R_body, pose.position)
            self._bag.write(ODOM, ODOMETRY, odometry_message(flat), event.arrival)
        for answer in answers:
            self._answer(answer)

    def _put(self, now: float, content: bytes) -> None:
        # Readers sort by time: no two events may have the same one.
        self._last = max(now, math.nextafter(self._last, math.inf))
        layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        found = message(BYTES, layout=layout, data=np.frombuffer(content, dtype=np.uint8))
        self._bag.write(EVENTS, BYTES, found, self._last)

    def _picture(self, event: FrameCame) -> None:
        if event.picture is None or self.pictures == "none":
            return
        if self._waiting > WAITING:
            self.left_out += 1
            if self.left_out == 1:
                self._trouble("pictures come faster than they can be written; some are left out of the recording")
            return
        stamp = max(0.0, event.stamp)
        found = compressed_message(event.picture, stamp, BODY, kind=self.pictures, quality=QUALITY)
        self._bag.write(IMAGES, COMPRESSED, found, self._last)

    def _answer(self, answer: Answer) -> None:
        text = json.dumps(answer.as_dict(exact=True), allow_nan=False)
        self._bag.write(ANSWERS, TEXT, text_message(text), self._last)  # in the order of the events
        if answer.direction is not None:
            found = vector_message(answer.direction, answer.stamp, BODY)
            self._bag.write(f"{DIRECTION}/{slug(answer.query)}", VECTOR, found, self._last)


def slug(query: str) -> str:
    """A query as the last part of a topic's name: letters, digits and underscores."""
    found = re.sub(r"[^A-Za-z0-9]+", "_", query).strip("_").lower() or "query"
    return found if found[0].isalpha() else f"q_{found}"


@dataclass
class Compared:
    """Answers played again: how many, how many of them equal the recorded ones, and the first that does not.

    A recording that was cut off may end between an event and the answers to it: these are not `recorded`.
    """

    answers: int = 0
    equal: int = 0
    recorded: int = 0
    first: tuple[dict[str, Any], dict[str, Any]] | None = field(default=None, repr=False)

    def as_text(self) -> str:
        """How many are the same, and how many cannot be compared."""
        found = f"{self.answers} answers, {self.equal} of them equal to the recorded ones bit for bit"
        lost = self.answers - self.recorded
        return found + (f"; {lost} cannot be compared, because the recording ends before them" if lost else "")

    def add(self, played: dict[str, Any], recorded: dict[str, Any] | None) -> None:
        """One answer, and the recorded one in its place, if there is one."""
        self.answers += 1
        self.recorded += recorded is not None
        if played == recorded:
            self.equal += 1
        elif recorded is not None and self.first is None:
            self.first = played, recorded


class Replay:
    """A recording in the folder `path`: iterate for the answers that it gives again; `compared` tells how they differ.

    `perception`: look at the recorded pictures anew with this one instead of taking the recorded evidence; each look
    comes when the recorded one came, and takes `patience` seconds at most. A recording that was cut off is played as
    far as it goes, with a `UserWarning`. Raises `FormatError` for a folder that is no recording of the live loop.
    """

    def __init__(
        self,
        path: str | Path,
        perception: str | Perception | None = None,
        *,
        patience: float = PATIENCE,
    ) -> None:
        self.path, self.perception, self.patience = Path(path), perception, patience
        topics = bag_topics(self.path)
        if EVENTS not in topics:
            raise FormatError(
                f"{path} has no topic {EVENTS}: it is no recording of eagor live --record; it has {', '.join(topics)}"
            )
        if perception is not None and IMAGES not in topics:
            raise FormatError(f"{path} was recorded without pictures: play it with its own evidence")
        self.compared = Compared()
        self.settings = self._settings()

    def __iter__(self) -> Iterator[Answer]:
        core, self.compared = LiveCore(self.settings), Compared()
        anew = None if self.perception is None else _Anew(self.perception, self.patience, core, self._looked_at())
        written = self._answers() if anew is None else iter(())
        try:
            for event in self.events(pictures=anew is not None):
                for each in (event,) if anew is None else anew.instead(event):
                    for answer in core.take(each):
                        self.compared.add(answer.as_dict(exact=True), next(written, None))
                        yield answer
        finally:
            if anew is not None:
                anew.close()

    def _settings(self) -> LoopSettings:
        for _, _, _, found in read_bag(self.path, [EVENTS]):
            return settings_from(found.data.tobytes())
        raise FormatError(f"{self.path} holds no event: the run was ended before its first")

    def events(self, pictures: bool) -> Iterator[Event]:
        """The recorded events in order, with their pictures if wanted (where they were recorded)."""
        held: FrameCame | None = None
        for _, topic, _, found in read_bag(self.path, [EVENTS, IMAGES] if pictures else [EVENTS]):
            if topic == IMAGES:
                if held is not None:
                    yield replace(held, picture=panorama_of(found))
                    held = None
                continue
            if held is not None:
                yield held
                held = None
            content = found.data.tobytes()
            if content[:1] == b"S":
                continue
            event = event_from(content)
            if pictures and isinstance(event, FrameCame):
                held = event
            else:
                yield event
        if held is not None:
            yield held

    def _looked_at(self) -> list[float]:
        """The stamps of the pictures that were looked at, each once per look."""
        events = (found.data.tobytes() for _, _, _, found in read_bag(self.path, [EVENTS]))
        return [event_from(content).stamp for content in events if content[:1] == b"E"]  # type: ignore[union-attr]

    def _answers(self) -> Iterator[dict[str, Any]]:
        if ANSWERS not in bag_topics(self.path):
            return
        for _, _, _, found in read_bag(self.path, [ANSWERS]):
            yield json.loads(found.data)


class _Anew:
    """In place of recorded evidence: looks of another perception at the same pictures."""

    def __init__(self, perception: str | Perception, patience: float, core: LiveCore, wanted: list[float]) -> None:
        self._inference, self._core = InferenceWorker(perception, patience=patience), core
        self._left = Counter(wanted)  # looks at the picture of each stamp
        self._frames: dict[float, FrameCame] = {}

    def instead(self, event: Event) -> Iterator[Event]:
        """What comes in place of an event."""
        if isinstance(event, FrameCame) and event.picture is not None and self._left[event.stamp]:
            self._frames[event.stamp] = event
        if not isinstance(event, EvidenceCame):
            yield event
            return
        frame = self._frames.get(event.stamp)
        self._left[event.stamp] -= 1
        if not self._left[event.stamp]:
            self._frames.pop(event.stamp, None)
        if frame is None or frame.picture is None:  # it was left out of the recording
            return
        pose = self._core.orientation(event.stamp)
        for said in self._inference.look(frame.picture, [event.query], event.told, pose, frame.grid):
            if isinstance(said, Looked):
                yield replace(event, looks=said.looks, seconds=said.seconds)
            elif isinstance(said, Failed):
                yield Trouble(event.arrival, "perception", said.text, said.query or "")

    def close(self) -> None:
        self._inference.close()
