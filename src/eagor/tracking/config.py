"""The settings of a tracker, and of how targets come, go and move: rates that can be counted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from eagor._arrays import frozen
from eagor._checks import above, require, whole, within
from eagor._values import changed, lazy
from eagor.belief.ranged import log_ranges
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel
from eagor.harmonics import RealHarmonics

__all__ = ["AnswerSettings", "MotionModel", "TrackerConfig"]

PARALLAX = math.radians(3)  # per root second: what is some metres away passes a camera that walks
_RATES = ("start", "stop", "jump", "birth", "death")


@dataclass(frozen=True)
class MotionModel:
    """How targets come, go and move. Rates are per second: 0.002 means once in 500 seconds.

    - `wander`: radians per root second, one number for each kind of wandering target; empty: none wander.
    - `turn`: radians per second, one number for each kind of target that turns at a steady rate: the standard deviation
      of each component of its angular velocity. With a drifting heading, standing things turn too.
    - `start`: rate at which a standing target begins to move.
    - `stop`: rate at which a moving target stops.
    - `jump`: rate at which a moving target reappears anywhere else.
    - `birth`, `death`: rates at which a target appears and disappears.

        >>> motion = eagor.MotionModel(start=0.01, stop=0.03)
        >>> round(motion.moving, 6)  # of the targets, as long as nothing was seen
        0.25
    """

    wander: tuple[float, ...] = (math.radians(2.5), math.radians(10))
    turn: tuple[float, ...] = (math.radians(1.5), math.radians(8))
    start: float = 0.01
    stop: float = 0.04
    jump: float = 0.003
    birth: float = 0.0005
    death: float = 0.0005

    def __post_init__(self) -> None:
        rates = {name: (within(getattr(self, name), 0, 100), "a rate per second, from 0 on") for name in _RATES}
        kinds = {
            "wander": (_are_angles(self.wander), "radians per root second above 0, in a tuple"),
            "turn": (_are_angles(self.turn), "radians per second above 0, in a tuple"),
        }
        require(self, rates | kinds)
        for name in kinds:
            object.__setattr__(self, name, tuple(float(angle) for angle in getattr(self, name)))

    @classmethod
    def still(cls) -> MotionModel:
        """Targets that never move, appear or disappear."""
        return cls(wander=(), turn=(), start=0.0, stop=0.0, jump=0.0, birth=0.0, death=0.0)

    @lazy
    def kinds(self) -> np.ndarray:
        """The shares of the kinds among moving targets: each of `wander`, then all of `turn` as one."""
        count = len(self.wander) + len(self.turn)
        return frozen(np.array([1.0] * len(self.wander) + [len(self.turn)] * bool(self.turn)) / max(count, 1))

    @property
    def moving(self) -> float:
        """The share of targets that move, in the equilibrium of `start` and `stop`."""
        if not len(self.kinds):
            return 0.0
        return self.start / (self.start + self.stop) if self.start + self.stop > 0 else 0.0

    def jumped(self, elapsed: float) -> float:
        """The probability that a moving target jumps within `elapsed` seconds."""
        return -math.expm1(-self.jump * elapsed)

    def transitions(self, elapsed: float) -> np.ndarray:
        """Probabilities ``(2 + M, 2 + M)`` of going from hypothesis to hypothesis in `elapsed` seconds.

        The hypotheses: absent, standing, and each of the `kinds`. There are no transitions among the kinds.
        """
        kinds = self.kinds
        count = len(kinds)
        born, died = _switched(self.birth, self.death, elapsed), _switched(self.death, self.birth, elapsed)
        begun, stopped = _switched(self.start, self.stop, elapsed), _switched(self.stop, self.start, elapsed)
        if count == 0:
            begun = 0.0
        found = np.zeros((2 + count, 2 + count))
        found[0] = [1 - born, born * (1 - self.moving), *(born * self.moving * kinds)]
        found[1] = [died, (1 - died) * (1 - begun), *((1 - died) * begun * kinds)]
        for place in range(2, 2 + count):
            found[place, [0, 1, place]] = died, (1 - died) * stopped, (1 - died) * (1 - stopped)
        return found


def _switched(rate: float, back: float, elapsed: float) -> float:
    """The probability of the other one of two states after `elapsed` seconds, at these rates of change."""
    both = rate + back
    return 0.0 if both == 0 else -math.expm1(-both * elapsed) * rate / both


def _are_angles(found: object) -> bool:
    return isinstance(found, tuple | list) and all(within(angle, 0, math.pi) and angle > 0 for angle in found)


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


@dataclass(frozen=True)
class TrackerConfig:
    """How a `DirectionTracker` believes, forgets and answers.

    - `degree`: of the harmonics over the whole sphere; about peaks the belief is finer.
    - `calibration`: read all evidence with this calibration instead of its own, detections too.
    - `detector`: read every set of detections with this model instead of its own.
    - `ranges`: shells (metres) of the belief over distance, used where positions are known; None: directions only.
    - `floor_height`: z (metres) of the floor in the odometry's world, if known. Things stand on it, so a thing's
      elevation tells its distance (`eagor.belief.ranged.height_prior`).
    - `target_motion`: how targets come, go and move.
    - `drift`: drift of the odometry's heading, radians per root second; None: not known, and told by what is detected
      again and again (`eagor.tracking.look_alikes`).
    - `clock_error`: seconds (standard deviation) by which the stamps of all looks may be off, against those of poses.
      While the camera turns, all looks together are off by that time's turn.
    - `pose_error`: radians (standard deviation per axis) by which all orientations may be off: of the mount, mostly.
    - `history`: seconds for which poses and evidence are kept; late evidence must not be older.
    - `answers`: how answers are read (`AnswerSettings`).

        >>> config = eagor.TrackerConfig(floor_height=0.0, history=30.0)
        >>> config
        TrackerConfig(floor_height=0, history=30)
    """

    degree: int = 15
    calibration: Calibration | None = None
    detector: DetectorModel | None = None
    ranges: Sequence[float] | None = field(default_factory=lambda: tuple(log_ranges(count=14).tolist()))
    floor_height: float | None = None
    target_motion: MotionModel = field(default_factory=MotionModel)
    drift: float | None = None
    clock_error: float = 0.01
    pose_error: float = 0.0
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
            "drift": (
                self.drift is None or within(self.drift, 0, math.pi),
                "radians per root second, from 0 to pi, or None",
            ),
            "clock_error": (within(self.clock_error, 0, 10), "seconds, from 0 to 10"),
            "pose_error": (within(self.pose_error, 0, math.pi / 3), "radians, from 0 to 60 degrees"),
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
            drift=0.0,
            clock_error=0.0,
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
