"""Distance from walking past.

What is learnt: a direction alone says nothing about how far away a thing is; directions from several places do. Tell
the tracker where the camera is (metres, from odometry), and its estimate has a distance with a spread. Keep walking,
and the thing stays where it is, even behind you.
"""

import math

import numpy as np

import eagor

THING = np.array([1.5, 2.0, 0.0])  # metres in the world: 2 m beside the way, 1.5 m ahead; at the camera's height
rng = np.random.default_rng(0)

tracker = eagor.DirectionTracker()
for step in range(13):
    stamp, position = 0.5 * step, np.array([0.25 * step, 0.0, 0.0])  # straight ahead, 25 cm per look
    tracker.add_pose(stamp, np.eye(3), position)
    offset = THING - position
    seen = offset / np.linalg.norm(offset) + rng.normal(0, math.radians(1.5), 3)  # a detector that errs by 1.5 degrees
    tracker.observe(eagor.Evidence.from_points([seen], 1 / math.radians(5) ** 2, [0.9], stamp=stamp))
    if step % 3 == 0:
        estimate, true = tracker.estimate(stamp), float(np.linalg.norm(offset))
        error = math.degrees(eagor.angular_distance(estimate.direction, offset))
        spread = 100 * math.expm1(estimate.distance_spread)
        print(
            f"after {position[0]:.2f} m: {math.degrees(estimate.azimuth):5.1f} deg left ({error:.1f} deg off), "
            f"{estimate.distance:.2f} m away, give or take {spread:.0f} % (truly {true:.2f} m)"
        )
