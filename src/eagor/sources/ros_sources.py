"""Pictures and odometry of ROS 2 topics: how messages become frames, live or from a bag, and what a bag plays.

By the rule of ``image_transport``, the CameraInfo of ``/ns/image_raw`` is on ``/ns/camera_info``, one with each
picture. Some drivers send it once, for whoever comes later (transient local). Where several cameras are fixed to each
other, ``/tf_static`` tells how.
"""

from __future__ import annotations

import heapq
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor.cameras import Lens, Rig
from eagor.errors import DeviceError, FormatError, PoseError
from eagor.grids import PerspectiveGrid
from eagor.sources import Pose
from eagor.sources.bags import TF, TF_STATIC, Bag, pick
from eagor.sources.intrinsics import Camera, rig_of_info
from eagor.sources.ros_frames import BODY, PoseReader, TransformTree, contradiction, optical
from eagor.sources.ros_messages import CAMERA_INFO, MOTION, PICTURES, TRANSFORMS, image_from_msg, stamp_of, taken_as
from eagor.sources.stitching import PanoramaBuilder, sizes_of

__all__ = [
    "BagCamera", "BagPoses", "ImageTopics", "bag_odometry", "beside", "lens_in_bag", "lens_of_info",
    "lookup_static_transforms", "placed", "topics_of",
]  # fmt: skip

IMAGE_OPTION, INFO_OPTION = "--image-topic", "--camera-info"
RECTIFIED = "image_rect"  # image_rect, image_rect_color: what image_proc publishes
Info = tuple[Camera, str]  # the camera that a CameraInfo tells, and the frame that its header names
STUCK = 3  # pictures more with the stamp of one before: none that was sent twice
BEGUN = 60.0  # seconds within which the second picture comes of a clock that begins at 0, as in simulation
SETTLING = 10.0  # seconds of a bag in which its transforms have to tell where the camera is


def topics_of(text: str | None, option: str) -> tuple[str | None, ...]:
    """The topics in a text, with commas between; (None,) without one. Raises `FormatError` for one that is empty."""
    found = (None,) if text is None else tuple(part.strip() for part in text.split(","))
    if "" in found:
        raise FormatError(f"{option} {text}: a topic between two commas is empty; wanted /front/image,/back/image")
    return found


def beside(image_topic: str) -> str:
    """The topic of the CameraInfo of a topic of pictures, compressed ones as well."""
    return f"{image_topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info"


class ImageTopics:
    """How the messages of `topics`, one for each camera, become frames; the `firsts` of them, and the lenses, say it.

    A topic alone gives panoramas, or an ordinary camera's pictures; several are a rig, which is stitched. Known before:
    the `rig` of all, an ordinary `camera`, which each of the topics is, or `info`: the topics of their CameraInfo, with
    commas between. Else `told(topic, info)`, what a CameraInfo says, and `placed(frames)`, as `placed`, are asked.
    `rows`: the most of a frame.

    `camera`: as it is then known, of a topic alone. `frame`: that whose axes the frames' grids are in, as the (first)
    camera's pictures name it; None: the body's. `builder`: what makes the frames. Raises `ImageError` for pictures that
    are no panoramas, or do not fit the rig, `FormatError` for messages that tell too little.
    """

    def __init__(
        self,
        firsts: Sequence[Any],
        topics: Sequence[str],
        told: Callable[[str, str | None], Info | None],
        placed: Callable[[Sequence[str]], Sequence[np.ndarray]],
        *,
        rig: Rig | None = None,
        camera: Camera | None = None,
        info: str | None = None,
        rows: int | None = None,
    ) -> None:
        pictures = [image_from_msg(each) for each in firsts]
        for topic, each in zip(topics, firsts, strict=True):
            if (how := taken_as(each)) is not None:
                warnings.warn(f"{topic}: {how}", UserWarning, stacklevel=3)
        infos = topics_of(info, INFO_OPTION) if info is not None else (None,) * len(topics)
        if len(infos) != len(topics):
            given = f"{INFO_OPTION} {info} names {len(infos)} topics, and {len(topics)} have pictures"
            raise FormatError(f"{given}; wanted one for each, in their order")
        self._sizes, self.camera, self.frame = sizes_of(pictures), camera, None
        known = camera is not None and camera.known
        if len(topics) > 1:
            self.camera = None
            if rig is None:
                found = [(camera, "") if camera and known else told(*each) for each in zip(topics, infos, strict=True)]
                rig, self.frame = self._rig(topics, firsts, found, placed)
        else:
            self.frame = str(firsts[0].header.frame_id)
            if infos[0] is not None or not (known or rig or is_twice_as_wide(*pictures[0].shape[:2])):
                self.camera, frame = told(topics[0], infos[0]) or (camera, "")
                self.frame = self.frame or frame
        self.builder = PanoramaBuilder(self._sizes, ", ".join(topics), rig=rig, camera=self.camera, rows=rows)
        self.builder.check(*pictures)

    def made(self, received: Sequence[Any], otherwise: str = "") -> np.ndarray:
        """The frame of the messages of all topics. Raises `ImageError`; `FormatError` for another size."""
        pictures = [image_from_msg(each) for each in received]
        for (width, height), (wide, high) in zip(sizes_of(pictures), self._sizes, strict=True):
            if (width, height) != (wide, high):
                raise FormatError(f"it is {width} x {height}, and the first was {wide} x {high}{otherwise}")
        return self.builder.make(*pictures)

    def _rig(self, topics: Any, firsts: Any, found: Sequence[Info | None], placed: Any) -> tuple[Rig, str]:
        """The rig of several cameras, in the axes of the first, and the frame of that."""
        frames, lenses = [], list[Lens]()
        for topic, first, info, size in zip(topics, firsts, found, self._sizes, strict=True):
            if info is None:
                raise FormatError(
                    f"nothing tells the lens of {topic}: there is no CameraInfo on {beside(topic)}; name it with "
                    f"{INFO_OPTION}, or give all lenses and their places with --rig FILE.yaml"
                )
            frames.append(str(first.header.frame_id) or info[1])
            if not frames[-1]:
                raise FormatError(
                    f"the pictures of {topic} name no frame (frame_id is empty), so that nothing tells where this "
                    "camera is on the body; set it in the camera's driver, or give all lenses with --rig FILE.yaml"
                )
            if (lens_rig := info[0].rig) is not None:
                lens = lens_rig.scaled(lens_rig.factor_of((size,), topic)).lenses[0]
            else:
                assert info[0].hfov is not None  # it is known
                lens = PerspectiveGrid(size[1], size[0], info[0].hfov).lens
            lenses.append(replace(lens, name=frames[-1], picture=len(lenses)))
        turned = zip(lenses, placed(frames), strict=True)
        lenses = [replace(each, body_R_lens=turn @ each.body_R_lens) for each, turn in turned]
        return Rig(tuple(self._sizes), tuple(lenses)), frames[0]


