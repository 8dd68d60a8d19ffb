"""Put the pictures of a camera's lenses together to a panorama, and take one apart.

`Panoramas` does so for the pictures of a source, as they are or stitched, and refuses those that are no good for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._checks import is_twice_as_wide
from eagor._extras import need
from eagor._values import lazy
from eagor.errors import ImageError
from eagor.grids import ErpGrid, PerspectiveGrid
from eagor.media.defects import TWICE, fisheye_circles, two_eyes
from eagor.media.intrinsics import ASK, Camera, ShapeError, Told, ordinary_grid
from eagor.media.metadata import Layout, Projection
from eagor.media.panorama import checked_picture, resized
from eagor.media.rigs import Rig

__all__ = ["Panoramas", "Stitcher", "seen_by"]

RIM = 1.5  # pixels along the rim that are left out: interpolation would mix them with what lies beyond
PAD = 8  # columns, and rows over the poles, that are added around a panorama before it is sampled
STRIP = 1024  # width of the tables of the overlap; OpenCV takes sides below 32768

MOST_ROWS = 1 << 14  # of a panorama: the directions of its pixels take 13 GB

MAKE = "Give its lenses with --rig FILE.yaml (eagor camera calibrate makes one)"


@dataclass(frozen=True, eq=False)
class _Layer:
    """What one lens each shows of a panorama's pixels: the `table` for OpenCV says where to read them.

    `pixels` ``(n,)``: those of the panorama that are blended, with `weights` ``(n, 3)`` of 256; `places`: where they
    are among all that are blended. The first layer's table has all pixels of the panorama, those of the others theirs.
    """

    pixels: np.ndarray
    table: tuple[np.ndarray, np.ndarray]
    weights: np.ndarray
    places: np.ndarray | slice


class Stitcher:
    """Makes panoramas of `rows` rows from pictures of a `rig`; tables are made once, and all frames use them.

    Where several lenses see the same, they are blended: a lens counts in proportion to the distance from the rim of its
    picture, so that no seam is to be seen where they agree. What no lens sees is black, and True in `unseen` ``(rows,
    2 rows)`` (None if all is seen). Pictures are first brought to the rig's `sizes`, made about as fine as the
    panorama. Needs OpenCV (`MissingExtraError`).
    """

    def __init__(self, rig: Rig, rows: int | None = None) -> None:
        need("stitching pictures of lenses", "photos", "cv2")
        rows = rig.rows if rows is None else rows
        if not 2 <= rows <= MOST_ROWS:
            raise ImageError(f"rows = {rows}; wanted 2 to {MOST_ROWS}: is a lens' focal length or radius too large?")
        self.grid = ErpGrid(rows, 2 * rows)
        self.rig = rig.scaled(min(1.0, rows / rig.rows))
        self._offsets = np.cumsum([0, *(width for width, _ in self.rig.sizes)])

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """Width and height to which each picture is brought."""
        return self.rig.sizes

    @lazy
    def _depths(self) -> np.ndarray:
        """How deep each pixel of the panorama is inside each lens' rim, ``(lenses, rows * 2 rows)``, radians."""
        return np.stack([self._positions(k)[2] for k in range(len(self.rig.lenses))])

    def _positions(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place on the canvas, and depth, ``(n,)`` each, of the panorama's pixels in one lens."""
        lens = self.rig.lenses[index]
        x, y, depth = lens.project(self.grid.directions.reshape(-1, 3))
        wide, high = self.rig.sizes[lens.picture]
        depth[(x < 0) | (x > wide) | (y < 0) | (y > high)] = -1  # a fisheye's circle may be larger than its picture
        return x + self._offsets[lens.picture] - 0.5, y - 0.5, depth - RIM / lens.pixels_per_radian

    @property
    def unseen(self) -> np.ndarray | None:
        """The mask ``(rows, 2 rows)`` of what no lens sees, or None."""
        mask = (self._depths.max(axis=0) <= 0).reshape(self.grid.shape)
        return mask if mask.any() else None

    @lazy
    def _layers(self) -> tuple[_Layer, ...]:
        """First the deepest lens of each pixel, then the second deepest where there is one, and so on."""
        import cv2

        count, n = self._depths.shape
        order = np.argsort(-self._depths, axis=0, kind="stable")
        ranked = np.take_along_axis(self._depths, order, axis=0)
        share = np.maximum(ranked, 0)
        share = share / np.maximum(share.sum(axis=0), 1e-12)
        places = np.stack([np.stack(self._positions(k)[:2]) for k in range(count)]).astype(np.float32)
        whole = np.rint(256 * share[1:]).astype(np.uint16)
        whole = np.concatenate([256 - whole.sum(axis=0, keepdims=True, dtype=np.uint16), whole])  # to 256 exactly
        shared = np.flatnonzero(ranked[1] > 0) if count > 1 else np.empty(0, np.intp)
        layers = []
        for rank in range(count):
            pixels = np.arange(n) if rank == 0 else np.flatnonzero(ranked[rank] > 0)
            if len(pixels) == 0:
                break
            x, y = places[order[rank, pixels], :, pixels].T
            if rank == 0:
                hidden = ranked[0] <= 0
                x, y = np.where(hidden, -9, x), np.where(hidden, -9, y)
                shape = self.grid.shape
            else:  # any shape will do
                full = -len(pixels) % STRIP
                x, y = (np.pad(each, (0, full), constant_values=-9) for each in (x, y))
                shape = (-1, STRIP)
            table = cv2.convertMaps(x.reshape(shape), y.reshape(shape), cv2.CV_16SC2)
            own = shared if rank == 0 else pixels
            weights = np.repeat(whole[rank, own][:, None], 3, axis=1)
            among = slice(None) if len(own) == len(shared) else np.searchsorted(shared, own)
            layers.append(_Layer(own, table, weights, among))  # type: ignore[arg-type]
        return tuple(layers)

    def canvas(self, pictures: tuple[np.ndarray, ...]) -> np.ndarray:
        """The pictures ``(H, W, 3)`` uint8 at their `sizes`, side by side. Raises `ImageError`."""
        import cv2

        given = tuple((checked_picture(p, "a picture").shape[1], p.shape[0]) for p in pictures)
        self.rig.factor_of(given, "a picture")
        scaled = [
            picture
            if size == own
            else cv2.resize(picture, own, interpolation=cv2.INTER_AREA if size[0] > own[0] else cv2.INTER_LINEAR)
            for picture, size, own in zip(pictures, given, self.sizes, strict=True)
        ]
        if len(scaled) == 1:
            return np.ascontiguousarray(scaled[0])
        height = max(each.shape[0] for each in scaled)
        return np.hstack([np.pad(each, ((0, height - each.shape[0]), (0, 0), (0, 0))) for each in scaled])

    def stitch(self, *pictures: np.ndarray) -> np.ndarray:
        """The panorama ``(rows, 2 rows, 3)`` uint8 of the pictures of one moment, ``(H, W, 3)`` uint8 each.

        Raises `ImageError` for another number of pictures, or another shape.
        """
        import cv2

        canvas = self.canvas(pictures)
        first, *others = self._layers
        panorama = cv2.remap(canvas, *first.table, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
        if not others:
            return panorama
        flat = panorama.reshape(-1, 3)
        # 255 * 256 and a half fit into 16 bits.
        total = np.multiply(np.take(flat, first.pixels, axis=0), first.weights, dtype=np.uint16)
        for layer in others:
            read = cv2.remap(canvas, *layer.table, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
            read = read.reshape(-1, 3)[: len(layer.pixels)]
            total[layer.places] += np.multiply(read, layer.weights, dtype=np.uint16)
        total += 128
        total >>= 8
        flat[first.pixels] = total
        return panorama

    def alone(self, index: int, *pictures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What one lens sees, as a panorama ``(rows, 2 rows, 3)`` black elsewhere, and where it sees."""
        import cv2

        x, y, depth = (each.reshape(self.grid.shape).astype(np.float32) for each in self._positions(index))
        read = cv2.remap(self.canvas(pictures), x, y, cv2.INTER_CUBIC)
        seen = depth > 0
        read[~seen] = 0
        return read, seen


def seen_by(rig: Rig, panorama: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the rig's camera shows of a panorama ``(H, W, 3)`` uint8: its pictures ``(H, W, 3)``, black beyond the rims.

    Bicubic, without a low-pass filter: give a panorama that is about as fine as the pictures. Raises `ImageError`.
    """
    need("taking a panorama apart", "photos", "cv2")
    import cv2

    image = checked_picture(panorama)
    grid, half = ErpGrid(*image.shape[:2]), image.shape[1] // 2
    # Beyond a pole the picture goes on half a turn away.
    tall = np.concatenate([np.roll(image[PAD - 1 :: -1], half, 1), image, np.roll(image[: -PAD - 1 : -1], half, 1)])
    canvas = np.concatenate([tall[:, -PAD:], tall, tall[:, :PAD]], axis=1)
    pictures = [np.zeros((height, width, 3), np.uint8) for width, height in rig.sizes]
    for lens in rig.lenses:
        picture = pictures[lens.picture]
        height, width = picture.shape[:2]
        directions = lens.unproject(np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None])
        x, y = ((place + PAD - 0.5).astype(np.float32) for place in grid.project(directions)[:2])
        read = cv2.remap(canvas, x, y, cv2.INTER_CUBIC)
        back_x, back_y, depth = lens.project(directions)
        near = np.hypot(back_x - np.arange(width) - 0.5, back_y - np.arange(height)[:, None] - 0.5) < 1
        shown = near & (depth >= 0)
        picture[shown] = read[shown]
    return tuple(pictures)


class Panoramas:
    """Makes panoramas from pictures of `sizes` (width, height), of a source called `name`.

    Without a `rig` the one picture is a panorama, or with a `camera` that is known, an ordinary one, which stays what
    it is. `rows`: the most rows; larger pictures are shrunk. `grid`: of what it makes; `unseen` ``(H, W)``: what no
    lens sees, or None; `wanted`: rows and columns to which each picture is to be brought while it is decoded. Raises
    `ImageError` for sizes that fit neither a panorama, nor the rig, nor the camera.
    """

    def __init__(
        self,
        sizes: tuple[tuple[int, int], ...],
        rig: Rig | None,
        rows: int | None,
        name: str,
        camera: Camera | None = None,
    ) -> None:
        if camera is not None and camera.wide:
            rig = camera.rig
        self.name, self.rig = name, rig
        self.unseen: np.ndarray | None = None
        self.grid: ErpGrid | PerspectiveGrid
        self._stitcher: Stitcher | None = None
        self._layout: Layout | None = None
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
        self.settled = camera is not None and camera.eyes is not None
        if camera is not None and camera.eyes not in (None, "mono"):
            self._layout = Projection.of_eyes(camera.eyes).layout(height, width, rows)
            self.grid, self.unseen = ErpGrid(*self._layout.shape), self._layout.unseen
            self.wanted = (self._layout.size,)
            return
        view = None if camera is None else ordinary_grid(camera, Told(), (width, height), name)
        if view is not None:
            by = 1.0 if rows is None else min(1.0, rows / height)
            self.grid = view.resized(max(1, round(height * by)), max(1, round(width * by)))
            self.wanted = (self.grid.shape,)
            return
        if not is_twice_as_wide(height, width):
            raise ShapeError(
                f"{name} gives pictures of {width} x {height}, not 2:1; wanted whole panoramas, twice as wide as high. "
                f"Set the camera to 360-degree (equirectangular) pictures. If these are pictures of lenses: {MAKE}. An "
                f"ordinary camera? {ASK}"
            )
        count = height if rows is None else min(rows, height)
        self.grid, self.wanted = ErpGrid(count, 2 * count), ((count, 2 * count),)

    @property
    def view(self) -> PerspectiveGrid | None:
        """The grid of an ordinary camera's pictures; None where it makes panoramas."""
        return self.grid if isinstance(self.grid, PerspectiveGrid) else None

    def check(self, *pictures: np.ndarray) -> None:
        """Look at the first pictures ``(H, W, 3)`` uint8. Raises `ImageError` for fisheye circles, or two eyes."""
        if self.rig is not None or self.view is not None or self.settled:
            return
        if circles := fisheye_circles(pictures[0]):
            what = "the two circles of a dual fisheye camera, side by side" if circles == 2 else "a fisheye's circle"
            raise ImageError(f"{self.name} shows {what}, and no panorama: directions would be wrong. {MAKE}")
        if eyes := two_eyes(pictures[0]):
            raise ImageError(f"{self.name} {TWICE[eyes]}")

    def make(self, *pictures: np.ndarray) -> np.ndarray:
        """The panorama ``(*grid.shape, 3)`` uint8 of the pictures of one moment. Raises `ImageError`."""
        if self._stitcher is not None:
            return self._stitcher.stitch(*pictures)
        (picture,) = pictures
        if self._layout is not None:
            return self._layout.place(resized(picture, self._layout.size))
        whole = self.view is None
        return picture if picture.shape[:2] == self.grid.shape else resized(picture, self.grid.shape, wrap=whole)
