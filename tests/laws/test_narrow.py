"""A camera that does not see all around shows what it shows, and a look says nothing about the rest."""

import json
import math

import numpy as np
import pytest

from eagor import Evidence
from eagor.cli import main
from eagor.errors import WorldError
from eagor.grids import ErpGrid
from eagor.lab.envs.episodes import Slot
from eagor.lab.envs.places import APARTMENT, in_view, mask_of
from eagor.lab.envs.rules import Camera, Disturbances, NavigationRules, as_dict
from eagor.lab.tasks.sim.navigation import MapFreeNavigationEnv
from eagor.lab.tasks.sim.play import Player
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


@pytest.mark.parametrize("hfov", [9.0, 171.0, 359.0, -100.0, math.nan, "100"])
def test_fields_of_view_that_no_picture_has_are_refused(hfov):
    with pytest.raises(WorldError, match=r"hfov.*wanted.*10 to 170, or 360"):
        Camera(hfov=hfov)


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


def test_what_is_out_of_the_picture_is_not_visible():
    env, wide = MapFreeNavigationEnv(panorama=None, camera=NARROW), MapFreeNavigationEnv(panorama=None)
    told = []
    for seed in range(6):
        _, info = env.reset(seed=seed)
        _, everything = wide.reset(seed=seed)
        azimuth, _ = azimuth_elevation(info["truth"]["direction"])
        assert abs(azimuth) > math.radians(50)  # an episode starts facing away
        assert not info["truth"]["visible"]
        told.append(everything["truth"]["visible"])
    assert any(told)


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
        told = {"rules": as_dict(NavigationRules()), "camera": as_dict(camera), "disturbances": as_dict(Disturbances())}
        player = Player({"task": "navigation", "perception": "truth:ideal", "rows": 64} | told)
        found = player.play(Slot("navigation", APARTMENT, 3, 0, 0), ["eagor"])["methods"]["eagor"]
        assert found["metrics"]["success"] == 1
        steps.append(found["metrics"]["steps"])
    assert steps[0] > steps[1]


def test_a_narrow_camera_is_set_and_kept_with_a_run(tmp_path):
    out = tmp_path / "run"
    asked = ("--perception", "truth", "--methods", "vmf", "--episodes", "1", "--seed", "3", "--out", str(out))
    assert main(["bench", "run", "navigation", *asked, "--set", "hfov=100", "max_steps=3"]) == 0
    assert json.loads((out / "run.json").read_text())["camera"]["hfov"] == 100
