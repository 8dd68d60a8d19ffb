"""A camera that is there now: frames of one or several live streams, the newest first.

A thread of its own decodes all that comes of a stream and keeps the newest picture. What nobody took in time is
counted. A stream that breaks off is opened again after a pause that grows; meanwhile `problem` says what is wrong.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eagor._files import redacted
from eagor.cameras import Rig
from eagor.errors import DeviceError, EagorError, ImageError, TimeError
from eagor.media import Frame
from eagor.media.intrinsics import Camera
from eagor.media.stitching import PanoramaBuilder
from eagor.media.video import to_rgb
from eagor.odometry.clocks import StreamClock

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

    from eagor.media.streams import RawPipe, Stream

__all__ = ["FrameGrabber", "LiveCamera", "TimedFrame"]

STALL = 2.0  # seconds without a picture that are worth a word
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0  # seconds before a broken stream is opened again; each time twice as long
PATIENCE = 20.0  # seconds to wait for the first picture: an RTSP camera may take ten to its first key picture
APART = 0.1  # seconds by which the newest pictures of two lenses may differ before it is said


@dataclass(frozen=True, eq=False)
class TimedFrame:
    """A decoded picture, its `stamp` (seconds, capture), and which one it is, from 1."""

    stamp: float
    picture: VideoFrame
    number: int


class FrameGrabber:
    """The newest picture of a stream. `latency`: seconds; `rate`: the most pictures per second to keep, or None.

    `problem`: what is wrong now, in words, or None. `dropped`: pictures that nobody took in time, that were damaged, or
    that could not be put in order. `error`: what ended the stream for good; None if it ended as such streams do, or has
    not. Raises `DeviceError` if the stream cannot be opened or no picture comes.
    """

    def __init__(self, stream: Stream | RawPipe, *, latency: float = 0.0, rate: float | None = None) -> None:
        self.stream, self.dropped = stream, 0
        self.newest: TimedFrame | None = None
        self.error: EagorError | None = None
        self._clock, self._rate, self._changed = StreamClock(latency), rate, threading.Condition()
        self._taken = 0  # the number of the picture that was taken last
        self._closed = self._ended = False
        self._broken: str | None = None
        self._since = time.monotonic()  # the last picture, or the beginning
        threading.Thread(target=self._run, name="eagor-camera", daemon=True).start()
        self._wait_for_first()

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
            while wait and not self._closed and not self._is_new() and not self._ended:
                self._changed.wait()
            if self.newest is None or (wait and (self._closed or not self._is_new())):
                return None
            self._taken = self.newest.number
            return self.newest

    def close(self) -> None:
        """Let go. The thread ends as soon as what it waits for returns; nobody waits for that."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _is_new(self) -> bool:
        return self.newest is not None and self.newest.number != self._taken

    def _wait_for_first(self) -> None:
        try:
            with self._changed:
                self._changed.wait_for(lambda: self.newest is not None or self._ended, PATIENCE)
        except BaseException:  # interrupted
            self.close()
            raise
        if self.newest is not None:
            return
        self.close()
        if self.error is not None:
            raise self.error
        why = "it ended before the first picture" if self._ended else f"no picture came within {PATIENCE:.0f} s"
        raise DeviceError(f"{self.stream.name}: {why}. Is something sending pictures there?")

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
        pictures = self.stream.pictures(self._damaged)
        try:
            for own, picture in pictures:
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
                    self.dropped += self._is_new()
                    self.newest = TimedFrame(stamp, picture, 1 if self.newest is None else self.newest.number + 1)
                    self._changed.notify_all()
        finally:
            pictures.close()  # type: ignore[attr-defined]

    def _damaged(self) -> None:
        with self._changed:
            self.dropped += 1


class LiveCamera:
    """A `CameraSource` of one stream, of panoramas or of an ordinary `camera`; or of one per picture of a `rig`.

    Each new picture of the first stream is stitched with the newest ones of the others. Only the newest picture is
    kept: it is made a frame when it is asked for. `dropped` counts those of the first stream that nobody took in time
    and those that were damaged; `rate`: the most pictures per second to take, which are not counted. Streams that break
    off are opened again. `problem`: what is wrong right now, in words, or None. Iterating twice shares the frames.

    Raises `DeviceError` if a stream cannot be opened, or nothing comes; `ImageError` for pictures that are no
    panoramas, or do not fit the rig.
    """

    live = True
    keeps_newest = True

    def __init__(
        self,
        streams: Sequence[Stream | RawPipe],
        *,
        rig: Rig | None = None,
        rows: int | None = None,
        rate: float | None = None,
        latency: float = 0.0,
        camera: Camera | None = None,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to arrival, 0 or more")
        if rate is not None and not (math.isfinite(rate) and rate > 0):
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
            firsts = [grabber.newest for grabber in self._grabbers]
            self._sizes = [(first.picture.width, first.picture.height) for first in firsts if first is not None]
            self._builder = PanoramaBuilder(self._sizes, self._name, rig=rig, camera=camera, rows=rows)
            self._builder.check(*self._decoded([first for first in firsts if first is not None]))
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
                raise ImageError(
                    f"it is {width} x {height}, and the first was {wide} x {high}: another camera or mode? Set it "
                    "back, or start again"
                )
        stamps = [each.stamp for each in taken]
        apart = max(stamps) - min(stamps)
        self._broken = f"{self._name}: the pictures of its lenses are {apart:.2f} s apart" if apart > APART else None
        return self._builder.make(*self._decoded(taken))

    def _decoded(self, taken: Sequence[TimedFrame]) -> list[np.ndarray]:
        return [to_rgb(each.picture, *size) for each, size in zip(taken, self._builder.wanted, strict=True)]

    def _warn(self, text: str) -> None:
        """Once for each source and kind of trouble."""
        if text[:60] not in self._warned:
            self._warned.add(text[:60])
            warnings.warn(text, UserWarning, stacklevel=3)
