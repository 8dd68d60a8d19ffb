"""Any perception for a camera that sees only part of the sphere: single perspective pictures, and masks.

A perception with the method ``view`` (`ViewPerception`) gets the picture itself. Any other gets a panorama in which
only the picture's part is filled; the rest counts as never looked at. `Masked` leaves out what the camera never sees
of a panorama: its own carrier.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
from PIL import Image

from eagor.errors import ImageError
from eagor.evidence import BodyMask, Evidence
from eagor.evidence.detections import View
from eagor.evidence.shapes import canvas_of
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid, ViewKey, forward_view, view_key
from eagor.media.panorama import checked_picture
from eagor.perception import Perception, look, rows_of
from eagor.perception.vlm.projection import bilinear

__all__ = ["Masked", "read_mask"]

BORDER = 0.5  # share of a cell that the picture has to fill for the cell to count as looked at


@runtime_checkable
class ViewPerception(Protocol):
    """A perception that takes perspective pictures."""

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `image` ``(h, w, 3)`` uint8, in the frame that `grid` is posed in.

        `grid` describes the pixels. The evidence is on a `PerspectiveGrid` with the same pose and field of view, of
        any size. Errors as for a panorama.
        """
        ...


def look_at_view(
    perception: Perception, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None
) -> Evidence:
    """Evidence from one ordinary picture ``(h, w, 3)`` uint8 with the pixels of `grid`, in the frame of its body.

    What the picture does not show gains and loses nothing. Raises `ImageError` if the image is not such a picture, or
    the perception does not answer on a panorama grid; otherwise what the perception raises.
    """
    picture = checked_picture(image, "the picture", grid)
    if isinstance(perception, ViewPerception):
        return perception.view(picture, grid, query, stamp=stamp)
    panorama = pasted(picture, grid, rows_of(perception))
    found = perception(panorama, query, stamp=stamp)
    if isinstance(found.grid, PerspectiveGrid | FisheyeGrid):
        raise ImageError(
            f"the perception {type(perception).__name__} answers a panorama on a {type(found.grid).__name__}; wanted "
            "cells of the panorama, or a method view that takes pictures"
        )
    if found.detections is not None:
        return _in_view(found, grid)
    cells = _kept(found.grid)
    covered = coverage(*cells.shape, grid)
    seen = Evidence.from_response(found.response, cells, found.calibration, stamp, coverage=covered >= BORDER)
    return replace(seen, source=found.source, looked_for=found.looked_for)


def _in_view(found: Evidence, grid: PerspectiveGrid) -> Evidence:
    """The detections that lie in the picture that `grid` describes; only this picture counts as looked at."""
    detections = found.detections
    assert detections is not None
    inside = grid.project(detections.directions)[2]
    parts = {key: getattr(detections, key)[inside] for key in ("directions", "axes", "ratios", "clutter", "scores")}
    seen = replace(detections, views=(View(grid),), **parts)
    made = Evidence.from_detections(seen, canvas_of(grid), found.stamp)
    return replace(made, source=found.source, looked_for=found.looked_for)


def pasted(picture: np.ndarray, grid: PerspectiveGrid, rows: int) -> np.ndarray:
    """A panorama ``(rows, 2 rows, 3)`` uint8 with `picture` where `grid` looks, and its mean colour elsewhere."""
    target = ErpGrid(rows, 2 * rows)
    wide = 2 * rows / math.pi * math.tan(grid.hfov / 2)  # width at which both have the same resolution in the middle
    if grid.width > 1.2 * wide:
        size = max(1, round(wide)), max(1, round(wide * grid.height / grid.width))
        picture = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
    x, y, inside = grid.project(target.directions)
    seen = bilinear(np.moveaxis(picture, -1, 0), x[inside] / grid.width, y[inside] / grid.height)
    panorama = np.empty((*target.shape, 3), dtype=np.uint8)
    panorama[:] = np.rint(picture.reshape(-1, 3).mean(axis=0)).astype(np.uint8)
    panorama[inside] = np.rint(seen.T).astype(np.uint8)
    return panorama


