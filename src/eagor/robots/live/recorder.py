"""Records a live run as a ROS 2 bag that other tools read, and that plays back bit for bit.

Topics: ``/eagor/events`` (`eagor.robots.live.packing`, exact), ``/eagor/image/compressed``, ``/eagor/odom``,
``/eagor/direction/QUERY``, ``/eagor/answers`` (JSON). Everything is written in a thread of its own, and handed to the
system every `FLUSHED` seconds: a run that is killed loses no more than that. If the disk is full, the recording ends,
and the loop goes on.
"""

from __future__ import annotations

import io
import json
import re
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Literal

import numpy as np
from PIL import Image

from eagor.conventions import xyzw_from_rotation
from eagor.errors import EagorError, StorageError
from eagor.robots.dds.ros_types import store
from eagor.robots.live.answers import Answer
from eagor.robots.live.bag import Bag
from eagor.robots.live.core import Settings
from eagor.robots.live.events import Event, FrameCame, PoseCame
from eagor.robots.live.packing import event_in_bytes, settings_in_bytes

__all__ = ["ANSWERS", "EVENTS", "IMAGES", "Recorder"]

EVENTS, IMAGES, ODOMETRY = "/eagor/events", "/eagor/image/compressed", "/eagor/odom"
ANSWERS, DIRECTION = "/eagor/answers", "/eagor/direction"
FLUSHED = 0.5  # seconds between two flushes: as much may be lost
WAITING = 16  # pictures that may wait to be written; further ones are left out
QUALITY = 92  # of JPEG
WORLD, BODY = "odom", "base_link"  # REP-105

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
        self._bag = Bag(self.path)
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
        flushed, going = time.monotonic(), True
        try:
            while going:
                try:
                    entry = self._queue.get(timeout=FLUSHED)
                    going = entry is not None
                    if entry is not None:
                        self._write(*entry)
                except Empty:
                    pass
                if time.monotonic() - flushed >= FLUSHED:
                    self._bag.flush()
                    flushed = time.monotonic()
            self._bag.close()
        except (EagorError, OSError) as error:
            self.problem = f"the recording has ended early: {error}"
            self._bag.abort()
            self._trouble(self.problem)
            while self._queue.get() is not None:
                pass  # nobody writes them any more

    def _write(self, event: Event, answers: Sequence[Answer]) -> None:
        now = event.arrival
        if self._settings is not None:
            self._put(EVENTS, now, self._settings)
            self._settings = None
        self._put(EVENTS, now, event_in_bytes(event))
        if isinstance(event, FrameCame):
            self._waiting -= 1
            self._picture(event)
        elif isinstance(event, PoseCame):
            self._odometry(event)
        for answer in answers:
            self._answer(answer)

    def _put(self, topic: str, now: float, content: bytes) -> None:
        types = store().types
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        data = np.frombuffer(content, dtype=np.uint8)
        self._bag.write(topic, "std_msgs/msg/UInt8MultiArray", now, layout=layout, data=data)

    def _picture(self, event: FrameCame) -> None:
        if event.panorama is None or self.pictures == "none":
            return
        if self._waiting > WAITING:
            self.left_out += 1
            if self.left_out == 1:
                self._trouble("pictures come faster than they can be written; some are left out of the recording")
            return
        content = io.BytesIO()
        picture = Image.fromarray(event.panorama)
        if self.pictures == "jpeg":
            picture.save(content, "JPEG", quality=QUALITY)
        else:
            picture.save(content, "PNG", compress_level=1)
        self._bag.write(
            IMAGES, "sensor_msgs/msg/CompressedImage", event.arrival,
            header=_header(event.stamp, BODY), format=self.pictures,
            data=np.frombuffer(content.getvalue(), dtype=np.uint8),
        )  # fmt: skip

    def _odometry(self, event: PoseCame) -> None:
        types, pose = store().types, event.pose
        x, y, z, w = map(float, xyzw_from_rotation(pose.world_R_body))
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        px, py, pz = map(float, (0.0, 0.0, 0.0) if pose.position is None else pose.position)
        unknown = np.full(36, -1.0 if pose.position is None else 0.0)
        here = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=px, y=py, z=pz),
            orientation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        )
        self._bag.write(
            ODOMETRY, "nav_msgs/msg/Odometry", event.arrival,
            header=_header(pose.stamp, WORLD), child_frame_id=BODY,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=here, covariance=unknown),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.full(36, -1.0)
            ),
        )  # fmt: skip

    def _answer(self, answer: Answer) -> None:
        text = json.dumps(answer.as_json(exact=True), allow_nan=False)
        self._bag.write(ANSWERS, "std_msgs/msg/String", answer.stamp, data=text)
        if answer.direction is not None:
            x, y, z = map(float, answer.direction)
            vector = store().types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)
            topic = f"{DIRECTION}/{slug(answer.query)}"
            header = _header(answer.stamp, BODY)
            self._bag.write(topic, "geometry_msgs/msg/Vector3Stamped", answer.stamp, header=header, vector=vector)


def slug(query: str) -> str:
    """A query as the last part of a topic's name: letters, digits and underscores."""
    found = re.sub(r"[^A-Za-z0-9]+", "_", query).strip("_").lower() or "query"
    return found if found[0].isalpha() else f"q_{found}"


def _header(stamp: float, frame: str) -> Any:
    types = store().types
    nanoseconds = max(0, round(stamp * 1e9))
    when = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return types["std_msgs/msg/Header"](stamp=when, frame_id=frame)
