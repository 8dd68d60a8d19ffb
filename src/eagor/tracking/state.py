"""The belief about one target right after a look: it carries itself to another time and place, and takes in a look.

The answer is decided here and nowhere else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor.belief.ranged import RangedBelief
from eagor.belief.reading import NEAR, Reading
from eagor.evidence.detector import Rates
from eagor.tracking.cases import Cases
from eagor.tracking.config import TrackerConfig
from eagor.tracking.look import Look, Sight
from eagor.tracking.standing import Standing

FLAT = 1e-6  # nats: a belief that varies by less has no direction


@dataclass(frozen=True, eq=False)
class Answer:
    """The answered direction ``(3,)``, world axes, and whether it is an older answer that is kept."""

    direction: np.ndarray
    held: bool = False


@dataclass(frozen=True, eq=False)
class State:
    """What is believed of a target right after the look at `stamp`, seen from `position` ``(3,)``; world axes.

    `look`: that look, of which the next one may repeat a part; `rates`: of the detector, where they are learnt;
    `answer`: None while nothing is known.
    """

    stamp: float
    position: np.ndarray | None
    cases: Cases
    look: Look | None = None
    rates: Rates | None = None
    answer: Answer | None = None

    @classmethod
    def blank(cls, config: TrackerConfig, stamp: float, position: np.ndarray | None) -> State:
        """Before any look."""
        standing = Standing.uniform(config.degree, config.shells(position), config.above_floor(position))
        return cls(stamp, position, Cases.prior(config.target_motion, standing))

    def at(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> State:
        """Carried to a later time and another place, with the answer that holds there; `stamp` is still the look's."""
        cases = self._carried(now, position, config)
        if cases is self.cases or config.answers.decode == "mean":
            return replace(self, cases=cases)
        repeats = self.look.sight.repeating.after(now - self.stamp) if self.look else 0.0
        return replace(self, cases=cases, answer=chosen(cases.reading, self.answer, repeats))

    def after(self, sight: Sight, config: TrackerConfig) -> State:
        """After one more look."""
        cases, since, moved = self._carried(sight.stamp, sight.position, config), None, 0.0
        if self.look is not None and sight.position is not None and self.position is not None:
            since = sight.position - self.position
            moved = float(np.linalg.norm(since))
        cases, look, rates = cases.updated(sight, self.rates, self.look, since)
        position = self.position if sight.position is None else sight.position
        answer = None
        if config.answers.decode == "mode":
            answer = chosen(cases.reading, self.answer, sight.repeating.after(sight.stamp - self.stamp, moved))
        return State(sight.stamp, position, cases, look, rates, answer)

    def _carried(self, now: float, position: np.ndarray | None, config: TrackerConfig) -> Cases:
        """The cases at a later time, seen from another place."""
        cases, height, step = self.cases, config.above_floor(position), None
        if (ranges := config.shells(position)) is not None:
            if not isinstance(cases.standing.coarse, RangedBelief):  # positions are known from here on
                cases = replace(cases, standing=cases.standing.ranged(ranges, height))
            if position is not None and self.position is not None:
                step = position - self.position
        return cases.after(now - self.stamp, config.target_motion, config.drift, step, height)


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
