"""Cameras and odometry on topics: of a running ROS 2 system, or of a recorded bag."""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import DeviceError, EagorError, FormatError, PoseError, TimeError
from eagor.media import Frame, Pose
from eagor.media.bags import Bag, split_bag
from eagor.media.intrinsics import Camera
from eagor.media.rigs import Rig
from eagor.media.ros_messages import TRANSFORMS, stamp_of
from eagor.robots.ros.graph import (
    MOTION,
    PICTURES,
    TF,
    TF_STATIC,
    WAITING,
    Graph,
    GraphReader,
    TopicPictures,
    find_topic,
    joined,
    pick,
    told_in_bag,
    told_on_graph,
)
from eagor.robots.ros.odometry import BACK, BODY, PoseReader

__all__ = ["BagCamera", "BagPoses", "RosCamera", "RosPoses", "apart", "bag_odometry"]

FIRST = 10.0  # seconds in which the first message has to come
SETTLING = 1.0  # seconds for transforms that were said before to come, once a topic is found
LATEST = 4000  # poses that wait to be taken: ten seconds at 400 per second
BEFORE = 0.2  # seconds of poses from before anybody asks: pictures that wait are not older
COUNTED = 1.0  # seconds between two looks at who writes the odometry


class RosCamera:
    """A `CameraSource`: an Image or CompressedImage topic; None is the only one that there is.

    Stamps are those of the headers, which are times of capture, less the `latency` (for drivers that stamp later). A
    header without a time is said once; the time of arrival less the latency takes its place. Only the newest picture is
    kept, and decoded when it is asked for; `dropped` counts the others, and those that were damaged.

    `rows`: the most rows of a panorama; `rate`: the most pictures per second; `rig`: the lenses, if the topic has their
    pictures; `camera`: of an ordinary one. `info`: the topic of its CameraInfo; None: where the pictures are not 2:1,
    and nothing else tells their lens, ``camera_info`` beside them. `domain`: None is that of the environment; `graph`:
    a graph to use instead of an own one; `now`: a clock to use instead of this machine's; `ended` says whether nobody
    waits for a picture any more. `frame`: the frame that the pictures name. `problem`: what is wrong now, or None.
    Raises `DeviceError` if there is no such topic or no picture comes, `ImageError` for pictures that are no panoramas.
    """

    live = True
    keeps_newest = True

    def __init__(
        self,
        topic: str | None = None,
        *,
        domain: int | None = None,
        interface: str | None = None,
        latency: float = 0.0,
        rows: int | None = None,
        rig: Rig | None = None,
        camera: Camera | None = None,
        info: str | None = None,
        rate: float | None = None,
        graph: Graph | None = None,
        wait: float = FIRST,
        ended: Callable[[], bool] = lambda: False,
        now: Callable[[], float] | None = None,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to the stamp, 0 or more")
        asked, self._graph, self._own = joined(topic, domain, interface, graph)
        self.latency, self.problem, self._now = latency, None, now
        self._apart = apart(rate)
        self._changed = threading.Condition()
        self._newest: tuple[Any, float] | None = None
        self._closed, self._dropped = False, 0
        self._last, self._said = -math.inf, set[str]()
        self._reader: GraphReader | None = None
        try:
            self.topic, self.kind, _ = find_topic(self._graph, PICTURES, asked, option="--image-topic", ended=ended)
            self._reader = self._graph.subscribe(self.topic, self.kind, self._received, depth=5)
            self._pictures = TopicPictures(
                self._first(wait, ended), self.topic, rows, rig, camera, info,
                lambda: told_on_graph(self._graph, self.topic, info, wait, ended),
            )  # fmt: skip
        except BaseException:
            self.close()
            raise
        self.frame = self._pictures.frame
        self.grid, self.unseen = self._pictures.panoramas.grid, self._pictures.panoramas.unseen

    @property
    def dropped(self) -> int:
        return self._dropped

    def __iter__(self) -> Iterator[Frame]:
        while (taken := self._take()) is not None:
            received, when = taken
            try:
                stamp = self._stamp(received, when)
                panorama = self._pictures.panorama(received, ": another camera or mode? Set it back, or start again")
            except EagorError as error:
                self._dropped += 1
                self.problem = f"{self.topic}: a picture is left out: {error}"
                self._warn(self.problem)
                continue
            if self._last - BACK <= stamp <= self._last:  # sent twice, or out of order
                self._dropped += 1
                continue
            if 0 < stamp - self._last < self._apart:
                continue
            self._last, self.problem = stamp, None
            yield Frame(stamp, panorama, f"{self.topic} at {stamp:.3f} s", self._pictures.panoramas.view)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._reader is not None:
            self._reader.close()
        if self._own is not None:
            self._own.close()

    def _received(self, message: Any, when: float) -> None:
        with self._changed:
            self._dropped += self._newest is not None
            self._newest = message, when if self._now is None else self._now()
            self._changed.notify_all()

    def _first(self, wait: float, ended: Callable[[], bool]) -> Any:
        """The first picture; it is not taken away."""
        with self._changed:
            _wait(self._changed, lambda: self._newest is not None, wait, ended)
            if self._newest is not None:
                return self._newest[0]
        writers = 0 if self._reader is None else self._reader.writers
        raise DeviceError(
            f"no picture came on {self.topic} within {wait:g} s from its {writers} publishers; is the camera running, "
            "and does its size pass the network (prefer CompressedImage)?"
        )

    def _take(self) -> tuple[Any, float] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._closed)
            taken, self._newest = self._newest, None
            return None if self._closed else taken

    def _stamp(self, received: Any, when: float) -> float:
        stamp = stamp_of(received)
        if stamp > 0:
            return stamp - self.latency
        self._warn(
            f"{self.topic} tells no times (its headers have the stamp 0): each picture is stamped with its arrival "
            f"less the latency ({self.latency:g} s), and carries the jitter of its way"
        )
        return when - self.latency

    def _warn(self, text: str) -> None:
        """Once for each kind of trouble."""
        if text[:60] not in self._said:
            self._said.add(text[:60])
            warnings.warn(text, UserWarning, stacklevel=3)


