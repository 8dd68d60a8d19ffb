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
from eagor.media import Pose
from eagor.media.bags import MOTION, PICTURES, TF, TF_STATIC, Bag, pick
from eagor.media.intrinsics import Camera
from eagor.media.ros_frames import BODY, PoseReader
from eagor.media.ros_messages import TRANSFORMS, stamp_of
from eagor.media.topic_pictures import Lenses, TopicPictures, lens_in_bag, placed_in_bag, topics_of

__all__ = ["BagCamera", "BagPoses", "bag_odometry"]

OPTION = "--image-topic"
SETTLING = 10.0  # seconds of a bag in which its transforms have to tell where the camera is


class BagCamera:
    """The pictures of a bag, to play from its start as often as wanted.

    `topic`: None is the only one with pictures, and several have commas between. Stamps are those of the headers; where
    a header has none, the time of recording. `dropped`: messages that were sent twice or out of order; `back`: how many
    of them had stamps that go back, which is said once. `count`: how many pictures there are; `begins`: the stamp of
    the first; `frame`: as of `TopicPictures`; `lens`: the ordinary camera, if it is one; `view`: the grid of its
    pictures, None where they become panoramas. Raises `FormatError` for the bag or topic, and as `TopicPictures`.
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
        found = [pick(self.bag.topics, PICTURES, each, where=where, option=OPTION) for each in topics_of(topic, OPTION)]
        self.topics, self.kind = tuple(name for name, _ in found), found[0][1]
        self.topic = ",".join(self.topics)
        firsts = [self._first(each) for each in self.topics]
        self.begins = min(_stamp(received, when) for when, received in firsts)
        self._pictures = TopicPictures(
            [received for _, received in firsts], self.topics, Lenses(rig, camera, info, rows),
            lambda image, told: lens_in_bag(self.bag, image, told),
            lambda frames: placed_in_bag(self.bag, frames),
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
            if lens or None in newest:  # those of the first topic go with the others' newest
                continue
            yield stamp, partial(self._pictures.made, tuple(newest))

    def _first(self, topic: str) -> tuple[float, Any]:
        """Time of recording and message."""
        first = next(iter(self.bag.messages([topic])), None)
        if first is None:
            raise FormatError(f"{self.bag.path} has no message on {topic}")
        return first[0], first[3]

    def _of(self, lens: int) -> Iterator[tuple[float, int, Any]]:
        """Stamp, number and message of one topic, whose stamps rise."""
        last, told, topic = -math.inf, False, self.topics[lens]
        for when, _, _, received in self.bag.messages([topic]):
            stamp = _stamp(received, when)
            if stamp_of(received) <= 0 and not told:
                told = True
                warnings.warn(
                    f"{topic} tells no times (its headers have the stamp 0): those of the recording are taken",
                    UserWarning,
                    stacklevel=1,  # the frame above is heapq's
                )
            if stamp <= last:  # sent twice, or out of order
                self.dropped += 1
                if stamp < last and not self.back:
                    warnings.warn(
                        f"the stamps of {topic} go back by {last - stamp:.2f} s at {last:.3f} s: its pictures are left "
                        "out until they have passed that",
                        UserWarning,
                        stacklevel=1,
                    )
                self.back += stamp < last
                continue
            last = stamp
            yield stamp, lens, received


def _stamp(received: Any, when: float) -> float:
    stamp = stamp_of(received)
    return stamp if stamp > 0 else when


class BagPoses:
    """A `PoseSource` that plays the odometry of a bag; each iteration begins at its start.

    `topic`, `camera`, `body`, `world`: as for `PoseReader`. The fixed transforms of the whole bag are known from the
    beginning; poses before one that moves are left out, if it comes within `SETTLING`. Where none tells where the
    camera is, its axes are taken for those of the messages, which is a `problem`, or (`strict`) an error. `dropped`:
    messages that hold no pose. Raises `FormatError`, `PoseError`.
    """

    live = False

    def __init__(
        self,
        bag: Bag | str | Path,
        topic: str | None = None,
        *,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
        strict: bool = False,
    ) -> None:
        self.bag = bag if isinstance(bag, Bag) else Bag(bag)
        self.topic, self.kind = pick(self.bag.topics, MOTION, topic, where=str(self.bag.path), option="--odom-topic")
        self._settings: dict[str, Any] = {"camera": camera, "body": body, "world": world}
        self._strict, self._first = strict, ""
        self.dropped, self._closed, self._came = 0, False, False
        self.reader = self._new_reader(strict)

    @property
    def problem(self) -> str | None:
        """What is missing, in words, or None."""
        return self.reader.problem

    def __iter__(self) -> Iterator[Pose]:
        told = ""
        for strict in (True,) if self._strict else (True, False):
            self._came = False
            for pose in self._played(strict):
                self._came = True
                yield pose
            if self._came or self._closed:
                return
            told = self.reader.problem or "it has no message"
            if self.dropped:
                told = f"all {self.dropped} messages are left out; the first: {self._first}"
        raise PoseError(f"{self.bag.path}: {self.topic} gives no pose: {told}")

    def _played(self, strict: bool) -> Iterator[Pose]:
        self.reader, self.dropped, begun = self._new_reader(strict), 0, math.inf
        for when, topic, _, received in self.bag.messages({self.topic} | ({TF} & self.bag.topics.keys())):
            begun = min(begun, when)
            if self._closed or (strict and not (self._strict or self._came) and when > begun + SETTLING):
                return
            try:
                own = topic == self.topic
                yield from self.reader.take(received) if own else self.reader.transforms(received, False)
            except PoseError as error:
                if not self.dropped and not self._first:
                    self._first = str(error)
                    warnings.warn(f"a pose of {self.topic} is left out: {error}", UserWarning, stacklevel=3)
                self.dropped += 1
            except DeviceError as error:
                raise FormatError(f"{self.bag.path}: {error}") from error

    def close(self) -> None:
        self._closed = True

    def _new_reader(self, strict: bool) -> PoseReader:
        reader = PoseReader(self.topic, self.kind, strict=strict, **self._settings)
        if self.bag.topics.get(TF_STATIC) == TRANSFORMS:
            for _, _, _, received in self.bag.messages([TF_STATIC]):
                reader.transforms(received, True)
        return reader


def bag_odometry(bag: Bag, topic: str | None, frame: str | None) -> BagPoses | None:
    """The odometry of a bag, as poses of the camera whose `frame` it is; None if no topic is named and it has none."""
    if topic is None and not any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items()):
        return None
    return BagPoses(bag, topic, camera=frame)
