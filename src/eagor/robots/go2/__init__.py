"""Unitree's Go2: its state, its commands, its remote control, and a simulated one that speaks the same wire.

- `idl`: the messages as DDS types; `wire`: the same as bytes, quickly.
- `state`: where the robot is (`Go2State`), its battery and remote control; `sport`: what it is told (`SportClient`),
  and by whom else; `check`: whether all that works.
- `plant`: how a Go2 answers commands, with its legs; `sim`: a simulated Go2 and its camera in a simulated `house`, on a
  clock of its own; `sim_live`: the same on DDS in real time (`sim_pictures`: the camera's process).

Nothing here decides to move: `eagor.robots.safety` does.
"""

from __future__ import annotations

from eagor.robots.go2.sport import SportClient
from eagor.robots.go2.state import BodyState, Go2State

__all__ = ["BodyState", "Go2State", "SportClient"]
