"""How a Go2 answers commands: a body on the floor, in steps of fixed length, without any clock or wire.

Forward, sideways and turning speed follow the command as first-order systems with dead time; gains and times were
fitted to a real Go2 (dimos, `go2_posedomain.json`, on concrete, June 2026). The rest is what users of real ones report:
a Move holds for a second, a robot that has just stood up heeds none for a while, and needs BalanceStand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eagor.sources import Pose

__all__ = ["GRAVITY", "HEIGHT", "LIMP", "LYING", "STANDING", "STEP", "WALKING", "BodyState", "Plant", "Slide"]

Slide = Callable[[np.ndarray, np.ndarray], np.ndarray]  # start (2,), step (2,) -> end (2,), metres
STANDING, WALKING, LYING, LOCKED, LIMP = 1, 3, 5, 6, 7  # numbers of `eagor.robots.go2.state.MODES`
READY, LOW = (STANDING, WALKING), (LYING, LIMP)
STEP = 0.005  # seconds
GAIN = (0.80, 0.74, 0.90)  # speed reached per speed commanded: forward, left, turning
LAG, DEAD_TIME = 0.30, 0.15  # seconds to 63 % of a speed; before anything happens
FASTEST = np.array([2.5, 1.0, 4.0])  # m/s, m/s, rad/s: commands beyond are cut
EXPIRY = 1.0  # seconds for which a Move holds
DEAF = (4.0, 10.0)  # from and to how many seconds after StandUp Moves are ignored
MOVING = 0.02  # metres or radians per second below which the legs stand still
TILT, TROT = math.radians(2.0), 3.0  # radians by which it rocks while walking, and times per second
HEIGHT, LYING_HEIGHT = 0.32, 0.08  # metres
GRAVITY = 9.81  # m/s^2
# Odometry, standard deviations: shares by which distances and turns are wrong; radians of heading after one metre,
# which grow with the root of the way.
SCALE_DRIFT, TURN_DRIFT, YAW_DRIFT = 0.02, 0.01, math.radians(0.5)


class BodyState(NamedTuple):
    """The body at one step: `pose`, and the same as roll, pitch and yaw; m/s (world), rad/s (body); `mode`."""

    pose: Pose
    rpy: tuple[float, float, float]
    velocity: np.ndarray
    rates: np.ndarray
    yaw_rate: float
    mode: int


class Plant:
    """A Go2's body. `rng` draws drift and how long it is deaf; `start`: x, y (metres) and heading (radians, left).

    `slide(start, step)` gives where a step over the floor ends, at walls; without it the floor has no end. `upright`:
    whether it stands ready to walk at first, or lies.
    """

    def __init__(
        self, rng: np.random.Generator, start: tuple[float, float, float] = (0.0, 0.0, 0.0), slide: Slide = np.add,
        upright: bool = True,
    ) -> None:  # fmt: skip
        self._rng, self._slide, self.mode = rng, slide, STANDING if upright else LYING
        self.steps, self.walked = 0, 0.0
        self._xy, self._yaw = np.array(start[:2], dtype=np.float64), float(start[2])
        self._speed = np.zeros(3)  # forward, left, turning; body frame
        self._velocity = np.zeros(2)  # of the last step, world frame
        self._wanted, self._until, self._deaf_until = np.zeros(3), 0, 0  # command; steps at which it, and that, ends
        self._pipe = deque([np.zeros(3)] * round(DEAD_TIME / STEP))
        self._phase, self._rocking = 0.0, 0.0  # of the trot; 0 standing, 1 walking
        self._attitude, self._rates = _turned(0.0, 0.0, self._yaw), np.zeros(3)
        # Odometry: where the robot believes it is.
        self._scale = 1.0 + SCALE_DRIFT * float(rng.standard_normal())
        self._turn_scale = 1.0 + TURN_DRIFT * float(rng.standard_normal())
        self._believed_xy, self._believed_yaw = self._xy, self._yaw

    @property
    def seconds(self) -> float:
        return self.steps * STEP

    # --- commands, by their names in Unitree's SDK ---

    def move(self, vx: float, vy: float, wz: float) -> None:
        """Heeded only by a robot that stands ready."""
        if self.mode in READY and self.steps >= self._deaf_until:
            self._wanted = np.clip([vx, vy, wz], -FASTEST, FASTEST)
            self._until = self.steps + round(EXPIRY / STEP)

    def stop_move(self) -> None:
        self._until = self.steps

    def stand_up(self) -> None:
        """Stand with locked joints, deaf to Moves for a while."""
        self.rest(LOCKED)
        self._deaf_until = self.steps + round(float(self._rng.uniform(*DEAF)) / STEP)

    def balance_stand(self) -> None:
        """Unlock the joints: ready to walk (once it is no longer deaf)."""
        if self.mode not in LOW:
            self.rest(STANDING)

    def recovery_stand(self) -> None:
        """From anything to standing, ready to walk once it is no longer deaf."""
        self.stand_up()
        self.balance_stand()

    def rest(self, mode: int) -> None:
        """Damp (`LIMP`: all joints go, and the body sinks to the floor) or StandDown (`LYING`)."""
        self.stop_move()
        self.mode = mode

    # --- time ---

    def advance(self) -> None:
        self._pipe.append(self._wanted if self.steps < self._until else np.zeros(3))
        command = self._pipe.popleft() * GAIN * (self.mode in READY)
        # Exact for a command that is constant over the step.
        self._speed = command + math.exp(-STEP / LAG) * (self._speed - command)
        if self.mode in LOW:
            self._speed = np.zeros(3)
        turned = float(self._speed[2]) * STEP
        end = self._slide(self._xy, _along(self._yaw + turned / 2, self._speed[:2] * STEP))
        done = end - self._xy
        way = float(np.hypot(*done))
        # What the robot believes of that: the step in body axes, with errors of scale and heading.
        self._believed_xy = self._believed_xy + _along(self._believed_yaw - self._yaw, done * self._scale)
        slip = YAW_DRIFT * math.sqrt(way) * float(self._rng.standard_normal()) if way > 0 else 0.0
        self._believed_yaw += turned * self._turn_scale + slip
        self._xy, self._yaw = end, self._yaw + turned
        self._velocity = done / STEP
        self.walked += way
        # It rocks from side to side and to and fro while the legs move, and fades in and out as the speed does.
        moving = bool((np.abs(self._speed) > MOVING).any())
        if self.mode in READY:
            self.mode = WALKING if moving or self.steps < self._until else STANDING
        self._rocking += (float(moving) - self._rocking) * (1.0 - math.exp(-STEP / LAG))
        self._phase += 2 * math.pi * TROT * STEP
        before, self._attitude = self._attitude, _turned(*self._leaning(self._yaw))
        # For the small turn of one step the antisymmetric part is the rotation vector (to 1e-6 of it).
        turn = before.T @ self._attitude - self._attitude.T @ before
        self._rates = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / (2 * STEP)
        self.steps += 1

    def _leaning(self, yaw: float) -> tuple[float, float, float]:
        lean = TILT * self._rocking
        return lean * math.sin(self._phase), lean * math.sin(self._phase + 1.0), yaw

    # --- what is so, and what the robot believes of it ---

    @property
    def truth(self) -> BodyState:
        return self._motion(self._xy, self._yaw, self._velocity)

    @property
    def odometry(self) -> BodyState:
        speed = _along(self._believed_yaw - self._yaw, self._velocity * self._scale)
        return self._motion(self._believed_xy, self._believed_yaw, speed)

    def _motion(self, xy: np.ndarray, yaw: float, velocity: np.ndarray) -> BodyState:
        rpy, height = self._leaning(yaw), LYING_HEIGHT if self.mode in LOW else HEIGHT
        pose = Pose(self.seconds, _turned(*rpy), np.array([*xy, height]))
        return BodyState(pose, rpy, np.array([*velocity, 0.0]), self._rates, float(self._speed[2]), self.mode)


def _along(heading: float, step: np.ndarray) -> np.ndarray:
    """A step ``(2,)`` forward and left, of a body with this heading."""
    c, s = math.cos(heading), math.sin(heading)
    forward, left = step
    return np.array([c * forward - s * left, s * forward + c * left])


def _turned(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """As `eagor.sphere.world_R_body`, multiplied out: it is needed 400 times per second."""
    a, b, c = math.cos(roll), math.cos(pitch), math.cos(yaw)
    x, y, z = math.sin(roll), math.sin(pitch), math.sin(yaw)
    rows = [c * b, c * y * x - z * a, c * y * a + z * x], [z * b, z * y * x + c * a, z * y * a - c * x]
    return np.array([*rows, [-y, b * x, b * a]])
