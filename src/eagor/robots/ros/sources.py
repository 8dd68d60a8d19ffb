"""Cameras on topics: of a running ROS 2 system, or of a recorded bag."""

from __future__ import annotations

import heapq
import math
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eagor.errors import DeviceError, EagorError, FormatError, TimeError
from eagor.media import Frame
from eagor.media.bags import Bag, split_bag
from eagor.media.intrinsics import Camera
from eagor.media.rigs import Rig
from eagor.media.ros_messages import stamp_of
from eagor.robots.ros.graph import PICTURES, WAITING, DdsGraph, Graph, GraphReader, find_topic, joined, pick
from eagor.robots.ros.odometry import BACK
from eagor.robots.ros.pictures import (
    Lenses,
    TopicPictures,
    placed_in_bag,
    placed_on_graph,
    told_in_bag,
    told_on_graph,
    topics_of,
)

__all__ = ["BagCamera", "RosCamera", "apart", "wait_for"]

FIRST = 10.0  # seconds in which the first message has to come
SILENT = 2.0  # seconds without a picture of one of several cameras that are worth a word
TOGETHER = 0.1  # seconds by which pictures that are stitched may differ before it is said
OPTION = "--image-topic"


class TopicSource:
    """What sources of topics share: a graph, an own one or one that is given, and the readers of the topics."""

    def __init__(self, graph: Graph, own: DdsGraph | None) -> None:
        self._graph, self._own = graph, own
        self._changed, self._closed = threading.Condition(), False
        self._readers: list[GraphReader] = []

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for reader in self._readers:
            reader.close()
        if self._own is not None:
            self._own.close()


