"""DDS, the transport of ROS 2 and of Unitree's robots: topics are written and read without ROS being installed."""

from __future__ import annotations

from eagor.robots.dds.link import Link, Reader, Writer

__all__ = ["Link", "Reader", "Writer"]
