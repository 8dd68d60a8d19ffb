"""Exact sizes: pictures whose sides are multiples of a model's cell, so that no server or processor resizes them.

Processors round the sides separately (2:1 at 512 x 1024 becomes 504 x 1036 with cells of 28), which distorts the
sphere. A picture of exact size is left as it is, and boxes in its pixels are in ours.
"""

from __future__ import annotations

import math
from fractions import Fraction

from eagor.errors import ImageError


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
