"""A track as a video: each frame with the belief, the answer in words, and the time line so far.

`Movie` writes video files picture by picture, by PyAV, `Animation` animated WebP and GIF files, by Pillow. Pictures are
shown at their own stamps, from the first one on.
"""

from __future__ import annotations

import io
import math
import os
import uuid
from contextlib import suppress
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from eagor._extras import need
from eagor._files import written
from eagor.drawing.step import StepPainter
from eagor.drawing.style import DESIGN
from eagor.drawing.timeline import Thinned
from eagor.errors import EagorError, StorageError, TimeError
from eagor.grids import PerspectiveGrid
from eagor.tracking.estimate import Estimate

__all__ = ["ANIMATIONS", "VIDEOS", "Animation", "BeliefVideo", "Movie"]

SMALL = 760  # columns of an animated picture, unless told
ANIMATIONS = {".webp": "WEBP", ".gif": "GIF"}
MOST = 240  # pictures, which are held in memory: about a megabyte each
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


class BeliefVideo:
    """Writes the steps of a track to `path`, as pictures of `StepPainter`, each shown at its own time.

    mp4 and mkv (H.264, or MPEG-4 where PyAV lacks it) and webm (VP9) need the extra ``photos``; webp and gif do not,
    and hold at most 240 pictures. Use it as a context manager. The file takes its place when it is closed, also after
    Ctrl-C or an error: it then holds the pictures so far. Without pictures no file is written, and an old one stays.

    Args:
        path: the file; its suffix chooses the format.
        rate: pictures per second that will come, if known; the last picture is shown for so long if it is alone.
        size: width in pixels, 320 to 3840, made even; default 1280, or 760 for webp and gif. The height is two thirds
            of it: what was seen, the answer above it and the time line below.
        span: length of the clip in seconds, for the time line; None: the time line grows.

    Raises `EagorError` for an unknown suffix, an impossible rate or size, a folder that does not exist; `StorageError`
    if that cannot be written to; `MissingExtraError` without PyAV.
    """

    def __init__(
        self, path: str | Path, *, rate: float | None = None, size: int | None = None, span: float | None = None
    ) -> None:
        self.path = Path(path)
        suffix = self.path.suffix.lower()
        if suffix not in VIDEOS and suffix not in ANIMATIONS:
            raise EagorError(
                f"{path} ends in {suffix or 'nothing'}; wanted a video ({', '.join(VIDEOS)}) or a moving picture "
                f"({', '.join(ANIMATIONS)})"
            )
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise EagorError(f"{rate} pictures per second; wanted a number above 0")
        video = suffix in VIDEOS
        self.painter = StepPainter(size or (DESIGN if video else SMALL), span)
        folder = self.path.absolute().parent
        if not folder.is_dir():
            raise EagorError(f"{self.path} cannot be written: there is no folder {folder}; make it first")
        if self.path.is_dir():
            raise EagorError(f"{self.path} is a folder; name a file")
        whole = (self.painter.width, self.painter.height)
        self._movie = Movie(self.path, whole, rate) if video else Animation(self.path, rate)

    @property
    def count(self) -> int:
        """Pictures in the file so far; of a webp or gif, those that will be in it."""
        return self._movie.count

    def add(
        self,
        picture: np.ndarray | None,
        estimate: Estimate,
        *,
        stamp: float | None = None,
        query: str = "",
        problem: str | None = None,
        grid: PerspectiveGrid | None = None,
    ) -> None:
        """Append one step; arguments as for `StepPainter.paint`. Stamps grow.

        Raises `TimeError` for a stamp that is not later than the last one, `StorageError` when there is no more room:
        the file then holds the pictures before.
        """
        drawn = self.painter.paint(picture, estimate, stamp=stamp, query=query, problem=problem, grid=grid)
        self._movie.add(drawn, self.painter.line.now)

    def close(self) -> None:
        """Finish the file. Raises `StorageError`."""
        self._movie.close()

    def __enter__(self) -> BeliefVideo:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except StorageError:
            if error is None:  # else the first error says what was wrong
                raise


# --- video files ------------------------------------------------------------------------------------------------------


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


# --- animated pictures ------------------------------------------------------------------------------------------------


class Animation:
    """An animated WebP or GIF, held in memory until it is closed; of more than 240 pictures every second one goes."""

    def __init__(self, path: Path, rate: float | None) -> None:
        self.path, self._last = path, 1 / (rate or NOMINAL)
        self._kept, self._closed = Thinned(MOST), False
        self._end, self._before = 0.0, 0.0  # the last stamp, and the seconds from the one before it
        if not os.access(path.absolute().parent, os.W_OK):
            raise StorageError(f"{path} cannot be written; name a folder that can be written to")

    @property
    def count(self) -> int:
        """Pictures in the file."""
        return len(self._kept.items)

    def add(self, pixels: np.ndarray, stamp: float) -> None:
        """Append a picture ``(height, width, 3)`` uint8; `stamp` in seconds from the first one."""
        from PIL import Image

        if self._kept.items and round(1000 * stamp) <= round(1000 * self._end):
            raise TimeError(f"a picture at {stamp:g} s, less than a millisecond after the one before it")
        if self._kept.wants:
            buffer = io.BytesIO()
            picture = Image.fromarray(pixels)
            if self.path.suffix.lower() == ".gif":
                picture = picture.quantize(256, dither=Image.Dither.NONE)
            picture.save(buffer, "PNG", compress_level=1)
            self._kept.add((buffer.getvalue(), stamp))
        else:
            self._kept.add(None)
        self._end, self._before = stamp, stamp - self._end

    def close(self) -> None:
        """Write the file; nothing without pictures. Raises `StorageError`."""
        from PIL import Image

        if self._closed or not self._kept.items:
            return
        self._closed = True
        kind = self.path.suffix.lower()
        step = 10 if kind == ".gif" else 1  # milliseconds: the clock of a GIF
        stamps = [stamp for _, stamp in self._kept.items]
        stamps.append(self._end + (self._before or self._last))
        at = [step * round(1000 * stamp / step) for stamp in stamps]
        shown = [max(step, end - begin) for begin, end in pairwise(at)]
        first, *others = [Image.open(io.BytesIO(data)) for data, _ in self._kept.items]
        buffer, quality = io.BytesIO(), {} if kind == ".gif" else {"quality": 78, "method": 4}
        first.save(
            buffer, ANIMATIONS[kind], save_all=True, append_images=others, duration=shown, loop=0, **quality
        )  # fmt: skip
        written(self.path, buffer.getvalue())
