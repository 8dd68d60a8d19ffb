"""What the gate allows: speeds, accelerations, ages of what it is told, and how it stops. Each number has a unit."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from eagor._checks import above, require, whole, within

__all__ = ["STILL", "Limits", "Velocity"]


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
      and looks come, less is (`eagor.robots.safety.rhythm`).
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
    - `follow`: seconds for which the robot may do something else than it is told (`eagor.robots.safety.following`).
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
