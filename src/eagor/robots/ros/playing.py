"""Cameras and odometry from a recorded bag."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eagor.errors import DeviceError, EagorError, FormatError, PoseError, TimeError
from eagor.media.bags.messages import TRANSFORMS, panorama_of, stamp_of
from eagor.media.bags.paths import split_bag
from eagor.media.bags.reader import Bag
from eagor.media.cameras.making import Panoramas
from eagor.media.cameras.rig import Rig
from eagor.media.frames import Frame, Pose
from eagor.robots.ros.odometry import BODY, PoseReader
from eagor.robots.ros.topics import MOTION, PICTURES, TF, TF_STATIC, pick

__all__ = ["BagCamera", "BagPoses", "apart", "bag_odometry"]


def apart(rate: float | None) -> float:
    """Seconds between two pictures of so many per second, a little less for rounding. Raises `TimeError`."""
    if rate is not None and not (math.isfinite(rate) and rate > 0):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    return 0.0 if rate is None else 0.99 / rate


class BagCamera:
    """A `CameraSource` that plays the pictures of a bag; each iteration begins at its start.

    `topic`: None is the only one with pictures; or `bag` is the text ``BAG?topic=/image``. Stamps are those of the
    headers less the `latency`; where a header has none, the time of recording. `rate`: the most pictures per second.
    `count`: how many pictures there are; `frame`: the frame that they name; otherwise as
    `eagor.robots.ros.sources.RosCamera`. Raises `FormatError` for the bag or topic, `ImageError` for the pictures.
    """

    live = False

    def __init__(
        self,
        bag: Bag | str | Path,
        topic: str | None = None,
        *,
        latency: float = 0.0,
        rows: int | None = None,
        rig: Rig | None = None,
        rate: float | None = None,
    ) -> None:
        self._apart = apart(rate)
        if isinstance(bag, str) and topic is None:
            bag, topic = split_bag(bag)
        self.bag = bag if isinstance(bag, Bag) else Bag(bag)
        self.latency, self.dropped, self.problem = latency, 0, None
        self._closed = False
        self.topic, self.kind = pick(self.bag.topics, PICTURES, topic, where=str(self.bag.path), option="--image-topic")
        self.count = self.bag.counts[self.topic]
        first = next(iter(self.bag.messages([self.topic])), None)
        if first is None:
            raise FormatError(f"{self.bag.path} has no message on {self.topic}")
        self.begins = self._stamp(first[3], first[0])
        self.frame: str = first[3].header.frame_id
        picture = panorama_of(first[3])
        self._size = picture.shape
        self._panoramas = Panoramas(((picture.shape[1], picture.shape[0]),), rig, rows, f"{self.topic} of {bag}")
        self._panoramas.check(picture)
        self.grid, self.unseen = self._panoramas.grid, self._panoramas.unseen

    def __iter__(self) -> Iterator[Frame]:
        for stamp, read in self.pictures():
            try:
                panorama = read()
            except EagorError as error:
                if not self.dropped:
                    warnings.warn(f"a picture of {self.topic} is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            yield Frame(stamp, panorama, f"{self.topic} at {stamp:.3f} s")

    def pictures(self) -> Iterator[tuple[float, Any]]:
        """Stamp of each picture, in order of time, and a function that gives the panorama or raises `ImageError`."""
        last, told = -math.inf, False
        for when, _, _, received in self.bag.messages([self.topic]):
            if self._closed:
                return
            stamp = self._stamp(received, when)
            if stamp_of(received) <= 0 and not told:
                told = True
                warnings.warn(
                    f"{self.topic} tells no times (its headers have the stamp 0): those of the recording are taken",
                    UserWarning,
                    stacklevel=2,
                )
            if stamp <= last:  # sent twice, or out of order
                self.dropped += 1
                continue
            if stamp < last + self._apart:
                continue
            last = stamp
            yield stamp, lambda received=received: self._panorama(received)

    def close(self) -> None:
        self._closed = True

    def _panorama(self, received: Any) -> Any:
        picture = panorama_of(received)
        if picture.shape != self._size:
            raise FormatError(
                f"it is {picture.shape[1]} x {picture.shape[0]}, and the first was {self._size[1]} x {self._size[0]}"
            )
        return self._panoramas.make(picture)

    def _stamp(self, received: Any, when: float) -> float:
        stamp = stamp_of(received)
        return (stamp if stamp > 0 else when) - self.latency


class BagPoses:
    """A `PoseSource` that plays the odometry of a bag; each iteration begins at its start.

    `topic`, `camera`, `body`, `world`, `strict`: as for `eagor.robots.ros.sources.RosPoses`. The fixed transforms of
    the whole bag are known from the beginning. `dropped`: messages that hold no pose. Raises `FormatError`.
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
        self._settings: dict[str, Any] = {"camera": camera, "body": body, "world": world, "strict": strict}
        self.dropped, self._closed = 0, False
        self.reader = self._new_reader()

    @property
    def problem(self) -> str | None:
        """What is missing, in words, or None."""
        return self.reader.problem

    def __iter__(self) -> Iterator[Pose]:
        self.reader = reader = self._new_reader()
        self.dropped, came = 0, False
        wanted = {self.topic} | ({TF} & self.bag.topics.keys())
        for _, topic, _, received in self.bag.messages(wanted):
            if self._closed:
                return
            try:
                poses = reader.take(received) if topic == self.topic else reader.transforms(received, False)
            except PoseError as error:
                if not self.dropped:
                    warnings.warn(f"a pose of {self.topic} is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            except DeviceError as error:
                raise FormatError(f"{self.bag.path}: {error}") from error
            came = came or bool(poses)
            yield from poses
        if not came:
            raise PoseError(f"{self.bag.path}: {self.topic} gives no pose: {reader.problem or 'it has no message'}")

    def close(self) -> None:
        self._closed = True

    def _new_reader(self) -> PoseReader:
        reader = PoseReader(self.topic, self.kind, **self._settings)
        if self.bag.topics.get(TF_STATIC) == TRANSFORMS:
            for _, _, _, received in self.bag.messages([TF_STATIC]):
                reader.transforms(received, True)
        return reader


def bag_odometry(bag: Bag, topic: str | None, camera: BagCamera) -> BagPoses | None:
    """The odometry of a bag, as poses of its camera; None if no topic is named and it has none."""
    if topic is None and not any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items()):
        return None
    return BagPoses(bag, topic, camera=camera.frame)
