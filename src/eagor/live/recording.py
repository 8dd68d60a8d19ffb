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
from eagor.live.events import Answer, Event, ImageReceived, ObservationReceived, PoseReceived
from eagor.sources import Pose
from eagor.sources.bags import Bag, BagWriter, read_bag
from eagor.sources.ros_messages import (
    COMPRESSED,
    ODOMETRY,
    TEXT,
    VECTOR,
    compressed_message,
    header,
    image_from_msg,
    message,
    odometry_message,
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
VERSION = 8  # of the events
KINDS: dict[str, type] = {kind.__name__: kind for kind in (*get_args(Event), LoopSettings)}

Pictures = Literal["jpeg", "png", "none"]


def event_in_bytes(event: Event | LoopSettings) -> bytes:
    """An event without its picture, or the settings of the core, exactly: bytes of `eagor.tracking.checkpoint`."""
    values = {each.name: getattr(event, each.name) for each in fields(event) if each.name != "picture"}
    if isinstance(event, PoseReceived):
        parts = (getattr(event.pose, each.name) for each in fields(Pose))
        values["pose"] = [part.tolist() if isinstance(part, np.ndarray) else part for part in parts]  # a third of it
    try:
        return packed((VERSION, type(event).__name__, values))
    except FormatError:  # what a look says of its source may be anything
        if not isinstance(event, ObservationReceived):
            raise
        return event_in_bytes(replace(event, looks=tuple(replace(look, source=None) for look in event.looks)))


def event_from(content: bytes) -> Event | LoopSettings:
    """What `event_in_bytes` turned into bytes; no code in them is run. Raises `FormatError`."""
    found = unpacked(content)
    version, name, values = found if isinstance(found, tuple) and len(found) == 3 else (None, "", {})
    if version != VERSION:
        raise FormatError(
            f"the recording is of version {version!r}; wanted {VERSION}: play it with the eagor that made it"
        )
    try:
        if name == PoseReceived.__name__:
            stamp, turn, position, *more = values["pose"]
            values["pose"] = Pose(stamp, np.array(turn), position and np.array(position), *more)
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
        self.problem: str | None = None  # why the recording has ended before the loop
        self._trouble, self._pictures, self._left_out = trouble, pictures, False
        self._bag = BagWriter(Path(path), at_risk=FLUSHED)
        self._last = 0.0  # bags know no time before 1970
        self._waiting = 0  # pictures
        self._queue: SimpleQueue[tuple[Event, Sequence[Answer]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._serve, args=[settings], name="eagor recording", daemon=True)
        self._thread.start()

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """Write down an event and the answers to it, soon."""
        if self.problem is None:
            self._waiting += isinstance(event, ImageReceived)
            self._queue.put((event, answers))

    def close(self) -> None:
        """Write the rest, and the index."""
        self._queue.put(None)
        self._thread.join()

    def _serve(self, settings: LoopSettings) -> None:
        begun = False
        try:
            while True:
                try:
                    entry = self._queue.get(timeout=FLUSHED)
                except Empty:
                    self._bag.flush()
                    continue
                if entry is None:
                    break
                event, answers = entry
                for each in (event,) if begun else (settings, event):  # all at the time of the first event
                    self._put(event.arrival, each)
                begun = True
                self._for_others(event, answers)
            self._bag.close()
        except (EagorError, OSError) as error:
            self.problem = f"the recording has ended early: {error}"
            self._trouble(self.problem)
            self._bag.close()
            while self._queue.get() is not None:
                continue  # nobody writes them any more

    def _put(self, now: float, event: Event | LoopSettings) -> None:
        # Readers sort by time: no two events may have the same one.
        self._last = max(now, math.nextafter(self._last, math.inf))
        layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        content = np.frombuffer(event_in_bytes(event), dtype=np.uint8)
        self._bag.write(EVENTS, BYTES, message(BYTES, layout=layout, data=content), self._last)

    def _for_others(self, event: Event, answers: Sequence[Answer]) -> None:
        """What other tools read."""
        if isinstance(event, ImageReceived):
            self._waiting -= 1
            picture, kind = event.picture, self._pictures
            if picture is None or kind == "none":
                return
            if self._waiting <= WAITING:
                found = compressed_message(picture, max(0.0, event.stamp), BODY, kind=kind, quality=QUALITY)
                self._bag.write(IMAGES, COMPRESSED, found, self._last)
            elif not self._left_out:
                self._left_out = True
                self._trouble("pictures come faster than they can be written; some are left out of the recording")
        elif isinstance(event, PoseReceived):
            flat = Pose(max(0.0, event.pose.stamp), event.pose.world_R_body, event.pose.position)
            self._bag.write(ODOM, ODOMETRY, odometry_message(flat), self._last)
        for answer in answers:
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
        first = next((event_from(found.data.tobytes()) for *_, found in read_bag(self.path, [EVENTS])), None)
        if not (isinstance(first, LoopSettings) and isinstance(first.config, TrackerConfig)):
            raise FormatError(
                f"{path} does not begin with settings on {EVENTS}: it is no recording of eagor live --record, or was "
                f"ended at once; it has {', '.join(topics)}"
            )
        self.settings = first

    def __iter__(self) -> Iterator[Answer]:
        core = LiveCore(self.settings)
        for event in self.events(pictures=False):
            yield from core.take(event)

    def events(self, pictures: bool) -> Iterator[Event]:
        """The recorded events in order, with their pictures if wanted (where they were recorded)."""
        held: Event | None = None  # its picture may come next
        for _, topic, _, found in read_bag(self.path, [EVENTS, IMAGES] if pictures else [EVENTS]):
            if topic == IMAGES:
                held = replace(held, picture=image_from_msg(found)) if isinstance(held, ImageReceived) else held
                continue
            if held is not None:
                yield held
            event = event_from(found.data.tobytes())
            held = None if isinstance(event, LoopSettings) else event
        if held is not None:
            yield held
