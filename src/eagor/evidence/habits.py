"""Places have habits: why looks at the same thing are not independent.

A detector finds one thing in nearly every look and another in few of them, and what it once took for the thing it takes
for it again. The share of looks in which a place is detected is drawn once, and kept while the view stays the same: a
random effect (beta-binomial instead of binomial; Skellam, Journal of the Royal Statistical Society B 10(2), 1948), and
for mistakes a clutter map. `Habits` holds its distributions over a few levels, for places where the thing is and for
look-alikes. When the camera has moved by m metres, or s seconds have passed, a place draws its habit anew with
probability

    1 - exp(-m / kept_within - s / kept_for).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from eagor._checks import above, within

NODES = 8  # of the quadrature over a habit: with so many, forty looks are exact to a few hundredths of a nat
# Beta distributions of the share of looks in which a place is detected: of the thing, and of a look-alike.
HABIT, LOOK_ALIKE_HABIT = (0.8, 0.8), (0.5, 2.0)
LOOK_ALIKES = 0.7  # expected on the whole sphere, where that is not known
BETA = (0.001, 500.0)  # where the quadrature is exact
KEPT_FOR, KEPT_WITHIN = 60.0, 1.0  # seconds, metres


@dataclass(frozen=True, eq=False)
class Habits:
    """How often a place is detected, and how long that lasts.

    `levels` ``(P,)`` with weights `shares` ``(P,)``: of places where the thing is. `alike_levels`, `alike_shares`
    ``(A,)``: of look-alikes, of which there are `look_alikes` on the whole sphere on average. A is 0 if there are none.
    """

    levels: np.ndarray
    shares: np.ndarray
    alike_levels: np.ndarray
    alike_shares: np.ndarray
    look_alikes: float
    kept_for: float | None
    kept_within: float | None

    def same(self, other: Habits) -> bool:
        """Whether all numbers are equal."""
        if self is other:
            return True
        ours, theirs = ([getattr(each, f.name) for f in fields(each)] for each in (self, other))
        return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))

    @property
    def mean(self) -> float:
        """The mean share of looks in which the thing is detected."""
        return float(self.levels @ self.shares)

    @property
    def correlation(self) -> float:
        """The correlation of two looks at one thing: 1 if it is found always or never, 0 if looks are independent."""
        mean = self.mean
        spread = float(self.levels**2 @ self.shares) - mean**2
        return spread / (mean * (1 - mean)) if 0 < mean < 1 else 0.0

    def anew(self, elapsed: float, moved: float = 0.0) -> float:
        """The probability that a place has drawn its habit anew after `elapsed` seconds and `moved` metres."""
        faded = 0.0 if self.kept_for is None else elapsed / self.kept_for
        return -math.expm1(-faded - (0.0 if self.kept_within is None else moved / self.kept_within))


@lru_cache(maxsize=64)
def habits(
    detection_probability: float | None,
    habit: tuple[float, float],
    look_alikes: float | None,
    look_alike_habit: tuple[float, float],
    kept_for: float | None,
    kept_within: float | None,
) -> Habits:
    """The habits with these numbers, the fields of `DetectorModel`."""
    levels, shares = _nodes(habit)
    if detection_probability is not None:
        levels, shares = np.array([detection_probability]), np.ones(1)
    if look_alikes is None:
        look_alikes = LOOK_ALIKES if detection_probability is None else 0.0
    alike_levels, alike_shares = _nodes(look_alike_habit)
    if look_alikes == 0:
        alike_levels = alike_shares = np.zeros(0)
    return Habits(levels, shares, alike_levels, alike_shares, look_alikes, kept_for, kept_within)


def _nodes(habit: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights ``(NODES,)`` of a Gauss-Jacobi quadrature over a beta distribution."""
    from scipy.special import roots_jacobi

    first, second = habit
    places, weights = roots_jacobi(NODES, second - 1, first - 1)
    return (1 + places) / 2, weights / weights.sum()


def checks(model: object) -> dict[str, tuple[bool, str]]:
    """Whether the fields of `habits` hold what they should, and what that is."""
    values = {name: getattr(model, name) for name in ("habit", "look_alikes", "look_alike_habit")}
    seconds, metres = (getattr(model, name) for name in ("kept_for", "kept_within"))
    beta = f"two numbers from {BETA[0]:g} to {BETA[1]:g}, of a beta distribution"
    return {
        "habit": (_is_beta(values["habit"]), beta),
        "look_alike_habit": (_is_beta(values["look_alike_habit"]), beta),
        "look_alikes": (
            values["look_alikes"] is None or within(values["look_alikes"], 0),
            "an expected number on the whole sphere, from 0 on, or None",
        ),
        "kept_for": (seconds is None or above(seconds, 0), "seconds above 0, or None if habits last however long"),
        "kept_within": (metres is None or above(metres, 0), "metres above 0, or None if habits last however far"),
    }


def _is_beta(found: object) -> bool:
    return isinstance(found, tuple) and len(found) == 2 and all(within(each, *BETA) for each in found)


RESPONSES = habits(1.0, HABIT, 0.0, LOOK_ALIKE_HABIT, None, None)  # of response maps, whose looks just add up
