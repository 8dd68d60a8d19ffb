"""Look around in one equirectangular photograph: turn the camera, or cut a view out of it.

Images are ``(H, W)`` or ``(H, W, C)`` arrays in the layout of `eagor.sphere`: the centre column is forward, columns
grow to the right. A photograph has no depth, so the camera can turn in it, but not move.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from typing import IO

import numpy as np
from PIL import Image, ImageOps

from eagor.errors import ImageError
from eagor.grids import ErpGrid, Grid
from eagor.sphere import check_rotation

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM")  # Pillow starts no other program for any of these
ORIENTATION = 0x0112  # the tag in Exif
_SMALL = 1 << 26  # bytes: 4096 x 4096 in colour
_DENSEST = 600  # decoded bytes per byte of the file; blank pictures reach up to a thousand


def read_panorama(path: str | os.PathLike[str]) -> np.ndarray:
    """The image file at `path` as ``(H, W, 3)`` uint8.

    Grey, palette and transparent images become RGB (transparency is dropped). It is turned or mirrored as the
    orientation tag of the file (Exif) says, unless that would stand a 2:1 panorama on its side. An image that is not
    2:1 is accepted with a `UserWarning`; its columns span 360 degrees and its rows 180. Raises `ImageError` if there is
    no readable image.
    """
    name = os.fspath(path)
    if not os.path.exists(name):
        raise ImageError(f"there is no file {name!r}; give the path of an equirectangular image (PNG, JPEG, ...)")
    if os.path.isdir(name):
        raise ImageError(f"{name!r} is a folder; give one image file in it")
    if os.path.getsize(name) == 0:
        raise ImageError(f"{name!r} is empty (0 bytes); an interrupted copy or download? Fetch the image again")
    try:
        image = read_image(name, os.path.getsize(name), _lying)
    except ImageError as error:
        raise ImageError(f"{name!r} {error}") from error
    except Exception as error:  # Pillow's decoders may raise anything for damaged files
        raise ImageError(
            f"{name!r} cannot be read as an image ({type(error).__name__}: {error}); it is corrupt, truncated or of "
            "another kind. Wanted an image that Pillow reads, such as PNG or JPEG: fetch or export it again"
        ) from error
    height, width = image.shape[:2]
    if width != 2 * height:
        warnings.warn(
            f"{name!r} is {width} x {height}, not 2:1: longitude and latitude are mapped separately (all columns "
            "span 360 degrees, all rows 180). If the image covers less than the whole sphere, pad it first",
            UserWarning,
            stacklevel=2,
        )
    return image


def read_image(
    file: str | IO[bytes], size: int, turned: Callable[[Image.Image], Image.Image] = lambda image: image
) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8 in a file of `size` bytes. Raises `ImageError`, or what Pillow's decoders raise.

    `turned`: what turns it as its orientation tag (Exif) says; by default the tag is ignored.

    A picture that claims more pixels than a real one of this file size can have is rejected before memory is allocated.
    Small pictures may be blank.
    """
    with Image.open(file, formats=FORMATS) as image:
        width, height = image.size
        if decoded_bytes(image) > max(_SMALL, _DENSEST * size):
            raise ImageError(f"claims {width} x {height} pixels in {size} bytes; it is corrupt, or blank")
        image.load()
        return as_rgb(turned(image))


def _lying(image: Image.Image) -> Image.Image:
    """A panorama as its orientation tag says, but never a whole one on its side; with a damaged tag, as it is."""
    try:
        tag = image.getexif().get(ORIENTATION, 1)
        quarter = isinstance(tag, int) and 5 <= tag <= 8
        return image if quarter and image.width == 2 * image.height else ImageOps.exif_transpose(image)
    except Exception:  # Pillow may raise anything for damaged metadata
        return image


def decoded_bytes(image: Image.Image) -> int:
    """Memory for the picture while it is read."""
    return image.width * image.height * (8 if image.mode[0] in "IF" else 4)


