"""Evidence that arrives late.

What is learnt: a large model may answer seconds after the picture was taken, and the camera has turned meanwhile. Stamp
the evidence with the time of CAPTURE, and the tracker puts it where it belongs; taken for news of now, it is as far off
as the camera has turned.
"""

import math

import eagor
from eagor.sphere import world_R_body

SPEED, DELAY = 40.0, 1.5  # degrees per second to the left; seconds until the model has answered
THING = eagor.direction(math.radians(70.0), 0.0)  # in the world, standing still


def pose(stamp: float):
    """world_R_body of the turning camera."""
    return world_R_body(math.radians(SPEED * stamp))


def model(captured: float, claimed: float) -> eagor.Evidence:
    """What a slow model says of the picture taken at `captured`, stamped with `claimed`."""
    return eagor.Evidence.from_points([pose(captured).T @ THING], 1 / math.radians(6) ** 2, [0.9], stamp=claimed)


def error(tracker: eagor.DirectionTracker, now: float) -> float:
    """Degrees between the answer at `now` and the truth."""
    return math.degrees(eagor.angular_distance(tracker.estimate(now).direction, pose(now).T @ THING))


by_capture, by_arrival = eagor.DirectionTracker(), eagor.DirectionTracker()
for step in range(31):  # odometry at 10 Hz, a picture every half second
    now = step / 10
    for tracker in (by_capture, by_arrival):
        tracker.add_pose(now, pose(now))
    captured = now - DELAY
    if captured >= 0 and step % 5 == 0:
        by_capture.observe(model(captured, claimed=captured))
        by_arrival.observe(model(captured, claimed=now))
        print(
            f"at {now:.1f} s the picture of {captured:.1f} s is answered. Stamped with its capture: "
            f"{error(by_capture, now):4.1f} deg off; with its arrival: {error(by_arrival, now):4.1f} deg off"
        )
