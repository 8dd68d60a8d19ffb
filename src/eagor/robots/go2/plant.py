"""How a Go2 answers commands: a body on the floor and its legs, in steps of fixed length, without any clock or wire.

Forward, sideways and turning speed follow the command as first-order systems with dead time; gains and times were
fitted to a real Go2 (dimos, `go2_posedomain.json`, on concrete, June 2026). The rest is what users of real ones report:
a Move holds for a second, a robot that has just stood up heeds none for a while, and needs BalanceStand.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eagor._checks import require, stretch, within
from eagor.errors import DeviceError
from eagor.media import Pose

__all__ = ["JOINTS", "STANDING", "WALKING", "Ahead", "Motion", "Plant", "PlantSettings", "Slide", "joint_angles"]

LEGS = "FR", "FL", "RR", "RL"  # the order of the motors in ``LowState``: front right, front left, rear right, rear left
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
LINK = 0.213  # metres of thigh and calf alike (Unitree's description of the Go2)
CALF = -2.7227, -0.83776  # radians that the calf's joint can reach; the others' limits are not met here
AHEAD, ASIDE = 0.1934, 0.1420  # metres from the body's centre to the hips, forward and to the side of the feet
LIFT = 0.09  # metres by which a foot is lifted

Slide = Callable[[np.ndarray, np.ndarray], np.ndarray]  # start (2,), step (2,) -> end (2,), metres
Ahead = Callable[[np.ndarray, float], float]  # point (2,), heading in radians -> metres of free floor ahead
STANDING, WALKING, LYING, LOCKED, LIMP = 1, 3, 5, 6, 7  # numbers of `eagor.robots.go2.state.MODES`
GRAVITY = 9.81  # m/s^2
MOVING = 0.02  # metres or radians per second below which the legs stand still
BERTH = 0.35  # metres that a careful body keeps from what it would run into
BRAKING = 1.0  # seconds in which a careful body would reach that distance, at most


def joint_angles(
    height: float, velocity: tuple[float, float, float], phase: float, trot: float, share: float
) -> tuple[float, ...]:
    """The twelve angles of `JOINTS`, radians; zero is a leg that hangs down straight.

    `height`: metres from the floor to the hips. `velocity`: m/s forward and left, rad/s to the left; `phase`: radians
    of a trot with `trot` steps per second, whose feet are lifted by `share` (0 to 1) of what is usual. Feet on the
    floor stay where they are while the body moves; diagonal legs go together.
    """
    forward, left, turn = velocity
    angles: list[float] = []
    for index in range(len(LEGS)):
        ahead, aside = (AHEAD if index < 2 else -AHEAD), (ASIDE if index % 2 else -ASIDE)
        at = (phase if index in (0, 3) else phase + math.pi) % (2 * math.pi)
        # On the floor for half a step: seconds until the body is above the foot, then since. In the air it goes back.
        reach = (2 * abs(at / math.pi - 1) - 1) / (4 * trot) if trot > 0 else 0.0
        x, y = (forward - turn * aside) * reach, (left + turn * ahead) * reach
        down = height - LIFT * share * max(0.0, -math.sin(at))
        angles += _leg(x, y, down)
    return tuple(angles)


def _leg(x: float, y: float, down: float) -> tuple[float, float, float]:
    """Hip, thigh and calf of a leg whose foot is `x` ahead, `y` left and `down` below the hip, metres."""
    hip, down = math.atan2(y, down), math.hypot(y, down)
    bend = math.acos(min(1.0, math.hypot(x, down) / (2 * LINK)))
    calf = min(max(-2 * bend, CALF[0]), CALF[1])
    return hip, math.atan2(-x, down) - calf / 2, calf


@dataclass(frozen=True)
class PlantSettings:
    """A Go2's body.

    - `step`: seconds per step. `gain`: speed reached per speed commanded, forward, sideways, turning. `lag`: seconds to
      63 % of it; `dead_time`: seconds before anything happens. `fastest`: commands beyond are cut (m/s, m/s, rad/s).
    - `expiry`: seconds for which a Move holds. `deaf`: from and to how many seconds after StandUp Moves are ignored.
    - `tilt`: radians by which it rocks while walking; `trot`: how often per second. `height`: of the standing body, m.
    - Odometry: `scale_drift`: share by which distances are wrong; `turn_drift`: share by which turns are; `yaw_drift`:
      radians of heading after one metre, growing with the root of the way. Standard deviations of normal distributions.
    - `upright`: whether it stands ready to walk at first, or lies.
    """

    step: float = 0.005
    gain: tuple[float, float, float] = (0.80, 0.74, 0.90)
    lag: float = 0.30
    dead_time: float = 0.15
    fastest: tuple[float, float, float] = (2.5, 1.0, 4.0)
    expiry: float = 1.0
    deaf: tuple[float, float] = (4.0, 10.0)
    tilt: float = math.radians(2.0)
    trot: float = 3.0
    height: float = 0.32
    scale_drift: float = 0.02
    turn_drift: float = 0.01
    yaw_drift: float = math.radians(0.5)
    upright: bool = True

    def __post_init__(self) -> None:
        positive = {"lag": 1e-3, "trot": 0.0, "height": 0.05, "expiry": 0.0, "dead_time": 0.0, "tilt": 0.0}
        fields = {name: (within(getattr(self, name), low, 60), f"at least {low:g}") for name, low in positive.items()}
        fields["step"] = within(self.step, 1e-4, 0.1), "0.0001 to 0.1 s"
        fields["deaf"] = stretch(self.deaf, 0, 600), "seconds (from, to)"
        for name in ("scale_drift", "turn_drift", "yaw_drift"):
            fields[name] = within(getattr(self, name), 0, 1), "0 to 1"
        require(self, fields, DeviceError)


@dataclass(frozen=True, eq=False)
class Motion:
    """The body at one step: `pose`, `velocity` ``(3,)`` (m/s, world), `rates` ``(3,)`` (rad/s, body), `mode`."""

    pose: Pose
    velocity: np.ndarray
    rates: np.ndarray
    yaw_rate: float
    mode: int


class Plant:
    """A Go2's body. `rng` draws drift and how long it is deaf; `start`: x, y (metres) and heading (radians, left).

    `slide(start, step)` gives where a step over the floor ends, at walls; without it the floor has no end. `ahead`: how
    far the floor is free, which careful moves heed.
    """

    def __init__(
        self,
        settings: PlantSettings,
        rng: np.random.Generator,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        slide: Slide | None = None,
        ahead: Ahead | None = None,
    ) -> None:
        self.settings, self._rng, self._slide, self._ahead = settings, rng, slide, ahead
        self.steps = 0
        self.mode = STANDING if settings.upright else LYING
        self.walked = 0.0
        self._xy, self._yaw = np.array(start[:2], dtype=np.float64), float(start[2])
        self._speed = np.zeros(3)  # forward, left, turning; body frame
        self._velocity = np.zeros(2)  # of the last step, world frame
        self._wanted, self._until = np.zeros(3), 0  # command, and the step at which it ends
        self._careful = False
        self._pipe: deque[np.ndarray] = deque([np.zeros(3)] * round(settings.dead_time / settings.step))
        self._deaf_until = 0
        self._phase, self._rocking = 0.0, 0.0  # of the trot; 0 standing, 1 walking
        self._attitude = _turned(self._yaw, 0.0, 0.0)
        self._before = self._attitude
        # Odometry: where the robot believes it is.
        self._scale = 1.0 + settings.scale_drift * float(rng.standard_normal())
        self._turn_scale = 1.0 + settings.turn_drift * float(rng.standard_normal())
        self._believed_xy, self._believed_yaw = self._xy.copy(), self._yaw

    @property
    def seconds(self) -> float:
        """Since the start."""
        return self.steps * self.settings.step

    @property
    def joints(self) -> tuple[float, ...]:
        """The angles of the legs' joints (`JOINTS`), radians."""
        forward, left, turn = (float(value) for value in self._speed)
        return joint_angles(self._height, (forward, left, turn), self._phase, self.settings.trot, self._rocking)

    # --- commands: whether the robot takes them, as it says itself ---

    def move(self, vx: float, vy: float, wz: float, *, careful: bool = False) -> None:
        """A Move: heeded only by a robot that stands ready. `careful`: it stops before what it would run into."""
        if self.mode in (STANDING, WALKING) and self.steps >= self._deaf_until:
            limit = np.array(self.settings.fastest)
            self._wanted = np.clip([vx, vy, wz], -limit, limit)
            self._until = self.steps + round(self.settings.expiry / self.settings.step)
            self._careful = careful

    def stop(self) -> None:
        """StopMove."""
        self._until = self.steps

    def stand_up(self) -> None:
        """Stand with locked joints, deaf to Moves for a while."""
        self.stop()
        low, high = self.settings.deaf
        self._deaf_until = self.steps + round(float(self._rng.uniform(low, high)) / self.settings.step)
        self.mode = LOCKED

    def balance_stand(self) -> None:
        """Unlock the joints: ready to walk (once it is no longer deaf)."""
        if self.mode not in (LYING, LIMP):
            self.stop()
            self.mode = STANDING

    def recover(self) -> None:
        """RecoveryStand: from anything to standing, ready to walk once it is no longer deaf."""
        self.stand_up()
        self.balance_stand()

    def damp(self) -> None:
        """Let all joints go: the body sinks to the floor."""
        self.stop()
        self.mode = LIMP

    def stand_down(self) -> None:
        """Lie down."""
        self.stop()
        self.mode = LYING

    # --- time ---

    def advance(self) -> None:
        """One step."""
        rules = self.settings
        asked = self._allowed() if self.steps < self._until else np.zeros(3)
        self._pipe.append(asked)
        command = self._pipe.popleft() * rules.gain
        if self.mode not in (STANDING, WALKING):
            command = np.zeros(3)
        # Exact for a command that is constant over the step.
        self._speed = command + math.exp(-rules.step / rules.lag) * (self._speed - command)
        if self.mode in (LYING, LIMP):
            self._speed = np.zeros(3)
        turned = float(self._speed[2]) * rules.step
        heading = self._yaw + turned / 2
        c, s = math.cos(heading), math.sin(heading)
        forward, left = self._speed[:2] * rules.step
        step = np.array([c * forward - s * left, s * forward + c * left])
        end = self._xy + step if self._slide is None else np.asarray(self._slide(self._xy, step), dtype=np.float64)
        done = end - self._xy
        self._believe(done, turned)
        self._xy, self._yaw = end, self._yaw + turned
        self._velocity = done / rules.step
        self.walked += float(np.hypot(*done))
        self._trot()
        self.steps += 1

    def _allowed(self) -> np.ndarray:
        """The command, slowed down by a careful body before obstacles."""
        speed = float(np.hypot(*self._wanted[:2]))
        if not self._careful or self._ahead is None or speed == 0:
            return self._wanted
        free = self._ahead(self._xy, self._yaw + math.atan2(self._wanted[1], self._wanted[0]))
        most = max(0.0, free - BERTH) / BRAKING
        return self._wanted * (min(1.0, most / speed), min(1.0, most / speed), 1.0)

    def _believe(self, done: np.ndarray, turned: float) -> None:
        """The odometry's share: the step in body axes, with errors of scale and heading."""
        off = self._believed_yaw - self._yaw
        c, s = math.cos(off), math.sin(off)
        x, y = done * self._scale
        self._believed_xy = self._believed_xy + np.array([c * x - s * y, s * x + c * y])
        way = float(np.hypot(*done))
        slip = self.settings.yaw_drift * math.sqrt(way) * float(self._rng.standard_normal()) if way > 0 else 0.0
        self._believed_yaw += turned * self._turn_scale + slip

    def _trot(self) -> None:
        """Rock from side to side and to and fro while the legs move; fade in and out as the speed does."""
        rules = self.settings
        moving = bool((np.abs(self._speed) > MOVING).any())
        if self.mode in (STANDING, WALKING):
            self.mode = WALKING if moving or self.steps < self._until else STANDING
        self._rocking += (float(moving) - self._rocking) * (1.0 - math.exp(-rules.step / rules.lag))
        self._phase += 2 * math.pi * rules.trot * rules.step
        self._before = self._attitude
        self._attitude = self._leaning(self._yaw)

    @property
    def _height(self) -> float:
        return self.settings.height * (0.25 if self.mode in (LYING, LIMP) else 1.0)

    def _leaning(self, yaw: float) -> np.ndarray:
        lean = self.settings.tilt * self._rocking
        return _turned(yaw, lean * math.sin(self._phase + 1.0), lean * math.sin(self._phase))

    # --- what is so, and what the robot believes ---

    @property
    def truth(self) -> Motion:
        """The body as it is."""
        return self._motion(self._xy, self._attitude, self._velocity)

    @property
    def odometry(self) -> Motion:
        """The body as the robot believes."""
        off = self._believed_yaw - self._yaw
        c, s = math.cos(off), math.sin(off)
        x, y = self._velocity * self._scale
        speed = np.array([c * x - s * y, s * x + c * y])
        return self._motion(self._believed_xy, self._leaning(self._believed_yaw), speed)

    def _motion(self, xy: np.ndarray, attitude: np.ndarray, velocity: np.ndarray) -> Motion:
        turn = self._before.T @ self._attitude
        # For the small turn of one step the antisymmetric part is the rotation vector (to 1e-6 of it).
        rates = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        rates /= 2 * self.settings.step
        pose = Pose(self.seconds, attitude, np.array([*xy, self._height]))
        return Motion(pose, np.array([*velocity, 0.0]), rates, float(self._speed[2]), self.mode)


def _turned(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """As `eagor.sphere.world_R_body`, multiplied out: it is needed 400 times per second."""
    a, b, c = math.cos(roll), math.cos(pitch), math.cos(yaw)
    x, y, z = math.sin(roll), math.sin(pitch), math.sin(yaw)
    return np.array(
        [
            [c * b, c * y * x - z * a, c * y * a + z * x],
            [z * b, z * y * x + c * a, z * y * a - c * x],
            [-y, b * x, b * a],
        ]
    )