def as_rgb(image: Image.Image) -> np.ndarray:
    """``(H, W, 3)`` uint8 of any picture with 8 or 16 bits per channel."""
    if image.mode.startswith("I"):  # 16-bit grey, which Pillow would clip instead of scaling
        grey = np.clip(np.asarray(image), 0, 65535).astype(np.uint32)
        grey += 128  # rounds to nearest
        grey //= 257
        return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)
    if image.mode == "F":
        raise ImageError("holds floating-point grey values of unknown range; tone-map it to 8 bits first")
    if image.mode == "P":  # palettes may carry transparency, which only RGBA supports
        image = image.convert("RGBA")
    return np.array(image.convert("RGB"))


def turn(image: np.ndarray, new_R_old: np.ndarray) -> np.ndarray:
    """The panorama that the camera sees after it has turned: ``turn(image, R)`` at R @ d shows `image` at d.

    `new_R_old` is the rotation of the body frame, ``new_R_old @ direction_old = direction_new``; for poses
    ``world_R_body`` it is ``world_R_new.T @ world_R_old``. Turning left moves the content to the right. Bilinear; shape
    and data type are kept. Raises `RotationError` and `ImageError`.
    """
    rotation = check_rotation(np.asarray(new_R_old, dtype=np.float64))
    image = _checked(image)
    grid = ErpGrid(*image.shape[:2])
    return _sample(image, grid.directions @ rotation)  # row vectors: d_old = R^T d_new


def view(image: np.ndarray, grid: Grid) -> np.ndarray:
    """The view of a camera with `grid` in the panorama, ``grid.shape`` or ``(*grid.shape, C)``, data type kept.

    Bilinear, without a low-pass filter: choose pixels that are not much coarser than the panorama's. Cells in which
    `grid` sees nothing (the corners of a fisheye) are black. Raises `ImageError`.
    """
    seen = _sample(_checked(image), grid.directions)
    seen[np.asarray(grid.weights) <= 0] = 0
    return seen


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.ndim not in (2, 3) or image.size == 0 or image.dtype.kind not in "uif":
        raise ImageError(
            f"a panorama is an array (H, W) or (H, W, C) of numbers; got shape {image.shape}, type {image.dtype}. "
            "Read files with eagor.media.panorama.read_panorama"
        )
    return image


def _sample(image: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """`image` read bilinearly at `directions` ``(..., 3)``, around the seam and over the poles."""
    height, width = image.shape[:2]
    x, y, _ = ErpGrid(height, width).project(directions)
    # Beyond a pole the image continues half a turn away: one such row is added above and one below.
    rows = np.concatenate([_half_turn(image[:1]), image.astype(_working(image)), _half_turn(image[-1:])])
    u, v = x - 0.5, np.clip(y, 0, height) + 0.5
    left, top = np.floor(u).astype(np.intp), np.clip(np.floor(v).astype(np.intp), 0, height)
    channels = (1,) * (image.ndim - 2)
    right_share = (u - left).astype(rows.dtype).reshape(u.shape + channels)
    lower_share = (v - top).astype(rows.dtype).reshape(v.shape + channels)
    left, right = left % width, (left + 1) % width
    upper = rows[top, left] * (1 - right_share) + rows[top, right] * right_share
    lower = rows[top + 1, left] * (1 - right_share) + rows[top + 1, right] * right_share
    values = upper * (1 - lower_share) + lower * lower_share
    if image.dtype.kind in "ui":
        return np.rint(values).astype(image.dtype)
    return values.astype(image.dtype)


def _working(image: np.ndarray) -> np.dtype:
    """The floating type to interpolate in: float32 where that holds the values, float64 otherwise."""
    return np.dtype(np.float32 if image.dtype.itemsize <= 2 or image.dtype == np.float32 else np.float64)


def _half_turn(row: np.ndarray) -> np.ndarray:
    """One row ``(1, W, ...)`` as seen half a turn further; the mean of two columns if W is odd."""
    row = row.astype(_working(row))
    width = row.shape[1]
    return (np.roll(row, width // 2, axis=1) + np.roll(row, width - width // 2, axis=1)) / 2
