"""A panoramic photograph with what its file says of it (Photo Sphere XMP Metadata, "GPano")."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from eagor.errors import ImageError
from eagor.media.images import resized
from eagor.media.panorama import FORMATS, read_panorama
from eagor.media.projection import Projection, of_photograph
from eagor.media.xmp import GPANO, properties

__all__ = ["IMAGES", "PanoramaFile", "in_order", "is_whole", "pictures_in", "read_photograph"]

IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")

ROUNDING = 2  # columns by which a panorama may fail to be 2:1
JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"  # how a JPEG's APP1 segment with XMP begins (XMP specification, part 3)


@dataclass(frozen=True, eq=False)
class PanoramaFile:
    """A picture of the whole sphere, and what its file says of it.

    `panorama` ``(H, W, 3)`` uint8; a cropped one is put on a black sphere, and the mask `unseen` ``(H, W)`` says where
    nothing is known (None: all is seen). `level_R_body`: None, or the rotation ``(3, 3)`` that makes it level.
    `world_R_body`: None, or the same with its compass heading: x north, y west, z up. `facts`: sentences.
    """

    panorama: np.ndarray
    unseen: np.ndarray | None = None
    level_R_body: np.ndarray | None = None
    world_R_body: np.ndarray | None = None
    facts: tuple[str, ...] = ()


def pictures_in(folder: Path) -> tuple[Path, ...]:
    """The image files in a folder, `in_order`. Raises `ImageError` if it cannot be read, or there are none."""
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        raise ImageError(f"{folder} cannot be read ({error.strerror}); make it readable, or name another") from error
    found = [path for path in inside if path.suffix.lower() in IMAGES and not path.name.startswith(".")]
    if not found:
        raise ImageError(f"{folder} holds no images; wanted files that end in {', '.join(IMAGES)}")
    return in_order(found)


def in_order(paths: Sequence[Path]) -> tuple[Path, ...]:
    """`paths` sorted by name; numbers in names sort by value."""
    return tuple(sorted(paths, key=lambda path: (_natural(path.name), str(path))))


def _natural(name: str) -> list[tuple[int, str | int]]:
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"([0-9]+)", name) if part]


def read_photograph(path: str | os.PathLike[str]) -> PanoramaFile:
    """The photograph in the file at `path` (JPEG, PNG, WebP, ...).

    As `eagor.media.panorama.read_panorama` where the file says nothing of itself, with its warning about pictures that
    are not 2:1. Raises `ImageError` if there is no readable image, or if it says that it is not equirectangular.
    """
    name = os.fspath(path)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        image = read_panorama(name)
    found = of_photograph(properties(_xmp(name), GPANO))
    if found is None:
        for warning in warned:
            warnings.warn(str(warning.message), UserWarning, stacklevel=2)
        return PanoramaFile(image)
    found.check(name)
    return _placed(image, found)


def is_whole(panorama: np.ndarray) -> bool:
    """Whether its aspect ratio is 2:1, up to the rounding of a resized picture."""
    height, width = panorama.shape[:2]
    return abs(width - 2 * height) <= ROUNDING


def _placed(image: np.ndarray, found: Projection) -> PanoramaFile:
    height, width = image.shape[:2]
    layout = found.layout(height, width)
    panorama = layout.place(resized(image, layout.size))
    tilted, turned = bool(found.pitch or found.roll), bool(found.yaw)
    return PanoramaFile(
        panorama,
        layout.unseen,
        found.level_R_body if tilted else None,
        found.world_R_body if tilted or turned else None,
        found.facts(),
    )


def _xmp(path: str) -> bytes:
    """The XMP packet of a picture that could be read; empty if it has none."""
    with Image.open(path, formats=FORMATS) as image:
        info = image.info
        for data in (info.get("xmp"), info.get("XML:com.adobe.xmp")):
            if data:
                return data.encode() if isinstance(data, str) else bytes(data)
        segments = [data for kind, data in getattr(image, "applist", ()) if kind == "APP1"]
    return next((data[len(JPEG_XMP) :] for data in segments if data.startswith(JPEG_XMP)), b"")