def lens_of_info(received: Any, topic: str, image_topic: str) -> Info:
    """What a CameraInfo on a `topic` tells of the pictures on another, whose name says whether they are rectified.

    Raises `FormatError`.
    """
    rectified = image_topic.removesuffix("/compressed").rpartition("/")[2].startswith(RECTIFIED)
    return Camera(rig_of_info(received, rectified, topic), name=topic), received.header.frame_id


def placed(tree: TransformTree, frames: Sequence[str]) -> list[np.ndarray]:
    """The rotations ``(3, 3)`` of the axes of cameras (x ahead) in those of the first, by the frames that name them.

    A name that contradicts a mount is a `UserWarning`. Raises `FormatError` where the `tree` does not connect them.
    """
    own, found = optical(frames[0]), []
    for frame in frames:
        between = tree.at(frames[0], frame, 0.0)
        if between is None:
            raise FormatError(
                f"{TF_STATIC} does not tell where {frame} is in {frames[0]}; cameras of a rig are fixed to each other: "
                "publish it (robot_state_publisher, static_transform_publisher), or give all lenses in a rig's file"
            )
        on_body = tree.at(BODY, frame, 0.0)
        if on_body is not None and (told := contradiction(frame, on_body[0])) is not None:
            warnings.warn(told, UserWarning, stacklevel=2)
        found.append(own.T @ between[0] @ optical(frame))
    return found


# --- bags ---


def lens_in_bag(bag: Bag, image_topic: str, asked: str | None = None) -> Info | None:
    """What the first CameraInfo of a bag tells, on the topic `asked` for.

    Without one, on that beside the `image_topic`; None if there is none. Raises `FormatError`.
    """
    topic = beside(image_topic)
    if asked is not None:
        topic, _ = pick(bag.topics, (CAMERA_INFO,), asked, where=str(bag.path), option=INFO_OPTION)
    elif bag.topics.get(topic) != CAMERA_INFO:
        return None
    first = next(iter(bag.messages([topic])), None)
    if first is None:
        raise FormatError(f"{bag.path} has no message on {topic}; give the lens with --hfov or --camera FILE")
    return lens_of_info(first[3], topic, image_topic)


def _static(bag: Bag) -> list[Any]:
    """The messages of the fixed transforms."""
    there = bag.topics.get(TF_STATIC) == TRANSFORMS
    return [received for *_, received in bag.messages([TF_STATIC])] if there else []


def lookup_static_transforms(bag: Bag, frames: Sequence[str]) -> list[np.ndarray]:
    """As `placed`, of the ``/tf_static`` of a bag."""
    tree = TransformTree()
    for received in _static(bag):
        tree.add(received, True)
    try:
        return placed(tree, frames)
    except FormatError as error:
        raise FormatError(f"{bag.path}: {error}") from error


