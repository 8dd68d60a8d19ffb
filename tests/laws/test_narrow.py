"""A camera that does not see all around shows what it shows, and a look says nothing about the rest."""

import math
from dataclasses import asdict

import numpy as np

from eagor import Evidence
from eagor.grids import ErpGrid
from eagor.lab.envs.episodes import EpisodeSpec
from eagor.lab.envs.places import APARTMENT, in_view, mask_of
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.sim.navigation import MapFreeNavigationEnv
from eagor.lab.tasks.sim.play import Runner
from eagor.sphere import azimuth_elevation, direction

NARROW = Camera(hfov=100.0)


def test_it_shows_a_picture_of_4_to_3_straight_ahead():
    grid = ErpGrid(180, 360)
    seen = in_view(NARROW, 180)
    azimuth, elevation = azimuth_elevation(grid.directions)
    x, y = np.tan(azimuth), np.tan(elevation) / np.cos(azimuth)
    half = math.tan(math.radians(50))
    inside = (np.abs(azimuth) < math.pi / 2) & (np.abs(x) < half) & (np.abs(y) < 0.75 * half)
    assert (seen == inside).mean() > 0.999
    assert in_view(Camera(), 180) is None
    assert mask_of(Camera()) is None


def test_the_rest_of_a_panorama_is_empty():
    env = MapFreeNavigationEnv(panorama=64, with_range=True, camera=NARROW)
    wide = MapFreeNavigationEnv(panorama=64, with_range=True)
    observation, info = env.reset(seed=3)
    whole, everything = wide.reset(seed=3)
    seen = in_view(NARROW, 64)
    assert (info["instances"]["ids"][~seen] == -1).all()
    assert (info["instances"]["ids"][seen] == everything["instances"]["ids"][seen]).all()
    assert (observation["range"][~seen] == 0).all()
    assert (observation["panorama"][seen] == whole["panorama"][seen]).all()
    assert len(np.unique(observation["panorama"][~seen], axis=0)) == 1


def test_a_look_says_nothing_outside_of_the_picture():
    response = np.zeros((64, 128))
    found = Evidence.from_response(response, ErpGrid(64, 128), stamp=0.0).covered(mask_of(NARROW))
    ratio = np.asarray(found.log_ratio)
    grid = ErpGrid(64, 128)

    def there(azimuth):
        x, y, _ = grid.project(direction(math.radians(azimuth), 0.0)[None])
        return float(ratio[int(y[0]), int(x[0])])

    assert there(0) == there(45) < 0
    assert there(55) == there(180) == there(-90) == 0


def test_a_body_with_a_narrow_camera_comes_to_the_thing():
    """It turns before it walks, and takes longer than one that sees all around."""
    steps = []
    for camera in (NARROW, Camera()):
        runner = Runner({"task": "navigation", "perception": "truth:ideal", "camera": asdict(camera), "rows": 64})
        found = runner.run_episode(EpisodeSpec("navigation", APARTMENT, 3, 0, 0), ["eagor"])["methods"]["eagor"]
        assert found["metrics"]["success"] == 1
        steps.append(found["metrics"]["steps"])
    assert steps[0] > steps[1]
