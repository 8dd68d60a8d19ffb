"""Panoramas as arrays: read from files, checked, resized, turned, and views cut out of them.

Images are ``(H, W)`` or ``(H, W, C)`` arrays in the layout of `eagor.sphere`: the centre column is forward, columns
grow to the right. A photograph has no depth, so the camera can turn in it, but not move. `read_stored` also tells what
a file says of itself (Photo Sphere XMP Metadata, "GPano").
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from eagor._checks import checked_picture
from eagor._extras import opencv, require_extra
from eagor._files import natural
from eagor._srgb import to_coded
from eagor.cameras import Sampler
from eagor.errors import ImageError, MissingExtraError
from eagor.grids import ErpGrid, Grid, PerspectiveGrid, ViewKey, forward_view, view_key
from eagor.sources.metadata import GPANO, Projection, of_photograph, properties
from eagor.sphere import check_rotation

# Pillow starts no other program for any of these; AVIF since its version 11.3.
FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM", *(("AVIF",) if find_spec("PIL.AvifImagePlugin") else ()))
# Kinds of pictures that Pillow does not read, by how their files begin.
UNREAD = (
    (b"\xff\x0a", "JPEG XL"), (b"\0\0\0\x0cJXL ", "JPEG XL"), (b"v/1\x01", "OpenEXR"), (b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (b"\xff\x4f\xff\x51", "JPEG 2000"), (b"qoif", "QOI"), (b"8BPS", "a Photoshop document"),
)  # fmt: skip
DEPTHS = (10, 12, 14, 16)  # bits of sensors whose values are stored in 16
HEIC = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
BOXED = dict.fromkeys(HEIC, "HEIC") | {b"avif": "AVIF", b"avis": "AVIF"}  # brands of pictures (ISO/IEC 23008-12)
ORIENTATION = 0x0112  # the tag in Exif
_SMALL = 1 << 26  # bytes: 4096 x 4096 in colour
_DENSEST = 600  # decoded bytes per byte of the file; blank pictures reach up to a thousand
_PAD = 8  # columns copied from the other side of the seam before a panorama is resized

IMAGES = (
    ".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff", ".hdr", ".avif", ".heic", ".heif", ".hif", ".insp",
    ".gif", ".apng", ".jpe", ".jfif", ".ppm", ".pgm", ".pnm", ".jxl", ".jp2", ".exr",
)  # fmt: skip
TONE_MAPPED = "holds radiance (HDR); tone-mapped to 8 bits"
MIDDLE = 0.18  # what the mean radiance becomes: grey

JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"  # how a JPEG's APP1 segment with XMP begins (XMP specification, part 3)


class Stored(NamedTuple):
    """A `picture` ``(H, W, 3)`` uint8 as its file has it, upright, and what the file says of it.

    `hidden`: the mask ``(H, W)`` of what is transparent, and black, or None. `projection`: of the sphere (GPano), or
    None. `facts`: sentences.
    """

    picture: np.ndarray
    hidden: np.ndarray | None = None
    projection: Projection | None = None
    facts: tuple[str, ...] = ()


def read_panorama(path: str | os.PathLike[str]) -> np.ndarray:
    """The image file at `path` as ``(H, W, 3)`` uint8, as `read_stored` gives it.

    What is not 2:1 is accepted with a `UserWarning`: its columns span 360 degrees and its rows 180. Radiance is
    tone-mapped with a warning. Raises `ImageError` if there is no readable image.
    """
    found = read_stored(path)
    height, width = found.picture.shape[:2]
    stretched = f"is {width} x {height}, not 2:1: all columns span 360 degrees, all rows 180. If it shows less, pad it"
    odd = {TONE_MAPPED: TONE_MAPPED in found.facts, f"{stretched} first": width != 2 * height}
    for text in (text for text, holds in odd.items() if holds):
        warnings.warn(f"{os.fspath(path)!r} {text}", UserWarning, stacklevel=2)
    return found.picture


def read_stored(path: str | os.PathLike[str]) -> Stored:
    """The picture in a file (JPEG, PNG, WebP, ...), and what the file says of it.

    Grey, palette and transparent images become RGB (what is transparent is black). It is turned or mirrored as the
    orientation tag of the file (Exif) says, unless that would stand a 2:1 panorama on its side. Radiance (.hdr) is
    tone-mapped; that needs OpenCV. Raises `ImageError` if there is no readable image.
    """
    name = check_file(path, "an equirectangular image (PNG, JPEG, ...)")
    try:
        if name.lower().endswith(".hdr"):
            return Stored(tone_mapped(_radiance(name)), facts=(TONE_MAPPED,))
        with opened(name) as image:
            count = 1
            with suppress(Exception):  # Pillow may raise anything for a damaged file; an MPO has one that counts
                count = 1 if image.format == "MPO" else getattr(image, "n_frames", 1)
            deep = "16" in str(image.tile)  # of which Pillow keeps eight, the upper ones
            _load(image, os.path.getsize(name))
            several = (f"it holds {count} pictures, of which the first is taken",) if count > 1 else ()
            upright = _upright(image)
            if image.mode.startswith("I") and (depth := depth_in_words(np.asarray(image))):
                several += (depth,)
            found = Stored(*seen_of(upright), projection_of(image, upright.size), several)
            if deep and 0 < found.picture.max(initial=0) < 16:
                raise ImageError("holds 16-bit colours of which 12 bits or fewer are used: black here; scale them up")
            return found
    except MissingExtraError:
        raise
    except ImageError as error:
        raise ImageError(f"{name!r} {error}") from error
    except Exception as error:  # Pillow's decoders may raise anything for damaged files
        raise ImageError(
            f"{name!r} cannot be read as an image ({type(error).__name__}: {error}); it is corrupt, truncated or of "
            "another kind. Wanted an image that Pillow reads, such as PNG or JPEG: fetch or export it again"
        ) from error


def check_file(path: str | os.PathLike[str], wanted: str) -> str:
    """The name of a file that can be read, and is not empty. Raises `ImageError`, with what is `wanted`."""
    name = os.fspath(path)
    if not os.path.exists(name):
        raise ImageError(f"there is no file {name!r}; give the path of {wanted}")
    if os.path.isdir(name):
        raise ImageError(f"{name!r} is a folder; give one file in it, {wanted}")
    if not os.path.isfile(name):
        raise ImageError(f"{name!r} is a pipe or a device; give a file, {wanted}")
    if os.path.getsize(name) == 0:
        raise ImageError(f"{name!r} is empty (0 bytes); an interrupted copy or download? Fetch it again")
    if not os.access(name, os.R_OK):
        raise ImageError(f"{name!r} cannot be read; make it readable (chmod +r), or copy it")
    return name


def _radiance(name: str) -> np.ndarray:
    """Linear red, green, blue ``(H, W, 3)`` float32 of a Radiance picture (RGBE, Ward 1991)."""
    require_extra("a picture with radiance (.hdr)", "photos", "cv2")
    import cv2

    with open(name, "rb") as file:
        head = file.read(1 << 16)
    size = re.search(rb"\n[-+]Y (\d{1,6}) [-+]X (\d{1,6})\n", head)
    if not head.startswith(b"#?") or size is None:
        raise ImageError("is no Radiance picture (it has no header of one); export it again, or as PNG or JPEG")
    height, width = int(size[1]), int(size[2])
    _check_claim(width, height, 12 * width * height, os.path.getsize(name))
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong is said below
    try:
        found = cv2.imread(name, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if found is None or found.dtype != np.float32:
        raise ImageError("cannot be decoded; it is corrupt or truncated: fetch or export it again")
    return np.nan_to_num(found[..., ::-1], nan=0.0, posinf=float(np.finfo(np.float32).max), neginf=0.0)


def tone_mapped(radiance: np.ndarray) -> np.ndarray:
    """Linear radiance ``(H, W, 3)``, of any unit, as sRGB uint8.

    Reinhard, Stark, Shirley and Ferwerda, "Photographic tone reproduction for digital images" (2002), equation 4: the
    logarithmic mean becomes middle grey, the brightest half per cent white.
    """
    found = np.maximum(np.asarray(radiance, dtype=np.float64), 0.0)
    light = found @ np.array([0.2126, 0.7152, 0.0722])
    bright = light[light > 0]
    if not bright.size:
        return np.zeros(found.shape, dtype=np.uint8)
    scaled = light * (MIDDLE / np.exp(np.log(bright).mean()))
    white = max(float(np.quantile(scaled, 0.995)), MIDDLE)
    shown = scaled * (1 + scaled / white**2) / (1 + scaled)
    share = np.divide(shown, light, out=np.zeros_like(light), where=light > 0)
    return np.rint(255 * to_coded(found * share[..., None])).astype(np.uint8)


def read_image(
    file: str | IO[bytes], size: int, turned: Callable[[Image.Image], Image.Image] = lambda image: image
) -> np.ndarray:
    """The picture ``(H, W, 3)`` uint8 in a file of `size` bytes, `turned`: as it is stored, unless this says otherwise.

    A picture that claims more pixels than a real one of this file size can have is rejected before memory is allocated.
    Small pictures may be blank. Raises `ImageError`, or what Pillow's decoders raise.
    """
    with opened(file) as image:
        _load(image, size)
        return seen_of(turned(image))[0]


def _load(image: Image.Image, size: int) -> None:
    _check_claim(image.width, image.height, decoded_bytes(image), size)
    image.load()


def _check_claim(width: int, height: int, decoded: int, size: int) -> None:
    if decoded > max(_SMALL, _DENSEST * size):
        raise ImageError(f"claims {width} x {height} pixels in {size} bytes; it is corrupt, or blank")


def opened(file: str | os.PathLike[str] | IO[bytes]) -> Image.Image:
    """The picture in a file, not decoded yet. Raises `ImageError` for a kind that needs a package, and as Pillow."""
    try:
        return Image.open(file, formats=FORMATS)
    except UnidentifiedImageError:
        with open(file, "rb") if isinstance(file, str | os.PathLike) else nullcontext(file) as data:
            data.seek(0)
            head = data.read(12)
        kind = BOXED.get(head[8:]) if head[4:8] == b"ftyp" else None
        if unread := next((name for begin, name in UNREAD if head.startswith(begin)), ""):
            raise ImageError(f"is {unread}, which is not read; export it as PNG or JPEG") from None
        if kind is None:
            raise
        if kind == "HEIC" and find_spec("pillow_heif"):
            import_module("pillow_heif").register_heif_opener()
            return Image.open(file, formats=("HEIF",))
        reader = {"HEIC": "the package pillow-heif", "AVIF": "Pillow from version 11.3 on"}[kind]
        raise ImageError(f"is {kind}, which takes {reader} (pip install); or export it as JPEG") from None


def seen_of(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture as ``(H, W, 3)`` uint8, black where it is transparent by more than half; the mask of that, or None."""
    if image.mode == "F":
        raise ImageError("holds floating-point grey values of unknown range; tone-map it to 8 bits first")
    if image.mode.startswith("I"):  # 16-bit grey, which Pillow would clip instead of scaling
        grey = to_8_bits(np.clip(np.asarray(image), 0, 65535))
        return np.repeat(grey[..., None], 3, axis=-1), None
    hides = image.has_transparency_data
    image = image.convert("RGBA") if hides or image.mode == "P" else image
    rgb = np.array(image.convert("RGB"))
    unseen = np.asarray(image.getchannel("A")) < 128 if hides else np.zeros(1, bool)
    if not unseen.any():
        return rgb, None
    rgb[unseen] = 0
    return rgb, unseen


