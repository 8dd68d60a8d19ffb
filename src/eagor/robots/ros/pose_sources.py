"""Odometry on topics: of a running ROS 2 system, or of a recorded bag."""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import DeviceError, EagorError, FormatError, PoseError
from eagor.media import Pose
from eagor.media.bags import Bag
from eagor.media.ros_messages import TRANSFORMS
from eagor.robots.ros.graph import MOTION, TF, TF_STATIC, Graph, GraphReader, find_topic, joined, pick
from eagor.robots.ros.odometry import BODY, PoseReader
from eagor.robots.ros.sources import FIRST, TopicSource, wait_for

__all__ = ["BagPoses", "RosPoses", "bag_odometry"]

SETTLING = 1.0  # seconds for transforms that were said before to come, once a topic is found
LATEST = 4000  # poses that wait to be taken: ten seconds at 400 per second
BEFORE = 0.2  # seconds of poses from before anybody asks: pictures that wait are not older
COUNTED = 1.0  # seconds between two looks at who writes the odometry


class RosPoses(TopicSource):
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
        asked, shared, own = joined(topic, domain, interface, graph)
        super().__init__(shared, own)
        self._poses: deque[Pose] = deque(maxlen=LATEST)
        self._error: DeviceError | None = None
        self._counted, self.dropped = 0.0, 0
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
            wait_for(self._changed, lambda: bool(self._poses or self._error), wait, ended)
            if self._error is not None:
                raise self._error
            if self._poses:
                return
        told = self.reader.problem or "are its stamps set, and does it run?"
        raise DeviceError(f"no pose came on {self.topic} within {wait:g} s: {told}")


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
        self.dropped, came, first = 0, False, ""
        wanted = {self.topic} | ({TF} & self.bag.topics.keys())
        for _, topic, _, received in self.bag.messages(wanted):
            if self._closed:
                return
            try:
                poses = reader.take(received) if topic == self.topic else reader.transforms(received, False)
            except PoseError as error:
                if not self.dropped:
                    first = str(error)
                    warnings.warn(f"a pose of {self.topic} is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            except DeviceError as error:
                raise FormatError(f"{self.bag.path}: {error}") from error
            came = came or bool(poses)
            yield from poses
        if not came:
            told = reader.problem or "it has no message"
            if self.dropped:
                told = f"all {self.dropped} messages are left out; the first: {first}"
            raise PoseError(f"{self.bag.path}: {self.topic} gives no pose: {told}")

    def close(self) -> None:
        self._closed = True

    def _new_reader(self) -> PoseReader:
        reader = PoseReader(self.topic, self.kind, **self._settings)
        if self.bag.topics.get(TF_STATIC) == TRANSFORMS:
            for _, _, _, received in self.bag.messages([TF_STATIC]):
                reader.transforms(received, True)
        return reader


def bag_odometry(bag: Bag, topic: str | None, frame: str | None) -> BagPoses | None:
    """The odometry of a bag, as poses of the camera whose `frame` it is; None if no topic is named and it has none."""
    if topic is None and not any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items()):
        return None
    return BagPoses(bag, topic, camera=frame)
