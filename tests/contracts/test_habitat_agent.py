"""Our policy as habitat-lab's agent: a flat of ours gives what its sensors would, and its actions move the body."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from rooms import two_rooms

from eagor.errors import EagorError
from eagor.grids import ErpGrid
from eagor.lab.agents.habitat import CAMERA, HabitatAgent, categories_of
from eagor.lab.envs.places import Place
from eagor.lab.worlds import ground_of, view_of
from eagor.perception.colour import ColourPerception
from eagor.sphere import world_R_body

ROWS, START, YAW = 96, np.array([7.0, 3.6]), 0.4  # in the bedroom; the red chair stands in the other room
CUBE = np.abs(ErpGrid(ROWS, 2 * ROWS).directions).max(axis=-1)  # from a range to a depth along the axis of its face
TURNS = {"turn_left": math.radians(30), "turn_right": -math.radians(30)}


@pytest.fixture(scope="module")
def flat():
    scene = two_rooms()
    return Place(scene, ground_of(scene, CAMERA.radius), view_of(scene))


def observed(flat, xy, yaw, goal=0):
    frame = flat.renderer.panorama(flat.eye(xy, CAMERA.height), world_R_body(yaw), ROWS, ids=False)
    ahead, left = world_R_body(YAW).T[:2, :2] @ (xy - START)
    depth = np.where(np.isfinite(frame.range), frame.range, 0) * CUBE
    return {
        "rgb": frame.rgb, "depth": depth[..., None], "gps": np.array([ahead, -left]),
        "compass": np.array([math.remainder(yaw - YAW, math.tau)]), "objectgoal": np.array([goal]),
    }  # fmt: skip


def walked(flat, agent, steps=150, change=lambda observations: observations):
    xy, yaw, actions = START, YAW, []
    agent.reset()
    while len(actions) < steps and "stop" not in actions:
        actions.append(agent.act(change(observed(flat, xy, yaw)))["action"])
        yaw += TURNS.get(actions[-1], 0.0)
        if actions[-1] == "move_forward":
            xy, _ = flat.ground.move(xy, CAMERA.step * np.array([math.cos(yaw), math.sin(yaw)]), slide=False)
    return xy, actions


def test_it_searches_goes_there_and_stops(flat):
    agent = HabitatAgent(ColourPerception(), ["red"])
    xy, actions = walked(flat, agent)
    assert actions[-1] == "stop"
    assert set(actions) <= {"stop", "move_forward", *TURNS}
    chair = next(
        k for k, thing in enumerate(flat.scene.instances) if (thing.category, thing.colour) == ("chair", "red")
    )
    assert float(flat.way_to((chair,)).distance(xy)) < 1.0
    scaled = HabitatAgent(ColourPerception(), ["red"], depth_range=10.0)
    found = walked(flat, scaled, 8, lambda seen: seen | {"depth": seen["depth"] / 10.0})
    assert found[1] == actions[:8], "depth as a share of ten metres is the same depth"
    assert walked(flat, agent, 8)[1] == actions[:8], "nothing is left of the last episode"


def test_a_sensor_that_lacks_is_named(flat):
    seen = observed(flat, START, YAW)
    del seen["compass"], seen["depth"]
    with pytest.raises(EagorError, match="no compass, depth; add these sensors"):
        HabitatAgent(ColourPerception(), ["red"]).act(seen)


def test_the_words_of_goals_are_in_the_order_of_their_numbers():
    numbers = {"tv_monitor": 1, "chair": 0, "chest_of_drawers": 2}
    task = SimpleNamespace(_dataset=SimpleNamespace(category_to_task_category_id=numbers))
    assert categories_of(SimpleNamespace(task=task)) == ["chair", "tv", "chest of drawers"]
