"""A simulated Go2 in a house, and the same on DDS with its camera."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from eagor.errors import DeviceError, QueryError, WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds.render import Ball, Renderer
from eagor.robots.go2.house import SimWorld, panorama
from eagor.robots.go2.sim import SimSettings, SimulatedGo2
from eagor.sphere import angular_distance, world_R_body


def test_the_same_seed_gives_the_same_walk():
    robots = [SimulatedGo2(SimSettings(target="blue ball", speed=0.3)) for _ in range(2)]
    for robot in robots:
        for step in range(400):
            if step % 20 == 0:
                robot.plant.move(0.4, 0.0, 0.5)
            robot.plant.advance()
            assert robot.house.ground.is_free(robot.plant.truth.pose.position[:2])
    one, two = ([each.plant.odometry.pose.position, each.house.ball_at(33).centre] for each in robots)
    np.testing.assert_array_equal(one, two)
    assert np.linalg.norm(one[0] - robots[0].plant.truth.pose.position) > 1e-3  # it drifts


def test_its_camera_sees_the_ball_where_it_is():
    """Direction, handedness, mount and tilt agree: what differs with the ball lies towards the ball."""
    house, seen = SimWorld(SimSettings(seed=5, target="red ball")), 0
    renderer, height = Renderer(house.scene), house.ball_at(0).centre[2]
    at = np.array([*house.clear_start(np.random.default_rng(5))[:2], 0.72])
    for seed in range(16):
        spot = house.ground.sample(np.random.default_rng(seed), 0.3)
        ball = Ball(np.array([*spot, height]), 0.25, "red")
        turned = world_R_body(0.7 * seed, 0.03, -0.04)
        pictures = [panorama(renderer, 128, at, turned, each) for each in (ball, None)]
        change = np.abs(pictures[0].astype(int) - pictures[1]).sum(axis=-1) > 150
        if change.sum() < 20:
            continue  # hidden, or far away
        seen += 1
        found = ErpGrid(*change.shape).directions[change].mean(axis=0)
        offset = turned.T @ (ball.centre - at)
        assert angular_distance(found, offset) < np.arctan(0.25 / np.linalg.norm(offset)), seed
    assert seen >= 2


def test_the_ball_rolls_over_the_floor_and_a_start_has_a_straight_way():
    house = SimWorld(SimSettings(seed=3, target="green ball", speed=0.5))
    path = np.array([house.ball_at(t).centre[:2] for t in np.arange(0, 20, 0.1)])
    assert all(house.ground.is_free(xy) for xy in path)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 0.055
    assert np.median(steps) == pytest.approx(0.05, abs=0.002)
    house = SimWorld(SimSettings(seed=3, target="chair"))
    assert len(house.targets) == sum(thing.category == "chair" for thing in house.things)
    start = np.array(house.clear_start(np.random.default_rng(0))[:2])
    assert min(np.linalg.norm(chair.centre[:2] - start) for chair in house.targets) <= 5.0
    assert house.ground.is_free(start)


@pytest.mark.parametrize(("settings", "error", "said"), [
    ({"target": "elephant"}, QueryError, "'elephant' names nothing known here"),
    ({"target": "pink sofa"}, QueryError, "there is no pink sofa in apartment 3 seed 7; it has .*purple sofa"),
    ({"world": "moon"}, WorldError, "there is no world 'moon'"), ({"seed": -1}, DeviceError, "seed = -1; wanted 0 or"),
    ({"world": None, "target": "sofa"}, DeviceError, "an empty floor has no target"),
    ({"start": (math.nan, 0, 0)}, DeviceError, "wanted x, y .metres. and heading .radians., finite"),
])  # fmt: skip
def test_settings_that_cannot_be_say_so(settings, error, said):
    with pytest.raises(error, match=said):
        SimulatedGo2(SimSettings(**settings))
