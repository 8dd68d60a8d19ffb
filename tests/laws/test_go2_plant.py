"""The simulated Go2's body: first order with dead time, commands that expire, a deaf window, drift, walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.robots.go2.plant import LIMP, LOCKED, LYING, STEP, WALKING, Plant
from eagor.sphere import world_R_body

few = settings(max_examples=12)
commands = st.tuples(st.floats(-2, 2), st.floats(-0.9, 0.9), st.floats(-3, 3))


def plant(seed=0, **options):
    return Plant(np.random.default_rng(seed), **options)


def run(body, seconds, command=None):
    """Let time pass, with a Move at every step if there is one; the body's motions."""
    motions = []
    for _ in range(round(seconds / STEP)):
        if command is not None:
            body.move(*command)
        body.advance()
        motions.append(body.truth)
    return motions


def yaw_of(motion):
    return math.atan2(*motion.pose.world_R_body[1::-1, 0])


@few
@given(commands)
def test_speeds_follow_the_command_as_first_order_systems_with_dead_time(command):
    """v(t) = K u (1 - exp(-(t - L) / tau)) for t > L; the closed form of the fitted model."""
    for number, motion in enumerate(run(plant(), 1.5, command), start=1):
        rise = 1 - math.exp(-max(0.0, number * STEP - 0.15) / 0.30)
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
@given(st.integers(0, 1000))
def test_after_stand_up_it_is_deaf_for_4_to_10_seconds_and_needs_balance_stand(seed):
    body = plant(seed, upright=False)
    assert body.truth.mode == LYING
    body.stand_up()
    body.balance_stand()
    run(body, 3.9, (0.5, 0, 0))
    assert body.walked == 0.0
    run(body, 6.4, (0.5, 0, 0))
    assert body.walked > 0.0
    assert body.truth.mode == WALKING
    body.stand_up()
    run(body, 10.5, (0.5, 0, 0))
    assert (body.truth.mode, np.abs(body.truth.velocity).max()) == (LOCKED, pytest.approx(0, abs=1e-9))
    body.balance_stand()
    run(body, 1.0, (0.5, 0, 0))
    assert body.truth.mode == WALKING
    body.rest(LYING)
    run(body, 1.0, (0.5, 0, 0))
    assert body.truth.mode == LYING
    body.rest(LIMP)
    body.balance_stand()
    assert body.truth.mode == LIMP


def test_odometry_drifts_per_metre_and_per_radian_as_stated():
    """Standard deviations over many robots: 2 % of the way, 1 % of the turns, 0.5 degrees after one metre."""
    ways, turns, slips = [], [], []
    for seed in range(60):
        walker, turner = plant(seed), plant(seed)
        run(walker, 2.0, (2.0, 0.0, 0.0))
        run(turner, 1.0, (0.0, 0.0, 1.0))
        said, true = (np.linalg.norm(each.pose.position[:2]) for each in (walker.odometry, walker.truth))
        ways.append(said / true - 1)
        slips.append((yaw_of(walker.odometry) - yaw_of(walker.truth)) / math.sqrt(walker.walked))
        turns.append(yaw_of(turner.odometry) / yaw_of(turner.truth) - 1)
    assert np.std(ways) == pytest.approx(0.02, rel=0.2)
    assert np.std(turns) == pytest.approx(0.01, rel=0.2)
    assert math.degrees(np.std(slips)) == pytest.approx(0.5, rel=0.2)


def test_walls_stop_the_body_and_its_speed_says_so():
    body = plant(slide=lambda start, step: np.minimum(start + step, (1.0, np.inf)))
    last = run(body, 6.0, (0.5, 0.0, 0.0))[-1]
    assert (last.pose.position[0], last.velocity[0], last.mode) == (1.0, 0.0, WALKING)  # it walks on the spot
