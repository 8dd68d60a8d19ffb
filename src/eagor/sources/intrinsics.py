"""Where the pixels of one camera look: from a calibration, a field of view, or what its pictures' files say.

A `Camera` is what the user knows; an `IntrinsicsHint` is what a file says: Exif of photographs (CIPA DC-008), or
QuickTime's metadata of phones' videos. `ordinary_grid` makes an `eagor.grids.PerspectiveGrid` of them. The lens is that
of the picture as it is shown: where a file wants to be turned, the lens turns with it.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from eagor.cameras import SHAPE, Rig
from eagor.errors import EagorError, FormatError, ImageError
from eagor.grids import PerspectiveGrid
from eagor.sources.rigs import lens_of_model, read_rig

__all__ = [
    "Camera", "IntrinsicsHint", "ShapeError", "camera_of", "in_words", "intrinsics_from_exif", "intrinsics_from_tags",
    "ordinary_grid", "read_camera", "rig_of_info",
]  # fmt: skip

FULL_FRAME = math.hypot(36.0, 24.0)  # mm: the diagonal of the film that "35 mm equivalent" refers to (CIPA DCG-001)
PLAUSIBLE = (math.radians(2), math.radians(150))  # horizontal fields of ordinary cameras
ASK = (
    "How wide does its camera see? --hfov DEGREES, across the picture's width (a phone's main camera: about 65 held "
    "across, 50 upright), or --camera FILE, its calibration"
)

ORIENTATION, EXIF = 0x0112, 0x8769
FOCAL_LENGTH, FOCAL_35MM, PLANE_X, PLANE_UNIT, EXIF_WIDTH, EXIF_HEIGHT = 0x920A, 0xA405, 0xA20E, 0xA210, 0xA002, 0xA003
UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # mm: inch, cm, mm, micrometre
QUARTERS = {3: 2, 6: 3, 8: 1}  # quarter turns, counterclockwise, of Exif's orientations; the others are mirrored

FOCAL_KEY = re.compile(r"focal_?length[._]?(in)?_?35mm", re.IGNORECASE)


class ShapeError(ImageError):
    """A picture is neither a whole panorama, 2:1, nor known to be that of an ordinary lens."""


@dataclass(frozen=True, eq=False)
class Camera:
    """What the user knows of a camera; without anything, files may tell.

    `rig`: a calibration, of one lens; `hfov`: the field of an ideal lens, radians; `name`: where it is from, for texts.
    `eyes`: None, or what of `eagor.sources.metadata.LAYOUTS` a panorama's pictures are.
    """

    rig: Rig | None = None
    hfov: float | None = None
    name: str = ""
    eyes: str | None = None

    @property
    def known(self) -> bool:
        return self.rig is not None or self.hfov is not None


@dataclass(frozen=True)
class IntrinsicsHint:
    """What a file says of an ordinary camera.

    `focal`: pixels of its picture as it is shown, or None; `source`: who says so. `turns`: quarter turns
    (counterclockwise) with which the picture was turned. `facts`: sentences.
    """

    focal: float | None = None
    source: str = ""
    turns: int = 0
    facts: tuple[str, ...] = ()


def camera_of(hfov: float | None, path: Path | None, eyes: str | None = None) -> Camera:
    """The camera of ``--hfov`` (degrees), ``--camera`` and ``--eyes``. Raises `ImageError`, `FormatError`."""
    if eyes is not None and (hfov is not None or path is not None):
        raise ImageError(f"--eyes {eyes} is for panoramas; leave out --hfov and --camera")
    if hfov is not None and path is not None:
        raise ImageError(f"--hfov {hfov:g} and --camera {path}: wanted one of them; a calibration has the field")
    if path is not None:
        return Camera(read_camera(path), name=str(path))
    if hfov is None:
        return Camera(eyes=eyes)
    low, high = (math.degrees(limit) for limit in PLAUSIBLE)
    if not low <= hfov <= high:
        raise ImageError(
            f"--hfov {hfov:g}; wanted degrees across the picture's width, {low:g} to {high:g}. A wider lens is a "
            "fisheye: give its calibration with --camera, or --rig"
        )
    return Camera(hfov=math.radians(hfov), name=f"--hfov {hfov:g}")


def read_camera(path: str | os.PathLike[str]) -> Rig:
    """The one lens in a calibration file, as `eagor.sources.rigs.read_rig` reads it. Raises `FormatError`."""
    rig = read_rig(path)
    if max(len(rig.lenses), len(rig.sizes)) > 1:
        raise FormatError(
            f"{os.fspath(path)} holds {len(rig.lenses)} lenses in {len(rig.sizes)} pictures; wanted one lens in one "
            "picture. For a camera with several lenses: --rig"
        )
    return rig


def ordinary_grid(camera: Camera, hint: IntrinsicsHint, size: tuple[int, int], name: str) -> PerspectiveGrid | None:
    """The grid of an ordinary picture of `size` (width, height), as it is shown; None if nothing is known of its lens.

    The pose is that of the calibration; without one the picture looks forward. Raises `ImageError`, about `name`, where
    a calibration is for pictures of another shape.
    """
    width, height = size
    if camera.rig is not None:
        lens = camera.rig.lenses[0]
        if hint.turns % 2 == 0 or _alike(size, (lens.size[1], lens.size[0])):  # else it was calibrated as it is shown
            lens = lens.turned(hint.turns)
        if not _alike(size, lens.size):
            wide, high = camera.rig.lenses[0].size
            raise ImageError(
                f"{name} is {width} x {height}, and {camera.name} is for pictures of {wide} x {high}; wanted the same "
                "shape in any size. A camera cuts its pictures differently for another shape: calibrate it with such "
                "pictures, or give --hfov"
            )
        return PerspectiveGrid.of_lens(lens).resized(height, width)
    if camera.hfov is not None:
        return PerspectiveGrid(height, width, camera.hfov)
    return None if hint.focal is None else PerspectiveGrid(height, width, 2 * math.atan(width / (2 * hint.focal)))


def in_words(source: str, grid: PerspectiveGrid | None) -> str:
    """What `source` says of a lens: the field of its `grid`; without one it is laid out in a panorama."""
    if grid is None:
        return f"a fisheye, as {source} says: it is looked at as a part of a panorama"
    height, width = grid.shape
    high = 2 * math.degrees(math.atan(math.tan(grid.hfov / 2) * height / width))
    return f"an ordinary camera, {math.degrees(grid.hfov):.1f} x {high:.1f} degrees, says {source}"


def _alike(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return abs(one[0] * other[1] / (one[1] * other[0]) - 1) <= SHAPE


# --- what files say ---


def intrinsics_from_exif(path: str | Path) -> IntrinsicsHint:
    """What Exif says of the camera; nothing where the tags are missing, impossible, or of a picture that was cropped.

    The focal length in 35 mm film refers to the diagonal (CIPA DCG-001).
    """
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            tags, size = exif.get_ifd(EXIF), image.size
            turns = QUARTERS.get(exif.get(ORIENTATION, 1), 0)
    except Exception:  # Pillow may raise anything for damaged metadata
        return IntrinsicsHint()
    numbers = (_number(tags.get(tag)) for tag in (FOCAL_35MM, FOCAL_LENGTH, PLANE_X, EXIF_WIDTH, EXIF_HEIGHT))
    film, length, per_unit, wide, high = numbers
    taken = wide or size[0], high or size[1]
    if not (_alike(size, taken) or _alike(size, (taken[1], taken[0]))):
        return IntrinsicsHint(turns=turns, facts=("its Exif is that of a picture of another shape: it was cropped",))
    if film:
        return _hint(film * math.hypot(*size) / FULL_FRAME, "its Exif (FocalLengthIn35mmFilm)", size[turns % 2], turns)
    focal = (length or 0.0) * (per_unit or 0.0) / UNITS.get(tags.get(PLANE_UNIT, 2), math.inf)
    source = "its Exif (FocalLength, FocalPlaneXResolution)"
    return _hint(focal * max(size) / max(taken), source, size[turns % 2], turns)


def intrinsics_from_tags(tags: Mapping[str, str], size: tuple[int, int], turns: int) -> IntrinsicsHint:
    """What the `tags` of a video say, of pictures of `size` (width, height) as they are shown.

    Phones write the focal length in 35 mm film (``com.apple.quicktime.camera.focal_length.35mm_equivalent``).
    """
    films = ((key, film) for key, value in tags.items() if FOCAL_KEY.search(key) and (film := _number(value)))
    key, film = next(films, ("..", 0.0))
    source = f"its metadata ({key.rsplit('.', 2)[-2]}, 35 mm)"
    return _hint(film * math.hypot(*size) / FULL_FRAME, source, size[0], turns)


def _hint(focal: float, source: str, width: int, turns: int) -> IntrinsicsHint:
    """With the focal length, if pictures of this `width` then have a field that can be."""
    good = focal > 0 and PLAUSIBLE[0] <= 2 * math.atan(width / (2 * focal)) <= PLAUSIBLE[1]
    return IntrinsicsHint(focal, source, turns) if good else IntrinsicsHint(turns=turns)


def _number(value: Any) -> float | None:
    """A number above 0 in a tag, or None."""
    with suppress(TypeError, ValueError, ZeroDivisionError):
        if math.isfinite(found := float(value)) and found > 0:
            return found
    return None


def rig_of_info(received: Any, rectified: bool, name: str) -> Rig:
    """The one lens that a sensor_msgs/CameraInfo tells, called `name`, with the size of its pictures.

    `rectified`: of the pictures without distortion (``image_rect``): the lens is that of P, otherwise of K and D. P and
    K are those of the whole sensor; the pictures are the region `roi`, with `binning` pixels in one. R is not used: the
    header's frame is taken for that of the pictures, as ``image_geometry`` takes it. Raises `FormatError`.
    """
    roi = received.roi
    left, top, wide, high = roi.x_offset, roi.y_offset, roi.width, roi.height
    if 0 in (wide, high):
        left, top, wide, high = 0, 0, received.width, received.height
    across, down = max(1, received.binning_x), max(1, received.binning_y)
    size = wide // across, high // down
    if min(size) < 1:
        raise FormatError(f"{name} is for pictures of {wide} x {high} pixels; wanted the size that the camera has")
    letter, values, columns = ("P", received.p, 4) if rectified else ("K", received.k, 3)
    values = [float(value) for value in values]
    fx, cx, fy, cy = (values[at] for at in (0, 2, columns + 1, columns + 2))
    if not (np.isfinite(values).all() and min(fx, fy) > 0):
        raise FormatError(
            f"{name} has the focal lengths {fx:g} and {fy:g} in {letter}; wanted pixels above 0. The camera is not "
            "calibrated: calibrate it (ros2 run camera_calibration cameracalibrator), or give --hfov"
        )
    centre = (cx + 0.5 - left) / across, (cy + 0.5 - top) / down
    model = "none" if rectified else received.distortion_model.strip().lower()
    distortion = [] if rectified else [float(value) for value in received.d]
    try:
        return Rig((size,), (lens_of_model(model, size, (fx / across, fy / down), centre, distortion),))
    except EagorError as error:  # numbers that no lens has
        raise FormatError(f"{name} tells no lens: {error}") from error
