"""Cameras that are there now: V4L2 devices, network addresses, encoded pictures on a pipe (by PyAV), and raw ones.

A thread of its own decodes all that comes of a stream and keeps the newest picture. What nobody took in time is
counted. A stream that breaks off is opened again after a pause that grows; meanwhile `problem` says what is wrong.
Raw pictures (``pipe:rgb24:1920x960``) follow each other row by row from the top, without anything between but, with
``:stamped`` at the end, the time of capture before each: a little-endian double, seconds on the clock of
``time.time()``.
"""

from __future__ import annotations

import errno
import math
import os
import re
import stat
import struct
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

import numpy as np

from eagor._checks import above
from eagor._extras import require_extra
from eagor._files import redacted
from eagor.errors import DeviceError, EagorError, ImageError, TimeError
from eagor.odometry.clocks import TimestampDejitter
from eagor.sources import Frame
from eagor.sources.stitching import PanoramaBuilder
from eagor.sources.video import Damage, pictures, to_rgb

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame

__all__ = [
    "SCHEMES", "STREAMS", "FrameGrabber", "LiveCamera", "Stream", "TimedFrame", "device", "network", "raw_pipe",
    "standard_input",
]  # fmt: skip

OPENING, READING = 10.0, 5.0  # seconds that a network stream may take to open; may be silent before it counts as broken
PROTOCOLS = "rtsp,rtp,udp,tcp,tls,http,https,httpproxy,rtmp,rtmps,rtmpt,rtmpts,srtp,crypto,data,hls"
SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "udp", "tcp", "rtp", "srt")
LOW_LATENCY = {"fflags": "nobuffer", "flags": "low_delay"}
BRIEF = {"probesize": "2000000", "analyzeduration": "1000000"}  # bytes, microseconds in which a stream is described
SETTINGS = {"size": "video_size", "rate": "framerate", "format": "input_format"}  # and what FFmpeg calls them
_SIZE = re.compile(r"(\d+)x(\d+)")

BYTES = {"rgb24": 3, "bgr24": 3, "rgba": 4, "bgra": 4, "gray": 1}  # per pixel
LARGEST = 1 << 27  # pixels
_SPEC = re.compile(r"pipe:(\w+):(\d+)x(\d+)(:stamped)?")
STAMP = struct.Struct("<d")

STALL = 2.0  # seconds without a picture that are worth a word
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0  # seconds before a broken stream is opened again; each time twice as long
PATIENCE = 20.0  # seconds to wait for the first picture: an RTSP camera may take ten to its first key picture
APART = 0.1  # seconds by which the newest pictures of two lenses may differ before it is said


# --- encoded ---


