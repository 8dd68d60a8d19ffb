"""Any perception for a camera that sees only part of the sphere: ordinary pictures, and masks.

A perception with the method ``view`` (`ViewPerception`) gets the picture itself. Any other gets a panorama in which
only the picture's part is filled; the rest counts as never looked at.
"""

from __future__ import annotations

import math
import os
import warnings
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from eagor.cameras import Sampler
from eagor.errors import ImageError
from eagor.evidence import BodyMask, Evidence
from eagor.evidence.detections import View
from eagor.evidence.shapes import canvas_of
from eagor.grids import ErpGrid, FisheyeGrid, PatchGrid, PerspectiveGrid
from eagor.perception import Perception, rows_of
from eagor.sources.panorama import by_area, checked_picture, read_panorama

BORDER = 0.5  # share of a cell that the picture has to fill for the cell to count as looked at
GREY = 0.02  # share of a mask's pixels that may be neither black nor white: smoothed edges


@runtime_checkable
class ViewPerception(Protocol):
    """A perception that takes perspective pictures."""

    def view(self, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None) -> Evidence:
        """Evidence for what `query` names in `image` ``(h, w, 3)`` uint8, in the frame that `grid` is posed in.

        `grid` describes the pixels. The evidence is on a `PerspectiveGrid` with the same pose and field of view, of
        any size. Errors as for a panorama.
        """
        ...


def infer_view(
    perception: Perception, image: np.ndarray, grid: PerspectiveGrid, query: str, *, stamp: float | None = None
) -> Evidence:
    """Evidence from one ordinary picture ``(h, w, 3)`` uint8 with the pixels of `grid`, in the frame of its body.

    What the picture does not show gains and loses nothing. Raises `ImageError` if the image is not such a picture, or
    the perception does not answer on a panorama grid; otherwise what the perception raises.
    """
    picture = checked_picture(image, "the picture", grid)
    if isinstance(perception, ViewPerception):
        return perception.view(picture, grid, query, stamp=stamp)
    answer = perception(pasted(picture, grid, rows_of(perception)), query, stamp=stamp)
    if isinstance(answer.grid, PerspectiveGrid | FisheyeGrid):
        raise ImageError(
            f"the perception {type(perception).__name__} answers a panorama on a {type(answer.grid).__name__}; wanted "
            "cells of the panorama, or a method view that takes pictures"
        )
    if (detections := answer.detections) is not None:
        inside = grid.project(detections.directions)[2]
        names = ("directions", "axes", "ratios", "clutter", "scores", "sizes")
        parts = {name: getattr(detections, name)[inside] for name in names}
        inside_view = replace(detections, views=(View(grid),), **parts)
        part = Evidence.from_detections(inside_view, canvas_of(grid), answer.stamp)
    else:
        shown = coverage(*answer.grid.shape, grid) >= BORDER
        part = Evidence.from_response(answer.response, answer.grid, answer.calibration, stamp, coverage=shown)
    return replace(part, source=answer.source, looked_for=answer.looked_for)


def pasted(picture: np.ndarray, grid: PerspectiveGrid, rows: int) -> np.ndarray:
    """A panorama ``(rows, 2 rows, 3)`` uint8 with `picture` where `grid` looks, and its mean colour elsewhere."""
    wide = 2 * rows / math.pi * math.tan(grid.hfov / 2)  # width at which both have the same resolution in the middle
    lens = PerspectiveGrid.of_lens(grid.lens)
    if grid.width > 1.2 * wide:
        size = max(1, round(wide * grid.height / grid.width)), max(1, round(wide))
        picture, lens = by_area(picture, *size), lens.resized(*size)
    sampler = Sampler(lens.lens, ErpGrid(rows, 2 * rows).directions)
    panorama = sampler(picture)
    panorama[~sampler.seen] = np.rint(picture.reshape(-1, 3).mean(axis=0))
    return panorama


def coverage(rows: int, columns: int, grid: PerspectiveGrid) -> np.ndarray:
    """The fraction of each of `rows` x `columns` cells of a panorama that a view shows (by sample points in each)."""
    fine = 5 if rows <= 100 else 3
    offsets = (np.arange(fine) + 0.5) / fine
    x = (np.arange(columns)[:, None] + offsets).reshape(-1)
    y = (np.arange(rows)[:, None] + offsets).reshape(-1, 1)
    _, _, inside = grid.project(PatchGrid(rows, columns).unproject(x, y))
    return inside.reshape(rows, fine, columns, fine).mean(axis=(1, 3))


def read_mask(path: str | os.PathLike[str]) -> BodyMask:
    """The mask in a picture, 2:1, of any size: white where the camera sees the world, black where it never does.

    Any grey from half on counts as white; of a picture with no value above 1, 1 is white. Raises `ImageError`.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of another shape: the mask says it itself
            values = read_panorama(path).mean(axis=-1)
        values /= 255.0 if values.max() > 1 else 1.0
        if (grey := float(np.mean((values > 0.1) & (values < 0.9)))) > GREY:
            raise ImageError(f"is grey in {100 * grey:.0f} % of its pixels; wanted black and white")
        return BodyMask(values >= 0.5)
    except ImageError as error:
        told = str(error).removeprefix("the mask ")
        raise ImageError(f"the mask {os.fspath(path)}: {told}; white is where the camera sees the world") from error
