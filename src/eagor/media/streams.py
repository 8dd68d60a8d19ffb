"""Streams of pictures: V4L2 devices, network addresses and encoded pictures (by PyAV), raw ones from a pipe.

Raw pictures, ``pipe:rgb24:1920x960``, follow each other without anything between: for rgb24, height x width x 3 bytes,
row by row from the top. With ``:stamped`` at the end (``pipe:rgb24:1920x960:stamped``), eight bytes stand before each:
the time of capture as a little-endian IEEE double, seconds on the clock of ``time.time()``. Use it if you know when a
picture was taken; without it, the arrival less the latency counts.
"""

from __future__ import annotations

import errno
import math
import os
import re
import stat
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar, cast

import numpy as np

from eagor._extras import need
from eagor._files import redacted
from eagor.errors import DeviceError
from eagor.media.video import Damage, pictures

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame

__all__ = ["RawPipe", "Stream", "device", "network", "raw_pipe", "standard_input"]

OPENING, READING = 10.0, 5.0  # seconds that a network stream may take to open; may be silent before it counts as broken
PROTOCOLS = "rtsp,rtp,udp,tcp,tls,http,https,httpproxy,rtmp,rtmps,rtmpt,rtmpts,srtp,crypto,data,hls"
SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "udp", "tcp", "rtp", "srt")
LOW_LATENCY = {"fflags": "nobuffer", "flags": "low_delay"}
BRIEF = {"probesize": "2000000", "analyzeduration": "1000000"}  # bytes, microseconds in which a stream is described
SETTINGS = {"size": "video_size", "rate": "framerate", "format": "input_format"}  # and what FFmpeg calls them
_SIZE = re.compile(r"(\d+)x(\d+)")

# Bytes per pixel.
BYTES = {"rgb24": 3.0, "bgr24": 3.0, "rgba": 4.0, "bgra": 4.0, "gray": 1.0, "yuv420p": 1.5, "nv12": 1.5, "yuyv422": 2.0}
LARGEST = 1 << 27  # pixels
_SPEC = re.compile(r"pipe:(\w+):(\d+)x(\d+)(:stamped)?")
STAMP = struct.Struct("<d")


# --- encoded ---


@dataclass(frozen=True)
class Stream:
    """How to open a stream: `address` for FFmpeg, `format` ("" if it finds out), `options`; `name` is for texts.

    `again`: whether it can be opened once more. `size`: width and height that were asked for, or None. `stamped`:
    whether its times are those of capture, on this machine's clock (``time.time()``).
    """

    address: str
    name: str
    format: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    again: bool = True
    size: tuple[int, int] | None = None
    stamped: ClassVar[bool] = False

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """Time (seconds on the stream's own clock, or None) and picture, as they come, until the stream ends.

        `damaged` is called for each picture that is lost. Raises `DeviceError` in words.
        """
        need(f"reading {self.name}", "photos", "av")
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
                raise DeviceError(
                    f"{self.name} is in a codec that this FFmpeg cannot decode; wanted H.264, H.265, MJPEG"
                )
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


def device(path: str, settings: Mapping[str, str]) -> Stream:
    """A V4L2 camera at `path` (/dev/video0); `settings`: size=WxH, rate=HZ, format=mjpeg.

    Raises `DeviceError` if there is none, in words that list those that there are.
    """
    for key in settings:
        if key not in SETTINGS:
            raise DeviceError(f"{path}: there is no setting {key!r}; wanted size=WxH, rate=HZ or format=mjpeg")
    found = _SIZE.fullmatch(settings.get("size", "1x1"))
    if found is None:
        raise DeviceError(f"{path}: size={settings['size']}; wanted width and height, such as size=1920x960")
    size = (int(found[1]), int(found[2])) if "size" in settings else None
    if not os.path.exists(path):
        there = ", ".join(str(each) for each in sorted(Path("/dev").glob("video*")))
        have = f"this machine has {there}" if there else "this machine has no camera (no /dev/video*)"
        raise DeviceError(f"there is no {path}; {have}. Plug it in, or give another source")
    if not stat.S_ISCHR(os.stat(path).st_mode):
        raise DeviceError(
            f"{path} is no device; wanted a camera such as /dev/video0, or the path of a video or a folder"
        )
    return Stream(path, path, "v4l2", {SETTINGS[key]: value for key, value in settings.items()}, size=size)


