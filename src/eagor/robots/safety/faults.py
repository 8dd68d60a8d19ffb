"""What the gate is told, and what is wrong with it, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eagor.robots.safety.limits import STILL, Limits, Velocity
from eagor.robots.safety.rhythm import Rhythm, look_age, picture_age

__all__ = ["Body", "Fault", "Inputs", "faults_of", "stamp_of"]


@dataclass(frozen=True)
class Body:
    """The robot's own state, as the gate's process reads it.

    `stamp`: when it came, on the gate's clock; `roll`, `pitch`: radians; `speed`: m/s in the plane; `turn`: rad/s.
    """

    stamp: float
    roll: float
    pitch: float
    speed: float
    turn: float
    error_code: int = 0

    @classmethod
    def of(cls, stamp: float, world_R_body: np.ndarray, speed: float, turn: float, error_code: int = 0) -> Body:
        """With roll and pitch (REP-103: positive with the nose down) of the attitude `world_R_body` ``(3, 3)``."""
        x, y, z = (float(value) for value in np.asarray(world_R_body)[2])
        return cls(stamp, math.atan2(y, z), math.asin(min(max(-x, -1.0), 1.0)), speed, turn, error_code)


@dataclass(frozen=True)
class Inputs:
    """All that the gate knows at one step. Stamps are seconds on the gate's clock; None: never came.

    - `wanted`, `command`: the velocity that the policy wants, and when it was computed.
    - `image`, `pose`, `belief`: capture of the newest picture, of the newest pose, of the newest evidence.
    - `presence`: probability that the thing is there.
    - `heartbeat`: the newest word of the parent; `gone`: the parent has ended.
    - `stated`: faults that the parent knows of, in words.
    - `body`: the robot's state.
    - `deadman`: whether it is held; None: there is none.
    - `acknowledged`: the number of the newest StopMove that the robot acknowledged.
    - `emergency`: the emergency stop is pressed now; `reset`: somebody releases it.
    """

    wanted: Velocity | None = None
    command: float | None = None
    image: float | None = None
    pose: float | None = None
    belief: float | None = None
    presence: float | None = None
    heartbeat: float | None = None
    gone: bool = False
    stated: tuple[str, ...] = ()
    body: Body | None = None
    deadman: bool | None = None
    acknowledged: int | None = None
    emergency: bool = False
    reset: bool = False


class Fault(NamedTuple):
    """Why the robot must not move: a `name` for tables, and the words for people."""

    name: str
    words: str


def stamp_of(now: float, age: float | None) -> float | None:
    """The stamp of what is `age` seconds old at `now`; None if nothing came yet (an age of None, or infinite)."""
    return None if age is None or age == math.inf else now - age


def faults_of(
    limits: Limits, now: float, inputs: Inputs, sent: Velocity = STILL, *, pictures: Rhythm = (), looks: Rhythm = ()
) -> tuple[Fault, ...]:
    """Everything that forbids motion at `now`; empty if nothing does. `sent`: the velocity that was sent last.

    `pictures`, `looks`: how often they have come, which may allow less than `limits` do. A stale command is not among
    the faults: it only means that the wanted velocity is zero.
    """
    if not math.isfinite(now):
        return (Fault("number", f"the time is {now}"),)
    ages = picture_age(pictures, limits.image_age), look_age(looks, limits.belief_age)
    return tuple(_faults(limits, now, inputs, sent, *ages))


def _faults(
    limits: Limits, now: float, inputs: Inputs, sent: Velocity, image_age: float, belief_age: float
) -> Iterator[Fault]:
    if inputs.gone:
        yield Fault("parent", "the program that steers has ended")
    else:
        yield from _stale(
            "parent", "word of the program that steers", inputs.heartbeat, limits.heartbeat_age, limits, now
        )
    if inputs.deadman is False:
        yield Fault("deadman", "the dead-man switch is not held")
    yield from _stale("image", "picture", inputs.image, image_age, limits, now)
    yield from _stale("pose", "pose", inputs.pose, limits.pose_age, limits, now)
    yield from _stale("belief", "look of the perception", inputs.belief, belief_age, limits, now)
    yield from _of_body(limits, now, inputs.body)
    yield from _of_command(limits, now, inputs, sent)
    for words in inputs.stated:
        yield Fault("stated", words)


def _stale(name: str, what: str, stamp: float | None, most: float, limits: Limits, now: float) -> Iterator[Fault]:
    if stamp is None:
        yield Fault(name, f"there was no {what} yet")
    elif not math.isfinite(stamp):
        yield Fault("number", f"the stamp of the newest {what} is {stamp}")
    elif now - stamp > most:
        yield Fault(name, f"the newest {what} is {now - stamp:.2f} s old; at most {most:.3g} s is allowed")
    elif stamp - now > limits.early:
        yield Fault(name, f"the newest {what} is {stamp - now:.2f} s in the future: the clocks differ")


def _of_body(limits: Limits, now: float, body: Body | None) -> Iterator[Fault]:
    yield from _stale("state", "state of the robot", body and body.stamp, limits.state_age, limits, now)
    if body is None:
        return
    if not all(map(math.isfinite, (body.roll, body.pitch, body.speed, body.turn))):
        yield Fault("number", "the state of the robot holds a number that is not finite")
    elif max(abs(body.roll), abs(body.pitch)) > limits.tilt:
        roll, pitch, most = (math.degrees(angle) for angle in (body.roll, body.pitch, limits.tilt))
        yield Fault(
            "tilt", f"the robot is tilted: roll {roll:.0f}°, pitch {pitch:.0f}°; at most {most:.0f}° is allowed"
        )
    if body.error_code not in limits.calm_codes:
        yield Fault("error", f"the robot reports error code {body.error_code}")


def _of_command(limits: Limits, now: float, inputs: Inputs, sent: Velocity) -> Iterator[Fault]:
    """NaN in the command or the presence; stamps from the future; walking without enough presence."""
    if inputs.wanted is not None and not inputs.wanted.finite:
        yield Fault("number", f"the wanted velocity is {inputs.wanted.parts}")
    if inputs.command is not None and not math.isfinite(inputs.command):
        yield Fault("number", f"the stamp of the wanted velocity is {inputs.command}")
    elif inputs.command is not None and inputs.command - now > limits.early:
        yield Fault("command", f"the wanted velocity is {inputs.command - now:.2f} s in the future: the clocks differ")
    presence = inputs.presence
    if presence is None:
        yield Fault("presence", "there was no answer yet")
    elif not math.isfinite(presence):
        yield Fault("number", f"the presence is {presence}")
    elif presence < limits.presence and (sent.walks or (inputs.wanted is not None and inputs.wanted.walks)):
        yield Fault("presence", f"the presence is {presence:.2f}; walking needs {limits.presence:g}")
