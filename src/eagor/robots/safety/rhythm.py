"""How often something comes, from its stamps, and from which age on it must have stopped to come. Pure.

A limit that fits the slowest perception lets a quick one hang for seconds. So the limit follows what is usual.
"""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import median_high

__all__ = ["Rhythm", "heard", "look_age", "picture_age"]

INTERVALS, LEAST = 3, 0.5  # usual intervals that may pass since the newest look; seconds that are always allowed
BEYOND, SLACK = 2, 0.2  # usual intervals, and at least seconds, beyond the usual age of what just came
SAME = 0.01  # seconds within which two stamps are one: they are computed anew from ages at each word
ENOUGH, KEPT = 4, 9  # stamps from which an interval counts as usual; and those that are remembered

Rhythm = tuple[tuple[float, float], ...]  # stamps and the times at which each was heard of first, oldest first


def heard(rhythm: Rhythm, stamp: float | None, now: float) -> Rhythm:
    """With the newest stamp, if that is a new one. One that is no time, or lies in the future, is none."""
    if stamp is None or not math.isfinite(stamp) or not math.isfinite(now) or stamp > now + SAME:
        return rhythm
    if rhythm and stamp - rhythm[-1][0] <= SAME:
        return rhythm
    return (*rhythm[1 - KEPT :], (stamp, now))


def picture_age(rhythm: Rhythm, most: float) -> float:
    """Seconds since its capture after which the newest picture is too old: `most` until enough is known.

    The usual age of one that just came, and two usual intervals, at least 0.2 s; at most `most`. So a camera of ten
    pictures per second or more that ends is noticed within 0.2 s. Usual is the median.
    """
    if len(rhythm) < ENOUGH:
        return most
    interval, age = _usual(rhythm)
    return min(most, age + max(SLACK, BEYOND * interval))


def look_age(rhythm: Rhythm, most: float) -> float:
    """The same of the newest look: three usual intervals, at least half a second; at most `most`.

    Where looks usually come later than one interval after their capture: their usual age and two intervals.
    """
    if len(rhythm) < ENOUGH:
        return most
    interval, age = _usual(rhythm)
    return min(most, max(LEAST, INTERVALS * interval, age + BEYOND * interval))


def _usual(rhythm: Rhythm) -> tuple[float, float]:
    """Seconds between two stamps, and from a stamp to when it was heard of."""
    interval = median_high(after[0] - before[0] for before, after in pairwise(rhythm))
    return interval, median_high(now - stamp for stamp, now in rhythm)
