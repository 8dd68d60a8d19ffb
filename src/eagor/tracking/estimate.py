"""The answer at one time: direction, candidates, cone, presence, distance, status."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from eagor._arrays import to_numpy
from eagor._checks import checked_stamp
from eagor._values import lazy, where, wide
from eagor.belief.density import Density
from eagor.belief.field import cells_of
from eagor.belief.posterior import checked_mass
from eagor.errors import EagorError, TimeError
from eagor.evidence.detector import ClutterRate
from eagor.grids import ErpGrid, Grid, PatchGrid
from eagor.harmonics.peaks import FLAT
from eagor.sphere import azimuth_elevation, check_unit, checked_pose
from eagor.tracking.config import TrackerConfig
from eagor.tracking.imm import TargetHypotheses
from eagor.tracking.next_view import Heights, Known, NextLook, TurningCamera, TurningRig, best_look

__all__ = ["Estimate", "Mode", "Status"]

Status = Literal["searching", "tracking", "ambiguous", "stale"]
SURE = math.radians(15)  # of the answer: a target within this angle counts as found
RIVAL = 0.2  # of the belief: a second mode that holds this share makes the answer ambiguous
LEAST_MODE = 0.02  # of the belief: modes that hold less are not listed
MOST_MODES = 10


@dataclass(frozen=True, eq=False)
class Mode:
    """A candidate: `direction` ``(3,)`` in the body frame, azimuth and elevation in radians.

    `weight`: the probability of its basin: the directions within 20 degrees whose steepest ascent leads to it. The
    weights of all modes sum to less than 1; the rest is elsewhere.

        >>> tracker = eagor.DirectionTracker()
        >>> tracker.observe(eagor.Evidence.from_points([[0, 1, 0], [1, 0, 0]], stamp=0.0))
        >>> sorted(round(math.degrees(mode.azimuth)) for mode in tracker.estimate(0.0).modes)
        [0, 90]
    """

    direction: np.ndarray
    azimuth: float
    elevation: float
    weight: float

    def __repr__(self) -> str:
        return f"Mode({where(self.azimuth, self.elevation)}, weight {self.weight:.2f})"


@dataclass(frozen=True, eq=False)
class Estimate:
    """The answer at one time, in the body frame of that time. All of it is read from one posterior.

    `stamp`: the time asked for; `age`: seconds since the newest evidence was captured (infinite before any);
    `hypotheses`: the posterior, in WORLD axes; `world_R_body`: the pose at that time; `alarms`: the number of false
    alarms in a look, where it is learnt. `looked_for`: what was looked for, where that is another word than was asked.
    `spread`: radians per axis by which that pose may be off; regions are as much wider.

        >>> tracker = eagor.DirectionTracker()
        >>> tracker.observe(eagor.Evidence.from_points([[0, 1, 0]], stamp=0.0))
        >>> estimate = tracker.estimate(0.0)
        >>> estimate.status, round(estimate.presence, 1), estimate.distance
        ('tracking', 0.7, None)
    """

    stamp: float
    age: float
    hypotheses: TargetHypotheses
    world_R_body: np.ndarray
    config: TrackerConfig
    alarms: ClutterRate | None = None
    looked_for: str = ""
    spread: float = 0.0
    of: Estimate | None = field(default=None, repr=False)  # what this is `turned` from

    def __repr__(self) -> str:
        presence = f"presence {self.presence:.2f}, {self.status}"
        presence += f", looked for {self.looked_for}" if self.looked_for else ""
        if self.azimuth is None or self.elevation is None:
            return f"Estimate(t={self.stamp:g} s, direction not known, {presence})"
        return f"Estimate(t={self.stamp:g} s, {where(self.azimuth, self.elevation)}, {self.certainty}, {presence})"

    @property
    def certainty(self) -> str:
        """Where the belief is about a direction that is known: "90 % within 6°", or "2 candidates hold 96 %".

        The latter where the answer is ambiguous: a cone about one of them that reaches to the other says nothing.
        """
        if self._found == "ambiguous" and len(self.modes) > 1:
            return f"{len(self.modes)} candidates hold {100 * sum(mode.weight for mode in self.modes):.0f} %"
        return f"90 % within {wide(self.credible_angle)}"

    @property
    def posterior(self) -> Density:
        """The posterior over directions, given that the target is present; world axes."""
        return self.hypotheses.widened(self.spread)

    @lazy
    def direction(self) -> np.ndarray | None:
        """The answer ``(3,)``: the first of `modes`; None while nothing is known."""
        return None if self._answer is None else self._answer @ self.world_R_body

    @lazy
    def _answer(self) -> np.ndarray | None:
        """`direction` in world axes."""
        if self.of is not None:
            return self.of._answer
        if math.isinf(self.age):
            return None
        if self.config.answers.decode == "mean":
            return to_numpy(self.hypotheses.standing.coarse.direction_belief().mean_direction())
        field = self.posterior.field
        if float(np.ptp(field.values)) < FLAT and not field.patches:
            return None
        return self._places[0][0]

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
        found, masses = self._places
        return tuple(_mode(d @ self.world_R_body, m) for d, m in zip(found, masses, strict=True))

    @lazy
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """The candidates' directions ``(m, 3)``, world axes, and weights ``(m,)``."""
        return self.posterior.modes(MOST_MODES, LEAST_MODE) if self.of is None else self.of._places

    @lazy
    def credible_angle(self) -> float:
        """Half-angle (radians) of the cone that is centred on the answer and holds 90 % of the belief."""
        return self.posterior.cone(0.9, self._about) if self._alike is None else self._alike.credible_angle

    def within(self, angle: float) -> float:
        """Probability that the target is present and within `angle` radians of the answer, from 0 to pi."""
        if not 0 <= angle <= math.pi:
            raise EagorError(f"angle = {angle!r}; wanted radians from 0 to pi: math.radians(30) for 30 degrees")
        return self.presence * self.posterior.within(angle, self._about)

    @lazy
    def size(self) -> float:
        """The angular size (radians) of what was detected in the direction of the answer; 0 where that is not known.

        It is the mean over the looks, along the longer axis. Points and response maps have none.
        """
        if self.of is not None:
            return self.of.size
        return 0.0 if self._answer is None else 2 * self.hypotheses.standing.size(self._answer)

    @property
    def confidence(self) -> float:
        """Probability that the target is present and where the answer says.

        That is within 15 degrees of the answer, or half its angular size, where that is more.
        """
        return self.within(min(max(SURE, 0.5 * self.size), math.pi))

    @property
    def progress(self) -> float:
        """Metres by which the target, if it is present and far, comes nearer per metre walked to the answer.

        It is the expected cosine of the angle between the answer and the target; 0 while nothing is known.
        """
        return 0.0 if self.direction is None else self.posterior.cosine(self._about)

    @property
    def _alike(self) -> Estimate | None:
        """What this is turned from, if the pose was as sure then."""
        return None if self.of is None or self.of.spread != self.spread else self.of

    @property
    def _about(self) -> np.ndarray:
        """The answer in world axes, or forward if there is none."""
        return self.world_R_body[:, 0] if self._answer is None else self._answer

    def log_density(self, directions: np.ndarray) -> np.ndarray:
        """log of the posterior density (per steradian) ``(...)`` at unit vectors ``(..., 3)``; it integrates to 1."""
        found = check_unit(np.asarray(to_numpy(directions), dtype=np.float64))
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
        cell = cells_of(grid, directions @ self.world_R_body)
        weights = grid.weights.reshape(-1)
        # Where the parts of the reading are finer than the cells, sum them; elsewhere sample.
        fine = np.bincount(cell, minlength=weights.size) >= 4
        summed = np.bincount(cell, mass, minlength=weights.size) / weights
        found = np.where(fine.reshape(grid.shape), summed.reshape(grid.shape), found)
        return found / float(np.sum(found * grid.weights))

    def mass_above(self, direction: np.ndarray) -> float:
        """The mass of the smallest credible region that reaches `direction` ``(3,)``, body frame."""
        return self.posterior.mass_above(self.world_R_body @ check_unit(np.asarray(direction, dtype=np.float64)))

    def region(self, mass: float = 0.9) -> tuple[float, float]:
        """The smallest region that holds `mass`: log density (per steradian) at its border, and area (steradians)."""
        return self.posterior.region(checked_mass(mass))

    @property
    def presence(self) -> float:
        """Probability that the target is present."""
        return self.hypotheses.presence

    @property
    def drift(self) -> float:
        """How far the odometry drifts, radians per root second: as the config says, or as the looks tell."""
        return self.hypotheses.drift

    @property
    def moving(self) -> float | None:
        """Probability that the target moves, if it is present; None if the motion model has no motion."""
        return self.hypotheses.moving if len(self.config.target_motion.kinds) else None

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
        if self.of is not None:
            return self.of._range
        return None if math.isinf(self.age) else self.hypotheses.distance(self._about)

    @lazy
    def status(self) -> Status:
        """How good the answer is.

        - "searching": the target is probably absent, or its direction is too uncertain;
        - "tracking": with a probability of at least 0.5 it is present and within 15 degrees of the answer (half its
          angular size, where that is more), and no other mode holds a fifth of the belief;
        - "ambiguous": it is probably present, and several modes hold a fifth or more each, or half of the belief
          together;
        - "stale": there was an answer, but no evidence for longer than `AnswerSettings.stale_after`.
        """
        if self.direction is None:
            return "searching"
        found = self._found
        return "stale" if found != "searching" and self.age > self.config.answers.stale_after else found

    @lazy
    def _found(self) -> Status:
        if self._alike is not None:
            return self._alike._found
        if self.presence < 0.5:
            return "searching"
        rivals = sum(mode.weight >= RIVAL for mode in self.modes)
        if rivals > 1:
            return "ambiguous"
        if self.confidence >= 0.5:
            return "tracking"
        told = sum(mode.weight for mode in self.modes)
        return "ambiguous" if len(self.modes) > 1 and told >= 0.5 else "searching"

    def next_look(
        self,
        camera: TurningCamera | TurningRig | float,
        usual: Heights | None = None,
        body_R_view: np.ndarray | None = None,
    ) -> NextLook:
        """Where a camera that sees only a part of the sphere should look next: where that is expected to tell most.

        Of several cameras on a body (`TurningRig`): to where the body should turn, for all that they see together.

        What counts is whether the thing is present, and where (`eagor.tracking.next_view`). The world's z axis is up.

        Args:
            camera: what it sees and how it turns, or its horizontal field of view in radians.
            usual: at which heights things usually are, if that is known.
            body_R_view: where the camera looks now ``(3, 3)``; default: straight ahead. A rig's views have theirs.

        Raises `GridError` for numbers out of range.

            >>> tracker = eagor.DirectionTracker()
            >>> tracker.observe(eagor.Evidence.from_points([[0, 1, 0]], stamp=0.0))
            >>> look = tracker.estimate(0.0).next_look(math.radians(70))
            >>> look.direction[1] > math.cos(math.radians(35))  # the thing to the left will be in view
            True
        """
        camera = camera if isinstance(camera, TurningCamera | TurningRig) else TurningCamera(camera)
        view = np.eye(3) if body_R_view is None else checked_pose(body_R_view, "body_R_view")
        to, tells, turn = best_look(self._known, camera, usual, self.world_R_body, view[:, 0])
        toward = to @ self.world_R_body
        azimuth, elevation = azimuth_elevation(toward)
        return NextLook(toward, float(azimuth), float(elevation), tells, turn)

    @lazy
    def _known(self) -> Known:
        """What is believed, for a choice of the next look."""
        modes = np.zeros((0, 3)) if self._answer is None else self._places[0]
        return Known(self.hypotheses, *self.posterior.nodes, modes, self.alarms)

    def turned(self, stamp: float, world_R_body: np.ndarray, spread: float = 0.0) -> Estimate:
        """This belief at a later time, from another orientation ``(3, 3)``; quick, since all is shared with this one.

        `spread`: radians per axis by which that orientation may be off.

        Exact for the camera's turns. What else may have happened since (the target moved, the camera moved past it) is
        left out: for a short while only. Raises `TimeError` if `stamp` is earlier than this estimate's.
        """
        if checked_stamp(stamp) < self.stamp:
            raise TimeError(f"turned to t = {stamp:.6f} s from {self.stamp:.6f} s; wanted that time or later")
        world_R_body = checked_pose(world_R_body)
        age = self.age + (stamp - self.stamp)
        return replace(self, stamp=stamp, age=age, world_R_body=world_R_body, spread=spread, of=self.of or self)

    def as_dict(self, modes: int = MOST_MODES, near: int | None = None) -> dict[str, Any]:
        """The answer as plain numbers, the form in which it is written everywhere; what is not known is None.

        Angles in degrees. At most so many `modes`; the distance is left out while searching, "looked_for" where it is
        what was asked. `near`: degrees, adds the probability that the target is `within` that angle of the answer.
        """

        def angles(azimuth: float | None, elevation: float | None) -> dict[str, float | None]:
            return {"azimuth_deg": degrees(azimuth), "elevation_deg": degrees(elevation)}

        def degrees(angle: float | None) -> float | None:
            return None if angle is None else plain_number(math.degrees(angle))

        known, placed = self.direction is not None, self.status != "searching"
        within = {} if near is None else {
            f"within_{near}_deg": plain_number(self.within(math.radians(near))) if known else None
        }  # fmt: skip
        return {
            "stamp": plain_number(self.stamp),
            **({"looked_for": self.looked_for} if self.looked_for else {}),
            **angles(self.azimuth, self.elevation),
            "direction": None if self.direction is None else [plain_number(each) for each in self.direction],
            "credible_angle_deg": degrees(self.credible_angle) if known else None,
            "presence": plain_number(self.presence),
            "distance_m": plain_number(self.distance) if placed else None,
            "distance_spread": plain_number(self.distance_spread) if placed else None,
            **within,
            "status": self.status,
            "modes": [
                angles(each.azimuth, each.elevation) | {"weight": plain_number(each.weight)}
                for each in self.modes[:modes]
            ],
        }

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


def plain_number(value: float | None) -> float | None:
    """A number for files, rounded to a millionth; None for what is not known, or endless."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)
