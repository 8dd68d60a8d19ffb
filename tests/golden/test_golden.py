"""Small seeded episodes whose outcome is written down: a change that moves them must be meant."""

import math

import numpy as np
import pytest

from eagor.evidence import Evidence
from eagor.sphere import angular_distance, world_R_body
from eagor.tracking.config import TrackerConfig
from eagor.tracking.tracker import DirectionTracker


def walk(config, steps=24):
    """A camera walks past a target, turning; 30 % misses, 20 % false alarms, 5 degrees of noise; one second a step."""
    rng, tracker, target = np.random.default_rng(7), DirectionTracker(config), np.array([3.0, 2.0, 0.3])
    for step in range(steps):
        pose, position = world_R_body(0.25 * step, 0.1 * math.sin(step), 0.0), np.array([0.25 * step, 0.0, 0.0])
        truth = pose.T @ (target - position)
        truth = truth / np.linalg.norm(truth)
        points = []
        if rng.random() > 0.3:
            points.append(truth + math.radians(5) * rng.normal(size=3))
        if rng.random() < 0.2:
            points.append(rng.normal(size=3))
        tracker.add_pose(float(step), pose, position)
        tracker.observe(Evidence.from_points(np.reshape(points, (-1, 3)), 60.0, [0.8] * len(points), stamp=float(step)))
    return tracker.estimate(steps - 1.0), truth, float(np.linalg.norm(target - position))


CASES = {
    "default": (
        TrackerConfig(),
        {"angles": (174.2, 8.8), "error": 1.3, "status": "tracking", "presence": 0.99, "ratio": 0.983},
    ),
    "turning only": (
        TrackerConfig(ranges=None),
        {"angles": (179.4, 8.0), "error": 5.2, "status": "tracking", "presence": 0.99},
    ),
    "published": (
        TrackerConfig.paper(),
        {"angles": (114.5, 7.3), "error": 59.3, "status": "searching", "presence": 0.0},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_walk_ends_where_it_ended(name):
    config, expected = CASES[name]
    estimate, truth, distance = walk(config)
    error = float(np.degrees(angular_distance(estimate.direction, truth)))
    assert np.degrees([estimate.azimuth, estimate.elevation]) == pytest.approx(expected["angles"], abs=0.5)
    assert error == pytest.approx(expected["error"], abs=0.5)
    assert estimate.status == expected["status"]
    assert estimate.presence == pytest.approx(expected["presence"], abs=0.02)
    if estimate.distance is not None:
        assert estimate.distance / distance == pytest.approx(expected["ratio"], abs=0.02)
