"""A simulated Go2 in a house: repeatable on its own clock, and the same on DDS with its camera."""

from __future__ import annotations

import io
import json
import math
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from processes import alive, sessions_of, wait_for

from eagor.errors import DeviceError, QueryError, WorldError
from eagor.grids import ErpGrid
from eagor.lab.worlds.render import Ball
from eagor.media import Frame, Pose
from eagor.metrics import angular_error_deg
from eagor.robots.dds import Link, free_domain
from eagor.robots.go2.house import BALL_ID, CAMERA_TOPIC, CameraSettings, load_house
from eagor.robots.go2.plant import PlantSettings
from eagor.robots.go2.sim import TRUTH_THINGS, LiveGo2, SimSettings, SimulatedGo2
from eagor.robots.go2.sim_wire import TRUTH, WireSettings
from eagor.robots.go2.sport import SportClient
from eagor.robots.go2.state import BodyState, Go2State
from eagor.sphere import world_R_body

live = pytest.mark.xdist_group("real time")

SMALL = CameraSettings(rows=32, rate=5.0, latency=0.15)


def walk(robot, seconds=2.0):
    came = []
    for _ in range(round(seconds / 0.1)):
        assert robot.move(0.4, 0.0, 0.5) == 0
        came += robot.advance(0.1)
    return came


def test_the_same_seed_gives_the_same_run_with_pictures_when_they_arrive():
    settings = SimSettings(target="blue ball", speed=0.3, camera=SMALL, wire=WireSettings(drop=0.05, delay=(0, 0.02)))
    robots = [SimulatedGo2(settings, begun=1000.0) for _ in range(2)]
    one, two = (walk(robot) for robot in robots)
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        assert (type(a), a.stamp) == (type(b), b.stamp)
        if isinstance(a, Frame):
            np.testing.assert_array_equal(a.picture, b.picture)
        else:
            np.testing.assert_array_equal(a.position, b.position)
    frames = [each for each in one if isinstance(each, Frame)]
    states = [each for each in one if isinstance(each, BodyState)]
    assert 7 <= len(frames) <= 10
    assert 350 <= len(states) < 400  # some are lost
    # Both arrive later than they were made: pictures by the camera's latency, states by the wire's delay.
    order = [(each.stamp, isinstance(each, Frame)) for each in one]
    for at, (stamp, is_frame) in enumerate(order):
        if is_frame:
            newest = max(s for s, frame in order[:at] if not frame)
            assert newest - stamp == pytest.approx(0.15, abs=0.03)


def test_states_are_the_odometry_and_the_truth_is_beside():
    robot = SimulatedGo2(
        SimSettings(world=None, plant=PlantSettings(scale_drift=0.1), wire=WireSettings(clock_offset=99))
    )
    states = walk(robot, 3.0)
    assert all(isinstance(state, BodyState) for state in states)
    assert states[-1].stamp == pytest.approx(robot.now, abs=0.01)
    assert states[-1].robot_stamp == pytest.approx(robot.now + 99, abs=0.01)
    believed, true = states[-1].position, robot.truth.pose.position
    assert np.linalg.norm(believed - true) > 0.002
    np.testing.assert_allclose(believed, robot.plant.odometry.pose.position, atol=1e-6)


@pytest.mark.parametrize("kind", ["erp", "fisheye"])
def test_its_camera_sees_the_ball_where_it_is(kind):
    """Direction, handedness, mount, tilt and stitching agree: what differs with the ball lies towards the ball."""
    camera = CameraSettings(kind=kind, rows=128, latency=0.0)
    robot = SimulatedGo2(SimSettings(seed=5, target="red ball", camera=camera))
    ground, height, seen = robot.house.ground, robot.house.ball.at(0).centre[2], 0
    for seed in range(16):
        spot = ground.sample(np.random.default_rng(seed), 0.3)
        ball = Ball(np.array([*spot, height]), 0.25, "red")
        pose = Pose(0.0, world_R_body(0.7 * seed, 0.03, -0.04), np.array([*robot.truth.pose.position[:2], 0.72]))
        pictures = [robot.camera.received(robot.camera.picture(pose, each)) for each in (ball, None)]
        change = np.abs(pictures[0].astype(int) - pictures[1]).sum(axis=-1) > 150
        if change.sum() < 20:
            continue  # hidden, or far away
        seen += 1
        found = ErpGrid(*change.shape).directions[change].mean(axis=0)
        offset = pose.world_R_body.T @ (ball.centre - pose.position)
        aside = angular_error_deg((found / np.linalg.norm(found))[None], (offset / np.linalg.norm(offset))[None])[0]
        assert aside < np.degrees(np.arctan(0.25 / np.linalg.norm(offset))), (seed, aside)
    assert seen >= 2


