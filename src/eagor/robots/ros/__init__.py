"""ROS 2 without ROS: messages, bags, cameras and odometry on topics. The node that answers is `eagor.robots.node`.

`messages`: to and from our types. `bags`: recordings. `transforms`, `odometry`: poses from what robots publish.
`topics`: which topic is meant. `graph`: the graph over DDS, or another. `sources`: live topics. `playing`: topics of a
bag.
"""

from __future__ import annotations

from eagor.robots.ros.bags import read_bag
from eagor.robots.ros.recording import BagWriter
from eagor.robots.ros.sources import RosCamera, RosPoses

__all__ = ["BagWriter", "RosCamera", "RosPoses", "read_bag"]
