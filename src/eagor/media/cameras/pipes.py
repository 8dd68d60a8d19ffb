"""Raw pictures on standard input, or another pipe: ``pipe:rgb24:1920x960``.

Pictures follow each other without anything between: for rgb24, height x width x 3 bytes, row by row from the top. With
``:stamped`` at the end (``pipe:rgb24:1920x960:stamped``), eight bytes stand before each: the time of capture as a
little-endian IEEE double, seconds on the clock of ``time.time()``. Use it if you know when a picture was taken; without
it, the arrival less the latency counts.
"""

from __future__ import annotations

import math
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from eagor._extras import need
from eagor.errors import DeviceError

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

__all__ = ["RawPipe", "raw_pipe"]

# Format: numerator and denominator of bytes per pixel, and the shape of the array that PyAV takes.
BYTES = {"rgb24": 3.0, "bgr24": 3.0, "rgba": 4.0, "bgra": 4.0, "gray": 1.0, "yuv420p": 1.5, "nv12": 1.5, "yuyv422": 2.0}
LARGEST = 1 << 27  # pixels
_SPEC = re.compile(r"pipe:(\w+):(\d+)x(\d+)(:stamped)?")
STAMP = struct.Struct("<d")


class Readable(Protocol):
    """Where the bytes come from: a file, a pipe."""

    def read(self, size: int = -1, /) -> bytes | None:
        """Up to `size` bytes; empty at the end."""
        ...


@dataclass(frozen=True)
class RawPipe:
    """Raw pictures of `kind` (a name of FFmpeg's) with `width` and `height` that `file` brings; see the module."""

    file: Readable
    kind: str
    width: int
    height: int
    stamped: bool = False
    name: str = "standard input"
    again: bool = False

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """As `eagor.media.cameras.feeds.Opening` says."""
        need("reading raw pictures", "photos", "av")
        import av

        size = round(self.width * self.height * BYTES[self.kind])
        head = STAMP.size if self.stamped else 0
        while True:
            data = self._exactly(head + size)
            if len(data) < head + size:
                if data:
                    damaged()
                    warnings.warn(
                        f"{self.name} ended in the middle of a picture, after {len(data)} of {head + size} bytes. Are "
                        f"its pictures {self.kind} of {self.width} x {self.height}?",
                        UserWarning,
                        stacklevel=2,
                    )
                return
            told = STAMP.unpack_from(data)[0] if self.stamped else None
            if told is not None and not (math.isfinite(told) and 0 < told < 1e11):
                raise DeviceError(
                    f"{self.name}: the time before a picture is {told:g}; wanted seconds since 1970 as a little-endian "
                    f"double, then {size} bytes ({self.kind}, {self.width} x {self.height}). Pictures without times: "
                    "leave out :stamped"
                )
            array = np.frombuffer(data, np.uint8, offset=head).reshape(self._shape())
            yield told, av.VideoFrame.from_ndarray(np.ascontiguousarray(array), format=self.kind)

    def _shape(self) -> tuple[int, ...]:
        per = BYTES[self.kind]
        if per == 1.5:
            return self.height * 3 // 2, self.width
        return (self.height, self.width) if per == 1.0 else (self.height, self.width, int(per))

    def _exactly(self, count: int) -> bytes:
        """`count` bytes, or fewer at the end."""
        parts, left = [], count
        while left:
            part = self.file.read(left)
            if not part:
                break
            parts.append(part)
            left -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)


def raw_pipe(text: str, file: Readable) -> RawPipe:
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
