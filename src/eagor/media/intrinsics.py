"""Where the pixels of an ordinary picture look: from a calibration, a field of view, or what its file says.

A `Camera` is what the user knows; `Told` is what a file says: Exif of photographs (CIPA DC-008), QuickTime's metadata
of phones' videos. `ordinary_grid` makes an `eagor.grids.PerspectiveGrid` of them. The lens is that of the picture as it
is shown: where a file wants to be turned, the lens turns with it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from eagor.errors import ImageError
from eagor.grids import PerspectiveGrid
from eagor.lenses import PinholeLens
from eagor.media.camera_files import read_camera
from eagor.media.rigs import SHAPE, Rig

__all__ = ["Camera", "Told", "camera_of", "in_words", "ordinary_grid", "told_by_photograph", "told_by_video"]

FULL_FRAME = math.hypot(36.0, 24.0)  # mm: the diagonal of the film that "35 mm equivalent" refers to (CIPA DCG-001)
WIDEST = math.radians(140)  # beyond, a plane has hardly any pixels for what is ahead: such lenses are stitched
PLAUSIBLE = (math.radians(2), math.radians(150))  # horizontal fields of ordinary cameras
ASK = (
    "How wide does its camera see? --hfov DEGREES, across the picture's width (a phone's main camera: about 65 held "
    "across, 50 upright), or --camera FILE, its calibration"
)

ORIENTATION, EXIF = 0x0112, 0x8769
FOCAL_LENGTH, FOCAL_35MM = 0x920A, 0xA405
PLANE_X, PLANE_UNIT = 0xA20E, 0xA210
EXIF_WIDTH, EXIF_HEIGHT = 0xA002, 0xA003
UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # mm: inch, cm, mm, micrometre
QUARTERS = {3: 2, 6: 3, 8: 1}  # quarter turns, counterclockwise, of Exif's orientations; the others are mirrored

FOCAL_KEY = re.compile(r"focal_?length[._]?(in)?_?35mm", re.IGNORECASE)
STEADY_KEY = re.compile(r"stabili[sz]|steadi", re.IGNORECASE)
OFF = ("", "0", "off", "no", "none", "false", "disabled")


@dataclass(frozen=True, eq=False)
class Camera:
    """What the user knows of an ordinary camera; without anything, files may tell.

    `rig`: a calibration, of one lens; `hfov`: the field of an ideal lens, radians; `name`: where it is from, for texts.
    """

    rig: Rig | None = None
    hfov: float | None = None
    name: str = ""

    @property
    def known(self) -> bool:
        return self.rig is not None or self.hfov is not None

    @property
    def wide(self) -> bool:
        """Whether its pictures have to be stitched: a fisheye, or a lens wider than `WIDEST`."""
        lens = None if self.rig is None else self.rig.lenses[0]
        return lens is not None and not (isinstance(lens, PinholeLens) and PerspectiveGrid.of_lens(lens).hfov <= WIDEST)


@dataclass(frozen=True)
class Told:
    """What a file says of an ordinary camera.

    `focal`: pixels of its picture as it is shown, or None; `source`: who says so. `turns`: quarter turns
    (counterclockwise) with which the picture was turned. `facts`: sentences.
    """

    focal: float | None = None
    source: str = ""
    turns: int = 0
    facts: tuple[str, ...] = ()


def camera_of(hfov: float | None, path: Path | None) -> Camera:
    """The camera of ``--hfov`` (degrees) and ``--camera``. Raises `ImageError`, `FormatError`."""
    if hfov is not None and path is not None:
        raise ImageError(f"--hfov {hfov:g} and --camera {path}: wanted one of them; a calibration has the field")
    if path is not None:
        return Camera(read_camera(path), name=str(path))
    if hfov is None:
        return Camera()
    low, high = (math.degrees(limit) for limit in PLAUSIBLE)
    if not low <= hfov <= high:
        raise ImageError(
            f"--hfov {hfov:g}; wanted degrees across the picture's width, {low:g} to {high:g}. A wider lens is a "
            "fisheye: give its calibration with --camera, or --rig"
        )
    return Camera(hfov=math.radians(hfov), name=f"--hfov {hfov:g}")


def ordinary_grid(camera: Camera, told: Told, size: tuple[int, int], name: str) -> PerspectiveGrid | None:
    """The grid of an ordinary picture of `size` (width, height), as it is shown; None if nothing is known of its lens.

    The pose is that of the calibration; without one the picture looks forward. Raises `ImageError`, about `name`, where
    a calibration is for pictures of another shape.
    """
    width, height = size
    if camera.rig is not None:
        lens = camera.rig.lenses[0]
        assert isinstance(lens, PinholeLens)
        wide, high = lens.size
        if told.turns % 2 == 0 or _alike(size, (high, wide)):  # else it was calibrated as it is shown
            lens = lens.turned(told.turns)
        if not _alike(size, lens.size):
            raise ImageError(
                f"{name} is {width} x {height}, and {camera.name} is for pictures of {wide} x {high}; wanted the same "
                "shape in any size. A camera cuts its pictures differently for another shape: calibrate it with such "
                "pictures, or give --hfov"
            )
        return PerspectiveGrid.of_lens(lens).resized(height, width)
    if camera.hfov is not None:
        return PerspectiveGrid(height, width, camera.hfov)
    if told.focal is None:
        return None
    return PerspectiveGrid(height, width, 2 * math.atan(width / (2 * told.focal)))


def in_words(source: str, grid: PerspectiveGrid | None) -> str:
    """What `source` says of a lens: the field of its `grid`; without one it is a fisheye, which is stitched."""
    if grid is None:
        return f"a fisheye, as {source} says: it is looked at as a part of a panorama"
    height, width = grid.shape
    high = 2 * math.degrees(math.atan(math.tan(grid.hfov / 2) * height / width))
    return f"an ordinary camera, {math.degrees(grid.hfov):.1f} x {high:.1f} degrees, says {source}"


def _alike(one: tuple[int, int], other: tuple[int, int]) -> bool:
    return abs(one[0] * other[1] / (one[1] * other[0]) - 1) <= SHAPE


# --- what files say ---


def told_by_photograph(path: str | Path) -> Told:
    """What Exif says of the camera; nothing where the tags are missing, impossible, or of a picture that was cropped.

    The focal length in 35 mm film refers to the diagonal (CIPA DCG-001).
    """
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            said, size = exif.get_ifd(EXIF), image.size
            turns = QUARTERS.get(exif.get(ORIENTATION, 1), 0)
    except Exception:  # Pillow may raise anything for damaged metadata
        return Told()
    width, height = size
    shown = height if turns % 2 else width
    taken = _number(said.get(EXIF_WIDTH)) or width, _number(said.get(EXIF_HEIGHT)) or height
    if not (_alike(size, taken) or _alike(size, (taken[1], taken[0]))):  # type: ignore[arg-type]
        return Told(turns=turns, facts=("its Exif is that of a picture of another shape: it was cropped",))
    if film := _number(said.get(FOCAL_35MM)):
        return _plausible(film * math.hypot(*size) / FULL_FRAME, shown, "its Exif (FocalLengthIn35mmFilm)", turns)
    length, per_unit = _number(said.get(FOCAL_LENGTH)), _number(said.get(PLANE_X))
    unit = UNITS.get(said.get(PLANE_UNIT, 2))
    if length and per_unit and unit:
        focal = length * per_unit / unit * max(size) / max(taken)
        return _plausible(focal, shown, "its Exif (FocalLength, FocalPlaneXResolution)", turns)
    return Told(turns=turns)


def told_by_video(tags: Mapping[str, str], size: tuple[int, int], turns: int) -> Told:
    """What the `tags` of a video say, of pictures of `size` (width, height) as they are shown.

    Phones write the focal length in 35 mm film (``com.apple.quicktime.camera.focal_length.35mm_equivalent`` and the
    like). Where the tags say that the pictures were steadied or cropped, a fact warns: no lens describes them exactly.
    """
    facts = tuple(_warned(tags))
    for key, value in tags.items():
        if FOCAL_KEY.search(key) and (film := _number(value)):
            focal = film * math.hypot(*size) / FULL_FRAME
            found = _plausible(focal, size[0], f"its metadata ({key.rsplit('.', 2)[-2]}, 35 mm)", turns)
            return Told(found.focal, found.source, turns, facts)
    return Told(turns=turns, facts=facts)


def _warned(tags: Mapping[str, str]) -> Iterator[str]:
    for key, value in tags.items():
        if STEADY_KEY.search(key) and value.strip().lower() not in OFF:
            yield (
                f"warning: its metadata says {key.rsplit('.', 1)[-1]} = {value}: steadied pictures move within the "
                "lens' field, so directions are off by some degrees. Film without stabilisation"
            )


def _plausible(focal: float, width: int, source: str, turns: int) -> Told:
    hfov = 2 * math.atan(width / (2 * focal))
    return Told(focal, source, turns) if PLAUSIBLE[0] <= hfov <= PLAUSIBLE[1] else Told(turns=turns)


def _number(value: Any) -> float | None:
    """A number above 0 in a tag, or None."""
    try:
        found = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return found if math.isfinite(found) and found > 0 else None
