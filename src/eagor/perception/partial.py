"""Any perception for a camera that sees only part of the sphere: ordinary pictures, and masks.

A perception with the method ``view`` (`ViewPerception`) gets the picture itself. Any other gets a panorama in which
only the picture's part is filled; the rest counts as never looked at.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Sequence
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
from eagor.sources.defects import InvalidMask
from eagor.sources.panorama import Picture, by_area, checked_picture, read_panorama

BORDER = 0.5  # share of a cell that the picture has to fill for the cell to count as looked at
WORTH_SAYING = 0.002  # share of the sphere from which on a black region is worth a sentence
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


# --- masks of what a camera never sees --------------------------------------------------------------------------------


class ValidMasks:
    """What the camera never sees: looks say nothing there.

    That is each of the `masks` that are given, what a file says that its picture lacks, and black around a pole in all
    frames so far; of the last two `say` is told, once.
    """

    def __init__(self, masks: Sequence[BodyMask] = (), say: Callable[[str], object] = lambda text: None) -> None:
        self._given, self._say, self._black = tuple(masks), say, InvalidMask()

    def masks(self, frame: Picture | None) -> tuple[BodyMask, ...]:
        """All masks of a frame; those that are given for a look without a picture, whose record says what is black."""
        own = None if frame is None else self.of(frame)
        return self._given if own is None else (*self._given, own)

    def of(self, frame: Picture) -> BodyMask | None:
        """What `frame` shows, beside the masks that are given; None if that is all."""
        if frame.grid is not None:  # an ordinary picture has no poles
            return None if frame.unseen is None else _around(frame.grid, ~frame.unseen)
        black = self._black.add(frame.picture)
        hidden = black if frame.unseen is None else black | frame.unseen
        if not hidden.any():
            return None
        if hidden.all():
            raise ImageError("the picture is black or transparent everywhere: nothing can be seen in it")
        mask = BodyMask(~hidden)
        share = 1 - float(np.sum(mask.seen * mask.grid.weights)) / (4 * np.pi)
        if share > WORTH_SAYING and black.any():
            self._say(f"{100 * share:.1f} % of the sphere is black around a pole, or missing: taken as not seen")
            self._say = lambda text: None
        return mask


def _around(grid: PerspectiveGrid, seen: np.ndarray) -> BodyMask:
    """What an ordinary picture shows, ``(H, W)``, as a mask of the sphere; what is beside it says nothing anyway."""
    x, y, inside = grid.project(ErpGrid(512, 1024).directions)
    cells = (
        np.clip(np.where(inside, at, 0).astype(int), 0, most - 1) for at, most in zip((y, x), seen.shape, strict=True)
    )
    return BodyMask(inside & seen[tuple(cells)])


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
        reason = str(error).removeprefix("the mask ")
        raise ImageError(f"the mask {os.fspath(path)}: {reason}; white is where the camera sees the world") from error
