"""A live run as a ROS 2 bag that other tools read, and that plays again.

Topics: ``/eagor/image/compressed``, ``/eagor/odom``, ``/eagor/direction/QUERY``, ``/eagor/answers`` (JSON), and
``/eagor/events``: all that came into the loop, from which the same core gives the same answers and beliefs.
"""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal, get_args

import numpy as np

from eagor.errors import EagorError, FormatError
from eagor.live.core import LiveCore, LoopSettings
from eagor.live.events import Answer, Event, EvidenceCame, FrameCame, PoseCame
from eagor.media import Pose
from eagor.media.bags import Bag, BagWriter, read_bag
from eagor.media.ros_messages import (
    COMPRESSED,
    ODOMETRY,
    TEXT,
    VECTOR,
    compressed_message,
    header,
    message,
    odometry_message,
    panorama_of,
    vector,
)
from eagor.tracking import TrackerConfig
from eagor.tracking.checkpoint import packed, unpacked

__all__ = ["EVENTS", "IMAGES", "Pictures", "Recorder", "Replay", "event_from", "event_in_bytes"]

EVENTS, IMAGES, ODOM = "/eagor/events", "/eagor/image/compressed", "/eagor/odom"
ANSWERS, DIRECTION = "/eagor/answers", "/eagor/direction"
BYTES = "std_msgs/msg/UInt8MultiArray"
FLUSHED = 0.5  # seconds between two flushes: as much may be lost
WAITING = 16  # pictures that may wait to be written; further ones are left out
QUALITY = 92  # of JPEG
BODY = "base_link"  # REP-105
VERSION = 6  # of the events
KINDS: dict[str, type] = {kind.__name__: kind for kind in (*get_args(Event), LoopSettings)}

Pictures = Literal["jpeg", "png", "none"]


def event_in_bytes(event: Event | LoopSettings) -> bytes:
    """An event without its picture, or the settings of the core, exactly: bytes of `eagor.tracking.checkpoint`."""
    values = {each.name: getattr(event, each.name) for each in fields(event) if each.name != "picture"}
    if isinstance(event, PoseCame):
        values["pose"] = [getattr(event.pose, each.name) for each in fields(Pose)]
    try:
        return packed((VERSION, type(event).__name__, values))
    except FormatError:  # what a look says of its source may be anything
        if not isinstance(event, EvidenceCame):
            raise
        return event_in_bytes(replace(event, looks=tuple(replace(look, source=None) for look in event.looks)))


def event_from(content: bytes) -> Event | LoopSettings:
    """What `event_in_bytes` turned into bytes; no code in them is run. Raises `FormatError`."""
    found = unpacked(content)
    if not (isinstance(found, tuple) and len(found) == 3 and found[0] == VERSION):
        version = found[0] if isinstance(found, tuple) and found else None
        raise FormatError(
            f"the recording is of version {version!r}; wanted {VERSION}: play it with the eagor that made it"
        )
    _, name, values = found
    try:
        if name == PoseCame.__name__:
            values["pose"] = Pose(*values["pose"])
        return KINDS[name](**values)
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"an event of the recording cannot be read: {error!r}") from error


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
        self._settings: LoopSettings | None = settings
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
            self._put(event.arrival, event_in_bytes(self._settings))
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
        text = json.dumps(answer.as_dict(), allow_nan=False)
        self._bag.write(ANSWERS, TEXT, message(TEXT, data=text), self._last)  # in the order of the events
        if answer.direction is not None:
            found = message(VECTOR, header=header(answer.stamp, BODY), vector=vector(answer.direction))
            self._bag.write(f"{DIRECTION}/{slug(answer.query)}", VECTOR, found, self._last)


def slug(query: str) -> str:
    """A query as the last part of a topic's name: letters, digits and underscores."""
    found = re.sub(r"[^A-Za-z0-9]+", "_", query).strip("_").lower() or "query"
    return found if found[0].isalpha() else f"q_{found}"


class Replay:
    """A recording in the folder `path`: iterate for the answers that it gives again, with their beliefs.

    A recording that was cut off is played as far as it goes, with a `UserWarning`. Raises `FormatError` for a folder
    that is no recording of the live loop.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        topics = Bag(self.path).topics
        if EVENTS not in topics:
            raise FormatError(
                f"{path} has no topic {EVENTS}: it is no recording of eagor live --record; it has {', '.join(topics)}"
            )
        first = next((event_from(found.data.tobytes()) for *_, found in read_bag(self.path, [EVENTS])), None)
        if first is None:
            raise FormatError(f"{path} holds no event: the run was ended before its first")
        if not (isinstance(first, LoopSettings) and isinstance(first.config, TrackerConfig)):
            raise FormatError(f"{path} does not begin with its settings; it is not one of eagor live --record")
        self.settings = first

    def __iter__(self) -> Iterator[Answer]:
        core = LiveCore(self.settings)
        for event in self.events(pictures=False):
            yield from core.take(event)

    def events(self, pictures: bool) -> Iterator[Event]:
        """The recorded events in order, with their pictures if wanted (where they were recorded)."""
        held: FrameCame | None = None  # its picture comes next
        for _, topic, _, found in read_bag(self.path, [EVENTS, IMAGES] if pictures else [EVENTS]):
            if held is not None:
                yield replace(held, picture=panorama_of(found)) if topic == IMAGES else held
                held = None
            if topic == IMAGES:
                continue
            event = event_from(found.data.tobytes())
            if pictures and isinstance(event, FrameCame):
                held = event
            elif not isinstance(event, LoopSettings):
                yield event
        if held is not None:
            yield held
