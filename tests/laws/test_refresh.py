"""A follower answers as its tracker does; it computes where there is reason to, and turns the belief meanwhile."""

import json
import math

import numpy as np
import pytest

from eagor.errors import TimeError
from eagor.evidence import Evidence
from eagor.sphere import world_R_body
from eagor.tracking import DirectionTracker, TrackerConfig
from eagor.tracking.refresh import Follower, Refresh

LEFT = np.array([0.0, 1.0, 0.0])
SELDOM = Refresh(soonest=0.0, latest=10.0, moved=0.5)


def seen(stamp, direction=LEFT):
    return Evidence.from_points(direction[None], scores=np.full(1, 0.9), stamp=stamp)


@pytest.fixture
def follower():
    """One that has looked once and has answered, at time 0."""
    follower = Follower()
    follower.move(0.0, np.eye(3), np.array([0.0, 0.0, 1.2]))
    follower.observe(seen(0.0))
    follower.estimate(0.0)
    return follower


def test_it_answers_as_its_tracker_does():
    follower, tracker = Follower(), DirectionTracker()
    for step in range(4):
        stamp, turn, place = 0.5 * step, world_R_body(0.3 * step), np.array([0.2 * step, 0.0, 1.2])
        follower.move(stamp, turn, place)
        tracker.add_pose(stamp, turn, place)
        if step != 2:
            follower.observe(seen(stamp))
            tracker.observe(seen(stamp))
        ours, theirs = follower.estimate(stamp), tracker.estimate(stamp)
        assert ours.as_dict() == theirs.as_dict()
        assert follower.estimate(stamp) is ours, "the same question is answered once"


def test_between_computations_the_belief_turns_with_the_camera(follower):
    before, turn = follower.computed, world_R_body(math.radians(30))
    follower.move(1.0, turn, np.array([0.1, 0.0, 1.2]))
    found = follower.estimate(1.0, SELDOM)
    assert follower.computed is before
    np.testing.assert_allclose(found.direction, turn.T @ before.direction, atol=1e-9)
    assert (found.stamp, found.age) == (1.0, 1.0)


@pytest.mark.parametrize("reason", ["a look", "a way", "a while"])
def test_a_belief_is_computed_anew_where_there_is_reason_to(follower, reason):
    before, stamp = follower.computed, 11.0 if reason == "a while" else 1.0
    follower.move(stamp, np.eye(3), np.array([0.6 if reason == "a way" else 0.0, 0.0, 1.2]))
    if reason == "a look":
        follower.observe(seen(stamp))
    assert follower.estimate(stamp, SELDOM) is follower.computed
    assert follower.computed is not before


def test_computations_keep_their_distance(follower):
    before = follower.computed
    for stamp, computed in ((0.1, False), (0.29, False), (0.31, True)):
        follower.move(stamp, np.eye(3), np.array([0.0, 0.0, 1.2]))
        follower.observe(seen(stamp))
        follower.estimate(stamp, Refresh(soonest=0.3, latest=10.0, moved=0.5))
        assert (follower.computed is not before) == computed


def test_stamps_of_looks_are_clipped_to_the_poses(follower):
    follower.move(1.0, np.eye(3), np.array([0.0, 0.0, 1.2]))
    assert [follower.placed(seen(stamp)).stamp for stamp in (-0.01, 0.4, 1.01)] == [0.0, 0.4, 1.0]
    assert follower.placed(seen(None)).stamp is None
    with pytest.raises(TimeError):
        follower.observe(seen(None))


def test_a_belief_without_ranges_takes_no_positions():
    follower = Follower(TrackerConfig(ranges=None))
    follower.move(0.0, np.eye(3), np.array([0.0, 0.0, 1.2]))
    assert follower.tracker.pose_at(0.0)[1] is None


def test_an_answer_is_written_down_in_plain_numbers(follower):
    found = follower.computed.as_dict(modes=1, near=15)
    assert json.loads(json.dumps(found)) == found
    assert found["azimuth_deg"] == pytest.approx(90, abs=1)
    assert [*found] == [
        "stamp", "azimuth_deg", "elevation_deg", "direction", "credible_angle_deg", "presence", "distance_m",
        "distance_spread", "within_15_deg", "status", "modes",
    ]  # fmt: skip
    assert found["within_15_deg"] == round(follower.computed.within(math.radians(15)), 6)
    assert len(found["modes"]) == 1


def test_what_is_not_known_is_null():
    found = Follower().estimate(0.0).as_dict(near=15)
    assert {name for name, value in found.items() if value is None} == {
        "azimuth_deg", "elevation_deg", "direction", "credible_angle_deg", "distance_m", "distance_spread",
        "within_15_deg",
    }  # fmt: skip
    assert (found["status"], found["modes"]) == ("searching", [])