class RosPoses:
    """A `PoseSource`: Odometry, PoseStamped, the orientation of an Imu, or the transforms of /tf (`PoseReader`).

    `topic`: None is the only one of its kind, odometry first. `camera`, `body`, `world`, `strict`: as for `PoseReader`;
    /tf_static and /tf are always read. Otherwise as `RosCamera`. Raises `DeviceError` if there is no such topic, if two
    publishers write it, or if nothing comes.
    """

    live = True

    def __init__(
        self,
        topic: str | None = None,
        *,
        camera: str | None = None,
        body: str = BODY,
        world: str | None = None,
        strict: bool = False,
        domain: int | None = None,
        interface: str | None = None,
        graph: Graph | None = None,
        wait: float = FIRST,
        ended: Callable[[], bool] = lambda: False,
    ) -> None:
        asked, self._graph, self._own = joined(topic, domain, interface, graph)
        self._changed = threading.Condition()
        self._poses: deque[Pose] = deque(maxlen=LATEST)
        self._error: DeviceError | None = None
        self._closed, self._counted, self.dropped = False, 0.0, 0
        self._readers: list[GraphReader] = []
        self._main: GraphReader | None = None  # messages come before it is there
        try:
            self.topic, self.kind, writers = find_topic(self._graph, MOTION, asked, option="--odom-topic", ended=ended)
            self._check_alone(writers)
            self.reader = PoseReader(
                self.topic, self.kind, camera=camera, body=body, world=world, strict=strict, rewinds=True
            )
            subscribe = self._graph.subscribe
            self._readers.append(
                subscribe(TF_STATIC, TRANSFORMS, partial(self._moved, True), reliable=True, depth=100, transient=True)
            )
            if self.kind != TRANSFORMS:
                self._readers.append(subscribe(TF, TRANSFORMS, partial(self._moved, False), depth=100))
                self._settle(ended)
            self._main = subscribe(self.topic, self.kind, self._received, depth=100)
            self._readers.append(self._main)
            self._wait_for_first(wait, ended)
            if self._own is not None and self.problem is not None:  # otherwise the graph's owner tells it
                warnings.warn(self.problem, UserWarning, stacklevel=2)
        except BaseException:
            self.close()
            raise

    @property
    def problem(self) -> str | None:
        """What is wrong now, in words, or None."""
        return self.reader.problem

    def body_R_camera(self, stamp: float) -> np.ndarray:
        """The rotation ``(3, 3)`` of the camera's axes in those of the body."""
        with self._changed:
            return self.reader.body_R_camera(stamp)

    def __iter__(self) -> Iterator[Pose]:
        with self._changed:  # what has waited for long came late for its clock, it would seem
            while self._poses and self._poses[0].stamp < self._poses[-1].stamp - BEFORE:
                self._poses.popleft()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._poses or self._closed or self._error)
                if self._closed:
                    return
                if self._error is not None:
                    raise self._error
                pose = self._poses.popleft()
            yield pose

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for reader in self._readers:
            reader.close()
        if self._own is not None:
            self._own.close()

    def _moved(self, fixed: bool, message: Any, _: float) -> None:
        self._take(lambda: self.reader.transforms(message, fixed))

    def _received(self, message: Any, _: float) -> None:
        self._take(lambda: self.reader.take(message))
        now = time.monotonic()
        if now - self._counted > COUNTED and self._main is not None:
            self._counted = now
            try:
                self._check_alone(self._main.writers)
            except DeviceError as error:
                self._fail(error)

    def _take(self, what: Any) -> None:
        try:
            with self._changed:
                self._poses.extend(what())
                self._changed.notify_all()
        except DeviceError as error:
            self._fail(error)
        except EagorError as error:
            self.dropped += 1
            if self.dropped == 1:
                warnings.warn(f"a pose of {self.topic} is left out: {error}", UserWarning, stacklevel=2)

    def _fail(self, error: DeviceError) -> None:
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def _check_alone(self, writers: int) -> None:
        if writers > 1 and self.kind != TRANSFORMS:  # many nodes write /tf, each its own frames
            raise DeviceError(
                f"{writers} publishers write {self.topic}, and their poses would be mixed; stop all but one "
                f"(ros2 topic info -v {self.topic} names them), or take another topic with --odom-topic"
            )

    def _settle(self, ended: Callable[[], bool]) -> None:
        """Wait for the fixed transforms, if anybody tells them."""
        end = time.monotonic() + SETTLING
        while time.monotonic() < end and not (self.reader.tree.frames or ended()):
            time.sleep(0.02)

    def _wait_for_first(self, wait: float, ended: Callable[[], bool]) -> None:
        with self._changed:
            _wait(self._changed, lambda: bool(self._poses or self._error), wait, ended)
            if self._error is not None:
                raise self._error
            if self._poses:
                return
        told = self.reader.problem or "are its stamps set, and does it run?"
        raise DeviceError(f"no pose came on {self.topic} within {wait:g} s: {told}")


