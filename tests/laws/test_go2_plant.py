"""The simulated Go2's body: first order with dead time, commands that expire, a deaf window, drift, walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from eagor.errors import DeviceError
from eagor.robots.go2.plant import LIMP, LOCKED, LYING, WALKING, Plant, PlantSettings
from eagor.sphere import world_R_body

STEP = 0.005
few = settings(max_examples=12)
commands = st.tuples(st.floats(-2, 2), st.floats(-0.9, 0.9), st.floats(-3, 3))


def plant(seed=0, start=(0.0, 0.0, 0.0), slide=np.add, **settings):
    return Plant(PlantSettings(**{"step": STEP, **settings}), np.random.default_rng(seed), start, slide)


def run(body, seconds, command=None):
    """Let time pass, with a Move at every step if there is one; the body's motions."""
    motions = []
    for _ in range(round(seconds / body.settings.step)):
        if command is not None:
            body.move(*command)
        body.advance()
        motions.append(body.truth)
    return motions


def yaw_of(motion):
    return math.atan2(*motion.pose.world_R_body[1::-1, 0])


@few
@given(commands, st.sampled_from([0.1, 0.3, 0.6]), st.sampled_from([0.0, 0.15, 0.3]))
def test_speeds_follow_the_command_as_first_order_systems_with_dead_time(command, lag, dead):
    """v(t) = K u (1 - exp(-(t - L) / tau)) for t > L; the closed form of the fitted model."""
    body = plant(lag=lag, dead_time=dead)
    for number, motion in enumerate(run(body, 1.5, command), start=1):
        t = number * STEP - round(dead / STEP) * STEP
        rise = 0.0 if t <= 0 else 1 - math.exp(-t / lag)
        middle = world_R_body(yaw_of(motion) - motion.yaw_rate * STEP / 2, 0.0, 0.0)
        wanted = np.array(command) * (0.80, 0.74, 0.90) * rise
        np.testing.assert_allclose((middle.T @ motion.velocity)[:2], wanted[:2], atol=0.05)  # it leans: not exact
        assert motion.yaw_rate == pytest.approx(wanted[2], abs=1e-9)


def test_one_move_holds_for_a_second_and_ends_by_itself():
    body = plant()
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
def test_the_poses_are_those_of_its_angles_and_the_gyroscope_tells_how_they_turn(command, seed):
    body = plant(seed)
    before = body.truth
    for motion in run(body, 1.0, command):
        turned = motion.pose.world_R_body
        np.testing.assert_allclose(turned, world_R_body(*motion.rpy[::-1]), atol=1e-12)
        turn = Rotation.from_rotvec(STEP * motion.rates).as_matrix()
        np.testing.assert_allclose(before.pose.world_R_body @ turn, turned, atol=1e-5)
        before = motion


def test_odometry_drifts_per_metre_and_per_radian_as_stated():
    """Standard deviations over many robots: 2 % of the way, 1 % of the turns, 0.5 degrees after one metre."""
    ways, turns, slips = [], [], []
    for seed in range(200):
        walker, turner = (plant(seed, step=0.05, tilt=0.0) for _ in range(2))
        run(walker, 5.0, (0.5, 0.0, 0.0))
        run(turner, 2.0, (0.0, 0.0, 1.0))
        said, true = (np.linalg.norm(each.pose.position[:2]) for each in (walker.odometry, walker.truth))
        ways.append(said / true - 1)
        slips.append(yaw_of(walker.odometry) / math.sqrt(walker.walked))
        turns.append(yaw_of(turner.odometry) / yaw_of(turner.truth) - 1)
    assert np.std(ways) == pytest.approx(0.02, rel=0.2)
    assert np.std(turns) == pytest.approx(0.01, rel=0.2)
    assert math.degrees(np.std(slips)) == pytest.approx(0.5, rel=0.2)


def test_without_drift_odometry_is_the_truth():
    body = plant(scale_drift=0, turn_drift=0, yaw_drift=0, start=(1.0, 2.0, 0.5))
    run(body, 3.0, (0.6, 0.2, 0.8))
    np.testing.assert_allclose(body.odometry.pose.position, body.truth.pose.position, atol=1e-12)
    np.testing.assert_allclose(body.odometry.velocity, body.truth.velocity, atol=1e-12)


def test_walls_stop_the_body_and_its_speed_says_so():
    body = plant(slide=lambda start, step: np.minimum(start + step, (1.0, np.inf)), tilt=0.0)
    last = run(body, 6.0, (0.5, 0.0, 0.0))[-1]
    assert (last.pose.position[0], last.velocity[0], last.mode) == (1.0, 0.0, WALKING)  # it walks on the spot


@pytest.mark.parametrize(
    "wrong", [{"lag": 0.0}, {"step": 1.0}, {"deaf": (5, 4)}, {"yaw_drift": -1}, {"tilt": math.nan}]
)
def test_bodies_that_cannot_be_are_refused(wrong):
    with pytest.raises(DeviceError, match=next(iter(wrong))):
        PlantSettings(**wrong)
