"""Decode the pictures of a video file (PyAV, FFmpeg), with bounded memory, and past what is damaged."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, cast

import numpy as np

from eagor.errors import ImageError

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

__all__ = ["Damage", "First", "first_picture", "opened", "pictures", "sought", "to_rgb"]

LARGEST = 1 << 27  # pixels: 16384 x 8192
IN_FLIGHT = 1 << 28  # bytes: decoded pictures that threads may hold beside those that the codec needs
MOST_THREADS = 8
HD = 720  # rows from which on colours are ITU-R BT.709 where the file says nothing
UNSPECIFIED, BT709 = 2, "ITU709"
CONVERT = "convert it, for example: ffmpeg -i {} -c:v libx264 -pix_fmt yuv420p converted.mp4"


@dataclass
class Damage:
    """What could not be decoded: how many packets, and the time of the first (seconds; threads tell it late)."""

    packets: int = 0
    first: float = 0.0


@dataclass(frozen=True)
class First:
    """What the first picture and its stream say.

    `shape`: rows and columns in square pixels, upright. `turns`: quarter turns, counterclockwise, that make it upright.
    `mirrored`: whether it is to be shown so. `codec`, `camera`: names. `transfer`: of its colours, by ITU-T H.273.
    `zero`: start of the file on its clock; `clock`: unit of that; `duration`; all in seconds. `rate`: pictures per
    second. `timed`: whether pictures have times.
    """

    shape: tuple[int, int]
    size: tuple[int, int]
    turns: int
    mirrored: bool
    codec: str
    camera: str
    transfer: int
    zero: float
    clock: float
    duration: float | None
    rate: float | None
    timed: bool


def opened(path: str, entry: str = "", track: int = 0) -> tuple[InputContainer, VideoStream]:
    """The file and one of its streams of pictures; `entry`: its codec, if known otherwise. Raises `ImageError`."""
    import av
    from av.error import FFmpegError

    try:
        # As "file:", or a colon in its name would name a protocol; other protocols stay closed to playlists.
        container = av.open(f"file:{path}", metadata_errors="replace", options={"protocol_whitelist": "file"})
    except (FFmpegError, ValueError) as error:
        why = error.strerror if isinstance(error, FFmpegError) else error
        raise ImageError(
            f"{path} cannot be read as a video ({why}); it is damaged, cut off at its start, or of another kind. "
            "Wanted an MP4, MOV, MKV or WebM file: copy it again from the camera"
        ) from error
    try:
        stream = _stream(container, path, entry, track)
        context = stream.codec_context
        pixels = context.width * context.height
        if pixels > LARGEST:
            raise ImageError(
                f"{path} has pictures of {context.width} x {context.height} pixels; wanted at most {LARGEST} pixels. "
                f"Shrink it, for example: ffmpeg -i {path} -vf scale=7680:-2 smaller.mp4"
            )
        context.thread_type = "AUTO"
        context.thread_count = max(1, min(MOST_THREADS, os.cpu_count() or 1, IN_FLIGHT // max(1, 3 * pixels)))
    except BaseException:
        container.close()
        raise
    return container, stream


def _stream(container: InputContainer, path: str, entry: str, track: int) -> VideoStream:
    kind = container.format.name
    if kind.endswith("_pipe") or kind in ("image2", "tty"):
        what = "text" if kind == "tty" else "a single picture"
        raise ImageError(f"{path} is {what}, not a video; eagor locate takes a picture, eagor track a folder of them")
    streams = [s for s in container.streams.video if not s.disposition & s.disposition.attached_pic]
    if not streams:
        others = ", ".join(sorted({s.type for s in container.streams})) or "nothing"
        raise ImageError(f"{path} has no stream of pictures, but: {others}. Give a video")
    if not 0 <= track < len(streams):
        raise ImageError(f"{path} has {len(streams)} tracks of pictures, and number {track} was asked for, from 0")
    if streams[track].codec_context is None:
        raise ImageError(f"{path} is in a codec {entry!r} that this FFmpeg cannot decode; {CONVERT.format(path)}")
    return streams[track]


def first_picture(container: InputContainer, stream: VideoStream, path: str) -> tuple[First, VideoFrame]:
    """What the first picture that can be decoded says, and that picture. Raises `ImageError` if there is none."""
    damage = Damage()
    picture = next(pictures(container, stream, damage), None)
    if picture is None:
        why = f"none of its {damage.packets} packets can be decoded" if damage.packets else "it is empty"
        raise ImageError(f"{path} holds no picture: {why}. Copy it again from the camera, or {CONVERT.format(path)}")
    turns, mirrored = _turns(picture)
    aspect = float(stream.sample_aspect_ratio or 1) or 1.0
    high, wide = picture.height, max(1, round(picture.width * aspect))
    unit, duration = float(stream.time_base or 0), None
    start = (container.start_time or 0) / 1e6
    if stream.duration is not None:
        duration = stream.duration * unit
    elif container.duration is not None:
        duration = container.duration / 1e6
    rate = float(stream.average_rate or stream.guessed_rate or 0)
    first = First(
        shape=(wide, high) if turns % 2 else (high, wide),
        size=(picture.height, picture.width),
        turns=turns,
        mirrored=mirrored,
        codec=stream.codec_context.name,
        camera=_camera(container.metadata | stream.metadata),
        transfer=picture.color_trc,
        zero=round(start / unit) * unit if unit else start,
        clock=unit,
        duration=duration,
        rate=rate or None,
        timed=picture.pts is not None,
    )
    return first, picture


def _turns(picture: VideoFrame) -> tuple[int, bool]:
    """Quarter turns (counterclockwise) with which a picture is to be shown, and whether mirrored, too."""
    with suppress(KeyError, ValueError):
        data = bytes(cast("dict[str, bytes]", picture.side_data)["DISPLAYMATRIX"])
        matrix = np.frombuffer(data, "i4").reshape(3, 3)[:2, :2].astype(float)
        return round(picture.rotation / 90) % 4, bool(np.linalg.det(matrix) < 0)
    return 0, False


def _camera(metadata: dict[str, str]) -> str:
    """Maker and model, "" if unknown."""
    keys = {key.rsplit(".", 1)[-1].lower(): value for key, value in metadata.items()}
    return " ".join(keys[key] for key in ("make", "model") if keys.get(key)).strip()


def pictures(container: InputContainer, stream: VideoStream, damage: Damage) -> Iterator[VideoFrame]:
    """The pictures that can be decoded, in order of presentation; `damage` counts the packets that cannot."""
    from av.error import FFmpegError

    packets, time, spoilt = container.demux(stream), 0.0, set()
    while True:
        try:
            packet = next(packets, None)
            if packet is None:
                return
            if packet.pts is not None and packet.time_base:
                time = float(packet.pts * packet.time_base)
            if packet.is_corrupt:  # decoded all the same: later pictures build on it
                spoilt.add(packet.pts)
            found = packet.decode()
            good = [picture for picture in found if not picture.is_corrupt and picture.pts not in spoilt]
            broken = len(good) < len(found)
            spoilt -= {picture.pts for picture in found}  # a clock that starts again may come to the same time
        except FFmpegError:
            good, broken = [], True
        if broken:
            damage.first = damage.first if damage.packets else time
            damage.packets += 1
        yield from good  # pyright: ignore[reportReturnType]


def sought(container: InputContainer, stream: VideoStream, time: float) -> bool:
    """Go to the last key picture at or before `time` (seconds, the file's clock); False if it leads to a later one."""
    from av.error import FFmpegError

    goal = round(time / (stream.time_base or Fraction(1, 90000)))
    with suppress(FFmpegError, StopIteration):
        container.seek(goal, stream=stream)
        packet = next(container.demux(stream))
        if packet.pts is not None and packet.pts <= goal:
            container.seek(goal, stream=stream)
            return True
    return False


def to_rgb(picture: VideoFrame, height: int, width: int) -> np.ndarray:
    """A decoded picture as ``(height, width, 3)`` uint8; shrunk by the mean of the area of each pixel."""
    colours = BT709 if picture.colorspace == UNSPECIFIED and picture.height >= HD else None
    shrinks = height < picture.height or width < picture.width
    filtered = "AREA" if shrinks else "BILINEAR"
    rgb = picture.reformat(width, height, "rgb24", src_colorspace=colours, interpolation=filtered, threads=1)
    return rgb.to_ndarray()