@dataclass(frozen=True)
class Stream:
    """How to open a stream: `address` for FFmpeg, `format` ("" if it finds out), `options`; `name` is for texts.

    `again`: whether it can be opened once more. `size`: width and height that were asked for, or None. `stamped`: its
    times are those of capture, on this machine's clock (``time.time()``). `raw`: what reads it in place of FFmpeg.
    """

    address: str
    name: str
    format: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    again: bool = True
    size: tuple[int, int] | None = None
    stamped: bool = False
    raw: Callable[..., Iterator[tuple[float | None, VideoFrame]]] | None = None

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """Time (seconds on the stream's own clock, or None) and picture, as they come, until the stream ends.

        `damaged` is called for each picture that is lost. Raises `DeviceError` in words.
        """
        if self.raw is not None:
            yield from self.raw(damaged)
            return
        require_extra(f"reading {self.name}", "photos", "av")
        import av
        from av.error import FFmpegError

        how = {"options": dict(self.options), "timeout": (OPENING, READING), "metadata_errors": "replace"}
        try:
            container = cast("InputContainer", av.open(self.address, format=self.format or None, **how))  # type: ignore[call-overload]
        except (FFmpegError, OSError, ValueError) as error:
            raise DeviceError(f"{self.name} cannot be opened ({_why(error)}). {self._hint(error)}") from error
        try:
            streams = container.streams.video
            if not streams:
                others = ", ".join(sorted({stream.type for stream in container.streams})) or "nothing"
                raise DeviceError(f"{self.name} has no pictures, but: {others}. Give the address of a video")
            if (context := streams[0].codec_context) is None:
                wanted = "wanted H.264, H.265, MJPEG"
                raise DeviceError(f"{self.name} is in a codec that this FFmpeg cannot decode; {wanted}")
            context.thread_type = "SLICE"  # threads by picture would hold back a picture for each thread
            damage, before = Damage(), 0
            for picture in pictures(container, streams[0], damage):
                for _ in range(damage.packets - before):
                    damaged()
                before = damage.packets
                if self.size not in (None, (picture.width, picture.height)):
                    wide, high = self.size
                    raise DeviceError(
                        f"{self.name} gives pictures of {picture.width} x {picture.height}, not {wide} x {high} as "
                        "asked for. Choose a size that it has (v4l2-ctl --list-formats-ext shows them)"
                    )
                yield picture.time, picture
        except FFmpegError as error:
            raise DeviceError(f"{self.name} broke off ({_why(error)})") from error
        finally:
            container.close()

    def _hint(self, error: Exception) -> str:
        if isinstance(error, PermissionError):
            return "Add yourself to the group video (sudo usermod -aG video $USER), and log in again"
        if getattr(error, "errno", 0) == errno.EBUSY:
            return "Another program uses it; end that"
        if self.format == "v4l2":
            return "Is it a camera, and can it give this size, rate and format? v4l2-ctl --list-formats-ext shows them"
        if self.address.startswith("pipe:"):
            return "Wanted encoded pictures (MPEG-TS, Matroska, MJPEG); raw ones are pipe:rgb24:1920x960"
        return "Is the address right, the camera on, and this machine in its network?"


def device(text: str) -> Stream:
    """A V4L2 camera: /dev/video0, v4l2:0, with ?size=WxH&rate=HZ&format=mjpeg.

    Raises `DeviceError` if there is none, in words that list those that there are.
    """
    place, _, query = text.partition("?")
    path = place.removeprefix("v4l2:")
    path = f"/dev/video{path}" if path.isdigit() else path
    settings = {key: value for key, _, value in (pair.partition("=") for pair in query.split("&") if pair)}
    for key in settings:
        if key not in SETTINGS:
            raise DeviceError(f"{path}: there is no setting {key!r}; wanted size=WxH, rate=HZ or format=mjpeg")
    found = _SIZE.fullmatch(settings.get("size", "1x1"))
    if found is None:
        raise DeviceError(f"{path}: size={settings['size']}; wanted width and height, such as size=1920x960")
    size = (int(found[1]), int(found[2])) if "size" in settings else None
    if not os.path.exists(path):
        there = ", ".join(map(str, sorted(Path("/dev").glob("video*")))) or "no camera (no /dev/video*)"
        raise DeviceError(f"there is no {path}; this machine has {there}. Plug it in, or give another source")
    if not stat.S_ISCHR(os.stat(path).st_mode):
        raise DeviceError(f"{path} is no device; wanted one such as /dev/video0, or the path of a video or a folder")
    return Stream(path, path, "v4l2", {SETTINGS[key]: value for key, value in settings.items()}, size=size)


def network(address: str) -> Stream:
    """A stream at an address: RTSP (over TCP), RTMP, HTTP, UDP, ..."""
    options = {**LOW_LATENCY, **BRIEF, "protocol_whitelist": PROTOCOLS}
    scheme = address.partition(":")[0].lower()
    if scheme.startswith("rtsp"):
        options["rtsp_transport"] = "tcp"  # over UDP, a lost packet spoils all pictures up to the next key picture
    kind = "mpegts" if scheme == "udp" else ""
    return Stream(address, redacted(address), kind, options)


