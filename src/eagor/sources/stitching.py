"""What pictures of a source are, decided in one place, and frames made of them: `PanoramaBuilder`.

A whole panorama, one with two eyes, an ordinary camera's picture, or the pictures of lenses, which `Stitcher` puts
together: one panorama, and a mask of what no lens sees.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from eagor._checks import is_twice_as_wide, whole
from eagor.cameras import Rig, Sampler
from eagor.errors import ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.sources.defects import MAKE, STITCH, TWICE, circles_in_words, two_eyes
from eagor.sources.intrinsics import ASK, Camera, IntrinsicsHint, ShapeError, ordinary_grid
from eagor.sources.metadata import EYES, Projection
from eagor.sources.panorama import by_area, checked_picture, resized

__all__ = ["PanoramaBuilder", "Stitcher", "sizes_of"]

STRETCHED = "all columns for 360 degrees, all rows for 180"
MOST_ROWS = 1 << 14  # of a panorama: the directions of its pixels take 13 GB
NO_HINT = IntrinsicsHint()


def sizes_of(pictures: Iterable[np.ndarray]) -> tuple[tuple[int, int], ...]:
    """Width and height of each picture ``(H, W, ...)``, as rigs count them."""
    return tuple((picture.shape[1], picture.shape[0]) for picture in pictures)


class Stitcher:
    """Makes panoramas of `rows` rows (default: as fine as the sharpest lens) from pictures of a `rig`.

    What no lens sees is black, and True in `unseen` ``(rows, 2 rows)`` (None if all is seen). Pictures are first
    brought to `sizes`, about as fine as the panorama. Raises `ImageError`.
    """

    def __init__(self, rig: Rig, rows: int | None = None) -> None:
        rows = rig.rows if rows is None else rows
        if not 2 <= rows <= MOST_ROWS:
            raise ImageError(f"rows = {rows}; wanted 2 to {MOST_ROWS}: is a lens' focal length or radius too large?")
        self.grid = ErpGrid(rows, 2 * rows)
        self.rig = rig.scaled(min(1.0, rows / rig.rows))
        self.sizes = self.rig.sizes
        self._sampler = Sampler(self.rig, self.grid.directions, cubic=True)
        self.unseen = None if self._sampler.seen.all() else ~self._sampler.seen

    def scaled(self, pictures: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The pictures ``(H, W, 3)`` uint8 of one moment at their `sizes`. Raises `ImageError` for another shape."""
        self.rig.factor_of(sizes_of(checked_picture(each, "a picture") for each in pictures), "a picture")
        return [by_area(each, high, wide) for each, (wide, high) in zip(pictures, self.sizes, strict=True)]

    def stitch(self, *pictures: np.ndarray) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 of the pictures of one moment. Raises `ImageError`."""
        return self._sampler(*self.scaled(pictures))

    def alone(self, index: int, *pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What one lens sees, as a panorama ``(rows, 2 rows, 3)`` black elsewhere, and where it sees."""
        own = Sampler(Rig(self.sizes, (self.rig.lenses[index],)), self.grid.directions, cubic=True)
        return own(*self.scaled(pictures)), own.seen


