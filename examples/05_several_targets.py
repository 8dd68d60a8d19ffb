"""Several targets, followed at once.

What is learnt: one tracker follows any number of targets by name, over the same poses; what is asked for and is not
there stays `searching`, with a low presence: not seeing a thing is evidence too. Where the height of the floor is
known, a direction below the horizon tells a distance.
"""

import math

import numpy as np

import eagor
from eagor.lab.worlds.painted import Room, bearing, paint
from eagor.perception import load
from eagor.sphere import world_R_body

room = Room()
balls = {f"{ball.colour} ball": ball for ball in room.balls}
queries = [*balls, "purple ball"]  # there is none
perceive = load("colour")
tracker = eagor.DirectionTracker(eagor.TrackerConfig(floor_height=0.0))  # things stand on a floor at z = 0

for step in range(12):  # a walk through the room, turning to the left
    stamp, pose = 0.5 * step, world_R_body(math.radians(25 * step))
    position = np.array([0.0, -1.4 + 0.25 * step, 1.3])
    tracker.add_pose(stamp, pose, position)
    panorama = paint(room, position, pose, 128, 256)
    for query in queries:
        tracker.observe(perceive(panorama, query, stamp=stamp), target=query)

for query in queries:
    estimate = tracker.estimate(stamp, target=query)
    line = f"{query:12} {estimate.status:10} presence {100 * estimate.presence:3.0f} %"
    if query in balls:
        truth, distance = bearing(balls[query], position, pose)
        error = math.degrees(eagor.angular_distance(estimate.direction, truth))
        line += f"  {math.degrees(estimate.azimuth):7.1f} deg, {error:.1f} deg off"
        line += f"  {estimate.distance:.1f} m away (truly {distance:.1f} m)"
    print(line)
