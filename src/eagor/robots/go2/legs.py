"""The joints of a Go2's legs: which angles bring its feet where a standing or trotting body has them."""

from __future__ import annotations

import math

__all__ = ["JOINTS", "joint_angles"]

LEGS = (
    "FR",
    "FL",
    "RR",
    "RL",
)  # the order of the motors in ``LowState``: front right, front left, rear right, rear left
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
LINK = 0.213  # metres of thigh and calf alike (Unitree's description of the Go2)
CALF = -2.7227, -0.83776  # radians that the calf's joint can reach; the others' limits are not met here
AHEAD, ASIDE = 0.1934, 0.1420  # metres from the body's centre to the hips, forward and to the side of the feet
LIFT = 0.09  # metres by which a foot is lifted


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
