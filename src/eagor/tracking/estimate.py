"""A tracker's settings and answers: `TrackerConfig` and `Estimate`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import above, require, whole, within
from eagor._lazy import lazy
from eagor._reprs import changed, where
from eagor.belief.ranged import log_ranges
from eagor.belief.reading import NEAR, Reading
from eagor.evidence.calibration import Calibration
from eagor.evidence.detector import DetectorModel, Rates
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.harmonics import RealHarmonics
from eagor.sphere import azimuth_elevation, check_directions
from eagor.tracking.cases import Cases
from eagor.tracking.motion import MotionModel

__all__ = ["Answer", "Estimate", "Mode", "Status", "TrackerConfig"]

Status = Literal["searching", "tracking", "ambiguous", "stale"]
SURE = math.radians(15)  # of the answer: a target within this angle counts as found
RIVAL = 0.2  # of the belief: a second mode that holds this share makes the answer ambiguous
LEAST_MODE = 0.02  # of the belief: modes that hold less are not listed
MOST_MODES = 5


FLAT = 1e-6  # nats: a belief that varies by less has no direction


@dataclass(frozen=True)
class TrackerConfig:
    """How a `DirectionTracker` believes, forgets and answers.

    - `degree`: of the harmonics over the whole sphere; about peaks the belief is finer.
    - `decode`: "mode", or "mean" for the published estimate.
    - `calibration`: read all evidence with this calibration instead of its own, detections too.
    - `detector`: read every set of detections with this model instead of its own.
    - `ranges`: shells (metres) of the belief over distance, used where positions are known; None: directions only.
    - `floor`: height (z, metres) of the floor in the odometry's world, if known. Things stand on it, so a thing's
      elevation tells its distance (`eagor.belief.heights.height_prior`).
    - `motion`: how targets come, go and move (`eagor.tracking.motion.MotionModel`).
    - `drift`: drift of the odometry's heading, radians per root second.
    - `history`: seconds for which poses and evidence are kept; late evidence must not be older.
    - `stale_after`: seconds without evidence after which an estimate is stale.
    """

    degree: int = 15
    decode: Literal["mode", "mean"] = "mode"
    calibration: Calibration | None = None
    detector: DetectorModel | None = None
    ranges: Sequence[float] | None = field(default_factory=lambda: tuple(log_ranges(count=14).tolist()))
    floor: float | None = None
    motion: MotionModel = field(default_factory=MotionModel)
    drift: float = 0.0
    history: float = 10.0
    stale_after: float = 5.0

    def __post_init__(self) -> None:
        RealHarmonics(self.degree)  # raises for a wrong degree
        kinds = (Calibration, DetectorModel, MotionModel)
        fields = {
            "degree": (whole(self.degree, 1, 127), "a whole number from 1 to 127"),
            "decode": (self.decode in ("mode", "mean"), "mode or mean"),
            "calibration": (self.calibration is None or isinstance(self.calibration, kinds[0]), "an eagor.Calibration"),
            "detector": (self.detector is None or isinstance(self.detector, kinds[1]), "an eagor.DetectorModel"),
            "ranges": (_are_ranges(self.ranges), "at least two rising distances in metres, or None"),
            "floor": (self.floor is None or within(self.floor, -math.inf), "a height in metres, or None"),
            "motion": (isinstance(self.motion, kinds[2]), "an eagor.MotionModel"),
            "drift": (within(self.drift, 0, math.pi), "radians per root second, from 0 to pi"),
            "history": (within(self.history, 0), "seconds from 0 on"),
            "stale_after": (within(self.stale_after, 0), "seconds from 0 on"),
        }
        require(self, fields)

    def __repr__(self) -> str:
        return changed(self)

    @classmethod
    def paper(cls) -> TrackerConfig:
        """The published recursion: degree 7, log(l + 1e-3) scaled to the frame's maximum, spherical mean."""
        published = Calibration.paper()
        return cls(degree=7, decode="mean", calibration=published, ranges=None, motion=MotionModel.still())

    def fitted(
        self, calibration: Calibration | None, detector: DetectorModel | None, forgetting: Mapping[str, Any]
    ) -> TrackerConfig:
        """This with fitted values: how looks are read (None: unchanged), and fields of `motion`."""
        return replace(
            self,
            calibration=calibration or self.calibration,
            detector=detector or self.detector,
            motion=replace(self.motion, **forgetting),
        )


