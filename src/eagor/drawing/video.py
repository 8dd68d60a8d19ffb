"""A track as a video: each frame with the belief, the answer in words, and the time line so far.

`Movie` writes video files picture by picture, by PyAV, `Animation` animated WebP and GIF files, by Pillow. Pictures are
shown at their own stamps, from the first one on.
"""

from __future__ import annotations

import io
import math
import os
import uuid
from contextlib import AbstractContextManager, suppress
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from eagor._extras import need
from eagor._files import written
from eagor.drawing.step import StepPainter
from eagor.drawing.style import DESIGN
from eagor.drawing.timeline import Thinned
from eagor.errors import EagorError, StorageError, TimeError
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
BT709, LIMITED = 1, 1  # matrix, primaries and transfer of HD video, and its range, in FFmpeg's numbers


class BeliefVideo(AbstractContextManager["BeliefVideo"]):
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

    Raises `EagorError` for an unknown suffix, an impossible rate or size, or a folder that is not there or cannot be
    written to; `MissingExtraError` without PyAV.
    """

    def __init__(
        self, path: str | Path, *, rate: float | None = None, size: int | None = None, span: float | None = None
    ) -> None:
        path = Path(path)
        kind = {**dict.fromkeys(VIDEOS, Movie), **dict.fromkeys(ANIMATIONS, Animation)}.get(path.suffix.lower())
        if kind is None:
            wanted = f"a video ({', '.join(VIDEOS)}) or a moving picture ({', '.join(ANIMATIONS)})"
            raise EagorError(f"{path} ends in {path.suffix or 'nothing'}; wanted {wanted}")
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise EagorError(f"{rate} pictures per second; wanted a number above 0")
        if path.is_dir() or not os.access(path.absolute().parent, os.W_OK):
            why = "it is a folder" if path.is_dir() else "there is no folder for it, or none that can be written to"
            raise EagorError(f"{path} cannot be written: {why}; name a file")
        self.painter = StepPainter(size or (DESIGN if kind is Movie else SMALL), span)
        self._movie = kind(path, (self.painter.width, self.painter.height), rate)

    def add(self, picture: np.ndarray | None, estimate: Estimate, **more: Any) -> None:
        """Append one step; arguments as for `StepPainter.paint`. Stamps grow.

        Raises `TimeError` for a stamp that is not later than the last one, `StorageError` when there is no more room:
        the file then holds the pictures before.
        """
        self._movie.add(self.painter.paint(picture, estimate, **more), self.painter.line.now)

    def close(self) -> None:
        """Finish the file. Raises `StorageError`."""
        self._movie.close()

    def __exit__(self, *_: object) -> None:
        self.close()


class Movie:
    """A video. It is written beside `path` and takes its place when it is closed.

    What was added is kept whatever happens: a movie that is closed after an error, or that runs out of room, holds the
    pictures so far. `size`: width and height, even; `rate`: pictures per second, for a lone picture's duration.

    Raises `MissingExtraError` without PyAV, `StorageError` if the folder cannot be written to.
    """

    def __init__(self, path: str | Path, size: tuple[int, int], rate: float | None) -> None:
        need("a video", "photos", "av")
        import av

        self.path = Path(path)
        suffix = self.path.suffix.lower()
        container, codecs, options = VIDEOS[suffix]
        codec = next((name for name in codecs if name in av.codecs_available), None)
        if codec is None:
            others = " or ".join(other for other in (*VIDEOS, *ANIMATIONS) if other != suffix)
            raise EagorError(
                f"this PyAV has no encoder for {suffix} ({' or '.join(codecs)}); name a file that ends in {others}"
            )
        self._part = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex[:12]}.part")
        try:
            self._file: Any = av.open(str(self._part), "w", format=container, options=options)
        except OSError as error:
            raise StorageError(f"{path} cannot be written ({error.strerror}); name a folder that can be") from error
        nominal = Fraction(rate or NOMINAL).limit_denominator(1001)
        self._stream: Any = self._file.add_stream(codec, rate=nominal, options=SETTINGS[codec])
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        context = self._stream.codec_context
        context.time_base = Fraction(1, TICKS)
        context.max_b_frames = 0  # pictures leave in the order in which they come
        context.gop_size = BETWEEN_KEYS
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        self._tick, self._long = -1, round(TICKS / nominal)  # of the last picture, and for how long one was shown
        self._packet: Any = None  # how long its picture is shown, the next one tells

    def add(self, pixels: np.ndarray, stamp: float) -> None:
        """Append a picture ``(height, width, 3)`` uint8; `stamp` in seconds from the first one.

        It is shown until the next one; the last one for as long as the one before it. Raises `StorageError` when there
        is no more room: the movie is closed, with the pictures that it holds.
        """
        import av

        tick = round(stamp * TICKS)
        if self._file is None:
            raise StorageError(f"{self.path} is closed")
        if tick <= self._tick:
            raise TimeError(f"a picture at {stamp:g} s, less than 1/{TICKS} s after the one before it")
        how: dict[str, Any] = {"format": "yuv420p", "dst_colorspace": "ITU709", "dst_color_range": "MPEG"}
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24").reformat(**how)
        frame.pts, frame.time_base = tick, Fraction(1, TICKS)
        self._tick = tick
        self._encode(frame)

    def close(self) -> None:
        """Finish the file; nothing is left of a movie without pictures. Raises `StorageError`."""
        try:
            if self._file is not None and self._tick >= 0:
                self._encode(None)
        finally:
            if self._file is not None:
                self._end()

    def _encode(self, frame: Any) -> None:
        """Write a picture, or all that the encoder still holds; if that fails, end the file with what it has."""
        try:
            for packet in (*self._stream.encode(frame), *([None] if frame is None else [])):
                if self._packet is not None:
                    self._long = self._long if packet is None else packet.pts - self._packet.pts
                    self._packet.duration = self._long
                    self._file.mux(self._packet)
                self._packet = packet
            if frame is None:
                self._file.close()
        except OSError as error:
            self._end()
            text = f"{self.path} takes no more ({error.strerror}); it has the pictures so far"
            raise StorageError(f"{text}. Make room, or name another place") from error

    def _end(self) -> None:
        """Close the file, and let it take its place if there is a picture in it."""
        import av

        plays = False
        with suppress(OSError):
            self._file.close()
        with suppress(OSError, ValueError, IndexError, StopIteration), av.open(str(self._part)) as file:
            plays = next(file.decode(video=0)) is not None
        self._file = None
        if plays:
            self._part.replace(self.path)
        self._part.unlink(missing_ok=True)


class Animation:
    """An animated WebP or GIF, held in memory until it is closed; of more than 240 pictures every second one goes."""

    def __init__(self, path: Path, size: tuple[int, int], rate: float | None) -> None:
        self.path, self._last = path, 1 / (rate or NOMINAL)
        self._kept, self._end = Thinned(MOST), 0.0  # the end: the last stamp

    def add(self, pixels: np.ndarray, stamp: float) -> None:
        """Append a picture ``(height, width, 3)`` uint8; `stamp` in seconds from the first one."""
        from PIL import Image

        if self._kept.items and round(1000 * stamp) <= round(1000 * self._end):
            raise TimeError(f"a picture at {stamp:g} s, less than a millisecond after the one before it")
        picture = Image.fromarray(pixels)
        if self.path.suffix.lower() == ".gif" and self._kept.wants:
            picture = picture.quantize(256, dither=Image.Dither.NONE)
        self._kept.add((picture, stamp))
        self._last, self._end = stamp - self._end or self._last, stamp

    def close(self) -> None:
        """Write the file; nothing without pictures. Raises `StorageError`."""
        if not self._kept.items:
            return
        pictures, stamps = zip(*self._kept.items, strict=True)
        self._kept, buffer, suffix = Thinned(MOST), io.BytesIO(), self.path.suffix.lower()
        step = 10 if suffix == ".gif" else 1  # milliseconds: the clock of a GIF
        at = [step * round(1000 * stamp / step) for stamp in (*stamps, self._end + self._last)]
        how = {"duration": [max(step, end - begin) for begin, end in pairwise(at)], "append_images": pictures[1:]}
        pictures[0].save(buffer, ANIMATIONS[suffix], save_all=True, loop=0, quality=78, method=4, **how)
        written(self.path, buffer.getvalue())
