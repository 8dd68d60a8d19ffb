"""What the gate allows, what it is told, and what is wrong with that, in words. Pure; each number has a unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from eagor._checks import above, require

__all__ = ["STILL", "Inputs", "Limits", "RobotState", "Velocity", "faults_of"]

EARLY = 0.05  # seconds by which a stamp may lie in the future: clocks that differ
MOST = {  # each limit may be tightened; ages, presence and tilt never loosened
    "forward": 1.5, "aside": 1.0, "turn": 3.0, "acceleration": 5.0, "turn_acceleration": 10.0, "presence": 1.0,
}  # fmt: skip


class Velocity(NamedTuple):
    """A velocity of the body, axes as in REP-103: `forward` and `left` in m/s, `turn` to the left in rad/s."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def walks(self) -> bool:
        return bool(self.forward or self.left)


STILL = Velocity()


@dataclass(frozen=True)
class Limits:
    """The twelve limits of the gate: careful values for a robot of 15 kg indoors.

    - `forward`; `aside`, which is sideways and backwards: m/s. `turn`: rad/s. A Go2 reaches 0.74 to 0.90 of them.
    - `acceleration` (m/s per second), `turn_acceleration` (rad/s per second): of speeding up; braking is not delayed.
    - `command_age`: seconds for which a wanted velocity holds; it becomes zero before it reaches this age.
    - `state_age`, `pose_age`: of the newest state of the robot that the gate's process read itself, and of the newest
      pose that the program used; `image_age`, `look_age`: since the newest picture, and that of the newest look of the
      perception, were captured. Seconds.
    - `presence`: the least probability that the thing is there, for walking. Turning in place is allowed below it.
    - `tilt`: radians, of roll and of pitch.
    """

    forward: float = 0.5
    aside: float = 0.2
    turn: float = 0.8
    acceleration: float = 0.6
    turn_acceleration: float = 1.6
    command_age: float = 0.25
    state_age: float = 0.1
    pose_age: float = 0.25
    image_age: float = 0.5
    look_age: float = 2.0
    presence: float = 0.5
    tilt: float = 0.5

    def __post_init__(self) -> None:
        most = {name: field.default for name, field in self.__dataclass_fields__.items()} | MOST
        require(self, {n: (above(getattr(self, n), 0, m), f"a number above 0, at most {m}") for n, m in most.items()})


@dataclass(frozen=True)
class RobotState:
    """What the robot says; `stamp`: when, on the gate's clock. Radians, m/s in the plane, and rad/s to the left."""

    stamp: float
    roll: float = 0.0
    pitch: float = 0.0
    speed: float = 0.0
    turn: float = 0.0
    error_code: int = 0


@dataclass(frozen=True)
class Inputs:
    """All that the gate knows at one step. Stamps are seconds on the gate's clock; None: never came.

    - `wanted`, `command`: the velocity that the policy wants, and when it was computed.
    - `image`, `pose`, `look`: capture of the newest picture, of the newest pose, of the newest look.
    - `presence`: probability that the thing is there. `stated`: other faults that are known, in words.
    - `robot`: its state. `deadman`: whether the switch is held; None: there is none.
    - `acknowledged`: the number of the newest StopMove that the robot acknowledged; 0: none yet.
    - `emergency`: the emergency stop is pressed now; `reset`: somebody releases it.
    """

    wanted: Velocity | None = None
    command: float | None = None
    image: float | None = None
    pose: float | None = None
    look: float | None = None
    presence: float | None = None
    stated: tuple[str, ...] = ()
    robot: RobotState | None = None
    deadman: bool | None = None
    acknowledged: int = 0
    emergency: bool = False
    reset: bool = False


def faults_of(
    limits: Limits, now: float, inputs: Inputs, sent: Velocity = STILL, ignored_codes: tuple[int, ...] = (0,)
) -> Iterator[str]:
    """Everything that forbids motion at `now`, in words; nothing if nothing does. `sent`: the last velocity.

    `ignored_codes`: error codes of the robot that are none. A stale command is not among the faults: it only means
    that the wanted velocity is zero.
    """
    robot, wanted, presence = inputs.robot, inputs.wanted or STILL, inputs.presence
    yield from inputs.stated
    if inputs.deadman is False:
        yield "the dead-man switch is not held"
    numbers = {"time": (now,), "wanted velocity": wanted, "presence": (presence or 0.0,)}
    if robot is not None:
        numbers["state of the robot"] = robot.roll, robot.pitch, robot.speed, robot.turn
    for what, values in numbers.items():
        if not all(map(math.isfinite, values)):
            yield f"the {what} holds a number that is not finite: {values}"
    for what, stamp, most in (
        ("picture", inputs.image, limits.image_age),
        ("pose", inputs.pose, limits.pose_age),
        ("look of the perception", inputs.look, limits.look_age),
        ("state of the robot", robot and robot.stamp, limits.state_age),
        ("wanted velocity", now if inputs.command is None else inputs.command, math.inf),
    ):
        age = math.inf if stamp is None else now - stamp
        if stamp is None:
            yield f"there was no {what} yet"
        elif not math.isfinite(age):
            yield f"the stamp of the newest {what} is {stamp}"
        elif age > most:
            yield f"the newest {what} is {age:.2f} s old; at most {most:g} s is allowed"
        elif age < -EARLY:
            yield f"the newest {what} is {-age:.2f} s in the future: the clocks differ"
    if robot is not None and max(abs(robot.roll), abs(robot.pitch)) > limits.tilt:
        roll, pitch, most = (f"{math.degrees(angle):.0f}°" for angle in (robot.roll, robot.pitch, limits.tilt))
        yield f"the robot is tilted: roll {roll}, pitch {pitch}; at most {most} is allowed"
    if robot is not None and robot.error_code not in ignored_codes:
        yield f"the robot reports error code {robot.error_code}"
    if presence is None:
        yield "there was no answer yet"
    elif presence < limits.presence and (sent.walks or wanted.walks):
        yield f"the presence is {presence:.2f}; walking needs {limits.presence:g}"
