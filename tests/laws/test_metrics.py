"""Laws and closed forms of the metrics: what a perfect run scores, what a wrong sign would score."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor import metrics
from eagor.errors import DirectionError, EagorError, RotationError
from eagor.sphere import direction, rotation, unit, world_R_body

seeds = st.integers(0, 2**32 - 1)
FORWARD, LEFT, UP = np.eye(3)


def walk(rng, steps=8, turning=True):
    """Poses, positions, and the true bearings and ranges of a target that stands still."""
    if turning:
        poses = np.stack([world_R_body(*rng.uniform(-np.pi, np.pi, 3)) for _ in range(steps)])
    else:
        poses = np.repeat(world_R_body(*rng.uniform(-1, 1, 3))[None], steps, axis=0)
    positions = np.cumsum(rng.normal(0, 0.5, (steps, 3)), axis=0)
    target = unit(rng.normal(size=3)) * 30.0
    seen = np.einsum("kji,kj->ki", poses, target - positions)
    return poses, positions, unit(seen), np.linalg.norm(seen, axis=1)


# Angles


def test_angular_error_closed_forms():
    estimates = np.array([FORWARD, LEFT, -FORWARD, FORWARD + LEFT])
    np.testing.assert_allclose(metrics.angular_error_deg(estimates, FORWARD), [0, 90, 180, 45], atol=1e-12)
    assert metrics.angular_error_deg(FORWARD, UP) == pytest.approx(90)


@pytest.mark.parametrize(
    "bad", [np.zeros((0, 3)), [1.0, 0.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], np.ones((4, 3)), np.ones(())]
)
def test_angular_error_refuses_what_is_no_direction(bad):
    with pytest.raises(DirectionError):
        metrics.angular_error_deg(np.ones((5, 3)), bad)


# Means over parts of a run


def test_mean_error():
    assert metrics.mean_error([1, 2, 30, 50], [False, False, True, True]) == 40.0
    assert metrics.mean_error([1, 2], [False, False]) is None
    assert metrics.mean_error([1, 2]) == 1.5
    with pytest.raises(EagorError, match="errors has 3, where has 2"):
        metrics.mean_error([1, 2, 3], [True, False])
    with pytest.raises(EagorError, match="NaN"):
        metrics.mean_error([1, np.nan], [True, False])
    with pytest.raises(EagorError, match="empty"):
        metrics.mean_error([])
    with pytest.raises(EagorError, match="booleans"):
        metrics.mean_error([1, 2], [0.5, 0])


# The seam


def test_seam_is_behind_and_not_in_front():
    bearings = np.radians([170, -170, -10, 10, 90, 179.9, -179.9, 179.9, 179.8])
    crossed = metrics.seam_crossings(direction(bearings, np.zeros(9)))
    assert crossed.tolist() == [False, True, False, False, False, False, True, True, False]


def test_standing_exactly_on_the_seam_counts_once():
    through = np.array([[-1, 0.1, 0], [-1, 0.0, 0], [-1, -0.1, 0], [-1, 0.0, 0], [-1, 0.1, 0]])
    assert metrics.seam_crossings(through).tolist() == [False, False, True, True, False]
    in_front = through * [-1, 1, 1]
    assert not metrics.seam_crossings(in_front).any()


azimuths = st.lists(st.floats(-180, 180), min_size=1, max_size=20)


@given(azimuths, st.floats(-80, 80), st.floats(-80, 80))
def test_seam_crossings_are_where_the_short_way_round_wraps(degrees, low, high):
    # Away from the two meridians where the side of a rounded y is a matter of taste, and from half turns.
    azimuth = np.radians([a for a in degrees if 1e-6 < abs(a) < 180 - 1e-6] or [1.0])
    jump = np.abs(np.diff(azimuth))
    elevation = np.radians(np.where(np.arange(len(azimuth)) % 2, low, high))
    clear = np.abs(jump - np.pi) > 1e-6
    crossed = metrics.seam_crossings(direction(azimuth, elevation))
    np.testing.assert_array_equal(crossed[1:][clear], (jump > np.pi)[clear])
    mirrored = metrics.seam_crossings(direction(-azimuth, elevation))
    np.testing.assert_array_equal(mirrored[1:][clear], crossed[1:][clear])
    assert not crossed[0]


# Consistency over time


@given(seeds, st.booleans())
def test_perfect_estimates_score_zero_under_any_motion(seed, turning):
    poses, positions, bearings, ranges = walk(np.random.default_rng(seed), turning=turning)
    turns, moves = metrics.ego_motion(poses, positions)
    assert metrics.temporal_consistency(bearings, turns, moves, ranges) == pytest.approx(0, abs=1e-6)


@given(seeds)
def test_wrong_motions_do_not_score_zero(seed):
    poses, positions, bearings, ranges = walk(np.random.default_rng(seed))
    turns, moves = metrics.ego_motion(poses, positions)
    tc = metrics.temporal_consistency
    assert tc(bearings, turns, -moves, ranges) > 1e-3  # the displacement the other way
    assert tc(bearings, np.swapaxes(turns, 1, 2), moves, ranges) > 1e-3  # old_R_new
    assert tc(bearings, turns, np.einsum("kji,kj->ki", turns, moves), ranges) > 1e-3  # in the old frame
    assert tc(bearings, turns, moves, 3 * ranges) > 1e-3
    assert metrics.temporal_consistency(bearings, turns) > 1e-3  # parallax


def test_consistency_closed_forms():
    # Turning 30 degrees to the left moves what is ahead 30 degrees to the right.
    turns = rotation(UP, np.radians(-30))[None]
    right = direction(np.radians(-30.0), 0.0)
    assert metrics.temporal_consistency([FORWARD, right], turns) == pytest.approx(0, abs=1e-9)
    assert metrics.temporal_consistency([FORWARD, direction(np.radians(30.0), 0.0)], turns) == pytest.approx(60)
    # One metre ahead; the body steps one metre to the right: the target is now 45 degrees to the left.
    there = direction(np.radians(45.0), 0.0)
    still, step = np.eye(3)[None], -LEFT[None]
    assert metrics.temporal_consistency([FORWARD, there], still, step, [1.0, 2**0.5]) == pytest.approx(0, abs=1e-9)
    assert metrics.temporal_consistency([FORWARD, FORWARD], still, step, [1.0, 2**0.5]) == pytest.approx(45)
    assert metrics.temporal_consistency([FORWARD, there], still) == pytest.approx(45)


def test_ego_motion_closed_form():
    # From facing world x to facing world y, one metre forward along world x: in the new frame that is to the right.
    turns, moves = metrics.ego_motion([world_R_body(0), world_R_body(np.pi / 2)], [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(moves, [-LEFT], atol=1e-12)
    np.testing.assert_allclose(turns[0] @ FORWARD, -LEFT, atol=1e-12)


def test_consistency_needs_two_steps_and_fitting_input():
    still = np.eye(3)[None]
    assert metrics.temporal_consistency([FORWARD], np.zeros((0, 3, 3))) is None
    assert metrics.temporal_consistency([FORWARD], np.zeros((0, 3, 3)), np.zeros((0, 3)), [1.0]) is None
    two = [FORWARD, FORWARD]
    with pytest.raises(DirectionError, match=r"\(n, 3\)"):
        metrics.temporal_consistency(FORWARD, still)
    for arguments, says in (
        ((np.eye(3)[None].repeat(2, axis=0),), "one per move"),
        ((still, [[np.nan, 0, 0]], [1.0, 1.0]), "translations"),
        ((still, np.zeros((1, 3)), [1.0]), "true_ranges"),
        ((still, np.zeros((1, 3))), "go together"),
        ((still, FORWARD[None], [1.0, 0.0]), "camera itself"),
    ):
        with pytest.raises(EagorError, match=says):
            metrics.temporal_consistency(two, *arguments)
    with pytest.raises(RotationError):
        metrics.temporal_consistency(two, 2 * still)
    with pytest.raises(EagorError, match="positions"):
        metrics.ego_motion(still, np.zeros((2, 3)))


# Navigation


def test_success_needs_a_stop_strictly_inside():
    ends = [(0.5, True), (0.5, False), (1.0, True), (np.inf, True)]
    assert [metrics.success(*end, success_distance=1.0) for end in ends] == [True, False, False, False]
    with pytest.raises(EagorError, match="success_distance"):
        metrics.success(0.5, True, success_distance=0)
    with pytest.raises(EagorError, match="distance"):
        metrics.success(np.nan, False, success_distance=1.0)
    with pytest.raises(EagorError, match="booleans"):
        metrics.spl(0.5, 1.0, 1.0)  # type: ignore[arg-type]
    for bad in (-1.0, np.nan, np.inf):
        for refused in (lambda bad: metrics.spl(True, bad, 1.0), lambda bad: metrics.soft_spl(1.0, 1.0, bad)):
            with pytest.raises(EagorError):
                refused(bad)


def test_spl_closed_forms_and_guards():
    episodes = {(1, 10, 20): 0.5, (1, 10, 10): 1.0, (0, 10, 10): 0.0, (1, 0, 0): 1.0, (1, 0, 5): 0.0, (1, 10, 5): 1.0}
    assert {episode: metrics.spl(*episode) for episode in episodes} == episodes


def test_soft_spl_closed_forms_and_guards():
    episodes = {
        (5, 10, 10): 0.5, (20, 10, 10): 0, (np.inf, 10, 10): 0, (0, 10, 40): 0.25, (0, 0, 0): 1, (0, 0, 3): 0,
        (2, 0, 0): 0,
    }  # fmt: skip
    assert {episode: metrics.soft_spl(*episode) for episode in episodes} == episodes


lengths = st.floats(0, 1e6, allow_subnormal=False)


@given(lengths, lengths, lengths, st.booleans())
def test_spl_and_soft_spl_stay_in_the_unit_interval(distance, shortest, path, stopped):
    succeeded = metrics.success(distance, stopped, 1.0)
    hard, soft = metrics.spl(succeeded, shortest, path), metrics.soft_spl(distance, shortest, path)
    assert 0 <= hard <= succeeded
    assert 0 <= soft <= 1
    assert soft <= metrics.spl(True, shortest, path)
    assert metrics.soft_spl(0.0, shortest, path) == metrics.spl(True, shortest, path)
