"""An answer of the live loop: an estimate, how old what it rests on is, and what is wrong, in words."""

from __future__ import annotations

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
        status = f"{self.estimate.status}, held" if self.estimate.held else self.estimate.status
        return "; ".join([status, *(fault.text for fault in self.faults)])

    def as_json(self, modes: int = 3) -> dict[str, Any]:
        """This answer for a line of JSON, with at most so many candidates; what is not known is None."""
        e = self.estimate
        return {
            "stamp": round(self.stamp, 6),
            "query": self.query,
            "azimuth_deg": _degrees(e.azimuth),
            "elevation_deg": _degrees(e.elevation),
            "direction": None if e.direction is None else [round(float(each), 6) for each in e.direction],
            "credible_angle_deg": None if e.direction is None else _degrees(e.credible_angle),
            "presence": round(e.presence, 6),
            "status": e.status,
            "held": e.held,
            "modes": [
                {"azimuth_deg": _degrees(m.azimuth), "elevation_deg": _degrees(m.elevation), "weight": round(m.weight, 6)}
                for m in e.modes[:modes]
            ],
            "pose_age": _seconds(self.pose_age),
            "look_age": _seconds(self.look_age),
            "image_age": _seconds(self.image_age),
            "faults": [{"part": each.part, "text": each.text, "since": round(each.since, 6)} for each in self.faults],
        }


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else round(float(np.degrees(angle)), 4)


def _seconds(age: float | None) -> float | None:
    return None if age is None or not np.isfinite(age) else round(age, 6)