class RosCamera(TopicSource):
    """A `CameraSource`: an Image or CompressedImage topic; None is the only one that there is.

    Several topics with commas between are those of cameras that are fixed to each other. The `rig` has their lenses, or
    each one's CameraInfo and ``/tf_static`` tell them. Pictures of ordinary lenses come as they are, each camera in its
    turn, unless they are to be `stitched`; one that falls silent leaves the others.

    Stamps are those of the headers, which are times of capture, less the `latency` (for drivers that stamp later). A
    header without a time is said once; the time of arrival less the latency takes its place. Only the newest picture is
    kept, and decoded when it is asked for; `dropped` counts the others, and those that were damaged.

    `rows`: the most rows of a panorama; `rate`: the most pictures per second; `rig`: the lenses, if the topics have
    their pictures; `camera`: of an ordinary one. `info`: the topic of its CameraInfo; None: where the pictures are not
    2:1, and nothing else tells their lens, ``camera_info`` beside them. `domain`: None is that of the environment;
    `graph`: a graph to use instead of an own one; `now`: a clock to use instead of this machine's; `ended` says whether
    nobody waits for a picture any more. `frame`: as of `TopicPictures`. `problem`: what is wrong now, or None.
    Raises `DeviceError` if there is no such topic or no picture comes, `ImageError` for pictures that are no panoramas,
    and as `TopicPictures`.
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
        stitched: bool = False,
        graph: Graph | None = None,
        wait: float = FIRST,
        ended: Callable[[], bool] = lambda: False,
        now: Callable[[], float] | None = None,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to the stamp, 0 or more")
        asked, shared, own = joined(topic, domain, interface, graph)
        super().__init__(shared, own)
        self.latency, self._problem, self._now = latency, None, now
        self._apart = apart(rate)
        self._dropped, self._said = 0, set[str]()
        try:
            found = [
                find_topic(self._graph, PICTURES, each, option=OPTION, ended=ended) for each in topics_of(asked, OPTION)
            ]
            self.topics, self.kind = tuple(name for name, _, _ in found), found[0][1]
            self.topic, count = ",".join(self.topics), len(found)
            self._newest: list[tuple[Any, float] | None] = [None] * count
            self._fresh, self._heard, self._last = [False] * count, [time.monotonic()] * count, [-math.inf] * count
            self._turn = [*range(count)]  # the cameras, that which waited longest first
            for at, (name, kind, _) in enumerate(found):
                self._readers.append(self._graph.subscribe(name, kind, partial(self._received, at), depth=5))
            self._pictures = TopicPictures(
                self._firsts(wait, ended), self.topics, Lenses(rig, camera, info, rows, stitched),
                lambda image, told: told_on_graph(self._graph, image, told, wait, ended),
                lambda frames: placed_on_graph(self._graph, frames, ended=ended),
            )  # fmt: skip
        except BaseException:
            self.close()
            raise
        self.frame, first = self._pictures.frame, self._pictures.makers[0]
        self.grid, self.unseen = first.grid, first.unseen
        if self._pictures.together:
            self._turn = [0]  # the others are taken with it

    @property
    def dropped(self) -> int:
        return self._dropped

    @property
    def problem(self) -> str | None:
        """What is wrong now, in words; None if nothing is."""
        if self._problem is not None or len(self.topics) == 1:
            return self._problem
        silent = [time.monotonic() - heard for heard in self._heard]
        if max(silent) <= SILENT or min(silent) > SILENT:  # all of them: then the loop says it
            return None
        return f"no picture on {self.topics[silent.index(max(silent))]} for {max(silent):.0f} s"

    def __iter__(self) -> Iterator[Frame]:
        while (taken := self._take()) is not None:
            lens, messages = taken
            topic = self.topics[lens]
            try:
                stamps = [self._stamp(at, *each) for at, each in enumerate(messages, lens)]
                received = [message for message, _ in messages]
                picture = self._pictures.made(lens, received, ": another camera or mode? Set it back, or start again")
            except EagorError as error:
                self._dropped += 1
                self._problem = f"{topic}: a picture is left out: {error}"
                self._warn(self._problem)
                continue
            stamp, last = stamps[0], self._last[lens]
            if last - BACK <= stamp <= last:  # sent twice, or out of order
                self._dropped += 1
                continue
            if 0 < stamp - last < self._apart:
                continue
            while stamp in self._last:  # of another camera: no two frames have one stamp
                stamp = math.nextafter(stamp, math.inf)
            self._last[lens], self._problem = stamp, None
            if (differ := max(stamps) - min(stamps)) > TOGETHER:
                self._problem = f"{self.topic}: the pictures that are stitched are {differ:.2f} s apart"
            yield Frame(stamp, picture, f"{topic} at {stamp:.3f} s", self._pictures.makers[lens].view, lens)

    def _received(self, lens: int, message: Any, when: float) -> None:
        with self._changed:
            self._dropped += self._fresh[lens] and lens in self._turn
            self._newest[lens] = message, when if self._now is None else self._now()
            self._fresh[lens], self._heard[lens] = True, time.monotonic()
            self._changed.notify_all()

    def _firsts(self, wait: float, ended: Callable[[], bool]) -> list[Any]:
        """The first picture of each topic; none is taken away."""
        with self._changed:
            wait_for(self._changed, lambda: None not in self._newest, wait, ended)
            if None not in self._newest:
                return [each[0] for each in self._newest if each is not None]
            silent = self._newest.index(None)
        writers = self._readers[silent].writers
        raise DeviceError(
            f"no picture came on {self.topics[silent]} within {wait:g} s from its {writers} publishers; is the camera "
            "running, and does its size pass the network (prefer CompressedImage)?"
        )

    def _take(self) -> tuple[int, list[tuple[Any, float]]] | None:
        """Wait for a picture: which camera's, and the messages that make the frame. None after `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or any(self._fresh[each] for each in self._turn))
            if self._closed:
                return None
            lens = next(each for each in self._turn if self._fresh[each])
            self._turn.remove(lens)
            self._turn.append(lens)
            self._fresh[lens] = False
            wanted = self._newest if self._pictures.together else [self._newest[lens]]
            return lens, [each for each in wanted if each is not None]

    def _stamp(self, lens: int, received: Any, when: float) -> float:
        stamp = stamp_of(received)
        if stamp > 0:
            return stamp - self.latency
        self._warn(
            f"{self.topics[lens]} tells no times (its headers have the stamp 0): each picture is stamped with its "
            f"arrival less the latency ({self.latency:g} s), and carries the jitter of its way"
        )
        return when - self.latency

    def _warn(self, text: str) -> None:
        """Once for each kind of trouble."""
        if text[:60] not in self._said:
            self._said.add(text[:60])
            warnings.warn(text, UserWarning, stacklevel=3)


