"""Live cameras and their motion: pictures with their times, and how the camera turned between them."""

from __future__ import annotations

from eagor.media.frames import CameraSource, Frame, Pose, PoseSource

__all__ = ["CameraSource", "Frame", "Pose", "PoseSource"]