def standard_input(_: str = "-") -> Stream:
    """Encoded pictures on standard input: MPEG-TS, Matroska, MJPEG, ..."""
    return Stream("pipe:0", "standard input", "", {**LOW_LATENCY, "protocol_whitelist": "pipe"}, again=False)


def _why(error: Exception) -> str:
    said = getattr(error, "strerror", None) or str(error)
    return "it did not answer in time" if said.startswith("Immediate exit") else redacted(said)


# --- raw ---


def _raw(
    damaged: Callable[[], None], *, file: BinaryIO, kind: str, width: int, height: int, stamped: bool
) -> Iterator[tuple[float | None, VideoFrame]]:
    """The pictures of a raw pipe, as those of `Stream`."""
    require_extra("reading raw pictures", "photos", "av")
    import av

    per, head, shape = BYTES[kind], STAMP.size if stamped else 0, f"{kind}, {width} x {height}"
    size = head + width * height * per
    while True:
        data, read = memoryview(bytearray(size)), 0
        while read < size and (part := file.readinto(data[read:])):  # type: ignore[attr-defined]
            read += part
        if 0 < read < size:
            damaged()
            text = f"standard input ended in the middle of a picture, after {read} of {size} bytes. Are its pictures"
            warnings.warn(f"{text} {shape}?", UserWarning, stacklevel=2)
        if read < size:
            return
        told = STAMP.unpack_from(data)[0] if stamped else None
        if told is not None and not (math.isfinite(told) and 0 < told < 1e11):
            raise DeviceError(
                f"standard input: the time before a picture is {told:g}; wanted seconds since 1970 as a little-endian "
                f"double, then {size - head} bytes ({shape}). Pictures without times: leave out :stamped"
            )
        array = np.frombuffer(data, np.uint8, offset=head).reshape(height, width, *((per,) if per > 1 else ()))
        yield told, av.VideoFrame.from_ndarray(array, format=kind)


def raw_pipe(text: str, file: BinaryIO | None = None) -> Stream:
    """The pictures that `file` brings as `text` describes, such as ``pipe:rgb24:1920x960``. Raises `DeviceError`.

    None: standard input.
    """
    file = file or FileIO(0, closefd=False)  # not sys.stdin: who waits for it holds its lock, and Python aborts at exit
    found = _SPEC.fullmatch(text)
    if found is None or found[1] not in BYTES:
        raise DeviceError(
            f"{text}: wanted pipe:FORMAT:WIDTHxHEIGHT, such as pipe:rgb24:1920x960, with :stamped at the end if each "
            f"picture's time comes before it. Formats: {', '.join(BYTES)}"
        )
    width, height, stamped = int(found[2]), int(found[3]), bool(found[4])
    if not 0 < width * height <= LARGEST:
        raise DeviceError(f"{text}: wanted at least 1 and at most {LARGEST} pixels")
    raw = partial(_raw, file=file, kind=found[1], width=width, height=height, stamped=stamped)
    return Stream(text, "standard input", again=False, stamped=stamped, raw=raw)


STREAMS = {  # what a text has to begin with, or be, and what then opens it
    "input": (re.compile(r"(-|pipe:0?)$"), standard_input),
    "pipe": (re.compile("pipe:"), raw_pipe),
    "device": (re.compile(r"((v4l2:)?/dev/[^?]+|v4l2:\d+)(\?|$)"), device),
    "stream": (re.compile(rf"({'|'.join(SCHEMES)})://", re.IGNORECASE), network),
}


# --- the newest picture ---


class TimedFrame(NamedTuple):
    """A decoded picture and its `stamp` (seconds, capture)."""

    stamp: float
    picture: VideoFrame


