"""ROS 2 without ROS: cameras and odometry on topics, and a node that answers on them. Bags: `eagor.media.bags`.

`graph`: the graph over DDS, or another, which of its topics is meant, and what a camera's lens is there. `odometry`:
poses from what robots publish. `sources`: cameras and odometry, live or of a bag. `node`: pictures, odometry and
queries in; `publishing`: directions, markers, beliefs and diagnostics out; `driving`: velocities for a base.
"""

from __future__ import annotations

from eagor.robots.ros.pose_sources import RosPoses
from eagor.robots.ros.sources import RosCamera

__all__ = ["RosCamera", "RosPoses"]
