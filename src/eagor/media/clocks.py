"""Clocks that do not agree: by how much they differ, from the messages or pictures that one sends to the other.

A message is stamped on the robot and arrives here later, never earlier. So ``arrival - stamp`` is the difference of the
clocks plus a delay, and the smallest of many is nearest to the difference alone (as in one-way clock synchronisation:
V. Paxson, SIGMETRICS 1998).

`ClockOffset`: the quickest message of the last minute counts, the less the older it is, since clocks drift. It is
arithmetic on the numbers given; no clock is read.

`StreamClock`, for the pictures of a live camera: a picture has up to two times: when it arrived here, and what its
stream says (the presentation time, on a clock of the camera's own, with an unknown beginning). Arrival jitters:
networks, decoders and a busy machine make it late, never early. The stream's increments do not jitter.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from eagor._checks import checked_stamp

__all__ = ["ClockOffset", "Jump", "Lateness", "RelatedClock", "StreamClock"]

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
        # late + drift * (now - arrival) is least where late - drift * arrival is, whatever the time is.
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
class Jump:
    """A clock was set: `seconds` by which it went forward (negative: back), and the first `stamp` after it."""

    seconds: float
    stamp: float


@dataclass
class _Strange:
    """Messages in a row that do not fit, but agree with each other: the first of them, their number, the quickest."""

    stamp: float
    since: float
    count: int
    quickest: tuple[float, float]  # arrival, arrival - stamp


class ClockOffset:
    """What to add to the stamps of another clock to have ours, tracked message by message.

    `window`: seconds for which a message counts. A step of more than `JUMP` is believed once `CONFIRMED` messages in a
    row agree on it (they come too early, or their stamps went back), or once messages are late alike for `settled`
    seconds; infinite: messages that are late never count as a clock that was set. Until then, and for single wrong
    stamps, nothing changes.
    """

    def __init__(self, window: float = WINDOW, settled: float = SETTLED) -> None:
        self.settled = settled
        self._quickest = _Quickest(window, DRIFT)
        self._strange: _Strange | None = None
        self._last = 0.0  # stamp of the newest message that fits
        self._now = 0.0  # its arrival

    @property
    def offset(self) -> float | None:
        """Seconds to add to a stamp; None before any message. It exceeds the truth by the quickest delay."""
        return self._quickest.at(self._now) if self._quickest else None

    @property
    def doubtful(self) -> bool:
        """Whether the newest message cannot be one of the clock as it was: its stamp is of no use yet."""
        return self._strange is not None and self._impossible(self._strange.stamp, *self._strange.quickest)

    def add(self, stamp: float, arrival: float) -> Jump | None:
        """Take in a message; returns a jump of the other clock once it is believed.

        `stamp`, `arrival`: seconds, on its clock and on ours. Raises `TimeError` for stamps that are no times.
        """
        stamp, arrival = checked_stamp(stamp), checked_stamp(arrival)
        late = arrival - stamp
        if not self._quickest or abs(late - self._quickest.at(arrival)) <= JUMP:
            self._take(stamp, arrival)
            return None
        odd = self._strange
        if odd is None or abs(late - odd.quickest[1]) > JUMP:
            odd = self._strange = _Strange(stamp, arrival, 0, (arrival, late))
        odd.count += 1
        odd.quickest = min(odd.quickest, (arrival, late), key=lambda each: each[1])
        settled = arrival - odd.since >= self.settled
        if odd.count < CONFIRMED or not (settled or self._impossible(odd.stamp, *odd.quickest)):
            return None
        jump = Jump(self._quickest.at(arrival) - odd.quickest[1], odd.stamp)
        self._quickest.clear()
        self._take(odd.quickest[0] - odd.quickest[1], odd.quickest[0])
        self._take(stamp, arrival)
        return jump

    def _impossible(self, stamp: float, arrival: float, late: float) -> bool:
        """Whether no delay explains this message: it came before it was sent, or after later ones."""
        return late < self._quickest.at(arrival) - JUMP or stamp < self._last - JUMP

    def _take(self, stamp: float, arrival: float) -> None:
        self._quickest.add(arrival, arrival - stamp)
        self._strange, self._last, self._now = None, stamp, arrival


class Lateness:
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
        offset = self._clock.offset
        assert offset is not None
        return max(0.0, arrival - stamp - offset)


class RelatedClock:
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
        offset = self.offsets.offset
        assert offset is not None
        was, self.related = self.related, not -AHEAD <= offset - self.latency <= self.latest
        news = None
        if jump is not None:
            way = "forward" if jump.seconds > 0 else "back"
            news = f"the clock of the {self.name} jumped {way} by {abs(jump.seconds):.2f} s; its stamps are shifted"
            if not (self.related or was):  # the first messages came late, and those after them do not
                news = None
            elif not self.related:
                news = f"the clock of the {self.name} jumped {way} by {abs(jump.seconds):.2f} s, to this machine's time"
        elif self.related and not was:
            way = "behind" if self.shift > 0 else "ahead of"
            news = (
                f"the clock of the {self.name} is {abs(self.shift):.3f} s {way} this machine's; its stamps are shifted"
            )
        return stamp + self.shift, news


# --- live streams ---


class StreamClock:
    """Stamps for the pictures of one live stream; `latency`: seconds from capture to the earliest possible arrival.

    Stamps are on the clock of ``time.time()``. They are computed on the monotonic clock, so that a step of this
    machine's clock does not come between two pictures; after a step, stamps follow the new time. In the first
    `PROBATION` seconds, and while the stream's clock runs at another pace than time does, its times are not used, and
    the arrival counts. `now`, `monotonic`: the two clocks, for tests.
    """

    def __init__(
        self,
        latency: float = 0.0,
        now: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.latency = latency
        self.timeless = False  # whether the stream's own times are missing, or cannot be used
        self._now, self._monotonic = now, monotonic
        self._least = _Quickest(STREAM_WINDOW)
        self._recent: deque[tuple[float, float]] = deque()  # all (arrival, difference) of two probations
        self._told: float | None = None
        self._arrival = self._begin = self._last = float("-inf")

    def restart(self) -> None:
        """The stream begins anew: its clock tells nothing about the one before."""
        self._least.clear()
        self._recent.clear()
        self._told = None

    def stamp(self, told: float | None, arrival: float) -> float | None:
        """The time of capture of a picture that came at `arrival` (monotonic), and whose stream says `told`, or None.

        None if that is not later than the picture before: such a picture cannot be put in order.
        """
        taken = arrival if told is None else self._related(told, arrival)
        if told is None:
            self.timeless = True
        if taken <= self._last:
            return None
        self._last = taken
        return taken - self.latency + (self._now() - self._monotonic())

    def _related(self, told: float, arrival: float) -> float:
        """The monotonic time at which a picture of the time `told` would have arrived without delay."""
        last, self._told = self._told, told
        passed, self._arrival = arrival - self._arrival, arrival
        if last is None or told < last or told - last > passed + GAP:  # it begins, or its clock was set
            self._least.clear()
            self._recent.clear()
            self._begin = arrival
        difference = arrival - told
        self._least.add(arrival, difference)
        self._recent.append((arrival, difference))
        while self._recent[0][0] < arrival - 2 * PROBATION:
            self._recent.popleft()
        if arrival < self._begin + PROBATION:
            return arrival
        self.timeless = not self._keeps_pace(arrival)
        return arrival if self.timeless else told + self._least.at(arrival)

    def _keeps_pace(self, arrival: float) -> bool:
        """Whether the least differences of two halves of the last seconds agree."""
        middle = (self._recent[0][0] + arrival) / 2
        early = min((d for at, d in self._recent if at <= middle), default=None)
        late = min((d for at, d in self._recent if at > middle), default=None)
        if early is None or late is None:
            return False
        return abs(late - early) <= PACE * (arrival - middle)
