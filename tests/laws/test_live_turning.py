"""Regions of live answers hold the truth while the camera turns, however late poses are. All times are simulated."""

import math

import numpy as np
import pytest

from eagor import DetectorModel, DirectionTracker, ErpGrid, Evidence, angular_distance
from eagor.live.core import LiveCore, LoopSettings, RecentPoses
from eagor.live.events import ImageReceived, ObservationReceived, PoseReceived, Tick
from eagor.sources import Pose
from eagor.sphere import direction, unit, world_R_body
from eagor.tracking import TrackerConfig

SPREAD = math.radians(3)
MODEL = DetectorModel(detection_probability=0.9, false_alarms_per_look=0.1, spread=SPREAD, offset=0.0)
CONFIG = TrackerConfig(degree=7, detector=MODEL, clock_error=0.0)
ODOMETRY, PICTURES = (100.0, 0.01), (10.0, 0.15)  # poses a second, and how late they are at most (seconds)

SECONDS = 3.0


class Ride:
    """A camera that turns about the vertical: `heading` (radians) at a time; `poses` a second, `late` by so much."""

    def __init__(self, heading, poses, late, seed):
        self.heading, self.draw = heading, np.random.default_rng(seed)
        self.core = LiveCore(LoopSettings(("thing",), CONFIG))
        self.thing = direction(self.draw.uniform(-3, 3), self.draw.uniform(-0.4, 0.4))
        self.poses, self.late = poses, late

    def answers(self):
        """The answers after the first two seconds, each with the true direction."""
        events, delays = [], np.random.default_rng(0)  # the looks of a seed err alike with all poses
        for stamp in np.arange(0, SECONDS, 1 / self.poses):
            events.append(PoseReceived(stamp + self.late * delays.uniform(0.5, 1.0), Pose(stamp, self.pose(stamp))))
        for stamp in np.arange(0, SECONDS, 0.5):
            look = self.look(stamp)
            events += [
                ImageReceived(stamp, stamp, ""),
                ObservationReceived(stamp + 0.3, stamp, stamp, "thing", (look,)),
            ]
        events += [Tick(now) for now in np.arange(2.0, SECONDS, 0.17)]
        for event in sorted(events, key=lambda each: each.arrival):
            for answer in self.core.take(event):
                yield answer, self.thing @ self.pose(answer.stamp)

    def look(self, stamp):
        """What a detector of `MODEL` says: sometimes nothing, sometimes of something else."""
        found = [self.thing + SPREAD * self.draw.normal(size=3)] * (self.draw.random() < MODEL.detection_probability)
        found += [self.draw.normal(size=3) for _ in range(self.draw.poisson(MODEL.false_alarms_per_look))]
        bodies = unit(np.array(found).reshape(-1, 3)) @ self.pose(stamp)
        return Evidence.from_points(bodies, detector=MODEL, stamp=stamp)

    def pose(self, stamp):
        return world_R_body(self.heading(stamp))


def coverage(heading, poses, late, rides=80):
    """The share of answers whose cone of 90 % holds the truth."""
    answers = (each for seed in range(rides) for each in Ride(heading, poses, late, seed).answers())
    return np.mean([angular_distance(a.direction, truth) <= a.estimate.credible_angle for a, truth in answers])


@pytest.mark.parametrize(("rate", "poses"), [(45, ODOMETRY), (90, PICTURES)], ids=["odometry", "pictures"])
def test_regions_of_90_percent_hold_the_truth_while_the_camera_turns(rate, poses):
    assert 0.85 <= coverage(lambda now: math.radians(rate) * now, *poses) <= 0.97


def test_an_extrapolation_says_how_far_it_has_been_off():
    """Against poses that it never saw, for a heading that wanders: the root mean square is that of the errors."""
    draw, off, told = np.random.default_rng(0), [], []
    for _ in range(60):
        rates = np.cumsum(draw.normal(size=80)) * 0.1
        headings, recent = np.cumsum(rates) * 0.1, RecentPoses(0.5)
        for number in range(60):
            recent.add(number / 10, world_R_body(headings[number]))
        pose, spread = recent.after(0.3)
        off.append(math.sqrt(0.5) * angular_distance(pose[:, 0], world_R_body(headings[62])[:, 0]))
        told.append(spread)
    assert np.mean(np.square(told)) == pytest.approx(np.mean(np.square(off)), rel=0.5)


def test_a_turn_that_nobody_has_seen_for_long_goes_on_and_is_hardly_known():
    recent = RecentPoses(0.5)
    for stamp in np.arange(0, 3, 0.5):
        recent.add(stamp, world_R_body(stamp))
    times = [0.4, 1.2, 2.0, 4.0]
    after = [recent.after(seconds) for seconds in times]
    for seconds, (pose, _) in zip(times, after, strict=True):
        assert angular_distance(pose[:, 0], world_R_body(2.5 + seconds)[:, 0]) < 0.01
    assert np.all(np.diff([spread for _, spread in after]) > 0)
    assert after[-1][1] > 1


def test_few_poses_or_long_ago_tell_little():
    recent = RecentPoses(0.5)
    assert recent.after(1.0)[1] == 0.0, "before any pose the camera stands"
    recent.add(0.0, world_R_body(0.3))
    spreads = [recent.after(seconds)[1] for seconds in (0.0, 0.3, 1.0, 5.0)]
    assert spreads[0] == 0 < spreads[1] < spreads[2] < spreads[3] == math.pi / 2
    assert np.array_equal(recent.after(5.0)[0], world_R_body(0.3))
    recent.clear()
    assert recent.after(1.0)[1] == 0.0


@pytest.mark.parametrize("spread", [0.02, 0.08, 0.3])
def test_an_estimate_whose_pose_may_be_off_is_wider_by_that(spread):
    """A Gaussian turn of the sphere scales the mean direction by exp(-spread^2), whatever the belief is."""
    tracker = DirectionTracker(CONFIG)
    for number in range(4):
        tracker.observe(Evidence.from_points(np.array([[1.0, 0.0, 0.0]]), scores=np.array([0.9]), stamp=number / 2))
    sure = tracker.estimate(2.0)
    unsure = sure.turned(2.0, np.eye(3), spread)
    grid = ErpGrid(256, 512)
    assert np.sum(np.exp(unsure.log_density(grid.directions)) * grid.weights) == pytest.approx(1, abs=0.01)
    assert 1 - unsure.progress / sure.progress == pytest.approx(1 - math.exp(-(spread**2)), rel=0.1)
    assert unsure.credible_angle > sure.credible_angle
    assert unsure.within(0.1) < sure.within(0.1)
    assert np.array_equal(unsure.direction, sure.direction)
    assert unsure.turned(2.1, np.eye(3)).credible_angle == sure.credible_angle
