"""The threads of a live loop: readers of its sources, and workers that take the newest item.

Live poses of robots are in `eagor.robots`.
"""

from __future__ import annotations

import math
import threading
import time
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Generic, TypeVar

import numpy as np

from eagor.errors import EagorError
from eagor.live.events import Part
from eagor.live.inference import error_text
from eagor.sphere import heading

__all__ = ["FrozenCamera", "LatestWorker", "LoopClock", "Reader", "already_open"]

REOPENED = (0.5, 10.0)  # seconds before a source that is gone is opened again: at first, and at most; doubled each time
TURNED = math.radians(3.0)  # by which the camera may turn without its picture changing at all
HANGS = "the picture stays the same although the camera turns: does it hang? Restart the camera or its driver"
ROWS = 128  # of a picture that are compared, and as dense along them: a sensor's noise alone changes these

Item = TypeVar("Item")


def already_open(source: Any, opens: Callable[[], Any]) -> Callable[[], Any]:
    """A function that opens a source which is open already: the first call gives that one."""
    waiting = [source]
    return lambda: waiting.pop() if waiting else opens()


class Reader:
    """Reads `source` in a thread of its own, item by item, until `close`.

    `source`: an object, which is read again when it ends, or a function that opens one. These are called in the thread:
    `give` with each item; `trouble` with what is wrong, in words, and "" once it works again; `ended` at the end of a
    recording, with what went wrong or "". Anything may be raised by a source: it is said, and it is opened again.
    """

    def __init__(
        self,
        name: Part,
        source: Any,
        *,
        give: Callable[[Any], Any],
        trouble: Callable[[str], Any],
        ended: Callable[[str], Any],
    ) -> None:
        self.name: Part = name
        opened = hasattr(source, "close")
        self.source: Any = source if opened else None  # None while it is gone
        self._open = None if opened else source
        self._give, self._trouble, self._ended = give, trouble, ended
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def opened(self) -> Any:
        """The source, opened if it was not: for whoever reads it without the thread."""
        if self.source is None:
            assert self._open is not None
            self.source = self._open()
        return self.source

    def start(self, played: Callable[[Any], Iterable[Any]] | None = None) -> None:
        """Begin to read. `played` gives the items of a recording, which is read once."""
        self._thread = threading.Thread(target=self._read, args=[played], name=f"eagor {self.name}", daemon=True)
        self._thread.start()

    def interrupt(self) -> None:
        """Close the source if it can be opened again, so that its thread comes back and does so."""
        if self._open is not None and self.source is not None:
            with suppress(Exception):
                self.source.close()

    def close(self, patience: float) -> None:
        """Close the source, and wait so many seconds for the thread to come back from it."""
        self._stopped.set()
        if self.source is not None:
            with suppress(Exception):
                self.source.close()
        if self._thread is not None:
            self._thread.join(patience)

    def _read(self, played: Callable[[Any], Iterable[Any]] | None) -> None:
        pause, bad = REOPENED[0], False
        while not self._stopped.is_set():
            text = ""
            try:
                for item in self.opened() if played is None else played(self.opened()):
                    if self._stopped.is_set():
                        return
                    if bad:
                        self._trouble("")
                    pause, bad = REOPENED[0], False
                    self._give(item)
            except Exception as error:
                text = error_text(error)
            if self._stopped.is_set():
                return
            if played is not None:
                self._ended(text)
                return
            bad = True
            self._trouble(f"{text or f'the {self.name} ended'}; opened again")
            if self._open is not None:
                gone, self.source = self.source, None
                with suppress(Exception):
                    gone.close()
            self._stopped.wait(pause)
            pause = min(2 * pause, REOPENED[1])


class LoopClock:
    """Seconds since 1970 that never jump: the machine's time at the start, and the seconds since then."""

    def __init__(self) -> None:
        self._wall, self._steady = time.time(), time.monotonic()

    def now(self) -> float:
        return self._wall + (time.monotonic() - self._steady)


class FrozenCamera:
    """Finds a camera that shows one picture again and again while it turns: its driver hangs, and stamps it anew.

    Compares pictures bit by bit. `orientation(stamp)`: `world_R_body` ``(3, 3)`` at a picture that came before.
    """

    def __init__(self, orientation: Callable[[float], np.ndarray | None]) -> None:
        self.problem = ""
        self._orientation, self._stamp = orientation, math.nan
        self._code: int | None = None
        self._heading: float | None = None  # where the camera looked when this picture came first

    def take(self, picture: np.ndarray, stamp: float) -> str:
        """What is wrong, in words, at the picture ``(H, W, 3)`` of this stamp; "" if nothing is."""
        step = max(1, len(picture) // ROWS)
        code, before, self._stamp = zlib.crc32(picture[::step, ::step].tobytes()), self._stamp, stamp
        if code != self._code:
            self._code, self._heading, self.problem = code, None, ""
        elif (pose := self._orientation(before)) is not None:  # poses of one that just came may be on their way
            ahead = heading(pose)
            self._heading = ahead if self._heading is None else self._heading
            if abs(math.remainder(ahead - self._heading, math.tau)) > TURNED:
                self.problem = HANGS
        return self.problem


class LatestWorker(Generic[Item]):
    """Calls `work` with the newest of the items that are given, in a thread; those that it misses are `skipped`.

    Also in the thread: `begin` at first; `ended` at last, with the error that ended it, or None.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[Item], Any],
        begin: Callable[[], Any] = lambda: None,
        ended: Callable[[EagorError | None], Any] = lambda error: None,
    ) -> None:
        self.skipped = 0
        self._changed = threading.Condition()
        self._waiting: Item | None = None
        self._busy = self._closed = False
        self._thread = threading.Thread(
            target=self._serve, args=[work, begin, ended], name=f"eagor {name}", daemon=True
        )
        self._thread.start()

    def give(self, item: Item) -> None:
        """An item; it replaces one that still waits."""
        with self._changed:
            self.skipped += self._waiting is not None
            self._waiting = item
            self._changed.notify_all()

    @property
    def idle(self) -> bool:
        """Whether every item has been dealt with or skipped, or nothing will be any more."""
        with self._changed:
            return not self._thread.is_alive() or (self._waiting is None and not self._busy)

    def wait(self, seconds: float) -> None:
        """Wait so long, or until the next item is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or (self._waiting is None and not self._busy), seconds)

    def end(self) -> None:
        """Nothing more comes; what waits is still dealt with."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def close(self, patience: float | None = None) -> None:
        """End, and wait so many seconds (None: however long it takes) for the thread."""
        self.end()
        self._thread.join(patience)

    def _serve(self, work: Callable[[Item], Any], begin: Callable[[], Any], ended: Callable[..., Any]) -> None:
        error: EagorError | None = None
        try:
            begin()
            while (item := self._next()) is not None:
                work(item)
        except EagorError as problem:
            error = problem
        finally:
            ended(error)

    def _next(self) -> Item | None:
        """Be done with the item before, and wait for the next; None if no more comes."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting is not None or self._closed)
            item, self._waiting = self._waiting, None
            self._busy = item is not None
            return item
