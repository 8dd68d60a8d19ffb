"""Videos, and pictures that move, as frames: of panoramas, of an ordinary camera, or of the lenses of a rig.

PyAV decodes videos in bounded memory and past what is damaged; `PanoramaBuilder` says what the pictures are.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from eagor._checks import above, within
from eagor._extras import require_extra
from eagor.cameras import SHAPE, Rig
from eagor.errors import EagorError, FormatError, ImageError, TimeError
from eagor.odometry.imu import MotionTrack, read_insta360
from eagor.sources import Frame
from eagor.sources.animations import Animation, is_animation, selected
from eagor.sources.defects import MAKE
from eagor.sources.intrinsics import intrinsics_from_tags
from eagor.sources.metadata import EXPORT, of_video
from eagor.sources.panorama import check_file
from eagor.sources.stitching import PanoramaBuilder

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

__all__ = [
    "Damage", "Track", "Video", "lens_videos", "open_video", "pictures", "plays", "to_rgb",
]  # fmt: skip

CLOCK = 5e-4  # seconds: half a unit of the coarsest common clock, Matroska's, to which stamps are rounded
PLAIN = 25.0  # pictures per second where a file tells neither times nor rate; FFmpeg's own
HDR = {16: "PQ", 18: "HLG"}  # transfer characteristics, ITU-T H.273
LARGEST = 1 << 27  # pixels: 16384 x 8192
IN_FLIGHT = 1 << 28  # bytes: decoded pictures that threads may hold beside those that the codec needs
MOST_THREADS = 8
HD, UNSPECIFIED, BT709 = 720, 2, "ITU709"  # rows from which on colours are ITU-R BT.709 where the file says nothing
SHORT = 0.5  # seconds that may be missing at the end of a file that tells its length, and not how many pictures
APART = 0.02  # seconds by which the pictures of two lenses may differ in time, beside half an interval
CONVERT = "convert it, for example: ffmpeg -i {} -c:v libx264 -pix_fmt yuv420p converted.mp4"
LENSES = "{0} holds {1} tracks of pictures, one for each lens. " + f"{MAKE}. Or: {EXPORT}"
GOPRO = (
    "{0} is a GoPro recording that is not put together yet: its two tracks are the two strips of an equi-angular "
    "cubemap (EAC), which no rig of lenses describes. Export it as an equirectangular MP4 with GoPro's Player or Quik. "
    "Or with FFmpeg, some degrees off where the strips overlap: ffmpeg -i {0} -filter_complex "
    "'[0:v:0][0:v:1]vstack,v360=eac:e' -map 0:a? whole.mp4"
)
INSTA360 = (
    "its motion track (Insta360) has axes that are not documented: the one that feels gravity is taken for up, so "
    "turns of the heading are right, tilts may be about another axis",
    "the motion track is the camera's: where its app steadied the pictures, they turn otherwise",
)
_LENS = re.compile(r"(VID_\d+_\d+_)(00|10)(_\d+\.insv)$", re.IGNORECASE)


class Video:
    """The frames of a video, to iterate over as often as wanted; each time yields `Frame` in order of time.

    With a `rig`, `path` and `others` are the files of its pictures: one may hold a track for each, and of two Insta360
    recordings of the same moment one is enough. `lens`: `camera`, `force` and `rows` of `PanoramaBuilder`, which is the
    `builder`. `rate`, `start`, `end`, and `duration` and so on: as of `Track`. `shape`: rows and columns of the frames;
    `unseen`: None, or the mask of what no frame shows; `level_R_body`: as of the `builder`.

    Raises as `Track`, and where files do not belong to the rig. Iterating raises `ShapeError` for pictures of which
    nothing tells what they are, and as `Track.pictures`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *others: str | os.PathLike[str],
        rate: float | None = None,
        start: float = 0.0,
        end: float | None = None,
        rig: Rig | None = None,
        **lens: Any,
    ) -> None:
        if rate is not None and not above(rate, 0):
            raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0, or None for all pictures")
        if not within(start, 0):
            raise TimeError(f"start = {start!r}; wanted seconds from the start of the file, 0 or more")
        if end is not None and not above(end, start):
            raise TimeError(f"end = {end!r}; wanted seconds of the file after start = {start:g}, or None for its end")
        if rig is None and others:
            raise ImageError(f"{len(others) + 1} files are given, and no rig says how they belong together: --rig FILE")
        taken: dict[str, Any] = {"rate": rate, "start": start, "end": end}
        self._tracks: list[Track | Animation]
        if rig is not None:
            self._tracks = [*_lens_tracks((path, *others), len(rig.sizes), taken)]
        else:
            self._tracks = [(Animation if is_animation(path) else Track)(path, **taken)]
        first, self._checked = self._tracks[0], False
        self.path, self.motion, self.hint, self.duration = first.path, first.motion, first.hint, first.duration
        self.frame_rate, self.count, sizes = first.frame_rate, first.count, [each.size for each in self._tracks]
        told: dict[str, Any] = {"hint": first.hint, "projection": first.projection}
        self.builder = builder = PanoramaBuilder(sizes, self.path, rig=rig, **told, **lens)
        self.shape, self.level_R_body = builder.grid.shape, builder.level_R_body
        self.unseen, self.facts = builder.hidden(first.hidden), (*first.facts, *builder.facts)

    def __iter__(self) -> Iterator[Frame]:
        for stamp, pictures in _together(self._tracks, self.builder.wanted):
            name = f"{os.path.basename(self.path)} at {stamp:.2f} s"
            if not self._checked:
                self.builder.check(*pictures, name=name)
                self._checked = True
            yield Frame(stamp, self.builder.make(*pictures), name, self.builder.view, unseen=self.unseen)


