"""The simulated tasks: Waypoint Following, Map-Free Navigation, Target Direction Estimation.

``import eagor.lab.tasks`` registers them with Gymnasium: ``gymnasium.make("Eagor/MapFreeNavigation-v0")`` then works.
"""

from __future__ import annotations

from importlib.util import find_spec

from eagor._extras import need

__all__ = ["ENVIRONMENTS", "register"]

ENVIRONMENTS = {
    "Eagor/WaypointFollowing-v0": "eagor.lab.tasks.sim.waypoint:WaypointFollowingEnv",
    "Eagor/MapFreeNavigation-v0": "eagor.lab.tasks.sim.navigation:MapFreeNavigationEnv",
    "Eagor/TargetTracking-v0": "eagor.lab.tasks.sim.tracking:TargetTrackingEnv",
}


def register() -> None:
    """Register the environments with Gymnasium, which the extra ``sim`` brings; calling it twice is harmless."""
    need("a simulated task", "sim", "gymnasium")
    import gymnasium

    for name in ENVIRONMENTS.keys() - gymnasium.registry.keys():
        gymnasium.register(name, ENVIRONMENTS[name])


if find_spec("gymnasium"):  # the published benchmarks in this package do not need it
    register()
