"""The answers of a whole clip over time: what a time line shows, for videos (pixels) and pages (SVG) alike.

An answer holds from its time until the next one, and is drawn so: nothing is interpolated between two answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.drawing.style import STATUS
from eagor.errors import TimeError
from eagor.tracking.estimate import Estimate

__all__ = ["Thinned", "TimeLine", "TimelinePoint"]

MOST = 2400  # moments that are kept for curves: more than a picture has columns
STEPS = (1, 2, 5, 10)  # times powers of ten: of the ticks, and of the lengths by which a time line grows
CALENDAR = 1e5  # seconds: stamps beyond are of a calendar, and the time line counts from the first one


class Thinned:
    """At most `most` items of a stream of unknown length, evenly spread: when it is full, every second one goes."""

    def __init__(self, most: int) -> None:
        self.items: list[Any] = []
        self.count, self.stride, self.most = 0, 1, most

    @property
    def wants(self) -> bool:
        """Whether the next item would be kept."""
        return self.count % self.stride == 0

    def add(self, item: Any) -> None:
        """Append an item, or pass over it."""
        if self.wants:
            self.items.append(item)
        self.count += 1
        if len(self.items) > self.most:
            self.items, self.stride = self.items[::2], 2 * self.stride


@dataclass(frozen=True)
class TimelinePoint:
    """The answer at one time.

    `stamp`: seconds; `azimuth`, `elevation`, `cone` (half-angle of the 90 % cone): radians, None while nothing is
    known; `problem`: why the frame could not be used, if so.
    """

    stamp: float
    status: str
    presence: float
    azimuth: float | None
    elevation: float | None
    cone: float | None
    problem: str | None = None

    @classmethod
    def of(cls, estimate: Estimate, stamp: float | None = None, problem: str | None = None) -> TimelinePoint:
        """The answer of `estimate`, for a frame of time `stamp` (None: the estimate's)."""
        e = estimate
        cone = None if e.azimuth is None else float(e.credible_angle)
        at = float(e.stamp if stamp is None else stamp)
        return cls(at, e.status, float(e.presence), e.azimuth, e.elevation, cone, problem)

    @property
    def half_width(self) -> float:
        """Half of the range of azimuths (radians) that the cone about the answer covers; pi if it holds a pole.

        The meridians that touch a cap of radius r at elevation e are asin(sin r / cos e) off its centre.
        """
        if self.cone is None or self.elevation is None:
            return 0.0
        if self.cone + abs(self.elevation) >= math.pi / 2:
            return math.pi
        return math.asin(min(1.0, math.sin(self.cone) / math.cos(self.elevation)))


class TimeLine:
    """The moments so far, in order of time.

    `span`: the seconds, from the first stamp on, that the axis shows, if the length of the clip is known. Without it
    the axis grows with the moments. Of more than 2400 moments every second one is dropped from the curves; statuses
    keep all their changes.
    """

    def __init__(self, span: float | None = None) -> None:
        if span is not None and not (math.isfinite(span) and span >= 0):
            raise TimeError(f"a time line of {span} seconds; wanted the length of the clip, or None")
        self._given = span
        self.last: TimelinePoint | None = None
        self.first = self.now = self._held = 0.0  # the first stamp, the seconds since then and since the last one
        self._kept = Thinned(MOST)
        self._changes: list[tuple[float, str]] = []  # since when, which status

    def add(self, moment: TimelinePoint) -> None:
        """Append a moment. Raises `TimeError` unless its stamp is finite and later than the last one."""
        if not math.isfinite(moment.stamp):
            raise TimeError(f"the stamp {moment.stamp}; wanted a finite time in seconds")
        if self.last is None:
            self.first = moment.stamp
        elif moment.stamp <= self.last.stamp:
            raise TimeError(
                f"the stamp {moment.stamp:g} s comes after {self.last.stamp:g} s; wanted frames in order of time"
            )
        self._held, self.now = moment.stamp - self.first - self.now, moment.stamp - self.first
        if self.last is None or moment.status != self.last.status:
            self._changes.append((self.now, moment.status))
        self._kept.add(moment)
        self.last = moment

    @property
    def span(self) -> float:
        """Seconds on the axis."""
        if self._given is not None:
            return max(self._given, self.now, 1e-3)
        decade = 10.0 ** math.floor(math.log10(max(self.now, 1.0)))
        return next(step * decade for step in STEPS if step * decade >= self.now)

    @property
    def end(self) -> float:
        """Until when the last answer is drawn: for as long as the one before it, within the axis."""
        return min(self.span, self.now + (self._held or self.span / 200))

    def ticks(self) -> list[tuple[float, str]]:
        """Round times, seconds on the axis, and how they are called."""
        from matplotlib.ticker import MaxNLocator

        times = MaxNLocator(8, steps=STEPS).tick_values(0, self.span)
        begin = self.first if 0 <= self.first < CALENDAR else 0.0
        return [(time, f"{begin + time:g} s") for time in times if time <= self.span * (1 + 1e-9)]

    def boxes(self) -> dict[str, np.ndarray]:
        """What is drawn over time: boxes ``(n, 4)``, begin and end (seconds on the axis) and two values.

        `answers`: their azimuth in degrees, twice; `bands`: the lowest and highest azimuth of their 90 % cones, cut at
        the seam; `presence`: from 0; and for each status from 0 to 1 where it lasted.
        """
        moments, changes = self._kept.items, np.array([*(begin for begin, _ in self._changes), self.end])
        at = np.array([*(moment.stamp - self.first for moment in moments), self.end])
        times = np.stack([at[:-1], at[1:]], axis=1)
        angles = [(m.azimuth, m.half_width) if m.azimuth is not None else (math.nan, 0.0) for m in moments]
        middle, half = np.degrees(angles).reshape(-1, 2).T[:, :, None]
        presence = np.array([(0.0, moment.presence) for moment in moments]).reshape(-1, 2)
        limits = [np.hstack([middle - half + turn, middle + half + turn]).clip(-180, 180) for turn in (0, 360, -360)]
        bands = np.vstack([np.hstack([times, each]) for each in limits])
        found = {
            "answers": np.hstack([times, middle, middle])[np.isfinite(middle[:, 0])],
            "bands": bands[bands[:, 2] < bands[:, 3]],
            "presence": np.hstack([times, presence]),
        }
        for name in STATUS:
            mine = [index for index, (_, status) in enumerate(self._changes) if status == name]
            found[name] = np.array([(changes[k], changes[k + 1], 0.0, 1.0) for k in mine]).reshape(-1, 4)
        return found
