"""From the messages of cameras to frames: what each one's lens is, and where several are on the body.

By the rule of ``image_transport``, the CameraInfo of ``/ns/image_raw`` is on ``/ns/camera_info``, one with each
picture. Some drivers send it once, for whoever comes later (transient local). Where several cameras are fixed to each
other, ``/tf_static`` tells how.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor.cameras import Lens, Rig
from eagor.errors import FormatError
from eagor.grids import PerspectiveGrid
from eagor.sources.bags import TF_STATIC, Bag, pick
from eagor.sources.intrinsics import Camera, rig_of_info
from eagor.sources.ros_frames import BODY, TransformTree, contradiction, optical
from eagor.sources.ros_messages import CAMERA_INFO, TRANSFORMS, image_from_msg, taken_as
from eagor.sources.stitching import PanoramaBuilder, sizes_of

__all__ = [
    "ImageTopics",
    "beside",
    "lens_in_bag",
    "lens_of_info",
    "lookup_static_transforms",
    "placed",
    "topics_of",
]  # fmt: skip

OPTION = "--camera-info"
RECTIFIED = "image_rect"  # image_rect, image_rect_color: what image_proc publishes
Info = tuple[Camera, str]  # the camera that a CameraInfo tells, and the frame that its header names
SETTLING = 5.0  # seconds in which the fixed transforms of all cameras have to come


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

    A topic alone gives panoramas, or an ordinary camera's pictures. Several are a rig, which is stitched.

    `told(topic, info)`: what a CameraInfo says, asked only for the topic `info`, or where nothing else tells the lens.
    `placed(frames)`: the rotations ``(3, 3)`` of the axes of cameras (x ahead) in those of the first, asked for
    several without a rig. What is known before: the `rig` of all, an ordinary `camera`, which each of the topics is, or
    `info`: the topic of its CameraInfo, with commas between those of several; else the CameraInfo beside the pictures
    tells. `rows`: the most of a frame.

    `camera`: as it is then known, of a topic alone. `frame`: the frame whose axes the frames' grids are in, as its
    pictures name it (that of the first camera); None: the body's, where a rig is given for several topics. `builder`:
    what makes the frames. Raises `ImageError` for pictures that are no panoramas, or do not fit the rig, `FormatError`
    for messages that tell too little.
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
        infos = topics_of(info, OPTION) if info is not None else (None,) * len(topics)
        if len(infos) != len(topics):
            raise FormatError(
                f"{OPTION} {info} names {len(infos)} topics, and {len(topics)} have pictures; wanted one for "
                "each, in their order"
            )
        self._sizes, own = sizes_of(pictures), rig
        known, frame = camera is not None and camera.known, str(firsts[0].header.frame_id)
        if len(topics) > 1:
            if rig is None:
                found = [(camera, "") if camera and known else told(*each) for each in zip(topics, infos, strict=True)]
                rig, frame = self._rig(topics, firsts, found, placed)
            camera, frame = None, frame if own is None else None
        elif infos[0] is not None or not (known or rig or is_twice_as_wide(*pictures[0].shape[:2])):
            said = told(topics[0], infos[0])
            camera, frame = (said[0], frame or said[1]) if said is not None else (camera, frame)
        self.camera: Camera | None = camera
        self.frame: str | None = frame
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
                    f"{OPTION}, or give all lenses and their places with --rig FILE.yaml"
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
        placed_lenses = tuple(replace(each, body_R_lens=turn @ each.body_R_lens) for each, turn in turned)
        return Rig(tuple(self._sizes), placed_lenses), frames[0]


# --- what CameraInfo and the fixed transforms tell ---


def lens_in_bag(bag: Bag, image_topic: str, asked: str | None = None) -> Info | None:
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
    return lens_of_info(first[3], topic, image_topic)


def lens_of_info(received: Any, topic: str, image_topic: str) -> Info:
    """What a CameraInfo on a `topic` tells of the pictures on another, whose name says whether they are rectified.

    Raises `FormatError`.
    """
    rectified = image_topic.removesuffix("/compressed").rpartition("/")[2].startswith(RECTIFIED)
    return Camera(rig_of_info(received, rectified, topic), name=topic), received.header.frame_id


def lookup_static_transforms(bag: Bag, frames: Sequence[str]) -> list[np.ndarray]:
    """As `placed`, of the ``/tf_static`` of a bag."""
    tree = TransformTree()
    if bag.topics.get(TF_STATIC) == TRANSFORMS:
        for _, _, _, received in bag.messages([TF_STATIC]):
            tree.add(received, True)
    try:
        return placed(tree, frames)
    except FormatError as error:
        raise FormatError(f"{bag.path}: {error}") from error


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
