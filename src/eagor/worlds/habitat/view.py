"""What a camera sees in Habitat-Sim, in our coordinates: colour, Euclidean range, and the ids of our instances.

Habitat's world has Y up; its x is ours, its Z is our -y (`eagor.conventions.to_gltf`), as in exported GLB files and
ObjectNav episodes. Heights differ by the floor of the chosen storey: our z = 0 is Habitat's y = `Frames.floor`. A
camera's own axes are x right, y up, z backward.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from eagor.conventions import from_gltf, pose_to_habitat, to_gltf, wxyz_from_rotation
from eagor.errors import GridError, PoseError
from eagor.grids import ErpGrid
from eagor.sphere import check_rotation
from eagor.worlds.habitat.simulator import Session
from eagor.worlds.render import Frame

__all__ = ["Frames", "HabitatView", "Labels", "euclidean"]


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


# --- panoramas from Habitat-Sim ---------------------------------------------------------------------------------------

FAR = 999.0  # metres: the far plane is at 1000


class Labels(Protocol):
    """Finds the instance in each direction of a panorama."""

    raw: bool  # whether it reads Habitat's semantic ids; otherwise it needs points

    def ids(self, semantic: np.ndarray | None, points: np.ndarray | None) -> np.ndarray:
        """Ids ``(H, W)`` int32, -1 for none.

        `semantic` ``(H, W)``: Habitat's ids; `points` ``(H, W, 3)``: what is seen, our world, NaN for no hit.
        """
        ...


class HabitatView:
    """The renderer of one scene: an `eagor.worlds.View`."""

    def __init__(self, session: Session, frames: Frames, labels: Labels | None) -> None:
        self.session, self.frames, self.labels = session, frames, labels

    def panorama(
        self, position: np.ndarray | tuple[float, float, float], world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The panorama ``(height, 2 height)`` from `position` ``(3,)``, metres, in the pose `world_R_body`.

        Cube maps of Habitat hold depth along the axis of each face; ranges here are metres along the ray. Raises
        `PoseError`, `RotationError`, `GridError`, and `WorldError` if the simulator cannot be opened.
        """
        if height < 1:
            raise GridError(f"a panorama of height {height}; wanted at least one row")
        rotation = np.asarray(check_rotation(np.asarray(world_R_body, dtype=np.float64), "world_R_body"))
        place = np.asarray(position, dtype=np.float64)
        if place.shape != (3,) or not np.isfinite(place).all():
            raise PoseError(f"the camera stands at {position}; wanted a position (x, y, z), finite, in metres")
        labels = self.labels if ids else None
        by_points = labels is not None and not labels.raw
        kinds = [
            kind
            for kind, wanted in (
                ("color", rgb),
                ("depth", range or by_points),
                ("semantic", labels is not None and labels.raw),
            )
            if wanted
        ]
        seen = self.session.look(kinds, height, self.frames.to_habitat(place), self.frames.quaternion(rotation))
        metres = euclidean(seen["depth"]) if "depth" in seen else None
        points = None
        if by_points and metres is not None:
            finite = np.where(np.isfinite(metres), metres, np.nan)[..., None]
            points = place + finite * (ErpGrid(height, 2 * height).directions @ rotation.T)
        return Frame(
            np.ascontiguousarray(seen["color"][..., :3]) if rgb else None,
            metres if range else None,
            labels.ids(seen.get("semantic"), points) if labels is not None else None,
        )


def euclidean(depth: np.ndarray) -> np.ndarray:
    """Metres along the ray ``(H, 2 H)`` float32, inf for no hit, from the depth of an equirectangular sensor.

    That depth is measured along the axis of the face of a cube map that a pixel was taken from. The axis is the one
    along which the ray is longest: range = depth / max(abs(ray)). Depth is 0 where nothing is hit.
    """
    hit = (depth > 0) & (depth < FAR)
    return np.where(hit, depth * _stretch(len(depth)), np.float32(np.inf)).astype(np.float32)


@lru_cache(maxsize=4)
def _stretch(height: int) -> np.ndarray:
    """Range per depth ``(H, 2 H)`` float32: 1 at the middle of a face, sqrt(3) at the corners of the cube."""
    found = (1 / np.abs(ErpGrid(height, 2 * height).directions).max(axis=-1)).astype(np.float32)
    found.setflags(write=False)
    return found
