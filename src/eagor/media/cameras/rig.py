"""A camera with lenses: all that is needed to make panoramas of its pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from eagor.errors import GridError, ImageError
from eagor.lenses import FisheyeLens, Lens
from eagor.sphere import world_R_body

__all__ = ["Rig", "dual_fisheye"]

SHAPE = 0.01  # by which the ratio of a picture's sides may differ from the rig's: rounding to even numbers


@dataclass(frozen=True, eq=False)
class Rig:
    """The `lenses` of a camera, in pixels of pictures of the `sizes` (width, height): one, or one per lens.

    Raises `GridError` where there is no lens, or one refers to a picture that there is not.
    """

    sizes: tuple[tuple[int, int], ...]
    lenses: tuple[Lens, ...]

    def __post_init__(self) -> None:
        if not self.lenses or not self.sizes:
            raise GridError("a rig needs at least one lens and one picture")
        for lens in self.lenses:
            if not 0 <= lens.picture < len(self.sizes):
                raise GridError(
                    f"the lens {lens.name!r} is in picture {lens.picture}; wanted 0 to {len(self.sizes) - 1}"
                )

    @property
    def rows(self) -> int:
        """Rows of a panorama that is as fine as the pictures, an even number."""
        return max(2, 2 * round(math.pi * max(lens.pixels_per_radian for lens in self.lenses) / 2))

    def scaled(self, factor: float) -> Rig:
        """The same for pictures that are `factor` times as large."""
        sizes = tuple((max(1, round(w * factor)), max(1, round(h * factor))) for w, h in self.sizes)
        return Rig(sizes, tuple(lens.scaled(factor) for lens in self.lenses))

    def turned(self, new_R_old: np.ndarray) -> Rig:
        """The same on a body with other axes: ``new_R_old @ direction_old = direction_new``."""
        lenses = tuple(replace(lens, body_R_lens=new_R_old @ lens.body_R_lens) for lens in self.lenses)
        return Rig(self.sizes, lenses)

    def factor_of(self, sizes: tuple[tuple[int, int], ...], name: str) -> float:
        """How much larger than the rig's own are pictures of these `sizes` (width, height).

        Raises `ImageError`, about `name`, if they are others: another number, or another shape.
        """
        if len(sizes) != len(self.sizes):
            raise ImageError(
                f"{name} gives {len(sizes)} picture{'s' if len(sizes) > 1 else ''} at a time, and the rig is for "
                f"{len(self.sizes)}; give as many files or streams as the rig lists pictures, with commas between"
            )
        factors = [width / own[0] for (width, _), own in zip(sizes, self.sizes, strict=True)]
        for (width, height), own, factor in zip(sizes, self.sizes, factors, strict=True):
            if abs(height / own[1] / factor - 1) > SHAPE or abs(factor / factors[0] - 1) > SHAPE:
                raise ImageError(
                    f"{name} is {width} x {height}, and the rig is for pictures of {own[0]} x {own[1]}, or the same "
                    "shape in another size. Set the camera to that resolution, or calibrate the rig with pictures of "
                    "this one (eagor camera calibrate)"
                )
        return factors[0]


def dual_fisheye(width: int, height: int, fov: float = math.radians(200)) -> Rig:
    """Two ideal lenses back to back, their circles side by side in one picture, the front one on the left.

    Each circle touches the top and the bottom of the picture; `fov`: the angle across it, radians.
    """
    places = (("front", width / 4, 0.0), ("back", 3 * width / 4, math.pi))
    lenses = tuple(
        FisheyeLens.of_field(name, (x, height / 2), min(height, width / 2) / 2, fov, body_R_lens=world_R_body(yaw))
        for name, x, yaw in places
    )
    return Rig(((width, height),), lenses)