def network(address: str) -> Stream:
    """A stream at an address: RTSP (over TCP), RTMP, HTTP, UDP, ..."""
    options = {**LOW_LATENCY, **BRIEF, "protocol_whitelist": PROTOCOLS}
    scheme = address.partition(":")[0].lower()
    if scheme.startswith("rtsp"):
        options["rtsp_transport"] = "tcp"  # over UDP, a lost packet spoils all pictures up to the next key picture
    kind = "mpegts" if scheme == "udp" else ""
    return Stream(address, redacted(address), kind, options)


def standard_input() -> Stream:
    """Encoded pictures on standard input: MPEG-TS, Matroska, MJPEG, ..."""
    return Stream("pipe:0", "standard input", "", {**LOW_LATENCY, "protocol_whitelist": "pipe"}, again=False)


def _why(error: Exception) -> str:
    said = getattr(error, "strerror", None) or str(error)
    return "it did not answer in time" if said.startswith("Immediate exit") else redacted(said)


# --- raw ---


@dataclass(frozen=True)
class RawPipe:
    """Raw pictures of `kind` (a name of FFmpeg's) with `width` and `height` that `file` brings; see the module."""

    file: BinaryIO
    kind: str
    width: int
    height: int
    stamped: bool = False
    name: str = "standard input"
    again: bool = False

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """As those of `Stream`."""
        need("reading raw pictures", "photos", "av")
        import av

        per, head = BYTES[self.kind], STAMP.size if self.stamped else 0
        rows, planes = (self.height * 3 // 2, ()) if per == 1.5 else (self.height, () if per == 1 else (int(per),))
        size = head + round(self.width * self.height * per)
        shape = f"{self.kind}, {self.width} x {self.height}"
        while True:
            data, read = memoryview(bytearray(size)), 0
            while read < size and (part := self.file.readinto(data[read:])):  # type: ignore[attr-defined]
                read += part
            if 0 < read < size:
                damaged()
                warnings.warn(
                    f"{self.name} ended in the middle of a picture, after {read} of {size} bytes. Are its pictures "
                    f"{shape}?",
                    UserWarning,
                    stacklevel=2,
                )
            if read < size:
                return
            told = STAMP.unpack_from(data)[0] if self.stamped else None
            if told is not None and not (math.isfinite(told) and 0 < told < 1e11):
                raise DeviceError(
                    f"{self.name}: the time before a picture is {told:g}; wanted seconds since 1970 as a little-endian "
                    f"double, then {size - head} bytes ({shape}). Pictures without times: leave out :stamped"
                )
            array = np.frombuffer(data, np.uint8, offset=head).reshape(rows, self.width, *planes)
            yield told, av.VideoFrame.from_ndarray(np.ascontiguousarray(array), format=self.kind)


def raw_pipe(text: str, file: BinaryIO) -> RawPipe:
    """The pipe that `text` describes, such as ``pipe:rgb24:1920x960``. Raises `DeviceError`."""
    found = _SPEC.fullmatch(text)
    if found is None or found[1] not in BYTES:
        raise DeviceError(
            f"{text}: wanted pipe:FORMAT:WIDTHxHEIGHT, such as pipe:rgb24:1920x960, with :stamped at the end if each "
            f"picture's time comes before it. Formats: {', '.join(BYTES)}"
        )
    width, height = int(found[2]), int(found[3])
    halved = BYTES[found[1]] in (1.5, 2.0)
    if not 0 < width * height <= LARGEST or (halved and (width % 2 or height % 2)):
        even = "even sides, " if halved else ""
        raise DeviceError(f"{text}: wanted {even}at least 1 and at most {LARGEST} pixels")
    return RawPipe(file, found[1], width, height, bool(found[4]))
