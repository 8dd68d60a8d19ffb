"""Pictures that are no good panoramas, as only their pixels tell: fisheye circles, a broken seam, black holes.

`problems` puts the first two into sentences; `NeverSeen` gathers the third over a video. Measured on four photographs
and a painted room: no false alarm in 250 pictures (25 random rotations each, as they are and as JPEG of quality 50),
none in 2050 with the seam at other columns. Of ten pictures each, a broken seam is seen in 10 where the brightness
changes by 30 % around the picture, or a quarter of it is missing; in 9 for 10 %; in 8 where 5 % of the columns are
missing, in 2 for 2 % or for halves that are shifted by 2 degrees, in none for 1 %. `tests/laws/test_defects.py`
repeats a part of this.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from eagor.grids import ErpGrid
from eagor.media.panorama import checked_picture, resized

__all__ = ["NeverSeen", "Seam", "fisheye_circles", "never_seen", "problems", "seam_of", "two_eyes"]

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

RADII = np.arange(0.80, 1.16, 0.05)  # of a fisheye circle, in half sides of the square around it
OUTSIDE, INSIDE = 0.9, 0.4  # black share: at least, outside the circle; at most, inside along its rim


@dataclass(frozen=True)
class Seam:
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


def fisheye_circles(picture: np.ndarray) -> int:
    """How many circles of a fisheye lens the picture ``(H, W, 3)`` uint8 consists of: 0, 1, or 2 side by side.

    A circle is bright along its rim and black beyond it, up to the corners of the square around it. A panorama cannot
    be: all its pixels at the top are one direction. Raises `ImageError`.
    """
    image = checked_picture(picture)
    small = image[:: _step(image, CIRCLE_ROWS), :: _step(image, CIRCLE_ROWS)]
    black = small.max(axis=2) <= BLACK
    height, width = black.shape
    if min(height, width) < 16:
        return 0
    halves = (black[:, : width // 2], black[:, width - width // 2 :])
    if all(_is_circle(half) for half in halves):
        return 2
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    rest = black.copy()
    rest[top : top + side, left : left + side] = True
    return int(rest.mean() > OUTSIDE and _is_circle(black[top : top + side, left : left + side]))


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
    least 88 %.
    """
    image = checked_picture(picture)
    if min(image.shape[:2]) < 32:
        return ""
    for layout, axis in (("left-right", 1), ("top-bottom", 0)):
        size = (EYE_ROWS, 2 * EYE_ROWS) if axis else (2 * EYE_ROWS, EYE_ROWS)
        halves = np.split(resized(image, size).mean(axis=2), 2, axis=axis)
        fine = [half - ndimage.gaussian_filter(half, EYE_PART / 2) for half in halves]
        spread = [np.sqrt(ndimage.uniform_filter(half**2, EYE_PART)) for half in fine]
        alike = np.full(fine[0].shape, -1.0)
        for shift in range(-EYE_SHIFT, EYE_SHIFT + 1):
            other, deviation = (np.roll(each[1], shift, axis=1) for each in (fine, spread))
            common = ndimage.uniform_filter(fine[0] * other, EYE_PART)
            alike = np.maximum(alike, common / np.maximum(spread[0] * deviation, 1e-9))
        drawn = np.minimum(*spread) > EYE_TEXTURE
        if drawn.mean() > EYE_DRAWN and (alike[drawn] > EYE_ALIKE).mean() > EYE_SHARE:
            return layout
    return ""


def never_seen(panorama: np.ndarray) -> np.ndarray:
    """The mask ``(H, W)`` of black regions around a pole of ``(H, W, 3)`` uint8: tripod hole, letterbox, half sphere.

    Black that compression left flat, connected with a pole, and larger than `LEAST`. One look cannot tell it from a
    dark place: use `NeverSeen` for several. Raises `ImageError`.
    """
    image = checked_picture(panorama)
    step = _step(image)
    small = image[::step, ::step]
    brightest = small.max(axis=2)
    around = {"size": (3, 3, 1), "mode": ("nearest", "wrap", "nearest")}
    spread = ndimage.maximum_filter(small, **around) - ndimage.minimum_filter(small, **around)
    flat = (brightest <= HOLE) & (spread.max(axis=2) <= FLAT)
    area = ErpGrid(*flat.shape).weights
    found = np.zeros(flat.shape, dtype=bool)
    for pole in (0, -1):
        if flat[pole].mean() < ROUND:
            continue
        seed = np.zeros_like(flat)
        seed[pole] = flat[pole]
        region = _grown(seed, flat)
        if area[region].sum() >= 2 * np.pi * (1 - np.cos(LEAST)):
            found |= region
    if found.any():  # what the filter took off the rim, and the ringing of compression around it
        found = _grown(found, np.ones_like(found), 2)
    return found.repeat(step, axis=0).repeat(step, axis=1)[: image.shape[0], : image.shape[1]]


def _grown(seed: np.ndarray, within: np.ndarray, steps: int = 0) -> np.ndarray:
    """`seed` and what is connected with it in `within`, around the seam too; by `steps` pixels, or (0) all of it."""
    width = seed.shape[1]
    tiled = [np.concatenate([a, a, a], axis=1) for a in (seed, within)]
    grown = ndimage.binary_dilation(tiled[0], np.ones((3, 3), bool), steps, mask=tiled[1]) if steps else None
    if grown is None:
        grown = ndimage.binary_propagation(tiled[0], np.ones((3, 3), bool), mask=tiled[1])
    return grown[:, width : 2 * width]


class NeverSeen:
    """What is black in all pictures of a camera that moves: what it never sees."""

    def __init__(self) -> None:
        self.mask: np.ndarray | None = None  # (H, W); None before the first picture

    def add(self, panorama: np.ndarray) -> np.ndarray:
        """The mask ``(H, W)`` of what was in `never_seen` of all panoramas so far; all have to have the same shape."""
        if self.mask is not None and self.mask.shape == panorama.shape[:2] and not self.mask.any():
            return self.mask  # and it stays so
        found = never_seen(panorama)
        self.mask = found if self.mask is None or self.mask.shape != found.shape else self.mask & found
        return self.mask


def problems(panorama: np.ndarray) -> tuple[str, ...]:
    """Sentences about a picture ``(H, W, 3)`` uint8 that is probably no good panorama; empty for a good one."""
    circles = fisheye_circles(panorama)
    if circles:
        what = "the two circles of a dual fisheye camera" if circles == 2 else "the circle of a fisheye lens"
        return (
            f"this is {what}, not a panorama: directions would be wrong. Give its lenses with --rig FILE.yaml (eagor "
            "camera calibrate makes one), or stitch it first, in the camera's own app or with FFmpeg's filter "
            "v360=dfisheye:e",
        )
    seam = seam_of(panorama)
    if seam.visible:
        return (
            f"the left and the right border do not fit: the jump between them is {seam.ratio:.1f} times that between "
            f"other neighbouring columns, in {100 * seam.rows:.0f} % of the rows. Is it a whole panorama of 360 "
            "degrees, and stitched well? Directions near the seam may be wrong",
        )
    return ()


def _step(image: np.ndarray, rows: int = ROWS) -> int:
    return max(1, image.shape[0] // rows)
