"""How the body of a walk moves: as the person says, or step by step as the policy says."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from eagor.sphere import azimuth_elevation, world_R_body
from eagor.studio.messages import LATE
from eagor.tasks.policy import Policy
from eagor.tasks.rules import Camera
from eagor.worlds.walkable import Walkable

__all__ = ["Body", "Walker"]

SPEED, TURN = 0.5, math.radians(75)  # metres and radians per second, of the policy
FASTEST, QUICKEST = 1.2, math.radians(150)  # of the person


@dataclass
class Body:
    """A round body with a camera on the ground of a house; x, y in metres, yaw in radians."""

    ground: Walkable
    xy: np.ndarray
    yaw: float
    height: float = Camera().height
    walked: float = 0.0

    @property
    def position(self) -> np.ndarray:
        """The camera ``(3,)``, world frame."""
        return np.array([*self.xy, self.height + self.ground.height(self.xy)])

    @property
    def world_R_body(self) -> np.ndarray:
        return world_R_body(self.yaw)

    def advance(self, metres: float) -> None:
        """Go ahead (back, if negative), sliding along walls."""
        if metres == 0:
            return
        ahead = metres * np.array([math.cos(self.yaw), math.sin(self.yaw)])
        before = self.xy
        self.xy, _ = self.ground.move(self.xy, ahead)
        self.walked += float(np.hypot(*(self.xy - before)))


@dataclass
class Walker:
    """Moves a body: `by` the policy as time passes, or by the person, who says how."""

    body: Body
    by: str = "policy"
    policy: Policy = field(default_factory=lambda: Policy(Camera().step))
    _heading: float | None = None  # of the policy's step that is under way
    _left: float = 0.0  # metres of that step
    _stood: tuple[float, ...] = field(init=False)  # where it stood when it was last asked

    def __post_init__(self) -> None:
        self._stood = (*self.body.xy, self.body.yaw)

    def steer(self, forward: float, turn: float, seconds: float) -> None:
        """What the person has steered: m/s and rad/s (left), limited, and how long. The body stands without it."""
        if self.by == "person":
            self._turned(min(max(turn, -QUICKEST), QUICKEST) * seconds)
            self.body.advance(min(max(forward, -FASTEST), FASTEST) * seconds)

    def drive(self, by: str) -> None:
        """Hand over to "policy" or "person"."""
        if by != self.by:
            self.by, self._heading = by, None
            self.policy = Policy(self.policy.step)

    def move(self, seconds: float, direction: np.ndarray | None, arrived: bool) -> bool:
        """Let time pass; `direction` ``(3,)``: the estimate, body frame. Returns whether the body has moved since."""
        if self.by == "policy" and not arrived:
            self._walk(min(seconds, LATE), direction)
        before, self._stood = self._stood, (*self.body.xy, self.body.yaw)
        return before != self._stood

    def _walk(self, seconds: float, direction: np.ndarray | None) -> None:
        if direction is None:  # nothing is known: look around
            self._turned(TURN / 2 * seconds)
            return
        if self._heading is None:
            azimuth = float(azimuth_elevation(direction)[0])
            self._heading = self.body.yaw + self.policy.heading(azimuth, self.body.xy, self.body.yaw)
            self._left = self.policy.step
        off = math.remainder(self._heading - self.body.yaw, math.tau)
        turned = min(abs(off), TURN * seconds)
        self._turned(math.copysign(turned, off))
        rest = seconds - turned / TURN
        if rest > 0:
            metres = min(self._left, SPEED * rest)
            self.body.advance(metres)
            self._left -= metres
            if self._left <= 1e-9:
                self._heading = None

    def _turned(self, angle: float) -> None:
        self.body.yaw = math.remainder(self.body.yaw + angle, math.tau)
