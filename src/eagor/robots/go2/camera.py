"""A panoramic camera whose pictures come over DDS, as those of the simulated Go2: read without ROS."""

from __future__ import annotations

import queue
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from eagor._extras import need
from eagor.errors import EagorError
from eagor.robots.dds import Participant, Raw, raw
from eagor.robots.go2.state import CompressedImage
from eagor.sources.live_camera import LiveCamera
from eagor.sources.ros_messages import COMPRESSED, compressed_message, image_from_msg, stamp_of, store

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

__all__ = ["PICTURE", "DdsCamera", "picture_message"]

PICTURE = raw(CompressedImage)  # as bytes: cyclonedds takes 40 ms per megabyte


def picture_message(panorama: np.ndarray, stamp: float, frame: str) -> Raw:
    """A `PICTURE` of ``(H, W, 3)`` uint8 RGB as JPEG."""
    return PICTURE(bytes(store().serialize_cdr(compressed_message(panorama, stamp, frame), COMPRESSED)))


class DdsCamera(LiveCamera):
    """A `LiveCamera` of panoramas, of at most so many `rows`: a topic of sensor_msgs/CompressedImage on DDS.

    Stamps are those of the headers, which are times of capture; where a header has none, the time of arrival.
    """

    stamped, again = True, False  # it is its own stream

    def __init__(self, topic: str, domain: int, interface: str | None, rows: int | None = None) -> None:
        need("reading pictures", "robot", "av")
        self.name, self._came = topic, queue.SimpleQueue[tuple[Any, float] | None]()
        self._link = Participant(domain, interface)
        self._link.subscribe(topic, PICTURE, self._received)
        super().__init__([self], rows=rows)  # type: ignore[list-item]

    def _received(self, message: Raw, when: float) -> None:
        self._came.put((store().deserialize_cdr(message.data, COMPRESSED), when))

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float, VideoFrame]]:
        """Until it is closed; those that came while one was looked at are `damaged`, but for the newest."""
        from av import VideoFrame

        last = 0.0
        while (came := self._came.get()) is not None:
            message, when = came
            stamp = stamp_of(message) or when
            if not self._came.empty() or stamp <= last:  # late, sent twice, or out of order
                damaged()
                continue
            try:
                picture = VideoFrame.from_ndarray(np.ascontiguousarray(image_from_msg(message)), "rgb24")
            except EagorError as error:
                damaged()
                warnings.warn(f"{self.name}: a picture is left out: {error}", UserWarning, stacklevel=2)
                continue
            last = stamp
            yield stamp, picture

    def close(self) -> None:
        super().close()
        self._link.close()
        self._came.put(None)
