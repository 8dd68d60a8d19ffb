"""What comes into the live loop, what comes out, and what to tell a person: of its faults, and where to look next.

Events have their time of arrival, in seconds on the loop's clock. Stamps are those of the source, on its own clock; the
core relates the clocks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from eagor.errors import GridError
from eagor.evidence import Evidence
from eagor.grids import PerspectiveGrid
from eagor.sources import Pose
from eagor.tracking import TurningCamera
from eagor.tracking.estimate import Estimate, plain_number

__all__ = [
    "AGAIN", "CALM", "Answer", "Diagnostic", "Event", "Fault", "FaultLog", "ImageReceived", "NextLooks",
    "ObservationReceived", "OdometryReset", "Part", "PoseReceived", "QueriesChanged", "Tick",
]  # fmt: skip

Part = Literal["camera", "poses", "perception", "clock", "recording"]

CALM = 3.0  # seconds without a fault after which a part counts as well again
AGAIN = 30.0  # seconds after which a fault that lasts is told again
APART = 0.5  # seconds between two computations of where to look next, which take about 40 ms each


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

    def as_dict(self, modes: int = 10) -> dict[str, Any]:
        """The query, `Estimate.as_dict`, and how far to trust it: for a line of JSON."""
        ages = {name: plain_number(getattr(self, name)) for name in ("pose_age", "look_age", "image_age")}
        faults = [{"part": each.part, "text": each.text, "since": plain_number(each.since)} for each in self.faults]
        return {"query": self.query, **self.estimate.as_dict(modes), **ages, "faults": faults}


@dataclass(frozen=True, eq=False)
class ImageReceived:
    """A picture; `stamp`: its capture. The core needs no `picture` ``(H, W, 3)``; a recording does.

    `grid`: its pixels, if an ordinary camera took it; None for a panorama. `problem`: why there is no picture.
    `looked`: whether the perception looks at it, if that is known.
    """

    arrival: float
    stamp: float
    name: str
    picture: np.ndarray | None = field(default=None, repr=False)
    grid: PerspectiveGrid | None = field(default=None, repr=False)
    problem: str = ""
    looked: bool = True


@dataclass(frozen=True, eq=False)
class PoseReceived:
    """A pose; `of_picture`: it was found in a picture, and its stamp is on the camera's clock."""

    arrival: float
    pose: Pose
    of_picture: bool = False


@dataclass(frozen=True, eq=False)
class OdometryReset:
    """Nothing relates the poses from here on to those before: the world starts anew, and with it every belief."""

    arrival: float
    text: str


@dataclass(frozen=True, eq=False)
class ObservationReceived:
    """What the perception says about `query` in the picture of `stamp`; `looks` has several items for several views.

    `told`: the stamp that the perception was told, on whose clock the looks are. `seconds`: how long it took.
    """

    arrival: float
    stamp: float
    told: float
    query: str
    looks: tuple[Evidence, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Diagnostic:
    """Something is wrong with a part, in words; an empty `text`: it works again.

    `about`: the query that alone is concerned, or which of a part's faults this is; empty for the part as a whole.
    `passing`: it is over when it is said, as a clock that jumped.
    """

    arrival: float
    part: Part
    text: str = ""
    about: str = ""
    passing: bool = False


@dataclass(frozen=True)
class QueriesChanged:
    """The queries to follow from now on."""

    arrival: float
    queries: tuple[str, ...]


@dataclass(frozen=True)
class Tick:
    """An answer to every query is wanted for this time."""

    arrival: float


Event = ImageReceived | PoseReceived | OdometryReset | ObservationReceived | Diagnostic | QueriesChanged | Tick


class FaultLog:
    """Turns the faults of answers, one after the other, into lines for a log.

    A fault is told when it begins, and while it lasts every `AGAIN` seconds, but not again while its part has faults
    every few seconds: words that differ in numbers alone are the same ("no picture for 2.1 s"). That a part is well
    again is told after `CALM` seconds; if it was well for less than `AGAIN` seconds before, after `AGAIN`, so that a
    part that comes and goes does not fill the log.
    """

    def __init__(self) -> None:
        self._told: dict[str, dict[str, float]] = {}  # of each part with faults: when each was told last
        self._bad: dict[str, tuple[float, float]] = {}  # when one was there last, and how long it has to be without
        self._well: dict[str, float] = {}  # when a part was said to be well

    def of(self, faults: Sequence[Fault], now: float) -> list[tuple[str, bool]]:
        """New lines at `now` (seconds, never going back), each with whether something is wrong."""
        lines = []
        for fault in faults:
            soon = now - self._well.get(fault.part, -math.inf) < AGAIN
            _, calm = self._bad.get(fault.part, (now, AGAIN if soon else CALM))
            self._bad[fault.part] = now, calm
            told, words = self._told.setdefault(fault.part, {}), re.sub(r"\d+(\.\d+)?", "#", fault.text)
            if now - told.get(words, -math.inf) >= AGAIN:
                told[words] = now
                lines.append((fault.text, True))
        for part in [part for part, (last, calm) in self._bad.items() if now - last >= calm]:
            del self._bad[part], self._told[part]
            self._well[part] = now
            lines.append((f"{part}: all is well again", False))
        return lines


class NextLooks:
    """A sink of the loop that tells where to look next for the thing of one query: a camera can turn one way only.

    It is computed anew with a new look, at most every `APART` seconds, and stands in the world until then. A panorama
    sees all, so that there is nothing to tell. `of` is for one thread, which may be another than the loop's.
    """

    def __init__(self) -> None:
        self._grid: PerspectiveGrid | None = None
        self._query, self._looked, self._when = "", -math.inf, -math.inf  # of what was computed last
        self._toward: np.ndarray | None = None  # world axes

    def take(self, event: Event, answers: Sequence[Answer]) -> None:
        """An event of the loop."""
        if isinstance(event, ImageReceived):
            self._grid = event.grid
        elif isinstance(event, OdometryReset):
            self._query = ""

    def close(self) -> None:
        """Nothing is held."""

    def of(self, answer: Answer) -> np.ndarray | None:
        """The direction ``(3,)``, in the body frame of the answer, to which the camera's axis should turn.

        None before the first look, for panoramas, and for a field that `TurningCamera` refuses.
        """
        estimate, grid = answer.estimate, self._grid
        looked = estimate.stamp - estimate.age  # when the newest evidence in it was captured
        if grid is None or not math.isfinite(looked):
            return None
        news = looked > self._looked + 1e-6 and estimate.stamp >= self._when + APART
        if answer.query != self._query or news:
            self._query, self._looked, self._when, self._toward = answer.query, looked, estimate.stamp, None
            with suppress(GridError):
                found = estimate.next_look(TurningCamera.of_view(grid), body_R_view=grid.body_R_view)
                self._toward = estimate.world_R_body @ found.direction
        return None if self._toward is None else self._toward @ estimate.world_R_body
