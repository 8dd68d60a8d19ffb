"""Records a live run as a ROS 2 bag that other tools read, and that plays back bit for bit.

Topics: ``/eagor/events`` (`eagor.live.packing`, exact), ``/eagor/image/compressed``, ``/eagor/odom``,
``/eagor/direction/QUERY``, ``/eagor/answers`` (JSON). Everything is written in a thread of its own, and handed to the
system every `FLUSHED` seconds: a run that is killed loses no more than that. If the disk is full, the recording ends,
and the loop goes on.
"""

from __future__ import annotations

import json
import math
import re
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal

import numpy as np

from eagor.errors import EagorError
from eagor.live.answers import Answer
from eagor.live.core import Settings
from eagor.live.events import Event, FrameCame, PoseCame
from eagor.live.packing import event_in_bytes, settings_in_bytes
from eagor.media.bags.messages import (
    COMPRESSED,
    ODOMETRY,
    TEXT,
    VECTOR,
    compressed_message,
    message,
    odometry_message,
    text_message,
    vector_message,
)
from eagor.media.bags.reader import BagWriter
from eagor.media.frames import Pose

__all__ = ["ANSWERS", "EVENTS", "IMAGES", "Recorder"]

EVENTS, IMAGES, ODOM = "/eagor/events", "/eagor/image/compressed", "/eagor/odom"
ANSWERS, DIRECTION = "/eagor/answers", "/eagor/direction"
BYTES = "std_msgs/msg/UInt8MultiArray"
FLUSHED = 0.5  # seconds between two flushes: as much may be lost
WAITING = 16  # pictures that may wait to be written; further ones are left out
QUALITY = 92  # of JPEG
BODY = "base_link"  # REP-105

Pictures = Literal["jpeg", "png", "none"]


class Recorder:
    """A watcher of the loop that writes all into a new folder `path`; `trouble` is told what goes wrong, in words.

    `pictures`: as JPEG, as PNG (exact, but slow), or not at all. Raises `StorageError` if the folder cannot be made.
    """

    def __init__(
        self, path: Path, settings: Settings, trouble: Callable[[str], Any], pictures: Pictures = "jpeg"
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
        if event.panorama is None or self.pictures == "none":
            return
        if self._waiting > WAITING:
            self.left_out += 1
            if self.left_out == 1:
                self._trouble("pictures come faster than they can be written; some are left out of the recording")
            return
        stamp = max(0.0, event.stamp)
        found = compressed_message(event.panorama, stamp, BODY, kind=self.pictures, quality=QUALITY)
        self._bag.write(IMAGES, COMPRESSED, found, self._last)

    def _answer(self, answer: Answer) -> None:
        text = json.dumps(answer.as_json(exact=True), allow_nan=False)
        self._bag.write(ANSWERS, TEXT, text_message(text), self._last)  # in the order of the events
        if answer.direction is not None:
            found = vector_message(answer.direction, answer.stamp, BODY)
            self._bag.write(f"{DIRECTION}/{slug(answer.query)}", VECTOR, found, self._last)


def slug(query: str) -> str:
    """A query as the last part of a topic's name: letters, digits and underscores."""
    found = re.sub(r"[^A-Za-z0-9]+", "_", query).strip("_").lower() or "query"
    return found if found[0].isalpha() else f"q_{found}"
