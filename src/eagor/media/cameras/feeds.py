"""One live stream of pictures, read by a thread of its own: devices, network streams, pipes.

The thread decodes all that comes and keeps the newest picture. What nobody took in time is counted. A stream that
breaks off is opened again after a pause that grows; meanwhile `problem` says what is wrong.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from eagor._secrets import redacted
from eagor.errors import DeviceError, EagorError
from eagor.media.cameras.clock import StreamClock

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

__all__ = ["Feed", "Opening", "Shot"]

STALL = 2.0  # seconds without a picture that are worth a word
FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0  # seconds before a broken stream is opened again; each time twice as long
PATIENCE = 20.0  # seconds to wait for the first picture: an RTSP camera may take ten to its first key picture


@dataclass(frozen=True, eq=False)
class Shot:
    """A decoded picture, its `stamp` (seconds, capture), and which one it is, from 1."""

    stamp: float
    picture: VideoFrame
    number: int


class Opening(Protocol):
    """Opens a stream: a device, an address, a pipe. `name`: for texts. `again`: whether it can be opened once more."""

    @property
    def name(self) -> str: ...

    @property
    def again(self) -> bool: ...

    def pictures(self, damaged: Callable[[], None]) -> Iterator[tuple[float | None, VideoFrame]]:
        """Time (seconds on the stream's own clock, or None) and picture, as they come, until the stream ends.

        `damaged` is called for each picture that is lost. Raises `DeviceError` or `ImageError` in words.
        """
        ...

    @property
    def stamped(self) -> bool:
        """Whether its times are those of capture, on this machine's clock (``time.time()``)."""
        ...


class Feed:
    """The newest picture of a stream. `latency`: seconds; `rate`: the most pictures per second to keep, or None.

    `problem`: what is wrong now, in words, or None. `dropped`: pictures that nobody took in time, that were damaged, or
    that could not be put in order. Raises `DeviceError` if the stream cannot be opened or no picture comes.
    """

    def __init__(self, opening: Opening, *, latency: float = 0.0, rate: float | None = None) -> None:
        self.opening, self.dropped = opening, 0
        self._clock, self._rate = StreamClock(latency), rate
        self._changed = threading.Condition()
        self._shot: Shot | None = None
        self._taken = 0  # the number of the shot that was taken last
        self._count = 0
        self._closed = self._ended = self._began = False
        self._error: EagorError | None = None
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
            return f"{self.opening.name}: no picture for {silent:.0f} s" if silent > STALL else None

    @property
    def timeless(self) -> bool:
        """Whether the stream's own times cannot be used, so that the time of arrival counts."""
        return not self.opening.stamped and self._clock.timeless

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

    def take(self) -> Shot | None:
        """The newest picture that was not taken yet; waits for one. None where no more can come, or after `close`."""
        with self._changed:
            while not self._closed:
                if self._shot is not None and self._shot.number != self._taken:
                    self._taken = self._shot.number
                    return self._shot
                if self._ended:
                    break
                self._changed.wait()
            return None

    @property
    def error(self) -> EagorError | None:
        """What ended the stream for good; None if it ended as such streams do, or has not."""
        return self._error

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
                error = self._error
        except BaseException:  # interrupted
            self.close()
            raise
        self.close()
        if error is not None:
            raise error
        why = "it ended before the first picture" if self._ended else f"no picture came within {PATIENCE:.0f} s"
        raise DeviceError(f"{self.opening.name}: {why}. Is something sending pictures there?")

    def _run(self) -> None:
        pause = FIRST_PAUSE
        try:
            while not self._closed:
                before, why = self._count, f"{self.opening.name} ended"
                self._clock.restart()
                try:
                    self._read()
                except EagorError as error:
                    why = redacted(str(error))
                    if not self._began or not self.opening.again:
                        self._error = error
                if not self._began or not self.opening.again or self._closed:
                    return
                pause = FIRST_PAUSE if self._count > before else min(2 * pause, LONGEST_PAUSE)
                with self._changed:
                    self._trouble = f"{why}; trying again every {pause:g} s"
                    self._changed.wait_for(lambda: self._closed, pause)
        except Exception as error:  # a bug here or in a library: said, not hidden
            self._error = DeviceError(f"{self.opening.name}: {type(error).__name__}: {error}")
        finally:
            with self._changed:
                self._ended = True
                if self._error is not None:
                    self._trouble = redacted(str(self._error))
                self._changed.notify_all()

    def _read(self) -> None:
        """All pictures of the stream, until it ends or `close`."""
        kept = float("-inf")
        pictures = self.opening.pictures(self._damaged)
        try:
            for told, picture in pictures:
                arrival = self._clock.arrived()
                if self._closed:
                    return
                stamp = told if self.opening.stamped else self._clock.stamp(told, arrival)
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