class PanoramaBuilder:
    """Says what pictures of `sizes` (width, height) are, of a source called `name`, and makes frames of them.

    `rig`: they are those of its lenses. `camera`: what the user knows otherwise; after it counts what a file says:
    `projection` of the sphere, and `hint` of an ordinary lens, for pictures that are not 2:1. `force`: what nothing is
    known of is a panorama all the same. `rows`: the most rows; larger pictures are shrunk.

    `grid`: of what it makes; `unseen` ``(H, W)``: what they do not show, or None; `wanted`: rows and columns to which
    each picture may be brought while it is decoded; `fisheye`: whether the camera's calibration is one; `facts`: what
    the file says, in sentences; `level_R_body`: None, or the rotation ``(3, 3)`` that makes frames level; `refused`:
    why nothing tells what they are, else "". Raises `ImageError` where sizes do not fit.
    """

    def __init__(
        self,
        sizes: Sequence[tuple[int, int]],
        name: str,
        *,
        rig: Rig | None = None,
        camera: Camera | None = None,
        hint: IntrinsicsHint = NO_HINT,
        projection: Projection | None = None,
        rows: int | None = None,
        force: bool = False,
    ) -> None:
        if rows is not None and not whole(rows, 1):
            raise ImageError(f"rows = {rows!r}; wanted a whole number of at least 1, or None for those of the pictures")
        camera = camera or Camera()
        self.fisheye = rig is None and camera.rig is not None and not camera.rig.lenses[0].is_ordinary
        rig = camera.rig if self.fisheye else rig
        self.name, self.rig, self.unseen, self.refused, self._stitcher = name, rig, None, "", None
        self.grid: ErpGrid | PerspectiveGrid
        self.level_R_body, self.facts = None, ()
        self._settled = force or rig is not None or camera.eyes is not None
        if rig is not None:
            own = rig.scaled(rig.factor_of(sizes, name))
            self._stitcher = Stitcher(own, own.rows if rows is None else min(rows, own.rows))
            self.grid, self.unseen = self._stitcher.grid, self._stitcher.unseen
            self.wanted = tuple((height, width) for width, height in self._stitcher.sizes)
            return
        if len(sizes) > 1:
            raise ImageError(f"{name} gives {len(sizes)} pictures at a time, one for each lens. {MAKE}")
        ((width, height),) = sizes
        if projection is not None:
            projection.check(name, force)
            self.level_R_body, self.facts = projection.level_R_body, projection.facts()
        if camera.eyes not in (None, "mono"):
            projection, self.facts = Projection.of_eyes(camera.eyes), ()
        projection = projection or Projection("nothing", "rectangular")
        *_, down, across = EYES[projection.stereo]
        high, wide = max(1, round(height * down)), max(1, round(width * across))
        sphere = projection.kind == "equirectangular" or is_twice_as_wide(high, wide)
        view, part = None, any(projection.cropped)
        squeezed = not (part or camera.eyes or projection.wrong or is_twice_as_wide(high, wide))
        if projection.kind == "equirectangular" and squeezed:
            eyes = "" if projection.stereo == "mono" else ". Of half spheres (VR180): --eyes vr180"
            self.facts += (f"it shows {wide} x {high}, not 2:1, and names no part: taken with {STRETCHED}{eyes}",)
        if not part and (camera.known or not (sphere or force or camera.eyes)):
            view = ordinary_grid(camera, hint, (wide, high), name)
        if view is None and not (sphere or force):
            why = f" ({'; '.join(hint.facts)})" if hint.facts else ""
            self.refused = (
                f"is {wide} x {high}, not 2:1 as a whole panorama is, and does not tell its lens{why}. {ASK}. Are "
                f"these the pictures of lenses? {MAKE}. A panorama all the same: --force ({STRETCHED})"
            )
        self._settled |= view is not None or part or projection.stereo != "mono"
        self._layout = layout = projection.layout((wide, high), rows, view is None and sphere)
        self.grid = ErpGrid(*layout.shape) if view is None else view.resized(*layout.shape)
        self.unseen = layout.unseen
        self.wanted = (self._layout.size,)

    @property
    def view(self) -> PerspectiveGrid | None:
        """The grid of an ordinary camera's pictures; None where it makes panoramas."""
        return self.grid if isinstance(self.grid, PerspectiveGrid) else None

    def hidden(self, mask: np.ndarray | None) -> np.ndarray | None:
        """What is not seen of a frame, if a `mask` ``(H, W)`` says so of its picture, or None."""
        if mask is None or self._stitcher is not None:
            return self.unseen
        grey = np.repeat(np.uint8(255) * mask[..., None], 3, axis=2)
        own = self._layout.place(resized(grey, self._layout.size)[..., 0] > 127)
        return own if self.unseen is None else own | self.unseen

    def check(self, *pictures: np.ndarray, name: str = "") -> None:
        """Look at the first pictures ``(H, W, 3)`` uint8. Raises `ShapeError` if refused, for circles, or two eyes."""
        name = name or self.name
        if not self._settled and (circles := circles_in_words(pictures[0])) and not self.refused:
            advice = f"{MAKE}, or stitch it first, {STITCH}. To look at it all the same: --force"
            raise ShapeError(f"{name} shows {circles}, and no panorama: directions would be wrong. {advice}")
        if not self._settled and (eyes := two_eyes(pictures[0])):
            raise ShapeError(f"{name} {TWICE[eyes]}")
        if self.refused:
            raise ShapeError(f"{name} {self.refused}")

    def make(self, *pictures: np.ndarray) -> np.ndarray:
        """The frame ``(*grid.shape, 3)`` uint8 of the pictures of one moment. Raises `ImageError`."""
        if self._stitcher is not None:
            return self._stitcher.stitch(*pictures)
        (picture,), size = pictures, self._layout.size
        return self._layout.place(resized(picture, size, wrap=self.view is None and size == self._layout.shape))
