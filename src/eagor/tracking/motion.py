"""How targets come, go and move: rates that can be counted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eagor._arrays import frozen
from eagor._checks import require, within
from eagor._lazy import lazy

__all__ = ["MotionModel"]

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
        """Targets that appear and disappear, but never move."""
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
        """Probabilities ``(2 + M, 2 + M)`` of going from case to case in `elapsed` seconds.

        The cases: absent, standing, and each of the `kinds`. There are no transitions among the kinds.
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