def wait_for(news: threading.Condition, what: Callable[[], bool], seconds: float, ended: Callable[[], bool]) -> None:
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

    `topic`: None is the only one with pictures, and several have commas between, as for `RosCamera`; or `bag` is the
    text ``BAG?topic=/image``. Stamps are those of the headers less the `latency`; where a header has none, the time of
    recording. `rate`: the most pictures per second of each topic. `back`: of the `dropped`, how many had stamps that go
    back, which is said once. `count`: how many pictures there are; `frame`: as of
    `TopicPictures`; `lens`: the ordinary camera, if it is one; `views`: the grid of each camera's pictures, None where
    they become panoramas. Otherwise as `RosCamera`. Raises `FormatError` for the bag or topic, and as `TopicPictures`.
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
        stitched: bool = False,
    ) -> None:
        self._apart = apart(rate)
        if isinstance(bag, str) and topic is None:
            bag, topic = split_bag(bag)
        self.bag = bag if isinstance(bag, Bag) else Bag(bag)
        self.latency, self.dropped, self.back, self.problem = latency, 0, 0, None
        self._closed = False
        where = str(self.bag.path)
        found = [pick(self.bag.topics, PICTURES, each, where=where, option=OPTION) for each in topics_of(topic, OPTION)]
        self.topics, self.kind = tuple(name for name, _ in found), found[0][1]
        self.topic = ",".join(self.topics)
        firsts = [self._first(each) for each in self.topics]
        self.begins = min(self._stamp(received, when) for when, received in firsts)
        self._pictures = TopicPictures(
            [received for _, received in firsts], self.topics, Lenses(rig, camera, info, rows, stitched),
            lambda image, told: told_in_bag(self.bag, image, told),
            lambda frames: placed_in_bag(self.bag, frames),
        )  # fmt: skip
        self.frame, camera, makers = self._pictures.frame, self._pictures.camera, self._pictures.makers
        self.lens = camera if camera is not None and camera.known else None
        self.grid, self.unseen, self.views = makers[0].grid, makers[0].unseen, tuple(each.view for each in makers)
        self.count = sum(self.bag.counts[each] for each in self.topics[: len(makers)])

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for stamp, lens, read in self.pictures():
            topic = self.topics[lens]
            try:
                picture = read()
            except EagorError as error:
                if not self.dropped:
                    warnings.warn(f"a picture of {topic} is left out: {error}", UserWarning, stacklevel=2)
                self.dropped += 1
                continue
            last = max(stamp, math.nextafter(last, math.inf))  # cameras may see at the same moment
            yield Frame(last, picture, f"{topic} at {stamp:.3f} s", self.views[lens], lens)

    def pictures(self) -> Iterator[tuple[float, int, Callable[[], np.ndarray]]]:
        """Stamp of each picture, in order of time, which camera's, and what gives the frame or raises `ImageError`."""
        newest: list[Any] = [None] * len(self.topics)
        together, after = self._pictures.together, [-math.inf] * len(self.topics)
        for stamp, lens, received in heapq.merge(*map(self._of, range(len(self.topics)))):
            newest[lens] = received
            if together and (lens or None in newest):  # those of the first topic are stitched with the others' newest
                continue
            if stamp < after[lens]:
                continue
            after[lens] = stamp + self._apart
            taken = tuple(newest) if together else (received,)
            yield stamp, lens, partial(self._pictures.made, lens, taken)

    def close(self) -> None:
        self._closed = True

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
            if self._closed:
                return
            stamp = self._stamp(received, when)
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

    def _stamp(self, received: Any, when: float) -> float:
        stamp = stamp_of(received)
        return (stamp if stamp > 0 else when) - self.latency