@lru_cache(maxsize=8)
def _kept(grid: ErpGrid | PatchGrid) -> ErpGrid | PatchGrid:
    """The first grid that was equal to this one: it has its directions computed already."""
    return grid


def coverage(rows: int, columns: int, grid: PerspectiveGrid) -> np.ndarray:
    """The fraction of each of `rows` x `columns` cells of a panorama that a view shows (by sample points in each)."""
    return _coverage(rows, columns, view_key(grid), grid.body_R_view.tobytes())


@lru_cache(maxsize=32)
def _coverage(rows: int, columns: int, lens: ViewKey, pose: bytes) -> np.ndarray:
    grid = replace(forward_view(lens), body_R_view=np.frombuffer(pose).reshape(3, 3))
    fine = 5 if rows <= 100 else 3
    offsets = (np.arange(fine) + 0.5) / fine
    x = (np.arange(columns)[:, None] + offsets).reshape(-1)
    y = (np.arange(rows)[:, None] + offsets).reshape(-1, 1)
    _, _, inside = grid.project(PatchGrid(rows, columns).unproject(x, y))
    return inside.reshape(rows, fine, columns, fine).mean(axis=(1, 3))


# --- masks ------------------------------------------------------------------------------------------------------------

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM")  # Pillow starts no other program for any of these
MOST = 1 << 27  # pixels: 16384 x 8192
GREY = 0.02  # share of pixels that may be neither black nor white: smoothed edges


class Masked:
    """The perception `perception`, whose looks say nothing where `mask` is black.

    `mask`: a `BodyMask`, or the array ``(H, W)`` for one.
    """

    def __init__(self, perception: Perception, mask: BodyMask | np.ndarray) -> None:
        self.perception = perception
        self.mask = mask if isinstance(mask, BodyMask) else BodyMask(mask)
        self.takes_pose, self.rows = bool(getattr(perception, "takes_pose", False)), rows_of(perception)

    def __call__(
        self, panorama: np.ndarray, query: str, *, stamp: float | None = None, world_R_body: np.ndarray | None = None
    ) -> Evidence:
        """One look, less what the mask hides. Errors as those of the perception."""
        return look(self.perception, panorama, query, stamp=stamp, world_R_body=world_R_body).covered(self.mask)

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """One look at an ordinary picture, less what the mask, which is one of the body, hides of it."""
        return look_at_view(self.perception, image, grid, query, stamp=stamp).covered(self.mask)

    def __repr__(self) -> str:
        hidden = 1 - float(np.sum(self.mask.seen * self.mask.grid.weights)) / (4 * np.pi)
        return f"Masked({self.perception!r}, {100 * hidden:.0f} % hidden)"


def read_mask(path: str | os.PathLike[str]) -> BodyMask:
    """The mask in a picture, 2:1, of any size: white where the camera sees the world, black where it never does.

    Any grey from half on counts as white; of a picture with no value above 1, 1 is white. Raises `ImageError`.
    """
    name = os.fspath(path)
    try:
        with Image.open(name, formats=FORMATS) as image:
            if image.width * image.height > MOST:
                raise ImageError(f"has {image.width} x {image.height} pixels; a mask of 1024 x 512 is fine enough")
            values = np.asarray(image.convert("L"), dtype=np.float64)
    except ImageError as error:
        raise ImageError(f"the mask {name} {error}") from error
    except Exception as error:  # Pillow's decoders may raise anything for damaged files
        reason: Any = getattr(error, "strerror", None) or error
        raise ImageError(
            f"the mask {name} cannot be read ({reason}); wanted a picture such as PNG, white where the camera sees"
        ) from error
    values = values / (255.0 if values.max() > 1 else 1.0)
    between = float(np.mean((values > 0.1) & (values < 0.9)))
    if between > GREY:
        raise ImageError(
            f"the mask {name} is grey in {100 * between:.0f} % of its pixels; wanted black and white: white where the "
            "camera sees the world, black where it never does"
        )
    try:
        return BodyMask(values >= 0.5)
    except ImageError as error:
        raise ImageError(f"{name}: {error}") from error
