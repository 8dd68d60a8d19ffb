"""Following targets over time: poses at one rate, evidence at another, late or out of order, answers whenever asked.

The belief is kept in the axes of the odometry's world, so that turning the camera costs nothing and loses nothing:
evidence is turned once, from the body at the time of CAPTURE, and an answer is turned into the body at the time of the
question. Evidence is kept in the order of its capture for as long as the history reaches; what comes late takes its
place there, and the belief is carried forward from it again when the next answer is asked for.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field, replace

import numpy as np

from eagor.cases import Cases
from eagor.detector import Rates
from eagor.errors import EagorError, PoseError, TimeError
from eagor.estimate import Answer, Estimate, TrackerConfig, chosen
from eagor.evidence import Evidence
from eagor.looks import Look, Sight
from eagor.poses import PoseHistory
from eagor.ranged import RangedBelief
from eagor.standing import Standing

SAME_MOMENT = 1e-3  # seconds: stamps no further apart are of one moment
PENDING = 64  # looks that may wait for the next answer; more are taken in at once


@dataclass(frozen=True, eq=False)
class _State:
    """What is believed of a target right after a look, about the place where the body was then."""

    stamp: float
    position: np.ndarray | None
    cases: Cases
    look: Look | None = None
    rates: Rates | None = None
    answer: Answer | None = None


@dataclass(eq=False)
class _Moment:
    """Evidence of one moment, and where it was taken from; `firm` once a pose that covers it is known."""

    stamp: float
    looks: list[Evidence]
    world_R_body: np.ndarray
    position: np.ndarray | None
    firm: bool
    state: _State | None = None  # after it, once it is taken in


@dataclass(eq=False)
class _Track:
    """The moments of one target by rising stamp, and the state before the first of them (None: nothing known)."""

    moments: list[_Moment] = field(default_factory=list)
    base: _State | None = None
    trimmed: bool = False

    def forget_from(self, place: int) -> None:
        """The states from here on are to be made anew."""
        for moment in self.moments[place:]:
            moment.state = None


class DirectionTracker:
    """Follows any number of targets from stamped poses and stamped evidence.

    Call `rotate` for every pose of the odometry, `observe` for every evidence as it arrives, `estimate` whenever an
    answer is wanted. Stamps are seconds on one clock. Without any pose the camera is taken to stand still.
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._poses = PoseHistory(self.config.history)
        self._tracks: dict[str, _Track] = {}

    def __repr__(self) -> str:
        return f"DirectionTracker({len(self._poses)} poses, targets: {', '.join(self._tracks) or 'none yet'})"

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that have had evidence."""
        return tuple(self._tracks)

    def rotate(self, stamp: float, world_R_body: np.ndarray, position: np.ndarray | None = None) -> None:
        """A pose of the body: orientation ``(3, 3)``, and `position` ``(3,)`` in metres of the world where known.

        Raises `TimeError` if `stamp` lies before the pose before it, `RotationError` for what is no rotation,
        `PoseError` for a position that is not three finite numbers or that is missing after earlier ones were given, or
        if the camera is not above the floor.
        """
        if position is not None:
            self._check_height(np.asarray(position, dtype=np.float64).reshape(-1))
        self._poses.add(stamp, world_R_body, position)
        for track in self._tracks.values():
            self._place_again(track)

    def observe(self, evidence: Evidence, target: str = "target") -> None:
        """Add evidence about `target`, placed by its time of capture; it may be late and out of order.

        Evidence of one moment (views of one panorama) is one look. A look that is newer than the last pose is placed by
        that pose until one comes that covers it. Raises `TimeError` without a stamp, or if it is older than the
        history, and `PoseError` if no pose of that time is known any more.
        """
        if evidence.stamp is None:
            raise TimeError(
                "the evidence has no time stamp; pass stamp=... (time of capture, seconds) where it is made"
            )
        stamp = evidence.stamp
        if evidence.detections is not None and self.config.detector is not None:
            evidence = evidence.with_detector(self.config.detector)
        elif self.config.calibration is not None:
            evidence = evidence.with_calibration(self.config.calibration)
        track = self._tracks.get(target) or _Track()
        place = bisect.bisect_left([moment.stamp for moment in track.moments], stamp - SAME_MOMENT)
        if place < len(track.moments) and track.moments[place].stamp <= stamp + SAME_MOMENT:
            track.moments[place].looks.append(evidence)
        else:
            if track.trimmed and track.base is not None and stamp < track.base.stamp:
                raise TimeError(
                    f"evidence of t = {stamp:.3f} s is older than the history, which starts at "
                    f"{track.base.stamp:.3f} s; raise TrackerConfig.history (now {self.config.history:g} s) or drop it"
                )
            pose, position = self._poses.at(stamp)
            track.moments.insert(place, _Moment(stamp, [evidence], pose, position, self._poses.covers(stamp)))
        track.forget_from(place)
        self._tracks[target] = track
        if sum(moment.state is None for moment in track.moments[-PENDING - 1 :]) > PENDING:
            self._take_in(track)

    def estimate(self, now: float, target: str = "target") -> Estimate:
        """The answer at time `now`, in the body frame of that time (the last known pose is held beyond its stamp).

        Raises `TimeError` if `now` lies before the newest evidence, `PoseError` if it lies before all known poses, and
        `EagorError` for a target without evidence while others have some: a name that is mistyped.
        """
        pose, position = self._poses.at(now)
        track = self._tracks.get(target)
        if track is None:
            if self._tracks and target != "target":
                raise EagorError(
                    f"there is no evidence about {target!r}; there is about {', '.join(map(repr, self._tracks))}"
                )
            return Estimate(now, math.inf, self._blank(position), pose, self.config)
        newest = track.moments[-1].stamp if track.moments else track.base.stamp  # type: ignore[union-attr]
        if now < newest:
            raise TimeError(
                f"asked for t = {now:.6f} s, but evidence up to {newest:.6f} s is already in; "
                "ask for that time or later"
            )
        state = self._take_in(track)
        cases = self._advanced(state, now, position)
        answer = state.answer
        if cases is not state.cases and self.config.decode == "mode":
            answer = chosen(cases.reading, state.answer, state.look.sight.repeats if state.look else 0.0)
        return Estimate(now, now - state.stamp, cases, pose, self.config, answer, state.rates)

    def _place_again(self, track: _Track) -> None:
        """Place looks that came before their pose, now that there is a newer one."""
        for index, moment in enumerate(track.moments):
            if moment.firm:
                continue
            pose, position = self._poses.at(max(moment.stamp, self._poses.first))
            moment.world_R_body, moment.position = pose, position
            moment.firm = self._poses.covers(moment.stamp)
            track.forget_from(index)

    def _take_in(self, track: _Track) -> _State:
        """The state after the newest look."""
        state = track.base
        for moment in track.moments:
            if moment.state is None:
                moment.state = self._added(state, moment)
            state = moment.state
        assert state is not None
        # One that still waits for its pose by now waits no longer: no memory is endless.
        old = sum(moment.stamp < state.stamp - self.config.history for moment in track.moments[:-1])
        if old:
            track.base, track.trimmed = track.moments[old - 1].state, True
            del track.moments[:old]
        return state

    def _added(self, state: _State | None, moment: _Moment) -> _State:
        """The state after one more look."""
        stamp, position = moment.stamp, moment.position
        sight = Sight.of(moment.looks, self.config.degree, stamp, moment.world_R_body, position)
        if state is None:
            cases, passing, since, rates, before = self._blank(position), None, None, None, None
        else:
            cases = self._advanced(state, stamp, position)
            passing, rates, before = state.look, state.rates, state.answer
            known = position is not None and state.position is not None
            since = position - state.position if known else None  # type: ignore[operator]
        cases, look, rates = cases.updated(sight, rates, passing, since)
        if position is None and state is not None:
            position = state.position
        answer = None if self.config.decode == "mean" else chosen(cases.reading, before, sight.repeats)
        return _State(stamp, position, cases, look, rates, answer)

    def _advanced(self, state: _State, now: float, position: np.ndarray | None) -> Cases:
        """The cases carried to a later time and another place."""
        cases, height = state.cases, self._height(position)
        step = None
        if position is not None and self.config.ranges is not None:
            if not isinstance(cases.standing.coarse, RangedBelief):  # positions are known from here on
                ranges = np.asarray(self.config.ranges, dtype=np.float64)
                cases = replace(cases, standing=cases.standing.ranged(ranges, height))
            if state.position is not None:
                step = position - state.position
        return cases.after(now - state.stamp, self.config.motion, self.config.drift, step, height)

    def _blank(self, position: np.ndarray | None) -> Cases:
        ranges = None
        if position is not None and self.config.ranges is not None:
            ranges = np.asarray(self.config.ranges, dtype=np.float64)
        standing = Standing.uniform(self.config.degree, ranges, self._height(position))
        return Cases.prior(self.config.motion, standing)

    def _height(self, position: np.ndarray | None) -> float | None:
        """Of the camera above the floor, where both are known; to the centimetre, since a walking camera bobs."""
        if self.config.floor is None or position is None:
            return None
        return round(float(position[2]) - self.config.floor, 2)

    def _check_height(self, position: np.ndarray) -> None:
        if self.config.floor is not None and len(position) == 3 and not position[2] - self.config.floor >= 0.01:
            raise PoseError(
                f"the camera is at z = {position[2]:.3f} m, and TrackerConfig.floor = {self.config.floor:g} m is not "
                "below it; give the floor's z in the odometry's world, or None if it is not known"
            )
