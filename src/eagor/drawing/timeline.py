"""The answers of a whole clip over time: what a time line shows, for videos (pixels) and pages (SVG) alike.

An answer holds from its time until the next one, and is drawn so: nothing is interpolated between two answers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eagor.errors import TimeError
from eagor.tracking.estimate import Estimate

__all__ = ["COLOURS", "SIDES", "Moment", "Thinned", "TimeLine", "cone_bands", "ticks"]

# By status. They differ in brightness too, and each is named beside the time line.
COLOURS = {"searching": "#7d8796", "tracking": "#2fd0e6", "ambiguous": "#ffb000", "stale": "#b48cff"}
# Azimuths in degrees, and what they are called.
SIDES = ((180, "behind"), (90, "left"), (0, "ahead"), (-90, "right"), (-180, "behind"))
MOST = 2400  # moments that are kept for curves: more than a picture has columns
SPANS = (1, 2, 5)  # the steps, times powers of ten, by which a time line of unknown length grows


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
class Moment:
    """The answer at one time.

    `stamp`: seconds; `azimuth`, `elevation`, `cone` (half-angle of the 90 % cone): radians, None while nothing is
    known; `problem`: why the frame could not be used, if so.
    """

    stamp: float
    status: str
    presence: float
    azimuth: float | None = None
    elevation: float | None = None
    cone: float | None = None
    problem: str | None = None

    @classmethod
    def of(cls, estimate: Estimate, stamp: float | None = None, problem: str | None = None) -> Moment:
        """The answer of `estimate`, for a frame of time `stamp` (None: the estimate's)."""
        known = estimate.azimuth is not None
        return cls(
            float(estimate.stamp if stamp is None else stamp), estimate.status, float(estimate.presence),
            estimate.azimuth, estimate.elevation, float(estimate.credible_angle) if known else None,
            problem,
        )  # fmt: skip

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
        self.given = span
        self.last: Moment | None = None
        self.first = 0.0
        self._kept = Thinned(MOST)
        self._stretches: list[tuple[float, str]] = []  # since when, which status

    def add(self, moment: Moment) -> None:
        """Append a moment. Raises `TimeError` unless its stamp is finite and later than the last one."""
        if not math.isfinite(moment.stamp):
            raise TimeError(f"the stamp {moment.stamp}; wanted a finite time in seconds")
        if self.last is not None and moment.stamp <= self.last.stamp:
            raise TimeError(
                f"the stamp {moment.stamp:g} s comes after {self.last.stamp:g} s; wanted frames in order of time"
            )
        if self.last is None:
            self.first = moment.stamp
        if self.last is None or moment.status != self.last.status:
            self._stretches.append((moment.stamp, moment.status))
        self._kept.add(moment)
        self.last = moment

    @property
    def now(self) -> float:
        """Seconds since the first stamp."""
        return 0.0 if self.last is None else self.last.stamp - self.first

    @property
    def span(self) -> float:
        """Seconds on the axis."""
        if self.given is not None:
            return max(self.given, self.now, 1e-3)
        decade = 10.0 ** math.floor(math.log10(max(self.now, 1.0)))
        return next(step * decade for step in (*SPANS, 10) if step * decade >= self.now)

    @property
    def end(self) -> float:
        """Until when the last answer is drawn: for as long as the one before it, within the axis."""
        if len(self._kept.items) < 2 or self.last is None:
            return min(self.span, self.now + self.span / 200)
        before = [kept for kept in self._kept.items[-2:] if kept is not self.last][-1]
        return min(self.span, self.now + (self.last.stamp - before.stamp))

    def stretches(self) -> list[tuple[float, float, str]]:
        """Begin and end (seconds since the first stamp) of each stretch of one status."""
        begins = [begin - self.first for begin, _ in self._stretches]
        return [
            (begin, end, status)
            for begin, end, (_, status) in zip(begins, [*begins[1:], self.end], self._stretches, strict=False)
        ]

    def presence(self) -> np.ndarray:
        """Begin, end (seconds) and presence of each moment ``(n, 3)``."""
        return np.array([(begin, end, m.presence) for begin, end, m in self._lasting()]).reshape(-1, 3)

    def answers(self) -> np.ndarray:
        """Begin, end (seconds) and azimuth (degrees) of each answer ``(n, 3)``."""
        found = [(b, e, math.degrees(m.azimuth)) for b, e, m in self._lasting() if m.azimuth is not None]
        return np.array(found, dtype=float).reshape(-1, 3)

    def bands(self) -> np.ndarray:
        """Begin, end (seconds), lowest and highest azimuth (degrees) of the 90 % cones ``(n, 4)``; cut at the seam."""
        known = [(b, e, m.azimuth, m.half_width) for b, e, m in self._lasting() if m.azimuth is not None]
        return cone_bands(known)

    def _lasting(self) -> list[tuple[float, float, Moment]]:
        """The kept moments with begin and end (seconds since the first stamp)."""
        begins = [moment.stamp - self.first for moment in self._kept.items]
        return list(zip(begins, [*begins[1:], self.end], self._kept.items, strict=False))


def cone_bands(cones: Iterable[tuple[float, float, float, float]]) -> np.ndarray:
    """Begin, end, lowest and highest azimuth (degrees) ``(n, 4)`` of cones; two where one is cut at the seam.

    `cones`: begin, end, middle and half width (radians) of each.
    """
    found = []
    for begin, end, *angles in cones:
        middle, half = map(math.degrees, angles)
        low, high = middle - half, middle + half
        if half >= 180:
            found.append((begin, end, -180.0, 180.0))
        elif low < -180:
            found += [(begin, end, -180.0, high), (begin, end, low + 360, 180.0)]
        elif high > 180:
            found += [(begin, end, low, 180.0), (begin, end, -180.0, high - 360)]
        else:
            found.append((begin, end, low, high))
    return np.array(found, dtype=float).reshape(-1, 4)


def ticks(span: float, most: int = 8) -> Sequence[float]:
    """Round times from 0 to `span`, at most `most` + 1."""
    rough = span / most
    decade = 10.0 ** math.floor(math.log10(rough))
    step = next(step * decade for step in (*SPANS, 10) if step * decade >= rough)
    return [round(step * index, 9) for index in range(math.floor(span / step + 1e-9) + 1)]
