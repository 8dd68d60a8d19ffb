"""The lens of an ordinary camera, as its driver tells it: the sensor_msgs/CameraInfo beside its pictures.

By the rule of ``image_transport``, the CameraInfo of ``/ns/image_raw`` is on ``/ns/camera_info``, one with
each picture. Some drivers send it once, for whoever comes later (transient local).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import DeviceError, FormatError
from eagor.media.bags import Bag
from eagor.media.intrinsics import Camera, rig_of_info
from eagor.media.panorama import is_whole
from eagor.media.rigs import Rig
from eagor.media.ros_messages import CAMERA_INFO
from eagor.robots.ros.graph import Graph, find_topic, pick

__all__ = ["LensTold", "beside", "is_rectified", "lacks_lens", "told_in_bag", "told_on_graph"]

OPTION = "--camera-info"
RECTIFIED = "image_rect"  # image_rect, image_rect_color: what image_proc publishes
WAITING = 0.1  # seconds after which who waits for a message looks whether to go on


@dataclass(frozen=True, eq=False)
class LensTold:
    """The `camera` that a CameraInfo tells, and the `frame` that its header names."""

    camera: Camera
    frame: str


def beside(image_topic: str) -> str:
    """The topic of the CameraInfo of a topic of pictures, compressed ones as well."""
    return f"{_plain(image_topic).rpartition('/')[0]}/camera_info"


def is_rectified(image_topic: str) -> bool:
    """Whether the name of a topic says that its pictures have no distortion any more."""
    return _plain(image_topic).rpartition("/")[2].startswith(RECTIFIED)


def lacks_lens(picture: np.ndarray, rig: Rig | None, camera: Camera | None) -> bool:
    """Whether a picture ``(H, W, 3)`` is no panorama, and neither a `rig` nor a `camera` tells its lens."""
    return rig is None and not (camera is not None and camera.known) and not is_whole(picture)


def told_in_bag(bag: Bag, image_topic: str, asked: str | None = None) -> LensTold | None:
    """What the first CameraInfo of a bag tells, on the topic `asked` for.

    Without one, on that beside the `image_topic`; None if there is none. Raises `FormatError`.
    """
    topic = beside(image_topic)
    if asked is not None:
        topic, _ = pick(bag.topics, (CAMERA_INFO,), asked, where=str(bag.path), option=OPTION)
    elif bag.topics.get(topic) != CAMERA_INFO:
        return None
    first = next(iter(bag.messages([topic])), None)
    if first is None:
        raise FormatError(f"{bag.path} has no message on {topic}; give the lens with --hfov or --camera FILE")
    return _told(first[3], topic, image_topic)


def told_on_graph(
    graph: Graph,
    image_topic: str,
    asked: str | None = None,
    wait: float = 10.0,
    ended: Callable[[], bool] = lambda: False,
) -> LensTold | None:
    """The same of a graph; the message may take `wait` seconds. Raises `DeviceError` if none comes, `FormatError`."""
    topic = beside(image_topic)
    if asked is not None:
        topic, _, _ = find_topic(graph, (CAMERA_INFO,), asked, option=OPTION, ended=ended)
    elif graph.topics().get(topic, ("", 0))[0] != CAMERA_INFO:
        return None
    came, found = threading.Event(), list[Any]()

    def received(message: Any, _: float) -> None:
        found.append(message)
        came.set()

    # A reader of what was said before hears no writer that keeps nothing, so there is one of either kind.
    readers = [
        graph.subscribe(topic, CAMERA_INFO, received, reliable=kept, depth=1, transient=kept) for kept in (True, False)
    ]
    end = time.monotonic() + wait
    try:
        while not (came.wait(WAITING) or ended()) and time.monotonic() < end:
            pass
    finally:
        for reader in readers:
            reader.close()
    if not found:
        raise DeviceError(
            f"no CameraInfo came on {topic} within {wait:g} s; drivers send one with each picture. Start it, or give "
            "the lens with --hfov"
        )
    return _told(found[0], topic, image_topic)


def _plain(image_topic: str) -> str:
    return image_topic.removesuffix("/compressed")


def _told(received: Any, topic: str, image_topic: str) -> LensTold:
    rig = rig_of_info(received, is_rectified(image_topic), topic)
    return LensTold(Camera(rig, name=topic), received.header.frame_id)
