"""A tracker under bad stamps, long silences and floods: what is wrong is told, what is right goes on."""

import contextlib
import math
import warnings

import numpy as np
import pytest

from eagor.errors import EagorError, PoseError, TimeError
from eagor.evidence import Evidence
from eagor.sphere import world_R_body
from eagor.tracking.config import MotionModel, TrackerConfig
from eagor.tracking.poses import POSES
from eagor.tracking.tracker import TARGETS, DirectionTracker
from eagor.tracking.tracks import APART, MOMENTS, NEWEST, VIEWS

LIGHT = TrackerConfig(degree=3, ranges=None, target_motion=MotionModel.still())
AHEAD = np.array([1.0, 0.0, 0.0])


def look(stamp, where=AHEAD):
    return Evidence.from_points([where], stamp=stamp)


def followed(config=None, until=4.0):
    """A tracker after a few seconds of poses and looks."""
    tracker = DirectionTracker(config or TrackerConfig(degree=7))
    for stamp in np.arange(0.0, until, 0.5):
        tracker.add_pose(stamp, np.eye(3), np.array([0.1 * stamp, 0.0, 1.0]))
        tracker.observe(look(float(stamp)))
    return tracker


def told(estimate):
    return estimate.presence, *estimate.direction, estimate.credible_angle, estimate.distance


def test_evidence_from_far_in_the_future_is_refused_and_harms_nothing():
    tracker, other = followed(), followed()
    with pytest.raises(TimeError, match=r"ahead of the last pose.*one clock"):
        tracker.observe(look(1.7e9))
    for each in (tracker, other):
        each.add_pose(4.0, np.eye(3), np.array([0.4, 0.0, 1.0]))
        each.observe(look(4.0))
    assert told(tracker.estimate(4.0)) == told(other.estimate(4.0))


