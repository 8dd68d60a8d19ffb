"""One track of pictures, decoded, with its times: of a video (by PyAV), or of a picture that moves (by Pillow).

Decoding takes bounded memory, and goes on past what is damaged.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

from eagor._extras import require_extra
from eagor.cameras import SHAPE
from eagor.errors import EagorError, FormatError, ImageError, TimeError
from eagor.odometry.imu import MotionTrack, read_insta360
from eagor.sources.defects import MAKE
from eagor.sources.intrinsics import IntrinsicsHint, intrinsics_from_tags
from eagor.sources.metadata import EXPORT, of_video
from eagor.sources.panorama import check_file, decoded_bytes, opened, projection_of, seen_of

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream
    from PIL import Image

__all__ = [
    "Animation", "Damage", "Track", "is_animation", "open_video", "pictures", "plays", "selected", "to_rgb",
]  # fmt: skip

Item = TypeVar("Item")
CLOCK = 5e-4  # seconds: half a unit of the coarsest common clock, Matroska's, to which stamps are rounded
PLAIN = 25.0  # pictures per second where a file tells neither times nor rate; FFmpeg's own
HDR = {16: "PQ", 18: "HLG"}  # transfer characteristics, ITU-T H.273
LARGEST = 1 << 27  # pixels: 16384 x 8192
IN_FLIGHT = 1 << 28  # bytes: decoded pictures that threads may hold beside those that the codec needs
MOST_THREADS = 8
HD = 720  # rows from which on colours are ITU-R BT.709 where the file says nothing
UNSPECIFIED, BT709 = 2, "ITU709"
SHORT = 0.5  # seconds that may be missing at the end of a file that tells its length, and not how many pictures
CONVERT = "convert it, for example: ffmpeg -i {} -c:v libx264 -pix_fmt yuv420p converted.mp4"
MOVING = ("GIF", "PNG", "WEBP", "AVIF")  # the pages of a TIFF, or of an MPO, are not pictures one after the other
SHORTEST, USUAL = 0.0101, 0.1  # seconds: shorter ones are shown as long as this, as browsers do
MOST_BYTES = 1 << 29  # of a picture that moves, in memory
LENSES = "{0} holds {1} tracks of pictures, one for each lens. " + f"{MAKE}. Or: {EXPORT}"
GOPRO = (
    "{0} is a GoPro recording that is not put together yet: its two tracks are the two strips of an equi-angular "
    "cubemap (EAC), which no rig of lenses describes. Export it as an equirectangular MP4 with GoPro's Player or Quik. "
    "Or with FFmpeg, some degrees off where the strips overlap: ffmpeg -i {0} -filter_complex "
    "'[0:v:0][0:v:1]vstack,v360=eac:e' -map 0:a? whole.mp4"
)


@dataclass
class Damage:
    """What could not be decoded: how many packets, of how many, and the time of the first (threads tell it late)."""

    packets: int = 0
    of: int = 0
    first: float = 0.0


class Track:
    """The decoded pictures of a track of a video, to iterate over as often as wanted, with `pictures`.

    `rate`: pictures per second to take: of each tick `start`, `start` + 1 / `rate`, ... the first picture at or after
    it, each picture once; None takes all. `start`, `end`: seconds of the file; the picture at `end` is not taken.
    `number`: which of several tracks of pictures, from 0. `lenses`: the pictures are those of a camera's lenses: what
    the file says of its projection does not count.

    `size`: width and height of the pictures as they are shown; `duration`: seconds, or None; `frame_rate`: mean, or
    None; `count`: about how many pictures will come, or None; `tracks`: how many tracks of pictures there are; `facts`:
    sentences about what the file says of itself; `motion`: None, or the rotations that its motion track tells
    (`eagor.odometry.imu.MotionTrack`); `projection`: what the file says of the sphere, or None; `hidden`: None; `hint`:
    what it says of an ordinary lens.

    Raises `ImageError` for a file that cannot be read as a video, `TimeError` for impossible times,
    `MissingExtraError`.
    """

    hidden = None

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        lenses: bool = False,
        number: int = 0,
    ) -> None:
        require_extra("reading a video", "photos", "av")
        self.path = check_file(path, "a video (MP4, MOV, MKV, WebM, INSV)")
        self.rate, self.start, self.end, self._number = rate, start, end, number
        camera, self.motion, facts = _camera_track(self.path)
        container, stream = open_video(self.path, number)
        with container:
            self.tracks = tracks = _check_tracks(container, self.path, bool(camera), lenses)
            damage = Damage()
            picture = next(pictures(container, stream, damage), None)
            if picture is None:
                why = f"none of its {damage.packets} packets can be decoded" if damage.packets else "it is empty"
                advice = f"Copy it again from the camera, or {CONVERT.format(path)}"
                raise ImageError(f"{path} holds no picture: {why}. {advice}")
            unit, begins = float(stream.time_base or 0), (container.start_time or 0) / 1e6  # seconds
            lasts = stream.duration * unit if stream.duration else (container.duration or 0) / 1e6
            self.duration, self._frames = lasts or None, stream.frames
            self.frame_rate = float(stream.average_rate or stream.guessed_rate or 0) or None
            aspect, codec = float(stream.sample_aspect_ratio or 1) or 1.0, stream.codec_context.name
            tags = container.metadata | stream.metadata
        if self.duration is not None and start >= self.duration:
            raise TimeError(f"start = {start:g} s is beyond the end of {self.path}, which lasts {self.duration:.2f} s")
        told = cast("dict[str, bytes | None]", picture.side_data)
        names = ("SPHERICAL", "STEREO3D", "DISPLAYMATRIX")
        side_data = {name: bytes(data) for name in names if (data := told.get(name)) is not None}
        self.projection = None if lenses else of_video(side_data)
        self._timed = picture.pts is not None
        self._zero = round(begins / unit) * unit if unit else begins
        self._clock, self._interval = min(CLOCK, unit / 2) + 1e-9, 1 / (self.frame_rate or PLAIN)
        self._size, self._turns, mirrored = (picture.height, picture.width), 0, False
        if len(matrix := side_data.get("DISPLAYMATRIX", b"")) == 36:
            self._turns = round(picture.rotation / 90) % 4
            mirrored = np.linalg.det(np.frombuffer(matrix, "i4").reshape(3, 3)[:2, :2].astype(float)) < 0
        high, wide = picture.height, max(1, round(picture.width * aspect))
        self.size = (high, wide) if self._turns % 2 else (wide, high)
        self.hint = intrinsics_from_tags(tags, self.size, self._turns)
        degrees, bright = 90 * self._turns, HDR.get(picture.color_trc)
        own = {
            f"{codec}, {picture.width} x {picture.height} pixels": True,
            f"the camera is {camera}": camera,
            f"its pictures are turned by {degrees} degrees counterclockwise, as it wants to be shown": degrees,
            "it wants to be shown mirrored, which is not done": mirrored,
            f"its colours are HDR ({bright}) and taken as they are: they look pale": bright,
            f"its pictures have no times; {self.frame_rate or PLAIN:g} a second are assumed": not self._timed,
            "its pictures are those of lenses, and are stitched": lenses,
            f"it has {tracks} tracks of pictures, of which the first is taken": tracks > 1 and not lenses,
        }
        self.facts = (*(fact for fact, holds in own.items() if holds), *facts)
        self.count: int | None = None
        if self.duration is not None and (rates := [each for each in (rate, self.frame_rate) if each]):
            seconds = min(self.duration, math.inf if end is None else end) - start
            self.count = max(1, math.ceil(seconds * min(rates) - 1e-6))

    def pictures(self, size: tuple[int, int]) -> Iterator[tuple[float, np.ndarray]]:
        """Stamp and picture ``(*size, 3)`` uint8, upright, of each moment; `size`: rows and columns.

        Stamps are the presentation times in seconds from the start of the file, and increase: a picture whose time is
        missing, or not after that of the one before, gets that time plus the mean interval; a `UserWarning` at the end
        says how many. Raises `ImageError` after the last picture if some could not be decoded, if the file is cut off,
        or where its pictures change their shape.
        """
        damage, taken = Damage(), 0
        self._seen, self._repaired, self._last = 0, 0, None
        for stamp, picture in selected(self._stamped(damage), self.start, self.end, self.rate, self._clock):
            taken += 1
            yield stamp, self._upright(picture, size)
        if self._repaired and self._timed:
            warnings.warn(
                f"{self.path}: the times of {self._repaired} of {self._seen} pictures are missing or do not increase; "
                f"each follows the picture before by {self._interval:.4f} s",
                UserWarning,
                stacklevel=2,
            )
        last, missing = self._last, ""
        reached = "none of its pictures could be read" if last is None else f"it was read up to {last:.2f} s"
        if last is not None and (self.end is None or last < self.end - self._clock):
            if self._frames and damage.of < self._frames and not self.start:
                missing = f"of {self._frames} pictures {damage.of} are there"
            elif not self._frames and self.duration and last < self.duration - SHORT - 2 * self._interval:
                missing = f"it should last {self.duration:.2f} s"
        end = f"{reached}, and {taken} pictures were taken. Copy it again from the camera"
        if missing:
            raise ImageError(f"{self.path} is cut off: {missing}; {end} for the rest")
        if damage.packets:
            first = damage.first - self._zero
            what = f"{damage.packets} of its packets could not be decoded, the first near {first:.2f} s"
            raise ImageError(f"{self.path} is damaged: {what}; {end}")
        if not taken:
            until = "its end" if self.end is None else f"end = {self.end:g} s"
            raise TimeError(
                f"{self.path} has no picture from start = {self.start:g} s to {until}; {reached}. Choose other times"
            )

    def _stamped(self, damage: Damage) -> Iterator[tuple[float, VideoFrame]]:
        """All pictures that can be decoded, from the key picture before `start` on, with stamps that increase."""
        container, stream = open_video(self.path, self._number)
        try:
            if self.start > 0 and self._timed and not _seek_to(container, stream, self.start + self._zero):
                container.close()
                container, stream = open_video(self.path, self._number)
            for picture in pictures(container, stream, damage):
                stamp = None if picture.time is None else picture.time - self._zero
                if stamp is None or (self._last is not None and stamp <= self._last):
                    self._repaired += 1
                    stamp = 0.0 if self._last is None else self._last + self._interval
                self._seen, self._last = self._seen + 1, stamp
                yield stamp, picture
        finally:
            container.close()

    def _upright(self, picture: VideoFrame, size: tuple[int, int]) -> np.ndarray:
        own = self._size
        if abs(picture.width * own[0] / (picture.height * own[1]) - 1) > SHAPE:
            raise ImageError(
                f"{self.path}: its pictures change from {own[1]} x {own[0]} to {picture.width} x {picture.height}, "
                "another shape, so another part of what the camera sees; cut the video there (--start, --end)"
            )
        rgb = to_rgb(picture, *(size[::-1] if self._turns % 2 else size))
        return np.rot90(rgb, self._turns) if self._turns else rgb


# --- pictures that move ---


def is_animation(path: str | os.PathLike[str]) -> bool:
    """Whether the file is a picture that moves."""
    if not os.path.isfile(path):  # a pipe would never open
        return False
    try:
        with opened(path) as image:
            return image.format in MOVING and getattr(image, "n_frames", 1) > 1
    except Exception:  # Pillow may raise anything for what is no picture
        return False


class Animation:
    """The pictures of a picture that moves: as `Track`, with the same attributes.

    `hidden` ``(H, W)``: what is transparent in the first picture, or None. Raises `ImageError`, `TimeError`.
    """

    duration = count = motion = None
    hint = IntrinsicsHint()

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
    ) -> None:
        self.path, self._taken = os.fspath(path), (start, end, rate)
        found = next(coming := self._all(), None)  # which holds the file open
        if found is None:
            raise ImageError(f"{self.path} holds no picture that can be read; fetch or export it again")
        _, lasts, (_, self.hidden), image = found
        self.size, self.projection, self.frame_rate = image.size, projection_of(image), 1 / lasts
        about = f"{image.format}, {image.width} x {image.height} pixels, {image.n_frames} pictures"  # type: ignore[attr-defined]
        self.facts = (f"{about}, one after the other",)
        coming.close()

    def pictures(self, size: tuple[int, int]) -> Iterator[tuple[float, np.ndarray]]:
        """As those of `Track`, in their own size."""
        stamp = None
        for stamp, picture in selected(((at, seen[0]) for at, _, seen, _ in self._all()), *self._taken, 1e-6):
            yield stamp, picture
        if stamp is None:
            raise TimeError(f"{self.path} has no picture from {self._taken[0]:g} s on; it ends before that")

    def _all(self) -> Generator[tuple[float, float, tuple[np.ndarray, np.ndarray | None], Image.Image], None, None]:
        """Time, for how long it is shown, picture and mask, and the file; raises `ImageError` where it is damaged."""
        stamp = 0.0
        try:
            with opened(self.path) as image:
                if decoded_bytes(image) > MOST_BYTES:
                    raise ImageError(
                        f"{self.path} claims {image.width} x {image.height} pixels; it is corrupt, or large"
                    )
                # Of an APNG the first may be one for programs that know no animations.
                for number in range(int(bool(image.info.get("default_image"))), image.n_frames):  # type: ignore[attr-defined]
                    image.seek(number)
                    image.load()
                    lasts = float(image.info.get("duration") or 0) / 1000
                    lasts = lasts if lasts >= SHORTEST else USUAL
                    yield stamp, lasts, seen_of(image), image
                    stamp += lasts
        except ImageError:
            raise
        except Exception as error:  # Pillow's decoders may raise anything for damaged files
            what = f"its picture after {stamp:.2f} s cannot be read ({type(error).__name__}: {error})"
            raise ImageError(f"{self.path} is damaged: {what}; fetch or export it again") from error


def selected(
    items: Iterable[tuple[float, Item]], start: float, end: float | None, rate: float | None, slack: float
) -> Iterator[tuple[float, Item]]:
    """Of each tick of `rate` per second from `start` to `end` (seconds) the first item at or after it, once."""
    next_tick = 0
    for stamp, item in items:
        if end is not None and stamp >= end - slack:
            return
        if stamp < start - slack:
            continue
        if rate is not None:
            tick = math.floor((stamp - start + slack) * rate)
            if tick < next_tick:
                continue
            next_tick = tick + 1
        yield stamp, item


# --- what the file says ---


def _camera_track(path: str) -> tuple[str, MotionTrack | None, tuple[str, ...]]:
    """The camera that wrote an Insta360 trailer ("" if there is none), its motion, and sentences about that."""
    try:
        with open(path, "rb") as file:
            trailer = read_insta360(file)
        motion = None if trailer is None else trailer.motion()
    except FormatError as error:
        return "", None, (f"its motion track cannot be used: it {error}",)
    if trailer is None:
        return "", None, ()
    camera = trailer.camera or "one of Insta360"
    return camera, motion, () if motion is None else (
        "its motion track (Insta360) has axes that are not documented: the one that feels gravity is taken for up, so "
        "turns of the heading are right, tilts may be about another axis",
        "the motion track is the camera's: where its app steadied the pictures, they turn otherwise",
    )  # fmt: skip


def _tracks(container: InputContainer) -> list[VideoStream]:
    return [each for each in container.streams.video if not each.disposition & each.disposition.attached_pic]


def _check_tracks(container: InputContainer, path: str, insta360: bool, lenses: bool) -> int:
    """How many tracks of pictures it has. Raises `ImageError` for those of lenses, unless `lenses` are wanted."""
    count, name = len(_tracks(container)), os.path.basename(path)
    if count > 1 and not lenses:
        gopro = any("GoPro" in str(each.metadata.get("handler_name", "")) for each in container.streams)
        if gopro or path.lower().endswith(".360"):
            raise ImageError(GOPRO.format(name))
        if insta360 or path.lower().endswith(".insv"):
            raise ImageError(LENSES.format(name, count))
    return count


# --- decoding ---


def open_video(path: str, track: int = 0) -> tuple[InputContainer, VideoStream]:
    """The file and one of its streams of pictures. Raises `ImageError`."""
    import av
    from av.error import FFmpegError

    try:
        # As "file:", or a colon in its name would name a protocol; other protocols stay closed to playlists.
        container = av.open(f"file:{path}", metadata_errors="replace", options={"protocol_whitelist": "file"})
    except (FFmpegError, ValueError) as error:
        why = error.strerror if isinstance(error, FFmpegError) else error
        raise ImageError(
            f"{path} cannot be read as a video ({why}); it is damaged, cut off before its index was written, or of "
            "another kind. Wanted an MP4, MOV, MKV or WebM file: copy it again from the camera"
        ) from error
    try:
        stream = _stream(container, path, track)
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


def plays(path: str | os.PathLike[str]) -> bool:
    """Whether FFmpeg finds moving pictures in the regular file at `path`, whatever its name."""
    try:
        require_extra("reading a video", "photos", "av")
        container, _ = open_video(os.fspath(path))
    except EagorError:
        return False
    container.close()
    return True


def _stream(container: InputContainer, path: str, track: int) -> VideoStream:
    kind = container.format.name
    if kind.endswith("_pipe") or kind in ("image2", "tty"):
        what = "text" if kind == "tty" else "a single picture"
        raise ImageError(f"{path} is {what}, not a video; eagor locate takes a picture, eagor track a folder of them")
    streams = _tracks(container)
    if not streams:
        others = ", ".join(sorted({s.type for s in container.streams})) or "nothing"
        raise ImageError(f"{path} has no stream of pictures, but: {others}. Give a video")
    if not 0 <= track < len(streams):
        raise ImageError(f"{path} has {len(streams)} tracks of pictures, and number {track} was asked for, from 0")
    if streams[track].codec_context is None:
        raise ImageError(f"{path} is in a codec that this FFmpeg cannot decode; {CONVERT.format(path)}")
    return streams[track]


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
            damage.of += packet.size > 0
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


def _seek_to(container: InputContainer, stream: VideoStream, time: float) -> bool:
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
