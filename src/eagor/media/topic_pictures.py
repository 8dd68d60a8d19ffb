"""From the messages of cameras to frames: what each one's lens is, and where several are on the body.

By the rule of ``image_transport``, the CameraInfo of ``/ns/image_raw`` is on ``/ns/camera_info``, one with each
picture. Some drivers send it once, for whoever comes later (transient local). Where several cameras are fixed to each
other, ``/tf_static`` tells how.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eagor.cameras import Lens, Rig
from eagor.errors import FormatError
from eagor.media.bags import TF_STATIC, Bag, pick
from eagor.media.intrinsics import Camera, IntrinsicsHint, ordinary_grid, rig_of_info
from eagor.media.panorama import is_whole
from eagor.media.ros_frames import BODY, IDENTITY, TransformTree, contradiction, optical
from eagor.media.ros_messages import CAMERA_INFO, TRANSFORMS, panorama_of, taken_as
from eagor.media.stitching import PanoramaBuilder, sizes_of

__all__ = [
    "Lenses",
    "TopicPictures",
    "beside",
    "lens_in_bag",
    "lens_of_info",
    "placed",
    "placed_in_bag",
    "topics_of",
]  # fmt: skip

OPTION = "--camera-info"
RECTIFIED = "image_rect"  # image_rect, image_rect_color: what image_proc publishes
SETTLING = 5.0  # seconds in which the fixed transforms of all cameras have to come


def topics_of(text: str | None, option: str) -> tuple[str | None, ...]:
    """The topics in a text, with commas between; (None,) without one. Raises `FormatError` for one that is empty."""
    found = (None,) if text is None else tuple(part.strip() for part in text.split(","))
    if "" in found:
        raise FormatError(f"{option} {text}: a topic between two commas is empty; wanted /front/image,/back/image")
    return found


@dataclass(frozen=True)
class Lenses:
    """What is known of the lenses of topics' pictures before these come.

    `rig`: of all; `camera`: an ordinary one, which each of the topics is; `info`: the topic of its CameraInfo, with
    commas between those of several. None of them: the CameraInfo beside the pictures tells. `rows`: the most of a
    frame.
    """

    rig: Rig | None = None
    camera: Camera | None = None
    info: str | None = None
    rows: int | None = None


Info = tuple[Camera, str]  # the camera that a CameraInfo tells, and the frame that its header names


def beside(image_topic: str) -> str:
    """The topic of the CameraInfo of a topic of pictures, compressed ones as well."""
    return f"{image_topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info"


class TopicPictures:
    """How the messages of `topics`, one for each camera, become frames; the `firsts` of them, and the lenses, say it.

    A topic alone gives panoramas, or an ordinary camera's pictures. Several are a rig, which is stitched.

    `told(topic, info)`: what a CameraInfo says, asked only for the topic `info`, or where nothing else tells the lens.
    `placed(frames)`: the rotations ``(3, 3)`` of the axes of cameras (x ahead) in those of the first, asked for
    several without a rig. `camera`: as it is then known, of a topic alone. `frame`: the frame whose axes the frames'
    grids are in, as its pictures name it (that of the first camera); None: the body's, where a rig is given for several
    topics. `builder`: what makes the frames. Raises `ImageError` for pictures that
    are no panoramas, or do not fit the rig, `FormatError` for messages that tell too little.
    """

    def __init__(
        self,
        firsts: Sequence[Any],
        topics: Sequence[str],
        lenses: Lenses,
        told: Callable[[str, str | None], Info | None],
        placed: Callable[[Sequence[str]], Sequence[np.ndarray]],
    ) -> None:
        pictures = [panorama_of(each) for each in firsts]
        for topic, each in zip(topics, firsts, strict=True):
            if (how := taken_as(each)) is not None:
                warnings.warn(f"{topic}: {how}", UserWarning, stacklevel=3)
        self._sizes, rig = sizes_of(pictures), lenses.rig
        infos = topics_of(lenses.info, OPTION)
        if lenses.info is not None and len(infos) != len(topics):
            raise FormatError(
                f"{OPTION} {lenses.info} names {len(infos)} topics, and {len(topics)} have pictures; wanted one for "
                "each, in their order"
            )
        names = [str(each.header.frame_id) for each in firsts]
        self.camera: Camera | None = lenses.camera
        self.frame: str | None = names[0]
        if len(topics) == 1:
            known = rig is not None or (self.camera is not None and self.camera.known) or is_whole(pictures[0])
            if (infos[0] is not None or not known) and (found := told(topics[0], infos[0])) is not None:
                self.camera, self.frame = found[0], names[0] or found[1]
        elif rig is not None:
            self.camera, self.frame = None, None
        else:
            cameras: list[Camera] = []
            for at, topic in enumerate(topics):
                camera, info = lenses.camera, infos[at] if lenses.info is not None else None
                if camera is None or not camera.known:
                    if (found := told(topic, info)) is None:
                        raise FormatError(
                            f"nothing tells the lens of {topic}: there is no CameraInfo on {beside(topic)}; name it "
                            f"with {OPTION}, or give all lenses and their places with --rig FILE.yaml"
                        )
                    camera, names[at] = found[0], names[at] or found[1]
                cameras.append(camera)
            self.camera, self.frame = None, names[0]
            rig = _rig_of(topics, names, cameras, self._sizes, placed)
        name = ", ".join(topics)
        self.builder = PanoramaBuilder(self._sizes, name, rig=rig, camera=self.camera, rows=lenses.rows)
        self.builder.check(*pictures)

    def made(self, received: Sequence[Any], otherwise: str = "") -> np.ndarray:
        """The frame of the messages of all topics. Raises `ImageError`; `FormatError` for another size."""
        pictures = [panorama_of(each) for each in received]
        for (width, height), (wide, high) in zip(sizes_of(pictures), self._sizes, strict=True):
            if (width, height) != (wide, high):
                raise FormatError(f"it is {width} x {height}, and the first was {wide} x {high}{otherwise}")
        return self.builder.make(*pictures)


def _rig_of(
    topics: Sequence[str],
    frames: Sequence[str],
    cameras: Sequence[Camera],
    sizes: Sequence[tuple[int, int]],
    placed: Callable[[Sequence[str]], Sequence[np.ndarray]],
) -> Rig:
    """The rig of several cameras, in the axes of the first."""
    for topic, frame in zip(topics, frames, strict=True):
        if not frame:
            raise FormatError(
                f"the pictures of {topic} name no frame (frame_id is empty), so that nothing tells where this camera "
                "is on the body; set it in the camera's driver, or give all lenses with --rig FILE.yaml"
            )
    found: list[Lens] = []
    for at, turn in enumerate(placed(frames)):
        lens = _lens_of(cameras[at], sizes[at], topics[at])
        found.append(replace(lens, name=frames[at], picture=at, body_R_lens=turn @ lens.body_R_lens))
    return Rig(tuple(sizes), tuple(found))


def _lens_of(camera: Camera, size: tuple[int, int], name: str) -> Lens:
    """The lens of pictures of a `size` (width, height)."""
    if camera.rig is not None:
        return camera.rig.scaled(camera.rig.factor_of((size,), name)).lenses[0]
    grid = ordinary_grid(camera, IntrinsicsHint(), size, name)
    assert grid is not None  # it is known
    return grid.lens


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


def placed_in_bag(bag: Bag, frames: Sequence[str]) -> list[np.ndarray]:
    """The rotations ``(3, 3)`` of the axes of cameras (x ahead) in those of the first, by the frames that name them.

    Raises `FormatError` where ``/tf_static`` does not connect them.
    """
    tree = TransformTree()
    if bag.topics.get(TF_STATIC) == TRANSFORMS:
        for _, _, _, received in bag.messages([TF_STATIC]):
            tree.add(received, True)
    try:
        return placed(tree, frames)
    except FormatError as error:
        raise FormatError(f"{bag.path}: {error}") from error


def placed(tree: TransformTree, frames: Sequence[str]) -> list[np.ndarray]:
    """As `placed_in_bag`, of what a tree knows; a name that contradicts a mount is a `UserWarning`.

    Raises `FormatError`.
    """
    own, found = optical(frames[0]), []
    for frame in frames:
        between = tree.at(frames[0], frame, 0.0) if frame != frames[0] else IDENTITY
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
