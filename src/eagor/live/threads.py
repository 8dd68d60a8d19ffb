"""The threads of a live loop: those that read its sources, and those that look at the newest picture.

A recording is read at its own speed. Who looks takes the newest picture when done with the one before: for things, and
for turns. Live poses of robots are in `eagor.robots`.
"""

from __future__ import annotations

import math
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from eagor.errors import EagorError
from eagor.grids import PerspectiveGrid
from eagor.live.events import Event, Part, PoseCame, PosesLost, Trouble
from eagor.live.inference import Failed, Inference, InferenceWorker, Looked, UnusableError
from eagor.media import Frame, Pose
from eagor.odometry.visual import VisualOdometer
from eagor.sphere import heading

__all__ = [
    "FrozenCamera", "LoopClock", "NewestPicture", "Pace", "PerceptionThread", "Picture", "Reader", "VisualPosesThread",
    "already_open", "opener", "paced_frames", "paced_poses", "poses_seen",
]  # fmt: skip

REOPENED = (0.5, 10.0)  # seconds before a source that is gone is opened again: at first, and at most; doubled each time

Item = TypeVar("Item")

TURNED = math.radians(3.0)  # by which the camera may turn without its picture changing at all
HANGS = "the picture stays the same although the camera turns: does it hang? Restart the camera or its driver"
ROWS = 128  # of a picture that are compared, and as dense along them: a sensor's noise alone changes these


def opener(source: Any) -> tuple[Callable[[], Any] | None, Any]:
    """The function that opens a source, and the source itself, whichever of them is given."""
    return (None, source) if hasattr(source, "close") else (source, None)


def already_open(source: Any, opens: Callable[[], Any]) -> Callable[[], Any]:
    """A function that opens a source which is open already: the first call gives that one."""
    waiting = [source]
    return lambda: waiting.pop() if waiting else opens()


class Reader(Generic[Item]):
    """Reads `source` in a thread of its own, item by item, until `close`.

    `open`: opens it again; None: the same object is read again. `items`: what to read of it. `again`: whether it is
    read again when it ends; otherwise it is a recording. These are called in the thread: `give` with each item;
    `trouble` with what is wrong, in words, and "" once it works again; `ended` at the end of a recording, with what
    went wrong or "". Anything may be raised by a source. What it raises is said, and it is opened again.
    """

    def __init__(
        self,
        name: Part,
        source: Any,
        open: Callable[[], Any] | None,
        *,
        items: Callable[[Any], Iterable[Item]],
        again: bool,
        give: Callable[[Item], Any],
        trouble: Callable[[str], Any],
        ended: Callable[[str], Any],
    ) -> None:
        self.name: Part = name
        self._open = open
        self._source: Any = source
        self._items, self._again = items, again
        self._give, self._trouble, self._ended = give, trouble, ended
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"eagor {name}", daemon=True)

    @property
    def source(self) -> Any:
        """What is read now; None while it is gone."""
        return self._source

    def opened(self) -> Any:
        """The source, opened if it was not: for whoever reads it without the thread."""
        if self._source is None:
            assert self._open is not None
            self._source = self._open()
        return self._source

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def interrupt(self) -> None:
        """Close the source if it can be opened again, so that its thread comes back and does so."""
        if self._open is not None and self._source is not None:
            with suppress(Exception):
                self._source.close()

    def close(self, patience: float) -> None:
        """Close the source, and wait so many seconds for the thread to come back from it."""
        self._stopped.set()
        if self._source is not None:
            with suppress(Exception):
                self._source.close()
        if self._thread.is_alive():
            self._thread.join(patience)

    def _read(self) -> None:
        pause, bad = REOPENED[0], False
        while not self._stopped.is_set():
            text = ""
            try:
                for item in self._items(self.opened()):
                    if self._stopped.is_set():
                        return
                    if bad:
                        self._trouble("")
                    pause, bad = REOPENED[0], False
                    self._give(item)
            except (EagorError, OSError) as error:
                text = str(error)
            except Exception as error:
                text = f"{type(error).__name__}: {error}"
            if self._stopped.is_set():
                return
            if not self._again:
                self._ended(text)
                return
            bad = True
            self._trouble(f"{text or f'the {self.name} ended'}; opened again")
            if self._open is not None:
                gone: Any = self._source
                self._source = None
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

    def slip(self) -> float:
        """Seconds by which the machine's time has been set since the start."""
        return time.time() - self.now()


