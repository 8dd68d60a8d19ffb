"""What a tracker is asked to do, and what it answers: `TrackerConfig` and `Estimate`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import require
from eagor.belief import Belief
from eagor.calibration import Calibration
from eagor.harmonics import RealHarmonics
from eagor.motion import DOUBT, SAME, SETTLE, StillOrMoving, standing
from eagor.posterior import MIN_WEIGHT, PROMINENCE, RIVAL
from eagor.ranged import RangedBelief, log_ranges, mean_range, range_spread
from eagor.sphere import azimuth_elevation

Status = Literal["searching", "tracking", "ambiguous", "stale"]


@dataclass(frozen=True)
class TrackerConfig:
    """How a `DirectionTracker` believes, forgets and answers.

    - `degree`: of the harmonics; resolution is about 180 / degree degrees.
    - `decode`: "mode", or "mean" for the published estimate.
    - `calibration`: read every evidence with this one instead of its own.
    - `ranges`: shells (metres) of the belief over distance, used where positions are known; None: directions only.
    - `floor`: height (z, metres) of the floor in the odometry's world, where it is known: things stand on it, so that
      how far below the horizon one is tells how far away it may be (`eagor.ranged.height_prior`).
    - `keep_per_second`: share of the log-odds that survives one second (1: nothing is forgotten).
    - `diffusion`: radians per square root of a second by which the belief is spread: for targets of which nothing
      stands still, and odometry that drifts.
    - `wander`: radians per square root of a second by which a target wanders if it does not stand still; both cases
      are believed in side by side (`eagor.motion`). 0: every target stands still.
    - `restless`: changes per second between standing still and wandering.
    - `doubt`: neither standing still nor wandering is ever less likely than this.
    - `settle`: seconds in which what is known of the place where it stood fades, once it is surely elsewhere
      (`eagor.motion.StillOrMoving.fading`).
    - `surest`: nats by which the best direction of a target that stands still may rise above a typical one; beyond,
      what is said of directions is scaled down. Looks share their mistakes: nothing is ever surer than that. What tells
      its ranges apart is not scaled.
    - `history`: seconds for which poses and evidence are kept, so that late evidence finds its place.
    - `stale_after`: seconds without evidence after which an estimate is stale.
    - `found_at`: nats by which the best direction must stand above a uniform belief; below, we are searching.
    - `switch_at`: nats. The answer stays with the peak that it named last until another rises above that by so much: an
      answer that jumps to and fro between equals is of no use to anybody.
    - `present_at`: probability of presence below which we are searching, however far a direction stands out.
    - `ambiguous_below`: if no mode holds this share of the belief, the answer is ambiguous. So it is if a second one
      rises nearly as high, or clearly (`eagor.posterior.RIVAL`, `CLEAR`), whatever their weights: looks that repeat
      each other make any small difference decisive, and two things that both look like the target stay two.
    """

    degree: int = 15
    decode: Literal["mode", "mean"] = "mode"
    calibration: Calibration | None = None
    ranges: Sequence[float] | None = field(default_factory=lambda: tuple(log_ranges(count=20).tolist()))
    floor: float | None = None
    keep_per_second: float = 0.997
    diffusion: float = 0.0
    wander: float = math.radians(7)
    restless: float = 0.002
    doubt: float = DOUBT
    settle: float = SETTLE
    surest: float = 20.0
    history: float = 10.0
    stale_after: float = 5.0
    switch_at: float = 1.0
    found_at: float = 1.5
    present_at: float = 0.3
    ambiguous_below: float = 0.65

    def __post_init__(self) -> None:
        RealHarmonics(self.degree)  # complains about what is no degree
        fields = {
            "decode": (self.decode in ("mode", "mean"), "mode or mean"),
            "keep_per_second": (0 < self.keep_per_second <= 1, "a share above 0 and up to 1"),
            "diffusion": (0 <= self.diffusion < math.pi, "radians per root second, from 0 to pi"),
            "wander": (0 <= self.wander < math.pi, "radians per root second, from 0 to pi"),
            "restless": (0 <= self.restless < math.inf, "changes per second, from 0 on"),
            "doubt": (0 < self.doubt < 0.5, "a probability between 0 and 0.5"),
            "settle": (self.settle > 0, "seconds above 0"),
            "surest": (self.surest > 0, "nats above 0"),
            "history": (self.history >= 0, "seconds from 0 on"),
            "stale_after": (self.stale_after >= 0, "seconds from 0 on"),
            "found_at": (not math.isnan(self.found_at), "nats"),
            "switch_at": (self.switch_at >= 0, "nats from 0 on"),
            "present_at": (0 <= self.present_at <= 1, "a probability"),
            "ambiguous_below": (0 <= self.ambiguous_below <= 1, "a share of the belief"),
        }
        require(self, fields)

    @classmethod
    def paper(cls) -> TrackerConfig:
        """The published recursion: degree 7, log(l + 1e-3) scaled to the frame's maximum, spherical mean."""
        published = Calibration.paper()
        memory = {"keep_per_second": 1.0, "wander": 0.0}
        return cls(degree=7, decode="mean", calibration=published, ranges=None, present_at=0.0, **memory)