def lens_videos(paths: Sequence[Path], rate: float | None = None) -> Iterator[tuple[np.ndarray, ...]]:
    """The lenses' pictures ``(H, W, 3)`` uint8 as they are, of each moment of a video."""
    tracks = _lens_tracks(paths, None, {"rate": rate})
    yield from (pictures for _, pictures in _together(tracks, [(each.size[1], each.size[0]) for each in tracks]))


def _lens_tracks(paths: Sequence[str | os.PathLike[str]], count: int | None, taken: dict[str, Any]) -> list[Track]:
    """A track for each of `count` pictures: of files of their own, tracks of one, or a file and its partner.

    None: as many as a file has tracks, or it and its partner: the recording of the other lens, as Insta360 names the
    two of one moment (``_00_``, ``_10_``).
    """
    first, *others = map(Path, paths)
    found = Track(first, lenses=True, **taken)
    if not others and count != 1 and found.tracks > 1 and found.tracks >= (count or 0):
        return [found, *(Track(first, number=k, lenses=True, **taken) for k in range(1, count or found.tracks))]
    if not others and count in (None, 2) and (name := _LENS.search(first.name)) is not None:
        other = first.with_name(f"{first.name[: name.start()]}{name[1]}{'10' if name[2] == '00' else '00'}{name[3]}")
        both = sorted([first, other]) if other.is_file() else [first]
        return [Track(path, lenses=True, **taken) for path in both]
    return [found, *(Track(path, lenses=True, **taken) for path in others)]


def _together(
    tracks: Sequence[Track | Animation], sizes: Sequence[tuple[int, int]]
) -> Iterator[tuple[float, tuple[np.ndarray, ...]]]:
    """Stamp and pictures of each moment, at these sizes. Raises `ImageError` where the times of lenses differ."""
    interval, path = 1 / (tracks[0].frame_rate or 25.0), tracks[0].path
    for moment in zip_longest(*(each.pictures(size) for each, size in zip(tracks, sizes, strict=True))):
        if None in moment:
            raise ImageError(f"{path}: the video of one lens ends before that of the other; what both have was taken")
        stamps = [stamp for stamp, _ in moment]
        if (apart := max(stamps) - min(stamps)) > interval / 2 + APART:
            raise ImageError(
                f"{path}: at {stamps[0]:.2f} s the pictures of its lenses are {apart:.3f} s apart: these are not the "
                "lenses of one recording. Give the files of one moment"
            )
        yield stamps[0], tuple(picture for _, picture in moment)


@dataclass
class Damage:
    """What could not be decoded: how many packets, of how many, and the time of the first (threads tell it late)."""

    packets: int = 0
    of: int = 0
    first: float = 0.0


