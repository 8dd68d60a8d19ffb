"""The seam: a panorama looked at twice, rolled by half a turn in between, so that nothing is cut in both looks.

What lies on the border of one picture lies in the middle of the other. Each direction takes most from the look in which
it is farther from the border: cut things, and the attention that models waste on borders and corners, fade out.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from eagor.errors import ImageError, ResponseError


def seamless(respond: Callable[[np.ndarray], np.ndarray], panorama: np.ndarray, cells: int) -> np.ndarray:
    """Responses ``(Q, h, cells)`` of two looks at `panorama`, rolled by a whole number of cells near half, merged.

    Args:
        respond: maps an image ``(H, W, 3)`` to responses ``(Q, h, cells)``.
        panorama: ``(H, W, 3)``, with W a multiple of `cells` (`sizes.exact_size` gives such sizes), so that a roll by
            whole cells moves no response between cells.
        cells: columns of the responses.

    The weights of the two looks are sin^2 of half the azimuth from the border; they sum to 1 (after division where
    `cells` is odd). Raises `ImageError` if the width does not fit, `ResponseError` if the responses do not.
    """
    image = np.asarray(panorama)
    width = image.shape[1] if image.ndim >= 2 else 0
    if cells < 1 or width == 0 or width % cells:
        raise ImageError(
            f"a panorama of shape {image.shape} cannot be rolled by whole cells of {cells} columns; resize it to a "
            "multiple first (eagor.perception.vlm.sizes)"
        )
    shift = cells // 2
    first = _checked(respond(image), cells)
    second = _checked(respond(np.roll(image, shift * (width // cells), axis=1)), cells)
    return merged(first, np.roll(second, -shift, axis=-1), shift / cells)


def merged(first: np.ndarray, second: np.ndarray, roll: float = 0.5) -> np.ndarray:
    """Two responses ``(..., h, w)`` float32 to one panorama, both in its own frame, merged as `seamless` does.

    `second` was seen in the panorama rolled to the right by the fraction `roll` of its width (near 1/2), and its
    columns were rolled back already.
    """
    fractions = (np.arange(first.shape[-1]) + 0.5) / first.shape[-1]
    weight, other = np.sin(math.pi * fractions) ** 2, np.sin(math.pi * (fractions + roll)) ** 2
    share = weight / (weight + other)
    return (first * share + second * (1 - share)).astype(np.float32)


def _checked(response: np.ndarray, cells: int) -> np.ndarray:
    response = np.asarray(response)
    if response.ndim != 3 or response.shape[-1] != cells:
        raise ResponseError(f"a look answered with shape {response.shape}; wanted (queries, rows, {cells})")
    return response
