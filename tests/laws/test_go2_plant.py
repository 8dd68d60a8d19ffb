"""The simulated Go2's body: first order with dead time, commands that expire, a deaf window, drift, walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from eagor.errors import DeviceError
from eagor.robots.go2.plant import (
    LIMP,
    LOCKED,
    LYING,
    WALKING,
    Plant,
    PlantSettings,
    _turned,
)
from eagor.sphere import check_rotation, world_R_body

STEP = 0.005
few = settings(max_examples=12)
commands = st.tuples(st.floats(-2, 2), st.floats(-0.9, 0.9), st.floats(-3, 3))


def plant(seed=0, start=(0.0, 0.0, 0.0), slide=None, **settings):
    return Plant(PlantSettings(step=STEP, **settings), np.random.default_rng(seed), start, slide)


def run(body, seconds, command=None):
    """Let time pass, with a Move at every step if there is one; the body's motions."""
    motions = []
    for _ in range(round(seconds / STEP)):
        if command is not None:
            body.move(*command)
        body.advance()
        motions.append(body.truth)
    return motions


@few
@given(commands, st.sampled_from([0.1, 0.3, 0.6]), st.sampled_from([0.0, 0.15, 0.3]))
def test_speeds_follow_the_command_as_first_order_systems_with_dead_time(command, lag, dead):
    """v(t) = K u (1 - exp(-(t - L) / tau)) for t > L; the closed form of the fitted model."""
    body = plant(lag=lag, dead_time=dead)
    for number, motion in enumerate(run(body, 1.5, command), start=1):
        t = number * STEP - round(dead / STEP) * STEP
        rise = 0.0 if t <= 0 else 1 - math.exp(-t / lag)
        yaw = math.atan2(*motion.pose.world_R_body[1::-1, 0])
        c, s = math.cos(yaw - motion.yaw_rate * STEP / 2), math.sin(yaw - motion.yaw_rate * STEP / 2)
        forward = c * motion.velocity[0] + s * motion.velocity[1]
        left = c * motion.velocity[1] - s * motion.velocity[0]
        wanted = np.array(command) * (0.80, 0.74, 0.90) * rise
        np.testing.assert_allclose((forward, left, motion.yaw_rate), wanted, atol=0.05)  # it leans, so yaw is not exact
        assert motion.yaw_rate == pytest.approx(wanted[2], abs=1e-9)


def test_one_move_holds_for_a_second_and_ends_by_itself():
    body = plant(expiry=1.0, dead_time=0.15)
    body.move(0.5, 0.0, 0.0)
    speeds = [float(np.hypot(*motion.velocity[:2])) for motion in run(body, 4.0)]
    assert speeds[round(1.1 / STEP)] > 0.35
    assert speeds[-1] < 1e-4
    assert int(np.argmax(speeds)) + 1 == pytest.approx((1.0 + 0.15) / STEP, abs=1)


@few
@given(st.integers(0, 1000), st.tuples(st.floats(0.5, 3), st.floats(3, 6)))
def test_after_stand_up_it_is_deaf_for_a_while_and_needs_balance_stand(seed, deaf):
    body = plant(seed, upright=False, deaf=deaf)
    assert body.truth.mode == LYING
    run(body, 0.5, (0.5, 0, 0))
    assert body.walked == 0.0
    body.stand_up()
    assert body.truth.mode == LOCKED
    run(body, deaf[0] - 0.1, (0.5, 0, 0))
    assert body.walked == 0.0
    run(body, deaf[1], (0.5, 0, 0))
    assert body.walked == 0.0  # its joints are locked
    body.balance_stand()
    run(body, 1.0, (0.5, 0, 0))
    assert body.walked > 0.1
    assert body.truth.mode == WALKING
    body.stand_down()
    run(body, 1.0, (0.5, 0, 0))
    assert body.truth.mode == LYING
    body.damp()
    body.balance_stand()
    assert body.truth.mode == LIMP


