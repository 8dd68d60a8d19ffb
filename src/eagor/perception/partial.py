"""Looking at part of the sphere: any perception made ready for a camera that sees one perspective picture at a time.

A perception that has a method ``view`` (`ViewPerception`) is shown the picture itself. Any other is shown a panorama in
which only the picture's part is filled, and what it says about the rest counts as never looked at.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eagor.errors import ImageError
from eagor.evidence import Evidence
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid
from eagor.perception import Perception
from eagor.sphere import world_R_body

ROWS = 256  # of the panorama that a picture is put into, for perceptions that do not say
BORDER = 0.5  # share of a response's cell that the picture has to fill for the cell to count as looked at


@runtime_checkable
class ViewPerception(Protocol):
    """A perception that takes ordinary pictures."""

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `image` ``(h, w, 3)`` uint8, in the frame that `grid` is posed in.

        `grid` describes the picture's pixels. The evidence is on a `PerspectiveGrid` with the same pose and field of
        view, of any size. Errors as for a panorama.
        """
        ...


def look_at_view(
    perception: Perception, image: np.ndarray, pitch: float, hfov: float, query: str, *, stamp: float | None = None
) -> Evidence:
    """Evidence from one perspective picture, in the frame of a body that stands upright and faces where it was taken.

    Args:
        perception: any; see the module.
        image: ``(h, w, 3)`` uint8, square pixels.
        pitch: radians by which the camera looks UP from the horizon. (Where it looks around the vertical does not
            matter: turn the evidence's coefficients with the body.)
        hfov: horizontal field of view, radians.
        query: what to look for.
        stamp: when it was taken, seconds.

    Raises `ImageError` if the image is no picture; else what the perception raises.
    """
    picture = np.asarray(image)
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise ImageError(f"a picture is (h, w, 3) uint8; got shape {picture.shape}, {picture.dtype}")
    height, width = picture.shape[:2]
    grid = PerspectiveGrid(height, width, hfov, world_R_body(0.0, -pitch))
    if isinstance(perception, ViewPerception):
        return perception.view(picture, grid, query, stamp=stamp)
    panorama = pasted(picture, grid, int(getattr(perception, "rows", ROWS)))
    found = perception(panorama, query, stamp=stamp)
    covered = coverage(grid, found.grid)
    seen = Evidence.from_response(found.response, found.grid, found.calibration, stamp, coverage=covered >= BORDER)
    source: dict[str, Any] = {"source": getattr(found, "source", None)}  # what the perception tells of itself
    return replace(seen, **source) if source["source"] else seen


def pasted(picture: np.ndarray, grid: PerspectiveGrid, rows: int) -> np.ndarray:
    """A panorama ``(rows, 2 rows, 3)`` uint8 with `picture` where `grid` looks, and its mean colour elsewhere.

    A picture that is finer than the panorama is shrunk first, so that nothing is left out between the pixels.
    """
    from PIL import Image

    target = ErpGrid(rows, 2 * rows)
    wide = 2 * rows / math.pi * math.tan(grid.hfov / 2)  # columns at which both are equally fine in the middle
    if grid.width > 1.2 * wide:
        size = max(1, round(wide)), max(1, round(wide * grid.height / grid.width))
        picture = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
    height, width = picture.shape[:2]
    x, y, inside = grid.project(target.directions)
    u = np.clip(x[inside] * (width / grid.width) - 0.5, 0, width - 1)
    v = np.clip(y[inside] * (height / grid.height) - 0.5, 0, height - 1)
    left, top = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (u - left)[:, None], (v - top)[:, None]
    values = picture.astype(np.float32)
    upper = values[top, left] * (1 - across) + values[top, right] * across
    lower = values[below, left] * (1 - across) + values[below, right] * across
    panorama = np.empty((*target.shape, 3), dtype=np.uint8)
    panorama[:] = np.rint(picture.reshape(-1, 3).mean(axis=0)).astype(np.uint8)
    panorama[inside] = np.rint(upper * (1 - down) + lower * down).astype(np.uint8)
    return panorama


def coverage(grid: PerspectiveGrid, cells: ErpGrid | PatchGrid | PerspectiveGrid | object) -> np.ndarray:
    """How much of each of `cells` ``(H, W)`` the view `grid` shows, 0 to 1 (by 5 x 5 points in each)."""
    height, width = cells.shape  # type: ignore[attr-defined]
    offsets = (np.arange(5) + 0.5) / 5
    x = (np.arange(width)[:, None] + offsets).reshape(-1)
    y = (np.arange(height)[:, None] + offsets).reshape(-1, 1)
    _, _, inside = grid.project(cells.unproject(x, y))  # type: ignore[attr-defined]
    return inside.reshape(height, 5, width, 5).mean(axis=(1, 3))
