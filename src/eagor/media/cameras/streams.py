"""Streams that FFmpeg (PyAV) opens: V4L2 devices, network addresses, encoded pictures on standard input."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, cast

from eagor._checks import above
from eagor._extras import need
from eagor._secrets import redacted
from eagor.errors import DeviceError
from eagor.media.decoding import Damage, pictures

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame

__all__ = ["Stream", "device", "network", "standard_input"]

OPENING, READING = 10.0, 5.0  # seconds that a network stream may take to open; may be silent before it counts as broken
PROTOCOLS = "rtsp,rtp,udp,tcp,tls,http,https,httpproxy,rtmp,rtmps,rtmpt,rtmpts,srtp,crypto,data,hls"
SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "udp", "tcp", "rtp", "srt")
LOW_LATENCY = {"fflags": "nobuffer", "flags": "low_delay"}
BRIEF = {
    "probesize": "2000000",
    "analyzeduration": "1000000",
}  # bytes and microseconds in which the stream is described
FORMATS = ("mjpeg", "h264", "hevc", "yuyv422", "nv12", "yuv420p", "rgb24", "bgr24", "uyvy422")
_SIZE = re.compile(r"(\d+)x(\d+)")


@dataclass(frozen=True)
class Stream:
    """How to open a stream: `address` for FFmpeg, `format` ("" if it finds out), `options`; `name` is for texts.

    `again`: whether it can be opened once more. `size`: width and height that were asked for, or None.
    """

    address: str
    name: str
    format: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    again: bool = True
    size: tuple[int, int] | None = None

    @property
    def stamped(self) -> bool:
        return False

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """As `eagor.media.cameras.feeds.Opening` says."""
        need(f"reading {self.name}", "photos", "av")
        from av.error import FFmpegError

        container = self._opened()
        try:
            streams = container.streams.video
            if not streams:
                raise DeviceError(
                    f"{self.name} has no pictures, but: {_others(container)}. Give the address of a video"
                )
            stream = streams[0]
            context = stream.codec_context
            if context is None:
                raise DeviceError(
                    f"{self.name} is in a codec that this FFmpeg cannot decode; wanted H.264, H.265, MJPEG"
                )
            context.thread_type = "SLICE"  # threads by picture would hold back a picture for each thread
            damage, before = Damage(), 0
            for picture in pictures(container, stream, damage):
                for _ in range(damage.packets - before):
                    damaged()
                before = damage.packets
                self._check(picture)
                yield picture.time, picture
        except FFmpegError as error:
            raise DeviceError(f"{self.name} broke off ({_why(error)})") from error
        finally:
            container.close()

    def _opened(self) -> InputContainer:
        import av
        from av.error import FFmpegError

        try:
            found = av.open(
                self.address,
                format=self.format or None,
                options=dict(self.options),
                timeout=(OPENING, READING),
                metadata_errors="replace",
            )
        except (FFmpegError, OSError, ValueError) as error:
            raise DeviceError(f"{self.name} cannot be opened ({_why(error)}). {self._hint(error)}") from error
        return cast("InputContainer", found)

    def _hint(self, error: Exception) -> str:
        if self.format == "v4l2":
            if isinstance(error, PermissionError):
                return "Add yourself to the group video (sudo usermod -aG video $USER), and log in again"
            if getattr(error, "errno", 0) == 16:
                return "Another program uses it; end that"
            return "Is it a camera, and can it give this size, rate and format? v4l2-ctl --list-formats-ext shows them"
        if self.address.startswith("pipe:"):
            return "Wanted encoded pictures (MPEG-TS, Matroska, MJPEG); raw ones are pipe:rgb24:1920x960"
        return "Is the address right, the camera on, and this machine in its network?"

    def _check(self, picture: VideoFrame) -> None:
        if self.size is not None and (picture.width, picture.height) != self.size:
            wide, high = self.size
            raise DeviceError(
                f"{self.name} gives pictures of {picture.width} x {picture.height}, not {wide} x {high} as asked for. "
                "Choose a size that it has (v4l2-ctl --list-formats-ext shows them)"
            )


def device(path: str, settings: Mapping[str, str]) -> Stream:
    """A V4L2 camera at `path` (/dev/video0); `settings`: size=WxH, rate=HZ, format=mjpeg.

    Raises `DeviceError` if there is none, in words that list those that there are.
    """
    options, size, kind = {}, None, settings.get("format", "")
    for key, value in settings.items():
        if key == "size":
            found = _SIZE.fullmatch(value)
            if found is None:
                raise DeviceError(f"{path}: size={value}; wanted width and height, such as size=1920x960")
            size, options["video_size"] = (int(found[1]), int(found[2])), value
        elif key == "rate":
            try:
                fits = above(float(value), 0)
            except ValueError:
                fits = False
            if not fits:
                raise DeviceError(f"{path}: rate={value}; wanted pictures per second, such as rate=30")
            options["framerate"] = value
        elif key == "format":
            if kind not in FORMATS:
                raise DeviceError(f"{path}: format={value}; wanted one of {', '.join(FORMATS)}")
            options["input_format"] = value
        else:
            raise DeviceError(f"{path}: there is no setting {key!r}; wanted size=WxH, rate=HZ or format=mjpeg")
    try:
        mode = os.stat(path).st_mode
    except OSError:
        there = ", ".join(str(each) for each in sorted(Path("/dev").glob("video*")))
        have = f"this machine has {there}" if there else "this machine has no camera (no /dev/video*)"
        raise DeviceError(f"there is no {path}; {have}. Plug it in, or give another source") from None
    if not stat.S_ISCHR(mode):
        raise DeviceError(
            f"{path} is no device; wanted a camera such as /dev/video0, or the path of a video or a folder"
        )
    return Stream(path, path, "v4l2", options, size=size)


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


def _others(container: InputContainer) -> str:
    return ", ".join(sorted({stream.type for stream in container.streams})) or "nothing"


def _why(error: Exception) -> str:
    said = getattr(error, "strerror", None) or str(error)
    return "it did not answer in time" if said.startswith("Immediate exit") else redacted(said)
