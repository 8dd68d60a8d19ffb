"""A node of ROS 2: pictures, odometry and queries in; directions, markers, beliefs and diagnostics out.

`node` runs it, over DDS without ROS, or through `rclpy`. `answers`: an estimate as messages. `outbox`: the thread that
sends them. `queries`: what a message on ``~/query`` means.
"""

from __future__ import annotations

from eagor.robots.node.node import Node, NodeSettings

__all__ = ["Node", "NodeSettings"]
