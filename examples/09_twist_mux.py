"""Walk a ROS 2 base to the thing that `eagor ros` answers about. It needs rclpy, and runs until Ctrl-C.

What is learnt: velocities go through twist_mux, and stop with the answers. twist_mux passes on what has the highest
priority and is not older than its timeout, so a joystick or a lock in its configuration always wins. This node sends
nothing while an answer is old: the base then stops by twist_mux's timeout.

    topics:
      eagor: {topic: eagor_vel, timeout: 0.3, priority: 10}
    use_stamped: true

``python examples/09_twist_mux.py --ros-args -p speed:=0.2 -p distance:=1.5``; for bases that want a Twist without a
stamp (before Jazzy), leave the header out of the message below.
"""

import json
import math
from contextlib import suppress

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from std_msgs.msg import String

OLD = 0.5  # seconds that an answer may be old
UNSEEN = 2.0  # seconds since the last look that counts
AHEAD = math.radians(20)  # it walks when the thing is so far ahead, and turns in place otherwise


class Walker(Node):
    """Turns towards the thing, then walks to it."""

    def __init__(self) -> None:
        super().__init__("eagor_walker")
        self.speed = self.declare_parameter("speed", 0.2).value  # m/s
        self.turn = self.declare_parameter("turn", 0.6).value  # rad/s at most
        self.distance = self.declare_parameter("distance", 1.0).value  # metres before the thing
        self.velocity = self.create_publisher(TwistStamped, "eagor_vel", 1)
        self.create_subscription(String, "/eagor/answers", self.answered, 1)

    def answered(self, message: String) -> None:
        answer = json.loads(message.data)[0]
        now = self.get_clock().now()
        age = (now.nanoseconds - answer["stamp_ns"]) / 1e9
        seen = answer["look_age"] is not None and answer["look_age"] < UNSEEN
        if answer["status"] != "tracking" or not seen or not 0 <= age < OLD or answer["faults"]:
            return
        azimuth, away = math.radians(answer["azimuth_deg"]), answer["distance_m"]
        sent = TwistStamped()
        sent.header.stamp, sent.header.frame_id = now.to_msg(), answer["frame"]
        sent.twist.angular.z = max(-self.turn, min(self.turn, 1.5 * azimuth))
        if abs(azimuth) < AHEAD and away is not None and away > self.distance:
            sent.twist.linear.x = self.speed
        self.velocity.publish(sent)


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt):
        rclpy.spin(Walker())
