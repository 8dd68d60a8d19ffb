"""The safety gate: what a policy wants passes it before a robot is told to move."""

from __future__ import annotations

from eagor.robots.safety.gate import Gate, Mode, Output, State
from eagor.robots.safety.limits import Body, Fault, Inputs, Limits, Velocity

__all__ = ["Body", "Fault", "Gate", "Inputs", "Limits", "Mode", "Output", "State", "Velocity"]
