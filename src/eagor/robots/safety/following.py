"""Whether a robot does what it is told, from its own state: if not, somebody else commands it, or holds it. Pure.

No body follows at once. What a body may do lies between the command and the same command as a very slow body would
follow it, each by the gain of a weak and of a strong one. A Go2 (dead time 0.15 s, lag 0.30 s, gains 0.74 to 0.90)
stays well between these, whatever it is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from eagor.robots.safety.faults import Body
from eagor.robots.safety.limits import Limits, Velocity

__all__ = ["Following", "follow"]

SLOW = 0.6  # seconds to 63 % of a command, of the slowest body
GAINS = 0.6, 1.15  # speed per speed commanded, of the weakest and of the strongest
SWAY = 0.12, 0.25  # m/s and rad/s by which a trotting body sways around what it does


@dataclass(frozen=True)
class Following:
    """What is remembered from step to step while a robot is told to move.

    `speed` (m/s), `turn` (rad/s): what the slowest body would do now. `moved`: whether it has moved at all; one that
    has just stood up ignores Move for seconds. `since`: when it began to do something else than it is told.
    """

    speed: float = 0.0
    turn: float = 0.0
    moved: bool = False
    since: float | None = None


def follow(
    limits: Limits, before: Following, time: float, gone: float, sent: Velocity, body: Body, *, ignored: bool
) -> Following:
    """One step, `gone` seconds after the last. `sent`: the command since then. `ignored`: told to move, it stands."""
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
