"""The settings of a tracker."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from eagor._checks import above, require, whole, within
from eagor._renamed import renamed
from eagor._reprs import changed
from eagor.belief.ranged import log_ranges
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.harmonics import RealHarmonics
from eagor.tracking.motion import MotionModel

__all__ = ["AnswerSettings", "TrackerConfig"]


@dataclass(frozen=True)
class AnswerSettings:
    """How answers are read from the belief.

    - `decode`: "mode", or "mean" for the published estimate.
    - `stale_after`: seconds without evidence after which an estimate is stale.
    """

    decode: Literal["mode", "mean"] = "mode"
    stale_after: float = 5.0

    def __post_init__(self) -> None:
        fields = {
            "decode": (self.decode in ("mode", "mean"), "mode or mean"),
            "stale_after": (within(self.stale_after, 0), "seconds from 0 on"),
        }
        require(self, fields)

    def __repr__(self) -> str:
        return changed(self)


@renamed(floor="floor_height", motion="target_motion", decode="answers.decode", stale_after="answers.stale_after")
@dataclass(frozen=True)
class TrackerConfig:
    """How a `DirectionTracker` believes, forgets and answers.

    - `degree`: of the harmonics over the whole sphere; about peaks the belief is finer.
    - `calibration`: read all evidence with this calibration instead of its own, detections too.
    - `detector`: read every set of detections with this model instead of its own.
    - `ranges`: shells (metres) of the belief over distance, used where positions are known; None: directions only.
    - `floor_height`: z (metres) of the floor in the odometry's world, if known. Things stand on it, so a thing's
      elevation tells its distance (`eagor.belief.heights.height_prior`).
    - `target_motion`: how targets come, go and move.
    - `drift`: drift of the odometry's heading, radians per root second.
    - `history`: seconds for which poses and evidence are kept; late evidence must not be older.
    - `answers`: how answers are read (`AnswerSettings`).
    """

    degree: int = 15
    calibration: Calibration | None = None
    detector: DetectorModel | None = None
    ranges: Sequence[float] | None = field(default_factory=lambda: tuple(log_ranges(count=14).tolist()))
    floor_height: float | None = None
    target_motion: MotionModel = field(default_factory=MotionModel)
    drift: float = 0.0
    history: float = 10.0
    answers: AnswerSettings = field(default_factory=AnswerSettings)

    def __post_init__(self) -> None:
        RealHarmonics(self.degree)  # raises for a wrong degree
        kinds = (Calibration, DetectorModel, MotionModel, AnswerSettings)
        fields = {
            "degree": (whole(self.degree, 1, 127), "a whole number from 1 to 127"),
            "calibration": (self.calibration is None or isinstance(self.calibration, kinds[0]), "an eagor.Calibration"),
            "detector": (self.detector is None or isinstance(self.detector, kinds[1]), "an eagor.DetectorModel"),
            "ranges": (_are_ranges(self.ranges), "at least two rising distances in metres, or None"),
            "floor_height": (self.floor_height is None or within(self.floor_height, -math.inf), "metres, or None"),
            "target_motion": (isinstance(self.target_motion, kinds[2]), "an eagor.MotionModel"),
            "drift": (within(self.drift, 0, math.pi), "radians per root second, from 0 to pi"),
            "history": (within(self.history, 0), "seconds from 0 on"),
            "answers": (isinstance(self.answers, kinds[3]), "an eagor.tracking.AnswerSettings"),
        }
        require(self, fields)

    def __repr__(self) -> str:
        return changed(self)

    @classmethod
    def paper(cls) -> TrackerConfig:
        """The published recursion: degree 7, log(l + 1e-3) scaled to the frame's maximum, spherical mean."""
        return cls(
            degree=7,
            calibration=Calibration.paper(),
            ranges=None,
            target_motion=MotionModel.still(),
            answers=AnswerSettings(decode="mean"),
        )

    def fitted(
        self, calibration: Calibration | None, detector: DetectorModel | None, forgetting: Mapping[str, Any]
    ) -> TrackerConfig:
        """This with fitted values: how looks are read (None: unchanged), and fields of `target_motion`."""
        return replace(
            self,
            calibration=calibration or self.calibration,
            detector=detector or self.detector,
            target_motion=replace(self.target_motion, **forgetting),
        )

    def shells(self, position: np.ndarray | None) -> np.ndarray | None:
        """The `ranges` ``(K,)`` if the belief is over distance too: only where a position is known."""
        return None if position is None or self.ranges is None else np.asarray(self.ranges, dtype=np.float64)

    def above_floor(self, position: np.ndarray | None) -> float | None:
        """The camera's height above the floor, if known, to the centimetre, since a walking camera bobs."""
        if self.floor_height is None or position is None:
            return None
        return round(float(position[2]) - self.floor_height, 2)


def _are_ranges(ranges: Sequence[float] | None) -> bool:
    if ranges is None:
        return True
    try:
        found = [float(value) for value in ranges]
    except (TypeError, ValueError):
        return False
    return len(found) > 1 and all(above(value, 0) for value in found) and bool((np.diff(found) > 0).all())
