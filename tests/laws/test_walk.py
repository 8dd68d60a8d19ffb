"""A simulated walk as a source: it keeps the contract of cameras, and its body moves as it is steered."""

import math
import time

import numpy as np
import pytest

from eagor.errors import DeviceError
from eagor.lab.envs.place_env import MobileBase
from eagor.lab.envs.rules import Camera
from eagor.lab.tasks.sim.walk import Walker
from eagor.live.loop import Sink
from eagor.sources import check_camera
from eagor.sources.camera_sources import open_source
from eagor.sources.odometry import open_poses
from eagor.sphere import angular_distance

AHEAD = np.array([1.0, 0.0, 0.0])


class Hall:
    """An empty floor, with a wall at x = 1."""

    def move(self, xy, step, slide=True):
        there = xy + step
        return np.array([min(there[0], 1.0), there[1]]), there[0] > 1.0

    def height(self, xy):
        return 0.0


def walker_at(x, *how):
    return Walker(MobileBase(Hall(), np.array([x, 0.0]), 0.0), *how)


def test_the_person_steers_and_cannot_be_faster_than_allowed():
    walker = walker_at(0.0, "person")
    walker.move(60.0, AHEAD, False)
    assert walker.body.xy.tolist() == [0, 0], "nothing is steered"
    walker.steer(100.0, 0.0, 0.1)
    assert 0 < walker.body.xy[0] <= 0.2
    for _ in range(20):
        walker.steer(100.0, 0.0, 0.1)
    assert walker.body.xy[0] == 1.0
    walker.steer(0.0, 1.0, 0.4)
    assert walker.body.yaw == pytest.approx(0.4), "as far as the key was held, however late that is read"
    walker.drive("policy")
    walker.steer(100.0, 1.0, 0.5)  # a late message
    assert walker.body.yaw == pytest.approx(0.4)


def test_the_policy_walks_to_the_answer_without_a_leap_and_stops_on_arrival():
    walker = walker_at(-4.0)
    walker.move(60.0, AHEAD, False)  # a late tick
    assert -4.0 < walker.body.xy[0] < -3.5
    for _ in range(100):
        walker.move(0.1, np.array([math.cos(walker.body.yaw), -math.sin(walker.body.yaw), 0.0]), False)
    assert walker.body.xy[0] > -2.0
    there = walker.body.xy.tolist()
    walker.move(0.1, AHEAD, True)
    assert walker.body.xy.tolist() == there
    walker.move(0.1, None, False)  # nothing is known: it looks around
    assert walker.body.yaw != 0.0


def test_a_tour_waits_for_an_answer_stops_at_its_end_and_comes_back():
    walker = walker_at(0.0, "tour", [np.array([-1.0, 0.0]), np.array([-1.0, 0.0]), np.zeros(2)])
    walker.move(0.5, None, False)
    assert walker.body.xy.tolist() == [0, 0]
    reached, stood = False, 0
    for _ in range(200):
        before = walker.body.xy.copy()
        walker.move(0.1, AHEAD, False)
        reached |= walker.body.xy[0] < -0.99
        stood += reached and np.array_equal(before, walker.body.xy) and walker.body.xy[0] < -0.99
    assert reached
    assert stood >= 50
    assert walker.body.xy == pytest.approx([0, 0], abs=0.06)


@pytest.fixture
def walk():
    found = open_source("apartment:2?drive=person", rows=64)
    yield found
    found.close()


def test_it_keeps_the_contract_of_cameras_and_gives_its_own_poses_and_hears_the_answers():
    walk = open_source("apartment:2", rows=64)
    assert isinstance(walk, Sink)
    poses = iter(open_poses("auto", walk))
    first, then = next(poses), next(poses)
    assert then.stamp > first.stamp
    assert then.position[2] == pytest.approx(Camera().height, abs=0.05)
    check_camera(walk, frames=2)
    assert list(poses) == []  # it is closed


def test_its_truth_is_where_the_thing_is_and_unknown_words_have_none(walk):
    thing = walk.place.scene.instances[walk._named("bed")[0]]
    truth, goal = walk.truth("bed", np.eye(3))
    away = np.asarray(thing.centre) - walk.walker.body.pose.position
    assert angular_distance(truth, away / np.linalg.norm(away)) < 1e-6
    assert goal["metres"] > 0
    assert thing.name in walk.targets("bed")
    assert walk.truth("unicorn", np.eye(3)) == (None, None)


def test_time_stands_still_while_it_is_paused(walk):
    walk.pause(True)
    now = walk.clock.now()
    walk.drive("person", forward=0.5, seconds=0.5)
    time.sleep(0.05)
    assert walk.clock.now() == now
    walk.step()
    assert walk.step() is None
    walk.pause(False)
    time.sleep(0.01)
    assert now < walk.clock.now() < now + 0.05
    before = walk.step().world_R_body[:, 0]
    walk.drive("person", forward=0.5, turn=2.0, seconds=0.5)
    assert not np.array_equal(walk.step().world_R_body[:, 0], before)


@pytest.mark.parametrize("text", ["x", "10000", "7?drive=fast", "7?seed=3"])
def test_what_is_no_apartment_is_refused_with_what_was_wanted(text):
    with pytest.raises(DeviceError, match="wanted apartment:SEED"):
        open_source(f"apartment:{text}")
