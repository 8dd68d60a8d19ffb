"""Clocks that do not agree: by how much they differ, from the messages or pictures that one sends to the other.

A message is stamped there and arrives here later, never earlier. So ``arrival - stamp`` is the difference of the clocks
plus a delay, and the smallest of many is nearest to the difference alone (V. Paxson, SIGMETRICS 1998).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from eagor._checks import checked_stamp

__all__ = ["ClockJump", "ClockOffset", "ClockSync", "LatencyFilter", "TimestampDejitter"]

WINDOW = 60.0  # seconds for which the quickest message counts
LONG_WINDOW = 600.0  # the same, for delays: what grows more slowly than a limit of 0.1 s in that time is like drift
DRIFT = 1e-4  # seconds per second: a poor quartz, 100 ppm
JUMP = 0.1  # seconds: a larger step is a clock that was set; smaller ones are delays
CONFIRMED = 3  # messages in a row that have to agree on a jump
SETTLED = 5.0  # seconds for which messages have to be late alike before it is no longer a delay
AHEAD = 0.05  # seconds by which a stamp of our own clock may lie in the future (rounding, slewing)
LATE = 0.25  # seconds: no network's quickest message takes longer, so a larger difference is one of clocks

STREAM_WINDOW = 10.0  # seconds: long enough to hold an arrival without delay, short enough for a drift of 1 ms
PROBATION = 3.0  # seconds that a stream's clock is watched before it counts, and over which its pace is judged
PACE = 0.03  # share by which its pace may differ from this machine's: a file sent too fast or a wrong rate is more
GAP = 10.0  # seconds by which a stream's clock may jump ahead of the time that passed here, before it counts as another


class _Quickest:
    """The quickest message of the last `window` seconds; older ones count as `drift` seconds later per second.

    Memory is bounded: only messages that may still become the quickest are kept.
    """

    def __init__(self, window: float, drift: float = 0.0) -> None:
        self.window, self.drift = window, drift
        self._kept: deque[tuple[float, float]] = deque()  # arrival, arrival - stamp; later ones are less quick

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, arrival: float, late: float) -> None:
        while self._kept and self._kept[-1][1] + self.drift * (arrival - self._kept[-1][0]) >= late:
            self._kept.pop()
        self._kept.append((arrival, late))
        while self._kept[0][0] < arrival - self.window:
            self._kept.popleft()

    def at(self, arrival: float) -> float:
        """``arrival - stamp`` of the quickest message, as it would be now."""
        when, late = self._kept[0]
        return late + self.drift * max(0.0, arrival - when)

    def clear(self) -> None:
        self._kept.clear()


@dataclass(frozen=True)
class ClockJump:
    """A clock was set: `seconds` by which it went forward (negative: back), and the first `stamp` after it."""

    seconds: float
    stamp: float


@dataclass
class _Strange:
    """Messages in a row that do not fit, but agree: stamp and arrival of the first, their number, the quickest."""

    stamp: float
    since: float
    count: int
    quickest: tuple[float, float]  # arrival, arrival - stamp


class ClockOffset:
    """What to add to the stamps of another clock to have ours, tracked message by message. It reads no clock.

    `window`: seconds for which a message counts. A step of more than `JUMP` is believed once `CONFIRMED` messages in a
    row agree on it (they come too early, or their stamps went back), or once messages are late alike for `settled`
    seconds; infinite: messages that are late never count as a clock that was set. Until then, and for single wrong
    stamps, nothing changes. `doubtful`: whether the newest message cannot be one of the clock as it was.
    """

    def __init__(self, window: float = WINDOW, settled: float = SETTLED) -> None:
        self.settled, self.doubtful = settled, False
        self._quickest = _Quickest(window, DRIFT)
        self._strange: _Strange | None = None
        self._last = self._now = 0.0  # stamp and arrival of the newest message that fits

    @property
    def offset(self) -> float | None:
        """Seconds to add to a stamp; None before any message. It exceeds the truth by the quickest delay."""
        return self._quickest.at(self._now) if self._quickest else None

    def add(self, stamp: float, arrival: float) -> ClockJump | None:
        """Take in a message; returns a jump of the other clock once it is believed.

        `stamp`, `arrival`: seconds, on its clock and on ours. Raises `TimeError` for stamps that are no times.
        """
        stamp, arrival = checked_stamp(stamp), checked_stamp(arrival)
        late = arrival - stamp
        if not self._quickest or abs(late - self._quickest.at(arrival)) <= JUMP:
            return self._take(stamp, arrival)
        odd = self._strange
        if odd is None or abs(late - odd.quickest[1]) > JUMP:
            odd = self._strange = _Strange(stamp, arrival, 0, (arrival, late))
        odd.count += 1
        when, quickest = odd.quickest = min(odd.quickest, (arrival, late), key=lambda each: each[1])
        # No delay explains what came before it was sent, or after later ones.
        self.doubtful = quickest < self._quickest.at(when) - JUMP or odd.stamp < self._last - JUMP
        if odd.count < CONFIRMED or not (self.doubtful or arrival - odd.since >= self.settled):
            return None
        jump = ClockJump(self._quickest.at(arrival) - quickest, odd.stamp)
        self._quickest.clear()
        self._take(when - quickest, when)
        self._take(stamp, arrival)
        return jump

    def _take(self, stamp: float, arrival: float) -> None:
        self._quickest.add(arrival, arrival - stamp)
        self._strange, self.doubtful, self._last, self._now = None, False, stamp, arrival


class LatencyFilter:
    """How much later than the quickest messages come, from their own stamps: a delay that grows is noticed.

    Clocks may drift by `DRIFT`, so that a delay that grows as slowly is taken for that.
    """

    def __init__(self) -> None:
        self._clock = ClockOffset(window=LONG_WINDOW, settled=math.inf)

    def of(self, stamp: float, arrival: float) -> float:
        """Seconds. `stamp`: of the other clock, 0 if that tells no time; `arrival`: on ours."""
        if stamp <= 0:
            return 0.0
        self._clock.add(stamp, arrival)
        return max(0.0, arrival - stamp - (self._clock.offset or 0.0))


class ClockSync:
    """The stamps of a source on our clock, whether it uses ours or one of its own.

    A source uses our clock if its quickest message takes from -`AHEAD` to `latest` seconds: its stamps are then taken
    as they are. Otherwise its clock is another one, and its stamps are shifted by the tracked offset (`ClockOffset`).
    `latency`: seconds that its stamps have been set back for what it knows of its own delay.
    """

    def __init__(self, name: str, latency: float = 0.0, latest: float = LATE) -> None:
        self.name, self.latency, self.latest = name, latency, latest
        self.offsets = ClockOffset()
        self.related = False

    @property
    def shift(self) -> float:
        """Seconds that are added to its stamps now."""
        offset = self.offsets.offset
        return offset - self.latency if self.related and offset is not None else 0.0

    def take(self, stamp: float, arrival: float) -> tuple[float | None, str | None]:
        """A stamp on our clock, and what to say of the clocks, if there is news.

        The stamp is None while it contradicts those before it: a wrong one, or the first ones after a jump.
        """
        jump = self.offsets.add(stamp, arrival)
        if self.offsets.doubtful:
            return None, None
        offset, before = self.offsets.offset, self.related
        assert offset is not None
        self.related = not -AHEAD <= offset - self.latency <= self.latest
        news = None
        if jump is not None and (self.related or before):  # else the first messages came late, and those after do not
            way = f"{'forward' if jump.seconds > 0 else 'back'} by {abs(jump.seconds):.2f} s"
            end = "; its stamps are shifted" if self.related else ", to this machine's time"
            news = f"the clock of the {self.name} jumped {way}{end}"
        elif jump is None and self.related and not before:
            way = "behind" if self.shift > 0 else "ahead of"
            news = (
                f"the clock of the {self.name} is {abs(self.shift):.3f} s {way} this machine's; its stamps are shifted"
            )
        return stamp + self.shift, news


class TimestampDejitter:
    """Stamps for the pictures of one live stream; `latency`: seconds from capture to the earliest possible arrival.

    A picture has up to two times: when it arrived here, and what its stream says, on a clock of the camera's own with
    an unknown beginning. Arrival jitters: networks, decoders and a busy machine make it late, never early. The
    stream's increments do not jitter.

    Stamps are on the clock of ``time.time()``. They are computed on the monotonic clock, so that a step of this
    machine's clock does not come between two pictures. In the first `PROBATION` seconds, and while the stream's clock
    runs at another pace than time does, its times are not used, and the arrival counts. `now`, `monotonic`: the two
    clocks, for tests. `timeless`: whether the stream's own times are missing, or cannot be used.
    """

    def __init__(
        self,
        latency: float = 0.0,
        now: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.latency, self.timeless = latency, False
        self._now, self._monotonic = now, monotonic
        self._last = self._arrival = self._begin = -math.inf
        self.restart()

    def restart(self) -> None:
        """The stream begins anew: its clock tells nothing about the one before."""
        self._least = _Quickest(STREAM_WINDOW)
        self._recent: deque[tuple[float, float]] = deque()  # all (arrival, difference) of two probations
        self._told: float | None = None

    def stamp(self, told: float | None, arrival: float) -> float | None:
        """The time of capture of a picture that came at `arrival` (monotonic), and whose stream says `told`, or None.

        None if that is not later than the picture before: such a picture cannot be put in order.
        """
        taken = arrival if told is None else self._related(told, arrival)
        self.timeless |= told is None
        if taken <= self._last:
            return None
        self._last = taken
        return taken - self.latency + (self._now() - self._monotonic())

    def _related(self, told: float, arrival: float) -> float:
        """The monotonic time at which a picture of the time `told` would have arrived without delay."""
        if self._told is None or not 0 <= told - self._told <= arrival - self._arrival + GAP:  # it begins, or was set
            self.restart()
            self._begin = arrival
        self._told, self._arrival = told, arrival
        self._least.add(arrival, arrival - told)
        self._recent.append((arrival, arrival - told))
        while self._recent[0][0] < arrival - 2 * PROBATION:
            self._recent.popleft()
        if arrival < self._begin + PROBATION:
            return arrival
        # Its pace is time's if the least differences of two halves of the last seconds agree.
        middle = (self._recent[0][0] + arrival) / 2
        early = min((late for at, late in self._recent if at <= middle), default=math.nan)
        late = min((late for at, late in self._recent if at > middle), default=math.nan)
        self.timeless = not abs(late - early) <= PACE * (arrival - middle)
        return arrival if self.timeless else told + self._least.at(arrival)