def depth_in_words(values: np.ndarray) -> str | None:
    """How 16-bit values of fewer bits are read; None for those that use all."""
    bits = _bits_of(values)
    return f"its 16-bit values are taken for {bits} bits: none is larger" if bits < 16 else None


def _bits_of(values: np.ndarray) -> int:
    """Bits that 16-bit values use: a sensor's 10, 12 or 14, which other programs show as black, or 16."""
    most = int(values.max(initial=0))
    return next(bits for bits in DEPTHS if most < 1 << bits)


def to_8_bits(values: np.ndarray) -> np.ndarray:
    """16-bit values as uint8, those of fewer bits scaled up."""
    full = (1 << _bits_of(values)) - 1
    return ((values.astype(np.uint32) * 255 + full // 2) // full).astype(np.uint8)


def _upright(image: Image.Image) -> Image.Image:
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


# --- turning, sizes ---


def turn(image: np.ndarray, new_R_old: np.ndarray) -> np.ndarray:
    """The panorama that the camera sees after it has turned: ``turn(image, R)`` at R @ d shows `image` at d.

    `new_R_old` is the rotation of the body frame, ``new_R_old @ direction_old = direction_new``; for poses
    ``world_R_body`` it is ``world_R_new.T @ world_R_old``. Turning left moves the content to the right. Bilinear; shape
    and data type are kept. Raises `RotationError` and `ImageError`.
    """
    rotation = check_rotation(np.asarray(new_R_old, dtype=np.float64))
    grid = _grid_of(image := np.asarray(image))
    return Sampler(grid, grid.directions @ rotation)(image)  # row vectors: d_old = R^T d_new


def view(image: np.ndarray, grid: Grid) -> np.ndarray:
    """The view of a camera with `grid` in the panorama, ``grid.shape`` or ``(*grid.shape, C)``, data type kept.

    Bilinear, without a low-pass filter: choose pixels that are not much coarser than the panorama's. Cells in which
    `grid` sees nothing (the corners of a fisheye) are black. Raises `ImageError`.
    """
    seen = Sampler(_grid_of(image := np.asarray(image)), grid.directions)(image)
    seen[np.asarray(grid.weights) <= 0] = 0
    return seen


def _grid_of(image: np.ndarray) -> ErpGrid:
    if image.ndim not in (2, 3) or image.size == 0 or image.dtype.kind not in "uif":
        raise ImageError(
            f"a panorama is an array (H, W) or (H, W, C) of numbers; got shape {image.shape}, type {image.dtype}. "
            "Read files with eagor.sources.panorama.read_panorama"
        )
    return ErpGrid(*image.shape[:2])


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


def by_area(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """A picture ``(H, W, 3)`` uint8 at another size: each pixel is the mean of its area; enlarged, bilinear."""
    if image.shape[:2] == (height, width):
        return image
    shrinks = height < image.shape[0] or width < image.shape[1]
    if (cv2 := opencv()) is not None:
        return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    how = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((width, height), how))


def shrunk(image: np.ndarray, rows: int) -> np.ndarray:
    """A panorama with about so many `rows`, by areas; one that has no more is returned as it is."""
    while image.shape[0] >= 2 * rows and not (image.shape[0] % 2 or image.shape[1] % 2):  # fast, and exact
        image = by_area(image, image.shape[0] // 2, image.shape[1] // 2)
    height, width = image.shape[:2]
    return image if height <= rows else by_area(image, rows, max(2, round(rows * width / height)))


# --- ordinary pictures cut from a panorama ---


def cut(panorama: np.ndarray, *views: PerspectiveGrid) -> list[np.ndarray]:
    """What cameras with these grids see of the panorama ``(H, W, 3)`` uint8: one uint8 ``(*grid.shape, 3)`` for each.

    Bilinear, around the seam and over the poles. A panorama that is finer than the views is shrunk first, so that
    nothing is left out between the pixels. Raises `ImageError`.
    """
    # A pixel of a view spans fewest degrees at its border; half way between that and the middle blurs least.
    rows = max((math.ceil(math.pi * view.focal / math.cos(view.hfov / 2)) for view in views), default=2)
    image = shrunk(np.ascontiguousarray(checked_picture(panorama)), max(2, rows))
    grid = ErpGrid(*image.shape[:2])
    rays = (view.body_R_view.astype(np.float32) @ _rays(view_key(view)) for view in views)
    return [Sampler(grid, each.T)(image).reshape(*view.shape, 3) for each, view in zip(rays, views, strict=True)]


@lru_cache(maxsize=4)
def _rays(lens: ViewKey) -> np.ndarray:
    """Directions ``(3, n)`` of the pixels of a view that looks forward; components side by side are quick to turn."""
    return np.ascontiguousarray(forward_view(lens).directions.reshape(-1, 3).T, dtype=np.float32)


# --- files of pictures ---


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of the whole sphere, or of an ordinary camera.

    `picture` ``(H, W, 3)`` uint8; a cropped panorama is put on a black sphere, and the mask `unseen` ``(H, W)`` says
    where nothing is known (None: all is seen). `grid`: the pixels of an ordinary camera's picture, in the body frame;
    None for a whole panorama. `level_R_body`: None, or the rotation ``(3, 3)`` that makes it level, as its file says.
    """

    picture: np.ndarray
    unseen: np.ndarray | None = None
    grid: PerspectiveGrid | None = None
    level_R_body: np.ndarray | None = None


def pictures_in(folder: Path) -> tuple[Path, ...]:
    """The image files in a folder, `in_order`. Raises `ImageError` if it cannot be read, or there are none."""
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        raise ImageError(f"{folder} cannot be read ({error.strerror}); make it readable, or name another") from error
    found = [path for path in inside if path.suffix.lower() in IMAGES and not path.name.startswith(".")]
    if not found:
        raise ImageError(f"{folder} holds no images; wanted files that end in {', '.join(IMAGES)}")
    twins = [stem for stem, count in Counter(path.stem for path in found).items() if count > 1]
    if twins:
        several = f"{len(twins)} names with several endings, such as {twins[0]}: all are taken, one after the other"
        warnings.warn(f"{folder} has {several}; keep one kind", UserWarning, stacklevel=4)
    return in_order(found)


def in_order(paths: Sequence[Path]) -> tuple[Path, ...]:
    """`paths` sorted by name; numbers in names sort by value."""
    return tuple(sorted(paths, key=lambda path: (natural(path.name), str(path))))


def projection_of(image: Image.Image, size: tuple[int, int] | None = None) -> Projection | None:
    """What the XMP of a picture that was read says of it (GPano), whose size is `size` as it is shown."""
    data = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp")
    if data is None:
        segments = [data for kind, data in getattr(image, "applist", ()) if kind == "APP1"]
        data = next((data[len(JPEG_XMP) :] for data in segments if data.startswith(JPEG_XMP)), b"")
    packet = data.encode() if isinstance(data, str) else bytes(data)
    return of_photograph(properties(packet, GPANO), size or image.size)
