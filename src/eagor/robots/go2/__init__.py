"""Unitree's Go2: its state, its commands, its remote control, and a simulated one that speaks the same wire.

- `idl`: the messages as DDS types.
- `state`: where the robot is (`Go2State`), its battery and remote control, from its messages as bytes; `sport`: what it
  is told (`SportClient`), by whom else, and whether all that works.
- `plant`: how a Go2 answers commands, with its legs; `house`: where a simulated one walks, and its camera; `sim`: a
  simulated Go2 there, on a clock of its own, or on DDS in real time, with the wire of a real one (`sim_wire`).

Nothing here decides to move: `eagor.robots.safety` does.
"""

from __future__ import annotations

from eagor.robots.go2.sport import SportClient
from eagor.robots.go2.state import BodyState, Go2State

__all__ = ["BodyState", "Go2State", "SportClient"]