def _are_ranges(ranges: Sequence[float] | None) -> bool:
    if ranges is None:
        return True
    try:
        found = [float(value) for value in ranges]
    except (TypeError, ValueError):
        return False
    return len(found) > 1 and all(above(value, 0) for value in found) and bool((np.diff(found) > 0).all())


@dataclass(frozen=True, eq=False)
class Mode:
    """A candidate: `direction` ``(3,)`` in the body frame, azimuth and elevation in radians.

    `weight`: the probability of its basin: the directions within 20 degrees whose steepest ascent leads to it. The
    weights of all modes sum to less than 1; the rest is elsewhere.
    """

    direction: np.ndarray
    azimuth: float
    elevation: float
    weight: float

    def __repr__(self) -> str:
        return f"Mode({where(self.azimuth, self.elevation)}, weight {self.weight:.2f})"


@dataclass(frozen=True, eq=False)
class Answer:
    """The answered direction ``(3,)``, world axes, and whether it is an older answer that is kept."""

    direction: np.ndarray
    held: bool = False


def chosen(reading: Reading, before: Answer | None, repeats: float = 0.0) -> Answer | None:
    """The answer: the heaviest mode, or the one `before` unless another holds 1 / (1 - repeats) times as much.

    `repeats`: share of a look's mistakes that is still repeated. With independent looks (0) the answer is the heaviest
    mode. Otherwise one mistake can make another mode heavier for many looks, and the answer would jump back and forth.
    """
    if float(np.ptp(reading.field.values)) < FLAT and not reading.field.patches:
        return None
    first, _ = reading.first(NEAR)
    if before is None or first @ before.direction > math.cos(NEAR):
        return Answer(first)
    if reading.around(before.direction, NEAR) < reading.around(first, NEAR) * (1 - repeats):
        return Answer(first)
    near = reading.parts[2] @ before.direction > math.cos(NEAR)
    kept = reading.top_of(near)
    # If the belief still rises at the border of the cone, there is no peak left to keep.
    return Answer(kept, True) if kept @ before.direction > math.cos(0.9 * NEAR) else Answer(first)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer at one time, in the body frame of that time. All of it is read from one posterior.

    `stamp`: the time asked for; `age`: seconds since the newest evidence was captured (infinite before any); `cases`:
    the posterior, in WORLD axes; `world_R_body`: the pose at that time; `answer`: in world axes; `rates`: of the
    detector, where they are learnt.
    """

    stamp: float
    age: float
    cases: Cases
    world_R_body: np.ndarray
    config: TrackerConfig
    answer: Answer | None = None
    rates: Rates | None = None

    def __repr__(self) -> str:
        presence = f"presence {self.presence:.2f}, {self.status}"
        if self.azimuth is None or self.elevation is None:
            return f"Estimate(t={self.stamp:g} s, direction not known, {presence})"
        cone = f"90 % within {math.degrees(self.credible_angle):.0f}°"
        held = ", held" if self.held else ""
        return f"Estimate(t={self.stamp:g} s, {where(self.azimuth, self.elevation)}, {cone}, {presence}{held})"

    @property
    def posterior(self) -> Reading:
        """The posterior over directions, given that the target is present; world axes."""
        return self.cases.reading

    @lazy
    def direction(self) -> np.ndarray | None:
        """The answer ``(3,)``: the first of `modes`, or the mode that is `held`; None while nothing is known."""
        if math.isinf(self.age):
            return None
        if self.config.decode == "mean":
            coarse = self.cases.standing.coarse.direction_belief()
            return to_numpy(coarse.mean_direction()) @ self.world_R_body
        return None if self.answer is None else self.answer.direction @ self.world_R_body

    @property
    def held(self) -> bool:
        """Whether an older answer is kept although another mode is heavier now."""
        return self.answer is not None and self.answer.held

    @property
    def azimuth(self) -> float | None:
        """Radians, positive left; None while nothing is known."""
        return None if self.direction is None else float(azimuth_elevation(self.direction)[0])

    @property
    def elevation(self) -> float | None:
        """Radians, positive up; None while nothing is known."""
        return None if self.direction is None else float(azimuth_elevation(self.direction)[1])

    @lazy
    def modes(self) -> tuple[Mode, ...]:
        """The candidates, the most probable first; none while nothing is known."""
        if self.direction is None:
            return ()
        found, masses = self.posterior.modes(MOST_MODES, LEAST_MODE)
        return tuple(_mode(d @ self.world_R_body, m) for d, m in zip(found, masses, strict=True))

    @lazy
    def credible_angle(self) -> float:
        """Half-angle (radians) of the cone that is centred on the answer and holds 90 % of the belief."""
        return self.posterior.cone(0.9, self._about)

    def within(self, angle: float) -> float:
        """Probability that the target is present and within `angle` radians of the answer."""
        return self.presence * self.posterior.within(angle, self._about)

    @property
    def _about(self) -> np.ndarray:
        """The answer in world axes, or forward if there is none."""
        return self.world_R_body[:, 0] if self.direction is None else self.world_R_body @ self.direction

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """log of the posterior density (per steradian) ``(...)`` at unit vectors ``(..., 3)``; it integrates to 1."""
        found = np.asarray(to_numpy(check_directions(np.asarray(directions, dtype=np.float64))))
        return self.posterior.field(found @ self.world_R_body.T) - self.posterior.log_total

    def density(self, grid: Grid) -> np.ndarray:
        """The posterior density (per steradian) on a grid of the body frame ``(H, W)``; over the sphere it sums to 1.

        On a grid of the whole sphere each cell holds its mean density: a peak narrower than a cell keeps its mass.
        """
        found = np.exp(self.log_density(grid.directions))
        if not isinstance(grid, ErpGrid | PatchGrid):
            return found
        _, _, directions = self.posterior.parts
        mass = self.posterior.mass
        x, y, _ = grid.project(directions @ self.world_R_body)
        cell = np.minimum(y.astype(np.intp), grid.height - 1) * grid.width + x.astype(np.intp) % grid.width
        weights = grid.weights.reshape(-1)
        # Where the parts of the reading are finer than the cells, sum them; elsewhere sample.
        fine = np.bincount(cell, minlength=weights.size) >= 4
        summed = np.bincount(cell, mass, minlength=weights.size) / weights
        found = np.where(fine.reshape(grid.shape), summed.reshape(grid.shape), found)
        return found / float(np.sum(found * grid.weights))

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest credible region that reaches `direction` ``(3,)``, body frame."""
        return self.posterior.mass_above(self.world_R_body @ np.asarray(direction, dtype=np.float64))

    def region(self, mass: float = 0.9) -> tuple[float, float]:
        """The smallest region that holds `mass`: log density (per steradian) at its border, and area (steradians)."""
        return self.posterior.region(mass)

    @property
    def presence(self) -> float:
        """Probability that the target is present."""
        return self.cases.presence

    @property
    def moving(self) -> float | None:
        """Probability that the target moves, if it is present; None if the motion model has no motion."""
        return self.cases.moving if len(self.config.motion.kinds) else None

    @property
    def distance(self) -> float | None:
        """Distance (metres) of a standing target in the direction of the answer; None without positions."""
        return None if self._range is None else self._range[0]

    @property
    def distance_spread(self) -> float | None:
        """Standard deviation of the logarithm of the distance; None without positions."""
        return None if self._range is None else self._range[1]

    @lazy
    def _range(self) -> tuple[float, float] | None:
        """Distance and its spread, from one (slow) computation of the range probabilities."""
        return None if math.isinf(self.age) else self.cases.standing.distance(self._about)

    @lazy
    def status(self) -> Status:
        """How good the answer is.

        - "searching": the target is probably absent, or its direction is too uncertain;
        - "tracking": with a probability of at least 0.5 it is present and within 15 degrees of the answer, and no other
          mode holds a fifth of the belief;
        - "ambiguous": it is probably present, and several modes hold a fifth or more each, or half of the belief
          together;
        - "stale": there was an answer, but no evidence for longer than `TrackerConfig.stale_after`.
        """
        if self.direction is None:
            return "searching"
        found = self._found()
        return "stale" if found != "searching" and self.age > self.config.stale_after else found

    def _found(self) -> Status:
        if self.presence < 0.5:
            return "searching"
        rivals = sum(mode.weight >= RIVAL for mode in self.modes)
        if rivals > 1:
            return "ambiguous"
        if self.within(SURE) >= 0.5:
            return "tracking"
        told = sum(mode.weight for mode in self.modes)
        return "ambiguous" if len(self.modes) > 1 and told >= 0.5 else "searching"

    def _repr_html_(self) -> str:
        """A small picture, for notebooks."""
        from eagor import thumbnail

        if self.direction is None:
            return thumbnail.unknown_html(repr(self))
        modes = [mode.direction for mode in self.modes]
        return thumbnail.density_html(repr(self), self.log_density, *self.region(0.9), modes, self.direction)


def _mode(direction: np.ndarray, weight: float) -> Mode:
    azimuth, elevation = azimuth_elevation(direction)
    return Mode(direction, float(azimuth), float(elevation), float(weight))
