"""Video files, written picture by picture by PyAV. Pictures are shown at their own stamps, from the first one on."""

from __future__ import annotations

import os
import uuid
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eagor._extras import need
from eagor.errors import EagorError, StorageError, TimeError

__all__ = ["VIDEOS", "Movie"]

# Suffix: the container, its encoders (the first that is there is used), and options of the container. A hybrid MP4
# grows by fragments (of a second; the option is in microseconds), so that it can be played even if its end is never
# written, and ends as an ordinary one.
VIDEOS: dict[str, tuple[str, tuple[str, ...], dict[str, str]]] = {
    ".mp4": ("mp4", ("libx264", "mpeg4"), {"movflags": "hybrid_fragmented+frag_keyframe", "frag_duration": "1000000"}),
    ".mkv": ("matroska", ("libx264", "mpeg4"), {}),
    ".webm": ("webm", ("libvpx-vp9",), {}),
}
SETTINGS = {
    "libx264": {"crf": "21", "preset": "veryfast"},
    "libvpx-vp9": {"crf": "33", "b": "0", "deadline": "realtime", "cpu-used": "7", "row-mt": "1"},
    "mpeg4": {"qmin": "3", "qmax": "6"},
}
NOMINAL = 2.0  # pictures per second, where it is not told
TICKS = 60_000  # per second, of the stamps in a video: the pictures of 24, 25, 29.97, 30 and 60 Hz fall on whole ones
BETWEEN_KEYS = 30  # pictures from one key frame to the next: players jump to key frames
BT709 = 1  # matrix, primaries and transfer of HD video, in FFmpeg's numbers
LIMITED = 1  # its range


