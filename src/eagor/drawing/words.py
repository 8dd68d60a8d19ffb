"""Answers in words: directions, distances, statuses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eagor.tracking.estimate import Estimate

STATUS = {
    "searching": "it may not be here, or lie anywhere",
    "tracking": "more likely than not it is here, within 15 degrees of the answer",
    "ambiguous": "it is likely here, and several directions fit",
    "stale": "there was an answer, and nothing has been looked at for a while",
}

SHARP = math.log(1.5)  # standard deviation of the log distance: a distance known to a factor of 1.5 is worth saying


def in_words(azimuth: float, elevation: float) -> str:
    """A direction (radians, azimuth positive left) such as "64 degrees to the left, 33 degrees down".

    Within 4 degrees of an axis it counts as on the axis; within 5 degrees of a pole it is only up or down.
    """
    side, height = round(math.degrees(math.remainder(azimuth, math.tau))), round(math.degrees(elevation))
    if abs(height) >= 85:
        return "straight up" if height > 0 else "straight down"
    where, hand = abs(side), "left" if side > 0 else "right"
    if where <= 4:
        level = "straight ahead"
    elif where <= 112:
        level = f"{where} degrees to the {hand}"
    elif where <= 157:
        level = f"behind you, to the {hand} ({where} degrees)"
    elif where <= 175:
        level = f"behind you, slightly {hand} ({where} degrees)"
    else:
        level = "straight behind you"
    if abs(height) <= 4:
        return level
    return f"{level}, {abs(height)} degrees {'up' if height > 0 else 'down'}"


def answer_in_words(estimate: Estimate) -> str:
    """The answer of an estimate as `in_words`, or "not known"."""
    if estimate.azimuth is None or estimate.elevation is None:
        return "not known"
    return in_words(estimate.azimuth, estimate.elevation)


def distance_in_words(estimate: Estimate) -> str:
    """The distance as "about 2.1 m"; "" while searching, without positions, or if it is known worse than `SHARP`."""
    if estimate.status == "searching" or estimate.distance is None or estimate.distance_spread is None:
        return ""
    return f"about {estimate.distance:.1f} m" if estimate.distance_spread <= SHARP else ""


def status_in_words(estimate: Estimate) -> str:
    """The status, and whether an older answer is held."""
    return f"{estimate.status}, held" if estimate.held else estimate.status


def signed(angle: float | None) -> str:
    """An angle (radians) in degrees with sign and one decimal: "+62.9"; "-" for None."""
    return "-" if angle is None else f"{math.degrees(angle):+.1f}"
