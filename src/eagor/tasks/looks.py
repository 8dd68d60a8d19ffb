"""What the next look is expected to tell about where a thing is: one measure for every search.

The thing is in one of many cells: directions around a camera that only turns (`eagor.tasks.hstar.search`), patches of
ground around a body (`eagor.tasks.searched_ground`). Either is a `Space`. A search takes the look that tells most for
what it costs (`eagor.tasks.searcher`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eagor.evidence import Evidence
from eagor.evidence.detector import Habits
from eagor.sphere import wrap

LEAST = 0.05  # recall: nobody looks with what finds less, whatever its calibration says


@dataclass(frozen=True)
class Chance:
    """What chance a look has to find what is in sight.

    `recall`: the probability that it reports it. `repeats`: the share of the mistakes of the look before that it
    repeats, which was taken `elapsed` seconds earlier: what was overlooked there is overlooked again. `habits`: of the
    detector, which fade with time and distance; None: nothing fades.
    """

    recall: float = 0.5
    repeats: float = 0.0
    habits: Habits | None = None
    elapsed: float = 0.0

    @classmethod
    def of(cls, evidence: Evidence, elapsed: float) -> Chance:
        """As the evidence itself has it, but `LEAST` at least.

        A detector's model states the recall, or a prior of it. Of a response, 1 - recall is the likelihood ratio where
        it reports nothing, which is most of what it covers. If that is 1 or more, silence says nothing.
        """
        if evidence.detections is not None:
            habits = evidence.detections.model.habits
            return cls(max(habits.mean, LEAST), habits.correlation, habits, elapsed)
        logs = np.asarray(evidence.log_ratio, dtype=np.float64)
        logs = logs if evidence.coverage is None else logs[evidence.coverage > 0.5]
        recall = -float(np.expm1(np.median(logs))) if logs.size else 0.0
        return cls(max(recall, LEAST), evidence.calibration.persistence, None, elapsed)

    def left(self, moved: float) -> float:
        """The share of the habits of places that is still the same `moved` metres after the look before."""
        return 1.0 if self.habits is None else 1 - self.habits.anew(self.elapsed, moved)


class Space(Protocol):
    """What a camera can look at from where it is, and what it has looked at so far."""

    @property
    def headings(self) -> np.ndarray:
        """The headings ``(n, 2)`` that it may face: azimuth and elevation, radians, world frame."""
        ...

    def tells(self) -> np.ndarray:
        """What a look at each of the headings ``(n,)`` is expected to tell about where the thing is, nats."""
        ...


def apart(angles: np.ndarray) -> np.ndarray:
    """The size of angles ``(...)``, the short way round, radians from 0 to pi."""
    return np.abs(wrap(angles))


def turned(headings: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """How far it is from `facing` ``(2,)`` to headings ``(..., 2)``, radians: in azimuth, and then in elevation."""
    return apart(headings[..., 0] - facing[0]) + np.abs(headings[..., 1] - facing[1])


def information(here: np.ndarray, share: np.ndarray, alarm: float = 0.0, falls: np.ndarray | None = None) -> np.ndarray:
    """Mutual information ``(n,)``, nats, of the outcome of each of n looks and the thing's cell.

    `here` ``(n, k)``: probability that the thing is in each of the k cells that a look shows; the rest is elsewhere.
    `share` ``(n, k)``: probability that the look reports it, if it is there. `alarm`: probability of a false report
    where there is no true one, which falls on the cells with the probabilities `falls` ``(k,)``, all above 0.

    The outcome is a report in one of the cells, or none: I = H(outcome) - sum_i p_i H(outcome | thing in cell i).
    """
    there = here * share
    reported = there.sum(axis=1, keepdims=True)
    silent = (1 - reported[:, 0]) * (1 - alarm)
    if not alarm or falls is None:
        given = -_xlog(1 - share) - _xlog(share)
        return -_xlog(there).sum(axis=1) - _xlog(silent) - (here * given).sum(axis=1)
    even = np.log(falls)
    there = there + (1 - reported) * alarm * falls
    outcome = -_xlog(there).sum(axis=1) - _xlog(silent)
    spread = -float((falls * even).sum())  # entropy of a false report's place

    def without(left: np.ndarray) -> np.ndarray:
        """Entropy of the outcome without a true report, which has the probability `left`: no report, or a false one."""
        return -_xlog(left * (1 - alarm)) - _xlog(left * alarm) + left * alarm * spread

    false = (1 - share) * alarm * falls[None]  # in the cell of the true report
    given = without(1 - share) + (-_xlog(share + false) + _xlog(false))
    out = 1.0 - here.sum(axis=1)
    return outcome - (here * given).sum(axis=1) - out * float(without(np.ones(1))[0])


def _xlog(x: np.ndarray) -> np.ndarray:
    return x * np.log(np.maximum(x, 1e-300))
