"""Coordinates between Habitat-Sim and us: the same change as in exported GLB files and ObjectNav episodes.

Habitat's world has Y up; its x is ours, its Z is our -y (`eagor.conventions.to_gltf`). Heights differ by the floor of
the chosen storey: our z = 0 is Habitat's y = `Frames.floor`. A camera's own axes are x right, y up, z backward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor.conventions import from_gltf, pose_to_habitat, to_gltf, wxyz_from_rotation

__all__ = ["Frames"]


@dataclass(frozen=True)
class Frames:
    """The change of coordinates for a scene whose floor is at the height `floor`, metres, in Habitat's world."""

    floor: float = 0.0

    def to_habitat(self, points: np.ndarray) -> np.ndarray:
        """Points ``(..., 3)`` of our world in Habitat's."""
        found = to_gltf(np.asarray(points, dtype=np.float64))
        found[..., 1] += self.floor
        return found

    def from_habitat(self, points: np.ndarray) -> np.ndarray:
        """Points ``(..., 3)`` of Habitat's world in ours."""
        found = from_gltf(np.asarray(points, dtype=np.float64))
        found[..., 2] -= self.floor
        return found

    def box_from_habitat(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner ``(3,)`` of an axis-aligned box, in our world."""
        corners = self.from_habitat(np.stack([low, high]))
        return corners.min(axis=0), corners.max(axis=0)

    def quaternion(self, world_R_body: np.ndarray) -> np.ndarray:
        """Habitat's rotation ``(4,)``, w first, of a camera with our pose `world_R_body`. Raises `RotationError`."""
        return wxyz_from_rotation(pose_to_habitat(world_R_body))