class FrameGrabber:
    """The newest picture of a stream. `latency`: seconds; `rate`: the most pictures per second to keep, or None.

    `problem`: what is wrong now, in words, or None. `dropped`: pictures that nobody took in time, that were damaged, or
    that could not be put in order. `error`: what ended the stream for good, or None. Raises `DeviceError` if the stream
    cannot be opened or no picture comes.
    """

    def __init__(self, stream: Stream, *, latency: float = 0.0, rate: float | None = None) -> None:
        self.stream, self.dropped = stream, 0
        self.newest: TimedFrame | None = None
        self.error: EagorError | None = None
        self._clock, self._rate, self._changed = TimestampDejitter(latency), rate, threading.Condition()
        self._fresh = self._closed = self._ended = False  # fresh: the newest was not taken yet
        self._broken: str | None = None
        self._since = time.monotonic()  # the last picture, or the beginning
        threading.Thread(target=self._run, name="eagor-camera", daemon=True).start()
        try:
            with self._changed:
                self._changed.wait_for(lambda: self.newest is not None or self._ended, PATIENCE)
            if self.newest is None:
                why = "it ended before the first picture" if self._ended else f"no picture came within {PATIENCE:.0f} s"
                why = f"{stream.name}: {why}. Is something sending pictures there?"
                raise self.error or DeviceError(why)
        except BaseException:  # interrupted, too
            self.close()
            raise

    @property
    def problem(self) -> str | None:
        with self._changed:
            silent = time.monotonic() - self._since
            if self._closed or self._ended:
                return self._broken
            if self._broken is not None:
                return f"{self._broken} (no picture for {silent:.0f} s)"
            return f"{self.stream.name}: no picture for {silent:.0f} s" if silent > STALL else None

    @property
    def timeless(self) -> bool:
        """Whether the stream's own times cannot be used, so that the time of arrival counts."""
        return not self.stream.stamped and self._clock.timeless

    def take(self, wait: bool = True) -> TimedFrame | None:
        """The newest picture; one that was not taken yet, if it is to `wait`. None where no more can come."""
        with self._changed:
            while wait and not (self._closed or self._fresh or self._ended):
                self._changed.wait()
            if wait and (self._closed or not self._fresh):
                return None
            self._fresh = False
            return self.newest

    def close(self) -> None:
        """Let go. The thread ends as soon as what it waits for returns; nobody waits for that."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _run(self) -> None:
        pause = FIRST_PAUSE
        try:
            while not self._closed:
                before, why = self.newest, f"{self.stream.name} ended"
                self._clock.restart()
                try:
                    self._read()
                except EagorError as error:
                    why = redacted(str(error))
                    if self.newest is None or not self.stream.again:
                        self.error = error
                if self._closed or self.newest is None or not self.stream.again:
                    return
                pause = FIRST_PAUSE if self.newest is not before else min(2 * pause, LONGEST_PAUSE)
                with self._changed:
                    self._broken = f"{why}; trying again every {pause:g} s"
                    self._changed.wait_for(lambda: self._closed, pause)
        except Exception as error:  # a bug here or in a library: said, not hidden
            self.error = DeviceError(f"{self.stream.name}: {type(error).__name__}: {error}")
        finally:
            with self._changed:
                self._ended = True
                if self.error is not None:
                    self._broken = redacted(str(self.error))
                self._changed.notify_all()

    def _read(self) -> None:
        """All pictures of the stream, until it ends or `close`."""
        kept = -math.inf
        with closing(self.stream.pictures(self._damaged)) as coming:  # type: ignore[type-var]
            for own, picture in coming:
                arrival = time.monotonic()
                if self._closed:
                    return
                stamp = own if self.stream.stamped else self._clock.stamp(own, arrival)
                with self._changed:
                    self._broken, self._since = None, arrival
                    if stamp is None:
                        self.dropped += 1
                        continue
                    if self._rate is not None and stamp < kept + 0.9 / self._rate:
                        continue
                    kept = stamp
                    self.dropped += self._fresh
                    self.newest, self._fresh = TimedFrame(stamp, picture), True
                    self._changed.notify_all()

    def _damaged(self) -> None:
        with self._changed:
            self.dropped += 1


class LiveCamera:
    """A `CameraSource` of one stream; or of one per picture of a rig. `lens`: as for `PanoramaBuilder`.

    Each new picture of the first stream is stitched with the newest ones of the others. Only the newest is kept, and
    made a frame when it is asked for. `dropped` counts those of the first stream that nobody took in time, and damaged
    ones; `rate`: the most per second to take. `problem`: what is wrong right now, in words, or None. Iterating twice
    shares the frames. Raises `DeviceError` if a stream cannot be opened, or nothing comes; `ImageError` for pictures
    that are no panoramas, or do not fit the rig.
    """

    live = True
    keeps_newest = True

    def __init__(
        self,
        streams: Sequence[Stream],
        *,
        rate: float | None = None,
        latency: float = 0.0,
        **lens: Any,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to arrival, 0 or more")
        if rate is not None and not above(rate, 0):
            raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
        if latency and any(stream.stamped for stream in streams):
            raise TimeError(f"latency = {latency:g} s, but the pictures come with their times of capture; leave it out")
        self.latency, self._name, self._unfit = latency, streams[0].name, 0
        self._broken: str | None = None
        self._warned: set[str] = set()
        self._grabbers: list[FrameGrabber] = []
        try:
            for stream in streams:
                self._grabbers.append(FrameGrabber(stream, latency=latency, rate=rate))
            firsts = [grabber.newest for grabber in self._grabbers if grabber.newest is not None]
            self._sizes = [(first.picture.width, first.picture.height) for first in firsts]
            self._builder = PanoramaBuilder(self._sizes, self._name, **lens)
            self._builder.check(*self._decoded(firsts))
        except BaseException:
            self.close()
            raise
        self.grid, self.unseen = self._builder.grid, self._builder.unseen

    @property
    def dropped(self) -> int:
        return self._grabbers[0].dropped + self._unfit

    @property
    def problem(self) -> str | None:
        """What is wrong right now, in words; None if nothing is."""
        return next((problem for grabber in self._grabbers if (problem := grabber.problem)), self._broken)

    def __iter__(self) -> Iterator[Frame]:
        first, *others = self._grabbers
        while (newest := first.take()) is not None:
            taken = [newest, *(found for each in others if (found := each.take(wait=False)) is not None)]
            try:
                picture = self._made(taken)
            except EagorError as error:
                self._unfit += 1
                self._broken = f"{self._name}: a picture is left out: {error}"
                self._warn(self._broken)
                continue
            if first.timeless:
                self._warn(
                    f"{self._name} tells no times, or not those of the pictures: each is stamped with its arrival less "
                    f"the latency ({self.latency:g} s), and carries the jitter of its way"
                )
            at = time.strftime("%H:%M:%S", time.gmtime(newest.stamp)) + f"{newest.stamp % 1:.3f}"[1:]
            yield Frame(newest.stamp, picture, f"{self._name} {at}", self._builder.view)
        if first.error is not None:
            raise first.error

    def close(self) -> None:
        for grabber in self._grabbers:
            grabber.close()

    def _made(self, taken: Sequence[TimedFrame]) -> np.ndarray:
        """The frame of the pictures of all streams."""
        for each, (wide, high) in zip(taken, self._sizes, strict=True):
            width, height = each.picture.width, each.picture.height
            if abs(width * high - wide * height) > 0.02 * high * width:
                came = f"it is {width} x {height}, and the first was {wide} x {high}"
                raise ImageError(f"{came}: another camera or mode? Set it back, or start again")
        apart = max(each.stamp for each in taken) - min(each.stamp for each in taken)
        self._broken = f"{self._name}: the pictures of its lenses are {apart:.2f} s apart" if apart > APART else None
        return self._builder.make(*self._decoded(taken))

    def _decoded(self, taken: Sequence[TimedFrame]) -> list[np.ndarray]:
        return [to_rgb(each.picture, *size) for each, size in zip(taken, self._builder.wanted, strict=True)]

    def _warn(self, text: str) -> None:
        """Once for each source and kind of trouble."""
        if text[:60] not in self._warned:
            self._warned.add(text[:60])
            warnings.warn(text, UserWarning, stacklevel=3)