@dataclass(eq=False)
class Pace:
    """When a recording's stamp is due: its first picture comes `begin` is called."""

    clock: LoopClock
    stop: threading.Event
    zero: float | None = None  # the recording's stamp of the first picture
    shift: float = 0.0  # seconds from the recording's clock to the loop's
    _begun: threading.Event = field(default_factory=threading.Event)

    def begin(self, stamp: float) -> None:
        """The first picture is there; the second call does nothing."""
        if self.zero is None:
            self.zero, self.shift = stamp, self.clock.now() - stamp
            self._begun.set()

    def begun(self) -> bool:
        """Wait for the first picture. False if the loop stops before."""
        while not self._begun.wait(0.1):
            if self.stop.is_set():
                return False
        return True

    def due(self, stamp: float) -> bool:
        """Wait until the stamp is due. False if the loop stops before."""
        return not self.stop.wait(max(0.0, stamp + self.shift - self.clock.now()))


def paced_frames(source: Iterable[Frame], pace: Pace) -> Iterator[tuple[Frame, float]]:
    """Each frame when it is due, with its stamp on the loop's clock, and its stamp in the recording."""
    for frame in source:
        pace.begin(frame.stamp)
        if not pace.due(frame.stamp):
            return
        yield replace(frame, stamp=frame.stamp + pace.shift), frame.stamp


def paced_poses(source: Iterable[Pose], pace: Pace) -> Iterator[Pose]:
    """Each pose when it is due, on the loop's clock; of those long before the first picture, the last one at once."""
    if not pace.begun():
        return
    assert pace.zero is not None
    before: Pose | None = None
    for pose in source:
        if pose.stamp < pace.zero:
            before = pose
            continue
        if before is not None:
            yield replace(before, stamp=pace.zero + pace.shift - 1e-6)
            before = None
        if not pace.due(pose.stamp):
            return
        yield replace(pose, stamp=pose.stamp + pace.shift)
    if before is not None:
        yield replace(before, stamp=pace.zero + pace.shift)


class FrozenCamera:
    """Finds a camera that shows one picture again and again while it turns: its driver hangs, and stamps it anew.

    Compares pictures bit by bit. `orientation(stamp)`: `world_R_body` ``(3, 3)`` at a picture that came before.
    """

    def __init__(self, orientation: Callable[[float], np.ndarray | None]) -> None:
        self._orientation = orientation
        self._code: int | None = None
        self._stamp = math.nan
        self._hangs = False
        self._ahead: float | None = None  # where the camera looked when this picture came first

    def take(self, panorama: np.ndarray, stamp: float) -> str:
        """What is wrong, in words, at the picture ``(H, W, 3)`` of this stamp; "" if nothing is."""
        step = max(1, len(panorama) // ROWS)
        code, before = zlib.crc32(panorama[::step, ::step].tobytes()), self._stamp
        same, self._code, self._stamp = code == self._code, code, stamp
        if not same:
            self._ahead, self._hangs = None, False
            return ""
        pose = self._orientation(before)  # poses of a picture that just came may be on their way
        if pose is None:
            return ""
        if self._ahead is None:
            self._ahead = heading(pose)
        turned = math.remainder(heading(pose) - self._ahead, 2 * math.pi)
        self._hangs |= abs(turned) > TURNED
        return HANGS if self._hangs else ""


# --- looking at the newest picture ---


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture ``(H, W, 3)`` to look at: a panorama, or an ordinary one with its `grid`.

    `stamp`: of its source; `told`: the stamp that the perception is told; `unseen` ``(H, W)``: what it does not show.
    """

    stamp: float
    told: float
    picture: np.ndarray
    grid: PerspectiveGrid | None = None
    unseen: np.ndarray | None = None


class NewestPicture:
    """Where a thread takes the newest of the pictures that are given; those that it does not come to are `skipped`."""

    def __init__(self) -> None:
        self.skipped = 0
        self._changed = threading.Condition()
        self._waiting: Picture | None = None
        self._busy = self._ended = False

    def give(self, picture: Picture) -> None:
        """A picture; it replaces one that still waits."""
        with self._changed:
            self.skipped += self._waiting is not None
            self._waiting = picture
            self._changed.notify_all()

    def take(self) -> Picture | None:
        """Be done with the one before, and wait for the next; None if no more comes."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._waiting or self._ended)
            picture, self._waiting = self._waiting, None
            self._busy = picture is not None
            return picture

    def end(self) -> None:
        """Nothing more comes; what waits is still to be taken."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def idle(self) -> bool:
        """Whether every picture has been dealt with or skipped."""
        with self._changed:
            return not self._waiting and not self._busy

    def wait(self, seconds: float) -> None:
        """Wait so long, or until the next picture is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or not (self._waiting or self._busy), seconds)