class Movie:
    """A video. It is written beside `path` and takes its place when it is closed.

    What was added is kept whatever happens: a movie that is closed after an error, or that runs out of room, holds the
    pictures so far. `size`: width and height, even; `rate`: pictures per second, for a lone picture's duration.

    Raises `MissingExtraError` without PyAV, `StorageError` if the folder cannot be written to.
    """

    def __init__(self, path: str | Path, size: tuple[int, int], rate: float | None) -> None:
        need("a video", "photos", "av")
        self.path, self.count = Path(path), 0
        self._last = 1 / (rate or NOMINAL)
        self._part = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex[:12]}.part")
        try:
            self._file: _Sink | None = _Sink(self._part)
        except OSError as error:
            raise StorageError(
                f"{path} cannot be written ({error.strerror or error}); name a folder that can be written to"
            ) from error
        try:
            self._container, self._stream = _opened(self._file, self.path.suffix.lower(), size, rate)
        except BaseException:
            self._drop()
            raise
        self._waiting: tuple[np.ndarray, int] | None = None  # how long a picture is shown, the next one tells
        self._durations: dict[int, int] = {}
        self._before = 0

    def add(self, pixels: np.ndarray, stamp: float) -> None:
        """Append a picture ``(height, width, 3)`` uint8; `stamp` in seconds from the first one.

        Raises `StorageError` when there is no more room: the movie is closed, with the pictures that it holds.
        """
        if self._file is None:
            raise StorageError(f"{self.path} is closed")
        tick = round(stamp * TICKS)
        if self._waiting is not None:
            if tick <= self._waiting[1]:
                raise TimeError(f"a picture at {stamp:g} s, less than 1/{TICKS} s after the one before it")
            (before, begin), self._waiting = self._waiting, None
            self._before = tick - begin
            self._encode(before, begin, self._before)
        self._waiting = (pixels, tick)

    def close(self) -> None:
        """Finish the file; nothing is left of a movie without pictures. Raises `StorageError`."""
        if self._file is None:
            return
        if self._waiting is not None:
            (pixels, tick), self._waiting = self._waiting, None
            self._encode(pixels, tick, self._before or round(self._last * TICKS))
        if not self.count:
            self._drop()
            return
        try:
            self._mux(self._stream.encode(None))
            self._container.close()
            self._file.check()
            self._file.close()
            self._part.replace(self.path)
            self._file = None
        except OSError as error:
            self._fail(error)
        finally:
            if self._file is not None:  # interrupted
                self._keep()

    def _encode(self, pixels: np.ndarray, tick: int, duration: int) -> None:
        import av

        assert self._file is not None
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        frame.pts, frame.time_base = tick, Fraction(1, TICKS)
        self._durations[tick] = duration
        try:
            self._mux(self._stream.encode(frame))
            self._file.check()
        except OSError as error:  # PyAV's errors are OSErrors too
            self._fail(error)
        self.count += 1

    def _mux(self, packets: list[Any]) -> None:
        for packet in packets:
            packet.duration = self._durations.pop(packet.pts, 0)
            self._container.mux(packet)

    def _fail(self, error: OSError) -> None:
        """Close what cannot be written on, keep the pictures that it holds, and say so."""
        held, size = self._keep()
        kept = f"Its first {held} pictures are there. " if held else ""
        raise StorageError(
            f"{self.path} takes no more ({error.strerror or error}) after {size} bytes. {kept}Make room, or name "
            "another place"
        ) from error

    def _keep(self) -> tuple[int, int]:
        """Close the unfinished file and let it take its place if it can be played: its pictures and bytes."""
        assert self._file is not None
        self._waiting = None
        with suppress(OSError):
            self._container.close()
        self._file.close()
        held, size = 0, 0
        with suppress(OSError):
            size = self._part.stat().st_size
            if held := _held(self._part):
                self._part.replace(self.path)
        self._drop()
        return held, size

    def _drop(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None
        with suppress(OSError):
            self._part.unlink()


class _Sink:
    """The file that PyAV writes to. It never fails there, where nothing could be saved: `check` says it afterwards."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._at = self._end = 0
        self._failed: BaseException | None = None

    def write(self, data: bytes) -> int:
        """Write all of it, or nothing after the first failure."""
        rest, at = memoryview(data), self._at
        while len(rest) and not isinstance(self._failed, OSError):
            try:
                self._file.seek(at)
                done = self._file.write(rest) or 0
                rest, at = rest[done:], at + done
            except (OSError, KeyboardInterrupt) as error:  # what Ctrl-C cut off is written again, at the same place
                self._failed = error
        self._at += len(data)
        self._end = max(self._end, self._at)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Where to write next."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._end}[whence]
        return self._at

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._at

    def check(self) -> None:
        """Raise what went wrong."""
        if self._failed is not None:
            failed, self._failed = self._failed, self._failed if isinstance(self._failed, OSError) else None
            raise failed

    def close(self) -> None:
        """No more is written; what there is, is on the disk."""
        if not self._file.closed:
            with suppress(OSError):
                os.fsync(self._file.fileno())
            with suppress(OSError):
                self._file.close()


def _opened(file: Any, suffix: str, size: tuple[int, int], rate: float | None) -> tuple[Any, Any]:
    """A container that writes to `file`, and its stream."""
    import av

    container_name, codecs, options = VIDEOS[suffix]
    codec = next((name for name in codecs if name in av.codecs_available), None)
    if codec is None:
        raise EagorError(
            f"this PyAV has no encoder for {suffix} ({' or '.join(codecs)}); name a file that ends in "
            f"{' or '.join(other for other in (*VIDEOS, '.webp', '.gif') if other != suffix)}"
        )
    container = av.open(file, "w", format=container_name, options=options)
    nominal = Fraction(rate or NOMINAL).limit_denominator(1001)
    stream: Any = container.add_stream(codec, rate=nominal, options=SETTINGS[codec])
    stream.width, stream.height = size
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.time_base = Fraction(1, TICKS)
    context.max_b_frames = 0  # pictures leave in the order in which they come
    context.gop_size = BETWEEN_KEYS
    context.colorspace = context.color_primaries = context.color_trc = BT709
    context.color_range = LIMITED
    return container, stream


def _held(path: Path) -> int:
    """How many pictures of an unfinished video can be shown."""
    import av

    count = 0
    with suppress(OSError, ValueError, IndexError), av.open(str(path)) as container:
        for _ in container.decode(video=0):
            count += 1
    return count
