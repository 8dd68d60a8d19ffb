"""The pictures and the odometry of a recorded bag."""

from __future__ import annotations

import heapq
import math
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor.cameras import Rig
from eagor.errors import DeviceError, FormatError, PoseError
from eagor.sources import Pose
from eagor.sources.bags import MOTION, PICTURES, TF, TF_STATIC, Bag, pick
from eagor.sources.image_topics import ImageTopics, lens_in_bag, lookup_static_transforms, topics_of
from eagor.sources.intrinsics import Camera
from eagor.sources.ros_frames import PoseReader
from eagor.sources.ros_messages import TRANSFORMS, stamp_of

__all__ = ["BagCamera", "BagPoses", "bag_odometry"]

OPTION = "--image-topic"
SETTLING = 10.0  # seconds of a bag in which its transforms have to tell where the camera is


class BagCamera:
    """The pictures of a bag, to play from its start as often as wanted.

    `topic`: None is the only one with pictures, and several have commas between. Stamps are those of the headers; where
    a header has none, the time of recording. `dropped`: messages that were sent twice or out of order; `back`: how many
    of them had stamps that go back, which is said once. `count`: how many pictures there are; `begins`: the stamp of
    the first; `frame`: as of `ImageTopics`; `lens`: the ordinary camera, if it is one; `view`: the grid of its
    pictures, None where they become panoramas. Raises `FormatError` for the bag or topic, and as `ImageTopics`.
    """

    def __init__(
        self,
        bag: Bag | str | Path,
        topic: str | None = None,
        *,
        rows: int | None = None,
        rig: Rig | None = None,
        camera: Camera | None = None,
        info: str | None = None,
    ) -> None:
        self.bag = bag if isinstance(bag, Bag) else Bag(bag)
        self.dropped = self.back = 0
        where = str(self.bag.path)
        self.topics = tuple(
            pick(self.bag.topics, PICTURES, each, where=where, option=OPTION)[0] for each in topics_of(topic, OPTION)
        )
        if empty := [each for each in self.topics if not self.bag.counts[each]]:
            raise FormatError(f"{where} has no message on {empty[0]}")
        self.topic = ",".join(self.topics)
        firsts = [next(self.bag.messages([each]), None) for each in self.topics]
        self.begins = min(_stamp(each[3], each[0]) for each in firsts if each is not None)
        self._pictures = ImageTopics(
            [each[3] for each in firsts if each is not None], self.topics, partial(lens_in_bag, self.bag),
            partial(lookup_static_transforms, self.bag), rig=rig, camera=camera, info=info, rows=rows,
        )  # fmt: skip
        self.frame, camera, builder = self._pictures.frame, self._pictures.camera, self._pictures.builder
        self.lens = camera if camera is not None and camera.known else None
        self.unseen, self.view = builder.unseen, builder.view
        self.count = self.bag.counts[self.topics[0]]

    def pictures(self) -> Iterator[tuple[float, Callable[[], np.ndarray]]]:
        """Stamp of each picture, in order of time, and what gives the frame or raises `ImageError`."""
        newest: list[Any] = [None] * len(self.topics)
        self.dropped = self.back = 0
        for stamp, lens, received in heapq.merge(*map(self._of, range(len(self.topics)))):
            newest[lens] = received
            if not lens and None not in newest:  # those of the first topic go with the others' newest
                yield stamp, partial(self._pictures.made, tuple(newest))

    def _of(self, lens: int) -> Iterator[tuple[float, int, Any]]:
        """Stamp, number and message of one topic, whose stamps rise."""
        last, told, topic = -math.inf, False, self.topics[lens]
        for when, _, _, received in self.bag.messages([topic]):
            stamp = _stamp(received, when)
            if stamp_of(received) <= 0 and not told:
                told = True
                text = f"{topic} tells no times (its headers have the stamp 0): those of the recording are taken"
                warnings.warn(text, UserWarning, stacklevel=1)  # the frame above is heapq's
            if stamp > last:
                last = stamp
                yield stamp, lens, received
                continue
            self.dropped += 1  # sent twice, or out of order
            if stamp < last and not self.back:
                text = f"the stamps of {topic} go back by {last - stamp:.2f} s at {last:.3f} s: its pictures are left "
                warnings.warn(f"{text}out until they have passed that", UserWarning, stacklevel=1)
            self.back += stamp < last


def _stamp(received: Any, when: float) -> float:
    return stamp_of(received) if stamp_of(received) > 0 else when


class BagPoses:
    """A `PoseSource` that plays the odometry of a bag; each iteration begins at its start.

    `topic`, `camera`: as for `PoseReader`. The fixed transforms of the whole bag are known from the beginning; poses
    before one that moves are left out, if it comes within `SETTLING`. Where none tells where the camera is, its axes
    are taken for those of the messages, which is a `problem`. `dropped`: messages that hold no pose. Raises
    `FormatError`, `PoseError`.
    """

    live = False

    def __init__(self, bag: Bag | str | Path, topic: str | None = None, *, camera: str | None = None) -> None:
        self.bag, self.camera = bag if isinstance(bag, Bag) else Bag(bag), camera
        self.topic, self.kind = pick(self.bag.topics, MOTION, topic, where=str(self.bag.path), option="--odom-topic")
        self.dropped, self._first, self._closed = 0, "", False
        self.reader = PoseReader(self.topic, self.kind, camera=camera)

    @property
    def problem(self) -> str | None:
        """What is missing, in words, or None."""
        return self.reader.problem

    def __iter__(self) -> Iterator[Pose]:
        came = False
        for strict in (True, False):
            for pose in self._played(strict):
                came = True
                yield pose
            if came or self._closed:
                return
        why = self.reader.problem or "it has no message"
        if self.dropped:
            why = f"all {self.dropped} messages are left out; the first: {self._first}"
        raise PoseError(f"{self.bag.path}: {self.topic} gives no pose: {why}")

    def _played(self, strict: bool) -> Iterator[Pose]:
        """The poses; with `strict` none unless one is known in time."""
        self.reader = PoseReader(self.topic, self.kind, camera=self.camera, strict=strict)
        if self.bag.topics.get(TF_STATIC) == TRANSFORMS:
            for _, _, _, received in self.bag.messages([TF_STATIC]):
                self.reader.transforms(received, True)
        self.dropped, ends = 0, math.inf
        for when, topic, _, received in self.bag.messages({self.topic} | ({TF} & self.bag.topics.keys())):
            ends = min(ends, when + SETTLING)
            if self._closed or (strict and when > ends):
                return
            try:
                own = topic == self.topic
                for pose in self.reader.take(received) if own else self.reader.transforms(received, False):
                    strict = False
                    yield pose
            except PoseError as error:
                if not self._first:
                    self._first = str(error)
                    warnings.warn(f"a pose of {self.topic} is left out: {error}", UserWarning, stacklevel=3)
                self.dropped += 1
            except DeviceError as error:
                raise FormatError(f"{self.bag.path}: {error}") from error

    def close(self) -> None:
        self._closed = True


def bag_odometry(bag: Bag, topic: str | None, frame: str | None) -> BagPoses | None:
    """The odometry of a bag, as poses of the camera whose `frame` it is; None if no topic is named and it has none."""
    if topic is None and not any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items()):
        return None
    return BagPoses(bag, topic, camera=frame)
