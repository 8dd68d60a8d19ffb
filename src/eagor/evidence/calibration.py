"""From a response to a log-likelihood ratio, and how far looks repeat each other.

    r = temperature * log((l + floor) / (neutral + floor))

for a response l in [0, 1]: positive above `neutral`, and bounded from below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._arrays import Array, namespace
from eagor._checks import above, require, within
from eagor._reprs import changed
from eagor.errors import ResponseError
from eagor.evidence.habits import RESPONSES, Habits

__all__ = ["Calibration"]

SPREADS = math.radians(1), math.radians(30)


@dataclass(frozen=True)
class Calibration:
    """How a response becomes a log-likelihood ratio: ``temperature * log((l + floor) / (neutral + floor))``.

    - `floor` (epsilon): the probability of missing a visible target; it bounds what one empty look can take away.
    - `neutral` (l0): the response that says nothing.
    - `temperature` (beta): a factor on the logarithm; a smaller one tempers overconfident evidence.
    - `persistence`: how much of one look the next one repeats, in [0, 1): what a response mistakes once it mistakes
      again. The share 1 - persistence of each look adds up; the rest counts only while the look is the newest. (The
      errors of looks follow an autoregression of first order.)
    - `spread`: angular error of responses, radians (standard deviation per axis): the evidence about a direction is the
      mean likelihood ratio around it. 0: no error.
    - `scale_to_max`: divide each response by its own maximum first. Only the published settings do so: it turns
      "nothing here" into a detection.
    """

    floor: float = 0.4
    neutral: float = 0.05
    temperature: float = 3.0
    persistence: float = 0.0
    spread: float = 0.0
    scale_to_max: bool = False

    def __post_init__(self) -> None:
        least, most = SPREADS
        wanted = {
            "floor": (above(self.floor, 0, 1), "a number above 0 and up to 1"),
            "neutral": (within(self.neutral, 0, 1), "a number from 0 to 1"),
            "temperature": (above(self.temperature, 0), "a number above 0"),
            "persistence": (within(self.persistence, 0, 1) and self.persistence < 1, "a number from 0, below 1"),
            "spread": (
                self.spread == 0 or within(self.spread, least, most),
                f"0, or radians from {least:.4f} to {most:.4f} (1 to 30 degrees)",
            ),
        }
        require(self, wanted, ResponseError)

    def __repr__(self) -> str:
        return changed(self)

    @classmethod
    def paper(cls) -> Calibration:
        """The published form, log(l + 1e-3), with each frame's response scaled to a maximum of 1."""
        return cls(floor=1e-3, neutral=1 - 1e-3, temperature=1.0, scale_to_max=True)

    @property
    def offset(self) -> float:
        """The part of the angular error (radians) that the next look repeats: `persistence` of its variance."""
        return self.spread * math.sqrt(self.persistence)

    @property
    def habits(self) -> Habits:
        """A response says of each place what it says: it has no look-alikes and no habits of its own."""
        return RESPONSES

    def log_ratio(self, response: Array) -> Array:
        """r of a response, elementwise; for checking and plotting (`Evidence.from_response` checks its input too)."""
        xp = namespace(response)
        return self.temperature * xp.log((response + self.floor) / (self.neutral + self.floor))

    @property
    def empty(self) -> float:
        """r where we looked and saw nothing: the lowest value there is."""
        return float(self.log_ratio(np.array(0.0)))

    @property
    def full(self) -> float:
        """r of a response of 1: the highest value there is."""
        return float(self.log_ratio(np.array(1.0)))
