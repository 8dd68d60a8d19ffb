"""Unitree's Go2: its state, its commands, its remote control, and a simulated one that speaks the same wire.

Nothing here decides to move: `eagor.robots.safety` does.
"""

__all__: list[str] = []
