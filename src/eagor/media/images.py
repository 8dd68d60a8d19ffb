"""Pictures as arrays: checked, and resized."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image

from eagor.errors import ImageError

_PAD = 8  # columns copied from the other side of the seam before a panorama is resized


def checked_picture(image: np.ndarray, name: str = "the panorama") -> np.ndarray:
    """`image`, checked to be uint8 ``(H, W, 3)``. Raises `ImageError`."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[-1] != 3 or image.size == 0:
        raise ImageError(
            f"{name} is {image.dtype} of shape {image.shape}; wanted uint8 sRGB (H, W, 3). Files: "
            "eagor.media.panorama.read_panorama"
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
