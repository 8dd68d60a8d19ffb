"""From an estimate to a step: straight at it, and around what is in the way by touch alone.

The published policy goes a fixed step along the estimate, whatever happens. Among furniture that ends at the first
corner that sliding does not lead around, for any estimate, the true direction included. With `detour`, a body that does
not get on feels its way along the obstacle until the way to the estimate is open again: the Pledge algorithm (Abelson
and diSessa, Turtle Geometry, 1981), which needs no map: only the odometry of the last step, and the sum of all turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

BLOCKED, FREE = 0.35, 0.9  # shares of a step: less is a wall, more is open ground, between them the body slid
AWAY, BACK, ALONG = math.radians(45), math.radians(35), math.radians(15)  # turns from the wall, to it, and along it
JUMP = math.pi / 2  # an estimate that jumps by more is another one: what stood in its way is forgotten
SAME_PLACE = 0.5  # metres: whoever is blocked here again goes around the other way


@dataclass
class Policy:
    """Chooses headings for one episode. `step` in metres; `detour`: whether to feel the way around obstacles."""

    step: float
    detour: bool = True
    _last: tuple[np.ndarray, float] | None = None  # where the last step began, and the estimate's heading then (world)
    _offset: float | None = None  # while following an obstacle: heading minus the estimate's, all turns counted
    _side: int = 1  # 1: the obstacle is to the right, and turning away from it is turning left
    _hit: np.ndarray | None = None  # where the last obstacle was met

    def heading(self, azimuth: float, xy: np.ndarray, yaw: float) -> float:
        """The heading to go in, radians from straight ahead.

        `azimuth` of the estimate, radians, body frame; `xy` ``(2,)`` and `yaw`: the pose as the odometry has it.
        """
        if not self.detour:
            return azimuth
        goal = yaw + azimuth
        if self._last is not None:
            moved, turned = xy - self._last[0], math.remainder(goal - self._last[1], 2 * math.pi)
            self._follow(goal, turned, moved, xy)
        self._last = (np.array(xy), goal)
        return math.remainder(azimuth + (self._offset or 0.0), 2 * math.pi)

    def _follow(self, goal: float, turned: float, moved: np.ndarray, xy: np.ndarray) -> None:
        """Bring `_offset` up to date after a step; None where nothing is in the way."""
        share = float(np.hypot(*moved)) / self.step
        if abs(turned) > JUMP:
            self._offset = None
        elif self._offset is None:
            if share < BLOCKED:
                across = math.cos(goal) * moved[1] - math.sin(goal) * moved[0]
                again = self._hit is not None and np.hypot(*(xy - self._hit)) < SAME_PLACE
                slid = 1 if across >= 0 else -1
                self._side = -self._side if again else slid
                self._hit = np.array(xy)
                self._offset = self._side * math.pi / 2
        else:
            offset = self._offset - turned
            if share < BLOCKED:
                offset += self._side * AWAY
            elif share > FREE:
                offset -= self._side * BACK
            else:
                heading = math.atan2(moved[1], moved[0])
                offset += math.remainder(heading - goal - offset, 2 * math.pi) - self._side * ALONG
            self._offset = offset if self._side * offset > 0 else None