class BagCamera:
    """The pictures of a bag, to play from its start as often as wanted.

    `topic`: None is the only one with pictures, and several have commas between. Stamps are those of the headers, else
    of the recording. `dropped`: messages that were sent twice or out of order; `back`: how many of them had stamps that
    go back, which is said once. `count`: how many pictures there are; `begins`: the stamp of the first; `lens`: the
    ordinary camera, if it is one; `frame`, `builder`, the arguments `lenses`, and errors: as of `ImageTopics`.
    """

    def __init__(self, bag: Bag | str | Path, topic: str | None = None, **lenses: Any) -> None:
        self.bag = bag if isinstance(bag, Bag) else Bag(bag)
        self.dropped = self.back = 0
        where, firsts = str(self.bag.path), []
        self.topics = tuple(
            pick(self.bag.topics, PICTURES, each, where=where, option=IMAGE_OPTION)[0]
            for each in topics_of(topic, IMAGE_OPTION)
        )
        for each in self.topics:
            if (first := next(self._stamped(each), None)) is None:
                raise FormatError(f"{where} has no message on {each}")
            firsts.append(first[::2])
        self.topic, self.count = ",".join(self.topics), self.bag.counts[self.topics[0]]
        self.begins, messages = min(stamp for stamp, _ in firsts), [received for _, received in firsts]
        told, on_body = partial(lens_in_bag, self.bag), partial(lookup_static_transforms, self.bag)
        self._images = images = ImageTopics(messages, self.topics, told, on_body, **lenses)
        self.frame, self.lens = images.frame, images.camera if images.camera and images.camera.known else None
        self.builder = images.builder

    def pictures(self) -> Iterator[tuple[float, Callable[[], np.ndarray]]]:
        """Stamp of each picture, in order of time, and what gives the frame or raises `ImageError`."""
        newest: list[Any] = [None] * len(self.topics)
        self.dropped = self.back = 0
        for stamp, lens, received in heapq.merge(*map(self._of, range(len(self.topics)))):
            newest[lens] = received
            if not lens and None not in newest:  # those of the first topic go with the others' newest
                yield stamp, partial(self._images.made, tuple(newest))

    def _stamped(self, topic: str) -> Iterator[tuple[float, bool, Any]]:
        """Stamp of each message, whether it is that of the recording, because the header has none, and the message."""
        first = [*islice(coming := self.bag.messages([topic]), 2)]
        from_0 = bool(first) and 0 < stamp_of(first[-1][-1]) < BEGUN
        for when, _, _, received in chain(first, coming):
            stamp = stamp_of(received)
            untold = stamp <= 0 and not from_0
            yield when if untold else stamp, untold, received

    def _of(self, lens: int) -> Iterator[tuple[float, int, Any]]:
        """Stamp, number and message of one topic, whose stamps rise."""
        last, told, same, topic = -math.inf, False, 0.0, self.topics[lens]
        for stamp, untold, received in self._stamped(topic):
            if untold and not told:
                told = True
                text = f"{topic} tells no times (its headers have the stamp 0): those of the recording are taken"
                warnings.warn(text, UserWarning, stacklevel=1)  # the frame above is heapq's
            if stamp > last:
                last, same = stamp, min(same, 0)
                yield stamp, lens, received
                continue
            self.dropped += 1  # sent twice, or out of order
            same += stamp == last
            if same == STUCK:
                same = -math.inf  # said once
                text = f"the stamps of {topic} stand still at {last:.3f} s: one picture of each stamp is taken"
                warnings.warn(text, UserWarning, stacklevel=1)
            if stamp < last and not self.back:
                text = f"the stamps of {topic} go back by {last - stamp:.2f} s at {last:.3f} s: its pictures are left "
                warnings.warn(f"{text}out until they have passed that", UserWarning, stacklevel=1)
            self.back += stamp < last


class BagPoses:
    """A `PoseSource` that plays the odometry of a bag; each iteration begins at its start.

    `topic`, `camera`, `axes`: as for `PoseReader`. The fixed transforms of the whole bag are known from the beginning;
    poses before one that moves are left out, if it comes within `SETTLING`. Where none tells where the camera is, its
    axes are taken for those of the messages, which is a `problem`. `dropped`: messages that hold no pose. Raises
    `FormatError`, `PoseError`.
    """

    def __init__(
        self, bag: Bag | str | Path, topic: str | None = None, *, camera: str | None = None, axes: str = "auto"
    ) -> None:
        self.bag, self._camera = bag if isinstance(bag, Bag) else Bag(bag), {"camera": camera, "axes": axes}
        self.topic, self.kind = pick(self.bag.topics, MOTION, topic, where=str(self.bag.path), option="--odom-topic")
        self.dropped, self._first, self._closed = 0, "", False
        self.reader = PoseReader(self.topic, self.kind, **self._camera)

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
        self.reader = PoseReader(self.topic, self.kind, **self._camera, strict=strict)
        for received in _static(self.bag):
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


def bag_odometry(bag: Bag, topic: str | None, frame: str | None, axes: str = "auto") -> BagPoses | None:
    """The odometry of a bag, as poses of the camera whose `frame` it is; None if no topic is named and it has none."""
    named = topic is not None or any(kind in MOTION and name != TF_STATIC for name, kind in bag.topics.items())
    return BagPoses(bag, topic, camera=frame, axes=axes) if named else None
