"""When a picture of a live camera was taken, in this machine's time.

A picture has up to two times: when it arrived here, and what its stream says (the presentation time, on a clock of the
camera's own, with an unknown beginning). Arrival jitters: networks, decoders and a busy machine make it late, never
early. The stream's increments do not jitter. So the least difference between the two, over the last seconds, relates
the clocks (as one-way clock synchronisation does: V. Paxson, SIGMETRICS 1998), and slow drift of the camera's clock is
followed.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

__all__ = ["StreamClock"]

WINDOW = 10.0  # seconds: long enough to hold an arrival without delay, short enough that clocks drift by 1 ms (100 ppm)
PROBATION = 3.0  # seconds that a stream's clock is watched before it counts, and over which its pace is judged
PACE = 0.03  # share by which its pace may differ from this machine's: a file sent too fast or a wrong rate is more
GAP = 10.0  # seconds by which a stream's clock may jump ahead of the time that passed here, before it counts as another


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
        self._least: deque[tuple[float, float]] = deque()  # (arrival, difference), differences increasing
        self._recent: deque[tuple[float, float]] = deque()  # all (arrival, difference) of two probations
        self._told: float | None = None
        self._arrival = self._begin = self._last = float("-inf")

    def arrived(self) -> float:
        """The time of arrival to give to `stamp`, monotonic seconds."""
        return self._monotonic()

    def restart(self) -> None:
        """The stream begins anew: its clock tells nothing about the one before."""
        self._least.clear()
        self._recent.clear()
        self._told = None

    def stamp(self, told: float | None, arrival: float) -> float | None:
        """The time of capture of a picture that `arrival` brought, and whose stream says `told` (seconds, or None).

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
        while self._least and self._least[-1][1] >= difference:
            self._least.pop()
        self._least.append((arrival, difference))
        while self._least[0][0] < arrival - WINDOW:
            self._least.popleft()
        self._recent.append((arrival, difference))
        while self._recent[0][0] < arrival - 2 * PROBATION:
            self._recent.popleft()
        if arrival < self._begin + PROBATION:
            return arrival
        self.timeless = not self._keeps_pace(arrival)
        return arrival if self.timeless else told + self._least[0][1]

    def _keeps_pace(self, arrival: float) -> bool:
        """Whether the least differences of two halves of the last seconds agree."""
        middle = (self._recent[0][0] + arrival) / 2
        early = min((d for at, d in self._recent if at <= middle), default=None)
        late = min((d for at, d in self._recent if at > middle), default=None)
        if early is None or late is None:
            return False
        return abs(late - early) <= PACE * (arrival - middle)
