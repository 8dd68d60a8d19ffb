"""Pictures that are no good panoramas, as only their pixels tell: fisheye circles, a broken seam, black holes.

`problems` puts the first two into sentences; `InvalidMask` gathers the third over a video. Measured on four photographs
and a painted room (`tests/laws/test_defects.py` repeats a part): no false alarm in 2300 pictures; a broken seam is seen
in 9 of 10 where the brightness changes by 10 % around the picture, in 8 where 5 % of the columns are missing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from eagor.grids import ErpGrid
from eagor.sources.panorama import checked_picture, resized

__all__ = [
    "MAKE", "TWICE", "InvalidMask", "Seam", "circles_in_words", "invalid_mask", "problems", "seam_of", "two_eyes",
]  # fmt: skip

# Larger pictures are looked at in every second, third, ... pixel, for at least so many rows.
ROWS, CIRCLE_ROWS = 512, 128
BLACK = 24  # levels of 255 up to which what a lens throws no light on is black: stray light and noise
HOLE = 8  # levels up to which what was filled with 0 stays after lossy compression; a black screen in a room is above
FLAT = 3  # levels by which black that was drawn, not photographed, differs within 3 x 3 pixels after compression
LEAST = np.radians(3.0)  # radius of the smallest hole at a pole that counts; a tripod's head is about 10 degrees
ROUND = 0.25  # of a pole's row that has to be black: half a sphere (VR180) covers half of it

NEAR_POLES = 1 / 6  # of the rows, above and below, without use for the seam: neighbours there see nearly the same
COLUMNS = 512  # pairs of columns that are compared with the seam
USUAL = 0.95  # share of all pixels that have no larger jump than a "large" one
FLOOR = 6.0  # sum of the three channels' jumps below which nothing is large: rounding and compression
BROKEN = 0.6  # share of the rows with a large jump across the seam; between other columns of photographs up to 0.66
TIMES = 2.0  # mean jump across the seam, in mean jumps between other neighbouring columns

EYE_ROWS, EYE_PART, EYE_SHIFT = 128, 17, 8  # pixels: an eye's side, a part of it, and its shift between eyes at most
EYE_TEXTURE, EYE_DRAWN = 3.0, 0.15  # grey levels in a part that shows something; share of such parts, at least
EYE_ALIKE, EYE_SHARE = 0.8, 0.6  # correlation of parts that show the same, and their share in two eyes

TWICE = {
    layout: f"shows the same twice, {where}: two eyes (3D 360, VR180) and not one panorama. {ways}, or if it is one "
    "panorama all the same: --eyes mono"
    for layout, where, ways in (
        ("left-right", "side by side", "Half spheres (VR180): --eyes vr180; whole ones: --eyes left-right"),
        ("top-bottom", "one above the other", "Whole panoramas: --eyes top-bottom; half ones: --eyes vr180-top-bottom"),
    )
}

MAKE = "Give its lenses with --rig FILE.yaml (eagor camera calibrate makes one)"
STITCH = "in the camera's own app or with FFmpeg's filter v360=dfisheye:e"

RADII = np.arange(0.80, 1.16, 0.05)  # of a fisheye circle, in half sides of the square around it
OUTSIDE, INSIDE = 0.9, 0.4  # black share: at least, outside the circle; at most, inside along its rim


class Seam(NamedTuple):
    """How well the left and right borders of a panorama fit.

    `ratio`: the mean jump across the seam, in mean jumps between other neighbouring columns. `rows`: share of the rows
    with a jump across the seam that stands out from its neighbours, as 1 of 20 pixels does elsewhere.
    """

    ratio: float
    rows: float

    @property
    def visible(self) -> bool:
        """Whether the borders do not fit."""
        return self.rows > BROKEN and self.ratio > TIMES


def seam_of(panorama: np.ndarray) -> Seam:
    """Compare the jump across the seam of ``(H, W, 3)`` uint8 with jumps between other neighbouring columns.

    A jump counts as large where it exceeds those to both sides of it by more than `USUAL` of all pixels do: an edge in
    the world is blurred over two or three columns, or bounded in height. Raises `ImageError`.
    """
    image = checked_picture(panorama)
    height, width = image.shape[:2]
    if width < 8 or height < 8:
        return Seam(1.0, 0.0)
    skipped = int(height * NEAR_POLES)
    middle = image[skipped : height - skipped]
    after = np.unique(np.linspace(0, width - 1, COLUMNS, dtype=int))  # the last: between the last column and the first
    columns = [middle[:, (after + k) % width].astype(np.int16) for k in (-1, 0, 1, 2)]
    before, jump, behind = (np.abs(b - a).sum(axis=2) for a, b in pairwise(columns))
    excess = jump - np.maximum(before, behind)
    large = max(FLOOR, float(np.quantile(excess, USUAL)))
    mean = max(float(jump[:, :-1].mean()), 1e-9)
    return Seam(float(jump[:, -1].mean()) / mean, float((excess[:, -1] > large).mean()))


def circles_in_words(picture: np.ndarray) -> str:
    """Which circles of fisheye lenses a picture ``(H, W, 3)`` uint8 consists of: one, or two side by side; else "".

    A circle is bright along its rim and black beyond it, up to the corners of the square around it. A panorama cannot
    be: all its pixels at the top are one direction. Raises `ImageError`.
    """
    image = checked_picture(picture)
    step = max(1, image.shape[0] // CIRCLE_ROWS)
    black = image[::step, ::step].max(axis=2) <= BLACK
    height, width = black.shape
    side = min(height, width)
    if side < 16:
        return ""
    if _is_circle(black[:, : width // 2]) and _is_circle(black[:, width - width // 2 :]):
        return "the two circles of a dual fisheye camera, side by side"
    square = np.zeros_like(black)
    top, left = (height - side) // 2, (width - side) // 2
    square[top : top + side, left : left + side] = True
    dark = black | square
    one = dark.mean() > OUTSIDE and _is_circle(black[top : top + side, left : left + side])
    return "the circle of a fisheye lens" if one else ""


def _is_circle(black: np.ndarray) -> bool:
    """Whether black pixels surround a circle in the middle of ``(H, W)``, about as large as the smaller side."""
    height, width = black.shape
    y, x = np.mgrid[:height, :width]
    radius = np.hypot(y - (height - 1) / 2, x - (width - 1) / 2) / (min(height, width) / 2)
    for size in RADII:
        outside, rim = radius > size + 0.05, (radius > 0.75 * size) & (radius < 0.9 * size)
        if outside.any() and black[outside].mean() > OUTSIDE and black[rim].mean() < INSIDE:
            return True
    return False


def two_eyes(picture: np.ndarray) -> str:
    """How two eyes share a picture ``(H, W, 3)`` uint8 whose halves show the same: a name of `metadata.EYES`, or "".

    What is near is shifted sideways between two eyes, so parts of the halves are compared with some shift. The halves
    of a panorama look in opposite directions: in 60 rotated ones at most 17 % of the parts were alike, in two eyes at
    least 88 %. Level lines, which are the same in any picture, do not count.
    """
    image = checked_picture(picture)
    if min(image.shape[:2]) < 32:
        return ""
    for layout, axis in (("left-right", 1), ("top-bottom", 0)):
        size = (EYE_ROWS, 2 * EYE_ROWS) if axis else (2 * EYE_ROWS, EYE_ROWS)
        halves = np.split(resized(image, size).mean(axis=2), 2, axis=axis)
        fine = [half - ndimage.gaussian_filter(half, EYE_PART / 2) for half in halves]
        alike = np.max([_alike(fine[0], fine[1], shift) for shift in range(-EYE_SHIFT, EYE_SHIFT + 1)], axis=0)
        telling = _alike(fine[0], fine[0], 2 * EYE_SHIFT) < EYE_ALIKE  # a level line looks the same wherever it is seen
        drawn = telling & (np.minimum(_texture(fine[0]), _texture(fine[1])) > EYE_TEXTURE)
        if drawn.mean() > EYE_DRAWN and (alike[drawn] > EYE_ALIKE).mean() > EYE_SHARE:
            return layout
    return ""


def _alike(one: np.ndarray, other: np.ndarray, shift: int) -> np.ndarray:
    """The correlation ``(H, W)`` of the part about each pixel with that of another picture, shifted sideways."""
    beside = np.roll(other, shift, axis=1)
    common = ndimage.uniform_filter(one * beside, EYE_PART)
    return common / np.maximum(_texture(one) * _texture(beside), 1e-9)


def _texture(fine: np.ndarray) -> np.ndarray:
    """The standard deviation ``(H, W)`` in the part about each pixel."""
    return np.sqrt(np.maximum(ndimage.uniform_filter(fine**2, EYE_PART), 0.0))


def invalid_mask(panorama: np.ndarray) -> np.ndarray:
    """The mask ``(H, W)`` of black regions around a pole of ``(H, W, 3)`` uint8: tripod hole, letterbox, half sphere.

    Black that compression left flat, connected with a pole, and larger than `LEAST`. One look cannot tell it from a
    dark place: use `InvalidMask` for several. Raises `ImageError`.
    """
    image = checked_picture(panorama)
    step = max(1, image.shape[0] // ROWS)
    small = image[::step, ::step]
    around = {"size": (3, 3, 1), "mode": ("nearest", "wrap", "nearest")}
    spread = ndimage.maximum_filter(small, **around) - ndimage.minimum_filter(small, **around)
    flat = (small.max(axis=2) <= HOLE) & (spread.max(axis=2) <= FLAT)
    area, width = ErpGrid(*flat.shape).weights, flat.shape[1]
    found, square = np.zeros((flat.shape[0], 3 * width), dtype=bool), np.ones((3, 3), bool)
    for pole in (0, -1):
        if flat[pole].mean() < ROUND:
            continue
        thrice = np.tile(flat, 3)  # regions go on around the seam
        seed = np.zeros_like(thrice)
        seed[pole] = thrice[pole]
        region: np.ndarray = ndimage.binary_propagation(seed, square, mask=thrice)
        if (area * region[:, width : 2 * width]).sum() >= 2 * np.pi * (1 - np.cos(LEAST)):
            found |= region
    if found.any():  # what the filter took off the rim, and the ringing of compression around it
        found = ndimage.binary_dilation(np.tile(found[:, width : 2 * width], 3), square, 2)
    found = found[:, width : 2 * width]
    return found.repeat(step, axis=0).repeat(step, axis=1)[: image.shape[0], : image.shape[1]]


class InvalidMask:
    """What is black in all pictures of a camera that moves: what it never sees."""

    def __init__(self) -> None:
        self.mask: np.ndarray | None = None  # (H, W); None before the first picture

    def add(self, panorama: np.ndarray) -> np.ndarray:
        """The mask ``(H, W)`` of what was in `invalid_mask` of all panoramas so far, which have one shape."""
        before = self.mask if self.mask is not None and self.mask.shape == panorama.shape[:2] else None
        if before is not None and not before.any():
            return before  # and it stays so
        found = invalid_mask(panorama)
        self.mask = found if before is None else before & found
        return self.mask


def problems(panorama: np.ndarray) -> tuple[str, ...]:
    """Sentences about a picture ``(H, W, 3)`` uint8 that is probably no good panorama; empty for a good one."""
    if circles := circles_in_words(panorama):
        return (f"this is {circles}, not a panorama: directions would be wrong. {MAKE}, or stitch it first, {STITCH}",)
    seam = seam_of(panorama)
    if not seam.visible:
        return ()
    return (
        f"the left and the right border do not fit: the jump between them is {seam.ratio:.1f} times that between other "
        f"neighbouring columns, in {100 * seam.rows:.0f} % of the rows. Is it a whole panorama of 360 degrees, and "
        "stitched well? Directions near the seam may be wrong. A part, or an ordinary camera's: --hfov DEGREES",
    )
