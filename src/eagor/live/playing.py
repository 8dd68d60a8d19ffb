"""Recordings as if they were live: pictures and poses come at the speed at which they were taken."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from eagor.media.frames import Frame, Pose

__all__ = ["LoopClock", "Pace", "paced_frames", "paced_poses"]

EARLY = 1.0  # seconds before the first picture: older poses are not waited for


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
