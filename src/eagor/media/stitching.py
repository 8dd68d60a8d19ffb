"""What pictures of a source are, decided in one place, and frames made of them: `PanoramaBuilder`.

A whole panorama, one with two eyes, an ordinary camera's picture, or the pictures of lenses, which `Stitcher` puts
together: one panorama, and a mask of what no lens sees.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor.cameras import Rig, Sampler
from eagor.errors import ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media.defects import MAKE, STITCH, TWICE, circles_in_words, two_eyes
from eagor.media.intrinsics import ASK, Camera, IntrinsicsHint, ShapeError, ordinary_grid
from eagor.media.metadata import Projection
from eagor.media.panorama import by_area, checked_picture, resized, resized_mask

__all__ = ["PanoramaBuilder", "Stitcher", "seen_by", "sizes_of"]

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


def seen_by(rig: Rig, panorama: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the rig's camera shows of a panorama ``(H, W, 3)`` uint8: its pictures ``(H, W, 3)``, black beyond the rims.

    Bicubic, without a low-pass filter: give a panorama that is about as fine as the pictures. Raises `ImageError`.
    """
    grid = ErpGrid(*checked_picture(panorama).shape[:2])
    pictures = tuple(np.zeros((height, width, 3), np.uint8) for width, height in rig.sizes)
    for lens in rig.lenses:
        width, height = rig.sizes[lens.picture]
        x, y = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5
        directions = lens.unproject(x, y)
        back_x, back_y, depth = lens.project(directions)
        shown = (np.hypot(back_x - x, back_y - y) < 1) & (depth >= 0)
        pictures[lens.picture][shown] = Sampler(grid, directions[shown], cubic=True)(panorama)
    return pictures


class PanoramaBuilder:
    """Says what pictures of `sizes` (width, height) are, of a source called `name`, and makes frames of them.

    `rig`: they are those of its lenses. `camera`: what is known otherwise; `hint`: what a file says of an ordinary
    lens, for pictures that are not 2:1, unless `force`: then they are panoramas all the same. `rows`: the most rows;
    larger pictures are shrunk. `grid`: of what it makes, a `PerspectiveGrid` for an ordinary camera's pictures;
    `unseen` ``(H, W)``: what no lens sees, or None; `wanted`: rows and columns to which each picture is to be brought
    while it is decoded. Raises `ShapeError` where nothing tells what they are, `ImageError` where they do not fit.
    """

    def __init__(
        self,
        sizes: Sequence[tuple[int, int]],
        name: str,
        *,
        rig: Rig | None = None,
        camera: Camera | None = None,
        hint: IntrinsicsHint = NO_HINT,
        rows: int | None = None,
        force: bool = False,
    ) -> None:
        camera = camera or Camera()
        if rig is None and camera.rig is not None and not camera.rig.lenses[0].is_ordinary:
            rig = camera.rig
        self.name, self.rig, self.unseen = name, rig, None
        self.grid: ErpGrid | PerspectiveGrid
        self._stitcher, self._layout = None, None
        self._settled = force or rig is not None or camera.eyes is not None
        if rig is not None:
            own = rig.scaled(rig.factor_of(sizes, name))
            self._stitcher = Stitcher(own, own.rows if rows is None else min(rows, own.rows))
            self.grid, self.unseen = self._stitcher.grid, self._stitcher.unseen
            self.wanted = tuple((height, width) for width, height in self._stitcher.sizes)
            return
        if len(sizes) > 1:
            raise ImageError(f"{name} gives {len(sizes)} pictures at a time, one for each lens. {MAKE}")
        (width, height), *_ = sizes
        whole, eyes = is_twice_as_wide(height, width), camera.eyes or "mono"
        if eyes != "mono":
            self._layout = Projection.of_eyes(eyes).layout(height, width, rows)
            self.grid, self.unseen = ErpGrid(*self._layout.shape), self._layout.unseen
            self.wanted = (self._layout.size,)
            return
        view = None
        if camera.known or not (whole or force or camera.eyes):
            view = ordinary_grid(camera, hint, (width, height), name)
        if view is None and not (whole or force):
            why = f" ({'; '.join(hint.facts)})" if hint.facts else ""
            raise ShapeError(
                f"{name} is {width} x {height}, not 2:1 as a whole panorama is, and does not tell its lens{why}. {ASK}"
                f". Are these the pictures of lenses? {MAKE}. A panorama all the same: --force ({STRETCHED})"
            )
        by = 1.0 if rows is None else min(1.0, rows / height)
        self._settled |= view is not None
        count, columns = max(1, round(height * by)), max(1, round(width * by))
        self.grid = ErpGrid(count, 2 * count if whole else columns) if view is None else view.resized(count, columns)
        self.wanted = (self.grid.shape,)

    @property
    def view(self) -> PerspectiveGrid | None:
        """The grid of an ordinary camera's pictures; None where it makes panoramas."""
        return self.grid if isinstance(self.grid, PerspectiveGrid) else None

    def hidden(self, mask: np.ndarray | None) -> np.ndarray | None:
        """What is not seen of a frame, if a `mask` ``(H, W)`` says so of its picture, or None."""
        if mask is None:
            return self.unseen
        if self._layout is None:
            return mask
        own = self._layout.place(resized_mask(mask, self._layout.size))
        return own if self.unseen is None else own | self.unseen

    def check(self, *pictures: np.ndarray) -> None:
        """Look at the first pictures ``(H, W, 3)`` uint8. Raises `ShapeError` for fisheye circles, or two eyes."""
        if self._settled:
            return
        if circles := circles_in_words(pictures[0]):
            advice = f"{MAKE}, or stitch it first, {STITCH}. To look at it all the same: --force"
            raise ShapeError(f"{self.name} shows {circles}, and no panorama: directions would be wrong. {advice}")
        if eyes := two_eyes(pictures[0]):
            raise ShapeError(f"{self.name} {TWICE[eyes]}")

    def make(self, *pictures: np.ndarray) -> np.ndarray:
        """The frame ``(*grid.shape, 3)`` uint8 of the pictures of one moment. Raises `ImageError`."""
        if self._stitcher is not None:
            return self._stitcher.stitch(*pictures)
        (picture,) = pictures
        if self._layout is not None:
            return self._layout.place(resized(picture, self._layout.size))
        return resized(picture, self.grid.shape, wrap=self.view is None)