def _wait(news: threading.Condition, what: Callable[[], bool], seconds: float, ended: Callable[[], bool]) -> None:
    """Wait until `what` is true, for so many seconds, or until `ended` is."""
    end = time.monotonic() + seconds
    while not (what() or ended()) and (left := end - time.monotonic()) > 0:
        news.wait(min(left, WAITING))


def apart(rate: float | None) -> float:
    """Seconds between two pictures of so many per second, a little less for rounding. Raises `TimeError`."""
    if rate is not None and not (math.isfinite(rate) and rate > 0):
        raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
    return 0.0 if rate is None else 0.99 / rate


class BagCamera:
    """A `CameraSource` that plays the pictures of a bag; each iteration begins at its start.

    `topic`: None is the only one with pictures; or `bag` is the text ``BAG?topic=/image``. Stamps are those of the
    headers less the `latency`; where a header has none, the time of recording. `rate`: the most pictures per second.
    `count`: how many pictures there are; `frame`: the frame that they name; `lens`: the ordinary camera, if it is one;
    `view`: the grid of its pictures, None where they become panoramas. Otherwise as `RosCamera`. Raises `FormatError`
    for the bag or topic, `ImageError` for the pictures.
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
        camera: Camera | None = None,
        info: str | None = None,
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
        self._pictures = TopicPictures(
            first[3], f"{self.topic} of {bag}", rows, rig, camera, info,
            lambda: told_in_bag(self.bag, self.topic, info),
        )  # fmt: skip
        self.frame, camera, made = self._pictures.frame, self._pictures.camera, self._pictures.panoramas
        self.lens = camera if camera is not None and camera.known else None
        self.grid, self.unseen, self.view = made.grid, made.unseen, made.view

    def __iter__(self) -> Iterator[Frame]:
        for stamp, read in self.pictures():
            try:
                panorama = read()
            except EagorError as error:
                if not self.dropped:
                    warnings.warn(f"a picture of {self.topic} is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            yield Frame(stamp, panorama, f"{self.topic} at {stamp:.3f} s", self.view)

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
            yield stamp, lambda received=received: self._pictures.panorama(received)

    def close(self) -> None:
        self._closed = True

    def _stamp(self, received: Any, when: float) -> float:
        stamp = stamp_of(received)
        return (stamp if stamp > 0 else when) - self.latency


class BagPoses:
    """A `PoseSource` that plays the odometry of a bag; each iteration begins at its start.

    `topic`, `camera`, `body`, `world`, `strict`: as for `RosPoses`. The fixed transforms of
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