def test_the_house_keeps_its_robot_inside_and_names_its_things():
    house = load_house("apartment", 3, ball="green", speed=0.5, rng=np.random.default_rng(0))
    assert {thing.id for thing in house.targets("green ball")} == {BALL_ID}
    assert len(house.targets("chair")) == sum(thing.category == "chair" for thing in house.things())
    for seconds in (0.0, 7.3, 2.0, 40.0):
        assert house.ground.is_free(house.things(seconds)[-1].centre[:2])
    path = np.array([house.ball.at(t).centre[:2] for t in np.arange(0, 20, 0.1)])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 0.055
    assert np.median(steps) == pytest.approx(0.05, abs=0.002)
    robot = SimulatedGo2(SimSettings(seed=3, camera=None))
    for _ in range(100):
        robot.move(1.5, 0.3, 0.3)
        robot.advance(0.1)
        assert robot.house.ground.is_free(robot.truth.pose.position[:2])


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"target": "elephant"}, QueryError, "'elephant' names nothing known here"),
        ({"target": "pink sofa"}, QueryError, "there is no pink sofa in apartment 2 seed 7; it has .*green sofa"),
        ({"target": "pink ball"}, QueryError, "there is no pink ball; balls are blue, green, red, yellow"),
        ({"world": "moon"}, WorldError, "there is no world 'moon'"),
        ({"seed": -1}, (WorldError, ValueError), "-1|non-negative"),
        ({"world": None, "target": "sofa"}, DeviceError, "an empty floor has no target"),
    ],
)
def test_settings_that_cannot_be_say_so(settings, error, said):
    with pytest.raises(error, match=said):
        SimulatedGo2(SimSettings(**settings))


@pytest.mark.parametrize("wrong", [{"rows": 33}, {"rate": 0}, {"latency": -1}, {"kind": "pinhole"}, {"quality": 0}])
def test_cameras_that_cannot_be_are_refused(wrong):
    with pytest.raises(DeviceError, match=next(iter(wrong))):
        CameraSettings(**wrong)


@pytest.mark.slow
@live
def test_live_it_walks_sends_pictures_and_tells_the_truth_beside():
    domain, frames, truths, things = free_domain(), [], [], []
    robot = SimulatedGo2(SimSettings(target="red ball", speed=0.3, camera=SMALL))
    with LiveGo2(robot, domain, "lo") as live, Link(domain, "lo") as link:
        live.wait_for_camera()
        state, client = Go2State(link), SportClient(link, timeout=20.0)
        kind = "sensor_msgs/msg/CompressedImage"
        link.subscribe(CAMERA_TOPIC, kind, lambda message, when: frames.append((message, when)))
        link.subscribe(TRUTH, "nav_msgs/msg/Odometry", lambda message, when: truths.append(message))
        text = "std_msgs/msg/String"
        link.subscribe(TRUTH_THINGS, text, lambda message, when: things.append(message.data), transient=True)
        assert client.wait(20)
        while len(frames) < 4 or not truths or not things:
            assert client.move(0.3, 0.0, 0.3) == 0
            state.wait(20)
            wait_for(lambda: live.server.plant.steps % 20 == 0)
        with pytest.raises(DeviceError, match=f"a robot already speaks on DDS domain {domain} on lo"):
            LiveGo2(SimulatedGo2(SimSettings(world=None)), domain, "lo")
    message, when = frames[0]
    picture = np.asarray(Image.open(io.BytesIO(bytes(message.data))))
    assert picture.shape == (32, 64, 3)
    assert picture.std() > 10
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    assert when - stamp >= 0.15 - 1e-3
    told = json.loads(things[-1])
    assert (told["target"], told["targets"]) == ("red ball", [BALL_ID])
    (ball,) = [each for each in told["things"] if each["id"] == BALL_ID]
    assert (ball["category"], ball["colour"], len(ball["position"])) == ("ball", "red", 3)
    assert truths[-1].header.frame_id == "world"
    assert robot.plant.walked > 0
    assert live.pictures is None  # its process has ended


@pytest.mark.slow
@live
def test_nothing_stays_behind_whatever_ends_it(tmp_path):
    code = f"""
import sys, time
from eagor.robots.go2.house import CameraSettings
from eagor.robots.go2.sim import *
if __name__ == "__main__":
    with LiveGo2(SimulatedGo2(SimSettings(seed=3, camera=CameraSettings(rows=16))), {free_domain()}, "lo") as live:
        live.wait_for_camera()
        print("ready", flush=True)
        time.sleep(600)
"""
    script = tmp_path / "robot.py"
    script.write_text(code, encoding="utf-8")
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, start_new_session=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        sessions = sessions_of(process.pid)
        assert len(alive(sessions)) >= 2
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    wait_for(lambda: not alive(sessions))


def test_bearings_are_from_the_camera():
    robot = SimulatedGo2(SimSettings(start=(0, 0, 0), seed=7, target="green sofa"))
    (sofa,) = robot.targets_now()
    direction, distance = robot.bearing(sofa)
    pose = robot.truth.pose
    camera = pose.position + np.array([0, 0, 0.4])
    np.testing.assert_allclose(pose.world_R_body @ direction * distance + camera, sofa.centre)
    assert math.isclose(np.linalg.norm(direction), 1.0)
