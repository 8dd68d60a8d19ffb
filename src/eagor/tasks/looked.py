"""Where a body had looked: the looks of an episode made again, from the poses in its record."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eagor.conventions import rotation_from_wxyz
from eagor.tasks.floor_seen import FloorSeen
from eagor.tasks.situation import Situation
from eagor.tasks.steering import ground_of
from eagor.tasks.views import in_view

if TYPE_CHECKING:
    from eagor.tasks.places import Place
    from eagor.tasks.rules import Camera

MOST = 1000  # looks that are made again, some 3 ms each; of a longer way, so many of its poses


def looked_along(place: Place, poses: np.ndarray, camera: Camera) -> FloorSeen:
    """What the looks from `poses` showed of the floor of `place`, to a body that searches.

    `poses` ``(n, 7)``: x, y, z (metres) of the camera in the world, and its orientation ``world_R_body`` as a
    quaternion w, x, y, z. They are the true ones: where odometry drifted, the body itself took the floor to be
    elsewhere.
    """
    ground = ground_of(camera)
    for x, y, z, *quaternion in _spread(poses):
        world_R_body = rotation_from_wxyz(np.array(quaternion) / np.linalg.norm(quaternion))
        eye = np.array([x, y, z])
        floor = place.floor_in(place.ids(eye, world_R_body), eye, world_R_body)
        seen = in_view(camera, len(floor))
        ground.look(
            Situation(
                azimuth=0.0,  # nothing is believed here: only what a look shows is taken in
                progress=0.0,
                presence=0.0,
                distance=None,
                position=eye - [0.0, 0.0, place.ground.height(eye[:2])],
                world_R_body=world_R_body,
                floor=floor if seen is None else floor & seen,
                seen=seen,
            )
        )
    return ground.known


def _spread(poses: np.ndarray) -> np.ndarray:
    """All poses, or `MOST` of them, evenly spread, the first and the last among them."""
    if len(poses) <= MOST:
        return poses
    return poses[np.linspace(0, len(poses) - 1, MOST).round().astype(np.intp)]
