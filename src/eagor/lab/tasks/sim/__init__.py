"""Simulated tasks: Waypoint Following, Map-Free Navigation, Target Direction Estimation."""

__all__: list[str] = []  # the names are those of the modules
