"""A panoramic camera whose pictures come over DDS, as those of the simulated Go2: read without ROS."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor.errors import DeviceError, EagorError, ImageError
from eagor.grids import ErpGrid
from eagor.media import Frame
from eagor.media.panorama import resized
from eagor.media.ros_messages import COMPRESSED, compressed_message, panorama_of, stamp_of, store
from eagor.robots.dds import Link, Raw, raw
from eagor.robots.go2.state import CompressedImage

__all__ = ["PICTURE", "DdsCamera", "picture_message"]

PICTURE = raw(CompressedImage)  # as bytes: cyclonedds takes 40 ms per megabyte
FIRST = 10.0  # seconds in which the first picture has to come


def picture_message(panorama: np.ndarray, stamp: float, frame: str) -> Raw:
    """A `PICTURE` of ``(H, W, 3)`` uint8 RGB as JPEG."""
    return PICTURE(bytes(store().serialize_cdr(compressed_message(panorama, stamp, frame), COMPRESSED)))


class DdsCamera:
    """A `CameraSource`: the panoramas of a topic of sensor_msgs/CompressedImage on DDS domain `domain`.

    Stamps are those of the headers, which are times of capture; where a header has none, the time of arrival. Only the
    newest picture is kept, and decoded when it is taken; `dropped` counts the others. `rows`: the most rows of a
    picture. Raises `DeviceError` if no picture comes, `ImageError` for pictures that are no panoramas.
    """

    live = True
    keeps_newest = True
    latency = 0.0

    def __init__(self, topic: str, domain: int, interface: str | None, rows: int | None = None) -> None:
        self.topic, self.dropped = topic, 0
        self.problem: str | None = None
        self._changed, self._closed = threading.Condition(), False
        self._newest: tuple[Any, float] | None = None
        self._link = Link(domain, interface)
        try:
            self._link.subscribe(topic, PICTURE, self._received)
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None, FIRST)
            if self._newest is None:
                raise DeviceError(f"no picture came on {topic} within {FIRST:g} s ({self._link}): is the camera there?")
            height = self._panorama(self._newest[0]).shape[0]
        except BaseException:
            self.close()
            raise
        height = min(rows or height, height)
        self.grid = ErpGrid(height, 2 * height)

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._newest is not None)
                if self._newest is None or self._closed:
                    return
                (message, when), self._newest = self._newest, None
            try:
                picture = resized(self._panorama(message), self.grid.shape, wrap=True)
            except EagorError as error:
                if self.problem is None:
                    warnings.warn(f"{self.topic}: a picture is left out: {error}", UserWarning, stacklevel=2)
                self.problem, self.dropped = str(error), self.dropped + 1
                continue
            if (stamp := stamp_of(message) or when) <= last:  # sent twice, or out of order
                self.dropped += 1
                continue
            last, self.problem = stamp, None
            yield Frame(stamp, picture, f"{self.topic} at {stamp:.3f} s")

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._link.close()

    def _panorama(self, message: Any) -> np.ndarray:
        picture = panorama_of(message)
        if not is_twice_as_wide(*picture.shape[:2]):
            raise ImageError(f"{self.topic} has pictures of {picture.shape[1]} x {picture.shape[0]}; wanted panoramas")
        return picture

    def _received(self, message: Any, when: float) -> None:
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = store().deserialize_cdr(message.data, COMPRESSED), when
            self._changed.notify_all()
