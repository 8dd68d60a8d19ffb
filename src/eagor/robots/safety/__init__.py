"""The safety gate: what a policy wants passes it before a robot is told to move."""

from __future__ import annotations

from eagor.robots.safety.gate import Gate, GateStatus, Mode, State
from eagor.robots.safety.limits import Inputs, Limits, RobotState, Velocity

__all__ = ["Gate", "GateStatus", "Inputs", "Limits", "Mode", "RobotState", "State", "Velocity"]