class PerceptionThread:
    """Has the perception of `inference` look for `queries` at the newest of its `pictures`.

    All of these are called in the thread. `found`: for each look, with the picture (None for what happens while
    loading); `ready`: once the perception is loaded; `ended`: once, with the error if it cannot be. `pose` gives the
    orientation ``(3, 3)`` at a picture that is about to be looked at, or None.
    """

    def __init__(
        self,
        inference: Inference | InferenceWorker,
        queries: Sequence[str],
        *,
        found: Callable[[Picture | None, Looked | Failed], Any],
        ready: Callable[[], Any],
        ended: Callable[[EagorError | None], Any],
        pose: Callable[[float], np.ndarray | None],
    ) -> None:
        self.inference, self.queries, self.pictures = inference, tuple(queries), NewestPicture()
        self._found, self._ready, self._ended, self._pose = found, ready, ended, pose
        self._stopped = False
        self._refused: set[str] = set()
        self._thread = threading.Thread(target=self._serve, name="eagor perception", daemon=True)
        self._thread.start()

    @property
    def idle(self) -> bool:
        """Whether every picture has been looked at or skipped, or nothing will be looked at any more."""
        return not self._thread.is_alive() or self.pictures.idle

    def stop(self) -> None:
        """End the perception's process and the thread, at once."""
        self._stopped = True
        self.pictures.end()
        self.inference.kill()
        self._thread.join()

    def _serve(self) -> None:
        error: EagorError | None = None
        try:
            for failed in self.inference.start():  # before the first picture: loading takes time
                self._found(None, failed)
            self._ready()
            while (picture := self.pictures.take()) is not None and not self._stopped:
                self._look(picture)
        except UnusableError as unusable:
            error = unusable
        finally:
            self.inference.close()
            self._ended(error)

    def _look(self, picture: Picture) -> None:
        queries = [query for query in self.queries if query not in self._refused]
        if not queries:
            return
        pose = self._pose(picture.stamp)
        for said in self.inference.look(picture.picture, queries, picture.told, pose, picture.grid, picture.unseen):
            if self._stopped:
                return
            if isinstance(said, Failed) and said.refused and said.query is not None:
                self._refused.add(said.query)
            self._found(picture, said)


def poses_seen(odometer: VisualOdometer, picture: Picture, now: Callable[[], float]) -> Iterator[Event]:
    """The pose at a picture, after what is to be said of it. `now` gives the times of arrival."""
    try:
        turned = odometer.add(picture.picture, picture.stamp, picture.grid)
    except EagorError as error:
        yield Trouble(now(), "poses", str(error))
        return
    if turned.lost:
        yield PosesLost(now(), "a picture does not fit to those before it: the belief starts anew")
    pose = Pose(picture.stamp, np.asarray(turned.world_R_body), spread=turned.std)
    yield PoseCame(now(), pose, of_picture=True)


class VisualPosesThread:
    """Finds the turn of the newest of its `pictures`; `post` gets what `poses_seen` says, in the thread."""

    def __init__(self, odometer: VisualOdometer, post: Callable[[Event], Any], now: Callable[[], float]) -> None:
        self.pictures = NewestPicture()
        self._odometer, self._post, self._now = odometer, post, now
        self._thread = threading.Thread(target=self._serve, name="eagor visual poses", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def close(self, patience: float) -> None:
        """End, and wait so many seconds for the picture that is being compared."""
        self.pictures.end()
        self._thread.join(patience)

    def _serve(self) -> None:
        while (picture := self.pictures.take()) is not None:
            for event in poses_seen(self._odometer, picture, self._now):
                self._post(event)
