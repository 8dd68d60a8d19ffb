"""Any perception without what the camera never sees: `Masked`, and the picture that says so."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from PIL import Image

from eagor.errors import ImageError
from eagor.evidence import BodyMask, Evidence
from eagor.perception import Perception, look, rows_of

__all__ = ["Masked", "read_mask"]

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
