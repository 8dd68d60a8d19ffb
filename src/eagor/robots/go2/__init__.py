"""Unitree's Go2, and a simulated one on the same wire. Nothing here decides to move: `eagor.robots.safety` does."""

__all__: list[str] = []
