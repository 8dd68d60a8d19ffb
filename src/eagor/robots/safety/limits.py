"""What the gate allows, what it is told, and what is wrong with that, in words. Pure; each number has a unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from statistics import median_high
from typing import NamedTuple

import numpy as np

from eagor._checks import above, require, whole, within

__all__ = [
    "STILL", "Body", "CommandResponse", "Fault", "Inputs", "Limits", "Rhythm", "Velocity", "faults_of", "heard",
    "look_age", "picture_age", "responded", "stamp_of",
]  # fmt: skip

INTERVALS, LEAST = 3, 0.5  # usual intervals that may pass since the newest look; seconds that are always allowed
BEYOND, SLACK = 2, 0.2  # usual intervals, and at least seconds, beyond the usual age of what just came
SAME = 0.01  # seconds within which two stamps are one: they are computed anew from ages at each word
ENOUGH, KEPT = 4, 9  # stamps from which an interval counts as usual; and those that are remembered

# How often something comes: stamps and the times at which each was heard of first, oldest first. From that follows from
# which age on it must have stopped to come: a limit that fits the slowest perception lets a quick one hang for seconds.
Rhythm = tuple[tuple[float, float], ...]

SLOW = 0.6  # seconds to 63 % of a command, of the slowest body
GAINS = 0.6, 1.15  # speed per speed commanded, of the weakest and of the strongest
SWAY = 0.12, 0.25  # m/s and rad/s by which a trotting body sways around what it does


@dataclass(frozen=True)
class Velocity:
    """A velocity of the body, axes as in REP-103: `forward` and `left` in m/s, `turn` to the left in rad/s."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def finite(self) -> bool:
        return all(map(math.isfinite, self.parts))

    @property
    def parts(self) -> tuple[float, float, float]:
        return self.forward, self.left, self.turn

    @property
    def still(self) -> bool:
        """Whether all three are zero."""
        return not any(self.parts)

    @property
    def walks(self) -> bool:
        """Whether the body leaves its place."""
        return bool(self.forward or self.left)


STILL = Velocity()


@dataclass(frozen=True)
class Limits:
    """The limits of the gate. The defaults are careful values for a robot of 15 kg indoors.

    Speeds (the command; a Go2 reaches 0.74 to 0.90 of it):

    - `forward`, `backward`, `sideways`: m/s; `turn`: rad/s; `blind_turn`: rad/s while the presence is too low.
    - `acceleration`: m/s per second; `turn_acceleration`: rad/s per second. They hold for speeding up. Braking is
      never delayed.

    Ages, seconds. Beyond them, what the gate knows is stale:

    - `command_age`: the wanted velocity. It becomes zero before it reaches this age.
    - `heartbeat_age`: the newest word of the parent process.
    - `state_age`: the newest state of the robot that the gate's process read itself.
    - `pose_age`: the newest pose that the parent used. It tells of it between two answers, each of which takes it up to
      0.15 s to compute (measured on a busy machine of two cores).
    - `image_age`: the newest picture, since its capture. `belief_age`: the newest evidence, since its capture; a model
      that needs 1.4 s per look comes to 2.8 s. Both are the most that is allowed: once it is known how often pictures
      and looks come, less is (`picture_age`, `look_age`).
    - `silence`: the gate's own last step. A gate that was away for longer stops, and needs a new command; the program
      that it works for sends StopMove itself meanwhile (`eagor.robots.safety.guard.Guard`).
    - `early`: how far a stamp may lie in the future: clocks that differ.

    What must hold:

    - `presence`: the least probability that the thing is there, for walking. Turning in place is allowed below it.
    - `tilt`: radians, of roll and of pitch.
    - `calm_codes`: values of the robot's error code that are no error. Some firmware puts its mode there.

    How it stops and starts:

    - `period`: seconds between two steps of the gate.
    - `retry`: seconds between two StopMove until one is acknowledged; `again`: afterwards, while the robot still moves.
    - `still_speed` (m/s), `still_turn` (rad/s): below both, the robot stands. A trotting Go2 sways, so not 0.
    - `settle`: seconds without any fault before the robot moves again.
    - `rest`: seconds of zero velocity after which StopMove is sent.
    - `follow`: seconds for which the robot may do something else than it is told (`responded`).
      After that it is stopped. One that has not moved at all yet gets no more than `creep` (m/s) and `creep_turn`
      (rad/s), until it moves: a Go2 ignores Move for seconds after it stood up.
    - `aside`: seconds for which it keeps standing after that, and after a command of somebody else.
    """

    forward: float = 0.5
    backward: float = 0.2
    sideways: float = 0.3
    turn: float = 0.8
    blind_turn: float = 0.5
    acceleration: float = 0.6
    turn_acceleration: float = 1.6
    command_age: float = 0.25
    heartbeat_age: float = 0.25
    state_age: float = 0.1
    pose_age: float = 0.25
    image_age: float = 1.0
    belief_age: float = 3.0
    silence: float = 0.2
    early: float = 0.05
    presence: float = 0.5
    tilt: float = 0.5
    calm_codes: tuple[int, ...] = (0,)
    period: float = 0.02
    retry: float = 0.04
    again: float = 0.5
    still_speed: float = 0.05
    still_turn: float = 0.05
    settle: float = 0.5
    rest: float = 0.5
    follow: float = 0.5
    aside: float = 2.0
    creep: float = 0.15
    creep_turn: float = 0.25

    def __post_init__(self) -> None:
        speeds = dict.fromkeys(("forward", "backward", "sideways"), (0.0, 3.0, "m/s, from 0 to 3"))
        turns = dict.fromkeys(("turn", "blind_turn"), (0.0, 3.0, "rad/s, from 0 to 3"))
        known = speeds | turns | {"presence": (0.0, 1.0, "a probability"), "tilt": (0.0, 1.5, "radians, up to 1.5")}
        checks = {name: (within(getattr(self, name), low, high), text) for name, (low, high, text) in known.items()}
        rest = [field.name for field in fields(self) if field.name not in checks and field.name != "calm_codes"]
        checks |= {name: (above(getattr(self, name), 0, 3600), "a number above 0") for name in rest}
        codes = isinstance(self.calm_codes, tuple) and all(whole(code, 0, 2**32 - 1) for code in self.calm_codes)
        require(self, checks | {"calm_codes": (codes, "whole numbers from 0 on, in a tuple")})
        shortest = min(self.command_age, self.heartbeat_age, self.state_age, self.pose_age, self.silence)
        orders = {
            "period": (2 * self.period < shortest, f"less than half of the shortest age, {shortest:g} s"),
            "creep": (self.creep > 2 * self.still_speed, "more than twice still_speed: else it cannot be seen"),
            "creep_turn": (self.creep_turn > 2 * self.still_turn, "more than twice still_turn: else it cannot be seen"),
        }
        require(self, orders)


