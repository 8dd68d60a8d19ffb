"""What a tracker keeps of one target: its looks in order of capture, and the beliefs after some of them.

Memory is bounded. Looks older than the history, or beyond `MOMENTS`, are folded into the state before the first look
that is kept; their evidence is not lost, but nothing can be inserted before them. States are kept after the newest
looks and after every `APART`-th of the others, so that a late look recomputes only a few.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field

import numpy as np

from eagor._values import altered, bare
from eagor.belief.ranged import RangedBelief
from eagor.errors import TimeError
from eagor.evidence.detector import ClutterRate
from eagor.evidence.evidence import Evidence
from eagor.tracking.config import TrackerConfig
from eagor.tracking.imm import TargetHypotheses
from eagor.tracking.poses import HELD
from eagor.tracking.scan import Measurement, Scan
from eagor.tracking.stationary import StationaryTarget


@dataclass(frozen=True, eq=False)
class State:
    """What is believed of a target right after the look at `stamp`, seen from `position` ``(3,)``; world axes.

    `look`: that look, of which the next one may repeat a part; `alarms`: the number of false alarms, where it is
    learnt.
    """

    stamp: float
    position: np.ndarray | None
    hypotheses: TargetHypotheses
    look: Measurement | None = None
    alarms: ClutterRate | None = None

    @classmethod
    def blank(cls, config: TrackerConfig, stamp: float, position: np.ndarray | None) -> State:
        """Before any look."""
        standing = StationaryTarget.uniform(config.degree, config.shells(position), config.above_floor(position))
        return cls(stamp, position, TargetHypotheses.prior(config.target_motion, standing, drift=config.drift))

    def at(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> State:
        """Carried to a later time and another place; `stamp` is still the look's."""
        return altered(self, hypotheses=self._carried(now, position, config))

    def after(self, scan: Scan, config: TrackerConfig) -> State:
        """After one more look."""
        hypotheses, since = self._carried(scan.stamp, scan.position, config), None
        if self.look is not None and scan.position is not None and self.position is not None:
            since = scan.position - self.position
        hypotheses, look, alarms = hypotheses.updated(scan, self.alarms, self.look, since)
        position = self.position if scan.position is None else scan.position
        return State(scan.stamp, position, hypotheses, look, alarms)

    def _carried(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> TargetHypotheses:
        """The hypotheses at a later time, seen from another place."""
        hypotheses, height = self.hypotheses, config.above_floor(position)
        ranges = config.shells(position)
        if ranges is not None and not isinstance(hypotheses.standing.coarse, RangedBelief):
            # Positions are known from here on.
            hypotheses = hypotheses.ranged(ranges, height)
        step = None if position is None or self.position is None else position - self.position
        return hypotheses.after(now - self.stamp, config.target_motion, step, height)


SAME_MOMENT = 1e-3  # seconds: stamps this close are one moment
PENDING = 64  # looks that may wait for the next answer; with more, all are processed at once
MOMENTS = 128  # most moments per target
VIEWS = 64  # of one moment
NEWEST, APART = 3, 8  # moments whose states are kept


@dataclass(eq=False)
class PosedEvidence:
    """Evidence of one moment and its pose; `firm` once a pose at or after it is known.

    `turning`: radians per second at which the body turned then. `bare`: its state has no cached values.
    """

    stamp: float
    looks: list[Evidence]
    world_R_body: np.ndarray
    position: np.ndarray | None
    firm: bool
    turning: float = 0.0
    state: State | None = None  # after it, once it is taken in, and while it is kept
    bare: bool = False

    def scan(self, config: TrackerConfig) -> Scan:
        """All of its evidence as one look."""
        error = math.hypot(config.pose_error, config.clock_error * self.turning)
        return Scan.of(self.looks, config.degree, self.stamp, self.world_R_body, self.position, error)


@dataclass(eq=False)
class Track:
    """The moments of one target by rising stamp, and the state `base` before them (None: uniform).

    `trimmed`: whether moments were folded into `base`; `used`: counter value at the last use of the target;
    `looked_for`: as its looks say.
    """

    moments: list[PosedEvidence] = field(default_factory=list)
    base: State | None = None
    trimmed: bool = False
    used: int = 0
    looked_for: str = ""

    def copied(self) -> Track:
        """A copy with its own moments."""
        return altered(self, moments=[altered(moment, looks=moment.looks.copy()) for moment in self.moments])

    @property
    def newest(self) -> float | None:
        """The stamp of the newest look, None without any."""
        if self.moments:
            return self.moments[-1].stamp
        return None if self.base is None else self.base.stamp

    @property
    def taken_in(self) -> int:
        """How many moments are processed."""
        return next((i + 1 for i in reversed(range(len(self.moments))) if self.moments[i].state is not None), 0)

    def place_of(self, stamp: float) -> tuple[int, PosedEvidence | None]:
        """The index where evidence of this time belongs, and its moment if there is one already.

        Raises `TimeError` if it is older than all that is kept, or if its moment is full.
        """
        place = bisect.bisect_left([moment.stamp for moment in self.moments], stamp - SAME_MOMENT)
        if place < len(self.moments) and self.moments[place].stamp <= stamp + SAME_MOMENT:
            moment = self.moments[place]
            if len(moment.looks) >= VIEWS:
                raise TimeError(
                    f"{VIEWS} looks of t = {stamp:.3f} s are in already, as many as one moment may have; give each "
                    "look its own time of capture"
                )
            return place, moment
        if self.trimmed and self.base is not None and stamp < self.base.stamp:
            raise TimeError(
                f"evidence of t = {stamp:.3f} s is older than the history, which starts at {self.base.stamp:.3f} s; "
                f"raise TrackerConfig.history, which keeps at most {MOMENTS} looks, or drop it"
            )
        return place, None

    def forget_from(self, place: int) -> None:
        """Drop the states from here on."""
        for moment in self.moments[place:]:
            moment.state, moment.bare = None, False

    def cut(self, last: float, until: float) -> None:
        """Drop looks later than `until`; looks later than the pose at `last` wait for their pose again.

        If the state before the first look is later too, it is dropped as well.
        """
        if self.base is not None and self.base.stamp > until:
            self.base, self.trimmed = None, False
        for place in reversed(range(len(self.moments))):
            moment = self.moments[place]
            if moment.stamp <= last:
                break
            moment.firm = False
            if moment.stamp > until:
                del self.moments[place]

    def state(self, config: TrackerConfig) -> State | None:
        """The state after the newest look, once all looks are taken in; None without looks."""
        known = self.taken_in
        state = self.moments[known - 1].state if known else self.base
        for place in range(known, len(self.moments)):
            moment = self.moments[place]
            before = state or State.blank(config, moment.stamp, moment.position)
            state = moment.state = before.after(moment.scan(config), config)
            if place >= NEWEST:
                self._thin(place - NEWEST)
        self._fold(config.history)
        return state

    def _thin(self, place: int) -> None:
        """Keep the state only if none of the `APART` before it is kept, and then without cached values."""
        moment = self.moments[place]
        if moment.state is None or moment.bare:
            return
        moment.bare = all(near.state is None for near in self.moments[max(0, place - APART + 1) : place])
        # Cached values are most of the memory.
        moment.state = bare(moment.state) if moment.bare else None

    def _fold(self, history: float) -> None:
        """Fold moments that are too old or too many into `base`."""
        old = len(self.moments) - MOMENTS
        # A moment that still waits for its pose is folded too: memory is bounded.
        awake = 0.0
        for place in reversed(range(1, len(self.moments))):
            silence = self.moments[place].stamp - self.moments[place - 1].stamp
            awake += silence if silence <= HELD else 0.0  # as long as poses are kept
            if awake > history:
                old = max(old, place)
                break
        while old > 0 and self.moments[old - 1].state is None:
            old -= 1
        if old > 0:
            self.base, self.trimmed = self.moments[old - 1].state, True
            del self.moments[:old]