class Track:
    """The decoded pictures of a track of a video, to iterate over as often as wanted, with `pictures`.

    `rate`: of each tick `start`, `start` + 1 / `rate`, ... the first picture at or after it, each picture once; None
    takes all. `start`, `end`: seconds of the file; the picture at `end` is not taken. `number`: which of several tracks
    of pictures, from 0. `lenses`: they are those of lenses: what the file says of its projection does not count.

    `size`: width and height as they are shown; `duration` (seconds), `frame_rate` (mean), `count` (about how many will
    come): None where nothing tells; `tracks`: how many there are; `facts`: sentences; `motion`, `projection`, `hint`:
    what the file says of rotations, of the sphere, of an ordinary lens; `hidden`: None. Raises `ImageError` for a file
    that cannot be read as a video, `TimeError` for impossible times, `MissingExtraError`.
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
            self.tracks = tracks = len(_tracks(container))
            name = os.path.basename(self.path)
            if tracks > 1 and not lenses:
                gopro = any("GoPro" in str(each.metadata.get("handler_name", "")) for each in container.streams)
                if gopro or name.lower().endswith(".360"):
                    raise ImageError(GOPRO.format(name))
                if camera or name.lower().endswith(".insv"):
                    raise ImageError(LENSES.format(name, tracks))
            picture = next(pictures(container, stream, damage := Damage()), None)
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
        ends = 0.0 if last is None else last + max(self._zero, 0.0)  # Matroska's length counts from time 0
        if last is not None and (self.end is None or last < self.end - self._clock):
            if self._frames and damage.of < self._frames and not self.start:
                missing = f"of {self._frames} pictures {damage.of} are there"
            elif not self._frames and self.duration and ends < self.duration - SHORT - 2 * self._interval:
                missing = f"it should last {self.duration:.2f} s"
        reached = "none of its pictures could be read" if last is None else f"it was read up to {last:.2f} s"
        end = f"{reached}, and {taken} pictures were taken. Copy it again from the camera"
        if missing:
            raise ImageError(f"{self.path} is cut off: {missing}; {end} for the rest")
        if damage.packets:
            what = f"{damage.packets} of its packets could not be decoded, the first near"
            raise ImageError(f"{self.path} is damaged: {what} {damage.first - self._zero:.2f} s; {end}")
        if not taken:
            until = f"from start = {self.start:g} s to {'its end' if self.end is None else f'end = {self.end:g} s'}"
            raise TimeError(f"{self.path} has no picture {until}; {reached}. Choose other times")

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
        high, wide = self._size
        if abs(picture.width * high / (picture.height * wide) - 1) > SHAPE:
            raise ImageError(
                f"{self.path}: its pictures change from {wide} x {high} to {picture.width} x {picture.height}, another "
                "shape, so another part of what the camera sees; cut the video there (--start, --end)"
            )
        rgb = to_rgb(picture, *(size[::-1] if self._turns % 2 else size))
        return np.rot90(rgb, self._turns) if self._turns else rgb


def _camera_track(path: str) -> tuple[str, MotionTrack | None, tuple[str, ...]]:
    """The camera that wrote an Insta360 trailer ("" if there is none), its motion, and sentences about that."""
    try:
        with open(path, "rb") as file:
            trailer = read_insta360(file)
        motion = None if trailer is None else trailer.motion()
    except FormatError as error:
        return "", None, (f"its motion track cannot be used: it {error}",)
    return "" if trailer is None else trailer.camera or "one of Insta360", motion, INSTA360 if motion else ()


# --- decoding ---


def _tracks(container: InputContainer) -> list[VideoStream]:
    return [each for each in container.streams.video if not each.disposition & each.disposition.attached_pic]


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
        open_video(os.fspath(path))[0].close()
    except EagorError:
        return False
    return True


def _stream(container: InputContainer, path: str, track: int) -> VideoStream:
    kind, streams = container.format.name, _tracks(container)
    if kind.endswith("_pipe") or kind in ("image2", "tty"):
        what = "text" if kind == "tty" else "a single picture"
        raise ImageError(f"{path} is {what}, not a video; eagor locate takes a picture, eagor track a folder of them")
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
    filtered = "AREA" if height < picture.height or width < picture.width else "BILINEAR"
    rgb = picture.reformat(width, height, "rgb24", src_colorspace=colours, interpolation=filtered, threads=1)
    return rgb.to_ndarray()
