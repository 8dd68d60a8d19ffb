"""One photograph as a place to look around in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from eagor.errors import GridError, ImageError, PoseError
from eagor.media.panorama import turn
from eagor.sphere import check_rotation
from eagor.worlds.render import Frame, Position


@dataclass(frozen=True, eq=False)
class Photograph:
    """A panorama ``(H, W, 3)`` uint8, in the layout of `eagor.sphere`, taken in the identity pose at the origin.

    The camera can turn but not move in it, since a photograph has no depth: there are no ranges and no ids.
    """

    image: np.ndarray

    def panorama(
        self, position: Position, world_R_body: np.ndarray, height: int, *,
        rgb: bool = True, range: bool = True, ids: bool = True,
    ) -> Frame:  # fmt: skip
        """The view in the pose `world_R_body`, ``(height, 2 height, 3)``; range and ids are always None.

        The photograph is averaged to the size first. Raises `PoseError` for a position other than the origin,
        `GridError` for a height below 1, `RotationError`, and `ImageError` for an invalid photograph.
        """
        image = np.asarray(self.image)
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[-1] != 3 or image.size == 0:
            raise ImageError(
                f"the photograph is {image.dtype} of shape {image.shape}; wanted uint8 sRGB (H, W, 3). Files: "
                "eagor.media.panorama.read_panorama"
            )
        if np.shape(position) != (3,) or np.any(np.asarray(position, dtype=float) != 0):
            raise PoseError(
                f"the camera stands at {position}; a photograph shows what is seen from (0, 0, 0), where it was taken"
            )
        if height < 1:
            raise GridError(f"a panorama of height {height}; wanted at least one row")
        pose = check_rotation(np.asarray(world_R_body, dtype=np.float64), "world_R_body")
        if not rgb:
            return Frame(None, None, None)
        sized = Image.fromarray(np.ascontiguousarray(image)).resize((2 * height, height), Image.Resampling.BOX)
        return Frame(turn(np.asarray(sized), pose.T), None, None)
