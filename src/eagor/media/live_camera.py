"""A camera that is there now: frames of one or several live streams, newest first: panoramas, or ordinary pictures.

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
from eagor.errors import DeviceError, EagorError, ImageError, TimeError
from eagor.media import Frame
from eagor.media.intrinsics import Camera
from eagor.media.rig_videos import makers
from eagor.media.rigs import Rig
from eagor.media.video import to_rgb
from eagor.odometry.clocks import StreamClock

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

    from eagor.media.streams import RawPipe, Stream

__all__ = ["Feed", "LiveCamera", "Shot"]

STALL = 2.0  # seconds without a picture that are worth a word
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0  # seconds before a broken stream is opened again; each time twice as long
PATIENCE = 20.0  # seconds to wait for the first picture: an RTSP camera may take ten to its first key picture

APART = 0.1  # seconds by which the newest pictures of two lenses may differ before it is said


@dataclass(frozen=True, eq=False)
class Shot:
    """A decoded picture, its `stamp` (seconds, capture), and which one it is, from 1."""

    stamp: float
    picture: VideoFrame
    number: int


class Feed:
    """The newest picture of a stream. `latency`: seconds; `rate`: the most pictures per second to keep, or None.

    `changed`: told of whatever comes, so that one may wait for several feeds; None: one of its own.
    `problem`: what is wrong now, in words, or None. `dropped`: pictures that nobody took in time, that were damaged, or
    that could not be put in order. `error`: what ended the stream for good; None if it ended as such streams do, or has
    not. Raises `DeviceError` if the stream cannot be opened or no picture comes.
    """

    def __init__(
        self,
        stream: Stream | RawPipe,
        *,
        latency: float = 0.0,
        rate: float | None = None,
        changed: threading.Condition | None = None,
    ) -> None:
        self.stream, self.dropped = stream, 0
        self._clock, self._rate = StreamClock(latency), rate
        self._changed = changed or threading.Condition()
        self._shot: Shot | None = None
        self._taken = 0  # the number of the shot that was taken last
        self._count = 0
        self._closed = self._ended = self._began = False
        self.error: EagorError | None = None
        self._trouble: str | None = None
        self._since = time.monotonic()  # the last picture, or the beginning
        self._thread = threading.Thread(target=self._run, name="eagor-camera", daemon=True)
        self._thread.start()
        self._wait_for_first()

    @property
    def problem(self) -> str | None:
        with self._changed:
            silent = time.monotonic() - self._since
            if self._closed or self._ended:
                return self._trouble
            if self._trouble is not None:
                return f"{self._trouble} (no picture for {silent:.0f} s)"
            return f"{self.stream.name}: no picture for {silent:.0f} s" if silent > STALL else None

    @property
    def timeless(self) -> bool:
        """Whether the stream's own times cannot be used, so that the time of arrival counts."""
        return not self.stream.stamped and self._clock.timeless

    @property
    def seen(self) -> Shot | None:
        """The newest picture, without taking it."""
        with self._changed:
            return self._shot

    def newest(self) -> Shot | None:
        """The newest picture, taken before or not; None before the first."""
        with self._changed:
            if self._shot is not None:
                self._taken = self._shot.number
            return self._shot

    @property
    def waits(self) -> bool:
        """Whether there is a picture that was not taken yet."""
        return not self._closed and self._shot is not None and self._shot.number != self._taken

    @property
    def over(self) -> bool:
        """Whether no more can come."""
        return self._closed or (self._ended and not self.waits)

    def close(self) -> None:
        """Let go. The thread ends as soon as what it waits for returns; nobody waits for that."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _wait_for_first(self) -> None:
        try:
            with self._changed:
                end = time.monotonic() + PATIENCE
                while self._shot is None and not self._ended and time.monotonic() < end:
                    self._changed.wait(end - time.monotonic())
                if self._shot is not None:
                    return
                error = self.error
        except BaseException:  # interrupted
            self.close()
            raise
        self.close()
        if error is not None:
            raise error
        why = "it ended before the first picture" if self._ended else f"no picture came within {PATIENCE:.0f} s"
        raise DeviceError(f"{self.stream.name}: {why}. Is something sending pictures there?")

    def _run(self) -> None:
        pause = FIRST_PAUSE
        try:
            while not self._closed:
                before, why = self._count, f"{self.stream.name} ended"
                self._clock.restart()
                try:
                    self._read()
                except EagorError as error:
                    why = redacted(str(error))
                    if not self._began or not self.stream.again:
                        self.error = error
                if not self._began or not self.stream.again or self._closed:
                    return
                pause = FIRST_PAUSE if self._count > before else min(2 * pause, LONGEST_PAUSE)
                with self._changed:
                    self._trouble = f"{why}; trying again every {pause:g} s"
                    self._changed.wait_for(lambda: self._closed, pause)
        except Exception as error:  # a bug here or in a library: said, not hidden
            self.error = DeviceError(f"{self.stream.name}: {type(error).__name__}: {error}")
        finally:
            with self._changed:
                self._ended = True
                if self.error is not None:
                    self._trouble = redacted(str(self.error))
                self._changed.notify_all()

    def _read(self) -> None:
        """All pictures of the stream, until it ends or `close`."""
        kept = float("-inf")
        pictures = self.stream.pictures(self._damaged)
        try:
            for told, picture in pictures:
                arrival = time.monotonic()
                if self._closed:
                    return
                stamp = told if self.stream.stamped else self._clock.stamp(told, arrival)
                with self._changed:
                    self._began, self._trouble, self._since = True, None, arrival
                    if stamp is None:
                        self.dropped += 1
                        continue
                    if self._rate is not None and stamp < kept + 0.9 / self._rate:
                        continue
                    kept = stamp
                    self.dropped += self._shot is not None and self._shot.number != self._taken
                    self._count += 1
                    self._shot = Shot(stamp, picture, self._count)
                    self._changed.notify_all()
        finally:
            pictures.close()  # type: ignore[attr-defined]

    def _damaged(self) -> None:
        with self._changed:
            self.dropped += 1


class LiveCamera:
    """A `CameraSource` of one stream, of panoramas or of an ordinary `camera`; or of one per picture of a `rig`.

    Pictures of a rig's ordinary lenses come as they are, each lens in its turn, unless `stitched`. Only the newest
    picture is kept (`keeps_newest`): it is made a panorama when it is asked for. `dropped` counts those
    that nobody took in time and those that were damaged; `rate`: the most pictures per second to take, which are not
    counted. Streams that break off are opened again. `problem`: what is wrong right now, in words, or None. Iterating
    twice shares the frames.

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
        stitched: bool = False,
    ) -> None:
        if not math.isfinite(latency):
            raise TimeError(f"latency = {latency!r}; wanted seconds from capture to arrival, 0 or more")
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise TimeError(f"rate = {rate!r}; wanted pictures per second, more than 0")
        if latency and any(stream.stamped for stream in streams):
            raise TimeError(f"latency = {latency:g} s, but the pictures come with their times of capture; leave it out")
        self.latency = latency
        self._name = streams[0].name
        self._broken: str | None = None
        self._unfit = 0
        self._warned: set[str] = set()
        self._feeds: list[Feed] = []
        self._changed = threading.Condition()
        try:
            for stream in streams:
                self._feeds.append(Feed(stream, latency=latency, rate=rate, changed=self._changed))
            shots = [shot for feed in self._feeds if (shot := feed.seen) is not None]
            sizes = tuple((shot.picture.width, shot.picture.height) for shot in shots)
            self._sizes = sizes
            self._makers = makers(sizes, rig, rows, self._name, camera, stitched)
            self._wanted = [size for each in self._makers for size in each.wanted]
            if len(self._makers) == 1:
                self._makers[0].check(*map(self._picture, range(len(shots)), shots))
        except BaseException:
            self.close()
            raise
        self.grid, self.unseen = self._makers[0].grid, self._makers[0].unseen
        self._turn = [*range(len(self._makers))]  # the lenses, that which waited longest first

    @property
    def dropped(self) -> int:
        return sum(feed.dropped for feed in self._feeds[: len(self._makers)]) + self._unfit

    @property
    def problem(self) -> str | None:
        """What is wrong right now, in words; None if nothing is."""
        return next((said for feed in self._feeds if (said := feed.problem)), self._broken)

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        while (lens := self._next()) is not None:
            feeds = self._feeds if len(self._makers) == 1 else [self._feeds[lens]]
            shots = [found for feed in feeds if (found := feed.newest()) is not None]
            try:
                picture = self._made(lens, shots)
            except EagorError as error:
                self._unfit += 1
                self._broken = f"{self._name}: a picture is left out: {error}"
                self._warn(self._broken)
                continue
            name, stamp = feeds[0].stream.name, shots[0].stamp
            if feeds[0].timeless:
                self._warn(
                    f"{name} tells no times, or not those of the pictures: each is stamped with its arrival less the "
                    f"latency ({self.latency:g} s), and carries the jitter of its way"
                )
            if stamp == last:  # of another lens: no two frames have one stamp
                stamp = math.nextafter(stamp, math.inf)
            last = stamp
            yield Frame(stamp, picture, f"{name} {_clock(stamp)}", self._makers[lens].view, lens)
        for feed in self._feeds[: len(self._makers)]:
            if feed.error is not None:
                raise feed.error

    def close(self) -> None:
        for feed in self._feeds:
            feed.close()

    def _next(self) -> int | None:
        """Wait for a picture; the lens that took it. None where no more can come, or after `close`."""
        with self._changed:
            while True:
                lens = next((each for each in self._turn if self._feeds[each].waits), None)
                if lens is not None:
                    self._turn.remove(lens)
                    self._turn.append(lens)
                    return lens
                if all(self._feeds[each].over for each in self._turn):
                    return None
                self._changed.wait()

    def _made(self, lens: int, shots: Sequence[Shot]) -> np.ndarray:
        """The frame of these pictures: of all streams, or of the one with this number."""
        sizes = tuple((shot.picture.width, shot.picture.height) for shot in shots)
        first = self._sizes if len(self._makers) == 1 else self._sizes[lens : lens + 1]
        if len(sizes) != len(first):
            raise ImageError("one of the lenses' streams gave no picture")
        for now, before in zip(sizes, first, strict=True):
            if abs(now[0] * before[1] - now[1] * before[0]) > 0.02 * before[1] * now[0]:
                raise ImageError(
                    f"it is {now[0]} x {now[1]}, and the first was {before[0]} x {before[1]}: another camera or mode? "
                    "Set it back, or start again"
                )
        apart = max(shot.stamp for shot in shots) - min(shot.stamp for shot in shots)
        self._broken = None
        if apart > APART:
            self._broken = f"{self._name}: the pictures of its lenses are {apart:.2f} s apart"
        return self._makers[lens].make(*(self._picture(lens + k, shot) for k, shot in enumerate(shots)))

    def _picture(self, number: int, shot: Shot) -> np.ndarray:
        return to_rgb(shot.picture, *self._wanted[number])

    def _warn(self, text: str) -> None:
        """Once for each source and kind of trouble."""
        kind = text[:60]
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, UserWarning, stacklevel=3)


def _clock(stamp: float) -> str:
    """The time of day in UTC, such as 13:05:07.250."""
    return time.strftime("%H:%M:%S", time.gmtime(stamp)) + f"{stamp % 1:.3f}"[1:]
