"""Short tracks for tests of pictures, videos and pages."""

import numpy as np

from eagor.evidence import Evidence
from eagor.sphere import direction, world_R_body
from eagor.tracking.tracker import DirectionTracker

PANORAMA = np.full((32, 64, 3), 90, dtype=np.uint8)


def turning(count, azimuth=40.0, elevation=10.0, turn=20.0, silent=(), interval=0.5):
    """Estimates of a camera that turns left by `turn` degrees per look, with the thing at a place in world axes.

    At the steps `silent` nothing is detected.
    """
    tracker = DirectionTracker()
    found = []
    for step in range(count):
        turned = world_R_body(np.radians(turn) * step)
        tracker.add_pose(interval * step, turned)
        places = [] if step in silent else [direction(*np.radians((azimuth, elevation))) @ turned]
        tracker.observe(Evidence.from_points(np.reshape(places, (-1, 3)), stamp=interval * step))
        found.append(tracker.estimate(interval * step))
    return found
