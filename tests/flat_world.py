"""The little flat of boxes as the place of every episode: for tests of tasks and environments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType

from rooms import two_rooms

from eagor.lab.envs import place_env, places
from eagor.lab.tasks.sim import navigation, tracking, waypoint
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Renderer


def the_flat() -> places.Place:
    """The flat, with its ground and what draws it."""
    scene = two_rooms()
    return places.Place(scene, Ground.from_scene(scene), Renderer(scene))


def loaders(flat: places.Place) -> Iterator[tuple[ModuleType, Callable[..., places.Place]]]:
    """The modules that open places, and the function that is to do it instead."""
    for module in (places, navigation, waypoint, tracking, place_env):
        yield module, lambda *_: flat