@dataclass(frozen=True, eq=False)
class Mode:
    """A candidate: `direction` ``(3,)`` in the body frame, azimuth and elevation in radians, share of the belief."""

    direction: np.ndarray
    azimuth: float
    elevation: float
    weight: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer at one time, in the body frame of that time. Each part is computed when it is first asked for.

    `stamp`: the time asked for; `age`: seconds since the newest evidence was captured (infinite before any);
    `reading`: the belief behind the answer, in the axes of the WORLD; `world_R_body`: the pose that turns it; `named`:
    the peak that was the answer to the newest evidence, in the axes of the world.
    """

    stamp: float
    age: float
    reading: Belief | RangedBelief | StillOrMoving
    world_R_body: np.ndarray
    config: TrackerConfig
    named: np.ndarray | None = None

    @cached_property
    def direction(self) -> np.ndarray:
        """Where it is ``(3,)``: a mode of the belief, or its published mean; forward while nothing is known."""
        if self.config.decode == "mean":
            return to_numpy(self.reading.direction_belief().mean_direction()) @ self.world_R_body
        return self._peak @ self.world_R_body  # body_R_world @ peak

    @property
    def _answer(self) -> np.ndarray:
        """`direction` in the axes of the world."""
        return self.world_R_body @ self.direction

    @cached_property
    def _peak(self) -> np.ndarray:
        return held(self.reading, self.named, self.config.switch_at)

    @property
    def azimuth(self) -> float:
        """Radians, positive left."""
        return float(azimuth_elevation(self.direction)[0])

    @property
    def elevation(self) -> float:
        """Radians, positive up."""
        return float(azimuth_elevation(self.direction)[1])

    @cached_property
    def _peaks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.reading.posterior.modes(5, PROMINENCE, MIN_WEIGHT)

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The candidates, strongest first."""
        found, weights, _ = self._peaks
        return tuple(_mode(d @ self.world_R_body, w) for d, w in zip(found, weights, strict=True))

    @cached_property
    def credible_angle(self) -> float:
        """Half-angle (radians) of the cone about the peak that is the answer which holds 90 % of the belief."""
        return self.reading.posterior.cone(0.9, self._peak)

    def within(self, angle: float) -> float:
        """Probability that the target is around and within `angle` radians of that peak: how far to trust it."""
        return self.presence * self.reading.posterior.within(angle, self._peak)

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest credible region that reaches `direction` ``(3,)``, body frame."""
        return self.reading.mass_above(self.world_R_body @ direction)

    @cached_property
    def presence(self) -> float:
        """Probability that the target is around at all."""
        return self.reading.presence()

    @property
    def distance(self) -> float | None:
        """Metres, of what stands where the answer points; None where positions are unknown."""
        return None if self._range is None else self._range[0]

    @property
    def distance_spread(self) -> float | None:
        """Standard deviation of the logarithm of the distance; None where positions are unknown."""
        return None if self._range is None else self._range[1]

    @cached_property
    def _range(self) -> tuple[float, float] | None:
        """Distance and its spread: both are read from the same probabilities of the ranges, which take their time."""
        still = standing(self.reading)
        if not isinstance(still, RangedBelief):
            return None
        probabilities = still.range_probabilities(self._answer)
        return float(mean_range(probabilities, still.ranges)), float(range_spread(probabilities, still.ranges))

    @property
    def moving(self) -> float | None:
        """Probability that the target moves; None where that is not asked (`TrackerConfig.wander` = 0)."""
        return self.reading.moving if isinstance(self.reading, StillOrMoving) else None

    @cached_property
    def status(self) -> Status:
        """Whether there is an answer: searching, tracking, ambiguous, or stale (nothing new for too long)."""
        known = not math.isinf(self.age)
        stale = known and self.age > self.config.stale_after
        if not known or self.reading.posterior.gain < self.config.found_at or self.presence < self.config.present_at:
            return "stale" if stale else "searching"
        if stale:
            return "stale"
        _, weights, heights = self._peaks
        rivals = int((heights >= RIVAL).sum())
        return "ambiguous" if rivals > 1 or float(weights.max()) < self.config.ambiguous_below else "tracking"


def held(reading: Belief | RangedBelief | StillOrMoving, named: np.ndarray | None, margin: float) -> np.ndarray:
    """The peak ``(3,)`` that is the answer: the one that was `named` before, unless another is higher by `margin`."""
    posterior = reading.likelier if isinstance(reading, StillOrMoving) else reading.posterior
    kept = None if named is None or margin == 0 else posterior.peak_near(named, SAME)
    if kept is None or kept[1] < float(posterior.coarse.max()) - margin:
        return posterior.mode
    return kept[0]


def _mode(direction: np.ndarray, weight: float) -> Mode:
    azimuth, elevation = azimuth_elevation(direction)
    return Mode(direction, float(azimuth), float(elevation), float(weight))
