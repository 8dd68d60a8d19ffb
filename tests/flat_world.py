"""The little flat of boxes as the place of every episode: for tests of tasks and environments."""

from functools import cache

import pytest
from rooms import two_rooms

from eagor.lab.envs import place_env, places
from eagor.lab.tasks.sim import navigation, tracking, waypoint
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Renderer


@cache
def the_flat():
    scene = two_rooms()
    return places.Place(scene, Ground.from_scene(scene), Renderer(scene))


@pytest.fixture(autouse=True)
def in_the_flat(monkeypatch):
    """Every module that opens places gets the flat: for files that import this."""
    for module in (places, navigation, waypoint, tracking, place_env):
        monkeypatch.setattr(module, "load_place", lambda *_: the_flat())
