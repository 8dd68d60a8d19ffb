"""What the camera never sees: the tripod, the robot's own back.

A `BodyMask` is fixed to the body, as the thing in the picture is. Under it a look says nothing: a detection there is no
detection, and seeing nothing there is no sign of absence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eagor._arrays import frozen
from eagor._checks import is_twice_as_wide
from eagor.errors import ImageError
from eagor.evidence.detections import Detections, View
from eagor.evidence.shapes import canvas_of
from eagor.grids import ErpGrid, Grid

__all__ = ["BodyMask"]

ROWS = 512  # finer masks are sampled at so many rows: cells of a third of a degree
MOSTLY = 0.5  # share of a detection's own extent that has to be seen for it to count
FINE = 3  # sample points along each side of a cell
SIDE = 9  # the same of a detection


@dataclass(frozen=True, eq=False)
class BodyMask:
    """What can be seen, ``(H, W)``: non-zero (white) where the camera sees the world, 0 (black) where it never does.

    The mask is a panorama in the body frame, twice as wide as high, of any size. Raises `ImageError` for another shape,
    and where nothing at all is seen.
    """

    seen: np.ndarray

    def __post_init__(self) -> None:
        seen = np.asarray(self.seen)
        if seen.ndim != 2 or not seen.size or not is_twice_as_wide(*seen.shape):
            shape = " x ".join(map(str, seen.shape[::-1])) if seen.ndim == 2 else f"of shape {seen.shape}"
            raise ImageError(
                f"the mask is {shape}; wanted a panorama twice as wide as high, (H, W): white where the camera sees "
                "the world, black where it never does"
            )
        if seen.dtype.kind not in "buif":
            raise ImageError(f"the mask holds {seen.dtype}; wanted bool, or numbers: 0 where the camera never sees")
        seen = seen != 0
        if not seen.any():
            raise ImageError("the mask is black everywhere, so nothing is seen; wanted white where the camera sees")
        if seen.shape[0] > ROWS:
            rows, columns = (np.arange(ROWS) + 0.5) / ROWS, (np.arange(2 * ROWS) + 0.5) / (2 * ROWS)
            seen = seen[np.ix_((rows * seen.shape[0]).astype(int), (columns * seen.shape[1]).astype(int))]
        object.__setattr__(self, "seen", frozen(seen))

    @property
    def grid(self) -> ErpGrid:
        """Its pixels, body frame."""
        return ErpGrid(*self.seen.shape)

    def at(self, directions: np.ndarray) -> np.ndarray:
        """Whether the camera sees directions ``(..., 3)`` of the body frame, bool."""
        height, width = self.seen.shape
        x, y, _ = self.grid.project(directions)
        return self.seen[np.clip(y.astype(int), 0, height - 1), x.astype(int) % width]

    def share(self, grid: Grid) -> np.ndarray:
        """The seen share ``(H, W)`` of each cell of `grid`."""
        height, width = grid.shape
        x = (np.arange(width * FINE) + 0.5) / FINE
        y = (np.arange(height * FINE)[:, None] + 0.5) / FINE
        return self.at(grid.unproject(x, y)).reshape(height, FINE, width, FINE).mean(axis=(1, 3))

    def view(self, view: View) -> View:
        """A view without what the mask covers."""
        grid = canvas_of(view.grid) if view.coverage is None else view.grid
        share = self.share(grid)
        return View(grid, share if view.coverage is None else share * view.coverage)

    def detections(self, found: Detections) -> Detections:
        """The detections without those whose own extent lies mostly under the mask, in what is left of the views."""
        kept = self._extents(found) >= MOSTLY
        names = "directions", "axes", "ratios", "clutter", "scores", "sizes"
        parts = {name: getattr(found, name)[kept] for name in names}
        views = tuple(map(self.view, found.views)) or (View(self.grid, self.seen.astype(np.float32)),)
        return replace(found, views=views if not self.seen.all() else found.views, **parts)

    def _extents(self, found: Detections) -> np.ndarray:
        """The seen share ``(n,)`` of each detection: of its own size, such as that of a box, not of its spread."""
        lengths = np.linalg.norm(found.axes, axis=-1)
        own = np.sqrt(np.maximum(lengths**-2 - found.model.spread**2, 0.0))
        # A uniform density of standard deviation s is as wide as sqrt(12) s. Lambert's plane ends at distance 2.
        steps = np.sqrt(3) * np.linspace(-1, 1, SIDE)
        across = np.clip(own[..., None] * steps, -1.2, 1.2)  # (n, 2, SIDE)
        axes = found.axes / lengths[..., None]
        first, second = (across[:, k, :, None] * axes[:, k, None] for k in (0, 1))  # (n, SIDE, 3)
        plane = first[:, :, None] + second[:, None]
        square = np.einsum("nijk,nijk->nij", plane, plane)[..., None]
        points = (1 - square / 2) * found.directions[:, None, None] + np.sqrt(np.maximum(1 - square / 4, 0.0)) * plane
        return self.at(points).mean(axis=(1, 2)) if len(found) else np.zeros(0)
