"""Odometry is interpolated between its poses: how far that is off is known from how the rates of turning change."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from eagor.sources import Pose
from eagor.sources import ros_messages as m
from eagor.sources.ros_frames import TOLERATED, PoseReader, Turning
from eagor.sphere import interpolate_rotation, world_R_body

FINE = 0.005  # seconds between two steps of the truth


def walk(density, seconds, seed, axes=(0.0, 0.0, 1.0)):
    """Rotations `FINE` seconds apart of a body whose rate about `axes` is a random walk (rad/s per root second)."""
    rng = np.random.default_rng(seed)
    rate = np.cumsum(rng.normal(size=int(seconds / FINE)) * math.sqrt(density * FINE))
    rate = np.abs((rate + 2) % 8 - 4) - 2  # it stays within 2 rad/s
    return Rotation.from_rotvec(np.outer(np.cumsum(rate) * FINE, axes))


@pytest.mark.parametrize("density", [0.05, 2.0])
@pytest.mark.parametrize("gap", [0.05, 0.1, 0.5])
@pytest.mark.parametrize("axes", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_the_error_between_poses_is_as_large_as_is_said(density, gap, axes):
    """Midway between every two poses, against the truth; the figure is that of the newest poses, so it is averaged."""
    truth, step = walk(density, 600 * gap, 3, axes), round(gap / FINE)
    knots = np.arange(0, len(truth) - step, step)
    turning, said = Turning(), []
    for number in knots:
        turning.add(Pose(number * FINE, truth[number].as_matrix()))
        said.append(turning.midway)
    slerp = Slerp(knots * FINE, truth[knots])
    middle = knots[:-1] + step // 2
    errors = (slerp(middle * FINE).inv() * truth[middle]).magnitude()
    share = math.sqrt(np.mean(np.square(said[20:]))) / math.sqrt(np.mean(errors**2))
    assert 0.8 < share < 1.25, share


def test_a_steady_turn_is_exact_however_fast_and_a_pause_changes_nothing():
    turning = Turning()
    for number in range(100):
        stamp = 0.5 * number + (20.0 if number > 50 else 0.0)
        turning.add(Pose(stamp, world_R_body(math.remainder(1.5 * stamp, math.tau))))
    assert turning.midway < 1e-6


def test_odometry_that_is_too_slow_for_how_a_robot_moves_is_a_problem_and_faster_one_is_none():
    """It swings left and right every two seconds, at up to 90 degrees per second."""

    def pose(stamp):
        return world_R_body(0.5 * math.sin(math.pi * stamp + 0.3))

    told = {}
    for rate in (2.0, 10.0, 20.0):
        reader, errors = PoseReader("/odom", m.ODOMETRY), []
        for number in range(100):
            stamp = number / rate
            reader.take(m.odometry_message(Pose(100.0 + stamp, pose(stamp), np.zeros(3))))
            middle = interpolate_rotation(pose(stamp), pose(stamp + 1 / rate), 0.5)
            errors.append(math.dist(middle[:, 0], pose(stamp + 0.5 / rate)[:, 0]))
        assert reader.turning.midway == pytest.approx(math.sqrt(np.mean(np.square(errors))), rel=0.5)
        told[rate] = reader.problem, reader.turning.midway
    assert told[20.0][0] is None
    assert told[10.0][0] is None
    assert "/odom tells a pose every 0.50 s, too seldom for how the turning changes" in told[2.0][0]
    assert told[2.0][1] > TOLERATED > told[10.0][1] > told[20.0][1]
