"""Following targets over time: poses at one rate, evidence at another, late or out of order, answers whenever asked.

The belief is kept in the axes of the odometry's world, so that turning the camera costs nothing and loses nothing:
evidence is rotated once, from the body at the time of CAPTURE, and an answer is turned into the body at the time of the
question. Evidence that arrives late therefore lands where it belongs by itself. Only what does not commute with adding
(diffusion of a density, parallax under translation) needs its order restored, and for that a bounded history is
replayed.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from eagor._arrays import to_numpy
from eagor.belief import Belief
from eagor.errors import PoseError, TimeError
from eagor.estimate import Estimate, TrackerConfig, held
from eagor.evidence import Evidence
from eagor.harmonics import RealHarmonics
from eagor.motion import StillOrMoving, standing
from eagor.poses import PoseHistory
from eagor.ranged import RangedBelief, height_prior


@dataclass(frozen=True, eq=False)
class _Look:
    """One evidence in world axes: when, from where, its coefficients, and how far it repeats the one before it."""

    stamp: float
    position: np.ndarray | None
    coefficients: np.ndarray
    persistence: float


@dataclass(frozen=True, eq=False)
class _State:
    """A target's belief in world axes, about the place where the body stood at `stamp`.

    `newest` ``(size,)``, or ``(K, size)`` once the body has moved on: the part of the newest look that is in the belief
    only while it is the newest; `named`: the peak that was the answer to it.
    """

    belief: Belief | RangedBelief | StillOrMoving
    stamp: float
    position: np.ndarray | None
    newest: np.ndarray | None = None
    named: np.ndarray | None = None

    @cached_property
    def reading(self) -> Belief | RangedBelief | StillOrMoving:
        """The belief with what the newest look says."""
        return self.belief if self.newest is None else self.belief.plus(self.newest)


class DirectionTracker:
    """Follows any number of targets from stamped poses and stamped evidence.

    Call `rotate` for every pose of the odometry, `observe` for every evidence as it arrives, `estimate` whenever an
    answer is wanted. Stamps are seconds on one clock. Without any pose the camera is taken to stand still.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._poses = PoseHistory(self.config.history)
        self._states: dict[str, _State] = {}
        self._pasts: dict[str, list[tuple[_State | None, _Look]]] = {}

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that have had evidence."""
        return tuple(self._states)

    def rotate(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None) -> None:
        """A pose of the body: orientation ``(3, 3)``, and `position` ``(3,)`` in metres of the world where known.

        Raises `TimeError` if `stamp` lies before the pose before it, `RotationError` for what is no rotation,
        `PoseError` for a position that is not three finite numbers or that is missing after earlier ones were given.
        """
        self._poses.add(stamp, world_R_body, position)

    def observe(self, evidence: Evidence, target: str = "target") -> None:
        """Add evidence about `target`, placed by its time of capture; it may be late and out of order.

        Raises `TimeError` without a stamp, or if it is older than the history and its order matters, and `PoseError` if
        no pose of that time is known any more, or if the camera is not above the floor.
        """
        if evidence.stamp is None:
            raise TimeError(
                "the evidence has no time stamp; pass stamp=... (time of capture, seconds) where it is made"
            )
        stamp = evidence.stamp
        if self.config.calibration is not None:
            evidence = evidence.with_calibration(self.config.calibration)
        pose, position = self._poses.at(stamp)
        found = to_numpy(evidence.coefficients(self.config.degree)).astype(np.float64)
        turned = RealHarmonics(self.config.degree).rotate(found, pose)
        look = _Look(stamp, position, turned, evidence.calibration.persistence)
        state = self._states.get(target)
        if state is None or look.stamp >= state.stamp or not self._linear(state):
            self._absorb_in_order(target, look)
        else:  # adding commutes: the late look only has to be forgotten for as long as it was under way
            share = (1 - look.persistence) * self.config.keep_per_second ** (state.stamp - look.stamp)
            faded = share * look.coefficients
            self._states[target] = replace(state, belief=Belief(state.belief.coefficients + faded))  # type: ignore[union-attr]

    def estimate(self, now: float, target: str = "target") -> Estimate:
        """The answer at time `now`, in the body frame of that time (the last known pose is held beyond its stamp).

        Raises `TimeError` if `now` lies before the newest evidence, and `PoseError` if it lies before all known poses
        or the camera is not above the floor. A target without evidence is `searching`, forward.
        """
        pose, _ = self._poses.at(now)
        state = self._advanced(target, now)
        age = now - self._states[target].stamp if target in self._states else math.inf
        return Estimate(now, age, state.reading, pose, self.config, state.named)

    def belief(self, now: float, target: str = "target") -> Belief:
        """The belief over directions at time `now`, in the body frame of that time."""
        pose, _ = self._poses.at(now)
        return self._advanced(target, now).reading.direction_belief().predict(pose.T)

    def _linear(self, state: _State) -> bool:
        """Whether everything that happens to this belief commutes with adding evidence."""
        return isinstance(state.belief, Belief) and self.config.diffusion == 0

    def _absorb_in_order(self, target: str, look: _Look) -> None:
        """Add a look; where order matters and later ones came first, go back and replay them."""
        past = self._pasts.setdefault(target, [])
        state = self._states.get(target)
        keep = state is None or not self._linear(state)
        if state is None or look.stamp >= state.stamp:
            self._states[target] = self._added(state, look)
            if keep:
                past.append((state, look))
        else:
            base = past[0][0]  # nothing before this state is remembered
            if base is not None and look.stamp < base.stamp:
                raise TimeError(
                    f"evidence of t = {look.stamp:.3f} s is older than the history, which starts at "
                    f"{base.stamp:.3f} s; raise TrackerConfig.history (now {self.config.history:g} s) or drop it"
                )
            place = bisect.bisect_right([other.stamp for _, other in past], look.stamp)
            state = past[place][0]
            later = [other for _, other in past[place:]]
            del past[place:]
            for other in [look, *later]:
                past.append((state, other))
                state = self._added(state, other)
            self._states[target] = state  # type: ignore[assignment]
        newest = self._states[target].stamp
        del past[: sum(other.stamp < newest - self.config.history for _, other in past)]

    def _added(self, state: _State | None, look: _Look) -> _State:
        """The state after one look."""
        passing = None
        if state is None:
            state = _State(self._blank(look.position), look.stamp, look.position)
        else:
            passing = state.newest
            state = self._moved(replace(state, newest=None), look.stamp, look.position)
        newest = look.persistence * look.coefficients if look.persistence > 0 else None
        share = 1 - look.persistence
        still = standing(state.belief).plus(share * look.coefficients)
        whole: Belief | RangedBelief | StillOrMoving = still
        if isinstance(state.belief, StillOrMoving):
            whole = state.belief.update(still, look.coefficients, share, passing, self.config.doubt)
            whole = whole.capped(self.config.surest, newest)
        found = _State(whole, look.stamp, state.position, newest)
        if self.config.switch_at == 0 or self.config.decode == "mean":
            return found
        return replace(found, named=held(found.reading, state.named, self.config.switch_at))

    def _blank(self, position: np.ndarray | None) -> Belief | RangedBelief | StillOrMoving:
        if position is None or self.config.ranges is None:
            still = Belief.uniform(self.config.degree)
        else:
            still = RangedBelief.uniform(self.config.degree, np.asarray(self.config.ranges))
            still = replace(still, prior=self._prior(position))
        return StillOrMoving.uniform(still) if self.config.wander > 0 else still

    def _prior(self, position: np.ndarray | None) -> np.ndarray | None:
        """What the camera's height above the floor says, where both are known."""
        if self.config.floor is None or position is None or self.config.ranges is None:
            return None
        height = float(position[2]) - self.config.floor
        if height <= 0:
            raise PoseError(
                f"the camera is at z = {position[2]:.3f} m, and TrackerConfig.floor = {self.config.floor:g} m is not "
                "below it; give the floor's z in the odometry's world, or None if it is not known"
            )
        # To the centimetre: a walking camera bobs, and the prior is kept for each height.
        return _height_prior(self.config.degree, tuple(self.config.ranges), round(height, 2))

    def _moved(self, state: _State, stamp: float, position: np.ndarray | None) -> _State:
        """The state carried to a later time and another place: parallax, forgetting, diffusion."""
        still, elapsed = standing(state.belief), stamp - state.stamp
        moved = None if position is None or state.position is None else position - state.position
        if elapsed == 0 and (moved is None or not moved.any()):
            return state
        if isinstance(still, RangedBelief) and moved is not None:
            still = replace(still.predict(np.eye(3), moved), prior=self._prior(position))
        keep = self.config.keep_per_second**elapsed
        stays = keep
        if isinstance(state.belief, StillOrMoving):
            stays *= state.belief.fading(elapsed, self.config.settle)
        if stays < 1:
            still = still.forget(stays)
        if self.config.diffusion > 0:
            still = still.diffuse(self.config.diffusion * math.sqrt(elapsed))
        whole = still
        if isinstance(state.belief, StillOrMoving):
            whole = state.belief.after(still, elapsed, self.config.wander, self.config.restless, keep)
        newest = state.newest
        if newest is not None:
            newest = keep * (self._carried(newest, moved) if isinstance(still, RangedBelief) else newest)
        return _State(whole, stamp, position if position is not None else state.position, newest, state.named)

    def _carried(self, newest: np.ndarray, moved: np.ndarray | None) -> np.ndarray:
        """The newest look's passing part after a step: what lies near moves more than what lies far."""
        if moved is None or not moved.any():
            return newest
        ranges = np.asarray(self.config.ranges)
        shells = np.broadcast_to(newest, (len(ranges), newest.shape[-1])).copy()
        return RangedBelief(shells, ranges).predict(np.eye(3), moved).shells

    def _advanced(self, target: str, now: float) -> _State:
        state = self._states.get(target)
        _, position = self._poses.at(now)
        if state is None:
            return _State(self._blank(position), now, position)
        if now < state.stamp:
            raise TimeError(
                f"asked for t = {now:.6f} s, but evidence up to {state.stamp:.6f} s is already in; "
                "ask for that time or later"
            )
        return self._moved(state, now, position)


@lru_cache(maxsize=64)
def _height_prior(degree: int, ranges: tuple[float, ...], height: float) -> np.ndarray:
    found = height_prior(degree, np.array(ranges), height)
    found.setflags(write=False)
    return found
