"""ROS 2 without ROS: cameras and odometry on topics. Bags are in `eagor.media.bags`, the node in `eagor.robots.node`.

`transforms`, `odometry`: poses from what robots publish. `topics`: which topic is meant. `graph`: the graph over DDS,
or another. `sources`: live topics. `playing`: topics of a bag.
"""

from __future__ import annotations

from eagor.robots.ros.sources import RosCamera, RosPoses

__all__ = ["RosCamera", "RosPoses"]
