"""Exact sizes: pictures whose sides are multiples of a model's cell, so that no server or processor resizes them.

Processors round the sides separately (2:1 at 512 x 1024 becomes 504 x 1036 with cells of 28), which distorts the
sphere. A picture of exact size is left as it is, and boxes in its pixels are in ours.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from PIL import Image

from eagor.errors import ImageError

_PAD = 8  # columns copied from the other side of the seam before a panorama is resized


def exact_size(cell: int, pixels: int, aspect: float = 2.0) -> tuple[int, int]:
    """(height, width) of the largest picture of at most `pixels` pixels whose sides are multiples of `cell`.

    width / height is exactly `aspect` if such a picture fits (2 for a panorama, 1 for a view; others are rounded to
    the nearest ratio of whole numbers up to 16), otherwise as near to it as whole cells allow. Raises `ImageError` if
    not even one cell fits.
    """
    cells = pixels // (cell * cell) if cell >= 1 else 0
    if cells < 1 or not (math.isfinite(aspect) and aspect > 0):
        raise ImageError(
            f"no picture of {aspect:g}:1 with cells of {cell} pixels has at most {pixels} pixels; allow more pixels"
        )
    ratio = Fraction(aspect).limit_denominator(16) if aspect >= 1 else 1 / Fraction(1 / aspect).limit_denominator(16)
    times = math.isqrt(cells // (ratio.numerator * ratio.denominator))
    if times:
        return cell * times * ratio.denominator, cell * times * ratio.numerator
    rows = range(1, math.isqrt(cells) + 1) if aspect >= 1 else range(1, cells + 1)
    shapes = [(row, max(1, min(round(row * aspect), cells // row))) for row in rows]
    row, column = min(shapes, key=lambda shape: (abs(math.log(shape[1] / shape[0] / aspect)), -shape[0] * shape[1]))
    return cell * row, cell * column


def nearest_size(cell: int, shape: tuple[int, int], least: int, most: int) -> tuple[int, int]:
    """(height, width) nearest to `shape` in whole cells, with `least` to `most` pixels, as a processor would choose it.

    The rounding is that of the Qwen families' image processors, so that a local conversation sees what a server would
    show. Sides are rounded separately, which distorts the picture by up to half a cell each way: use `exact_size` where
    directions are read. Raises `ImageError` if not even one cell fits.
    """
    height, width = shape
    if most < cell * cell or min(shape) < 1:
        raise ImageError(f"a picture of {width} x {height} cannot have cells of {cell} pixels and at most {most}")
    sides = [round(side / cell) * cell for side in shape]
    scale = math.sqrt(height * width / most)
    if sides[0] * sides[1] > most:
        sides = [max(cell, math.floor(side / scale / cell) * cell) for side in shape]
    elif sides[0] * sides[1] < least:
        scale = math.sqrt(least / (height * width))
        sides = [math.ceil(side * scale / cell) * cell for side in shape]
    return sides[0], sides[1]


def checked_picture(image: np.ndarray, name: str = "the panorama") -> np.ndarray:
    """`image`, checked to be uint8 ``(H, W, 3)``. Raises `ImageError`."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[-1] != 3 or image.size == 0:
        raise ImageError(
            f"{name} is {image.dtype} of shape {image.shape}; wanted uint8 sRGB (H, W, 3). Files: "
            "eagor.worlds.panorama.read_panorama"
        )
    return image


def resized(image: np.ndarray, size: tuple[int, int], wrap: bool = False) -> np.ndarray:
    """`image` ``(H, W, 3)`` uint8 at `size` (height, width), bicubic, antialiased if it shrinks.

    With `wrap` the columns continue across the seam, so that rolled panoramas give rolled results. An image that has
    the size already is returned as it is. Raises `ImageError`.
    """
    image = checked_picture(image, "the image")
    height, width = image.shape[:2]
    if (height, width) == tuple(size):
        return image
    if min(size) < 1:
        raise ImageError(f"an image cannot be resized to {size[1]} x {size[0]} pixels; wanted sides of at least 1")
    pad = 0
    if wrap:
        pad = _PAD * max(1, math.ceil(width / size[1]))
        image = image[:, np.arange(-pad, width + pad) % width]
    box = (pad, 0, pad + width, height)  # the filter also reads the padding beyond the box
    picture = Image.fromarray(np.ascontiguousarray(image))
    return np.asarray(picture.resize((size[1], size[0]), Image.Resampling.BICUBIC, box))
