"""Live cameras and their motion: pictures with their times, and how the camera turned between them."""

from __future__ import annotations

from eagor.robots.frames import Frame

__all__ = ["Frame"]
