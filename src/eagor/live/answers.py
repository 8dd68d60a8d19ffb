"""An answer of the live loop: an estimate, how old what it rests on is, and what is wrong, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from eagor.tracking.estimate import Estimate

__all__ = ["Answer", "Fault", "Part"]

Part = Literal["camera", "poses", "perception", "clock", "recording"]


@dataclass(frozen=True)
class Fault:
    """What is wrong now with a `part` of the loop, in words, and since when (seconds, on the loop's clock)."""

    part: Part
    text: str
    since: float


@dataclass(frozen=True, eq=False)
class Answer:
    """Where the thing of one `query` is at the time `stamp` (seconds on the loop's clock), and how far to trust that.

    `estimate`: in the body frame of that time. `pose_age`: seconds since the newest pose was true; None if the camera
    is taken to stand still, infinite before the first pose. `look_age`: seconds since the newest evidence about this
    query was captured, `image_age`: since the newest picture was; infinite before any. `faults`: what is wrong now,
    longest first; empty if all is well.
    """

    stamp: float
    query: str
    estimate: Estimate
    pose_age: float | None
    look_age: float
    image_age: float
    faults: tuple[Fault, ...] = ()

    @property
    def direction(self) -> np.ndarray | None:
        """The unit vector ``(3,)`` in the body frame; None while nothing is known."""
        return self.estimate.direction

    @property
    def status_words(self) -> str:
        """The status, and after a semicolon each fault: "tracking; no picture for 2.1 s"."""
        return "; ".join([self.estimate.status, *(fault.text for fault in self.faults)])

    def as_json(self, modes: int = 10, exact: bool = False) -> dict[str, Any]:
        """This answer for a line of JSON, with at most so many candidates; what is not known is None.

        `exact`: numbers are not rounded, so that answers can be compared bit for bit.
        """
        digits = None if exact else 6
        e, distance = self.estimate, None
        if e.direction is not None and e.status != "searching":
            distance = e.distance
        return {
            "stamp": _number(self.stamp, digits),
            "query": self.query,
            **_angles(e.azimuth, e.elevation, digits),
            "direction": None if e.direction is None else [_number(float(each), digits) for each in e.direction],
            "credible_angle_deg": None if e.direction is None else _degrees(e.credible_angle, digits),
            "presence": _number(e.presence, digits),
            "distance_m": _number(distance, digits),
            "status": e.status,
            "modes": [
                _angles(mode.azimuth, mode.elevation, digits) | {"weight": _number(mode.weight, digits)}
                for mode in e.modes[:modes]
            ],
            "pose_age": _number(self.pose_age, digits),
            "look_age": _number(self.look_age, digits),
            "image_age": _number(self.image_age, digits),
            "faults": [
                {"part": each.part, "text": each.text, "since": _number(each.since, digits)} for each in self.faults
            ],
        }


def _angles(azimuth: float | None, elevation: float | None, digits: int | None) -> dict[str, float | None]:
    return {"azimuth_deg": _degrees(azimuth, digits), "elevation_deg": _degrees(elevation, digits)}


def _degrees(angle: float | None, digits: int | None) -> float | None:
    return None if angle is None else _number(math.degrees(angle), digits)


def _number(value: float | None, digits: int | None) -> float | None:
    """The number, rounded; None for what is not known, and for ages before anything came."""
    if value is None or not math.isfinite(value):
        return None
    return float(value) if digits is None else round(float(value), digits)
