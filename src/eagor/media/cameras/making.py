"""From the pictures of a source to panoramas: as they are, or stitched; and what pictures are no good for that."""

from __future__ import annotations

import numpy as np

from eagor.errors import ImageError
from eagor.grids import ErpGrid
from eagor.media.cameras.rig import Rig
from eagor.media.cameras.stitching import Stitcher
from eagor.media.images import resized
from eagor.media.suspect import fisheye_circles

__all__ = ["Panoramas"]

ROUNDING = 2  # columns by which a panorama may fail to be 2:1
MAKE = "Give its lenses with --rig FILE.yaml (eagor camera calibrate makes one)"


class Panoramas:
    """Makes panoramas from pictures of `sizes` (width, height), of a source called `name`.

    Without a `rig` the one picture is a panorama. `rows`: the most rows; larger pictures are shrunk. `grid`: of the
    panoramas; `unseen` ``(H, W)``: what no lens sees, or None; `wanted`: rows and columns to which each picture is to
    be brought while it is decoded. Raises `ImageError` for sizes that fit neither a panorama nor the rig.
    """

    def __init__(self, sizes: tuple[tuple[int, int], ...], rig: Rig | None, rows: int | None, name: str) -> None:
        self.name, self.rig = name, rig
        self.unseen: np.ndarray | None = None
        self._stitcher: Stitcher | None = None
        if rig is not None:
            factor = rig.factor_of(sizes, name)
            own = rig.scaled(factor)
            self._stitcher = Stitcher(own, own.rows if rows is None else min(rows, own.rows))
            self.grid, self.unseen = self._stitcher.grid, self._stitcher.unseen
            self.wanted = tuple((height, width) for width, height in self._stitcher.sizes)
            return
        if len(sizes) > 1:
            raise ImageError(f"{name} gives {len(sizes)} pictures at a time, one for each lens. {MAKE}")
        width, height = next(iter(sizes))
        if abs(width - 2 * height) > ROUNDING:
            raise ImageError(
                f"{name} gives pictures of {width} x {height}, not 2:1; wanted whole panoramas, twice as wide as high. "
                f"Set the camera to 360-degree (equirectangular) pictures. If these are pictures of lenses: {MAKE}"
            )
        count = height if rows is None else min(rows, height)
        self.grid, self.wanted = ErpGrid(count, 2 * count), ((count, 2 * count),)

    def check(self, *pictures: np.ndarray) -> None:
        """Look at the first pictures ``(H, W, 3)`` uint8. Raises `ImageError` for fisheye circles without a rig."""
        if self.rig is None and (circles := fisheye_circles(pictures[0])):
            what = "the two circles of a dual fisheye camera, side by side" if circles == 2 else "a fisheye's circle"
            raise ImageError(f"{self.name} shows {what}, and no panorama: directions would be wrong. {MAKE}")

    def make(self, *pictures: np.ndarray) -> np.ndarray:
        """The panorama ``(*grid.shape, 3)`` uint8 of the pictures of one moment. Raises `ImageError`."""
        if self._stitcher is not None:
            return self._stitcher.stitch(*pictures)
        (picture,) = pictures
        return picture if picture.shape[:2] == self.grid.shape else resized(picture, self.grid.shape, wrap=True)