def heard(rhythm: Rhythm, stamp: float | None, now: float) -> Rhythm:
    """With the newest stamp, if that is a new one. One that is no time, or lies in the future, is none."""
    if stamp is None or not math.isfinite(stamp) or not math.isfinite(now) or stamp > now + SAME:
        return rhythm
    if rhythm and stamp - rhythm[-1][0] <= SAME:
        return rhythm
    return (*rhythm[1 - KEPT :], (stamp, now))


def picture_age(rhythm: Rhythm, most: float) -> float:
    """Seconds since its capture after which the newest picture is too old: `most` until enough is known.

    The usual age of one that just came, and two usual intervals, at least 0.2 s; at most `most`. So a camera of ten
    pictures per second or more that ends is noticed within 0.2 s. Usual is the median.
    """
    if len(rhythm) < ENOUGH:
        return most
    interval, age = _usual(rhythm)
    return min(most, age + max(SLACK, BEYOND * interval))


def look_age(rhythm: Rhythm, most: float) -> float:
    """The same of the newest look: three usual intervals, at least half a second; at most `most`.

    Where looks usually come later than one interval after their capture: their usual age and two intervals.
    """
    if len(rhythm) < ENOUGH:
        return most
    interval, age = _usual(rhythm)
    return min(most, max(LEAST, INTERVALS * interval, age + BEYOND * interval))


def _usual(rhythm: Rhythm) -> tuple[float, float]:
    """Seconds between two stamps, and from a stamp to when it was heard of."""
    interval = median_high(after[0] - before[0] for before, after in pairwise(rhythm))
    return interval, median_high(now - stamp for stamp, now in rhythm)


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


@dataclass(frozen=True)
class CommandResponse:
    """What is remembered from step to step while a robot is told to move.

    `speed` (m/s), `turn` (rad/s): what the slowest body would do now. `moved`: whether it has moved at all; one that
    has just stood up ignores Move for seconds. `since`: when it began to do something else than it is told.
    """

    speed: float = 0.0
    turn: float = 0.0
    moved: bool = False
    since: float | None = None


def responded(
    limits: Limits, before: CommandResponse, time: float, gone: float, sent: Velocity, body: Body, *, ignored: bool
) -> CommandResponse:
    """One step, `gone` seconds after the last. `sent`: the command since then. `ignored`: told to move, it stands.

    A robot that does something else than it is told is commanded, or held, by somebody else. No body follows at once:
    what a body may do lies between the command and the same command as a very slow body would follow it, each by the
    gain of a weak and of a strong one. A Go2 (dead time 0.15 s, lag 0.30 s, gains 0.74 to 0.90) stays well between
    these, whatever it is told.
    """
    share = 1.0 - math.exp(-max(gone, 0.0) / SLOW)
    told = math.hypot(sent.forward, sent.left), sent.turn
    speed = before.speed + share * (told[0] - before.speed)
    turn = before.turn + share * (told[1] - before.turn)
    moved = before.moved or abs(body.speed) >= limits.still_speed or abs(body.turn) >= limits.still_turn
    pairs = ((told[0], speed, abs(body.speed), SWAY[0]), (told[1], turn, body.turn, SWAY[1]))
    odd = ignored or not all(_between(*pair) for pair in pairs)
    since = None if not (moved and odd) else time if before.since is None else before.since
    return replace(before, speed=speed, turn=turn, moved=moved, since=since)


def _between(command: float, slow: float, measured: float, sway: float) -> bool:
    may = [gain * value for gain in GAINS for value in (command, slow)]
    return min(may) - sway <= measured <= max(may) + sway