@few
@given(commands)
def test_it_rocks_by_two_degrees_three_times_a_second_while_it_walks_only(command):
    body = plant()
    run(body, 2.0)
    assert body.truth.pose.world_R_body[2, 2] == 1.0
    motions = run(body, 4.0, command)
    if np.abs(command).max() < 0.1:
        return
    roll = np.array([math.atan2(*motion.pose.world_R_body[2, 1:]) for motion in motions[-400:]])  # two seconds
    assert math.degrees(np.abs(roll).max()) == pytest.approx(2.0, abs=0.05)
    assert int((np.diff(np.sign(roll)) > 0).sum()) in (5, 6, 7)


@few
@given(commands, st.integers(0, 1000))
def test_the_poses_are_rotations_and_the_gyroscope_tells_how_they_turn(command, seed):
    body = plant(seed)
    before = body.truth.pose.world_R_body
    for motion in run(body, 1.0, command)[::20]:
        check_rotation(motion.pose.world_R_body)
    for _ in range(20):
        before = body.truth.pose.world_R_body
        body.advance()
        motion = body.truth
        turn = Rotation.from_rotvec(STEP * motion.rates).as_matrix()
        np.testing.assert_allclose(before @ turn, motion.pose.world_R_body, atol=1e-5)


@few
@given(st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_turned_is_world_R_body(yaw, pitch, roll):
    np.testing.assert_allclose(_turned(roll, pitch, yaw), world_R_body(yaw, pitch, roll), atol=1e-12)


def test_odometry_drifts_per_metre_and_per_radian_as_stated():
    """Standard deviations over many robots: 2 % of the way, 1 % of the turns, 0.5 degrees after one metre."""
    ways, turns, slips = [], [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        body = Plant(PlantSettings(step=0.05, tilt=0.0), rng)
        for _ in range(100):
            body.move(0.5, 0.0, 0.0)
            body.advance()
        true, said = body.truth.pose, body.odometry.pose
        ways.append(np.linalg.norm(said.position[:2]) / np.linalg.norm(true.position[:2]) - 1)
        slips.append(math.atan2(*said.world_R_body[1::-1, 0]) / math.sqrt(body.walked))
        turner = Plant(PlantSettings(step=0.05, tilt=0.0), np.random.default_rng(seed))
        for _ in range(40):
            turner.move(0.0, 0.0, 1.0)
            turner.advance()
        yaws = [math.atan2(*m.pose.world_R_body[1::-1, 0]) for m in (turner.odometry, turner.truth)]
        turns.append(yaws[0] / yaws[1] - 1)
    assert np.std(ways) == pytest.approx(0.02, rel=0.2)
    assert np.std(turns) == pytest.approx(0.01, rel=0.2)
    assert math.degrees(np.std(slips)) == pytest.approx(0.5, rel=0.2)


def test_without_drift_odometry_is_the_truth():
    body = plant(scale_drift=0, turn_drift=0, yaw_drift=0, start=(1.0, 2.0, 0.5))
    run(body, 3.0, (0.6, 0.2, 0.8))
    np.testing.assert_allclose(body.odometry.pose.position, body.truth.pose.position, atol=1e-12)
    np.testing.assert_allclose(body.odometry.velocity, body.truth.velocity, atol=1e-12)


def test_walls_stop_the_body_and_its_speed_says_so():
    def slide(start, step):
        return np.minimum(start + step, (1.0, np.inf))

    body = plant(slide=slide, tilt=0.0)
    motions = run(body, 6.0, (0.5, 0.0, 0.0))
    assert motions[-1].pose.position[0] == 1.0
    assert motions[-1].velocity[0] == 0.0
    assert motions[-1].mode == WALKING  # it walks on the spot


@pytest.mark.parametrize(
    "wrong", [{"lag": 0.0}, {"step": 1.0}, {"deaf": (5, 4)}, {"yaw_drift": -1}, {"trot": math.nan}]
)
def test_bodies_that_cannot_be_are_refused(wrong):
    with pytest.raises(DeviceError, match=next(iter(wrong))):
        PlantSettings(**wrong)