@pytest.mark.parametrize(
    "wrong",
    [[1.7e9], [1e12, 1e10, 1e8], [1e5, 1e7, 1e9, 1e11], list(1.7e9 + 0.5 * np.arange(20))],
    ids=["one", "falling", "rising", "as long as the history"],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_any_number_of_poses_from_far_in_the_future_is_left_out(wrong):
    tracker, other = followed(), followed()
    for stamp in wrong:
        tracker.add_pose(stamp, world_R_body(1.0), np.array([5.0, 0.0, 1.0]))
        tracker.observe(look(stamp, -AHEAD))
        tracker.estimate(stamp)
    with pytest.warns(UserWarning, match=r"poses from t = .* on \(\d+\) .* left out"):
        tracker.add_pose(4.0, np.eye(3), np.array([0.4, 0.0, 1.0]))
    other.add_pose(4.0, np.eye(3), np.array([0.4, 0.0, 1.0]))
    for each in (tracker, other):
        each.observe(look(4.0))
    np.testing.assert_allclose(told(tracker.estimate(4.5)), told(other.estimate(4.5)), rtol=1e-6)


def test_a_flood_of_evidence_under_wrong_stamps_costs_a_target_what_was_known():
    tracker = followed(LIGHT)
    tracker.add_pose(1.7e9, np.eye(3), np.array([5.0, 0.0, 1.0]))
    for number in range(2 * MOMENTS):
        tracker.observe(look(1.7e9 + 0.01 * number, -AHEAD))
    tracker.estimate(1.7e9 + 10)
    with pytest.warns(UserWarning, match="left out"):
        tracker.add_pose(4.0, np.eye(3), np.array([0.4, 0.0, 1.0]))
    assert tracker.estimate(4.0).direction is None
    tracker.observe(look(4.0))
    assert tracker.estimate(4.0).direction @ AHEAD > 0.9


def test_after_a_long_sleep_that_went_on_time_does_not_run_backwards():
    tracker = followed(LIGHT)
    for stamp in 8000.0 + 0.5 * np.arange(30):
        tracker.add_pose(float(stamp), np.eye(3), np.array([0.4, 0.0, 1.0]))
    with pytest.raises(TimeError, match=r"reset\(\)"):
        tracker.add_pose(4.0, np.eye(3), np.array([0.4, 0.0, 1.0]))


def test_the_first_pose_may_be_the_wrong_one():
    tracker = DirectionTracker(LIGHT)
    tracker.add_pose(1.7e9, np.eye(3))
    with pytest.warns(UserWarning, match="left out"):
        tracker.add_pose(0.0, np.eye(3))
    tracker.add_pose(1.0, np.eye(3))
    with pytest.raises(TimeError, match=r"reset\(\)"):
        tracker.add_pose(0.5, np.eye(3))


def test_without_poses_a_wrong_stamp_is_told_and_mended_by_a_reset():
    tracker = DirectionTracker(LIGHT)
    tracker.observe(look(40.0))
    tracker.observe(look(1.7e9))
    with pytest.raises(TimeError, match=r"reset\('target'\)"):
        tracker.estimate(41.0)
    tracker.reset("target")
    assert tracker.targets == ("target",)
    assert tracker.estimate(41.0).direction is None
    tracker.observe(look(41.0))
    assert tracker.estimate(41.0).direction is not None


def test_evidence_from_far_in_the_future_is_left_out_when_the_first_pose_comes():
    tracker = DirectionTracker(LIGHT)
    tracker.observe(look(1.7e9, -AHEAD))
    with pytest.warns(UserWarning, match=r"'target' lies over 3600 s ahead of the pose at t = 0\.000 s"):
        tracker.add_pose(0.0, np.eye(3))
    tracker.observe(look(0.0))
    assert tracker.estimate(0.0).direction @ AHEAD > 0.9


@pytest.mark.parametrize("stamp", [1.7e18, -1e300, math.inf, math.nan])  # the first: nanoseconds
def test_stamps_beyond_all_clocks_are_refused(stamp):
    tracker = followed(LIGHT)
    for call in (
        lambda: tracker.add_pose(stamp, np.eye(3), AHEAD),
        lambda: look(stamp),
        lambda: tracker.estimate(stamp),
    ):
        with pytest.raises(TimeError, match=r"seconds, .* at most 1e\+12"):
            call()


def test_reset_and_forget():
    tracker = followed(LIGHT)
    tracker.observe(look(3.5), target="chair")
    tracker.forget("chair")
    assert tracker.targets == ("target",)
    for call in (tracker.forget, tracker.reset):
        with pytest.raises(EagorError, match=r"'chair'; there is about 'target'"):
            call("chair")
    tracker.reset()
    assert tracker.targets == ()
    tracker.add_pose(0.0, np.eye(3))  # the clock may begin anew


@pytest.mark.parametrize("silence", [987.0, 3000.0, 1e9])
@pytest.mark.parametrize("posed", [True, False])
def test_long_silences_are_survived(silence, posed):
    tracker = followed() if posed else DirectionTracker(TrackerConfig(degree=7))
    tracker.observe(look(3.5))
    estimate = tracker.estimate(3.5 + silence)
    assert math.isfinite(estimate.credible_angle)
    for later in (silence, silence + 1):
        if posed:
            tracker.add_pose(3.5 + later, np.eye(3), np.array([0.4, 0.0, 1.0]))
        tracker.observe(look(3.5 + later))
        assert tracker.estimate(3.5 + later).status in ("tracking", "searching", "ambiguous")


def test_positions_beyond_all_odometry_are_refused():
    tracker = followed()
    for far in (1e160, -1e10, math.inf, math.nan):
        with pytest.raises(PoseError, match=r"within 1e\+09 m"):
            tracker.add_pose(4.0, np.eye(3), np.array([far, 0.0, 1.0]))
    assert tracker.estimate(4.0).status == "tracking"
    tracker.add_pose(4.0, np.eye(3), np.array([1e9, -1e9, 1.0]))
    tracker.observe(look(4.0))
    assert math.isfinite(tracker.estimate(4.0).credible_angle)


def test_the_target_that_was_spoken_of_least_recently_is_forgotten():
    tracker = DirectionTracker(LIGHT)
    for number in range(TARGETS):
        tracker.observe(look(0.0), target=f"{number}")
    tracker.estimate(0.0, "0")
    with pytest.warns(UserWarning, match=r"100 targets are followed.*'1' is forgotten"):
        tracker.observe(look(0.0), target="one more")
    assert len(tracker.targets) == TARGETS
    assert {"0", "one more"} < {*tracker.targets}
    assert "1" not in tracker.targets


def test_a_flood_of_looks_is_bounded_and_nothing_of_it_is_lost():
    tracker, other = DirectionTracker(LIGHT), DirectionTracker(LIGHT)
    for number in range(1000):
        tracker.observe(look(number / 1000))
    for number in range(1000):
        other.observe(look(number / 1000))
        if number % 100 == 0:
            other.estimate(1.0 + number)
    moments = tracker._tracks["target"].moments
    a, b = tracker.estimate(1000.0), other.estimate(1000.0)
    np.testing.assert_allclose(a.presence, b.presence, rtol=1e-9)
    assert len(moments) <= MOMENTS + APART
    assert sum(moment.state is not None for moment in moments) <= MOMENTS // APART + NEWEST + 1
    with pytest.raises(TimeError, match=f"at most {MOMENTS} looks"):
        tracker.observe(look(0.1005))
    tracker.observe(look(0.9505))  # late, and kept


def test_views_of_one_moment_are_bounded():
    tracker = DirectionTracker(LIGHT)
    for _ in range(VIEWS):
        tracker.observe(look(0.0))
    with pytest.raises(TimeError, match=f"{VIEWS} looks"):
        tracker.observe(look(0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tracker.estimate(0.0).direction is not None


def test_a_look_before_all_poses_is_placed_by_the_first_and_stays_there():
    tracker = DirectionTracker(LIGHT)
    tracker.observe(look(0.0))
    for stamp in range(1, 15):
        tracker.add_pose(float(stamp), world_R_body(0.1 * stamp))
    tracker.observe(look(14.0, world_R_body(1.4).T @ world_R_body(0.1) @ AHEAD))
    direction = world_R_body(1.4) @ tracker.estimate(14.0).direction
    np.testing.assert_allclose(direction, world_R_body(0.1) @ AHEAD, atol=1e-2)


def test_looks_in_the_worst_order_are_bounded_too():
    tracker = DirectionTracker(LIGHT)
    for number in range(2 * MOMENTS):
        stamp = 1 + number / 1000 if number % APART == 0 else 0.9 + number / 10000
        with contextlib.suppress(TimeError):  # too late by then
            tracker.observe(look(stamp))
            if number % 16 == 0:
                tracker.estimate(2.0)
    assert len(tracker._tracks["target"].moments) <= MOMENTS + APART


def test_poses_at_any_rate_are_bounded():
    tracker = DirectionTracker(TrackerConfig(history=1e9))
    for number in range(POSES + 10):
        tracker.add_pose(1e-4 * number, np.eye(3))
    assert len(tracker._poses) == POSES
    with pytest.raises(PoseError, match="20000 poses"):
        tracker.observe(look(0.0))
