"""Where the pixels of one camera look: from a calibration, a field of view, or what its pictures' files say.

A `Camera` is what the user knows; `Told` is what a file says: Exif of photographs (CIPA DC-008), QuickTime's metadata
of phones' videos. `ordinary_grid` makes an `eagor.grids.PerspectiveGrid` of them. The lens is that of the picture as it
is shown: where a file wants to be turned, the lens turns with it.

`rig_of_info` reads the message sensor_msgs/CameraInfo, `read_camera` calibrations as other programs write them, which
it knows by what is in them:

- ROS ``camera_info`` (camera_calibration, or ``ros2 topic echo``): ``image_width``, ``image_height``,
  ``camera_matrix``, ``distortion_model``, ``distortion_coefficients``; or ``width``, ``height``, ``K``, ``D``.
- OpenCV's FileStorage (YAML with its own first line, JSON, XML): ``image_width``, ``image_height``, ``camera_matrix``,
  ``distortion_coefficients``; ``fisheye_model: 1`` for the module fisheye.
- Kalibr's camchain: ``cam0`` with ``camera_model``, ``intrinsics``, ``distortion_model``, ``distortion_coeffs``,
  ``resolution``; the same without ``cam0`` in EuRoC's sensor.yaml. Their extrinsics are not used.
- COLMAP's ``cameras.txt``: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS.
- A rig of ours with one lens (`eagor.media.rigs`), also with its pose in the body.

OpenCV, ROS and Kalibr count pixels from the first one's centre: half a pixel is added to their centre. COLMAP counts
from the corner, as we do.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from eagor._files import read_file
from eagor.errors import EagorError, FormatError, ImageError
from eagor.grids import PerspectiveGrid
from eagor.lenses import WIDEST, FisheyeLens, Lens, PinholeLens
from eagor.media.rigs import SHAPE, Place, Rig, read_rig, read_yaml

__all__ = [
    "Camera", "ShapeError", "Told", "camera_of", "in_words", "ordinary_grid", "read_camera", "rig_of_info",
    "told_by_photograph", "told_by_video",
]  # fmt: skip

FULL_FRAME = math.hypot(36.0, 24.0)  # mm: the diagonal of the film that "35 mm equivalent" refers to (CIPA DCG-001)
PLANE_WIDEST = math.radians(140)  # beyond, a plane has hardly any pixels for what is ahead: such lenses are stitched
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


class ShapeError(ImageError):
    """A picture is neither a whole panorama, 2:1, nor known to be that of an ordinary lens."""


@dataclass(frozen=True, eq=False)
class Camera:
    """What the user knows of an ordinary camera; without anything, files may tell.

    `rig`: a calibration, of one lens; `hfov`: the field of an ideal lens, radians; `name`: where it is from, for texts.
    `eyes`: None, or what of `eagor.media.metadata.LAYOUTS` a panorama's pictures are.
    """

    rig: Rig | None = None
    hfov: float | None = None
    name: str = ""
    eyes: str | None = None

    @property
    def known(self) -> bool:
        return self.rig is not None or self.hfov is not None

    @property
    def wide(self) -> bool:
        """Whether its pictures have to be stitched: a fisheye, or a lens wider than `PLANE_WIDEST`."""
        lens = None if self.rig is None else self.rig.lenses[0]
        return lens is not None and not (
            isinstance(lens, PinholeLens) and PerspectiveGrid.of_lens(lens).hfov <= PLANE_WIDEST
        )


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


def camera_of(hfov: float | None, path: Path | None, eyes: str | None = None) -> Camera:
    """The camera of ``--hfov`` (degrees), ``--camera`` and ``--eyes``. Raises `ImageError`, `FormatError`."""
    if eyes is not None:
        if hfov is not None or path is not None:
            raise ImageError(f"--eyes {eyes} is for panoramas; leave out --hfov and --camera")
        return Camera(eyes=eyes)
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
    shown = size[turns % 2]
    taken = _number(said.get(EXIF_WIDTH)) or size[0], _number(said.get(EXIF_HEIGHT)) or size[1]
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
            source = f"its metadata ({key.rsplit('.', 2)[-2]}, 35 mm)"
            return replace(_plausible(focal, size[0], source, turns), facts=facts)
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


# --- calibrations of other programs ---


KIND = "a camera's calibration"
WANTED = (
    "a camera: ROS camera_info, OpenCV's camera_matrix and distortion_coefficients, Kalibr's camchain, or pictures and "
    "lenses of a rig; COLMAP's is a text file"
)
SIZES = (("image_width", "image_height"), ("width", "height"))
MATRICES = ("camera_matrix", "cameramatrix", "k", "mtx")
COEFFICIENTS = ("distortion_coefficients", "dist_coeffs", "dist_coeff", "distcoeffs", "d", "dist")
# Distortion models of ROS and Kalibr, and how many numbers each has at most.
PLANE_MODELS = {"plumb_bob": 5, "rational_polynomial": 8, "radtan": 4, "radial-tangential": 4, "none": 0, "": 8}
ROUND_MODELS = {"equidistant": 4, "kannala_brandt": 4}
KALIBR = re.compile(r"cam\d+")
FLATTEST = 100  # by how much a picture may be larger than the focal length: a field of 178 degrees
SQUARE = 0.01  # by which the two focal lengths of a fisheye may differ
STEEP = 1441  # angles at which it is looked how far a fisheye's curve rises


def read_camera(path: str | os.PathLike[str]) -> Rig:
    """The one lens in a calibration file, with the size of the pictures that it was calibrated with.

    Raises `FormatError`, which names the file, the line or the field, what is there and what was wanted.
    """
    name = os.fspath(path)
    if name.lower().endswith(".txt"):
        return _colmap(name)
    root = read_yaml(name, KIND, WANTED)
    try:
        entries = {key.lower(): value for key, value in root.mapping().items()}
        if "lenses" in entries:
            rig = read_rig(name)
            if max(len(rig.lenses), len(rig.sizes)) > 1:
                raise FormatError(
                    f"{name} holds {len(rig.lenses)} lenses in {len(rig.sizes)} pictures; wanted one lens in one "
                    "picture. For a camera with several lenses: --rig"
                )
            return rig
        as_kalibr = "intrinsics" in entries or any(map(KALIBR.fullmatch, entries))
        lens, size = (_kalibr if as_kalibr else _opencv)(root, entries)
        return Rig((size,), (lens,))
    except FormatError as error:
        raise error if str(error).startswith(name) else FormatError(f"{name}, {error}") from error
    except EagorError as error:  # numbers that no lens has
        raise FormatError(f"{name}: {error}") from error


# --- ROS and OpenCV ---


def _opencv(root: Place, entries: Mapping[str, Place]) -> tuple[Lens, tuple[int, int]]:
    matrix = _first(entries, MATRICES)
    if matrix is None:
        found = ", ".join([*entries][:8]) or "nothing"
        raise root.wrong(f"holds {found}, and no camera_matrix; wanted {WANTED}")
    sides = next((pair for pair in SIZES if all(side in entries for side in pair)), None)
    if sides is None:
        raise root.wrong(
            "has no image_width and image_height; wanted the pixels of the pictures that it was calibrated with: add "
            "two lines, such as image_width: 1920"
        )
    size = _size(entries[sides[0]], entries[sides[1]])
    k = _numbers(matrix, "9 numbers, row by row: fx 0 cx 0 fy cy 0 0 1", (9,))
    fx, skew, cx, zero, fy, cy = k[:6]
    if (zero, *k[6:]) != (0, 0, 0, 1):
        raise matrix.wrong(f"has the last row {k[6:]}; wanted 0 0 1. Is it written column by column?")
    if abs(skew) > 1e-6 * fx:
        raise matrix.wrong(f"has the skew {skew:g}; wanted 0: pixels with right angles")
    model = entries["distortion_model"].text().lower() if "distortion_model" in entries else ""
    fisheye = "fisheye_model" in entries and entries["fisheye_model"].text().lower() not in ("0", "false")
    place = _first(entries, COEFFICIENTS)
    values = () if place is None else _numbers(place, "up to 8 numbers", range(15))
    model = model or ("equidistant" if fisheye else "")
    return _lens((place or matrix).wrong, model, size, (fx, fy), (cx + 0.5, cy + 0.5), values), size


def _first(entries: Mapping[str, Place], names: Sequence[str]) -> Place | None:
    return next((entries[name] for name in names if name in entries), None)


def _size(width: Place, height: Place) -> tuple[int, int]:
    wide, high = (int(side.number("a whole number of pixels", True)) for side in (width, height))
    if min(wide, high) < 1:
        raise width.wrong(f"and the height are {wide} and {high}; wanted pixels, at least 1")
    return wide, high


def _numbers(place: Place, wanted: str, counts: Sequence[int]) -> tuple[float, ...]:
    """A matrix: with ``data`` (ROS, OpenCV), a list, or a list of rows."""
    if place.node.id == "mapping":
        inside = place.mapping()
        if "data" not in inside:
            raise place.wrong(f"has no data; wanted {wanted}")
        place = inside["data"]
    found: list[float] = []
    for each in place.items(wanted):
        found += [one.number() for one in each.items(wanted)] if each.node.id == "sequence" else [each.number()]
    if len(found) not in counts:
        raise place.wrong(f"has {len(found)} numbers; wanted {wanted}")
    return tuple(found)


# --- Kalibr ---


def _kalibr(root: Place, entries: Mapping[str, Place]) -> tuple[Lens, tuple[int, int]]:
    cameras = [name for name in entries if KALIBR.fullmatch(name)]
    if len(cameras) > 1:
        raise root.wrong(f"holds {len(cameras)} cameras, {', '.join(cameras)}; keep the one that took the pictures")
    place = entries[cameras[0]] if cameras else root
    fields = place.mapping()
    for key in ("camera_model", "intrinsics", "resolution"):
        if key not in fields:
            raise place.wrong(f"has no {key}; wanted camera_model, intrinsics, resolution and the distortion")
    if (kind := fields["camera_model"].text()) != "pinhole":
        raise fields["camera_model"].wrong(f"is {kind!r}; wanted pinhole: calibrate with --models pinhole-radtan")
    fx, fy, cx, cy = _numbers(fields["intrinsics"], "4 numbers: fu, fv, pu, pv", (4,))
    sides = fields["resolution"].items("width and height, pixels")
    if len(sides) != 2:
        raise fields["resolution"].wrong(f"has {len(sides)} members; wanted width and height, pixels")
    size = _size(*sides)
    model = fields["distortion_model"].text().lower() if "distortion_model" in fields else "none"
    told = fields.get("distortion_coeffs") or fields.get("distortion_coefficients")
    values = () if told is None else _numbers(told, "up to 4 numbers", range(5))
    return _lens((told or place).wrong, model, size, (fx, fy), (cx + 0.5, cy + 0.5), values), size


# --- COLMAP ---

# Names of the parameters of each model, in order (COLMAP, src/colmap/sensor/models.h).
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}
PLAIN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def _colmap(name: str) -> Rig:
    try:
        lines = read_file(name).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise FormatError(f"{name} cannot be read as {KIND} ({why}); give COLMAP's cameras.txt") from error
    told = [(at, line.split()) for at, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if len(told) != 1:
        raise FormatError(
            f"{name} holds {len(told)} cameras; wanted one line CAMERA_ID MODEL WIDTH HEIGHT PARAMS...: that of the "
            "camera which took the pictures"
        )
    at, (_, model, *numbers) = told[0] if len(told[0][1]) > 4 else (told[0][0], ("", "", ""))
    where = f"{name}, line {at}"
    if model not in COLMAP_MODELS:
        known = ", ".join(COLMAP_MODELS)
        raise FormatError(f"{where}: the model is {model or lines[at - 1]!r}; wanted CAMERA_ID and one of {known}")
    wanted = COLMAP_MODELS[model].split()
    try:
        wide, high = int(numbers[0]), int(numbers[1])
        values = [float(text) for text in numbers[2:]]
        if len(values) != len(wanted) or not np.isfinite(values).all() or min(wide, high) < 1:
            raise ValueError
    except ValueError:
        raise FormatError(
            f"{where}: {model} has {' '.join(numbers)}; wanted width, height, {', '.join(wanted)}"
        ) from None
    found = dict(zip(wanted, values, strict=True))
    focal = (found["f"], found["f"]) if "f" in found else (found["fx"], found["fy"])
    centre = found["cx"], found["cy"]
    fisheye = model.endswith("FISHEYE")
    factors = [found.get(key, 0.0) for key in (("k1", "k2", "k3", "k4") if fisheye else PLAIN)]
    try:
        lens = _lens(FormatError, "equidistant" if fisheye else "", (wide, high), focal, centre, factors)
        return Rig(((wide, high),), (lens,))
    except EagorError as error:
        raise FormatError(f"{where}: {error}") from error


# --- messages ---


def rig_of_info(received: Any, rectified: bool, name: str) -> Rig:
    """The one lens that a sensor_msgs/CameraInfo tells, called `name`, with the size of its pictures.

    `rectified`: of the pictures without distortion (``image_rect``): the lens is that of P, otherwise of K and D. P and
    K are those of the whole sensor; the pictures are the region `roi`, with `binning` pixels in one. R is not used: the
    header's frame is taken for that of the pictures, as ``image_geometry`` takes it. Raises `FormatError`.
    """

    def wrong(text: str) -> FormatError:
        return FormatError(f"{name} {text}")

    roi = received.roi
    whole = 0 in (roi.width, roi.height)
    left, top, wide, high = (
        (0, 0, received.width, received.height) if whole else (roi.x_offset, roi.y_offset, roi.width, roi.height)
    )
    across, down = max(1, received.binning_x), max(1, received.binning_y)
    size = wide // across, high // down
    if min(size) < 1:
        raise wrong(f"is for pictures of {wide} x {high} pixels; wanted the size that the camera has")
    letter, values = ("P", [float(v) for v in received.p]) if rectified else ("K", [float(v) for v in received.k])
    fx, fy, cx, cy = (values[at] for at in ((0, 5, 2, 6) if rectified else (0, 4, 2, 5)))
    if not (np.isfinite(values).all() and min(fx, fy) > 0):
        raise wrong(
            f"has the focal lengths {fx:g} and {fy:g} in {letter}; wanted pixels above 0. The camera is not "
            "calibrated: calibrate it (ros2 run camera_calibration cameracalibrator), or give --hfov"
        )
    focal = fx / across, fy / down
    centre = (cx + 0.5 - left) / across, (cy + 0.5 - top) / down
    model = "none" if rectified else received.distortion_model.strip().lower()
    try:
        lens = _lens(wrong, model, size, focal, centre, [] if rectified else [float(v) for v in received.d])
    except EagorError as error:  # numbers that no lens has
        raise error if str(error).startswith(name) else wrong(f"tells no lens: {error}") from error
    return Rig((size,), (lens,))


# --- lenses ---


def _lens(
    wrong: Callable[[str], FormatError],
    model: str,
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    values: Sequence[float],
) -> Lens:
    """The lens of a distortion `model` of ROS, OpenCV or Kalibr with these `values`; `wrong` makes the errors."""
    most = {**PLANE_MODELS, **ROUND_MODELS}.get(model)
    if most is None:
        known = ", ".join(filter(None, (*PLANE_MODELS, *ROUND_MODELS)))
        raise wrong(f"belongs to the distortion model {model!r}; wanted one of {known}")
    if any(values[most:]):
        raise wrong(f"has {len(values)} numbers; wanted at most {most} that are not 0 ({model or 'OpenCV'})")
    if model in ROUND_MODELS:
        return _fisheye(size, focal, centre, values[:most])
    if 0 < min(focal) < max(size) / FLATTEST:
        raise wrong(f"goes with the focal lengths {focal[0]:g} and {focal[1]:g} in pictures of {size}; wanted pixels")
    return PinholeLens("camera", size, focal, centre, tuple(values[:most]))


def _fisheye(
    size: tuple[int, int], focal: tuple[float, float], centre: tuple[float, float], polynomial: Sequence[float]
) -> FisheyeLens:
    """A fisheye up to the farthest corner of its picture, or as far as its curve rises."""
    if not min(focal) > 0 or abs(focal[0] / focal[1] - 1) > SQUARE:
        raise FormatError(f"the fisheye's focal lengths are {focal[0]:g} and {focal[1]:g}; wanted square pixels")
    mean = math.sqrt(focal[0] * focal[1])
    corner = max(math.dist(centre, (x, y)) for x in (0, size[0]) for y in (0, size[1]))
    angles = np.linspace(0, WIDEST / 2, STEEP)[1:]
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that no lens has
        radii = mean * np.sum([k * angles ** (2 * n + 1) for n, k in enumerate((1.0, *polynomial))], axis=0)
        rising = np.flatnonzero(np.diff(np.concatenate([[0.0], radii])) <= 0)
    last = float(radii[rising[0] - 1]) if rising.size and rising[0] > 0 else float(radii[-1])
    return FisheyeLens("camera", centre, mean, min(corner, 0.999 * last), tuple(polynomial))
