"""The belief about one target right after a look: it carries itself to another time and place, and takes in a look."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eagor.belief.ranged import RangedBelief
from eagor.evidence.detector import Alarms
from eagor.tracking.cases import Cases
from eagor.tracking.config import TrackerConfig
from eagor.tracking.look import Look, Sight
from eagor.tracking.standing import Standing


@dataclass(frozen=True, eq=False)
class State:
    """What is believed of a target right after the look at `stamp`, seen from `position` ``(3,)``; world axes.

    `look`: that look, of which the next one may repeat a part; `alarms`: the number of false alarms, where it is
    learnt.
    """

    stamp: float
    position: np.ndarray | None
    cases: Cases
    look: Look | None = None
    alarms: Alarms | None = None

    @classmethod
    def blank(cls, config: TrackerConfig, stamp: float, position: np.ndarray | None) -> State:
        """Before any look."""
        standing = Standing.uniform(config.degree, config.shells(position), config.above_floor(position))
        return cls(stamp, position, Cases.prior(config.target_motion, standing))

    def at(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> State:
        """Carried to a later time and another place; `stamp` is still the look's."""
        return replace(self, cases=self._carried(now, position, config))

    def after(self, sight: Sight, config: TrackerConfig) -> State:
        """After one more look."""
        cases, since = self._carried(sight.stamp, sight.position, config), None
        if self.look is not None and sight.position is not None and self.position is not None:
            since = sight.position - self.position
        cases, look, alarms = cases.updated(sight, self.alarms, self.look, since)
        position = self.position if sight.position is None else sight.position
        return State(sight.stamp, position, cases, look, alarms)

    def _carried(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> Cases:
        """The cases at a later time, seen from another place."""
        cases, height = self.cases, config.above_floor(position)
        ranges = config.shells(position)
        if ranges is not None and not isinstance(cases.standing.coarse, RangedBelief):  # positions known from here on
            cases = replace(cases, standing=cases.standing.ranged(ranges, height))
        step = None if position is None or self.position is None else position - self.position
        return cases.after(now - self.stamp, config.target_motion, config.drift, step, height)
